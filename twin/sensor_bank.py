"""What a robot's sensors make of the truth: one bank for all channels of a robot.

A sample goes through low-pass, bias and white noise, saturation, quantisation, sample-and-hold
with dropout, and delay, in this order. A channel that has nothing to say is missing or stale;
it never reads zero instead.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from twin.robot import MISSING, Channel, FloatArray, Validity
from twin.sensors import CHANNEL_OFFSETS, CHANNEL_WIDTHS, ChannelSpec, SensorSuite, check_channel

_TIME_SLACK = 1e-9


# Rows of the coefficients of every component: noise, offset, range, the low pass's weights of its
# state, the last input and the present one, the converter's step (zero for none) and last code.
_SIGMA, _BIAS, _LOW, _HIGH, _KEEP, _BEFORE, _NOW, _STEP, _LAST = range(9)
# Rows of the timing of every channel; a period of zero means every tick.
_LAG, _PERIOD, _DROPOUT = range(3)


class BankState(NamedTuple):
    """Complete state of a `SensorBank`, enough to go on bit for bit.

    Attributes:
        filtered: (size,) low-pass states; NaN before the first sample.
        unfiltered: (size,) last inputs of the low passes.
        due: (channels,) when the next sample is due [s].
        past: (depth, size) held samples of the last ticks, the latest last.
        past_stamps: (depth, channels) when they were taken [s]; NaN before the first.
    """

    filtered: FloatArray
    unfiltered: FloatArray
    due: FloatArray
    past: FloatArray
    past_stamps: FloatArray


@dataclasses.dataclass(frozen=True)
class SavedBank:
    """A `BankState` with what else a bank remembers: wires and the generator's state."""

    state: BankState
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
        self.size = sum(CHANNEL_WIDTHS.values())
        self._rng = rng
        specs = [suite.channels.get(name, ChannelSpec()) for name in self.names]
        self._owner = np.repeat(np.arange(len(self.names)), list(CHANNEL_WIDTHS.values()))
        self._chain = _chain(specs, period)
        self._timing = _timing(specs, [(lags or {}).get(name, 0.0) for name in self.names], period)
        self._delay_ticks = np.array([round(spec.delay / period) for spec in specs])
        self._parts = [
            slice(CHANNEL_OFFSETS[name], CHANNEL_OFFSETS[name] + width)
            for name, width in CHANNEL_WIDTHS.items()
        ]
        self._limits = [spec.age_limit + _TIME_SLACK for spec in specs]
        self._connected = [spec.connected for spec in specs]
        self._noisy = bool(np.any(self._chain[_SIGMA] > 0.0))
        self._lossy = bool(np.any(self._timing[_DROPOUT] > 0.0))
        self._noise = np.zeros(self.size)
        self._luck = np.ones(len(self.names))
        self.reset()

    def reset(self) -> None:
        """Forget every sample; all channels are missing until the next `sample`."""
        depth, channels = 1 + int(self._delay_ticks.max()), len(self.names)
        self._state = BankState(
            np.full(self.size, math.nan),
            np.zeros(self.size),
            np.full(channels, -math.inf),
            np.zeros((depth, self.size)),
            np.full((depth, channels), math.nan),
        )
        self._show()

    def sample(self, time: float, raw: FloatArray) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            raw: (size,) true values in the order of `CHANNEL_WIDTHS`.
        """
        if self._noisy:
            self._rng.standard_normal(out=self._noise)
        if self._lossy:
            self._rng.random(out=self._luck)
        self._values, self._stamps = np.empty(self.size), np.empty(len(self.names))
        _advance(
            time,
            raw,
            self._noise,
            self._luck,
            self._owner,
            self._chain,
            self._timing,
            self._delay_ticks,
            *self._state,
            self._values,
            self._stamps,
        )

    def _show(self) -> None:
        """Set what the channels read: the samples of as many ticks ago as each is late."""
        self._values, self._stamps = np.empty(self.size), np.empty(len(self.names))
        _, _, _, past, stamps = self._state
        _read(self._owner, self._delay_ticks, past, stamps, self._values, self._stamps)

    def channels(self, time: float) -> list[Channel]:
        """Return every channel as it reads at `time` [s], read-only, in the order of `names`."""
        values = self._values
        values.flags.writeable = False
        measured, stale = Validity.MEASURED, Validity.STALE
        return [
            (
                Channel(values[part], stamp, measured if time - stamp <= limit else stale)
                if connected and stamp == stamp
                else MISSING
            )
            for part, stamp, limit, connected in zip(
                self._parts, self._stamps.tolist(), self._limits, self._connected
            )
        ]

    def disconnect(self, name: str) -> None:
        """Take a sensor away, as a broken wire does; it is missing from now on."""
        check_channel(name)
        self._connected[self.names.index(name)] = False

    def connect(self, name: str) -> None:
        """Give a sensor back."""
        check_channel(name)
        self._connected[self.names.index(name)] = True

    def save(self) -> SavedBank:
        """Return the complete state."""
        state = BankState(*(part.copy() for part in self._state))
        return SavedBank(state, tuple(self._connected), dict(self._rng.bit_generator.state))

    def restore(self, saved: SavedBank) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        self._state = BankState(*(part.copy() for part in saved.state))
        self._connected = list(saved.connected)
        self._rng.bit_generator.state = dict(saved.random)
        self._show()


def _chain(specs: list[ChannelSpec], period: float) -> FloatArray:
    """Return the coefficients of filter, noise, range and converter, (9, size)."""
    widths = list(CHANNEL_WIDTHS.values())

    def spread(values: list[Any]) -> FloatArray:
        parts = [np.broadcast_to(value, (width,)) for value, width in zip(values, widths)]
        return np.concatenate(parts).astype(float)

    low, high = spread([spec.low for spec in specs]), spread([spec.high for spec in specs])
    converted = spread([spec.bits is not None for spec in specs]) > 0.0
    levels = spread([2.0 ** (spec.bits or 0) for spec in specs])
    step = np.zeros(low.size)
    step[converted] = ((high - low) / levels)[converted]
    weights = [_low_pass(spec.bandwidth, period) for spec in specs]
    noise, bias = spread([spec.noise for spec in specs]), spread([spec.bias for spec in specs])
    keep, before, now = (spread([weight[n] for weight in weights]) for n in range(3))
    return np.array([noise, bias, low, high, keep, before, now, step, levels - 1.0])


def _timing(specs: list[ChannelSpec], lags: list[float], period: float) -> FloatArray:
    """Return which channels are late, slow or lossy, (3, channels)."""
    slow = [spec.rate if spec.rate and spec.rate * period < 1.0 else None for spec in specs]
    periods = [1.0 / rate if rate else 0.0 for rate in slow]
    return np.array([lags, periods, [spec.dropout for spec in specs]])


def _low_pass(bandwidth: float | None, period: float) -> tuple[float, float, float]:
    """Return a first-order filter's weights of its state, the last input and the present one.

    Exact for an input that runs straight from sample to sample: holding it instead would shift
    the filter by half a sample.

    Args:
        bandwidth: Corner [Hz]; None for no filter.
        period: Between samples [s].
    """
    if bandwidth is None:
        return 0.0, 0.0, 1.0
    decay = 2.0 * math.pi * bandwidth * period
    keep = math.exp(-decay)
    mean = (1.0 - keep) / decay
    return keep, mean - keep, 1.0 - mean


@numba.njit(cache=True)
def _read(
    owner: NDArray[np.intp],
    delay_ticks: NDArray[np.intp],
    past: FloatArray,
    past_stamps: FloatArray,
    values: FloatArray,
    stamps: FloatArray,
) -> None:
    """Write what each channel reads now into `values` and `stamps`."""
    latest = past.shape[0] - 1
    for channel in range(stamps.shape[0]):
        stamps[channel] = past_stamps[latest - delay_ticks[channel], channel]
    for i in range(values.shape[0]):
        values[i] = past[latest - delay_ticks[owner[i]], i]


@numba.njit(cache=True)
def _advance(
    time: float,
    raw: FloatArray,
    noise: FloatArray,
    luck: FloatArray,
    owner: NDArray[np.intp],
    chain: FloatArray,
    timing: FloatArray,
    delay_ticks: NDArray[np.intp],
    filtered: FloatArray,
    unfiltered: FloatArray,
    due: FloatArray,
    past: FloatArray,
    past_stamps: FloatArray,
    values: FloatArray,
    stamps: FloatArray,
) -> None:
    """Filter, disturb, limit and quantise a sample, hold it where it arrives, and read."""
    latest = past.shape[0] - 1
    for tick in range(latest):
        past[tick] = past[tick + 1]
        past_stamps[tick] = past_stamps[tick + 1]
    arrived = np.zeros(due.shape[0], np.bool_)
    for channel in range(due.shape[0]):
        if time < due[channel] - _TIME_SLACK:
            continue
        period = timing[_PERIOD, channel]
        if period > 0.0:
            # Counting from the due time keeps the mean rate when it does not divide the servo's.
            first = math.isinf(due[channel])
            due[channel] = time + period if first else max(due[channel] + period, time)
        if luck[channel] >= timing[_DROPOUT, channel]:
            arrived[channel] = True
            past_stamps[latest, channel] = time - timing[_LAG, channel]
    for i in range(raw.shape[0]):
        if math.isnan(filtered[i]):
            filtered[i] = unfiltered[i] = raw[i]
        value = chain[_KEEP, i] * filtered[i]
        value += chain[_BEFORE, i] * unfiltered[i]
        value += chain[_NOW, i] * raw[i]
        filtered[i], unfiltered[i] = value, raw[i]
        if not arrived[owner[i]]:
            continue
        low, step = chain[_LOW, i], chain[_STEP, i]
        value += chain[_BIAS, i] + chain[_SIGMA, i] * noise[i]
        value = min(max(value, low), chain[_HIGH, i])
        if step > 0.0:
            value = low + step * min(np.rint((value - low) / step), chain[_LAST, i])
        past[latest, i] = value
    _read(owner, delay_ticks, past, past_stamps, values, stamps)
