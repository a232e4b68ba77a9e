"""One MuJoCo scene stepped for several robots.

A servo tick is ordered so that position and velocity sensors are read at the tick itself and
nothing is computed twice: the second half of a physics step with the new motor voltages, whole
steps, and the first half of the next one. Force and acceleration sensors come out of the last
whole step, one physics step earlier, and carry that time stamp.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from perception.geometry.arrays import FloatArray
from twin.camera import StereoConfig, StereoHead, StereoState, has_stereo
from twin.describe import describe_rover
from twin.description import RobotDescription
from twin.sensors import DATASHEET, SensorSuite
from twin.servo import SERVO_PERIOD, ServoConfig
from twin.sim_robot import RobotState, SimRobot

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclasses.dataclass(frozen=True)
class SavedRun:
    """Complete state of a `Simulation`, enough to go on bit for bit."""

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
        suite: SensorSuite = DATASHEET,
        servo: ServoConfig | None = None,
        stereo: StereoConfig | None = None,
        seed: int = 0,
        period: float = SERVO_PERIOD,
        data: mujoco.MjData | None = None,
    ) -> None:
        """Find the robots in the scene, and configure them at rest.

        Args:
            model: The scene.
            robots: The robots as drawn; a name stands for the thesis' rover with that name.
            suite: How the robots' sensors measure.
            servo: Their motors and gains; None for the motors of each description.
            stereo: How their stereo heads see; None leaves the channel missing, as does a head
                without cameras.
            seed: Random seed of all noise; one seed gives one run, bit for bit.
            period: Servo tick [s], a multiple of the physics step.
            data: The scene's state, if another owner (dm_control) holds it.

        Raises:
            ValueError: If an actuator is missing, the tick is no multiple of the physics step, or
                the integrator cannot be split.
        """
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
            raise ValueError("the RK4 integrator cannot be split; use implicitfast or Euler")
        self.substeps = round(period / model.opt.timestep)
        if self.substeps < 1 or not math.isclose(self.substeps * model.opt.timestep, period):
            raise ValueError(
                f"servo period {period} s is no multiple of the physics step {model.opt.timestep} s"
            )
        self.model = model
        self.data = mujoco.MjData(model) if data is None else data
        self.period = period
        self._whole_tick = period - 0.5 * float(model.opt.timestep)
        if not robots:
            raise ValueError("a simulation needs at least one robot")
        drawn = [describe_rover(robot) if isinstance(robot, str) else robot for robot in robots]
        seeds = np.random.SeedSequence(seed).spawn(2 * len(drawn))
        self.robots: dict[str, SimRobot] = {
            robot.name: SimRobot(
                robot, model, self.data, suite, servo or ServoConfig.of(robot), period, rng
            )
            for robot, rng in zip(drawn, map(np.random.default_rng, seeds))
        }
        self._robots = tuple(self.robots.values())
        self.heads: dict[str, StereoHead] = {}
        if stereo is not None:
            self.heads = {
                name: StereoHead(model, f"{name}/", stereo, source)
                for name, source in zip(self.robots, seeds[len(drawn) :])
                if has_stereo(model, f"{name}/")
            }
        mujoco.mj_forward(model, self.data)
        self._time: float = self.data.time
        for robot in self._robots:
            robot.configure(self._time)
        self._look()

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._time

    def step(self) -> None:
        """Advance one servo tick: motors, physics, sensors.

        Raises:
            RobotError: If a robot cannot follow its command, or the physics diverged.
        """
        self.drive()
        mujoco.mj_step2(self.model, self.data)
        if self.substeps > 1:
            mujoco.mj_step(self.model, self.data, self.substeps - 1)
        mujoco.mj_step1(self.model, self.data)
        self.sense()

    def drive(self) -> None:
        """Bring the held commands to the motors; part of `step`, for owners of the physics."""
        for robot in self._robots:
            robot.drive()

    def sense(self) -> None:
        """Sample the sensors; part of `step`, for owners of the physics.

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
        if self.heads:
            self._look()

    def _look(self) -> None:
        """Give robots the stereo pairs that are due."""
        for name, head in self.heads.items():
            pair = head.poll(self.data, self._time)
            if pair is not None:
                self.robots[name].see(pair)

    def settle(self, duration: float) -> None:
        """Advance for `duration` [s], with the robots as they are."""
        for _ in range(round(duration / self.period)):
            self.step()

    def save(self) -> SavedRun:
        """Return the complete state."""
        physics = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, physics, _STATE)
        robots = {name: robot.save() for name, robot in self.robots.items()}
        heads = {name: head.save() for name, head in self.heads.items()}
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
        mujoco.mj_step1(self.model, self.data)
        # Force and acceleration sensors cannot be recomputed from this half of a step.
        self.data.sensordata[:] = saved.sensordata
        self._time = self.data.time
        for name, state in saved.robots.items():
            self.robots[name].restore(state)
        for name, state in saved.heads.items():
            self.heads[name].restore(state)

    def close(self) -> None:
        """Take the robots down; they are UNCONFIGURED afterwards."""
        for part in (*self._robots, *self.heads.values()):
            part.close()
