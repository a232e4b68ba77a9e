"""Chains of stages multiply, and straight stages commute."""

import numpy as np
import pytest

from controllers.braid.arm.chain import (
    all_words,
    chain_pose,
    count_poses,
    forward,
    reduced_count,
    reduced_words,
    relative,
)
from controllers.braid.arm.stage import StageGeometry, state_poses

STAGES = state_poses(StageGeometry())


def matrix(row):
    out = np.eye(4)
    out[:3, 3], out[:3, :3] = row[:3], row[3:].reshape(3, 3)
    return out


def test_chain_is_the_product_of_homogeneous_matrices():
    """Equation E-3."""
    words = np.random.default_rng(0).integers(0, 8, (20, 7))
    for word, pose in zip(words, forward(STAGES, words)):
        product = np.linalg.multi_dot([matrix(STAGES[state]) for state in word])
        np.testing.assert_allclose(matrix(pose), product, atol=1e-13)
    np.testing.assert_allclose(chain_pose(STAGES[words]), forward(STAGES, words))


def test_relative_pose_undoes_the_first():
    a, b = forward(STAGES, np.array([[1, 2, 3], [4, 5, 6]]))
    out = np.empty(12)
    relative(a, b, out)
    np.testing.assert_allclose(matrix(out), np.linalg.solve(matrix(a), matrix(b)), atol=1e-14)


@pytest.mark.parametrize("stages", [1, 2, 3, 4, 5])
def test_straight_stages_commute_and_nothing_else_coincides(stages):
    poses = forward(STAGES, all_words(stages))
    rounded = np.unique(np.round(poses, 7) + 0.0, axis=0)
    kept = reduced_words(stages)
    assert len(kept) == len(rounded) == count_poses(poses) == reduced_count(stages)
    assert count_poses(forward(STAGES, kept)) == len(kept)


def test_five_stages_reach_30744_poses():
    assert count_poses(forward(STAGES, all_words(5))) == 30744


def test_words_that_are_none_are_refused():
    with pytest.raises(ValueError, match="0 to 7"):
        forward(STAGES, np.array([0, 8]))
    with pytest.raises(ValueError, match="8 stages"):
        all_words(8)
