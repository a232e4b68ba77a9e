"""Fields on a slope: gravity, what holds against it, and what does not depend on it."""

import dataclasses
import math
import sys

import mujoco
import numpy as np
import pytest

from models.compose import ARM_JOINTS, WHEELS, RobotPlacement, make_model, make_terrain
from models.datasheets import ARM_MOTOR
from models.slope import turn_to_level
from perception.geometry.gravity import GRAVITY
from tests.models.scenes import PLAIN, make_scene, warnings
from twin.describe import describe

SLOPE = (math.radians(6.0), math.radians(-4.0))
INCLINED = dataclasses.replace(PLAIN, slope=SLOPE, friction=0.6)


@pytest.fixture(scope="module")
def inclined():
    return make_scene(RobotPlacement(yaw=0.7), field=INCLINED)


@pytest.mark.parametrize("slope", [SLOPE, (0.0, 0.0), (0.34, 0.3), (-0.2, 0.0)])
def test_each_axis_of_the_field_rises_by_its_angle_and_gravity_keeps_its_magnitude(slope):
    field = dataclasses.replace(PLAIN, slope=slope)
    gravity = make_model(field, []).opt.gravity
    assert np.linalg.norm(gravity) == pytest.approx(GRAVITY, rel=1e-12)
    # Work of a walk of 1 m along an axis: g times what it rises.
    np.testing.assert_allclose(-gravity[:2] / GRAVITY, np.sin(slope), atol=1e-12)
    assert gravity[2] < 0.0
    np.testing.assert_allclose(field.up, -gravity / GRAVITY, atol=1e-12)


@pytest.mark.parametrize("slope", [SLOPE, (0.0, 0.0), (0.34, 0.3), (-0.2, 0.0)])
def test_level_frame_has_gravity_along_its_z_and_the_field_s_y_above_its_own(slope):
    field = dataclasses.replace(PLAIN, slope=slope)
    turn = turn_to_level(field)
    np.testing.assert_allclose(turn.apply(field.up), [0.0, 0.0, 1.0], atol=1e-12)
    right, forward, _ = turn.apply(np.eye(3))
    assert forward[0] == pytest.approx(0.0, abs=1e-12) and forward[1] > 0.0
    np.testing.assert_allclose([right[2], forward[2]], np.sin(slope), atol=1e-12)


def test_slope_moves_nothing_but_gravity():
    robots, rough = [RobotPlacement()], dataclasses.replace(PLAIN, relief=0.02, rocks=30)
    level, steep = (
        make_model(dataclasses.replace(rough, slope=slope), robots) for slope in ((0.0, 0.0), SLOPE)
    )
    for name in ("geom_pos", "geom_size", "body_pos", "hfield_data", "key_qpos", "tex_data"):
        np.testing.assert_array_equal(getattr(level, name), getattr(steep, name))
    np.testing.assert_array_equal(level.opt.gravity, [0.0, 0.0, -GRAVITY])
    points = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 2))
    heights = [
        make_terrain(dataclasses.replace(rough, slope=slope)).height_at(points)
        for slope in ((0.0, 0.0), SLOPE)
    ]
    np.testing.assert_array_equal(*heights)


def test_robot_on_a_slope_is_described_as_on_level_ground(inclined):
    level = make_model(PLAIN, [RobotPlacement(yaw=0.7)])
    with np.printoptions(threshold=sys.maxsize, precision=17):
        described = [repr(describe(model, "rover1")) for model in (level, inclined.model)]
    assert described[0] == described[1]


def test_home_holds_the_arm_by_the_moments_of_its_weights_about_its_joints(inclined):
    model, home = inclined.model, inclined.model.key("home").id
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, home)
    mujoco.mj_forward(model, data)
    parents = model.body_parentid
    for name in ARM_JOINTS:
        joint = model.joint(f"rover1/{name}_joint").id
        carried = np.zeros(model.nbody, dtype=bool)
        carried[model.jnt_bodyid[joint]] = True
        for body in range(1, model.nbody):
            carried[body] |= carried[parents[body]]
        levers = data.xipos[carried] - data.xanchor[joint]
        weights = -GRAVITY * model.body_mass[carried, None] * INCLINED.up
        moment = np.cross(levers, weights).sum(axis=0) @ data.xaxis[joint]
        voltage = -moment / ARM_MOTOR.gross_stall_torque * ARM_MOTOR.voltage
        held = model.key_ctrl[home, model.actuator(f"rover1/{name}").id]
        assert held == pytest.approx(voltage, abs=1e-9), name
    # On level ground nothing turns the arm about its upright axis.
    assert abs(model.key_ctrl[home, model.actuator("rover1/base_yaw").id]) > 1e-3


def test_rover_at_0_volt_holds_on_the_slope_and_its_arm_stays(inclined):
    data = inclined.start()
    for wheel in WHEELS:
        assert data.actuator(f"rover1/{wheel}").ctrl[0] == 0.0
    before = data.body("rover1/chassis").xpos.copy()
    angles = [data.joint(f"rover1/{name}_joint").qpos[0] for name in ARM_JOINTS]
    inclined.run(data, 2.0)
    assert np.linalg.norm(data.body("rover1/chassis").xpos - before) < 1e-3
    after = [data.joint(f"rover1/{name}_joint").qpos[0] for name in ARM_JOINTS]
    np.testing.assert_allclose(after, angles, atol=5e-3)
    assert not warnings(data)


@pytest.mark.parametrize("slope", [(0.36, 0.0), (0.0, -0.36), (math.nan, 0.0), (0.1,)])
def test_slopes_of_more_than_twenty_degrees_are_refused(slope):
    with pytest.raises(ValueError, match="field slope: got .*, needs two angles within 20 degrees"):
        dataclasses.replace(PLAIN, slope=slope)
