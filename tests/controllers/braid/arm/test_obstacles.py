"""Occupied voxels in the arm's way, held against bodies sampled densely."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.braid.arm.chain import all_words, forward, identity
from controllers.braid.arm.inverse import CLEAR_METHODS, BinaryArm, solve
from controllers.braid.arm.obstacles import LinkCheck, VoxelObstacles
from controllers.braid.arm.stage import StageGeometry, rim_joints
from experiments.appe.arm.inverse_trial import draw_targets
from perception.geometry.pinhole import Frustum
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State

ARM = BinaryArm(3)
WORDS = all_words(3)
STEP = 0.03
"""No place of the body is farther from a sample than this [r]."""


def ball_of_voxels(side=0.13, centre=(1.3, 0.5, 2.6), radius=0.3):
    cells = np.stack(np.meshgrid(*3 * [np.arange(-40, 40)]), axis=-1).reshape(-1, 3)
    centres = (cells + 0.5) * side
    return centres[np.sum((centres - centre) ** 2, axis=1) < radius**2]


def dense_body(word):
    """Points (n, 3) all over the legs and platforms of a word."""
    joints, points = rim_joints(ARM.geometry.radius), []
    along = np.linspace(0.0, 1.0, 60)[:, None, None]
    x, y = np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 67)])
    disc = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    bearing = np.linspace(0.0, 2.0 * np.pi, 220)
    rim = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(220)])
    disc = np.vstack([disc[np.hypot(*disc[:, :2].T) <= 1.0], rim])
    for k in range(len(word)):
        base = forward(ARM.stages, word[:k]) if k else identity()
        top = forward(ARM.stages, word[: k + 1])
        ends = [joints @ pose[3:].reshape(3, 3).T + pose[:3] for pose in (base, top)]
        points.append((ends[0] + along * (ends[1] - ends[0])).reshape(-1, 3))
        points.append(disc @ top[3:].reshape(3, 3).T + top[:3])
    return np.vstack(points)


def test_words_are_clear_where_no_place_of_a_dense_body_is_within_reach():
    voxels = VoxelObstacles(ball_of_voxels(), 0.13, margin=0.05)
    clear = LinkCheck(ARM.geometry, voxels).free(WORDS)
    assert 50 < clear.sum() < len(WORDS) - 50
    tree, sure = KDTree(voxels.centres), 0
    for word, free in zip(WORDS[::9], clear[::9], strict=True):
        least = tree.query(dense_body(word))[0].min()  # the true one is less by a step at most
        assert least > voxels.reach if free else least < voxels.reach + STEP
        sure += not voxels.reach < least < voxels.reach + STEP
    assert sure > 45


def test_no_place_of_a_clear_body_is_in_a_cube_that_slips_between_samples():
    """One small cube in the middle of a leg, where the sampled body has no point."""
    joints = rim_joints(ARM.geometry.radius)
    small = VoxelObstacles(joints[:1] + [0.0, 0.0, 0.385], 0.02)  # state 0 is upright

    def sampled(points):
        return np.all(np.abs(points - small.centres[0]) < 0.01, axis=1).astype(float)

    word = np.zeros((1, 3), dtype=int)
    assert not LinkCheck(ARM.geometry, small).free(word)[0]
    assert LinkCheck(ARM.geometry, sampled).free(word)[0]


@pytest.mark.parametrize("method", CLEAR_METHODS)
def test_word_among_voxels_is_the_best_of_all_clear_ones(method):
    check = LinkCheck(ARM.geometry, VoxelObstacles(ball_of_voxels(), 0.13))
    clear, rng = check.free(WORDS), np.random.default_rng(0)
    poses = forward(ARM.stages, WORDS[clear])
    avoided = 0
    for target in draw_targets("reachable", 3, 20, ARM.geometry, np.random.default_rng(1)):
        off = poses - target
        costs = np.sum(off[:, :3] ** 2, axis=1) + 0.5 * np.sum(off[:, 3:] ** 2, axis=1)
        solution = solve(ARM, target, method, rng, check)
        assert solution.cost**2 == pytest.approx(costs.min(), abs=1e-12)
        assert check.free(solution.word[None])[0]
        avoided += solution.cost > solve(ARM, target, "kd-tree", rng).cost + 1e-9
    assert avoided > 2


def seen_map():
    """A map of a wall at x = 1.25 that a camera at the world's origin has seen."""
    camera = RigidTransform.from_components(
        [0.0, 0.0, 2.0], Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    )
    view = Frustum(60, 60, 60.0, 60.0, 29.5, 29.5, near=0.1, far=6.0)
    points = camera.apply(view.rays(view.pixel_grid()).reshape(-1, 3) * 1.25)
    voxels = VoxelMap(VoxelGrid(0.1, (-0.5, -2.0, 0.0), (2.0, 2.0, 4.0)))
    for _ in range(2):
        voxels.insert(camera, view, points, np.tile(1e-4 * np.eye(3), (len(points), 1, 1)))
    return voxels


def test_arm_solves_beside_a_mapped_wall_without_touching_it():
    voxels = seen_map()
    occupied, _ = voxels.occupied_cells()
    check = LinkCheck(ARM.geometry, VoxelObstacles(voxels.grid.centres(occupied), 0.1))
    rng, touched = np.random.default_rng(0), 0
    for target in draw_targets("reachable", 3, 30, ARM.geometry, np.random.default_rng(3)):
        plain, word = (solve(ARM, target, "kd-tree", rng, how).word for how in (None, check))
        states = [voxels.states(dense_body(which)) for which in (plain, word)]
        touched += np.any(states[0] == State.OCCUPIED)
        assert not np.any(states[1] == State.OCCUPIED)
    assert touched > 2


def test_no_voxels_are_no_obstacle_and_what_is_none_is_named():
    none = VoxelObstacles(np.empty((0, 3)), 0.1)
    assert LinkCheck(StageGeometry(), none).free(WORDS).all()
    with pytest.raises(ValueError, match="side 0"):
        VoxelObstacles(np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match="margin -1"):
        VoxelObstacles(np.zeros((1, 3)), 0.1, -1.0)
    with pytest.raises(ValueError, match=r"centres \(2, 2\)"):
        VoxelObstacles(np.zeros((2, 2)), 0.1)
