"""A swing of the arm from rest to rest that a guard against tipping over slows (Thesis A.3).

The guard plans the swing slower as a whole before it begins, by the zero-moment point
(`tip_over.guard`) or by how likely it is to tip the rover over (`look_ahead.slow`), slows it tick
by tick while it runs (`online_guard.OnlineGuard`), or is absent, for comparison.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from controllers.motion.arm_control import ArmControlConfig, ArmController, Reference
from controllers.motion.base_motion import level_of
from controllers.motion.tipping.look_ahead import LookAhead, slow
from controllers.motion.tipping.online_guard import OnlineGuard
from controllers.motion.tipping.tip_over import Footing, Guarded, Sweep, guard
from perception.geometry.checks import check_choice
from twin.robot import Command, Observation

GUARDS = ("unguarded", "planned", "ahead", "online")
"""As requested; slowed as a whole before it begins, by the zero-moment point or by looking ahead;
slowed tick by tick."""
HELD, PATIENCE = 1.0, 10.0
"""Longest rest of a swing online, and its greatest delay, until it counts as over [s]."""


@dataclasses.dataclass(frozen=True)
class GuardedSwingConfig:
    """One swing and its guard.

    Attributes:
        arm: Control of the arm along the swing.
        footing: Model of the rover that the guard uses.
        sweep: Requested swing.
        guard: Kind of guard, one of `GUARDS`.
        wait: Rest in the initial pose before the swing [s].
        ahead: Looks ahead for the rover, for the guard of that name.
        seed: Random seed of its copies.
    """

    arm: ArmControlConfig
    footing: Footing
    sweep: Sweep
    guard: str = "online"
    wait: float = 0.5
    ahead: LookAhead | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse an unknown guard.

        Raises:
            ValueError: Naming it and the valid ones, or what the guard lacks.
        """
        check_choice("guard", self.guard, GUARDS)
        if self.guard == "ahead" and self.ahead is None:
            raise ValueError("guard 'ahead' needs what looks ahead for the rover")


class GuardedSwing:
    """Swings the arm of one robot, guarded against tipping over.

    Attributes:
        online: The guard that slows tick by tick; None for another.

    Args:
        config: The swing.
    """

    def __init__(self, config: GuardedSwingConfig) -> None:
        self._config, self._asked = config, config.sweep
        self.reset()

    def reset(self) -> None:
        """Start again from the initial pose."""
        config = self._config
        self.online = (
            OnlineGuard(config.footing, self._asked.at) if config.guard == "online" else None
        )
        self._planned = Guarded(self._asked, 1.0, math.nan, "")
        self._sweep, self._ticks = self._asked, 0
        self._arm = ArmController(config.arm, lambda time: self.at(time - config.wait))

    def plan(self, seen: Observation) -> None:
        """Let a guard that plans ahead examine the swing, before the first step.

        Args:
            seen: The robot at rest in the initial pose.
        """
        config, still = self._config, level_of(seen)
        match config.guard:
            case "planned":
                self._planned = guard(config.footing, self._asked, still)
            case "ahead":
                assert config.ahead is not None
                rng = np.random.default_rng(config.seed)
                self._planned = slow(config.ahead, self._asked, rng, still)
            case _:
                return
        start = self._asked.start
        self._sweep = self._planned.sweep or Sweep(start, start, self._asked.duration)

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Advance the online guard by the tick, and command the arm along the reference."""
        seen = observations[self._config.arm.robot]
        if self.online is not None and self.time > -0.5 * self._config.arm.period:
            self.online.step(level_of(seen) if seen.inclinometer.usable else None)
        self._ticks += 1
        return self._arm.step(observations)

    @property
    def time(self) -> float:
        """Time of the next tick since the beginning of the swing [s]."""
        return self._ticks * self._config.arm.period - self._config.wait

    def at(self, time: float) -> Reference:
        """Return the reference at a time since the beginning of the swing [s]."""
        if self.online is not None and time > -0.5 * self._config.arm.period:
            return Reference(*self.online.at(time))
        return Reference(*self._sweep.at(time))

    def over(self, time: float) -> bool:
        """Return whether the swing has ended at a time since its beginning [s]."""
        if self.online is None:
            return time >= self._sweep.duration
        done = self.online.time >= self._asked.duration
        return done or self.online.held >= HELD or self.online.late >= PATIENCE

    @property
    def report(self) -> str:
        """Report of what the guard slowed; empty if nothing."""
        return self._planned.report if self.online is None else self.online.report

    @property
    def part(self) -> float:
        """Share of the path that was travelled, or that the plan allows."""
        if self.online is None:
            return 0.0 if self._planned.sweep is None else self._planned.sweep.part
        whole = np.linalg.norm(self._asked.end - self._asked.start)
        gone = self._asked.at(self.online.time)[0] - self._asked.start
        return float(np.linalg.norm(gone) / whole)
