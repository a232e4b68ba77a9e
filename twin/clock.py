"""Clocks that pace a loop: simulated time, which steps the scene, and wall time."""

import math
import time
from collections.abc import Callable
from typing import Protocol

from twin.simulation import Simulation


class Clock(Protocol):
    """Advances by one period a tick."""

    period: float
    misses: int

    @property
    def time(self) -> float:
        """Time since the clock was made or the scene began [s]."""
        ...

    def tick(self) -> None:
        """Return at the next tick."""
        ...


class SimClock:
    """Simulated time; a tick steps the scene, and no deadline is ever missed."""

    def __init__(self, simulation: Simulation) -> None:
        """Pace by `simulation`."""
        self._simulation = simulation
        self.period = simulation.period
        self.misses = 0

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._simulation.time

    def tick(self) -> None:
        """Step the scene by one servo tick.

        Raises:
            RobotError: As `Simulation.step`.
        """
        self._simulation.step()


class Ticking(Protocol):
    """Something behind boards that advances by a tick: a scene, or one in another process."""

    @property
    def period(self) -> float:
        """Servo tick [s]."""
        ...

    @property
    def time(self) -> float:
        """Of the last tick [s]."""
        ...

    def tick(self) -> None:
        """Advance by one servo tick."""
        ...


class TickClock:
    """Time of emulated boards, which advances by a tick out of band."""

    def __init__(self, scene: Ticking) -> None:
        """Pace by `scene`."""
        self._scene = scene
        self.period = scene.period
        self.misses = 0

    @property
    def time(self) -> float:
        """Time of the scene [s]."""
        return self._scene.time

    def tick(self) -> None:
        """Advance the scene by one servo tick."""
        self._scene.tick()


class WallClock:
    """Wall time with absolute deadlines, so that lateness does not add up.

    Args:
        period: Between ticks [s].
        slow_down: How many times as long as on the wall the robots' time takes; above 1 for
            emulated boards that run as slowly.
        now: Source of wall time [s], monotonic.
        sleep: Waits for so many seconds of wall time.

    Attributes:
        misses: Deadlines that had passed before they were waited for.

    Raises:
        ValueError: If the period is not positive, or the robots' time is to be faster.
    """

    def __init__(
        self,
        period: float,
        slow_down: float = 1.0,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not period > 0.0:
            raise ValueError(f"clock period must be positive, got {period}")
        if not 1.0 <= slow_down < math.inf:
            raise ValueError(f"clock slow_down must be at least 1, got {slow_down}")
        self.period = period
        self.misses = 0
        self._slow_down = slow_down
        self._now = now
        self._sleep = sleep
        self._start = now()
        self._ticks = 0

    @property
    def time(self) -> float:
        """Time of the robots since the clock was made [s]."""
        return (self._now() - self._start) / self._slow_down

    def tick(self) -> None:
        """Wait for the next deadline; deadlines that have passed are counted and skipped.

        Before the first one robots are set up; that misses nothing.
        """
        self._ticks = self._ticks + 1 if self._ticks else int(self.time / self.period) + 1
        remaining = self._ticks * self.period - self.time
        if remaining < 0.0:
            late = int(-remaining / self.period) + 1
            self.misses += late
            self._ticks += late
            remaining += late * self.period
        self._sleep(remaining * self._slow_down)
