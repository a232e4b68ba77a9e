"""What all drives by dead reckoning share: the odometry, the arm held, and the rate of a turn."""

import math

import numpy as np
from numpy.typing import ArrayLike

from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation, WheelMode

_LEAST_TURN = 0.05  # Turning rate below which friction stalls the rover [rad/s].


class ReckonedDrive:
    """Drives one rover by its dead reckoning; subclasses choose its motion.

    Args:
        steer: Wheels of the rover.
        period: Servo tick [s].

    Attributes:
        odometry: Dead reckoning since the drive began.
    """

    def __init__(self, steer: SkidSteer, period: float) -> None:
        self.odometry = Odometry(steer)
        self._steer, self._period = steer, period
        self._held: FloatArray | None = None

    def step(self, seen: Observation) -> Command:
        """Take what was measured and return the next command; the arm is held where it was.

        Where the arm moves meanwhile, the wheels' part joins the command of its motion:
        ``dataclasses.replace(move.command(seen), wheels=drive.step(seen).wheels)``.

        Args:
            seen: Observation of the rover; nothing moves before the arm's angles are known.
        """
        if self._held is None:
            if not seen.arm_angles.usable:
                return Command()
            self._held = np.array(seen.arm_angles.value, dtype=float)
        self.odometry.update(seen, self._period)
        wheels = self._wheels(*self._motion(seen))
        return Command(wheels, self._held, WheelMode.SPEED, ArmMode.POSITION, np.zeros(4))

    def _wheels(self, speed: float, turn: float) -> FloatArray:
        """Return (4,) wheel speeds of a motion, which make up for sliding ahead or back [rad/s]."""
        _, slides = self._steer.sliding(turn, self.odometry.tilt)
        return self._steer.wheel_speeds(speed - slides, turn)

    def _motion(self, seen: Observation) -> tuple[float, float]:
        """Return the next speed [m/s] and turning rate to the left [rad/s]."""
        raise NotImplementedError


def turning_rate(left: float, slowing: float, fastest: float) -> float:
    """Return the rate of a turn in place for the angle that is left of it [rad/s].

    Args:
        left: Remaining angle, positive to the left [rad].
        slowing: Turning rate over the remaining angle [1/s].
        fastest: Largest turning rate [rad/s].
    """
    return math.copysign(min(max(abs(slowing * left), _LEAST_TURN), fastest), left)


def course_along(path: ArrayLike) -> float:
    """Return the yaw [rad] of a rover that faces along a direction (2,) x, y."""
    x, y = np.asarray(path, dtype=float).tolist()
    return math.atan2(-x, y)


def wrapped(angle: float) -> float:
    """Return an angle within half a turn [rad]."""
    return math.remainder(angle, 2.0 * math.pi)
