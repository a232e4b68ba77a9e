"""A robot of the contract over a MuJoCo scene."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, cast

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.robot import Channel, Command, Lifecycle, Observation, RobotError, applied_command
from twin.sensor_bank import SavedBank, SensorBank
from twin.sensors import SensorSuite, channel_widths
from twin.servo import Servo, ServoConfig
from twin.wiring import wire

_AT_REST = Command()
_ACTIVE, _UNCONFIGURED = Lifecycle.ACTIVE, Lifecycle.UNCONFIGURED
# As `Observation._make`, without its Python frame.
_observation = cast(
    "Callable[[Any], Observation]",
    functools.partial(tuple.__new__, Observation),  # pyright: ignore[reportUnknownMemberType]
)


@dataclasses.dataclass(frozen=True)
class RobotState:
    """Complete state of a `SimRobot` beside the physics."""

    lifecycle: Lifecycle
    bank: SavedBank
    servo: FloatArray
    held: Command
    duty: tuple[FloatArray, FloatArray]
    driven: bool
    observation: Observation


class SimRobot:
    """One rover of a scene; made by `twin.simulation.Simulation`, which steps it."""

    def __init__(
        self,
        description: RobotDescription,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        suite: SensorSuite,
        servo: ServoConfig,
        period: float,
        rng: np.random.Generator,
    ) -> None:
        """Find the robot's actuators and sensors in the scene.

        Args:
            description: The robot as drawn; its elements' names begin with its own and a slash.
            model: The scene.
            data: The scene's state, shared with the simulation.
            suite: How its sensors measure.
            servo: Its motors and gains.
            period: Servo tick [s].
            rng: Source of sensor noise.

        Raises:
            ValueError: If an actuator is not in the scene.
        """
        self.name, self.description = description.name, description
        prefix = f"{description.name}/"
        # Read by anybody, set by the robot alone: a property takes long in a loop.
        self.lifecycle = Lifecycle.UNCONFIGURED
        axes = np.array([_actuator(model, prefix + axis) for axis in description.axes])
        self._axes = axes
        self._ctrl = data.ctrl
        volts = np.array(model.actuator_ctrlrange[axes, 1], dtype=float)
        # Side by side as a rule: then the servo writes where the motors read.
        row = np.array_equal(axes, axes[0] + np.arange(len(axes)))
        motors = data.ctrl[int(axes[0]) : int(axes[-1]) + 1] if row else None
        self._servo = Servo(servo, period, volts, motors)
        self._scattered = not row
        self._sensordata = data.sensordata
        self._history = data.history
        self._bank = SensorBank(
            suite, period, rng, channel_widths(description), wire(model, prefix, description)
        )
        self._held = _AT_REST
        rest = np.zeros(len(axes))
        rest.flags.writeable = False
        self._rest = rest[: len(description.wheels)], rest[len(description.wheels) :]
        self._duty = self._rest
        self._driven = False
        self._observation = Observation(0.0)

    def configure(self, time: float) -> None:
        """Take the first samples and go to INACTIVE, with all axes at zero; the owner calls it."""
        self._bank.reset()
        self._zero()
        self.lifecycle = Lifecycle.INACTIVE
        self.sense(time)

    def close(self) -> None:
        """Zero all axes and go to UNCONFIGURED: the scene is gone."""
        self._zero()
        self.lifecycle = Lifecycle.UNCONFIGURED

    def activate(self) -> None:
        """Go to ACTIVE, from INACTIVE or, explicitly, from ERROR.

        Raises:
            RobotError: If the robot is not configured.
        """
        if self.lifecycle is Lifecycle.UNCONFIGURED:
            raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be activated")
        if self.lifecycle is not Lifecycle.ACTIVE:
            self._zero()
            self.lifecycle = Lifecycle.ACTIVE

    def deactivate(self) -> None:
        """Zero all axes and go to INACTIVE; an ERROR stays until `activate` ends it."""
        self._zero()
        if self.lifecycle is Lifecycle.ACTIVE:
            self.lifecycle = Lifecycle.INACTIVE

    def observe(self) -> Observation:
        """Return what was measured at the latest servo tick.

        Raises:
            RobotError: If the robot is not configured.
        """
        if self.lifecycle is _UNCONFIGURED:
            raise RobotError(f"robot {self.name!r} is unconfigured; it cannot be read")
        return self._observation

    def command(self, command: Command) -> Command:
        """Drive until the next command, and return what is applied, as duty, after limits.

        Args:
            command: What is asked for.

        Raises:
            RobotError: If the robot is not ACTIVE, or a channel that the mode needs is not usable;
                then it is in ERROR.
            ValueError: If the command has another number of axes than the robot, or a duty comes
                to no number; all axes are zeroed.
        """
        if self.lifecycle is not _ACTIVE:
            self._zero()
            raise RobotError(f"robot {self.name!r} is {self.lifecycle.value}, not active")
        self._held = command
        self._apply()
        return applied_command(*self._duty)

    def fail(self, reason: str) -> RobotError:
        """Zero all axes, go to ERROR, and return the error to raise."""
        self._zero()
        self.lifecycle = Lifecycle.ERROR
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
        if not self._driven and self.lifecycle is _ACTIVE:
            self._apply()
        self._driven = False

    def sense(self, time: float) -> None:
        """Sample all sensors at `time` [s], the end of a servo tick; the owner calls it."""
        self._bank.sample(time, self._sensordata, self._history)
        channels = self._bank.channels(time)
        self._observation = _observation((time, *channels, self._observation.stereo))

    def see(self, stereo: Channel) -> None:
        """Take a new stereo pair; the owner calls it."""
        self._observation = self._observation._replace(stereo=stereo)

    def save(self) -> RobotState:
        """Return the complete state beside the physics."""
        return RobotState(
            self.lifecycle,
            self._bank.save(),
            self._servo.save(),
            self._held,
            self._duty,
            self._driven,
            self._observation,
        )

    def restore(self, state: RobotState) -> None:
        """Go back to a saved state."""
        self.lifecycle = state.lifecycle
        self._bank.restore(state.bank)
        self._servo.restore(state.servo)
        self._held, self._duty = state.held, state.duty
        self._driven, self._observation = state.driven, state.observation

    def _apply(self) -> None:
        """Let the servo act once, and write the duty to the motors."""
        try:
            self._duty = self._servo.drive(self._held, self._observation)
        except RobotError as error:
            raise self.fail(str(error)) from error
        except ValueError:
            self._zero()
            raise
        if self._scattered:
            self._ctrl[self._axes] = self._servo.motors
        self._driven = True

    def _zero(self) -> None:
        self._held = _AT_REST
        self._duty = self._rest
        self._ctrl[self._axes] = 0.0
        self._servo.reset()
        self._driven = False


def _actuator(model: mujoco.MjModel, name: str) -> int:
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, name)
    if index < 0:
        valid = ", ".join(model.actuator(i).name for i in range(model.nu)) or "none"
        raise ValueError(f"the scene has no actuator {name!r}; it has: {valid}")
    return index
