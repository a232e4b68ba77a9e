"""Cameras, inclinometers and the force/torque sensor."""

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from models.datasheets.units import DEGREE
from perception.geometry.pinhole import Pinhole


@dataclasses.dataclass(frozen=True)
class CameraSheet:
    """One camera of the stereo pair (Thesis Table D-2).

    The thesis contradicts itself: its text says a 1/3" sensor of 510 x 494 pixels of 9.6 x 7.5 um,
    its table a 1/2" one of 510 x 492 pixels and 6.4 x 4.8 mm. With the 8.5 mm lens the table's
    sensing area gives a field of view of 41.3 deg, the text's pixels 32.1 deg; it states 41.2 deg.
    So the table holds here, and the pixel pitch is the sensing area over the pixels
    (12.55 x 9.76 um; the table's 12.7 x 9.8 um would give 41.7 deg).
    """

    width: int = 510
    height: int = 492
    sensing_width: float = 6.4e-3
    sensing_height: float = 4.8e-3
    focal_length: float = 8.5e-3
    baseline: float = 0.038  # Spacing of the stereo pair [m]. Assumption: housings side by side
    mass: float = 0.120  # Table D-2: 120 g
    housing: tuple[float, float, float] = (30.5e-3, 30.5e-3, 61e-3)  # Table D-2
    signal_to_noise_db: float = 46.0  # Table D-2: more than 46 dB
    gamma: float = 0.45  # Table D-2

    @property
    def pinhole(self) -> Pinhole:
        """Intrinsics; the optical axis goes through the middle of the image."""
        return Pinhole(
            self.width,
            self.height,
            self.focal_length * self.width / self.sensing_width,
            self.focal_length * self.height / self.sensing_height,
            (self.width - 1) / 2.0,
            (self.height - 1) / 2.0,
        )

    @property
    def field_of_view(self) -> tuple[float, float]:
        """Horizontal and vertical field of view [rad]."""
        return (
            2.0 * math.atan(self.sensing_width / (2.0 * self.focal_length)),
            2.0 * math.atan(self.sensing_height / (2.0 * self.focal_length)),
        )


@dataclasses.dataclass(frozen=True)
class InclinometerSheet:
    """Crossbow CXTA02 two-axis tilt sensor: micro-machined masses, deflected by specific force."""

    bandwidth: float = 6.0  # -3 dB frequency [Hz] (maker)
    noise: float = 0.05 * DEGREE  # r.m.s. [rad] (maker)
    linear_range: float = 20.0 * DEGREE  # Thesis app. D: +-20 deg; of apparent tilt, before filter


@dataclasses.dataclass(frozen=True)
class InclinometerCalibration:
    """Calibration of one inclinometer axis (Thesis eq. D-1, Table D-1).

    Attributes:
        zero_voltage: Output at zero angle [V].
        sensitivity: Slope [V/deg]; eq. D-1 needs it as V/rad, so times 180/pi.
    """

    zero_voltage: float
    sensitivity: float

    def angle(self, voltage: float) -> float:
        """Return the angle [rad] that an output voltage [V] means (Thesis eq. D-1)."""
        return (voltage - self.zero_voltage) / self.sensitivity * DEGREE


@dataclasses.dataclass(frozen=True)
class ForceTorqueSheet:
    """JR3 67M25A six-axis sensor under the arm."""

    force_noise: float = 0.1  # Assumption: r.m.s., about 1/1000 of the range [N]
    torque_noise: float = 0.01  # Assumption: r.m.s., about 1/1000 of the range [N m]


CAMERA: Final = CameraSheet()
INCLINOMETER: Final = InclinometerSheet()
FORCE_TORQUE: Final = ForceTorqueSheet()
INCLINOMETER_CALIBRATION: Final[Mapping[str, Mapping[str, InclinometerCalibration]]] = (
    MappingProxyType(
        {
            "robot1": MappingProxyType(
                {
                    "roll": InclinometerCalibration(2.406, 33.631e-3),
                    "pitch": InclinometerCalibration(2.381, 34.733e-3),
                }
            ),
            "robot2": MappingProxyType(
                {
                    "roll": InclinometerCalibration(2.447, 29.338e-3),
                    "pitch": InclinometerCalibration(2.392, 34.905e-3),
                }
            ),
        }
    )
)
"""Thesis Table D-1, by robot and axis."""
