"""The thesis' numbers, and that the compiled parts carry them."""

import math

import mujoco
import numpy as np
import pytest

from models import datasheets
from models.compose import ARM_JOINTS, FOLDER, WHEELS
from models.datasheets import ARM, ARM_MOTOR, CAMERA, ROVER, WHEEL_MOTOR
from perception.geometry.gravity import GRAVITY
from tests.models.scenes import shaft_torque


def compiled(part: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(FOLDER / part / f"{part}.xml"))


@pytest.fixture(scope="module")
def rover() -> mujoco.MjModel:
    return compiled("rover")


@pytest.fixture(scope="module")
def arm() -> mujoco.MjModel:
    return compiled("arm")


def average_error(estimate, truth) -> float:
    names = [name for name in truth if truth[name] != 0.0]
    return 100.0 * float(np.mean([abs(estimate[n] / truth[n] - 1.0) for n in names]))


def test_table_2_1_has_22_parameters_and_its_rows_average_to_110_and_22_percent():
    truth = datasheets.TABLE_2_1_TRUTH
    assert len(truth) == len(datasheets.TABLE_2_1_CONSTANT) == 22
    assert average_error(datasheets.TABLE_2_1_CONSTANT, truth) == pytest.approx(110.1, abs=0.1)
    assert average_error(datasheets.TABLE_2_1_VARIABLE, truth) == pytest.approx(21.8, abs=0.1)


def test_table_2_2_rows_average_to_what_the_thesis_prints():
    truth = datasheets.TABLE_2_2_TRUTH
    printed = datasheets.TABLE_2_2_AVERAGE_ERROR
    constant = average_error(datasheets.TABLE_2_2_CONSTANT, truth)
    variable = average_error(datasheets.TABLE_2_2_VARIABLE, truth)
    assert (constant, variable) == pytest.approx(printed, abs=0.15)


def test_sensitivity_of_the_inclinometer_turns_millivolts_a_degree_into_radians():
    pitch = datasheets.INCLINOMETER_CALIBRATION["robot1"]["pitch"]
    assert pitch.angle(2.381 + 10 * 34.733e-3) == pytest.approx(math.radians(10.0))


def test_rated_point_of_the_wheel_motor_is_49_rpm_at_208_oz_in_from_908_oz_in_stall():
    ounce_inch = 0.00706155
    assert shaft_torque(WHEEL_MOTOR, 1.0, 0.0) == pytest.approx(908 * ounce_inch, rel=1e-5)
    rated = shaft_torque(WHEEL_MOTOR, 1.0, 49 * 2 * math.pi / 60)
    assert rated == pytest.approx(208 * ounce_inch, rel=1e-5)
    assert WHEEL_MOTOR.no_load_speed * 60 / (2 * math.pi) == pytest.approx(63.56, abs=0.01)


def test_wheel_radius_turns_49_rpm_into_25_cm_a_second():
    speed = datasheets.WHEEL_RATED_SPEED * ROVER.wheel_radius
    assert speed == pytest.approx(datasheets.ROVER_RATED_SPEED, rel=1e-3)


@pytest.mark.parametrize("wheel", WHEELS)
def test_wheel_in_the_model_agrees_with_the_datasheet(rover, wheel):
    dof = rover.joint(f"{wheel}_joint").dofadr[0]
    slide = rover.joint(f"{wheel}_suspension_joint")
    body = rover.body(f"{wheel}_wheel")
    side = -1.0 if "left" in wheel else 1.0
    end = 1.0 if "front" in wheel else -1.0
    low = ROVER.wheel_radius - ROVER.centre_height
    at = [side * ROVER.half_track, end * ROVER.half_wheelbase, low]
    np.testing.assert_allclose(body.pos, at, atol=1e-6)
    np.testing.assert_allclose(body.mass, ROVER.wheel_mass)
    np.testing.assert_allclose(rover.dof_armature[dof], WHEEL_MOTOR.armature)
    np.testing.assert_allclose(rover.dof_frictionloss[dof], WHEEL_MOTOR.friction)
    np.testing.assert_allclose(slide.range, [-ROVER.travel, ROVER.travel])
    np.testing.assert_allclose(rover.jnt_stiffness[slide.id].flat[0], ROVER.spring)
    np.testing.assert_allclose(rover.dof_damping[slide.dofadr[0]].flat[0], ROVER.damper)
    slack = -ROVER.sprung_mass * GRAVITY / (4.0 * ROVER.spring)  # the bare rover rides level at 0
    np.testing.assert_allclose(rover.qpos_spring[slide.qposadr[0]], slack, atol=1e-7)
    tyre = rover.geom(f"{wheel}_tyre")
    radius, width = ROVER.wheel_radius, ROVER.wheel_half_width
    np.testing.assert_allclose(tyre.size, [width, radius, radius])
    assert tyre.friction[0] == ROVER.tyre_friction


@pytest.mark.parametrize("wheel", WHEELS)
def test_wheel_motor_in_the_model_is_the_line_of_the_datasheet(rover, wheel):
    check_motor(rover, wheel, WHEEL_MOTOR)


@pytest.mark.parametrize("joint", ARM_JOINTS)
def test_arm_motor_in_the_model_is_the_line_of_the_datasheet(arm, joint):
    check_motor(arm, joint, ARM_MOTOR)


def check_motor(model: mujoco.MjModel, name: str, sheet: datasheets.MotorSheet) -> None:
    motor = model.actuator(name).id
    resistance, constant = model.actuator_gainprm[motor, :2]
    volts = sheet.voltage
    assert tuple(model.actuator_ctrlrange[motor]) == (-volts, volts)
    assert constant / resistance * volts == pytest.approx(sheet.gross_stall_torque, rel=1e-5)
    assert volts / constant == pytest.approx(sheet.gross_no_load_speed, rel=1e-5)


def test_spring_gives_the_pitch_stiffness_of_table_2_2_less_what_the_weight_takes_off():
    weight = ROVER.sprung_mass * GRAVITY * (ROVER.sprung_height - ROVER.wheel_radius)
    required = datasheets.TABLE_2_2_TRUTH["k_pitch"] + weight
    assert 4.0 * ROVER.spring * ROVER.half_wheelbase**2 == pytest.approx(required, rel=1e-3)


def test_decks_motors_and_mounts_in_the_model_agree_with_the_datasheet(rover):
    rise = ROVER.deck_height - ROVER.centre_height
    for end, sign in (("front", 1.0), ("rear", -1.0)):
        deck = rover.geom(f"{end}_deck")
        middle = sign * (ROVER.deck_gap + ROVER.deck_half_y)
        size = [ROVER.deck_half_x, ROVER.deck_half_y, ROVER.deck_half_z]
        np.testing.assert_allclose(deck.size, size, atol=1e-9)
        np.testing.assert_allclose(deck.pos, [0.0, middle, rise], atol=1e-6)
        np.testing.assert_allclose(rover.geom(f"{end}_deck_collision").pos, deck.pos)
        motor = rover.geom(f"{end}_left_motor")
        np.testing.assert_allclose(
            motor.pos,
            [
                -ROVER.motor_half_x,
                sign * ROVER.half_wheelbase,
                ROVER.wheel_radius - ROVER.centre_height,
            ],
            atol=1e-6,
        )
        np.testing.assert_allclose(motor.size[:2], [ROVER.motor_radius, ROVER.motor_half_length])
    np.testing.assert_allclose(rover.site("attachment_site").pos, ROVER.arm_mount, atol=1e-9)
    centre = rover.joint("centre_joint")
    assert centre.range[1] == pytest.approx(ROVER.centre_range, abs=1e-6)
    assert rover.dof_frictionloss[centre.dofadr[0]] == ROVER.centre_friction
    assert rover.dof_damping[centre.dofadr[0]].flat[0] == ROVER.centre_damping


def test_arm_in_the_model_agrees_with_the_datasheet(arm):
    np.testing.assert_allclose(arm.body("turret").pos, [0, 0, ARM.base_height])
    np.testing.assert_allclose(arm.body("upper_arm").pos, [0, 0, ARM.turret_height])
    np.testing.assert_allclose(arm.body("forearm").pos, [0, ARM.upper_length, 0])
    np.testing.assert_allclose(arm.body("wrist").pos, [0, ARM.forearm_length, 0])
    np.testing.assert_allclose(arm.site("gripper").pos, [0, ARM.wrist_length, 0])
    masses = [
        arm.body(n).mass[0] for n in ("arm_base_link", "turret", "upper_arm", "forearm", "wrist")
    ]
    parts = [ARM.base_mass, ARM.turret_mass, ARM.upper_mass, ARM.forearm_mass, ARM.wrist_mass]
    np.testing.assert_allclose(masses, parts)
    assert sum(parts) + 2 * CAMERA.mass == pytest.approx(ARM.mass)
    for joint, limits in zip(ARM_JOINTS, ARM.joint_limits, strict=True):
        np.testing.assert_allclose(arm.joint(f"{joint}_joint").range, limits)
        dof = arm.joint(f"{joint}_joint").dofadr[0]
        assert arm.dof_armature[dof] == ARM_MOTOR.armature
        assert arm.dof_frictionloss[dof] == ARM_MOTOR.friction
    np.testing.assert_allclose(arm.key("home").qpos, ARM.home)


def test_cameras_in_the_model_agree_with_table_d_2():
    head = compiled("stereo_head")
    left, right = head.camera("stereo_left"), head.camera("stereo_right")
    assert right.pos[0] - left.pos[0] == pytest.approx(CAMERA.baseline)
    for camera in (left.id, right.id):
        assert tuple(head.cam_resolution[camera]) == (CAMERA.width, CAMERA.height)
        sensor = [CAMERA.sensing_width, CAMERA.sensing_height]
        np.testing.assert_allclose(head.cam_sensorsize[camera], sensor)
        np.testing.assert_allclose(head.cam_intrinsic[camera, :2], CAMERA.focal_length)
    assert (CAMERA.pinhole.fx, CAMERA.pinhole.fy) == pytest.approx((677.34, 871.25), abs=0.01)
    assert math.degrees(CAMERA.field_of_view[0]) == pytest.approx(41.2, abs=0.1)
    assert head.body_mass.sum() == pytest.approx(2 * CAMERA.mass)
