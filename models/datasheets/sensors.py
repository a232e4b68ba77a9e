"""Cameras, inclinometers, the force/torque sensor, and the errors of all but the cameras."""

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
    field_time: float = 1.001 / 60.0  # Exposure [s]. Table D-2: EIA RS-170, no electronic shutter
    frame_time: float = 1.001 / 30.0  # Read-out of both fields [s] (EIA RS-170)
    use_time: float = 0.25  # Exposure to use [s]. Our slowest use, block matching, takes 0.19 s of
    # a core, half a field and the read-out 0.04 s; thesis 5.3: a visual loop of 3 to 4 Hz
    slow_use_time: float = 0.35  # The same by thesis 5.3: 0.3 s for the markers on its computer

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
class LensSheet:
    """The 8.5 mm C-mount lens before each camera."""

    f_number: float = 8.0  # Assumption: stopped down, as a camera without shutter is in daylight
    wide_f_number: float = 4.0  # Assumption: two stops more, indoors
    wide_falloff: float = 0.2  # Assumption: light that the barrel takes from the corners there

    @property
    def focus_distance(self) -> float:
        """Hyperfocal distance at `f_number` for blur of one pixel [m]: sharp from its half on."""
        pixel = CAMERA.sensing_width / CAMERA.width
        return CAMERA.focal_length**2 / (self.f_number * pixel) + CAMERA.focal_length


@dataclasses.dataclass(frozen=True)
class CameraCalibrationSheet:
    """What calibration leaves unknown of a stereo head: standard deviations along each axis.

    Intrinsics: the example of the Camera Calibration Toolbox for Matlab (20 images of 640 x 480 px)
    states 0.40 px of 658 px for the focal length and 0.82 px for the principal point, as three
    deviations. Hand-eye: 0.93 mm and 0.265 deg over three axes (arXiv 2311.01335). Between the
    eyes: a good calibration at this resolution leaves 0.28 px between rows, noise of the corners
    included (OpenCV forum, 640 x 480 px); the turn here leaves 0.15 px in the mean, the shift is
    an assumption. What a calibration calls poor: intrinsics of a camera of 512 x 424 px by the same
    toolbox (1.57 px of 364 px, 2.29 px), hand-eye residuals of 0.76 deg and 3.2 mm (Zivid's support
    pages), twice the error between the eyes (assumption).
    """

    focal: float = 2.0e-4  # Relative
    principal: float = 0.27  # [px]
    head_turn: float = 0.153 * DEGREE  # [rad]
    head_shift: float = 0.54e-3  # [m]
    eye_turn: float = 0.15e-3  # [rad]
    eye_shift: float = 0.05e-3  # [m]
    gain: float = 0.1  # Relative. Assumption: the automatic gain control's own error


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
    full_scale: tuple[float, float, float, float, float, float] = (100, 100, 200, 5, 5, 5)
    """Ranges of forces [N] and moments [N m] (a JR3's, default of the ROS driver rosjr3)."""


@dataclasses.dataclass(frozen=True)
class SensorErrorSheet:
    """How far one robot's sensors lie from their calibration, at most and to either side.

    Every error is drawn once a robot, uniformly and each component by itself. A share is of the
    value itself unless a range is named.
    """

    encoder_zero: float = 0.3 * DEGREE  # Assumption: a homing jig good to 1 mm at 0.2 m [rad]
    tachometer_scale: float = 0.01  # Share. Assumption: 20 K at 0.02 %/K, and its own calibration
    potentiometer_zero: float = 0.5 * DEGREE  # Assumption: zeroed on a floor, by eye [rad]
    potentiometer_scale: float = 0.01  # Share. Assumption: 1 %, usual linearity of the type
    # 48 simulated calibrations after Thesis app. D (`appd-calibration`) miss the zero voltage by
    # 0.03 % and the slope by 0.41 % in the median, so by twice that at most if uniform.
    inclinometer_zero: float = 2 * 3e-4 * 2.4 / 34e-3 * DEGREE  # 2.4 V, 34 mV/deg [rad]
    inclinometer_scale: float = 2 * 0.0041  # Share
    inclinometer_cross: float = 0.04  # Share of the other axis (largest of a VTI/Murata SCA100T)
    wrench_zero: float = 0.005  # Share of full scale. Assumption: zeroed at another temperature
    wrench_drift: float = 0.005  # Share of full scale, once warm. Assumption: 10 K at 0.05 %/K
    wrench_warm_up: float = 600.0  # Assumption: time constant of sensor and electronics [s]
    wrench_scale: float = 0.01  # Share. Assumption: 1 %, the usual accuracy of six-axis sensors
    # Share of full scale that a full load along another axis shows. Assumption: 1 %, as the scale.
    wrench_cross: float = 0.01
    gyro_bias: float = 0.3 * DEGREE  # Assumption: zeroed at rest, then 10 K at 0.03 deg/s/K [rad/s]
    gyro_scale: float = 0.01  # Share. Assumption: small MEMS unit
    accelerometer_bias: float = 0.2  # Assumption: small MEMS unit, 10 K at 2 mg/K [m/s^2]
    accelerometer_scale: float = 0.01  # Share. Assumption: small MEMS unit


CAMERA: Final = CameraSheet()
LENS: Final = LensSheet()
CAMERA_CALIBRATION: Final = CameraCalibrationSheet()
POOR_CAMERA_CALIBRATION: Final = CameraCalibrationSheet(
    focal=1.4e-3,
    principal=0.76,
    head_turn=0.44 * DEGREE,
    head_shift=1.8e-3,
    eye_turn=0.3e-3,
    eye_shift=0.1e-3,
    gain=0.25,
)
INCLINOMETER: Final = InclinometerSheet()
FORCE_TORQUE: Final = ForceTorqueSheet()
SENSOR_ERRORS: Final = SensorErrorSheet()
HARSH_SENSOR_ERRORS: Final = SensorErrorSheet(
    # Assumption: cold mornings, hot noons and a year since the calibration: twice the usual errors,
    # and an inclinometer off by its noise.
    encoder_zero=0.6 * DEGREE,
    tachometer_scale=0.02,
    potentiometer_zero=1.0 * DEGREE,
    potentiometer_scale=0.02,
    inclinometer_zero=0.05 * DEGREE,
    inclinometer_scale=0.02,
    inclinometer_cross=0.08,
    wrench_zero=0.01,
    wrench_drift=0.01,
    wrench_scale=0.02,
    wrench_cross=0.02,
    gyro_bias=0.6 * DEGREE,
    gyro_scale=0.02,
    accelerometer_bias=0.4,
    accelerometer_scale=0.02,
)
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
