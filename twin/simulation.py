"""One MuJoCo scene stepped for several robots, each of which keeps the contract.

A servo tick is ordered so that position and velocity sensors are read at the tick itself and
nothing is computed twice: the second half of a physics step with the new motor voltages, whole
steps, and the first half of the next one. Force and acceleration sensors come out of the last
whole step, one physics step earlier, and carry that time stamp.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import mujoco
import numpy as np

from models.ground_friction import TYRE, TyreFriction
from perception.geometry.arrays import FloatArray
from twin.camera import StereoConfig, StereoHead, StereoState, named_index
from twin.describe import describe_rover
from twin.description import RobotDescription
from twin.robot import Channel, Command, Lifecycle, Observation, RobotError, applied_command
from twin.sensor_bank import SavedBank, SensorBank, wire
from twin.sensors import DATASHEET, SensorSuite, channel_widths
from twin.servo import SERVO_PERIOD, Servo, ServoConfig
from twin.taken_load import TakenLoad

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
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
    fault: str
    bank: SavedBank
    servo: FloatArray
    held: Command
    duty: tuple[FloatArray, FloatArray]
    driven: bool
    observation: Observation


class SimRobot:
    """One rover of a scene; made by `Simulation`, which steps it.

    Attributes:
        fault: Reason for the state ERROR; empty in the other states.
        sensors: Sensors of the robot, whose wires may be broken.
    """

    def __init__(
        self,
        description: RobotDescription,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        suite: SensorSuite,
        servo: ServoConfig,
        rng: np.random.Generator,
    ) -> None:
        """Find the robot's actuators and sensors in the scene.

        Args:
            description: Robot as drawn; its elements' names begin with its own and a slash.
            model: Compiled scene.
            data: State of the scene, shared with the simulation.
            suite: Specification of the sensors.
            servo: Motors and gains.
            rng: Random generator of the sensor noise.

        Raises:
            ValueError: If an actuator is not in the scene.
        """
        self.name, self.description = description.name, description
        prefix = f"{description.name}/"
        # Read by anybody, set by the robot alone: a property takes long in a loop.
        self.lifecycle = Lifecycle.UNCONFIGURED
        self.fault = ""
        axes = self._axes = np.array(
            [named_index(model, "actuator", prefix + axis) for axis in description.axes]
        )
        self._ctrl = data.ctrl
        volts = np.array(model.actuator_ctrlrange[axes, 1], dtype=float)
        # Side by side as a rule: then the servo writes where the motors read.
        row = np.array_equal(axes, axes[0] + np.arange(len(axes)))
        motors = data.ctrl[int(axes[0]) : int(axes[-1]) + 1] if row else None
        self._servo = Servo(servo, SERVO_PERIOD, volts, motors)
        self._scattered = not row
        self._sensordata = data.sensordata
        self._history = data.history
        self.sensors = SensorBank(
            suite, SERVO_PERIOD, rng, channel_widths(description), wire(model, description)
        )
        self._held = _AT_REST
        rest = np.zeros(len(axes))
        rest.flags.writeable = False
        self._rest = rest[: len(description.wheels)], rest[len(description.wheels) :]
        self._duty = self._rest
        self._driven = False
        self._observation = Observation(0.0)

    def weaken(self, axis: str, share: float) -> None:
        """Take a share of a motor's voltage, for good; the robot does not know.

        Args:
            axis: Name of the axis.
            share: What is lost of what it got, 0 to 1.
        """
        self._servo.weaken(self.description.axes.index(axis), share)

    def configure(self, time: float) -> None:
        """Take the first samples and go to INACTIVE, with all axes at zero; the owner calls it."""
        self.sensors.reset()
        self._zero()
        self.lifecycle = Lifecycle.INACTIVE
        self.sense(time)

    def close(self) -> None:
        """Zero all axes and go to UNCONFIGURED."""
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
            self.fault = ""
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

        Whatever is raised, all axes are at zero first, and an ACTIVE robot is in ERROR.

        Args:
            command: Desired duty, effort, rate or position.

        Raises:
            RobotError: If the robot is not ACTIVE, or a channel that the mode needs is not usable.
            ValueError: If the command has another number of axes than the robot.
        """
        if self.lifecycle is not _ACTIVE:
            self._zero()
            reason = f": {self.fault}" if self.fault else ""
            raise RobotError(f"robot {self.name!r} is {self.lifecycle.value}, not active{reason}")
        self._held = command
        self._apply()
        return applied_command(*self._duty)

    def fail(self, reason: str) -> RobotError:
        """Zero all axes, go to ERROR, and return the error to raise."""
        self._zero()
        self.lifecycle = Lifecycle.ERROR
        self.fault = reason
        return RobotError(f"robot {self.name!r}: {reason}; all axes are at zero")

    def drive(self) -> None:
        """Apply the present command to the motors for one servo tick; the owner calls it.

        Raises:
            RobotError: As `command`.
        """
        if not self._driven and self.lifecycle is _ACTIVE:
            self._apply()
        self._driven = False

    def sense(self, time: float) -> None:
        """Sample all sensors at `time` [s], the end of a servo tick; the owner calls it."""
        self.sensors.sample(time, self._sensordata, self._history)
        channels = self.sensors.channels(time)
        self._observation = _observation((time, *channels, self._observation.stereo))

    def see(self, stereo: Channel) -> None:
        """Store a new stereo pair; the owner calls it."""
        self._observation = self._observation._replace(stereo=stereo)

    def save(self) -> RobotState:
        """Return the complete state beside the physics."""
        return RobotState(
            self.lifecycle,
            self.fault,
            self.sensors.save(),
            self._servo.save(),
            self._held,
            self._duty,
            self._driven,
            self._observation,
        )

    def restore(self, state: RobotState) -> None:
        """Go back to a saved state."""
        self.lifecycle, self.fault = state.lifecycle, state.fault
        self.sensors.restore(state.bank)
        self._servo.restore(state.servo)
        self._held, self._duty = state.held, state.duty
        self._driven, self._observation = state.driven, state.observation

    def _apply(self) -> None:
        """Let the servo act once, and write the duty to the motors."""
        try:
            self._duty = self._servo.drive(self._held, self._observation)
        except RobotError as error:
            raise self.fail(str(error)) from error
        except BaseException as error:
            self.fail(f"{type(error).__name__}: {error}")
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


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """Complete state of a `Simulation`, from which it continues bit for bit."""

    physics: FloatArray
    sensordata: FloatArray
    robots: Mapping[str, RobotState]
    heads: Mapping[str, StereoState]


class Simulation:
    """Physics, robots and their sensors, advanced one servo tick at a time."""

    def __init__(
        self,
        model: mujoco.MjModel,
        robots: Sequence[str | RobotDescription],
        *,
        suite: SensorSuite | Sequence[SensorSuite] = DATASHEET,
        servo: ServoConfig | None = None,
        stereo: StereoConfig | None = None,
        seed: int = 0,
        data: mujoco.MjData | None = None,
        loads: Sequence[TakenLoad] = (),
    ) -> None:
        """Find the robots in the scene, and configure them at rest.

        Args:
            model: Compiled scene.
            robots: Robots as drawn; a name is that of a rover of the thesis.
            suite: Specification of the sensors, of all robots or of each in their order.
            servo: Motors and gains of the robots; None for the motors of each description.
            stereo: Properties of the stereo heads; None leaves the channel missing, as
                does a scene without their cameras.
            seed: Random seed of all noise; one seed gives one run, bit for bit.
            data: State of the scene, if another owner (dm_control) holds it.
            loads: Payloads that grippers take in the course of the run.

        Raises:
            ValueError: If an actuator is missing, the tick is no multiple of the physics step, or
                the integrator cannot be split.
        """
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError("the RK4 integrator cannot be split; use implicitfast or Euler")
        self.period, step = SERVO_PERIOD, float(model.opt.timestep)
        self.substeps = round(self.period / step)
        if self.substeps < 1 or not math.isclose(self.substeps * step, self.period):
            raise ValueError(
                f"servo period {self.period} s is no multiple of the physics step {step} s"
            )
        self.model = model
        self.data = mujoco.MjData(model) if data is None else data
        self._whole_tick = self.period - 0.5 * step
        if not robots:
            raise ValueError("a simulation needs at least one robot")
        drawn = [describe_rover(robot) if isinstance(robot, str) else robot for robot in robots]
        seeds = np.random.SeedSequence(seed).spawn(2 * len(drawn))
        suites = [suite] * len(drawn) if isinstance(suite, SensorSuite) else suite
        self.robots: dict[str, SimRobot] = {
            robot.name: SimRobot(
                robot, model, self.data, sensors, servo or ServoConfig.of(robot), rng
            )
            for robot, sensors, rng in zip(drawn, suites, map(np.random.default_rng, seeds))
        }
        self._robots = tuple(self.robots.values())
        self._loads = tuple(loads)
        cameras = {model.camera(index).name for index in range(model.ncam)}
        self.heads = {
            name: StereoHead(model, f"{name}/", stereo, source)
            for name, source in zip(self.robots, seeds[len(drawn) :])
            if stereo is not None and f"{name}/stereo_left" in cameras
        }
        self._tyres = TyreFriction.of(model)
        self.grip()
        mujoco.mj_forward(model, self.data)
        self._time: float = self.data.time
        for robot in self._robots:
            robot.configure(self._time)
        self._poll_heads()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._time

    def tick(self) -> None:
        """Advance one servo tick: motors, physics, sensors.

        Raises:
            RobotError: If a robot cannot follow its command, or the physics diverged.
        """
        self.drive()
        for load in self._loads:
            load.weigh(self._time)
        mujoco.mj_step2(self.model, self.data)
        if self.substeps > 1:
            mujoco.mj_step(self.model, self.data, self.substeps - 1)
        # Before the contacts of the next tick, which a restored state has to find again.
        self.grip()
        mujoco.mj_step1(self.model, self.data)
        self.sense()

    def drive(self) -> None:
        """Apply the present commands to the motors; part of `tick`, for owners of the physics."""
        for robot in self._robots:
            robot.drive()

    def grip(self) -> None:
        """Give tyres the friction of the ground below; part of `tick`, for owners of the physics.

        Without friction in patches nothing is done.
        """
        if self._tyres is not None:
            self._tyres.update(self.data)

    def wear(self, robot: str, wheel: str, lost: float) -> float:
        """Let a tyre lose a share of its friction, here and on any ground that it gets to.

        Args:
            robot: Name of the robot.
            wheel: Name of the wheel.
            lost: Share of the friction that it has.

        Returns:
            Its Coulomb coefficient before, on the ground where it is.
        """
        tyre = f"{robot}/{wheel}{TYRE}"
        before = float(self.model.geom(tyre).friction[0])
        self.model.geom(tyre).friction[0] = (1.0 - lost) * before
        if self._tyres is not None:
            self._tyres.wear(tyre, lost)
        return before

    def sense(self) -> None:
        """Sample the sensors; part of `tick`, for owners of the physics.

        Raises:
            RobotError: If the physics diverged; every robot is in ERROR then.
        """
        time = self.data.time
        # MuJoCo resets a state that is not finite, and its clock with it: less than a tick passed.
        if time - self._time < self._whole_tick:
            self._time = time
            errors = [robot.fail("the simulation diverged") for robot in self._robots]
            raise errors[0]
        self._time = time
        for robot in self._robots:
            robot.sense(time)
        self._poll_heads()

    def _poll_heads(self) -> None:
        """Give robots the stereo pairs that are due."""
        for name, head in self.heads.items():
            pair = head.poll(self.data, self._time)
            if pair is not None:
                self.robots[name].see(pair)

    def settle(self, duration: float) -> None:
        """Advance for `duration` [s] while the robots keep their commands."""
        for _ in range(round(duration / self.period)):
            self.tick()

    def save(self) -> SavedRun:
        """Return the complete state."""
        physics = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, physics, _STATE)
        robots = {name: robot.save() for name, robot in self.robots.items()}
        heads = {name: head.state for name, head in self.heads.items()}
        return SavedRun(physics, self.data.sensordata.copy(), robots, heads)

    def restore(self, saved: SavedRun) -> None:
        """Go back to a saved state of the same scene, bit for bit.

        Raises:
            ValueError: If the state is of another scene.
        """
        fits = saved.physics.size == mujoco.mj_stateSize(self.model, _STATE)
        if not (fits and saved.robots.keys() == self.robots.keys()):
            raise ValueError("the saved run is of another scene")
        mujoco.mj_setState(self.model, self.data, saved.physics, _STATE)
        for load in self._loads:
            load.weigh(self.data.time)
        self.grip()
        mujoco.mj_step1(self.model, self.data)
        # Force and acceleration sensors cannot be recomputed from this half of a step.
        self.data.sensordata[:] = saved.sensordata
        self._time = self.data.time
        for name, state in saved.robots.items():
            self.robots[name].restore(state)
        for name, state in saved.heads.items():
            self.heads[name].state = state

    def close(self) -> None:
        """Close the robots; they are UNCONFIGURED afterwards."""
        for part in (*self._robots, *self.heads.values()):
            part.close()
