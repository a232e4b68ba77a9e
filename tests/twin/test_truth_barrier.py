"""Controllers learn of the world by observations only."""

import gc
import types

import mujoco
import numpy as np
import pytest

from tests.twin.scene import SERVO, compile_scene
from twin.camera import Renderer, StereoConfig, StereoRig
from twin.clock import SimClock
from twin.hardware.radio.framed_radio import FramedLink
from twin.loop import run
from twin.robot import Command, Observation, WheelMode
from twin.sensor_bank import SensorBank
from twin.sensors import DATASHEET
from twin.sim_robot import SimRobot
from twin.simulation import Simulation

TRUTH = (
    mujoco.MjModel,
    mujoco.MjData,
    Simulation,
    SimRobot,
    SensorBank,
    SimClock,
    StereoRig,
    Renderer,
)


def reachable(root):
    """Objects that can be reached from `root` without importing anything.

    A radio link is a device, as robots are: what comes out of it are bytes, and how its modems keep
    time is not entered. Classes and modules are not entered: every Python object leads to all
    modules through them, and what may be imported is the architecture test's affair. Functions are
    entered through what they closed over, not through their module's globals.
    """
    seen, pending = {}, [root]
    while pending:
        item = pending.pop()
        if id(item) in seen or isinstance(item, (type, types.ModuleType, FramedLink)):
            continue
        seen[id(item)] = item
        if isinstance(item, types.FunctionType):
            pending += [item.__closure__ or (), item.__defaults__ or (), item.__dict__]
        else:
            pending += gc.get_referents(item)
            if isinstance(item, np.ndarray) and item.base is not None:
                pending.append(item.base)
    return list(seen.values())


def leaks(root):
    return [item for item in reachable(root) if isinstance(item, TRUTH)]


class Learner:
    """Keeps everything that it is ever given."""

    def __init__(self):
        self.seen = []

    def reset(self):
        self.seen.clear()

    def step(self, observations):
        self.seen.append(observations)
        command = Command(np.full(4, 1.0), wheel_mode=WheelMode.SPEED)
        return dict.fromkeys(observations, command)


@pytest.fixture(scope="module")
def played():
    simulation = Simulation(
        compile_scene(("rover1", "rover2")),
        ["rover1", "rover2"],
        suite=DATASHEET,
        servo=SERVO,
        stereo=StereoConfig(),
    )
    learner = Learner()
    run(simulation.robots, [learner], SimClock(simulation), duration=0.5)
    return simulation, learner


def test_walk_finds_truth_where_there_is_some(played):
    simulation, learner = played
    robot = simulation.robots["rover1"]
    assert any(item is robot for item in leaks({"robots": [robot]}))
    assert simulation in leaks(lambda: simulation.time)
    learner.leak = robot.observe
    assert leaks(learner)
    del learner.leak


def test_no_truth_is_reachable_from_all_that_a_controller_was_given(played):
    _, learner = played
    assert len(learner.seen) == 50
    items = reachable(learner)
    assert sum(isinstance(item, Observation) for item in items) == 100
    assert leaks(learner) == []


def test_observed_arrays_are_read_only_and_share_no_memory_with_the_physics(played):
    simulation, learner = played
    data = simulation.data
    truth = (data.sensordata, data.qpos, data.qvel, data.ctrl, data.xpos)
    arrays = [item for item in reachable(learner.seen[-1]) if isinstance(item, np.ndarray)]
    assert len(arrays) > 10
    for array in arrays:
        assert not array.flags.writeable or array.size == 0
        assert not any(np.may_share_memory(array, part) for part in truth)


def test_earlier_observations_do_not_change_afterwards(played):
    simulation, learner = played
    first = learner.seen[0]["rover1"].gyro.value.copy()
    simulation.settle(0.05)
    np.testing.assert_array_equal(learner.seen[0]["rover1"].gyro.value, first)


def test_observation_has_no_attribute_beyond_the_contract(played):
    _, learner = played
    observation = learner.seen[0]["rover1"]
    assert type(observation) is Observation
    assert not hasattr(observation, "__dict__")
    assert len(observation) == len(Observation._fields)
