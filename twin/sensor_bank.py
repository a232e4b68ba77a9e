"""What a robot's sensors make of the truth: one bank for all channels of a robot.

A sample goes through low-pass, bias and white noise, saturation, quantisation, sample-and-hold
with dropout, and delay, in this order. A channel that has nothing to say is missing or stale;
it never reads zero instead.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from twin.robot import MISSING, Channel, FloatArray, Validity
from twin.sensors import CHANNEL_OFFSETS, CHANNEL_WIDTHS, ChannelSpec, SensorSuite, check_channel

Sample = tuple[FloatArray, list[float]]
_TIME_SLACK = 1e-9


@dataclasses.dataclass(frozen=True)
class BankState:
    """Complete state of a `SensorBank`, enough to go on bit for bit.

    Attributes:
        filtered: (size,) low-pass states, if there was a sample.
        unfiltered: (size,) last inputs of the low passes.
        due: By channel, when the next sample is due [s].
        past: Held samples of the last ticks, for delays.
        held: Latest values (size,) and their time stamps.
        shown: The same after delays.
        connected: By channel.
        random: State of the generator.
    """

    filtered: FloatArray | None
    unfiltered: FloatArray
    due: tuple[float, ...]
    past: tuple[Sample, ...]
    held: Sample
    shown: Sample
    connected: tuple[bool, ...]
    random: Mapping[str, Any]


class SensorBank:
    """All numeric channels of one robot, sampled together once a servo tick."""

    def __init__(
        self,
        suite: SensorSuite,
        period: float,
        rng: np.random.Generator,
        lags: Mapping[str, float] | None = None,
    ) -> None:
        """Lay the channels side by side.

        Args:
            suite: How each channel is measured.
            period: Servo tick [s].
            rng: Source of noise and dropout, owned by the bank from now on.
            lags: By channel, how much older than the tick the raw value is [s].
        """
        self.names = tuple(CHANNEL_WIDTHS)
        self._rng = rng
        widths = list(CHANNEL_WIDTHS.values())
        self._slices = {
            name: slice(CHANNEL_OFFSETS[name], CHANNEL_OFFSETS[name] + width)
            for name, width in CHANNEL_WIDTHS.items()
        }
        self.size = sum(widths)
        specs = [suite.channels.get(name, ChannelSpec()) for name in self.names]
        self._lags = [(lags or {}).get(name, 0.0) for name in self.names]
        self._limits = [spec.age_limit + _TIME_SLACK for spec in specs]
        self._connected = [spec.connected for spec in specs]
        self._set_chain(specs, widths, period)
        self._set_timing(specs, period)
        self.reset()

    def _set_chain(self, specs: list[ChannelSpec], widths: list[int], period: float) -> None:
        """Set the coefficients of filter, noise, range and converter."""

        def spread(field: str) -> FloatArray:
            parts = [np.broadcast_to(getattr(s, field), (w,)) for s, w in zip(specs, widths)]
            return np.concatenate(parts).astype(float)

        self._sigma, self._bias = spread("noise"), spread("bias")
        self._low, self._high = spread("low"), spread("high")
        self._noisy = bool(np.any(self._sigma > 0.0))
        self._biased = bool(np.any(self._bias != 0.0))
        self._limited = bool(np.any(np.isfinite(self._low) | np.isfinite(self._high)))
        parts = list(self._slices.values())
        self._filters = [
            (part, *_low_pass(2.0 * math.pi * spec.bandwidth * period))
            for spec, part in zip(specs, parts)
            if spec.bandwidth is not None
        ]
        self._codes: list[tuple[slice, FloatArray, FloatArray, FloatArray]] = []
        for first, end in _runs([spec.bits is not None for spec in specs]):
            part = slice(parts[first].start, parts[end - 1].stop)
            levels = np.repeat([2.0 ** (s.bits or 0) for s in specs[first:end]], widths[first:end])
            low, high = self._low[part], self._high[part]
            self._codes.append((part, low, (high - low) / levels, levels - 1.0))

    def _set_timing(self, specs: list[ChannelSpec], period: float) -> None:
        """Set which channels are slow or lossy, and which are late by how many ticks."""
        self._slow = [
            (index, part, 1.0 / spec.rate if spec.rate else 0.0, spec.dropout)
            for index, (spec, part) in enumerate(zip(specs, self._slices.values()))
            if spec.dropout > 0.0 or (spec.rate is not None and spec.rate * period < 1.0)
        ]
        self._late = [
            (index, part, round(spec.delay / period))
            for index, (spec, part) in enumerate(zip(specs, self._slices.values()))
            if round(spec.delay / period) > 0
        ]
        self._depth = 1 + max((ticks for _, _, ticks in self._late), default=0)

    def reset(self) -> None:
        """Forget every sample; all channels are missing until the next `sample`."""
        nothing = [math.nan] * len(self.names)
        self._filtered: FloatArray | None = None
        self._unfiltered = np.zeros(self.size)
        self._due = [-math.inf] * len(self.names)
        self._held = np.zeros(self.size)
        self._held_stamps = nothing
        self._past = [(self._held, nothing)] * self._depth
        self._values, self._stamps = self._held, nothing

    def sample(self, time: float, raw: FloatArray) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            raw: (size,) true values in the order of `CHANNEL_WIDTHS`.
        """
        values = self._measure(raw)
        stamps = [time - lag for lag in self._lags]
        for index, part, period, dropout in self._slow:
            if not self._arrives(index, time, period, dropout):
                values[part] = self._held[part]
                stamps[index] = self._held_stamps[index]
        self._held, self._held_stamps = values, stamps
        self._values, self._stamps = values, stamps
        if self._late:
            self._delay()

    def _measure(self, raw: FloatArray) -> FloatArray:
        """Return (size,) filtered, noisy, limited and quantised values, as a new array."""
        values = raw.copy()
        if self._filters:
            if self._filtered is None:
                self._filtered, self._unfiltered = raw.copy(), raw.copy()
            for part, keep, before, now in self._filters:
                state, last = self._filtered[part], self._unfiltered[part]
                state *= keep
                state += before * last
                state += now * raw[part]
                last[:] = raw[part]
                values[part] = state
        if self._biased:
            values += self._bias
        if self._noisy:
            values += self._sigma * self._rng.standard_normal(self.size)
        if self._limited:
            np.maximum(values, self._low, out=values)
            np.minimum(values, self._high, out=values)
        for part, low, step, last in self._codes:
            codes = values[part]
            codes -= low
            codes /= step
            np.rint(codes, out=codes)
            np.minimum(codes, last, out=codes)
            codes *= step
            codes += low
        return values

    def _arrives(self, index: int, time: float, period: float, dropout: float) -> bool:
        """Return whether a slow or lossy channel has a new sample."""
        due = self._due[index]
        if time < due - _TIME_SLACK:
            return False
        # Counting from the due time keeps the mean rate when it does not divide the servo rate.
        self._due[index] = time + period if due == -math.inf else max(due + period, time)
        return dropout == 0.0 or self._rng.random() >= dropout

    def _delay(self) -> None:
        """Give late channels their earlier samples."""
        self._past = [*self._past[1:], (self._held, self._held_stamps)]
        self._values, self._stamps = self._held.copy(), list(self._held_stamps)
        for index, part, ticks in self._late:
            values, stamps = self._past[-1 - ticks]
            self._values[part] = values[part]
            self._stamps[index] = stamps[index]

    def channels(self, time: float) -> dict[str, Channel]:
        """Return every channel as it reads at `time` [s], as read-only copies."""
        values = self._values.copy()
        values.flags.writeable = False
        result: dict[str, Channel] = {}
        measured, stale = Validity.MEASURED, Validity.STALE
        rows = zip(self._slices.items(), self._stamps, self._limits, self._connected)
        for (name, part), stamp, limit, connected in rows:
            if not connected or math.isnan(stamp):
                result[name] = MISSING
            else:
                late = time - stamp > limit
                result[name] = Channel(values[part], stamp, stale if late else measured)
        return result

    def disconnect(self, name: str) -> None:
        """Take a sensor away, as a broken wire does; it is missing from now on."""
        check_channel(name)
        self._connected[self.names.index(name)] = False

    def connect(self, name: str) -> None:
        """Give a sensor back."""
        check_channel(name)
        self._connected[self.names.index(name)] = True

    def save(self) -> BankState:
        """Return the complete state."""
        # Held values are never written in place, so sharing them is safe; the filter's are.
        return BankState(
            None if self._filtered is None else self._filtered.copy(),
            self._unfiltered.copy(),
            tuple(self._due),
            tuple(self._past),
            (self._held, self._held_stamps),
            (self._values, self._stamps),
            tuple(self._connected),
            dict(self._rng.bit_generator.state),
        )

    def restore(self, state: BankState) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        self._filtered = None if state.filtered is None else state.filtered.copy()
        self._unfiltered = state.unfiltered.copy()
        self._due = list(state.due)
        self._past = list(state.past)
        self._held, self._held_stamps = state.held
        self._values, self._stamps = state.shown
        self._connected = list(state.connected)
        self._rng.bit_generator.state = dict(state.random)


def _low_pass(decay: float) -> tuple[float, float, float]:
    """Return a first-order filter's weights of its state, the last input and the present one.

    Exact for an input that runs straight from sample to sample: holding it instead would shift
    the filter by half a sample.

    Args:
        decay: Pole times sampling period.
    """
    keep = math.exp(-decay)
    mean = (1.0 - keep) / decay
    return keep, mean - keep, 1.0 - mean


def _runs(flags: list[bool]) -> list[tuple[int, int]]:
    """Return first and past-the-end index of each run of true flags."""
    edges = np.flatnonzero(np.diff([False, *flags, False])).tolist()
    return list(zip(edges[::2], edges[1::2]))
