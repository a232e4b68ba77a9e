"""Robots of other shapes: the contract's numbers come from their descriptions."""

import numpy as np
import pytest

from models.compose import FieldConfig, RobotPlacement
from tests.twin.own_robots import NO_LOAD, STALL, six_joints, six_wheels
from tests.twin.recording.test_record import columns
from twin.connect import connect
from twin.describe import describe_placement
from twin.loop import run
from twin.recording.record import Recorder
from twin.robot import ARM_JOINTS, WHEELS, ArmMode, Command, Validity, WheelMode

FIELD = FieldConfig(texture_pixels=16)
SPEED = 3.0
ROBOTS = {
    "six wheels": (six_wheels, (*WHEELS, "middle_left", "middle_right"), ()),
    "no arm": (None, WHEELS, ()),
    "six joints": (six_joints, WHEELS, (*ARM_JOINTS, "roll", "hand")),
}


class Drive:
    """Straight on, with the arm held where it is."""

    def __init__(self, description):
        self.wheels = np.full(len(description.wheels), SPEED)
        self.hold = None

    def reset(self):
        pass

    def step(self, observations):
        seen = observations["mine"].arm_angles
        if seen.validity is Validity.MISSING:
            return {"mine": Command(self.wheels, wheel_mode=WheelMode.SPEED)}
        self.hold = seen.value if self.hold is None else self.hold
        return {"mine": Command(self.wheels, self.hold, WheelMode.SPEED, ArmMode.POSITION)}


def placed(write, folder):
    if write is None:
        return RobotPlacement("mine", arm=False)
    return RobotPlacement("mine", model=write(folder))


@pytest.mark.parametrize("kind", ROBOTS)
def test_robot_of_another_shape_connects_drives_and_is_recorded(kind, tmp_path):
    write, wheels, joints = ROBOTS[kind]
    with connect("sim", robots=[placed(write, tmp_path)], field=FIELD) as connection:
        robot, path = connection.robots["mine"], tmp_path / "run.rrd"
        description = robot.description
        assert (description.wheel_names, description.joint_names) == (wheels, joints)
        drive, data = Drive(description), connection.simulation.data
        before = data.body("mine/chassis").xpos.copy()
        with Recorder(path, connection.robots, connection.simulation) as recorder:
            run(connection.robots, [drive], connection.clock, [recorder], 2.0)
        seen = robot.observe()
        assert seen.wheel_speeds.value.shape == (len(wheels),)
        np.testing.assert_allclose(seen.wheel_speeds.value, SPEED, atol=0.1)
        # Two seconds at 3 rad/s on wheels of 49 mm, less the time to speed up.
        assert 0.2 < data.body("mine/chassis").xpos[1] - before[1] < 0.3
        if joints:
            np.testing.assert_allclose(seen.arm_angles.value, drive.hold, atol=0.05)
            np.testing.assert_allclose(drive.hold, description.arm.home, atol=0.1)
        else:
            assert seen.arm_angles.validity is seen.arm_base_wrench.validity is Validity.MISSING
    assert robot.description.axes == (*wheels, *joints)  # readable after the scene is gone
    rows = columns(path)
    (scalars,) = (rows["/mine/duty/wheels"][n] for n in rows["/mine/duty/wheels"] if "scalars" in n)
    assert {len(row) for row in scalars if row} == {len(wheels)}
    assert ("/mine/duty/arm" in rows) == bool(joints)


def test_motors_of_a_brought_robot_have_the_lines_of_its_file(tmp_path):
    motors = describe_placement(placed(six_wheels, tmp_path)).motors
    assert len(motors) == 6
    assert (motors[5].stall_torque, motors[5].no_load_speed) == pytest.approx(
        (STALL, NO_LOAD), rel=1e-5
    )
    # The rover's own file rounds its motors' lines to seven digits.
    rover = describe_placement(RobotPlacement("mine", arm=False)).motors
    assert motors[0].stall_torque == pytest.approx(rover[0].stall_torque, rel=1e-5)
    assert motors[0].no_load_speed == pytest.approx(rover[0].no_load_speed, rel=1e-5)


def test_command_of_another_size_is_refused_before_it_moves_anything(tmp_path):
    with connect("sim", robots=[placed(six_wheels, tmp_path)], field=FIELD) as connection:
        robot = connection.robots["mine"]
        for command in (Command(np.ones(4)), Command(np.ones(6), np.ones(4))):
            robot.activate()
            with pytest.raises(ValueError, match="the robot has 6 wheels and 0 joints"):
                robot.command(command)
            assert not connection.simulation.data.ctrl.any()
        robot.activate()
        applied = robot.command(Command())
        assert applied.wheels.shape == (6,) and not applied.wheels.any()


def test_boards_refuse_a_brought_robot(tmp_path):
    placement = placed(six_wheels, tmp_path)
    for target in ("quantised", "emulated"):
        with pytest.raises(ValueError, match="four wheels and four arm joints"):
            connect(target, robots=[placement])


def test_file_that_is_no_robot_is_refused(tmp_path):
    path = tmp_path / "box.xml"
    path.write_text(
        "<mujoco><worldbody><body name='box'><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(ValueError, match="no free body 'chassis'"):
        connect("sim", robots=[RobotPlacement("mine", model=str(path))])
    with pytest.raises(ValueError, match="missing.xml"):
        connect("sim", robots=[RobotPlacement("mine", model=str(tmp_path / "missing.xml"))])
    with pytest.raises(ValueError, match="nothing but name, position and yaw"):
        RobotPlacement("mine", arm=False, model=str(path))
