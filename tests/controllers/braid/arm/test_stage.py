"""The exact stage closes its loops, and the thesis' equations come near it."""

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from controllers.braid.arm.flexure import MATERIALS, greatest_thickness, joint_angles, stiffness
from controllers.braid.arm.stage import (
    RADIAL,
    StageGeometry,
    closure_residual,
    stage_pose,
    state_lengths,
    state_poses,
)
from controllers.braid.arm.thesis_stage import thesis_stage_pose

RADIUS = 0.05
DRAWN = np.random.default_rng(0).uniform(0.05, 0.065, (500, 3))


def test_random_legs_close_their_loops_to_1e_12():
    poses = stage_pose(DRAWN, RADIUS)
    assert np.abs(closure_residual(poses, DRAWN, RADIUS)).max() <= 1e-12
    rotation = poses[:, 3:].reshape(-1, 3, 3)
    np.testing.assert_allclose(rotation @ rotation.mT, np.tile(np.eye(3), (500, 1, 1)), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0)


def test_stage_agrees_with_loop_equations_solved_in_six_unknowns():
    """The platform's pose found by a third party from joints and hinges in the base frame."""
    joints = np.column_stack([RADIAL, np.zeros(3)])
    hinges = np.cross([0.0, 0.0, 1.0], joints)

    def residual(unknown, lengths):
        turn = Rotation.from_rotvec(unknown[3:])
        legs = unknown[:3] + turn.apply(joints) - joints
        along = np.sum(legs * turn.apply(hinges), axis=1)
        return np.append(np.linalg.norm(legs, axis=1) - lengths, along)

    for lengths in DRAWN[:20] / RADIUS:
        found = fsolve(residual, [0.0, 0.0, 1.1, 0.0, 0.0, 0.0], args=(lengths,), xtol=1e-13)
        pose = stage_pose(lengths, 1.0)
        np.testing.assert_allclose(pose[:3], found[:3], atol=1e-9)
        turn = Rotation.from_rotvec(found[3:]).as_matrix().ravel()
        np.testing.assert_allclose(pose[3:], turn, atol=1e-9)


def test_legs_passed_on_by_one_turn_the_pose_by_a_third():
    third = Rotation.from_euler("z", 120.0, degrees=True).as_matrix()
    poses, turned = stage_pose(DRAWN, RADIUS), stage_pose(np.roll(DRAWN, 1, axis=1), RADIUS)
    np.testing.assert_allclose(turned[:, :3], poses[:, :3] @ third.T, atol=1e-12 * RADIUS)
    rotation = third @ poses[:, 3:].reshape(-1, 3, 3) @ third.T
    np.testing.assert_allclose(turned[:, 3:], rotation.reshape(-1, 9), atol=1e-12)


def test_equal_legs_lift_straight_and_scale_with_the_radius():
    np.testing.assert_allclose(stage_pose(np.full(3, 0.06), RADIUS)[:3], [0, 0, 0.06], atol=1e-15)
    small, large = stage_pose(DRAWN, RADIUS), stage_pose(10.0 * DRAWN, 10.0 * RADIUS)
    np.testing.assert_allclose(large[:, :3], 10.0 * small[:, :3], atol=1e-14)


@pytest.mark.parametrize(
    ("extension", "mirrored", "any_state", "normal"),
    [(0.05, 3.5e-6, 7e-4, 6e-6), (0.2, 2.5e-4, 1.1e-2, 4e-4)],
)
def test_repaired_thesis_equations_come_near_the_stage(extension, mirrored, any_state, normal):
    lengths = state_lengths(StageGeometry(1.0, 1.0, 1.0 + extension))
    off = np.abs(thesis_stage_pose(lengths, 1.0) - stage_pose(lengths, 1.0))
    assert off[[0, 1, 6, 7], :3].max() <= mirrored
    assert off[:, :3].max() <= any_state
    assert off[:, [5, 8, 11]].max() <= normal


def test_bad_stages_are_named():
    with pytest.raises(ValueError, match="radius -1"):
        StageGeometry(radius=-1.0)
    with pytest.raises(ValueError, match="legs 2"):
        StageGeometry(short=2.0, long=1.0)
    with pytest.raises(ValueError, match="positive lengths"):
        stage_pose(np.array([1.0, 0.0, 1.0]), 1.0)
    with pytest.raises(RuntimeError, match="cannot be closed"):
        stage_pose(np.array([0.1, 9.0, 0.1]), 1.0)


def test_thickest_strip_for_an_angle_is_strained_to_the_limit():
    length, width, angle = 5e-3, 10e-3, 0.4
    for material in MATERIALS.values():
        thickness = greatest_thickness(length, angle, material)
        strain = thickness / (2.0 * length / angle)  # on the outside of an arc (E-1)
        assert strain == pytest.approx(material.bendability)
        # The bending moment of a beam strained so, from its stress: sigma w t^2 / 6.
        moment = strain * material.modulus * width * thickness**2 / 6.0
        assert stiffness(length, width, thickness, material) * angle == pytest.approx(moment)
    # Spring steel of 1 mm may be bent to a radius of 0.1 m (E-2).
    assert greatest_thickness(0.1, 1.0, MATERIALS["spring steel"]) == pytest.approx(1e-3)
    with pytest.raises(ValueError, match="angle 0"):
        greatest_thickness(1.0, 0.0, MATERIALS["nylon"])


def test_joint_angles_bound_those_of_all_states():
    geometry = StageGeometry()
    base, platform = joint_angles(geometry)
    tilt = np.arccos(state_poses(geometry)[:, 11].min())
    assert 0.0 < platform < base <= tilt + platform
