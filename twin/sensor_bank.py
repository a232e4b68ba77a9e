"""What a robot's sensors make of the truth: one bank for all channels of a robot.

A sample goes through low-pass, bias and white noise, saturation, quantisation, sample-and-hold
with dropout, and delay, in this order. A channel that has nothing to say is missing or stale;
it never reads zero instead.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import numba
import numpy as np

from twin.robot import MISSING, Channel, FloatArray, Validity
from twin.sensors import CHANNEL_OFFSETS, CHANNEL_WIDTHS, ChannelSpec, SensorSuite, check_channel

_TIME_SLACK = 1e-9
_BLOCK = 64  # ticks of noise drawn at a time
_ALL_MEASURED = (Validity.MEASURED,) * len(CHANNEL_WIDTHS)
# As `Channel._make`, without a Python frame for each channel of each tick.
_channel = cast(
    "Callable[[Any], Channel]",
    functools.partial(tuple.__new__, Channel),  # pyright: ignore[reportUnknownMemberType]
)


# Rows of the coefficients of every component: noise, offset, range, the low pass's weights of its
# state, the last input and the present one, the converter's step (zero for none) and last code,
# and the channel's number.
_SIGMA, _BIAS, _LOW, _HIGH, _KEEP, _BEFORE, _NOW, _STEP, _LAST, _OWNER = range(10)
# Rows of the timing of every channel: a period of zero means every tick, the delay is in ticks,
# and luck is this tick's draw.
_LAG, _PERIOD, _DROPOUT, _DELAY, _LUCK = range(5)


class BankState(NamedTuple):
    """Complete state of a `SensorBank`, enough to go on bit for bit.

    Attributes:
        filters: (2, size) low-pass states, NaN before the first sample, and their last inputs.
        due: (channels,) when the next sample is due [s].
        past: (depth, size + channels) held samples of the last ticks, the latest last, and when
            they were taken [s], NaN before the first.
    """

    filters: FloatArray
    due: FloatArray
    past: FloatArray


@dataclasses.dataclass(frozen=True)
class SavedBank:
    """A `BankState` with what else a bank remembers.

    Attributes:
        state: Of the channels.
        connected: Whether each channel's wire is whole.
        random: State of the generator, before it drew the present block of noise if some of
            that is left.
        used: Rows of the block that were used.
    """

    state: BankState
    connected: tuple[bool, ...]
    random: Mapping[str, Any]
    used: int


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
        self._chain = _chain(specs, period)
        self._timing = _timing(specs, [(lags or {}).get(name, 0.0) for name in self.names], period)
        self._parts = [
            slice(CHANNEL_OFFSETS[name], CHANNEL_OFFSETS[name] + width)
            for name, width in CHANNEL_WIDTHS.items()
        ]
        self._limits = [spec.age_limit + _TIME_SLACK for spec in specs]
        self._least_limit = min(self._limits)
        self._connected = [spec.connected for spec in specs]
        self._noisy = bool(np.any(self._chain[_SIGMA] > 0.0))
        self._lossy = bool(np.any(self._timing[_DROPOUT] > 0.0))
        # Noise is drawn in blocks; drop-outs are drawn between its rows, so then row by row.
        self._noise = np.zeros((1 if self._lossy else _BLOCK, self.size))
        self._luck = self._timing[_LUCK]
        self._used, self._before_block = len(self._noise), {}
        self.reset()

    def reset(self) -> None:
        """Forget every sample; all channels are missing until the next `sample`."""
        depth, channels = 1 + int(self._timing[_DELAY].max()), len(self.names)
        filters = np.array([np.full(self.size, math.nan), np.zeros(self.size)])
        past = np.full((depth, self.size + channels), math.nan)
        self._state = BankState(filters, np.full(channels, -math.inf), past)
        self._show()

    def sample(self, time: float, raw: FloatArray) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            raw: (size,) true values in the order of `CHANNEL_WIDTHS`.
        """
        if self._noisy:
            if self._used == len(self._noise):
                self._draw()
            self._used += 1
        if self._lossy:
            self._rng.random(out=self._luck)
        filters, due, past = self._state
        reading = self._reading = np.empty(past.shape[1])
        self._oldest = _advance(
            time,
            raw,
            self._noise,
            self._used - 1,
            self._chain,
            self._timing,
            filters,
            due,
            past,
            reading,
        )

    def _draw(self) -> None:
        """Draw the next block of noise."""
        self._before_block = dict(self._rng.bit_generator.state)
        self._rng.standard_normal(out=self._noise)
        self._used = 0

    def _show(self) -> None:
        """Set what the channels read: the samples of as many ticks ago as each is late."""
        self._reading = np.empty(self._state.past.shape[1])
        self._oldest = _read(self._chain, self._timing, self._state.past, self._reading)

    def channels(self, time: float) -> list[Channel]:
        """Return every channel as it reads at `time` [s], read-only, in the order of `names`."""
        reading = self._reading
        reading.flags.writeable = False
        views, stamps = map(reading.__getitem__, self._parts), reading[self.size :].tolist()
        if time - self._oldest <= self._least_limit and all(self._connected):
            return list(map(_channel, zip(views, stamps, _ALL_MEASURED)))
        measured, stale = Validity.MEASURED, Validity.STALE
        return [
            (
                Channel(view, stamp, measured if time - stamp <= limit else stale)
                if connected and stamp == stamp
                else MISSING
            )
            for view, stamp, limit, connected in zip(views, stamps, self._limits, self._connected)
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
        left = self._used < len(self._noise)
        random = self._before_block if left else dict(self._rng.bit_generator.state)
        return SavedBank(state, tuple(self._connected), random, self._used)

    def restore(self, saved: SavedBank) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        self._state = BankState(*(part.copy() for part in saved.state))
        self._connected = list(saved.connected)
        self._rng.bit_generator.state = dict(saved.random)
        if saved.used < len(self._noise):
            self._draw()
        self._used = saved.used
        self._show()


def _chain(specs: list[ChannelSpec], period: float) -> FloatArray:
    """Return the coefficients of filter, noise, range and converter, (10, size)."""
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
    owner = spread(list(range(len(specs))))
    return np.array([noise, bias, low, high, keep, before, now, step, levels - 1.0, owner])


def _timing(specs: list[ChannelSpec], lags: list[float], period: float) -> FloatArray:
    """Return which channels are late, slow or lossy, (5, channels)."""
    slow = [spec.rate if spec.rate and spec.rate * period < 1.0 else None for spec in specs]
    periods = [1.0 / rate if rate else 0.0 for rate in slow]
    delays = [round(spec.delay / period) for spec in specs]
    return np.array([lags, periods, [spec.dropout for spec in specs], delays, [1.0] * len(specs)])


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
def _read(chain: FloatArray, timing: FloatArray, past: FloatArray, reading: FloatArray) -> float:
    """Write what each channel reads now, and return the oldest stamp; NaN if one is missing."""
    latest, size, oldest = past.shape[0] - 1, chain.shape[1], math.inf
    for channel in range(timing.shape[1]):
        stamp = float(past[latest - int(timing[_DELAY, channel]), size + channel])
        reading[size + channel] = stamp
        if stamp < oldest or math.isnan(stamp):
            oldest = stamp
    for i in range(size):
        reading[i] = past[latest - int(timing[_DELAY, int(chain[_OWNER, i])]), i]
    return oldest


@numba.njit(cache=True)
def _advance(
    time: float,
    raw: FloatArray,
    noise: FloatArray,
    row: int,
    chain: FloatArray,
    timing: FloatArray,
    filters: FloatArray,
    due: FloatArray,
    past: FloatArray,
    reading: FloatArray,
) -> float:
    """Filter, disturb, limit and quantise a sample, hold it where it arrives, and `_read`."""
    latest, size = past.shape[0] - 1, raw.shape[0]
    for tick in range(latest):
        past[tick] = past[tick + 1]
    arrived = np.zeros(due.shape[0], np.bool_)
    for channel in range(due.shape[0]):
        if time < due[channel] - _TIME_SLACK:
            continue
        period = timing[_PERIOD, channel]
        if period > 0.0:
            # Counting from the due time keeps the mean rate when it does not divide the servo's.
            first = math.isinf(due[channel])
            due[channel] = time + period if first else max(due[channel] + period, time)
        if timing[_LUCK, channel] >= timing[_DROPOUT, channel]:
            arrived[channel] = True
            past[latest, size + channel] = time - timing[_LAG, channel]
    for i in range(size):
        if math.isnan(filters[0, i]):
            filters[0, i] = filters[1, i] = raw[i]
        value = chain[_KEEP, i] * filters[0, i]
        value += chain[_BEFORE, i] * filters[1, i]
        value += chain[_NOW, i] * raw[i]
        filters[0, i], filters[1, i] = value, raw[i]
        if not arrived[int(chain[_OWNER, i])]:
            continue
        low, step = chain[_LOW, i], chain[_STEP, i]
        value += chain[_BIAS, i] + chain[_SIGMA, i] * noise[row, i]
        value = min(max(value, low), chain[_HIGH, i])
        if step > 0.0:
            value = low + step * min(np.rint((value - low) / step), chain[_LAST, i])
        past[latest, i] = value
    return _read(chain, timing, past, reading)
