"""The scene as a dm_control environment, for its viewer, its wrappers and learning code.

Actions are duties; observations are measurements, never the truth. A channel that is missing or
stale reads NaN.
"""

# dm_control ships no types, and its abstract methods are inferred to return None.
# pyright: reportMissingTypeStubs=false, reportUnknownMemberType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportIncompatibleMethodOverride=false

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from models.compose import FLAT, FieldConfig, RobotPlacement, make_model, settle
from perception.geometry.arrays import FloatArray
from twin.describe import describe_placement
from twin.robot import Command, Observation
from twin.sensors import DATASHEET, SensorSuite, channel_widths
from twin.simulation import Simulation

try:
    from dm_control.mujoco import Physics, wrapper
    from dm_control.rl import control
    from dm_env import specs
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        "twin.environment needs dm_control: pip install 'fieldtwin[dm_control]' (Python 3.11, 3.12)"
    ) from missing

Reward = Callable[[Mapping[str, Observation]], float]


def _no_reward(observations: Mapping[str, Observation]) -> float:
    return 0.0


class RoverTask(control.Task):
    """Robots driven by duty; a reward may be given."""

    def __init__(self, simulation: Simulation, reward: Reward = _no_reward) -> None:
        """Wrap a simulation that shares its state with the environment's physics.

        Args:
            simulation: Scene, whose present state is the initial state of every episode.
            reward: Function from observations, by robot name, to the reward.
        """
        self._simulation = simulation
        self._start = simulation.save()
        self._reward = reward

    def initialize_episode(self, physics: Physics) -> None:
        """Go back to the start and activate the robots."""
        self._simulation.restore(self._start)
        for robot in self._simulation.robots.values():
            robot.activate()

    def before_step(self, action: FloatArray, physics: Physics) -> None:
        """Apply duties (robot by robot: wheels, then arm joints) to the motors."""
        duty = np.asarray(action, dtype=float)
        for robot in self._simulation.robots.values():
            wheels, axes = len(robot.description.wheels), len(robot.description.axes)
            robot.command(Command(duty[:wheels], duty[wheels:axes]))
            duty = duty[axes:]
        self._simulation.grip()
        self._simulation.drive()

    def after_step(self, physics: Physics) -> None:
        """Sample the sensors."""
        self._simulation.sense()

    def action_spec(self, physics: Physics) -> specs.BoundedArray:
        """Return the shape and range of an action."""
        robots = self._simulation.robots.items()
        names = [f"{name}/{axis}" for name, robot in robots for axis in robot.description.axes]
        return specs.BoundedArray((len(names),), float, -1.0, 1.0, name=",".join(names))

    def get_observation(self, physics: Physics) -> OrderedDict[str, Any]:
        """Return every channel, named robot/channel."""
        result: OrderedDict[str, Any] = OrderedDict()
        for name, robot in self._simulation.robots.items():
            for channel, width in channel_widths(robot.description).items():
                sample = getattr(robot.observe(), channel)
                missing = np.full(width, np.nan)
                result[f"{name}/{channel}"] = sample.value if sample.usable else missing
        return result

    def get_reward(self, physics: Physics) -> float:
        """Return the reward of the latest observations."""
        robots = self._simulation.robots
        return self._reward({name: robot.observe() for name, robot in robots.items()})


def make_environment(
    robots: Sequence[RobotPlacement] = (RobotPlacement(),),
    field: FieldConfig = FLAT,
    suite: SensorSuite = DATASHEET,
    seed: int = 0,
    time_limit: float = 10.0,
    reward: Reward = _no_reward,
) -> control.Environment:
    """Return a scene as a ``dm_env.Environment``.

    Args:
        robots: Names and initial poses of the robots.
        field: Ground of the scene.
        suite: Specification of the sensors.
        seed: Random seed of all sensor noise; every episode has the same.
        time_limit: Length of an episode [s].
        reward: Function from observations, by robot name, to the reward.
    """
    model = make_model(field, robots)
    physics = Physics.from_model(wrapper.MjModel(model))
    data = physics.data.ptr
    mujoco.mj_copyData(data, model, settle(model))
    drawn = [describe_placement(robot) for robot in robots]
    simulation = Simulation(model, drawn, suite=suite, seed=seed, data=data)
    return control.Environment(
        physics,
        RoverTask(simulation, reward),
        time_limit=time_limit,
        n_sub_steps=simulation.substeps,
    )
