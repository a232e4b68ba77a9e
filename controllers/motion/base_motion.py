"""Motion of the base by gyro, accelerometer and inclinometer.

What is fed forward of it (thesis eq. A-4) shakes the base in turn, a servo tick later: as measured
it is a delayed positive feedback, which grows on a base stiffer than soft. A first-order lag breaks
that loop; the longer it is, the less of a soft base's swing it still follows.
"""

import dataclasses
import math

import numpy as np

from controllers.kinematics.rigid_motion import LEVEL, FrameMotion, at_rest
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from twin.robot import Observation


@dataclasses.dataclass(frozen=True)
class BaseFilterConfig:
    """Filter from measured base motion to what is fed forward.

    Attributes:
        lag: Time constant of the first-order lag [s]; 0 for none.
        period: Servo tick [s].
    """

    lag: float = 0.015
    period: float = 0.01

    def __post_init__(self) -> None:
        """Refuse times that are none.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        check_numbers("base filter", self, "lag", zero=True)
        check_numbers("base filter", self, "period")


class BaseMotionFilter:
    """Turns observations into the base's motion, lagged.

    Args:
        config: Lag and tick.
    """

    def __init__(self, config: BaseFilterConfig) -> None:
        self._config = config
        self._keep = math.exp(-config.period / config.lag) if config.lag > 0.0 else 0.0
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._gyro: FloatArray | None = None
        self._shaped = np.zeros(6)

    def update(self, observation: Observation) -> FrameMotion | None:
        """Take a tick's samples.

        Gravity comes from the inclinometer at once, and what the accelerometer reads beyond it
        through the lag, so that a slow tilt is never counted twice nor late.

        Args:
            observation: Observation with accelerometer and gyro usable; else the state is reset.

        Returns:
            The base's motion at the accelerometer, in the body frame; None without sensors or
            before two samples.
        """
        if not (observation.accelerometer.usable and observation.gyro.usable):
            self.reset()
            return None
        gyro = np.asarray(observation.gyro.value, dtype=float)
        before, self._gyro = self._gyro, gyro
        if before is None:
            return None
        rest = level_of(observation).specific_force
        force = np.asarray(observation.accelerometer.value, dtype=float)
        measured = np.concatenate([force - rest, (gyro - before) / self._config.period])
        self._shaped = self._keep * self._shaped + (1.0 - self._keep) * measured
        return FrameMotion(rest + self._shaped[:3], gyro, self._shaped[3:])


def level_of(observation: Observation) -> FrameMotion:
    """Return the motion of a base at rest by its inclinometer; level without one.

    Args:
        observation: Observation of the robot, with its inclinometer.
    """
    if not observation.inclinometer.usable:
        return LEVEL
    pitch, roll = (float(angle) for angle in observation.inclinometer.value)
    # World's up seen from the body, R = Rz(yaw) Rx(pitch) Ry(roll).
    return at_rest([-np.sin(roll) * np.cos(pitch), np.sin(pitch), np.cos(roll) * np.cos(pitch)])
