"""The walk of long arms: its coordinates, its lattice, and how near it comes."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.braid.arm.chain import chain_pose, forward, identity
from controllers.braid.arm.inverse import TAIL, BinaryArm, InverseConfig, solve
from controllers.braid.arm.lattice_walk import WalkEffort, describe_tails, logarithms, misfit, walk
from controllers.braid.arm.stage import stage_pose

ARM = BinaryArm(20)


@pytest.fixture(scope="module")
def tails():
    return ARM.part(TAIL)


def targets(stages, count, seed):
    """Poses of stages whose legs have any length."""
    lengths = np.random.default_rng(seed).uniform(1.0, 1.3, (count, stages, 3))
    return chain_pose(stage_pose(lengths, 1.0))


def off_lattice(tilts, legs):
    """Distance of tilts (m, 2) from the nearest of many sums of two legs' tilts."""
    steps = np.stack(np.meshgrid(*2 * [np.arange(-15, 16)]), axis=-1).reshape(-1, 2)
    return np.linalg.norm(tilts[:, None] - (steps @ legs.T)[None], axis=2).min(axis=1)


def test_logarithms_are_scipys_exponential_coordinates():
    rng = np.random.default_rng(0)
    turns = Rotation.from_rotvec(rng.normal(0.0, 0.8, (200, 3)))
    places = rng.normal(0.0, 3.0, (200, 3))
    rows = np.column_stack([places, turns.as_matrix().reshape(-1, 9)])
    peer = RigidTransform.from_components(places, turns).as_exp_coords()
    np.testing.assert_allclose(logarithms(rows), peer, atol=1e-9)
    tiny = RigidTransform.from_exp_coords([1e-6, -2e-6, 0.0, 1.0, 2.0, 3.0])
    row = np.append(tiny.translation, tiny.rotation.as_matrix().ravel())
    np.testing.assert_allclose(logarithms(row[None])[0], tiny.as_exp_coords(), atol=1e-9)
    np.testing.assert_array_equal(logarithms(identity()[None])[0], np.zeros(6))


def test_tilts_of_short_chains_lie_on_a_lattice_and_those_of_long_ones_leave_it():
    """Spacing 0.2 rad: a target is 0.075 rad off in the median, so that cost is held there."""
    shape = describe_tails(forward(ARM.stages, np.eye(8, 6, dtype=int)), ARM.stages)
    np.testing.assert_allclose(np.linalg.norm(shape.lattice, axis=0), 0.2011, atol=1e-4)
    rng = np.random.default_rng(1)
    medians = {}
    for stages in (6, 20):
        words = rng.integers(0, 8, (1000, stages))
        tilts = logarithms(forward(ARM.stages, words))[:, :2]
        medians[stages] = np.median(off_lattice(tilts, shape.lattice))
    wanted = np.median(off_lattice(logarithms(targets(20, 1000, 2))[:, :2], shape.lattice))
    assert medians[6] < 0.004 < 0.015 < medians[20] < 0.03
    assert 0.07 < wanted < 0.08


def test_misfit_is_the_squared_deviation_from_tails_and_lattice(tails):
    shape = describe_tails(tails.poses, ARM.stages)
    coordinates = logarithms(tails.poses)
    precision = np.linalg.inv(np.cov(coordinates.T))
    some = targets(6, 50, 3)
    off = logarithms(some) - coordinates.mean(axis=0)
    lattice = off_lattice(logarithms(some)[:, :2], shape.lattice)
    expected = 0.5 * np.einsum("mi,ij,mj->m", off, precision, off)
    expected += 0.5 * shape.sharpness * lattice**2
    got = [misfit(shape, pose, np.empty(6)) for pose in some]
    np.testing.assert_allclose(got, expected, rtol=1e-5)


def test_walk_returns_the_word_whose_cost_it_reports(tails):
    shape, rng = ARM.tail_shape, np.random.default_rng(4)
    for target in targets(20, 3, 5):
        head = rng.integers(0, 8, 14)
        last, cost = walk(
            tails.tree, shape, ARM.goal(target), head, np.inf, WalkEffort(200, 2000), rng
        )
        word = np.append(head, tails.words[last])
        assert ARM.score(word, target).cost ** 2 == pytest.approx(cost, abs=1e-12)
        before = head.copy()
        assert walk(tails.tree, shape, ARM.goal(target), head, 0.0, WalkEffort(20, 99), rng) == (
            -1,
            0.0,
        )
        np.testing.assert_array_equal(head, before)


def test_walk_comes_much_nearer_than_exact_windows(tails):
    """Beyond the lattice's 0.075 rad, which windows of a search by cost hardly pass."""
    costs = {"walk": [], "neighbourhood": []}
    for target in targets(20, 5, 6):
        for method, found in costs.items():
            found.append(solve(ARM, target, method, np.random.default_rng(0)).cost)
    assert np.median(costs["walk"]) < 0.85 * np.median(costs["neighbourhood"])


def test_walk_is_never_better_than_the_exact_search_and_repeats_with_its_seed(tails):
    eight = BinaryArm(8, config=InverseConfig(looks=200, steps=400))
    for target in targets(8, 5, 7):
        exact = solve(eight, target, "meet", np.random.default_rng(0)).cost
        one, two = (solve(eight, target, "walk", np.random.default_rng(1)) for _ in range(2))
        assert one.cost >= exact - 1e-12
        np.testing.assert_array_equal(one.word, two.word)


def test_walk_answers_where_nothing_is_in_reach_and_where_all_words_are_alike(tails):
    target = targets(20, 1, 8)[0]
    target[:3] += [50.0, 0.0, 0.0]
    start = BinaryArm(20, config=InverseConfig(looks=0, steps=0, polish=(), neighbourhoods=()))
    some = BinaryArm(20, config=InverseConfig(steps=50, neighbourhoods=((2, 3),)))
    costs = [solve(arm, target, "walk", np.random.default_rng(0)).cost for arm in (start, some)]
    assert np.isfinite(costs[0]) and costs[1] <= costs[0] + 1e-12
    stiff = stage_pose(np.ones((8, 3)), 1.0)
    shape = describe_tails(np.tile(stiff[:1], (4, 1)), stiff)
    assert np.isfinite(misfit(shape, stiff[0], np.empty(6)))


def test_efforts_that_are_none_are_named():
    with pytest.raises(ValueError, match="looks -1"):
        InverseConfig(looks=-1)
    with pytest.raises(ValueError, match="polish"):
        InverseConfig(polish=((9, 1),))
