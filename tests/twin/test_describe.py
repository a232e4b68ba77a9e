"""The extractor of descriptions, against the datasheets and against MuJoCo."""

import dataclasses

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from models.compose import ARM_JOINTS, FLAT, WHEELS, FieldConfig, RobotPlacement, make_model
from models.datasheets import ARM, ARM_MOTOR, CAMERA, CARD_AND_SLOT, FORCE_TORQUE, ROVER
from twin.describe import body_pose, camera_in_world, describe, describe_rover

ROBOT = "rover1"


def posed(angles, card=False):
    """A scene with the arm at some angles."""
    model = make_model(FLAT, [RobotPlacement(ROBOT, card=card)])
    data = mujoco.MjData(model)
    for name, angle in zip(ARM_JOINTS, angles, strict=True):
        data.joint(f"{ROBOT}/{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    return model, data


def test_rover_has_the_numbers_of_its_datasheets():
    rover = describe_rover(ROBOT)
    assert rover.axes == (*WHEELS, *ARM_JOINTS)
    assert rover.wheel_radius == ROVER.wheel_radius
    assert rover.half_track == pytest.approx(ROVER.half_track, rel=1e-12)
    assert rover.half_wheelbase == pytest.approx(ROVER.half_wheelbase, rel=1e-12)
    assert rover.centre_height == ROVER.centre_height
    assert rover.body.mass == pytest.approx(ROVER.mass)
    np.testing.assert_allclose(rover.body.centre, 0.0, atol=1e-6)
    np.testing.assert_allclose(rover.arm.transform_base_to_robot.translation, ROVER.arm_mount)
    np.testing.assert_array_equal(rover.arm.home, ARM.home)
    np.testing.assert_array_equal(rover.arm.limits, ARM.joint_limits)
    for joint in rover.arm.joints:
        assert (joint.rotor_inertia, joint.friction) == (ARM_MOTOR.armature, ARM_MOTOR.friction)
    for wheel in rover.wheels:
        assert (wheel.mass, wheel.spring) == (ROVER.wheel_mass, ROVER.spring)
        assert wheel.damper == ROVER.damper
    arm = rover.arm.base.mass + sum(joint.body.mass for joint in rover.arm.joints)
    assert arm == pytest.approx(ARM.mass)
    assert (rover.head.camera.fx, rover.head.camera.cy) == (CAMERA.pinhole.fx, CAMERA.pinhole.cy)
    assert rover.head.baseline == CAMERA.baseline
    noise = [FORCE_TORQUE.force_noise] * 3 + [FORCE_TORQUE.torque_noise] * 3
    np.testing.assert_array_equal(rover.sensor_sigma["arm_base_wrench"], noise)


def test_described_chain_puts_the_camera_where_mujoco_has_it():
    rover = describe_rover(ROBOT)
    angles = np.random.default_rng(3).uniform(*rover.arm.limits.T)
    model, data = posed(angles)
    pose = rover.arm.transform_base_to_robot
    for joint, angle in zip(rover.arm.joints, angles, strict=True):
        turn = Rotation.from_rotvec(angle * np.array(joint.axis))
        pose = pose * joint.transform_link_to_parent * RigidTransform.from_rotation(turn)
    camera = body_pose(data, model.body(f"{ROBOT}/chassis").id).inv() * camera_in_world(
        model, data, f"{ROBOT}/stereo_left"
    )
    described = pose * rover.head.transform_camera_to_wrist
    np.testing.assert_allclose(described.as_matrix(), camera.as_matrix(), atol=1e-12)


def test_cover_points_lie_within_the_arm_and_their_spheres_hold_its_shapes():
    rover = describe_rover(ROBOT)
    model, data = posed(np.zeros(4))
    wrist = model.body(f"{ROBOT}/wrist").id
    shapes = (model.body_weldid[model.geom_bodyid] == wrist) & (model.geom_group == 3)
    to_wrist = body_pose(data, wrist).inv()
    points = rover.arm.joints[-1].cover_points
    for geom in np.flatnonzero(shapes):
        assert model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1).T
        corners = signs * model.geom_size[geom]
        corners = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        far = np.linalg.norm(points[:, None] - to_wrist.apply(corners), axis=2).min(axis=0)
        assert far.max() < rover.arm.cover_radius


def test_card_in_the_gripper_counts_as_part_of_the_wrist():
    without, holding = describe_rover(ROBOT), describe_rover(ROBOT, card=True)
    bare, loaded = without.arm.joints[-1].body, holding.arm.joints[-1].body
    sheet = CARD_AND_SLOT
    volume = sheet.card_width * sheet.card_length * sheet.card_thickness
    assert loaded.mass - bare.mass == pytest.approx(volume * sheet.card_density, rel=1e-6)
    assert loaded.centre[1] > bare.centre[1]
    for ours, theirs in zip(without.arm.joints[:-1], holding.arm.joints[:-1], strict=True):
        assert ours.body.mass == theirs.body.mass
    assert dataclasses.replace(holding, arm=None).body.mass == without.body.mass


def test_description_does_not_depend_on_the_pose_of_the_robot():
    field = FieldConfig(relief=0.02, seed=3, texture_pixels=16)
    robots = [RobotPlacement("a", (1.0, 0.3), 0.7), RobotPlacement("b", (-1.0, 0.3), -2.0)]
    model = make_model(field, robots)
    drawn = describe_rover(ROBOT)
    for name in "ab":
        there = describe(model, name)
        assert there.name == name
        np.testing.assert_allclose(there.body_spheres, drawn.body_spheres, atol=1e-12)
        np.testing.assert_allclose(there.body.inertia, drawn.body.inertia, atol=1e-12)
        np.testing.assert_allclose(
            there.arm.transform_base_to_robot.as_matrix(),
            drawn.arm.transform_base_to_robot.as_matrix(),
            atol=1e-12,
        )


def test_rover_without_its_arm_has_neither_arm_nor_head():
    rover = describe_rover(ROBOT, arm=False)
    assert rover.arm is None and rover.head is None
    assert rover.axes == WHEELS
    assert rover.body.mass == describe_rover(ROBOT).body.mass


def test_unknown_robot_and_hinge_beside_its_body_are_refused():
    model = make_model(FLAT, [RobotPlacement(ROBOT)])
    with pytest.raises(ValueError, match="no robot 'rover9'"):
        describe(model, "rover9")
    model.jnt_pos[model.joint(f"{ROBOT}/elbow_joint").id] = [0.0, 0.01, 0.0]
    with pytest.raises(ValueError, match="elbow of rover1: not a hinge"):
        describe(model, ROBOT)


def test_each_wheel_has_the_spring_and_damper_of_its_own_strut():
    model = make_model(FLAT, [RobotPlacement(ROBOT), RobotPlacement("rover2", (2.0, 0.0))])
    struts = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    stiffness = 100.0 + np.arange(len(struts))
    model.jnt_stiffness[struts] = stiffness
    model.dof_damping[model.jnt_dofadr[struts]] = stiffness / 10.0
    wheels = [wheel for name in (ROBOT, "rover2") for wheel in describe(model, name).wheels]
    np.testing.assert_array_equal([wheel.spring for wheel in wheels], stiffness)
    np.testing.assert_allclose([wheel.damper for wheel in wheels], stiffness / 10.0)


def test_track_is_across_and_wheelbase_along_the_rover():
    rover = describe_rover(ROBOT)
    wheels = tuple(
        dataclasses.replace(wheel, centre=wheel.centre * [2.0, 3.0, 1.0]) for wheel in rover.wheels
    )
    stretched = dataclasses.replace(rover, wheels=wheels)
    assert stretched.half_track == pytest.approx(2.0 * ROVER.half_track)
    assert stretched.half_wheelbase == pytest.approx(3.0 * ROVER.half_wheelbase)
