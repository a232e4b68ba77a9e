"""Motion of the base by gyro, accelerometer and inclinometer.

What is fed forward of it (thesis eq. A-4) shakes the base in turn, a servo tick later: as measured
it is a delayed positive feedback, which grows on a base stiffer than soft. A first-order lag breaks
that loop; the longer it is, the less of a soft base's swing it still follows.
"""

import math

import numpy as np

from controllers.kinematics.rigid_motion import LEVEL, FrameMotion, at_rest
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

LAG = 0.015
"""Time constant of the lag by default [s]."""


class BaseMotionFilter:
    """Turns observations into the base's motion, with a first-order lag.

    Args:
        lag: Time constant of the lag [s]; 0 for none.
        period: Servo tick [s].

    Raises:
        ValueError: Naming the time and what is valid.
    """

    def __init__(self, lag: float = LAG, period: float = 0.01) -> None:
        if not (0.0 <= lag < math.inf and 0.0 < period < math.inf):
            raise ValueError(f"base filter: lag {lag} s, period {period} s, needs positive times")
        self._period = period
        self._keep = math.exp(-period / lag) if lag > 0.0 else 0.0
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
        measured = np.concatenate([force - rest, (gyro - before) / self._period])
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
