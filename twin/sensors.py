"""What a robot's sensors make of the truth: one vectorised bank for all channels of a robot.

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
from numpy.typing import NDArray

from models.datasheets import DEGREE, FORCE_TORQUE, INCLINOMETER
from twin.robot import MISSING, Channel, FloatArray, Validity

CHANNEL_WIDTHS: Mapping[str, int] = {
    "wheel_speeds": 4,
    "centre_angle": 1,
    "arm_angles": 4,
    "arm_rates": 4,
    "inclinometer": 2,
    "arm_base_wrench": 6,
    "accelerometer": 3,
    "gyro": 3,
    "heading": 1,
}
"""Numeric channels of an `Observation` and their widths."""

CHANNEL_OFFSETS: Mapping[str, int] = {
    name: sum(list(CHANNEL_WIDTHS.values())[:index]) for index, name in enumerate(CHANNEL_WIDTHS)
}
"""Where each channel begins in a bank's vector."""

PerComponent = float | tuple[float, ...]
_TIME_SLACK = 1e-9


@dataclasses.dataclass(frozen=True)
class ChannelSpec:
    """How one channel is measured; the default is ideal.

    Numbers marked * may be one for all components or one for each.

    Attributes:
        noise: * Standard deviation of the white noise of each sample [unit of the channel].
        bias: * Constant offset [unit].
        low: * Lower end of the range [unit].
        high: * Upper end of the range [unit].
        bits: Resolution of the converter over [low, high]; None for none.
        bandwidth: First-order low-pass corner [Hz]; None for none.
        rate: Samples per second [Hz], held between; None for every servo tick.
        delay: From sample to reading [s], rounded to whole servo ticks.
        dropout: Probability that a sample is lost, in [0, 1].
        stale_after: Age from which a sample is stale [s]; None for three sampling periods
            (at least 0.1 s) and the delay.
        connected: False for a sensor that is not there.
    """

    noise: PerComponent = 0.0
    bias: PerComponent = 0.0
    low: PerComponent = -math.inf
    high: PerComponent = math.inf
    bits: int | None = None
    bandwidth: float | None = None
    rate: float | None = None
    delay: float = 0.0
    dropout: float = 0.0
    stale_after: float | None = None
    connected: bool = True

    def __post_init__(self) -> None:
        """Refuse numbers that describe no sensor.

        Raises:
            ValueError: Naming the field and its value.
        """
        for name in ("bandwidth", "rate", "stale_after"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ValueError(f"sensor {name} must be positive, got {value}")
        if not (self.delay >= 0.0 and math.isfinite(self.delay)):
            raise ValueError(f"sensor delay must be finite and not negative, got {self.delay}")
        if not 0.0 <= self.dropout <= 1.0:
            raise ValueError(f"sensor dropout must be a probability, got {self.dropout}")
        if not np.all(np.asarray(self.noise) >= 0.0):
            raise ValueError(f"sensor noise must not be negative, got {self.noise}")
        if not np.all(np.isfinite(self.bias)):
            raise ValueError(f"sensor bias must be finite, got {self.bias}")
        if not np.all(np.asarray(self.low) < np.asarray(self.high)):
            raise ValueError(f"sensor range is empty: low {self.low}, high {self.high}")
        if self.bits is not None:
            if self.bits < 1:
                raise ValueError(f"sensor bits must be at least 1, got {self.bits}")
            if not (np.all(np.isfinite(self.low)) and np.all(np.isfinite(self.high))):
                raise ValueError("sensor bits need a finite range: give low and high")

    @property
    def age_limit(self) -> float:
        """Age from which a sample is stale [s]."""
        if self.stale_after is not None:
            return self.stale_after
        return max(0.1, 3.0 / self.rate if self.rate else 0.0) + self.delay


@dataclasses.dataclass(frozen=True)
class SensorSuite:
    """A named set of channel specifications; a channel that is not named is ideal.

    Attributes:
        name: For messages and records.
        channels: Specification by channel name, keys of `CHANNEL_WIDTHS`.
    """

    name: str
    channels: Mapping[str, ChannelSpec] = dataclasses.field(default_factory=dict[str, ChannelSpec])

    def __post_init__(self) -> None:
        """Refuse unknown channels.

        Raises:
            ValueError: Naming the unknown channel and listing the valid ones.
        """
        for channel in self.channels:
            check_channel(channel)

    def with_channel(self, channel: str, **changes: Any) -> SensorSuite:
        """Return a copy in which one channel's specification has other fields.

        Args:
            channel: Key of `CHANNEL_WIDTHS`.
            **changes: Fields of `ChannelSpec`.

        Raises:
            ValueError: If the channel is unknown or the specification invalid.
        """
        check_channel(channel)
        spec = dataclasses.replace(self.channels.get(channel, ChannelSpec()), **changes)
        return SensorSuite(self.name, {**self.channels, channel: spec})


def check_channel(name: str) -> None:
    """Raise a ValueError that names an unknown channel and lists the valid ones."""
    if name not in CHANNEL_WIDTHS:
        raise ValueError(f"unknown sensor {name!r}; valid ones are {', '.join(CHANNEL_WIDTHS)}")


IDEAL = SensorSuite("ideal")
"""Every channel exact, undelayed, at every servo tick."""

_HALF_TURN = 180.0 * DEGREE

DATASHEET = SensorSuite(
    "datasheet",
    {
        # Assumption: a tachometer good to 0.02 rad/s, read with 12 bits over twice the top speed.
        "wheel_speeds": ChannelSpec(noise=0.02, low=-15.0, high=15.0, bits=12),
        # A potentiometer on a 10-bit converter over its 150 degrees: 0.145 degrees a count.
        "centre_angle": ChannelSpec(low=-75.0 * DEGREE, high=75.0 * DEGREE, bits=10),
        # Assumption: arm encoders of 2^14 counts a turn; rates from the same, 0.01 rad/s.
        "arm_angles": ChannelSpec(low=-_HALF_TURN, high=_HALF_TURN, bits=14),
        "arm_rates": ChannelSpec(noise=0.01),
        "inclinometer": ChannelSpec(
            noise=INCLINOMETER.noise,
            low=-INCLINOMETER.linear_range,
            high=INCLINOMETER.linear_range,
            bandwidth=INCLINOMETER.bandwidth,
            rate=25.0,  # Assumption: the analogue board is read every fourth tick
        ),
        "arm_base_wrench": ChannelSpec(
            noise=(FORCE_TORQUE.force_noise,) * 3 + (FORCE_TORQUE.torque_noise,) * 3
        ),
        # Assumption: small MEMS units; the thesis has these three in its simulated study only.
        "accelerometer": ChannelSpec(noise=0.05),
        "gyro": ChannelSpec(noise=0.005),
        "heading": ChannelSpec(noise=1.0 * DEGREE),
    },
)
"""Sensors as the makers and the thesis give them; assumptions are marked in the source."""


@dataclasses.dataclass(frozen=True)
class BankState:
    """Complete state of a `SensorBank`, enough to go on bit for bit."""

    arrays: Mapping[str, NDArray[np.generic]]
    random: Mapping[str, Any]
    row: int
    started: bool


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
        self._owner = np.repeat(np.arange(len(specs)), widths)
        self._lags = np.array([(lags or {}).get(name, 0.0) for name in self.names])
        self._limits = [spec.age_limit for spec in specs]
        self._connected = np.array([spec.connected for spec in specs])
        self._set_chain(specs, widths, period)
        self._set_timing(specs, period)
        self.reset()

    def _set_chain(self, specs: list[ChannelSpec], widths: list[int], period: float) -> None:
        """Set the coefficients of filter, noise, range and converter, (size,) each."""

        def spread(field: str) -> FloatArray:
            parts = [np.broadcast_to(getattr(s, field), (w,)) for s, w in zip(specs, widths)]
            return np.concatenate(parts).astype(float)

        corner = np.array([s.bandwidth or math.inf for s in specs])
        self._gain = np.where(np.isinf(corner), 1.0, -np.expm1(-2.0 * np.pi * corner * period))[
            self._owner
        ]
        self._sigma, self._bias = spread("noise"), spread("bias")
        self._low, self._high = spread("low"), spread("high")
        self._filters = bool(np.any(self._gain < 1.0))
        self._noisy = bool(np.any(self._sigma > 0.0))
        self._biased = bool(np.any(self._bias != 0.0))
        self._limited = bool(np.any(np.isfinite(self._low) | np.isfinite(self._high)))
        levels = np.array([2.0**s.bits if s.bits else 0.0 for s in specs])[self._owner]
        self._coded = np.flatnonzero(levels)
        low, high = self._low[self._coded], self._high[self._coded]
        self._code_low = low
        self._code_step = (high - low) / levels[self._coded]
        self._code_max = levels[self._coded] - 1.0

    def _set_timing(self, specs: list[ChannelSpec], period: float) -> None:
        """Set sampling periods, dropout and delays, (channels,) each."""
        self._periods = np.array([1.0 / s.rate if s.rate else 0.0 for s in specs])
        self._dropout = np.array([s.dropout for s in specs])
        self._delays = np.array([round(s.delay / period) for s in specs])
        self._drops = bool(np.any(self._dropout > 0.0))
        self._every_tick = not self._drops and not bool(np.any(self._periods > period))
        self._delayed = bool(np.any(self._delays))

    def reset(self) -> None:
        """Forget every sample; all channels are missing until the next `sample`."""
        channels, rows = len(self.names), int(self._delays.max()) + 1
        self._filtered = np.zeros(self.size)
        self._due = np.full(channels, -math.inf)
        self._held = np.zeros(self.size)
        self._held_stamps = np.full(channels, math.nan)
        self._ring = np.zeros((rows, self.size))
        self._ring_stamps = np.full((rows, channels), math.nan)
        self._row = 0
        self._started = False
        self._values = self._held
        self._stamps = self._held_stamps

    def sample(self, time: float, raw: FloatArray) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            raw: (size,) true values in the order of `CHANNEL_WIDTHS`.
        """
        values = self._measure(raw)
        stamps = time - self._lags
        if self._every_tick:
            self._held, self._held_stamps = values, stamps
        else:
            self._hold(time, values, stamps)
        if not self._delayed:
            self._values, self._stamps = self._held, self._held_stamps
            return
        rows = len(self._ring)
        self._row = (self._row + 1) % rows
        self._ring[self._row] = self._held
        self._ring_stamps[self._row] = self._held_stamps
        source = (self._row - self._delays) % rows
        self._values = self._ring[source[self._owner], np.arange(self.size)]
        self._stamps = self._ring_stamps[source, np.arange(len(self.names))]

    def _measure(self, raw: FloatArray) -> FloatArray:
        """Return (size,) filtered, noisy, limited and quantised values, as a new array."""
        if not self._filters:
            values = raw.copy()
        else:
            if not self._started:
                self._filtered = raw.copy()
            self._filtered += self._gain * (raw - self._filtered)
            values = self._filtered.copy()
        self._started = True
        if self._biased:
            values += self._bias
        if self._noisy:
            values += self._sigma * self._rng.standard_normal(self.size)
        if self._limited:
            np.maximum(values, self._low, out=values)
            np.minimum(values, self._high, out=values)
        if self._coded.size:
            codes = np.rint((values[self._coded] - self._code_low) / self._code_step)
            codes = np.minimum(codes, self._code_max)
            values[self._coded] = self._code_low + codes * self._code_step
        return values

    def _hold(self, time: float, values: FloatArray, stamps: FloatArray) -> None:
        """Let through the channels whose next sample is due and is not lost."""
        due = time >= self._due - _TIME_SLACK
        # Counting from the due time keeps the mean rate when it does not divide the servo rate.
        following = np.maximum(self._due + self._periods, time)
        first = np.isinf(self._due)
        following[first] = time + self._periods[first]
        self._due = np.where(due, following, self._due)
        if self._drops:
            due &= self._rng.random(len(due)) >= self._dropout
        self._held = np.where(due[self._owner], values, self._held)
        self._held_stamps = np.where(due, stamps, self._held_stamps)

    def channels(self, time: float) -> dict[str, Channel]:
        """Return every channel as it reads at `time` [s], as read-only copies."""
        values = self._values.copy()
        values.flags.writeable = False
        result: dict[str, Channel] = {}
        rows = zip(
            self._slices.items(), self._stamps.tolist(), self._limits, self._connected.tolist()
        )
        for (name, part), stamp, limit, connected in rows:
            if not connected or stamp != stamp:  # noqa: PLR0124 (NaN: nothing arrived yet)
                result[name] = MISSING
                continue
            late = time - stamp > limit + _TIME_SLACK
            validity = Validity.STALE if late else Validity.MEASURED
            result[name] = Channel(values[part], stamp, validity)
        return result

    def disconnect(self, name: str) -> None:
        """Take a sensor away, as a broken wire does; it is missing from now on."""
        check_channel(name)
        self._connected[self.names.index(name)] = False

    def connect(self, name: str) -> None:
        """Give a sensor back."""
        check_channel(name)
        self._connected[self.names.index(name)] = True

    _ARRAYS = (
        "_filtered",
        "_due",
        "_held",
        "_held_stamps",
        "_ring",
        "_ring_stamps",
        "_values",
        "_stamps",
        "_connected",
    )

    def save(self) -> BankState:
        """Return the complete state."""
        arrays = {name: getattr(self, name).copy() for name in self._ARRAYS}
        return BankState(arrays, dict(self._rng.bit_generator.state), self._row, self._started)

    def restore(self, state: BankState) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        for name in self._ARRAYS:
            setattr(self, name, state.arrays[name].copy())
        self._rng.bit_generator.state = dict(state.random)
        self._row, self._started = state.row, state.started
