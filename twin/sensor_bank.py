"""Measurements of a robot's sensors: one bank for all channels of a robot.

A sample goes through low-pass, scale and cross-talk, bias with its drift and white noise,
saturation, quantisation, sample-and-hold with dropout, and delay, in this order. A channel without
a present sample is missing or stale; it never reads zero instead. An inclinometer that refers to
specific force is low-passed at the rate of the physics, as its masses are shaken: sampled once a
tick, the shaking would be aliased.
"""

import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import mujoco
import numba
import numpy as np

from perception.geometry.arrays import FloatArray, IndexArray
from perception.geometry.gravity import GRAVITY
from twin.description import RobotDescription
from twin.robot import MISSING, Channel, Validity
from twin.sensors import (
    CHANNELS,
    MOST_CROSSED,
    ChannelSpec,
    SensorSuite,
    channel_widths,
    check_channel,
)

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
# the present one, the converter's step (zero for none) and last code, the channel's number, the
# range of apparent tilt of a sensor of specific force (zero for any other), the scale, the drift
# and its time constant, how many components show in this one (zero for none but itself), the place
# of the first of them, and the share of each;
_SIGMA, _BIAS, _LOW, _HIGH, _KEEP, _BEFORE, _NOW, _STEP, _LAST, _OWNER, _FORCE = range(11)
_SCALE, _DRIFT, _WARM_UP, _CROSSED, _FIRST, _CROSS = range(11, 17)
# in the same rows the timing of every channel: a period of zero means every tick, the delay is in
# ticks, luck is this tick's draw, and due is when the next sample is [s];
_LAG, _PERIOD, _DROPOUT, _DELAY, _LUCK, _DUE = range(6)
# then the filters, the true values, the held samples of the last ticks, and the block of noise.
_FILTER, _INPUT, _RAW, _PAST = range(_CROSS + MOST_CROSSED, _CROSS + MOST_CROSSED + 4)
_WRENCH = ("arm_base_force", "arm_base_torque")
_TILT = -1  # Samples of the wire that carries the orientation.
_TILT_FORCE = -2  # Samples of the wire that carries the specific force at the inclinometer.
_SAMPLES = 10  # Samples of that a servo tick.


class SensorWiring(NamedTuple):
    """Sources of a robot's true values.

    Attributes:
        wires: (wires, 4) for each value its place in the bank, the address of the value or of its
            first sample and, of those that MuJoCo keeps a history of, the distance of the samples
            and their number, 0 for a value of the present. One wire carries the front half's
            orientation: place of the pitch, address of the quaternion, place of the heading, -1.
            One carries the specific force at the inclinometer: place of the pitch, address of the
            first sample, number of the samples, -2.
        missing: Channels without a sensor.
        lags: Age of the value at a tick by channel name [s].
    """

    wires: IndexArray
    missing: Sequence[str]
    lags: Mapping[str, float]


def wire(model: mujoco.MjModel, robot: RobotDescription) -> SensorWiring:
    """Find a robot's sensors in the scene.

    A force/torque transducer averages; one sample of a hundred a second would alias the steps of
    the motors' duty into the wrench. So a sensor of forces or accelerations that has a history
    gives its mean.

    Args:
        model: Compiled scene.
        robot: Description of the robot; its elements' names begin with its own and a slash.
    """
    # MuJoCo sensors behind the channels, with their widths.
    sensors: dict[str, list[tuple[str, int]]] = {
        "wheel_speeds": [(f"{wheel}_vel", 1) for wheel in robot.wheel_names],
        "centre_angle": [("centre_pos", 1)],
        "arm_angles": [(f"{joint}_pos", 1) for joint in robot.joint_names],
        "arm_rates": [(f"{joint}_vel", 1) for joint in robot.joint_names],
        "arm_base_wrench": [(name, 3) for name in _WRENCH],
        "accelerometer": [("accelerometer", 3)],
        "gyro": [("gyro", 3)],
    }
    widths, step = channel_widths(robot), float(model.opt.timestep)
    places = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist()))
    # These are computed with the accelerations, one physics step before the tick.
    lags: dict[str, float] = {"arm_base_wrench": step, "accelerometer": step}
    wires: list[tuple[int, int, int, int]] = []
    missing: list[str] = []
    for channel, parts in sensors.items():
        indices = [_sensor(model, f"{robot.name}/{name}") for name, _ in parts]
        if not widths[channel] or min(indices) < 0:
            missing.append(channel)
            continue
        place = places[channel]
        for index, (_, width) in zip(indices, parts):
            first, samples = int(model.sensor_adr[index]), 0
            if channel in lags and model.sensor_history[index, 0] > 0:
                samples = int(model.sensor_history[index, 0])
                # The buffer holds two words of book-keeping, the times, then the samples.
                first = int(model.sensor_historyadr[index]) + 2 + samples
                # The last of the n samples is a step old; their mean is that of the middle.
                lags[channel] = step * (1 + samples) / 2
            wires.extend((place + i, first + i, width, samples) for i in range(width))
            place += width
    orientation = _sensor(model, f"{robot.name}/orientation")
    if orientation < 0:
        missing.extend(("inclinometer", "heading"))
    else:
        first = int(model.sensor_adr[orientation])
        wires.append((places["inclinometer"], first, places["heading"], _TILT))
    force = _sensor(model, f"{robot.name}/inclinometer")
    if force >= 0:
        samples = int(model.sensor_history[force, 0])
        first = int(model.sensor_historyadr[force]) + 2 + samples
        wires.append((places["inclinometer"], first, samples, _TILT_FORCE))
        lags["inclinometer"] = step
    return SensorWiring(np.array(wires, dtype=np.intp).reshape(-1, 4), missing, lags)


def _sensor(model: mujoco.MjModel, name: str) -> int:
    """Return the index of a sensor, or -1 if the scene lacks it."""
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)


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
def gather(present: FloatArray, history: FloatArray, wires: IndexArray, raw: FloatArray) -> None:
    """Copy true values to their places, those with a history as its mean.

    Args:
        present: Sensor data of MuJoCo.
        history: Sensor history of MuJoCo.
        wires: Rows of wires, see `SensorWiring`.
        raw: (values,) receives the values; one that has no wire stays as it is.
    """
    for i in range(wires.shape[0]):
        place, first, stride, samples = wires[i, 0], wires[i, 1], wires[i, 2], wires[i, 3]
        if samples == 0:
            raw[place] = present[first]
            continue
        if samples == _TILT_FORCE:
            continue
        if samples == _TILT:
            w, x, y, z = present[first : first + 4]
            raw[place], raw[place + 1], raw[stride] = tilt(w, x, y, z)
            continue
        total = 0.0
        for sample in range(samples):
            total += history[first + sample * stride]
        raw[place] = total / samples


class SavedBank(NamedTuple):
    """Complete state of a `SensorBank`, from which it continues bit for bit.

    Attributes:
        table: All numbers of the bank, among them the present block of noise.
        connected: True for each connected channel.
        random: State of the generator.
        used: Rows of the block that were used.
    """

    table: FloatArray
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
        wiring: SensorWiring,
    ) -> None:
        """Lay the channels side by side.

        Args:
            suite: Specification of each channel.
            period: Servo tick [s].
            rng: Random generator of noise and dropout, owned by the bank from now on.
            widths: Number of values of each channel, by name in contract order.
            wiring: Sources of the true values, and which channels lack them.
        """
        self.size = sum(widths.values())
        self._places = dict(zip(widths, np.cumsum([0, *widths.values()]).tolist()))
        # One tick's readings and their times: NumPy makes an item's views all in one call.
        self._reading = np.dtype(
            [(name, np.float64, (width,)) for name, width in widths.items()]
            + [(f"{name}_stamp", np.float64) for name in CHANNELS]
        )
        self._rng = rng
        self._wires = wiring.wires
        specs = [suite.channels.get(name, ChannelSpec()) for name in CHANNELS]
        missing, lags = set(wiring.missing), dict(wiring.lags)
        if suite.channels.get("inclinometer", ChannelSpec()).force_range is None:
            lags.pop("inclinometer", None)
        elif not np.any(wiring.wires[:, 3] == _TILT_FORCE):
            missing.add("inclinometer")
        timing = _timing(specs, [lags.get(name, 0.0) for name in CHANNELS], period)
        self._limits = [spec.age_limit + _TIME_SLACK for spec in specs]
        self._least_limit = min(self._limits)
        self._connected = [
            spec.connected and name not in missing for name, spec in zip(CHANNELS, specs)
        ]
        # Noise is drawn in blocks; drop-outs are drawn between its rows, so then row by row.
        self._lossy = bool(np.any(timing[_DROPOUT] > 0.0))
        self._noise = np.zeros((1 if self._lossy else _BLOCK, self.size))
        self._first = _PAST + 1 + int(timing[_DELAY].max())
        self._table = np.zeros((self._first + len(self._noise), self.size + _COUNT))
        self._table[:_FILTER, : self.size] = _chain(specs, list(widths.values()), period)
        self._table[: _LUCK + 1, self.size :] = timing
        self._noisy = bool(np.any(self._table[_SIGMA, : self.size] > 0.0))
        self._luck = self._table[_LUCK, self.size :]
        self._used = len(self._noise)
        self.reset()

    def reset(self) -> None:
        """Discard all samples; all channels are missing until the next `sample`."""
        self._table[_FILTER, : self.size] = math.nan
        self._table[_INPUT, : self.size] = 0.0
        self._table[_DUE, self.size :] = -math.inf
        self._table[_PAST : self._first] = math.nan
        self._show()

    def sample(self, time: float, present: FloatArray, history: FloatArray) -> None:
        """Take one sample of everything.

        Args:
            time: Robot time of this servo tick [s].
            present: True values at this tick that the wires lead from.
            history: Samples that the wires with a history lead from.
        """
        if self._noisy:
            if self._used == len(self._noise):
                self._table[self._first :, : self.size] = self._rng.standard_normal(out=self._noise)
                self._used = 0
            self._used += 1
        if self._lossy:
            self._rng.random(out=self._luck)
        row = self._row + 1
        if row == _BLOCK:
            self._lay_out()
            row = 0
        self._row = row
        self._oldest = _advance(
            time, present, history, self._wires, self._table, self._used, self._readings[row]
        )

    def _lay_out(self) -> None:
        """Allocate the next block of readings, which is written here and read-only outside."""
        self._block: Any = np.zeros(_BLOCK, self._reading)
        self._readings = list(self._block.view(np.float64).reshape(_BLOCK, -1))
        self._block.flags.writeable = False

    def _show(self) -> None:
        """Set the channels' readings: each channel's delayed sample."""
        self._lay_out()
        self._row = 0
        self._oldest = _read(self._table, self._readings[0])

    def channels(self, time: float) -> Iterable[Channel]:
        """Return every channel as it reads at `time` [s], read-only, in the order of `CHANNELS`."""
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

    def drift(self, name: str, number: int, by: float) -> None:
        """Let a zero drift, for good.

        Args:
            name: Name of the channel.
            number: Which of its numbers.
            by: What is read too much from now on, in the channel's unit.
        """
        check_channel(name)
        self._table[_BIAS, self._places[name] + number] += by

    def stick(self, name: str, number: int, at: float) -> None:
        """Let a sensor stick, for good: but for its noise it reads the same from now on.

        Args:
            name: Name of the channel.
            number: Which of its numbers.
            at: What it reads, in the channel's unit.
        """
        check_channel(name)
        column = self._places[name] + number
        self._table[[_SCALE, _DRIFT, _CROSSED], column] = 0.0
        self._table[_BIAS, column] = at

    def disconnect(self, name: str) -> None:
        """Disconnect a sensor, as a broken wire does; its channel is missing from now on."""
        check_channel(name)
        self._connected[CHANNELS.index(name)] = False

    def connect(self, name: str) -> None:
        """Connect a sensor again."""
        check_channel(name)
        self._connected[CHANNELS.index(name)] = True

    def save(self) -> SavedBank:
        """Return the complete state."""
        random = dict(self._rng.bit_generator.state)
        return SavedBank(self._table.copy(), tuple(self._connected), random, self._used)

    def restore(self, saved: SavedBank) -> None:
        """Go back to a saved state of this bank, bit for bit."""
        self._table[:] = saved.table
        self._connected = list(saved.connected)
        self._rng.bit_generator.state = dict(saved.random)
        self._used = saved.used
        self._show()


def _chain(specs: list[ChannelSpec], widths: list[int], period: float) -> FloatArray:
    """Return the coefficients of every component, (`_FILTER`, size)."""
    columns: list[FloatArray] = []
    place = 0
    for owner, (spec, width) in enumerate(zip(specs, widths)):
        levels = 2.0 ** (spec.bits or 0)
        step = np.subtract(spec.high, spec.low) / levels if spec.bits else 0.0
        force = spec.force_range or 0.0
        weights = _low_pass(spec.bandwidth, period / _SAMPLES if force else period)
        offsets, converter = (spec.noise, spec.bias, spec.low, spec.high), (step, levels - 1.0)
        crossed = len(spec.cross or ())
        if crossed not in (0, width):
            raise ValueError(
                f"sensor {CHANNELS[owner]}: cross has {crossed} rows, needs {width} or None"
            )
        rows = (*offsets, *weights, *converter, owner, force)
        rows += (spec.scale, spec.drift, spec.warm_up, crossed, place)
        column = np.zeros((_FILTER, width))
        column[:_CROSS] = [np.broadcast_to(row, (width,)) for row in rows]
        if spec.cross:
            column[_CROSS : _CROSS + crossed] = np.transpose(spec.cross)
        columns.append(column)
        place += width
    return np.concatenate(columns, axis=1)


def _timing(specs: list[ChannelSpec], lags: list[float], period: float) -> FloatArray:
    """Return the channels' lags, periods, dropouts, delays and luck, (5, channels)."""
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
        period: Time between samples [s].
    """
    if bandwidth is None:
        return 0.0, 0.0, 1.0
    decay = 2.0 * math.pi * bandwidth * period
    keep = math.exp(-decay)
    mean = (1.0 - keep) / decay
    return keep, mean - keep, 1.0 - mean


@numba.njit(cache=True)
def _read(table: FloatArray, reading: FloatArray) -> float:
    """Write each channel's reading, and return the oldest stamp; NaN if one is missing."""
    oldest, size = math.inf, table.shape[1] - _COUNT
    latest = _PAST + int(table[_DELAY, size:].max())
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
def _feel(history: FloatArray, wire: IndexArray, table: FloatArray) -> None:
    """Low-pass the apparent tilt in the specific force since the last tick.

    Along the axes of the sensor g sin(pitch) and -g cos(pitch) sin(roll) are felt at rest, and any
    acceleration beside them.

    Args:
        history: Sensor history of MuJoCo.
        wire: The wire of the specific force, see `SensorWiring`.
        table: The bank's.
    """
    pitch_place, first, samples = wire[0], wire[1], wire[2]
    most = math.sin(table[_FORCE, pitch_place])
    # A ring, whose latest sample's index stands before the stamps.
    latest = int(history[first - samples - 1])
    for sample in range(1, samples + 1):
        at = first + 3 * ((latest + sample) % samples)
        pitch = math.asin(min(max(history[at + 1] / GRAVITY, -most), most))
        across = -history[at] / (GRAVITY * math.cos(pitch))
        roll = math.asin(min(max(across, -most), most))
        for i, angle in ((pitch_place, pitch), (pitch_place + 1, roll)):
            if math.isnan(table[_FILTER, i]):
                table[_FILTER, i] = table[_INPUT, i] = angle
            table[_FILTER, i] = _filtered(table, i, angle)
            table[_INPUT, i] = angle


@numba.njit(cache=True, inline="always")
def _filtered(table: FloatArray, i: int, value: float) -> float:
    """Return the low pass's next state of component i."""
    kept = table[_KEEP, i] * table[_FILTER, i] + table[_BEFORE, i] * table[_INPUT, i]
    return kept + table[_NOW, i] * value


@numba.njit(cache=True)
def _advance(
    time: float,
    present: FloatArray,
    history: FloatArray,
    wires: IndexArray,
    table: FloatArray,
    used: int,
    reading: FloatArray,
) -> float:
    """Filter, disturb, limit and quantise a sample, hold it where it arrives, and `_read`."""
    size = table.shape[1] - _COUNT
    latest = _PAST + int(table[_DELAY, size:].max())
    gather(present, history, wires, table[_RAW, :size])
    for i in range(wires.shape[0]):
        if wires[i, 3] == _TILT_FORCE and table[_FORCE, wires[i, 0]] > 0.0:
            _feel(history, wires[i], table)
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
        if table[_FORCE, i] == 0.0:
            if math.isnan(table[_FILTER, i]):
                table[_FILTER, i] = table[_INPUT, i] = raw[i]
            table[_FILTER, i] = _filtered(table, i, raw[i])
            table[_INPUT, i] = raw[i]
    for i in range(size):
        if not arrived[int(table[_OWNER, i])]:
            continue
        value = table[_SCALE, i] * table[_FILTER, i]
        for j in range(int(table[_CROSSED, i])):
            value += table[_CROSS + j, i] * table[_FILTER, int(table[_FIRST, i]) + j]
        low, step = table[_LOW, i], table[_STEP, i]
        value += table[_BIAS, i] + table[_SIGMA, i] * noise[i]
        if table[_DRIFT, i] != 0.0:
            value -= table[_DRIFT, i] * math.expm1(-time / table[_WARM_UP, i])
        value = min(max(value, low), table[_HIGH, i])
        if step > 0.0:
            value = low + step * min(np.rint((value - low) / step), table[_LAST, i])
        held[i] = value
    return _read(table, reading)
