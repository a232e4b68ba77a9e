"""Motion of an arm to a posture, and whether a stereo pair was taken there at rest.

With a guard, a move that may tip the rover over, at the tilt that it has as it begins, is slowed as
a whole, cut short, or not made (`tipping.tip_guard`).
"""

import dataclasses
import math

import numpy as np

from controllers.motion.base_motion import level_of
from controllers.motion.tipping.tip_guard import TipGuard
from controllers.motion.tipping.tip_over import SteadySweep, Sweep
from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation, WheelMode


@dataclasses.dataclass
class ArmMove:
    """A straight path in joint space, the wheels at rest.

    Attributes:
        goal: (joints,) where it ends [rad].
        speed: Speed of the fastest joint [rad/s].
        rest: Time at the goal before a pair counts [s].
        near: Greatest joint error at which the arm counts as there [rad].
        patience: Longest time at a goal that is not reached [s].
        wheel_mode: Mode in which the wheels rest: zero speed, or zero voltage (duty).
        guard: Guard of the rover against tipping over; None for a move without one.
    """

    goal: FloatArray
    speed: float = 0.8
    rest: float = 0.6
    near: float = 0.05
    patience: float = 4.0
    wheel_mode: WheelMode = WheelMode.SPEED
    guard: TipGuard | None = None
    _sweep: Sweep | None = dataclasses.field(default=None, init=False)
    _begun: float = dataclasses.field(default=math.nan, init=False)
    _there: float = dataclasses.field(default=math.nan, init=False)

    def command(self, seen: Observation) -> Command:
        """Return the command of this tick; nothing moves before the arm's angles are known.

        Args:
            seen: Observation of the robot.
        """
        if self._sweep is None:
            if not seen.arm_angles.usable:
                return Command()
            self._sweep, self._begun = self._allowed(seen), seen.time
        sweep = self._sweep
        distance = sweep.part * (sweep.end - sweep.start)
        part = min(1.0, (seen.time - self._begun) / sweep.duration)
        rates = distance / sweep.duration if part < 1.0 else np.zeros_like(distance)
        place = sweep.start + part * distance
        return Command(np.zeros(4), place, self.wheel_mode, ArmMode.POSITION, rates)

    def is_there(self, seen: Observation) -> bool:
        """Return whether the arm has been at its goal for the time of rest.

        Args:
            seen: Observation of the robot.
        """
        if self._sweep is None or not seen.arm_angles.usable:
            return False
        arrived = self._begun + self._sweep.duration
        error = float(np.abs(np.asarray(seen.arm_angles.value, dtype=float) - self.goal).max())
        if seen.time < arrived or (error > self.near and seen.time < arrived + self.patience):
            self._there = math.nan
            return False
        if math.isnan(self._there):
            self._there = seen.time
        return seen.time >= self._there + self.rest

    def sees(self, seen: Observation) -> bool:
        """Return whether the latest stereo pair was taken at the goal, at rest.

        Args:
            seen: Observation of the robot.
        """
        stereo = seen.stereo
        return self.is_there(seen) and stereo.usable and stereo.stamp >= self._there + self.rest

    def _allowed(self, seen: Observation) -> Sweep:
        """Return the move from where the arm is, as the guard allows it."""
        start = np.array(seen.arm_angles.value, dtype=float)
        duration = max(float(np.abs(self.goal - start).max()) / self.speed, 1e-9)
        asked = SteadySweep(start, self.goal, duration)
        if self.guard is None:
            return asked
        allowed = self.guard.allowed(asked, level_of(seen)).sweep
        return allowed or dataclasses.replace(asked, part=0.0)
