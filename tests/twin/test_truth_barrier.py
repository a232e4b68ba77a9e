"""Controllers learn of the world by observations only."""

import collections
import contextlib
import enum
import functools
import gc
import sys
import types
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import experiments
import twin.hardware.emulator.scene as scene_room
from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import RobotLocalization
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.trial import MissionTrial, prepared
from tests.controllers.motion.seen import seen_at
from tests.twin.scene import SERVO, compile_scene
from twin.camera import Renderer, StereoConfig, StereoRig
from twin.describe import describe, describe_rover
from twin.hardware.radio.framed_radio import FramedLink
from twin.loop import run
from twin.robot import Command, Observation, WheelMode
from twin.robot_clock import ClockedRobot, RobotClock
from twin.sensor_bank import SensorBank
from twin.sensors import DATASHEET
from twin.simulation import SimRobot, Simulation

TRUTH = (
    mujoco.MjModel,
    mujoco.MjData,
    Simulation,
    SimRobot,
    SensorBank,
    StereoRig,
    Renderer,
    ClockedRobot,
    RobotClock,
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
    run(simulation.robots, [learner], simulation, duration=0.5)
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
    for _ in range(5):
        simulation.tick()
    np.testing.assert_array_equal(learner.seen[0]["rover1"].gyro.value, first)


def test_observation_has_no_attribute_beyond_the_contract(played):
    _, learner = played
    observation = learner.seen[0]["rover1"]
    assert type(observation) is Observation
    assert not hasattr(observation, "__dict__")
    assert len(observation) == len(Observation._fields)


PLAIN = (str, bytes, bool, int, type(None), enum.Enum, np.dtype, range, slice)
CLOSED = (type, types.ModuleType, types.BuiltinFunctionType, np.ufunc, FramedLink)
"""What holds no numbers of a robot; a radio link is a device."""


def held(root):
    """Numbers that are held by an object, by where they are; none is passed over in silence."""
    found, seen, pending = {}, {}, [("", root)]
    while pending:
        path, item = pending.pop()
        if isinstance(item, PLAIN):
            found[path] = repr(item)
        elif isinstance(item, (float, complex, np.generic)):
            found[path] = np.asarray(item)
        elif isinstance(item, np.ndarray) and item.dtype != object:
            found[path] = item.copy()
        elif isinstance(item, CLOSED) or id(item) in seen:
            continue
        else:
            seen[id(item)] = item
            pending += [(f"{path}/{name}", part) for name, part in parts(item).items()]
    return found


def parts(item):
    """Objects that an object holds, by name."""
    if isinstance(item, (RigidTransform, Rotation)):
        return {"matrix": item.as_matrix()}
    if isinstance(item, np.random.Generator):
        return {"state": item.bit_generator.state}
    if isinstance(item, (dict, types.MappingProxyType)):
        return {str(key): part for key, part in item.items()}
    if isinstance(item, (set, frozenset)):
        return dict(enumerate(sorted(item, key=repr)))
    if isinstance(item, (list, tuple, collections.deque, np.ndarray)):
        return dict(enumerate(item))
    if isinstance(item, types.GeneratorType):
        return dict(item.gi_frame.f_locals) if item.gi_frame else {}
    if isinstance(item, types.MethodType):
        return {"self": item.__self__, "function": item.__func__}
    if isinstance(item, types.FunctionType):
        cells = [cell.cell_contents for cell in item.__closure__ or ()]
        return {"closed": cells, "defaults": item.__defaults__, **vars(item)}
    if isinstance(item, functools.partial):
        return {"function": item.func, "args": item.args, "keywords": item.keywords}
    if isinstance(item, cv2.Algorithm):
        return {name: getattr(item, name)() for name in dir(item) if name.startswith("get")}
    if not hasattr(item, "__dict__") and not hasattr(item, "__slots__"):
        raise TypeError(f"what a {type(item)} holds is not known")
    slots = [slot for kind in type(item).__mro__ for slot in getattr(kind, "__slots__", ())]
    there = {slot: getattr(item, slot) for slot in slots if hasattr(item, slot)}
    return there | getattr(item, "__dict__", {})


def differing(one, other):
    """Places at which two objects hold other numbers; places of one alone are among them."""
    a, b = held(one), held(other)
    return sorted(path for path in a.keys() | b.keys() if not same(a.get(path), b.get(path)))


def same(one, other):
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    return one == other


def as_made(model, robots=(MASTER, SLAVE)):
    """Change every number of the robots in a scene by about a hundredth."""
    roots = [model.body(f"{robot}/chassis").id for robot in robots]
    bodies = np.isin(model.body_rootid, roots)
    joints = bodies[model.jnt_bodyid]
    owned = {
        "body": bodies,
        "jnt": joints,
        "dof": bodies[model.dof_bodyid],
        "geom": bodies[model.geom_bodyid],
        "site": bodies[model.site_bodyid],
        "cam": bodies[model.cam_bodyid],
        "actuator": joints[model.actuator_trnid[:, 0]],
    }
    turn = np.array([np.cos(5e-3), *(np.sin(5e-3) * np.array([0.6, 0.0, 0.8]))])
    for prefix, own in owned.items():
        for name in filter(lambda name: name.startswith(f"{prefix}_"), dir(model)):
            values = getattr(model, name)
            if not isinstance(values, np.ndarray) or values.dtype.kind != "f":
                continue
            if name.endswith("quat"):
                for index in np.flatnonzero(own):
                    mujoco.mju_mulQuat(values[index], values[index].copy(), turn)
            elif name == "jnt_axis":
                for index in np.flatnonzero(own):
                    mujoco.mju_rotVecQuat(values[index], values[index].copy(), turn)
            else:
                values[own] *= 1.013
    # What is zero as drawn, or would keep a ratio.
    model.actuator_gainprm[owned["actuator"]] *= 1.007
    model.cam_intrinsic[owned["cam"], 2:] += 1e-5
    hinges = joints & (model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    model.key_qpos[:, model.jnt_qposadr[hinges]] *= 1.013
    moved = np.flatnonzero(bodies & (model.body_jntnum == 0))
    model.body_pos[moved] += 2e-3
    model.body_ipos[bodies] += 2e-3
    return model


@pytest.fixture(scope="module")
def missions():
    """A mission with robots as drawn, and the same with robots as made that differ in all."""
    make_model = scene_room.make_model
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        found = []
        for change in (lambda model: model, as_made):
            for cached in (describe_rover, insertion_drawing):
                cached.cache_clear()
            patch.setattr(scene_room, "make_model", lambda *a, c=change: c(make_model(*a)))
            found.append(stack.enter_context(prepared(MissionTrial(seed=4, realism="ideal"))))
        yield found


def all_stages(team):
    """A team, and its last stages, which it makes when the ones before have ended."""
    for part in team.parts:
        _localize(part.belief)
    master, slave = team.parts
    insert = InsertCard(slave.belief, slave.radio)
    return team, insert, GuideInsertion(master.belief, master.radio, RigidTransform.identity())


def _localize(belief):
    """Let a rover believe that it stands at the panel."""
    belief.navigator.observe(seen_at(0.0))
    belief.map.transform_target_to_world = RigidTransform.identity()
    level = RigidTransform.from_translation([0.0, 0.0, 0.2])
    arm, _ = camera_arm(belief.robot)
    belief.localize(RobotLocalization(arm, level, 1e-6 * np.eye(6), np.zeros((6, 10))))


def test_robots_as_made_differ_from_the_drawn_ones_in_every_number(missions):
    drawn, made = (mission.connection.simulation.model for mission in missions)
    for robot in (MASTER, SLAVE):
        one, other = (held(describe(model, robot)) for model in (drawn, made))
        alike = [
            path for path in one
            if isinstance(one[path], np.ndarray)
            and not path.startswith(("/sensor_sigma", "/arm/cover_radius"))  # no robot's own
                and not path.endswith("/spring_sigma")  # the drawing's tolerance
            and np.any(np.abs(one[path]) > 1e-6) and np.array_equal(one[path], other[path])
        ]  # fmt: skip
        assert alike == []


def test_a_mission_holds_the_same_whatever_its_robots_are_made_like(missions):
    one, other = (all_stages(mission.team) for mission in missions)
    assert len(held(one)) > 300
    assert differing(one, other) == []


def test_a_controller_that_is_given_the_robot_as_made_is_found(missions):
    drawn, made = missions
    model = made.connection.simulation.model
    belief = made.team.slave.belief
    belief.robot, kept = describe(model, SLAVE), belief.robot
    try:
        assert differing(drawn.team, made.team)
    finally:
        belief.robot = kept


def test_a_tick_of_the_mission_calls_nothing_of_the_experiments(missions):
    """Between observation and command there are controllers alone."""
    mission = missions[0]
    folder = str(Path(experiments.__file__).parent)
    files = collections.Counter()
    robots = mission.connection.robots

    def note(frame, event, _):
        if event == "call":
            files[frame.f_code.co_filename] += 1

    for robot in robots.values():
        robot.activate()
    for _ in range(5):
        observations = {name: robot.observe() for name, robot in robots.items()}
        sys.setprofile(note)
        try:
            commands = mission.team.step(observations)
        finally:
            sys.setprofile(None)
        for name, command in commands.items():
            robots[name].command(command)
        mission.connection.clock.tick()
    assert any(file.endswith("controllers/mission/team.py") for file in files)
    assert [file for file in files if file.startswith(folder)] == []
