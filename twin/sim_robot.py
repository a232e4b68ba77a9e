"""A robot of the contract over a MuJoCo scene."""

from __future__ import annotations

import dataclasses
import math

import mujoco
import numba
import numpy as np
from numpy.typing import NDArray

from twin.robot import (
    ARM_JOINTS,
    WHEELS,
    Channel,
    Command,
    FloatArray,
    Lifecycle,
    Observation,
    RobotError,
)
from twin.sensor_bank import SavedBank, SensorBank
from twin.sensors import CHANNEL_OFFSETS, SensorSuite
from twin.servo import Servo, ServoConfig

IntArray = NDArray[np.intp]
AXES = (*WHEELS, *ARM_JOINTS)
_AT_REST = Command()

# MuJoCo sensors behind the channels, with their widths; orientation feeds the inclinometer and
# the heading.
_SENSORS: dict[str, tuple[tuple[str, int], ...]] = {
    "wheel_speeds": tuple((f"{wheel}_vel", 1) for wheel in WHEELS),
    "centre_angle": (("centre_pos", 1),),
    "arm_angles": tuple((f"{joint}_pos", 1) for joint in ARM_JOINTS),
    "arm_rates": tuple((f"{joint}_vel", 1) for joint in ARM_JOINTS),
    "arm_base_wrench": (("arm_base_force", 3), ("arm_base_torque", 3)),
    "accelerometer": (("accelerometer", 3),),
    "gyro": (("gyro", 3),),
}
_ORIENTATION = ("orientation", 4)
_PITCH = CHANNEL_OFFSETS["inclinometer"]
_HEADING = CHANNEL_OFFSETS["heading"]
# These are computed with the accelerations, one physics step before the tick.
_ACCELERATION_CHANNELS: tuple[str, ...] = ("arm_base_wrench", "accelerometer")


@dataclasses.dataclass(frozen=True)
class RobotState:
    """Complete state of a `SimRobot` beside the physics."""

    lifecycle: Lifecycle
    bank: SavedBank
    servo: FloatArray
    held: Command
    duty: FloatArray
    driven: bool
    observation: Observation


class SimRobot:
    """One rover of a scene; made by `twin.simulation.Simulation`, which steps it."""

    def __init__(
        self,
        name: str,
        prefix: str,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        suite: SensorSuite,
        servo: ServoConfig,
        period: float,
        rng: np.random.Generator,
    ) -> None:
        """Find the robot's actuators and sensors in the scene.

        Args:
            name: Robot name, as controllers see it.
            prefix: What its elements' names begin with in the scene.
            model: The scene.
            data: The scene's state, shared with the simulation.
            suite: How its sensors measure.
            servo: Its motors and gains.
            period: Servo tick [s].
            rng: Source of sensor noise.

        Raises:
            ValueError: If an actuator is not in the scene.
        """
        self.name = name
        self._lifecycle = Lifecycle.UNCONFIGURED
        axes = np.array([_actuator(model, prefix + axis) for axis in AXES])
        # Side by side as a rule; a slice is written faster than single places.
        row = np.array_equal(axes, axes[0] + np.arange(len(axes)))
        self._axes = slice(int(axes[0]), int(axes[-1]) + 1) if row else axes
        self._volts = np.array(model.actuator_ctrlrange[axes, 1], dtype=float)
        self._ctrl = data.ctrl
        self._sensordata = data.sensordata
        self._wires, missing = _wire(model, prefix)
        self._orientation = _sensor(model, prefix + _ORIENTATION[0])
        self._history = data.history
        self._averaged, samples = _averaged_wrench(model, prefix)
        step = float(model.opt.timestep)
        lags = dict.fromkeys(_ACCELERATION_CHANNELS, step)
        # A mean of n samples, the last of them a step old, stands for its middle.
        lags["arm_base_wrench"] = step * (1 + samples) / 2
        self._bank = SensorBank(suite, period, rng, lags)
        for channel in missing:
            self._bank.disconnect(channel)
        self._raw = np.zeros(self._bank.size)
        self._servo = Servo(servo, period)
        self._held = _AT_REST
        self._duty = np.zeros(8)
        self._driven = False
        self._observation = Observation(0.0)

    @property
    def lifecycle(self) -> Lifecycle:
        """Current state."""
        return self._lifecycle

    def configure(self, time: float) -> None:
        """Take the first samples and go to INACTIVE, with all axes at zero; the owner calls it."""
        self._bank.reset()
        self._zero()
        self._lifecycle = Lifecycle.INACTIVE
        self.sense(time)

    def close(self) -> None:
        """Zero all axes and go to UNCONFIGURED: the scene is gone."""
        self._zero()
        self._lifecycle = Lifecycle.UNCONFIGURED

    def activate(self) -> None:
        """Go to ACTIVE, from INACTIVE or, explicitly, from ERROR.

        Raises:
            RobotError: If the robot is not configured.
        """
        if self._lifecycle is Lifecycle.UNCONFIGURED:
            raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be activated")
        if self._lifecycle is not Lifecycle.ACTIVE:
            self._zero()
            self._lifecycle = Lifecycle.ACTIVE

    def deactivate(self) -> None:
        """Zero all axes and go to INACTIVE; an ERROR stays until `activate` ends it."""
        self._zero()
        if self._lifecycle is Lifecycle.ACTIVE:
            self._lifecycle = Lifecycle.INACTIVE

    def observe(self) -> Observation:
        """Return what was measured at the latest servo tick.

        Raises:
            RobotError: If the robot is not configured.
        """
        if self._lifecycle is Lifecycle.UNCONFIGURED:
            raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be read")
        return self._observation

    def command(self, command: Command) -> Command:
        """Drive until the next command, and return what is applied, as duty, after limits.

        Args:
            command: What is asked for.

        Raises:
            RobotError: If the robot is not ACTIVE, or a channel that the mode needs is not usable;
                then it is in ERROR.
        """
        if self._lifecycle is not Lifecycle.ACTIVE:
            self._zero()
            raise RobotError(f"robot {self.name!r} is {self._lifecycle.value}, not active")
        self._held = command
        self._apply()
        return Command(self._duty[:4], self._duty[4:])

    def fail(self, reason: str) -> RobotError:
        """Zero all axes, go to ERROR, and return the error to raise."""
        self._zero()
        self._lifecycle = Lifecycle.ERROR
        return RobotError(f"robot {self.name!r}: {reason}; all axes are zeroed")

    def disconnect_sensor(self, channel: str) -> None:
        """Break a sensor's wire: the channel is missing from the next tick on.

        Raises:
            ValueError: If there is no such channel.
        """
        self._bank.disconnect(channel)

    def reconnect_sensor(self, channel: str) -> None:
        """Mend a sensor's wire.

        Raises:
            ValueError: If there is no such channel.
        """
        self._bank.connect(channel)

    def drive(self) -> None:
        """Bring the held command to the motors for one servo tick; the owner calls it.

        Raises:
            RobotError: As `command`.
        """
        if self._lifecycle is Lifecycle.ACTIVE and not self._driven:
            self._apply()
        self._driven = False

    def sense(self, time: float) -> None:
        """Sample all sensors at `time` [s], the end of a servo tick; the owner calls it."""
        raw = self._raw
        _gather(
            self._sensordata,
            self._wires,
            self._orientation,
            self._history,
            self._averaged,
            raw,
        )
        self._bank.sample(time, raw)
        channels = self._bank.channels(time)
        self._observation = Observation._make((time, *channels, self._observation.stereo))

    def see(self, stereo: Channel) -> None:
        """Take a new stereo pair; the owner calls it."""
        self._observation = self._observation._replace(stereo=stereo)

    def save(self) -> RobotState:
        """Return the complete state beside the physics."""
        return RobotState(
            self._lifecycle,
            self._bank.save(),
            self._servo.save(),
            self._held,
            self._duty.copy(),
            self._driven,
            self._observation,
        )

    def restore(self, state: RobotState) -> None:
        """Go back to a saved state."""
        self._lifecycle = state.lifecycle
        self._bank.restore(state.bank)
        self._servo.restore(state.servo)
        self._held, self._duty = state.held, state.duty.copy()
        self._driven, self._observation = state.driven, state.observation

    def _apply(self) -> None:
        """Let the servo act once, and write the duty to the motors."""
        try:
            self._duty = self._servo.duty(self._held, self._observation)
        except RobotError as error:
            raise self.fail(str(error)) from error
        self._duty.flags.writeable = False
        self._ctrl[self._axes] = self._duty * self._volts
        self._driven = True

    def _zero(self) -> None:
        self._held = _AT_REST
        self._duty = np.zeros(8)
        self._ctrl[self._axes] = 0.0
        self._servo.reset()
        self._driven = False


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


def _actuator(model: mujoco.MjModel, name: str) -> int:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if index < 0:
        valid = ", ".join(model.actuator(i).name for i in range(model.nu)) or "none"
        raise ValueError(f"the scene has no actuator {name!r}; it has: {valid}")
    return index


def _sensor(model: mujoco.MjModel, name: str) -> int:
    """Return where a sensor's data begins, or -1 if the scene lacks it."""
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return int(model.sensor_adr[index]) if index >= 0 else -1


@numba.njit(cache=True)
def _gather(
    sensordata: FloatArray,
    wires: IntArray,
    orientation: int,
    history: FloatArray,
    averaged: IntArray,
    raw: FloatArray,
) -> None:
    """Bring MuJoCo's sensors to their places in `raw`, those with a history as its mean."""
    for i in range(wires.shape[1]):
        raw[wires[1, i]] = sensordata[wires[0, i]]
    if orientation >= 0:
        w, x, y, z = sensordata[orientation : orientation + 4]
        raw[_PITCH], raw[_PITCH + 1], raw[_HEADING] = tilt(w, x, y, z)
    for place, first, width, samples in averaged:
        for i in range(width):
            total = 0.0
            for sample in range(samples):
                total += history[first + sample * width + i]
            raw[place + i] = total / samples


def _averaged_wrench(model: mujoco.MjModel, prefix: str) -> tuple[IntArray, int]:
    """Return where the wrench goes and where its latest samples lie in MuJoCo's history.

    A force/torque transducer averages; one sample of a hundred a second would alias the steps of
    the motors' duty into the wrench. The rows are the first component's place, the first sample's,
    the number of components and that of samples. Also returns the number of samples, 1 without a
    history.
    """
    averaged: list[tuple[int, int, int, int]] = []
    count = 1
    place = CHANNEL_OFFSETS["arm_base_wrench"]
    for offset, (sensor, width) in zip((0, 3), _SENSORS["arm_base_wrench"]):
        index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, prefix + sensor)
        if index < 0 or model.sensor_history[index, 0] < 1:
            continue
        count = int(model.sensor_history[index, 0])
        # The buffer holds two words of book-keeping, the times, then the samples.
        first = int(model.sensor_historyadr[index]) + 2 + count
        averaged.append((place + offset, first, width, count))
    return np.array(averaged, dtype=np.intp).reshape(-1, 4), count


def _wire(model: mujoco.MjModel, prefix: str) -> tuple[IntArray, list[str]]:
    """Return places in sensordata and below them those in the bank, and what has no sensor."""
    source: list[int] = []
    into: list[int] = []
    missing: list[str] = []
    for channel, parts in _SENSORS.items():
        place = CHANNEL_OFFSETS[channel]
        starts = [_sensor(model, prefix + sensor) for sensor, _ in parts]
        if min(starts) < 0:
            missing.append(channel)
            continue
        for start, (_, width) in zip(starts, parts):
            source.extend(range(start, start + width))
            into.extend(range(place, place + width))
            place += width
    if _sensor(model, prefix + _ORIENTATION[0]) < 0:
        missing.extend(("inclinometer", "heading"))
    return np.array([source, into], dtype=np.intp), missing
