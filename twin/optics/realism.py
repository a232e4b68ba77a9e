"""How far a stereo head as made departs from a pair of pinholes as drawn."""

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform

from models.datasheets import CAMERA, CAMERA_CALIBRATION, LENS, POOR_CAMERA_CALIBRATION
from perception.geometry.pinhole import Pinhole, StereoCalibration


@dataclasses.dataclass(frozen=True)
class CameraRealism:
    """Light, lenses and mounting of a stereo head as made; the default is ideal.

    Errors are standard deviations along each axis, drawn once for each head from its seed;
    controllers keep the drawing.

    Attributes:
        exposure: Exposure time [s]; the stamp of a pair is its middle. 0 for no motion blur.
        latency: Time from the middle of the exposure to the pair's arrival on the channel [s].
        gain_error: Error of the logarithm of the exposure, for both eyes.
        vignetting: Part of the light that the lens' barrel takes from the image's corners, beyond
            the cos^4 law; None for images without any vignetting.
        f_number: Focal length over aperture; None for lenses that are sharp at all depths.
        focus_distance: Depth in focus [m].
        focal_error: Relative error of the focal lengths, the same for both eyes.
        principal_error: Error of the optical axis' place in the image, for both eyes [px].
        head_turn: Error of the head's orientation on the arm [rad].
        head_shift: Error of the head's place on the arm [m].
        eye_turn: Error of each eye's orientation in the head [rad].
        eye_shift: Error of each eye's place in the head [m].
    """

    exposure: float = 0.0
    latency: float = 0.0
    gain_error: float = 0.0
    vignetting: float | None = None
    f_number: float | None = None
    focus_distance: float = LENS.focus_distance
    focal_error: float = 0.0
    principal_error: float = 0.0
    head_turn: float = 0.0
    head_shift: float = 0.0
    eye_turn: float = 0.0
    eye_shift: float = 0.0

    @property
    def calibration(self) -> StereoCalibration:
        """What the calibration of such a head states of its own errors."""
        return StereoCalibration(
            self.focal_error,
            self.principal_error,
            self.eye_turn,
            self.eye_shift,
            self.head_turn,
            self.head_shift,
        )

    def __post_init__(self) -> None:
        """Refuse numbers that describe no camera.

        Raises:
            ValueError: Naming the field and its value.
        """
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not 0.0 <= value < math.inf:
                raise ValueError(f"camera {field.name} must be finite and >= 0, got {value}")
        if self.f_number == 0.0 or self.focus_distance <= CAMERA.focal_length:
            raise ValueError(
                f"camera f_number {self.f_number} must be positive, and focus_distance "
                f"{self.focus_distance} m more than the focal length"
            )
        if self.vignetting is not None and self.vignetting >= 1.0:
            raise ValueError(f"camera vignetting must be below 1, got {self.vignetting}")
        if self.latency < 0.5 * self.exposure:
            raise ValueError(
                f"camera latency {self.latency} s ends before the exposure of {self.exposure} s"
            )


IDEAL_CAMERA = CameraRealism()
"""A pair of pinholes as drawn, seen at once."""

DEFAULT_CAMERA = CameraRealism(
    exposure=CAMERA.field_time,
    latency=CAMERA.use_time,
    gain_error=CAMERA_CALIBRATION.gain,
    vignetting=0.0,
    f_number=LENS.f_number,
    focal_error=CAMERA_CALIBRATION.focal,
    principal_error=CAMERA_CALIBRATION.principal,
    head_turn=CAMERA_CALIBRATION.head_turn,
    head_shift=CAMERA_CALIBRATION.head_shift,
    eye_turn=CAMERA_CALIBRATION.eye_turn,
    eye_shift=CAMERA_CALIBRATION.eye_shift,
)
"""The thesis' cameras in daylight, well calibrated."""

HARSH_CAMERA = CameraRealism(
    exposure=CAMERA.frame_time,
    latency=CAMERA.slow_use_time,
    gain_error=POOR_CAMERA_CALIBRATION.gain,
    vignetting=LENS.wide_falloff,
    f_number=LENS.wide_f_number,
    focal_error=POOR_CAMERA_CALIBRATION.focal,
    principal_error=POOR_CAMERA_CALIBRATION.principal,
    head_turn=POOR_CAMERA_CALIBRATION.head_turn,
    head_shift=POOR_CAMERA_CALIBRATION.head_shift,
    eye_turn=POOR_CAMERA_CALIBRATION.eye_turn,
    eye_shift=POOR_CAMERA_CALIBRATION.eye_shift,
)
"""Little light, so both fields exposed through a wide aperture; slow, and poorly calibrated."""

RealismName = Literal["ideal", "default", "harsh"]
"""How far robots, their sensors and cameras are from their drawings; `twin.realism.REALISMS`."""
CAMERA_SETS: Mapping[RealismName, CameraRealism] = MappingProxyType(
    {"ideal": IDEAL_CAMERA, "default": DEFAULT_CAMERA, "harsh": HARSH_CAMERA}
)
"""Sets by name."""


class MadeHead(NamedTuple):
    """Errors of one stereo head.

    Attributes:
        focal: Factor of both focal lengths, of both eyes.
        principal: Offset (column, row) of the optical axes in the images [px].
        gain: Factor of the light.
        head: Pose of the head as made in the frame that it has as drawn; axes of the left camera,
            origin between the eyes.
        eyes: Poses of the left and the right camera as made in their frames as drawn.
    """

    focal: float
    principal: tuple[float, float]
    gain: float
    head: RigidTransform
    eyes: tuple[RigidTransform, RigidTransform]

    @classmethod
    def draw(cls, realism: CameraRealism, rng: np.random.Generator) -> "MadeHead":
        """Return the errors of a head.

        Args:
            realism: Standard deviations of the errors.
            rng: Random generator of the head's making.
        """
        # One draw whatever the sizes: heads of one seed differ by their sizes only.
        focal, column, row, gain, *poses = rng.standard_normal(22).tolist()
        head, left, right = np.array(poses).reshape(3, 6)
        turn, shift = realism.eye_turn, realism.eye_shift
        return cls(
            1.0 + realism.focal_error * focal,
            (realism.principal_error * column, realism.principal_error * row),
            math.exp(realism.gain_error * gain),
            _error(head, realism.head_turn, realism.head_shift),
            (_error(left, turn, shift), _error(right, turn, shift)),
        )

    def lens(self, drawn: Pinhole) -> Pinhole:
        """Return the intrinsics as made of a camera as drawn."""
        return dataclasses.replace(
            drawn,
            fx=drawn.fx * self.focal,
            fy=drawn.fy * self.focal,
            cx=drawn.cx + self.principal[0],
            cy=drawn.cy + self.principal[1],
        )

    def poses(
        self, drawn: tuple[RigidTransform, RigidTransform]
    ) -> tuple[RigidTransform, RigidTransform]:
        """Return the poses as made of the left and the right camera as drawn, in any frame."""
        middle = RigidTransform.from_components(
            0.5 * (drawn[0].translation + drawn[1].translation), drawn[0].rotation
        )
        moved = middle * self.head * middle.inv()
        left, right = (moved * pose * eye for pose, eye in zip(drawn, self.eyes, strict=True))
        return left, right


def _error(normal: Any, turn: float, shift: float) -> RigidTransform:
    """Return a small motion by (6,) numbers of a standard normal distribution."""
    return RigidTransform.from_exp_coords(np.concatenate([turn * normal[:3], shift * normal[3:]]))
