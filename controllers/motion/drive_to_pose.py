"""Drive a rover to a pose: turn, drive straight and turn again, by dead reckoning.

A goal close beside the rover would take a quarter turn to either side, in which skidding wheels on
rocks lose more than the distance to it. The rover backs off first then, and comes forward along
the goal's heading.
"""

import dataclasses
import enum
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from controllers.motion.driving import SkidSteer
from controllers.motion.reckoned_drive import ReckonedDrive, course_along, turning_rate, wrapped
from perception.geometry.arrays import FloatArray
from twin.robot import Observation

_CLOSE = 0.1  # Distance below which the direction to the goal is undetermined [m].


@dataclasses.dataclass(frozen=True)
class DriveToPoseConfig:
    """Limits and tolerances of a drive to a pose.

    Attributes:
        speed: Largest speed [m/s].
        turn: Largest turning rate [rad/s].
        slowing: Speed over the remaining distance, and turning rate over the remaining angle [1/s].
        near: Remaining distance [m] and angle [rad] at which a phase ends.
        back_off: Distance behind the goal to which the rover may back off first [m].
        period: Servo tick [s].
    """

    speed: float = 0.08
    turn: float = 0.3
    slowing: float = 1.5
    near: tuple[float, float] = (0.005, 0.01)
    back_off: float = 0.35
    period: float = 0.01


class _Phase(enum.Enum):
    FACE = "face"
    DRIVE = "drive"
    ALIGN = "align"
    DONE = "done"


class DriveToPose(ReckonedDrive):
    """Drives one rover to a pose, with its arm held where it was.

    Args:
        steer: Wheels of the rover.
        goal: (3,) x (to the right), y (ahead) [m] and yaw to the left [rad], from where the rover
            is now.
        config: Limits and tolerances; None for the default.
        free: Predicate of whether the rover may back off to a pose (3,), given as the goal is.

    Attributes:
        odometry: Dead reckoning since the drive began.

    Raises:
        ValueError: If the goal is not finite.
    """

    def __init__(
        self,
        steer: SkidSteer,
        goal: ArrayLike,
        config: DriveToPoseConfig | None = None,
        free: Callable[[FloatArray], bool] = lambda place: True,
    ) -> None:
        end = np.asarray(goal, dtype=float)
        if not np.all(np.isfinite(end)) or end.shape != (3,):
            raise ValueError(f"goal {goal}: expected three finite numbers")
        self._config = config or DriveToPoseConfig()
        super().__init__(steer, self._config.period)
        self._goals = [end]
        behind = end.copy()
        behind[:2] -= self._config.back_off * np.array([-math.sin(end[2]), math.cos(end[2])])
        if _turns(behind) < 0.5 * _turns(end) and free(behind):
            self._goals = [behind, end]
        self._begin()

    def _begin(self) -> None:
        """Face the next goal."""
        x, y, self._yaw = (float(value) for value in self._goals.pop(0))
        self._goal = np.array([x, y])
        path = self._goal - self.odometry.place
        self._course, self._sign = _facing(path, self.odometry.yaw)
        close = np.linalg.norm(path) <= self._config.near[0]
        self._phase = _Phase.ALIGN if close else _Phase.FACE

    @property
    def done(self) -> bool:
        """Whether the rover has arrived, by its dead reckoning."""
        return self._phase is _Phase.DONE

    def _motion(self, seen: Observation) -> tuple[float, float]:
        """Return speed [m/s] and turning rate [rad/s]; a phase that has ended gives the next."""
        config = self._config
        if self._phase is _Phase.FACE:
            left = wrapped(self._course - self.odometry.yaw)
            if abs(left) > config.near[1]:
                return 0.0, self._turning(left)
            self._phase = _Phase.DRIVE
        if self._phase is _Phase.DRIVE:
            yaw = self.odometry.yaw
            ahead = np.array([-math.sin(yaw), math.cos(yaw)])
            path = self._goal - self.odometry.place
            left = float(path @ ahead)
            if self._sign * left > config.near[0]:
                speed = min(max(config.slowing * left, -config.speed), config.speed)
                course = self._course
                if np.linalg.norm(path) > _CLOSE:
                    course = course_along(path)
                    if self._sign < 0.0:
                        course = wrapped(course + math.pi)
                return speed, self._turning(wrapped(course - yaw))
            self._phase = _Phase.ALIGN
        if self._phase is _Phase.ALIGN:
            left = wrapped(self._yaw - self.odometry.yaw)
            if abs(left) > config.near[1]:
                return 0.0, self._turning(left)
            if self._goals:
                self._begin()
            else:
                self._phase = _Phase.DONE
        return 0.0, 0.0

    def _turning(self, left: float) -> float:
        """Return the turning rate [rad/s] to the left for a remaining angle [rad]."""
        return turning_rate(left, self._config.slowing, self._config.turn)


def _facing(path: FloatArray, yaw: float) -> tuple[float, float]:
    """Return the yaw [rad] in which a rover drives along (2,) [m], and 1 for forward, else -1.

    Backwards where that is the smaller turn from the yaw that it has.
    """
    ahead = course_along(path)
    if abs(wrapped(ahead - yaw)) <= math.pi / 2.0:
        return ahead, 1.0
    return wrapped(ahead + math.pi), -1.0


def _turns(goal: FloatArray) -> float:
    """Return the angle [rad] of the turns before and after a straight drive to a goal (3,)."""
    course, _ = _facing(goal[:2], 0.0)
    return abs(course) + abs(wrapped(goal[2] - course))
