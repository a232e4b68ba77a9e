"""Poses, Jacobian and dynamics of the serial chain against MuJoCo and closed forms."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.rigid_motion import (
    LEVEL,
    WEIGHTLESS,
    FrameMotion,
    inertial_parameters,
    wrench_regressor,
)
from controllers.kinematics.serial_chain import SerialChain
from models.compose import ARM_JOINTS, FieldConfig, RobotPlacement, make_model
from models.datasheets import CAMERA_CALIBRATION, SENSOR_ERRORS, TOLERANCES
from perception.geometry.gravity import GRAVITY
from twin.describe import body_pose, camera_in_world, describe
from twin.description import JointDescription, RigidBody
from twin.realism import as_stated

MODEL = make_model(FieldConfig(texture_pixels=16), [RobotPlacement("rover1", (0.3, -0.2), 0.7)])
MODEL.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
ROBOT = describe(MODEL, "rover1")
ARM = SerialChain.of_robot(ROBOT)
ANGLES = np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 1.2, -1.8, 0.4], [-2.0, 0.3, 0.9, -1.0]])
BOX = RigidBody(0.2, np.array([0.01, 0.12, -0.015]), np.diag([2e-4, 1e-4, 3e-4]))
IDENTITY = RigidTransform.identity()


def posed(angles):
    data = mujoco.MjData(MODEL)
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        data.joint(f"rover1/{name}_joint").qpos = angle
    mujoco.mj_kinematics(MODEL, data)
    mujoco.mj_comPos(MODEL, data)
    mujoco.mj_camlight(MODEL, data)
    return data


@pytest.mark.parametrize("angles", ANGLES)
def test_camera_is_where_mujoco_puts_it(angles):
    data = posed(angles)
    chassis = body_pose(data, MODEL.body("rover1/chassis").id)
    true = (chassis.inv() * camera_in_world(MODEL, data, "rover1/stereo_left")).as_matrix()
    np.testing.assert_allclose(ARM.tool_in_robot(angles).as_matrix(), true, atol=1e-12)
    np.testing.assert_allclose(ARM.tool_frame(angles), true, atol=1e-12)


def test_many_configurations_at_once_are_the_same_as_one_by_one():
    together = ARM.tool_in_robot(ANGLES).as_matrix()
    alone = [ARM.tool_in_robot(angles).as_matrix() for angles in ANGLES]
    np.testing.assert_allclose(together, alone, atol=1e-14)
    rates, accelerations = np.random.default_rng(0).normal(size=(2, 3, 4))
    efforts, wrenches = ARM.inverse_dynamics(ANGLES, rates, accelerations)
    for k in range(3):
        effort, wrench = ARM.inverse_dynamics(ANGLES[k], rates[k], accelerations[k])
        np.testing.assert_allclose(efforts[k], effort, atol=1e-14)
        np.testing.assert_allclose(wrenches[k], wrench, atol=1e-14)


@pytest.mark.parametrize("angles", ANGLES)
def test_jacobian_is_mujocos(angles):
    site = MODEL.site("rover1/gripper").id
    assert ROBOT.arm is not None
    wrist = SerialChain.from_description(
        ROBOT.arm, RigidTransform.from_translation(MODEL.site_pos[site])
    )
    data = posed(angles)
    linear, angular = np.zeros((2, 3, MODEL.nv))
    mujoco.mj_jacSite(MODEL, data, linear, angular, site)
    dofs = [MODEL.joint(f"rover1/{name}_joint").dofadr[0] for name in ARM_JOINTS]
    to_robot = data.body("rover1/chassis").xmat.reshape(3, 3).T
    true = np.vstack([to_robot @ linear[:, dofs], to_robot @ angular[:, dofs]])
    np.testing.assert_allclose(wrist.jacobian(angles), true, atol=1e-12)


def test_spheres_about_the_cover_points_hold_the_moving_collision_shapes():
    angles = ANGLES[1]
    data = posed(angles)
    chassis = body_pose(data, MODEL.body("rover1/chassis").id)
    points = chassis.apply(ARM.cover_points(angles[None])[0])
    generator = np.random.default_rng(0)
    moving = [
        MODEL.body(f"rover1/{n}").id for n in ("upper_arm", "forearm", "wrist", "stereo_head")
    ]
    for geom in np.flatnonzero(np.isin(MODEL.geom_bodyid, moving) & (MODEL.geom_group == 3)):
        centre, half = MODEL.geom_aabb[geom, :3], MODEL.geom_aabb[geom, 3:]
        inside = centre + generator.uniform(-half, half, (200, 3))
        world = inside @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        nearest = np.linalg.norm(world[:, None] - points, axis=2).min(axis=1)
        assert nearest.max() <= ARM.cover_radius


def random_motion(count, rng):
    """Inverse dynamics of random states of the whole rover: wrench, joints and base."""
    data = mujoco.MjData(MODEL)
    joints = [MODEL.joint(f"rover1/{name}_joint") for name in ARM_JOINTS]
    places, dofs = ([int(getattr(j, key)[0]) for j in joints] for key in ("qposadr", "dofadr"))
    mount = MODEL.site("rover1/attachment_site").pos
    rows = []
    for _ in range(count):
        data.qpos[:] = rng.normal(size=MODEL.nq)
        data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
        data.qvel[:] = rng.normal(size=MODEL.nv)
        data.qacc[:] = 5.0 * rng.normal(size=MODEL.nv)
        mujoco.mj_inverse(MODEL, data)
        sensors = [data.sensor(f"rover1/arm_base_{name}").data for name in ("force", "torque")]
        omega, alpha = data.qvel[3:6], data.qacc[3:6]
        turned = data.body("rover1/chassis").xmat.reshape(3, 3).T @ (
            data.qacc[:3] - MODEL.opt.gravity
        )
        turned += np.cross(alpha, mount) + np.cross(omega, np.cross(omega, mount))
        base = (turned, omega, alpha)
        state = (data.qpos[places], data.qvel[dofs], data.qacc[dofs])
        rows.append([np.concatenate(part) for part in (sensors, state, base)])
    wrench, state, base = (np.array(part) for part in zip(*rows))
    return wrench, np.split(state, 3, axis=1), FrameMotion(*np.split(base, 3, axis=1))


def test_wrench_on_the_arm_is_mujocos():
    wrench, motion, base = random_motion(50, np.random.default_rng(1))
    ours = ARM.inverse_dynamics(*motion, base)[1]
    assert np.abs(ours - wrench).max() <= 1e-9 * np.abs(wrench).max()


def test_regressor_of_the_last_link_is_what_a_heavier_link_adds():
    _, motion, base = random_motion(20, np.random.default_rng(2))
    added = wrench_regressor(ARM.last_link_motion(*motion, base)) @ inertial_parameters(BOX)
    carried = JointDescription("held", IDENTITY, (1.0, 0.0, 0.0), BOX)
    longer = SerialChain((*ARM.joints, carried), ARM.base)
    total = longer.inverse_dynamics(*(np.pad(part, ((0, 0), (0, 1))) for part in motion), base)[1]
    bare = ARM.inverse_dynamics(*motion, base)[1]
    np.testing.assert_allclose(bare + added, total, rtol=1e-12, atol=1e-12)


def test_inertia_of_the_locked_arm_is_symmetric_and_holds_its_mass():
    inertia = ARM.base_inertia(np.array([[0.3, 0.9, -1.4, 0.1]]))[0]
    np.testing.assert_allclose(inertia, inertia.T, atol=1e-12)
    np.testing.assert_allclose(inertia[:3, :3], 0.76 * np.eye(3), atol=1e-9)
    assert np.all(np.linalg.eigvalsh(inertia) > 0.0)


def test_push_of_the_tool_enters_by_the_jacobian_transposed():
    rng = np.random.default_rng(4)
    axis, place = (0.6, 0.0, 0.8), RigidTransform.from_translation(rng.normal(size=3))
    slide = JointDescription("slide", place, axis, WEIGHTLESS, slides=True)
    chain = SerialChain((slide, *ARM.joints))
    q, still = rng.normal(size=5), np.zeros(5)
    rest = chain.inverse_dynamics(q, still, still)
    last = chain.tool_in_robot(q)
    for push in np.eye(6):
        pushed = chain.inverse_dynamics(q, still, still, tip=push)
        turned = np.concatenate([last.rotation.apply(push[:3]), last.rotation.apply(push[3:])])
        np.testing.assert_allclose(pushed[0] - rest[0], chain.jacobian(q).T @ turned, atol=1e-12)
        moment = turned[3:] + np.cross(last.translation, turned[:3])
        expected = np.concatenate([turned[:3], moment])
        np.testing.assert_allclose(pushed[1] - rest[1], expected, atol=1e-12)


def test_slide_on_a_turned_hinge_is_shifted_along_its_axis():
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    offset = RigidTransform.from_translation([0.1, 0.0, 0.0])
    joints = (
        JointDescription("turn", IDENTITY, z, WEIGHTLESS),
        JointDescription("slide", offset, y, WEIGHTLESS, slides=True),
    )
    chain = SerialChain(joints)
    np.testing.assert_allclose(
        chain.tool_in_robot([np.pi / 2, 0.3]).translation, [-0.3, 0.1, 0.0], atol=1e-12
    )
    expected = [[-0.1, -0.3, 0.0, 0.0, 0.0, 1.0], [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
    np.testing.assert_allclose(chain.jacobian([np.pi / 2, 0.3]).T, expected, atol=1e-12)


def test_sliding_mass_on_a_turning_hinge_obeys_its_closed_form():
    """A bead on a horizontal rod: m (r'' - r w^2) along it, m (r^2 a + 2 r r' w) about the axis."""
    bead = RigidBody(2.0, np.zeros(3), np.zeros((3, 3)))
    joints = (
        JointDescription("turn", IDENTITY, (0.0, 0.0, 1.0), WEIGHTLESS, rotor_inertia=0.5),
        JointDescription("slide", IDENTITY, (1.0, 0.0, 0.0), bead, slides=True),
    )
    chain = SerialChain(joints)
    r, dr, ddr, w, a = 0.7, 0.3, -1.1, 2.0, 4.0
    efforts, wrench = chain.inverse_dynamics([0.4, r], [w, dr], [a, ddr])
    turning = 2.0 * (r**2 * a + 2.0 * r * dr * w)
    np.testing.assert_allclose(efforts, [turning + 0.5 * a, 2.0 * (ddr - r * w**2)], atol=1e-12)
    assert wrench[2] == pytest.approx(2.0 * GRAVITY)
    assert wrench[5] == pytest.approx(turning)
    np.testing.assert_allclose(
        chain.mass_matrix([0.4, r]), np.diag([2.0 * r**2 + 0.5, 2.0]), atol=1e-12
    )
    np.testing.assert_allclose(chain.bias([0.4, r], [0.0, 0.0]), 0.0, atol=1e-12)


def test_motion_of_the_last_link_is_that_of_its_own_accelerometer():
    """Specific force, rate and acceleration by finite differences of the link's pose."""
    rng = np.random.default_rng(7)
    q, v, a = rng.normal(size=(3, 4))
    found = dataclasses.replace(ARM, transform_base_to_robot=IDENTITY).last_link_motion(
        q[None], v[None], a[None], LEVEL
    )
    h = 1e-4
    bare = SerialChain(ARM.joints)
    before, here, after = (bare.tool_in_robot(q + t * v + 0.5 * t**2 * a) for t in (-h, 0.0, h))
    felt = (after.translation - 2.0 * here.translation + before.translation) / h**2
    inside = here.rotation.inv()
    np.testing.assert_allclose(
        found.motion.specific_force[0], inside.apply(felt + [0.0, 0.0, GRAVITY]), atol=1e-5
    )
    rate = inside.apply((after.rotation * before.rotation.inv()).as_rotvec() / (2.0 * h))
    np.testing.assert_allclose(found.motion.angular_velocity[0], rate, atol=1e-6)
    np.testing.assert_allclose(found.rotation[0], here.rotation.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found.position[0], here.translation, atol=1e-12)
    ahead = bare.last_link_motion(
        (q + h * v + 0.5 * h**2 * a)[None], (v + h * a)[None], a[None], LEVEL
    )
    turned = Rotation.from_matrix(ahead.rotation[0]).apply(ahead.motion.angular_velocity[0])
    growth = inside.apply(turned - here.rotation.apply(found.motion.angular_velocity[0])) / h
    np.testing.assert_allclose(found.motion.angular_acceleration[0], growth, atol=2e-2)


def test_bad_chains_and_states_are_refused():
    bent = JointDescription("bent", IDENTITY, (0.0, 0.0, 2.0), WEIGHTLESS)
    with pytest.raises(ValueError, match="axis of joint bent"):
        SerialChain((bent,))
    with pytest.raises(ValueError, match="without joints"):
        SerialChain(())
    with pytest.raises(ValueError, match="joint positions"):
        ARM.mass_matrix([0.0, np.nan, 0.0, 0.0])
    for bad in (np.zeros(3), np.full(4, np.nan), np.zeros((2, 2, 4))):
        with pytest.raises(ValueError, match="joint positions"):
            ARM.tool_in_robot(bad)
    with pytest.raises(ValueError, match="rover1 has no arm"):
        SerialChain.of_robot(dataclasses.replace(ROBOT, arm=None))


@pytest.mark.parametrize("angles", ANGLES)
def test_tool_moves_by_errors_of_mounting_and_joints_as_a_finite_difference_says(angles):
    step, slopes = 1e-6, []
    for axis in range(10):
        ends = []
        for sign in (1.0, -1.0):
            error = sign * step * np.eye(10)[axis]
            mounted = ARM.tool_in_robot(angles + error[6:])
            ends.append(mounted * RigidTransform.from_exp_coords(error[:6]))
        slopes.append((ends[0] * ends[1].inv()).as_exp_coords() / (2.0 * step))
    np.testing.assert_allclose(ARM.error_jacobian(angles), np.transpose(slopes), atol=1e-8)


def test_arm_as_drawn_has_no_errors_and_a_stated_one_those_of_its_sheets():
    assert not ARM.error_covariance().any()
    stated = SerialChain.of_robot(as_stated(ROBOT, "default")).error_covariance()
    turn, shift = np.sqrt(np.diag(stated))[[0, 3]]
    sheet, made = CAMERA_CALIBRATION, TOLERANCES
    assert turn == pytest.approx(np.hypot(sheet.head_turn, sheet.eye_turn))
    joints = 4 * made.length**2 / 3.0  # uniform
    assert shift == pytest.approx(np.sqrt(sheet.head_shift**2 + sheet.eye_shift**2 + joints))
    # Many arms: the zeros of their encoders, and gears that all rest on one side of their play.
    rng, count = np.random.default_rng(0), 200_000
    zeros = rng.uniform(-1.0, 1.0, (count, 4)) * SENSOR_ERRORS.encoder_zero
    side = rng.choice([-1.0, 1.0], (count, 1))
    zeros += side * rng.uniform(*made.backlash, (count, 4)) / 2.0
    assert not stated[:6, 6:].any()
    np.testing.assert_allclose(stated[6:, 6:], np.cov(zeros.T), rtol=0.02)
