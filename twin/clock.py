"""Clocks that pace a loop: what every clock does, and wall time."""

import math
import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """Advances by one period a tick; a simulated scene is the clock of its robots."""

    @property
    def period(self) -> float:
        """Servo tick [s]."""
        ...

    @property
    def time(self) -> float:
        """Time since the clock was made or the scene began [s]."""
        ...

    def tick(self) -> None:
        """Return at the next tick."""
        ...


class WallClock:
    """Wall time with absolute deadlines, so that lateness does not add up.

    Args:
        period: Time between ticks [s].
        slow_down: Wall time that passes in a second of the robots' time [s]; above 1 for emulated
            boards that run slower than real ones.
        now: Source of wall time [s], monotonic.
        sleep: Function that waits for a wall time [s].

    Attributes:
        misses: Number of deadlines that had passed before `tick` waited for them.

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
        """Robot time since the clock was made [s]."""
        return (self._now() - self._start) / self._slow_down

    def tick(self) -> None:
        """Wait for the next deadline; deadlines that have passed are counted and skipped.

        The set-up of robots before the first tick misses none.
        """
        self._ticks = self._ticks + 1 if self._ticks else int(self.time / self.period) + 1
        remaining = self._ticks * self.period - self.time
        if remaining < 0.0:
            late = int(-remaining / self.period) + 1
            self.misses += late
            self._ticks += late
            remaining += late * self.period
        self._sleep(remaining * self._slow_down)


class PacedClock:
    """A clock whose time passes no faster than that of another one.

    Args:
        clock: Clock of simulated or emulated robots, which ticks as fast as it can.
        pace: Clock with the same period that waits; what is late is not made up for.
    """

    def __init__(self, clock: Clock, pace: WallClock) -> None:
        self._clock, self._pace = clock, pace

    @property
    def period(self) -> float:
        """Servo tick [s]."""
        return self._clock.period

    @property
    def time(self) -> float:
        """Time of the robots [s]."""
        return self._clock.time

    def tick(self) -> None:
        """Advance the robots, and wait."""
        self._clock.tick()
        self._pace.tick()
