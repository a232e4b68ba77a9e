"""A rover that goes to a pose: it turns, drives straight, and turns again, by dead reckoning."""

from __future__ import annotations

import dataclasses
import enum
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.motion.driving import Odometry, SkidSteer
from twin.robot import ArmMode, Command, Observation, WheelMode

FloatArray = NDArray[np.float64]
_CLOSE = 0.1  # Nearer, the direction to the goal says nothing [m].
_LEAST_TURN = 0.05  # Slower turns stall in friction [rad/s].


@dataclasses.dataclass(frozen=True)
class GoingConfig:
    """How a rover goes.

    Attributes:
        speed: At most [m/s].
        turn: At most [rad/s].
        slowing: Speed over what is left of the way or turn [1/s].
        near: Left of the way [m] and of the turn [rad] that will do.
        period: Servo tick [s].
    """

    speed: float = 0.08
    turn: float = 0.3
    slowing: float = 1.5
    near: tuple[float, float] = (0.005, 0.01)
    period: float = 0.01


class _Phase(enum.Enum):
    FACE = "face"
    DRIVE = "drive"
    ALIGN = "align"
    DONE = "done"


class Going:
    """Drives one rover to a pose.

    Attributes:
        odometry: Where it is by dead reckoning, from where it began.
    """

    def __init__(
        self, steer: SkidSteer, goal: ArrayLike, config: GoingConfig | None = None
    ) -> None:
        """Begin.

        Args:
            steer: The wheels.
            goal: (3,) x (to the right), y (ahead) [m] and yaw to the left [rad], from where the
                rover is now.
            config: How it goes.

        Raises:
            ValueError: If the goal is not finite.
        """
        x, y, self._yaw = (float(value) for value in np.asarray(goal, dtype=float))
        if not math.isfinite(x + y + self._yaw):
            raise ValueError(f"goal {goal}: expected three finite numbers")
        self.odometry = Odometry(steer)
        self._steer, self._config = steer, config or GoingConfig()
        self._goal = np.array([x, y])
        self._held: FloatArray | None = None
        self._phase = _Phase.FACE
        ahead = math.atan2(-x, y)
        # Backwards where that is the smaller turn.
        self._sign = 1.0 if abs(ahead) <= math.pi / 2.0 else -1.0
        self._course = ahead if self._sign > 0.0 else _wrapped(ahead + math.pi)
        if math.hypot(x, y) <= self._config.near[0]:
            self._phase = _Phase.ALIGN

    @property
    def done(self) -> bool:
        """Whether it is there, as far as it knows."""
        return self._phase is _Phase.DONE

    def step(self, seen: Observation) -> Command:
        """Take what was measured and return the next command; the arm is held where it was.

        Args:
            seen: Of the rover.
        """
        if self._held is None:
            if not seen.arm_angles.usable:
                return Command()
            self._held = np.array(seen.arm_angles.value, dtype=float)
        self.odometry.update(seen, self._config.period)
        forward, turn = self._motion()
        wheels = self._steer.wheel_speeds(forward, turn)
        return Command(wheels, self._held, WheelMode.SPEED, ArmMode.POSITION, np.zeros(4))

    def _motion(self) -> tuple[float, float]:
        """Return speed [m/s] and turning rate [rad/s], and go on to the next phase in time."""
        config = self._config
        if self._phase is _Phase.FACE:
            left = _wrapped(self._course - self.odometry.yaw)
            if abs(left) > config.near[1]:
                return 0.0, self._turning(left)
            self._phase = _Phase.DRIVE
        if self._phase is _Phase.DRIVE:
            yaw = self.odometry.yaw
            ahead = np.array([-math.sin(yaw), math.cos(yaw)])
            way = self._goal - self.odometry.place
            left = float(way @ ahead)
            if self._sign * left > config.near[0]:
                speed = min(max(config.slowing * left, -config.speed), config.speed)
                course = self._course
                if np.linalg.norm(way) > _CLOSE:
                    course = math.atan2(-way[0], way[1])
                    if self._sign < 0.0:
                        course = _wrapped(course + math.pi)
                return speed, self._turning(_wrapped(course - yaw))
            self._phase = _Phase.ALIGN
        if self._phase is _Phase.ALIGN:
            left = _wrapped(self._yaw - self.odometry.yaw)
            if abs(left) > config.near[1]:
                return 0.0, self._turning(left)
            self._phase = _Phase.DONE
        return 0.0, 0.0

    def _turning(self, left: float) -> float:
        """Return the rate [rad/s] of a turn of which some is left [rad], to the left."""
        rate = self._config.slowing * left
        size = min(max(abs(rate), _LEAST_TURN), self._config.turn)
        return math.copysign(size, left)


def _wrapped(angle: float) -> float:
    """Return an angle within half a turn [rad]."""
    return math.remainder(angle, 2.0 * math.pi)
