"""What a controller saw, kept for an estimate over the whole run, and refused where it is blind."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.robot import Observation

FloatArray = NDArray[np.float64]


class IdentificationError(ValueError):
    """What was measured does not allow the estimate that was asked for."""


class ObservationLog:
    """The channels that an estimate needs, tick by tick."""

    def __init__(self, purpose: str, channels: Sequence[str]) -> None:
        """Prepare an empty log.

        Args:
            purpose: What the channels are needed for; begins every error.
            channels: Names of fields of `Observation`.
        """
        self._purpose = purpose
        self._channels = tuple(channels)
        self._times: list[float] = []
        self._values: dict[str, list[FloatArray]] = {name: [] for name in channels}
        self._stamps: dict[str, list[float]] = {name: [] for name in channels}

    def forget_before(self, time: float) -> None:
        """Drop the ticks before a time [s]."""
        first = int(np.searchsorted(self._times, time))
        del self._times[:first]
        for rows in (*self._values.values(), *self._stamps.values()):
            del rows[:first]

    def __len__(self) -> int:
        return len(self._times)

    @property
    def times(self) -> FloatArray:
        """Robot time of each tick (n,) [s]."""
        return np.array(self._times)

    def take(self, observation: Observation) -> None:
        """Keep one tick.

        Raises:
            IdentificationError: If a channel is missing or stale, or holds a NaN or an infinity.
        """
        for name in self._channels:
            channel = getattr(observation, name)
            if not channel.usable:
                raise IdentificationError(
                    f"{self._purpose} needs {name}, which is {channel.validity.value} "
                    f"at {observation.time:.3f} s"
                )
            value = np.asarray(channel.value, dtype=float)
            bad = np.flatnonzero(~np.isfinite(value))
            if bad.size:
                raise IdentificationError(
                    f"{self._purpose}: {name}[{bad[0]}] is {value[bad[0]]} "
                    f"at {observation.time:.3f} s"
                )
            self._values[name].append(value)
            self._stamps[name].append(channel.stamp)
        self._times.append(observation.time)

    def values(self, channel: str) -> FloatArray:
        """Return what a channel read at every tick, (n, width)."""
        return np.array(self._values[channel])

    def age(self, channel: str) -> float:
        """Return how old a channel typically was at its tick [s]."""
        return float(np.median(self.times - np.array(self._stamps[channel])))

    def samples(self, channel: str) -> tuple[FloatArray, FloatArray]:
        """Return a channel's samples, each once: time stamps (m,) [s] and values (m, width)."""
        stamps, first = np.unique(self._stamps[channel], return_index=True)
        return stamps, self.values(channel)[first]
