"""What happens to a rover, against the deviations that its twin would have."""

import copy

import mujoco
import numpy as np
import pytest

from experiments.living.happenings import happen
from experiments.living.living_twin import CELLS, LOOSE
from experiments.living.trial import FIELD
from models.compose import RobotPlacement
from perception.stereo.eye_turn import find_eye_turn
from twin.camera import StereoConfig
from twin.connect import connect
from twin.describe import describe_rover
from twin.loop import run
from twin.robot import ArmMode, Command, WheelMode
from twin.shadow.deviations import deviating, rover_deviations, shadow_scene

ROBOT = "rover1"
DEVIATIONS = rover_deviations(describe_rover(ROBOT))
DRAWN = shadow_scene(RobotPlacement(ROBOT))
SIZES = {
    "load base": 1.0, "load gripper": 0.1, "spring rear_left": 0.4, "drag front_right": 2.0,
    "drag elbow": 0.2, "grip rear_right": 0.3, "grip all": 0.5, "blocked front_left": 1.0,
}  # fmt: skip


def weight(model, data):
    """Torque of gravity and springs on every joint (nv,) in a posture that is not the drawing's."""
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for index in range(model.njnt):
        joint = model.joint(index)
        if joint.type[0] != mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[joint.qposadr[0]] += 0.02 * (1 + index % 5)
    mujoco.mj_forward(model, data)
    by_name = {}
    for index in range(model.njnt):
        joint = model.joint(index)
        begin, count = joint.dofadr[0], 6 if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE else 1
        forces = data.qfrc_bias - data.qfrc_passive
        by_name[joint.name] = forces[begin : begin + count].copy()
    return by_name


@pytest.mark.parametrize("name", SIZES)
def test_a_happening_is_its_twins_deviation(name):
    with connect("sim", seed=1) as connection:
        simulation = connection.simulation
        size = happen(simulation, DRAWN, ROBOT, name, SIZES[name])
        twin = copy.copy(DRAWN)
        values = np.array([size if each.name == name else 0.0 for each in DEVIATIONS])
        deviating(twin, DEVIATIONS, values)
        changed = simulation.model
        made, expected = (weight(each, mujoco.MjData(each)) for each in (changed, twin))
        for joint, forces in expected.items():
            np.testing.assert_allclose(made[joint], forces, atol=2e-4, err_msg=joint)
        for wheel in describe_rover(ROBOT).wheel_names:
            tyre = f"{ROBOT}/{wheel}_tyre"
            friction = changed.geom(tyre).friction[0]
            assert friction == pytest.approx(twin.geom(tyre).friction[0])
        if name.startswith("blocked"):  # A twin holds it by its inertia.
            part = f"{ROBOT}/{name.partition(' ')[2]}_joint"
            assert twin.joint(part).armature[0] > 1e4 * changed.joint(part).armature[0]
            expected.pop(part)
        for joint in expected:
            loss = [m.dof_frictionloss[m.joint(joint).dofadr[0]] for m in (changed, twin)]
            assert loss[0] == pytest.approx(loss[1])
    assert abs(size) == pytest.approx(SIZES[name])


class Full:
    """All motors at two thirds of their duty."""

    def reset(self):
        pass

    def step(self, observations):
        return dict.fromkeys(observations, Command(np.full(4, 2 / 3), np.full(4, 2 / 3)))


@pytest.mark.parametrize("part", ["front_left", "base_yaw", "shoulder", "elbow", "wrist"])
def test_what_is_blocked_no_motor_overcomes(part):
    """Beside the largest duty of every motor, which moves what is not blocked."""

    class Most(Full):
        def step(self, observations):
            return dict.fromkeys(observations, Command(np.ones(4), np.ones(4)))

    moved = {}
    for blocked in (True, False):
        with connect("sim", seed=1) as connection:
            simulation = connection.simulation
            if blocked:
                happen(simulation, DRAWN, ROBOT, f"blocked {part}", 1.0)
            place = simulation.data.joint(f"{ROBOT}/{part}_joint")
            begin = float(place.qpos[0])
            run(connection.robots, [Most()], connection.clock, duration=0.5)
            moved[blocked] = abs(float(place.qpos[0]) - begin)
    assert moved[True] < 0.05 < 0.2 < moved[False], moved  # noqa: PLR2004


@pytest.mark.parametrize(("name", "axes"), [("supply wrist", ["wrist"]), ("battery", None)])
def test_a_motor_that_lost_torque_gets_less_of_its_voltage(name, axes):
    with connect("sim", seed=1) as connection:
        model, data = connection.simulation.model, connection.simulation.data
        assert happen(connection.simulation, DRAWN, ROBOT, name, 0.3) == 0.3  # noqa: PLR2004
        seen = []

        def look():
            seen.append(data.ctrl.copy())
            return False

        run(connection.robots, [Full()], connection.clock, [], 0.02, look)
        kept = seen[-1]
        volts = model.actuator_ctrlrange[:, 1]
        for axis in describe_rover(ROBOT).axes:
            index = model.actuator(f"{ROBOT}/{axis}").id
            share = 0.7 if axes is None or axis in axes else 1.0
            assert kept[index] == pytest.approx(share * 2 / 3 * volts[index])


@pytest.mark.parametrize(
    ("name", "channel", "number"),
    [("zero elbow", "arm_angles", 2), ("zero roll", "inclinometer", 1)],
)
def test_a_zero_that_drifts_is_read(name, channel, number):
    """Beside the same robot to which nothing happens."""
    read = []
    for happens in (False, True):
        with connect("sim", seed=1) as connection:
            (robot,) = connection.robots.values()
            if happens:
                happen(connection.simulation, DRAWN, ROBOT, name, 0.1)
            for _ in range(30):
                connection.clock.tick()
            read.append(getattr(robot.observe(), channel).value.copy())
    expected = np.zeros(len(read[0]))
    expected[number] = 0.1
    assert read[1] - read[0] == pytest.approx(expected, abs=1e-3)


class Reaching:
    """Turns all joints of the arm, and the wheels."""

    def reset(self):
        pass

    def step(self, observations):
        motor = Command(np.full(4, 2.0), np.full(4, 0.5), WheelMode.SPEED, ArmMode.RATE)
        return dict.fromkeys(observations, motor)


@pytest.mark.parametrize("part", ["wrist", "rear_left"])
def test_what_sticks_reads_the_same_whatever_moves(part):
    with connect("sim", seed=1) as connection:
        (robot,) = connection.robots.values()
        run(connection.robots, [Reaching()], connection.clock, [], 0.3)
        assert happen(connection.simulation, DRAWN, ROBOT, f"stuck {part}", 1.0) == 1.0
        rows = []

        def look():
            seen = robot.observe()
            rows.append([*seen.arm_angles.value, *seen.arm_rates.value, *seen.wheel_speeds.value])
            return False

        run(connection.robots, [Reaching()], connection.clock, [], 0.3, look)
    spans = np.ptp(rows[1:], axis=0)
    means = np.abs(np.mean(rows[1:], axis=0))
    if part == "wrist":
        assert spans[3] == 0.0 and means[7] < 0.01  # noqa: PLR2004
        assert spans[0] > 0.05 and means[4] > 0.2  # noqa: PLR2004
    else:
        assert means[10] < 0.02 and means[9] > 1.0  # noqa: PLR2004


def test_what_does_not_happen_is_refused():
    with connect("sim", seed=1) as connection, pytest.raises(ValueError, match="'flat tyre'"):
        happen(connection.simulation, DRAWN, ROBOT, "flat tyre", 1.0)


class Resting(Reaching):
    """Moves nothing."""

    def step(self, observations):
        still = Command(np.zeros(4), np.zeros(4), WheelMode.SPEED, ArmMode.RATE)
        return dict.fromkeys(observations, still)


def test_a_camera_that_comes_loose_is_seen_turned_by_its_size():
    """In the head's own frame: MuJoCo's y and z are against those of images."""
    with connect("sim", field=FIELD, seed=1, stereo=StereoConfig(1.0)) as connection:
        simulation = connection.simulation
        eyes = describe_rover(ROBOT).head.camera

        def turn():
            images = simulation.robots[ROBOT].observe().stereo.value
            return find_eye_turn(images, eyes).turn

        before = turn()
        assert happen(simulation, DRAWN, ROBOT, "loose camera", 0.03) == 0.03  # noqa: PLR2004
        run(connection.robots, [Resting()], connection.clock, [], 1.1)
        each = 0.03 / 3.0**0.5
        # What turns it about the vertical shows little in rows.
        assert (turn() - before)[[0, 2]] == pytest.approx([each, -each], abs=0.002)


def test_each_of_thirteen_things_happens_in_two_sizes_or_to_two_parts():
    cells = [*CELLS, *LOOSE]
    kinds = [name.partition(" ")[0] for name, _ in cells]
    assert len(cells) == 26 and len(set(cells)) == 26  # noqa: PLR2004
    assert sorted({kinds.count(each) for each in set(kinds)}) == [2, 4]
