"""What a robot's sensors make of the truth: one bank for all channels of a robot.

A sample goes through low-pass, bias and white noise, saturation, quantisation, sample-and-hold
with dropout, and delay, in this order. A channel that has nothing to say is missing or stale;
it never reads zero instead.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple, cast

import mujoco
import numba
import numpy as np

from perception.geometry.arrays import FloatArray, IndexArray
from twin.description import RobotDescription
from twin.robot import MISSING, Channel, Validity
from twin.sensors import CHANNELS, ChannelSpec, SensorSuite, channel_widths, check_channel

_TIME_SLACK = 1e-9
_BLOCK = 64  # ticks of noise drawn, and of readings laid out, at a time
_COUNT = len(CHANNELS)
_ALL_MEASURED = (Validity.MEASURED,) * _COUNT
# As `Channel._make`, without a Python frame for each channel of each tick.
_channel = cast(
    "Callable[[Any], Channel]",
    functools.partial(tuple.__new__, Channel),  # pyright: ignore[reportUnknownMemberType]
)
# All numbers of a bank are one table, since compiled code takes long to receive an array. Its
# columns are the components and then the channels. First come the rows of the coefficients of
# every component: noise, offset, range, the low pass's weights of its state, the last input and
# the present one, the converter's step (zero for none) and last code, and the channel's number;
_SIGMA, _BIAS, _LOW, _HIGH, _KEEP, _BEFORE, _NOW, _STEP, _LAST, _OWNER = range(10)
# in the same rows the timing of every channel: a period of zero means every tick, the delay is in
# ticks, luck is this tick's draw, and due is when the next sample is [s];
_LAG, _PERIOD, _DROPOUT, _DELAY, _LUCK, _DUE = range(6)
# then the filters, the true values, the held samples of the last ticks, and the block of noise.
_FILTER, _INPUT, _RAW, _PAST = range(10, 14)
_NO_HISTORY = np.zeros(0)
_ORIENTATION = "orientation"
_WRENCH = ("arm_base_force", "arm_base_torque")
# Pitch and roll and the heading feed on the orientation. From the bank's end, where every robot's
# channels are alike: behind the inclinometer come wrench, accelerometer, gyro and heading.
_PITCH, _HEADING = 15, 1
# These are computed with the accelerations, one physics step before the tick.
_ACCELERATION_CHANNELS: tuple[str, ...] = ("arm_base_wrench", "accelerometer")


class SensorWiring(NamedTuple):
    """Where a robot's true values come from.

    Attributes:
        wires: (values, 4) for each value its place in the bank, where it or its first sample
            lies, and of those that MuJoCo keeps a history of, how far apart the samples lie and
            how many they are; 0 samples for a value of the present.
        orientation: Where the quaternion of the front half begins; -1 for none.
        missing: Channels without a sensor.
        lags: Age of the value at a tick by channel name [s].
    """

    wires: IndexArray
    orientation: int
    missing: tuple[str, ...]
    lags: dict[str, float]


def direct(widths: Mapping[str, int]) -> SensorWiring:
    """Return a wiring in which every value comes from where it goes.

    Args:
        widths: How many values each channel has.
    """
    rows = [(i, i, 0, 0) for i in range(sum(widths.values()))]
    return SensorWiring(np.array(rows, dtype=np.intp), -1, (), {})


def wire(model: mujoco.MjModel, prefix: str, robot: RobotDescription) -> SensorWiring:
    """Find a robot's sensors in the scene.

    Args:
        model: The scene.
        prefix: What the names of the robot's elements begin with.
        robot: Its description.
    """
    # MuJoCo sensors behind the channels, with their widths; orientation feeds the inclinometer and
    # the heading.
    sensors: dict[str, list[tuple[str, int]]] = {
        "wheel_speeds": [(f"{wheel}_vel", 1) for wheel in robot.wheel_names],
        "centre_angle": [("centre_pos", 1)],
        "arm_angles": [(f"{joint}_pos", 1) for joint in robot.joint_names],
        "arm_rates": [(f"{joint}_vel", 1) for joint in robot.joint_names],
        "inclinometer": [],
        "arm_base_wrench": [(name, 3) for name in _WRENCH],
        "accelerometer": [("accelerometer", 3)],
        "gyro": [("gyro", 3)],
        "heading": [],
    }
    wires: list[tuple[int, int, int, int]] = []
    missing: list[str] = []
    place = wrench = 0
    for channel, width in channel_widths(robot).items():
        starts = [_sensor(model, prefix + sensor) for sensor, _ in sensors[channel]]
        if min(starts, default=0) < 0 or width == 0:
            missing.append(channel)
        else:
            first = place
            for start, (_, part) in zip(starts, sensors[channel]):
                wires.extend((first + i, start + i, 0, 0) for i in range(part))
                first += part
        wrench = place if channel == "arm_base_wrench" else wrench
        place += width
    averaged, samples = _averaged_wrench(model, prefix, wrench)
    replaced = {row[0] for row in averaged}
    wires = [row for row in wires if row[0] not in replaced] + averaged
    orientation = _sensor(model, prefix + _ORIENTATION)
    if orientation < 0:
        missing.extend(("inclinometer", "heading"))
    step = float(model.opt.timestep)
    lags = dict.fromkeys(_ACCELERATION_CHANNELS, step)
    # A mean of n samples, the last of them a step old, stands for its middle.
    lags["arm_base_wrench"] = step * (1 + samples) / 2
    rows = np.array(wires, dtype=np.intp).reshape(-1, 4)
    return SensorWiring(rows, orientation, tuple(missing), lags)


def _sensor(model: mujoco.MjModel, name: str) -> int:
    """Return where a sensor's data begins, or -1 if the scene lacks it."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return int(model.sensor_adr[index]) if index >= 0 else -1


def _averaged_wrench(
    model: mujoco.MjModel, prefix: str, place: int
) -> tuple[list[tuple[int, int, int, int]], int]:
    """Return the wires of the wrench into MuJoCo's history, and how many samples that has.

    A force/torque transducer averages; one sample of a hundred a second would alias the steps of
    the motors' duty into the wrench. Without a history there are no wires, and one sample.
    """
    averaged: list[tuple[int, int, int, int]] = []
    count = 1
    width = 3
    for offset, sensor in zip((0, width), _WRENCH):
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, prefix + sensor)
        if index < 0 or model.sensor_history[index, 0] < 1:
            continue
        count = int(model.sensor_history[index, 0])
        # The buffer holds two words of book-keeping, the times, then the samples.
        first = int(model.sensor_historyadr[index]) + 2 + count
        averaged.extend((place + offset + i, first + i, width, count) for i in range(width))
    return averaged, count


@numba.njit(cache=True)
def tilt(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return pitch, roll and yaw [rad] of a body with orientation quaternion (w, x, y, z).

    Pitch is the elevation of the body's y axis (forward), roll the elevation of its x axis turned
    about y, yaw the azimuth of y: R = Rz(yaw) Rx(pitch) Ry(roll).
    """
    forward_up = 2.0 * (y * z + w * x)
    right_up = 2.0 * (x * z - w * y)
    up_up = w * w - x * x - y * y + z * z
    pitch = math.asin(max(-1.0, min(1.0, forward_up)))
    roll = math.atan2(-right_up, up_up)
    yaw = math.atan2(-2.0 * (x * y - w * z), w * w - x * x + y * y - z * z)
    return pitch, roll, yaw


@numba.njit(cache=True)
def gather(
    present: FloatArray,
    history: FloatArray,
    wires: IndexArray,
    orientation: int,
    raw: FloatArray,
) -> None:
    """Bring true values to their places, those with a history as its mean.

    Args:
        present: MuJoCo's sensordata.
        history: Its history.
        wires: Rows of wires, see `SensorWiring`.
        orientation: Place of the orientation, see `SensorWiring`.
        raw: (values,) receives them; what has no wire stays as it is.
    """
    for i in range(wires.shape[0]):
        place, first, stride, samples = wires[i, 0], wires[i, 1], wires[i, 2], wires[i, 3]
        if samples == 0:
            raw[place] = present[first]
            continue
        total = 0.0
        for sample in range(samples):
            total += history[first + sample * stride]
        raw[place] = total / samples
    if orientation >= 0:
        w, x, y, z = present[orientation : orientation + 4]
        pitch, heading = raw.size - _PITCH, raw.size - _HEADING
        raw[pitch], raw[pitch + 1], raw[heading] = tilt(w, x, y, z)


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
        state: Saved state of the channels.
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
        widths: Mapping[str, int],
        wiring: SensorWiring | None = None,
    ) -> None:
        """Lay the channels side by side.

        Args:
            suite: How each channel is measured.
            period: Servo tick [s].
            rng: Source of noise and dropout, owned by the bank from now on.
            widths: How many values each channel has, by name in contract order.
            wiring: Where the true values come from, and which channels lack them; None for values
                in the order of the channels.
        """
        self.names = CHANNELS
        self.size = sum(widths.values())
        # One tick's readings, and when each was taken: NumPy makes an item's views all in one call.
        self._reading = np.dtype(
            [(name, np.float64, (width,)) for name, width in widths.items()]
            + [(f"{name}_stamp", np.float64) for name in CHANNELS]
        )
        self._rng = rng
        wiring = wiring or direct(widths)
        self._wires, self._orientation = wiring.wires, wiring.orientation
        specs = [suite.channels.get(name, ChannelSpec()) for name in self.names]
        timing = _timing(specs, [wiring.lags.get(name, 0.0) for name in self.names], period)
        self._limits = [spec.age_limit + _TIME_SLACK for spec in specs]
        self._least_limit = min(self._limits)
        self._connected = [
            spec.connected and name not in wiring.missing for name, spec in zip(self.names, specs)
        ]
        # Noise is drawn in blocks; drop-outs are drawn between its rows, so then row by row.
        self._lossy = bool(np.any(timing[_DROPOUT] > 0.0))
        self._noise = np.zeros((1 if self._lossy else _BLOCK, self.size))
        self._depth = 1 + int(timing[_DELAY].max())
        self._table = np.zeros((_PAST + self._depth + len(self._noise), self.size + _COUNT))
        self._table[: _OWNER + 1, : self.size] = _chain(specs, list(widths.values()), period)
        self._table[: _LUCK + 1, self.size :] = timing
        self._noisy = bool(np.any(self._table[_SIGMA, : self.size] > 0.0))
        self._luck = self._table[_LUCK, self.size :]
        self._used, self._before_block = len(self._noise), {}
        self.reset()

    def reset(self) -> None:
        """Forget every sample; all channels are missing until the next `sample`."""
        filters, due, past = self._state()
        filters[0], filters[1], due[:], past[:] = math.nan, 0.0, -math.inf, math.nan
        self._show()

    def sample(self, time: float, present: FloatArray, history: FloatArray = _NO_HISTORY) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            present: What the wires are connected to; without wires (size,) true values in the
                order of the channels.
            history: What the wires with several samples are connected to.
        """
        if self._noisy:
            if self._used == len(self._noise):
                self._draw()
            self._used += 1
        if self._lossy:
            self._rng.random(out=self._luck)
        row = self._row + 1
        if row == _BLOCK:
            self._lay_out()
            row = 0
        self._row = row
        self._oldest = _advance(
            time,
            present,
            history,
            self._wires,
            self._orientation,
            self._table,
            self._depth,
            self._used,
            self._readings,
            row,
        )

    def _state(self) -> BankState:
        """Return the state, as views of the table."""
        table = self._table
        past = table[_PAST : _PAST + self._depth]
        return BankState(table[_FILTER : _INPUT + 1, : self.size], table[_DUE, self.size :], past)

    def _draw(self) -> None:
        """Draw the next block of noise."""
        self._before_block = dict(self._rng.bit_generator.state)
        self._table[_PAST + self._depth :, : self.size] = self._rng.standard_normal(out=self._noise)
        self._used = 0

    def _lay_out(self) -> None:
        """Make room for the next block of readings, which is written here and read-only outside."""
        self._block: Any = np.zeros(_BLOCK, self._reading)
        self._readings = self._block.view(np.float64).reshape(_BLOCK, -1)
        self._block.flags.writeable = False

    def _show(self) -> None:
        """Set what the channels read: the samples of as many ticks ago as each is late."""
        self._lay_out()
        self._row = 0
        self._oldest = _read(self._table, self._depth, self._readings[0])

    def channels(self, time: float) -> Iterable[Channel]:
        """Return every channel as it reads at `time` [s], read-only, in the order of `names`."""
        reading = self._block.item(self._row)
        stamps = reading[_COUNT:]
        if time - self._oldest <= self._least_limit and False not in self._connected:
            return map(_channel, zip(reading, stamps, _ALL_MEASURED))
        measured, stale = Validity.MEASURED, Validity.STALE
        return [
            (
                Channel(view, stamp, measured if time - stamp <= limit else stale)
                if connected and stamp == stamp
                else MISSING
            )
            for view, stamp, limit, connected in zip(reading, stamps, self._limits, self._connected)
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
        state = BankState(*(part.copy() for part in self._state()))
        left = self._used < len(self._noise)
        random = self._before_block if left else dict(self._rng.bit_generator.state)
        return SavedBank(state, tuple(self._connected), random, self._used)

    def restore(self, saved: SavedBank) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        for part, value in zip(self._state(), saved.state):
            part[:] = value
        self._connected = list(saved.connected)
        self._rng.bit_generator.state = dict(saved.random)
        if saved.used < len(self._noise):
            self._draw()
        self._used = saved.used
        self._show()


def _chain(specs: list[ChannelSpec], widths: list[int], period: float) -> FloatArray:
    """Return the coefficients of filter, noise, range and converter, (10, size)."""

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
def _read(table: FloatArray, depth: int, reading: FloatArray) -> float:
    """Write what each channel reads now, and return the oldest stamp; NaN if one is missing."""
    latest, oldest, size = _PAST + depth - 1, math.inf, table.shape[1] - _COUNT
    for channel in range(size, size + _COUNT):
        stamp = table[latest - int(table[_DELAY, channel]), channel]
        reading[channel] = stamp
        if stamp < oldest or math.isnan(stamp):
            oldest = stamp
    for i in range(size):
        channel = size + int(table[_OWNER, i])
        reading[i] = table[latest - int(table[_DELAY, channel]), i]
    return oldest


@numba.njit(cache=True)
def _advance(
    time: float,
    present: FloatArray,
    history: FloatArray,
    wires: IndexArray,
    orientation: int,
    table: FloatArray,
    depth: int,
    used: int,
    readings: FloatArray,
    row: int,
) -> float:
    """Filter, disturb, limit and quantise a sample, hold it where it arrives, and `_read`."""
    latest, size = _PAST + depth - 1, table.shape[1] - _COUNT
    gather(present, history, wires, orientation, table[_RAW, :size])
    raw, noise, held = table[_RAW], table[latest + used], table[latest]
    for tick in range(_PAST, latest):
        table[tick] = table[tick + 1]
    arrived = np.zeros(_COUNT, np.bool_)
    for channel in range(_COUNT):
        column = size + channel
        due = table[_DUE, column]
        if time < due - _TIME_SLACK:
            continue
        period = table[_PERIOD, column]
        if period > 0.0:
            # Counting from the due time keeps the mean rate when it does not divide the servo's.
            table[_DUE, column] = time + period if math.isinf(due) else max(due + period, time)
        if table[_LUCK, column] >= table[_DROPOUT, column]:
            arrived[channel] = True
            held[column] = time - table[_LAG, column]
    for i in range(size):
        if math.isnan(table[_FILTER, i]):
            table[_FILTER, i] = table[_INPUT, i] = raw[i]
        value = table[_KEEP, i] * table[_FILTER, i]
        value += table[_BEFORE, i] * table[_INPUT, i]
        value += table[_NOW, i] * raw[i]
        table[_FILTER, i], table[_INPUT, i] = value, raw[i]
        if not arrived[int(table[_OWNER, i])]:
            continue
        low, step = table[_LOW, i], table[_STEP, i]
        value += table[_BIAS, i] + table[_SIGMA, i] * noise[i]
        value = min(max(value, low), table[_HIGH, i])
        if step > 0.0:
            value = low + step * min(np.rint((value - low) / step), table[_LAST, i])
        held[i] = value
    return _read(table, depth, readings[row])
