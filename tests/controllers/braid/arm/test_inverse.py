"""Searches for words, held against brute force."""

import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from controllers.braid.arm.chain import all_words, forward, identity
from controllers.braid.arm.heuristics import TipGoal, exchange, squared_cost
from controllers.braid.arm.inverse import (
    CLEAR_METHODS,
    METHODS,
    BinaryArm,
    InverseConfig,
    solve,
)
from controllers.braid.arm.meeting import improve_free_stages, meet, pairs_below
from controllers.braid.arm.obstacles import LinkCheck, body_points
from controllers.braid.arm.pose_tree import build_tree, gather, nearest
from experiments.appe.arm.inverse_trial import draw_targets

SHORT = InverseConfig(neighbourhoods=((2, 4), (3, 2)), restarts=3)
THREE, FOUR = BinaryArm(3, config=SHORT), BinaryArm(4, config=InverseConfig(weight=0.4))


def targets(stages, count, seed=0):
    rng = np.random.default_rng(seed)
    return draw_targets("reachable", stages, count, THREE.geometry, rng)


def brute_costs(arm, target):
    """Squared costs of all words, by rotations' angles."""
    poses = forward(arm.stages, all_words(arm.count))
    turn = Rotation.from_matrix(poses[:, 3:].reshape(-1, 3, 3))
    angle = (turn * Rotation.from_matrix(target[3:].reshape(3, 3)).inv()).magnitude()
    moved = np.sum((poses[:, :3] - target[:3]) ** 2, axis=1)
    return moved + arm.config.weight**2 * 4.0 * np.sin(angle / 2.0) ** 2


@pytest.mark.parametrize("method", ["exhaustive", "kd-tree", "meet", "neighbourhood"])
@pytest.mark.parametrize("arm", [THREE, FOUR], ids=["3 stages", "4 stages, lighter turns"])
def test_exact_methods_equal_brute_force(arm, method):
    rng = np.random.default_rng(1)
    for target in targets(arm.count, 20):
        solution = solve(arm, target, method, rng)
        assert solution.cost**2 == pytest.approx(brute_costs(arm, target).min(), abs=1e-12)
        assert solution.cost == pytest.approx(
            np.hypot(solution.displacement, 2.0 * arm.config.weight * np.sin(solution.angle / 2.0))
        )


def test_tree_finds_what_scipys_tree_finds():
    part = FOUR.part(4)
    scale = np.append(np.ones(3), np.full(9, 0.4 / np.sqrt(2.0)))
    peer = KDTree(part.poses * scale)
    for target in targets(4, 30, seed=5):
        found, cost = nearest(part.tree, target, np.inf)
        distance, index = peer.query(target * scale)
        assert (found, cost) == (index, pytest.approx(distance**2))
        inside, costs = np.empty(4096, dtype=np.int64), np.empty(4096)
        count = gather(part.tree, target, 0.3, inside, costs)
        assert set(inside[:count]) == set(peer.query_ball_point(target * scale, 0.3**0.5))
        assert nearest(part.tree, target, 0.5 * cost) == (-1, 0.5 * cost)


def test_halves_that_meet_find_the_best_whole_word():
    half = THREE.part(2)
    four = BinaryArm(4)
    for target in targets(4, 20):
        first, last, cost = meet(half.tree, half.poses, target, np.inf)
        word = np.append(half.words[first], half.words[last])
        least = brute_costs(four, target).min()
        assert cost == pytest.approx(least, abs=1e-12)
        assert four.score(word, target).cost ** 2 == pytest.approx(least, abs=1e-12)
        _, costs, total = pairs_below(half.tree, half.poses, target, 4.0 * cost + 1e-9, 4096)
        assert total == len(costs) and costs.min() == pytest.approx(cost)


def test_planted_words_of_ten_stages_are_recovered():
    arm, rng = BinaryArm(10), np.random.default_rng(2)
    for target in draw_targets("planted", 10, 5, arm.geometry, rng):
        assert solve(arm, target, "meet", rng).cost < 1e-9


def test_freed_stages_are_searched_exactly():
    """Stages 1 and 3 of four free, with a tail of two: all 8^4 combinations tried."""
    tail, rng = THREE.part(2), np.random.default_rng(3)
    six = BinaryArm(6)
    for target in targets(6, 3):
        word = rng.integers(0, 8, 4)
        trial = np.tile(word, (64, 1))
        trial[:, [1, 3]] = all_words(2)
        whole = np.column_stack([np.repeat(trial, 64, axis=0), np.tile(all_words(2), (64, 1))])
        off = forward(six.stages, whole) - target
        least = np.min(np.sum(off[:, :3] ** 2, axis=1) + 0.5 * np.sum(off[:, 3:] ** 2, axis=1))
        free = np.array([False, True, False, True])
        last, cost = improve_free_stages(tail.tree, six.stages, word, free, target, np.inf)
        assert cost == pytest.approx(least, abs=1e-12)
        found = six.score(np.append(word, tail.words[last]), target)
        assert found.cost**2 == pytest.approx(least, abs=1e-12)


def test_exchange_ends_where_no_three_legs_are_better():
    rng = np.random.default_rng(4)
    flips = np.array([sum(1 << b for b in bits) for bits in _up_to_three(12)])
    for target in targets(4, 5):
        word = rng.integers(0, 8, 4)
        cost = exchange(TipGoal(FOUR.stages, target, 0.5), word)
        assert cost == pytest.approx(squared_cost(forward(FOUR.stages, word), target, 0.5))
        code = int(word @ 8 ** np.arange(4))
        around = ((code ^ flips)[:, None] >> (3 * np.arange(4))) & 7
        off = forward(FOUR.stages, around) - target
        costs = np.sum(off[:, :3] ** 2, axis=1) + 0.5 * np.sum(off[:, 3:] ** 2, axis=1)
        assert costs.min() >= cost - 1e-12


def _up_to_three(bits):
    singles = range(bits)
    return [{a, b, c} for a in singles for b in singles for c in singles if a <= b <= c]


def test_heuristics_are_never_better_than_exact_ones_and_repeat_with_their_seed():
    for target in targets(4, 10):
        exact = solve(FOUR, target, "exhaustive", np.random.default_rng(0)).cost
        for method in ("genetic", "exchange"):
            one, two = (solve(FOUR, target, method, np.random.default_rng(7)) for _ in range(2))
            assert one.cost >= exact - 1e-12
            np.testing.assert_array_equal(one.word, two.word)


def test_neighbourhoods_of_long_arms_only_improve_on_their_start():
    target = targets(12, 1)[0]
    none = BinaryArm(12, config=InverseConfig(neighbourhoods=()))
    some = BinaryArm(12, config=SHORT)
    for seed in range(3):
        before, after = (
            solve(arm, target, "neighbourhood", np.random.default_rng([seed, 0])).cost
            for arm in (none, some)
        )
        assert after <= before + 1e-12


def wall(points):
    """Occupied beyond x = 1.2 above z = 1.2, and a ball at the other side."""
    ball = np.sum((points - [-1.6, 0.3, 2.6]) ** 2, axis=1) < 0.3
    return (((points[:, 0] > 1.2) & (points[:, 2] > 1.2)) | ball).astype(float)


def test_free_words_are_those_whose_every_body_point_is_free():
    check, body = LinkCheck(THREE.geometry, wall), body_points(THREE.geometry)
    words = all_words(3)
    clear = []
    for word in words:
        points = []
        for k in range(3):
            base = forward(THREE.stages, word[None, :k])[0] if k else identity()
            points.append(body[word[k]] @ base[3:].reshape(3, 3).T + base[:3])
        clear.append(not wall(np.vstack(points)).any())
    clear = np.array(clear)
    assert 0 < clear.sum() < len(words)
    np.testing.assert_array_equal(check.free(words), clear)


@pytest.mark.parametrize("method", CLEAR_METHODS)
def test_clear_word_is_the_best_of_all_clear_ones(method):
    check, rng = LinkCheck(THREE.geometry, wall), np.random.default_rng(0)
    clear = check.free(all_words(3))
    for target in targets(3, 10):
        solution = solve(THREE, target, method, rng, check)
        assert check.free(solution.word[None])[0]
        assert solution.cost**2 == pytest.approx(brute_costs(THREE, target)[clear].min(), abs=1e-12)


def test_none_is_returned_where_everything_is_occupied():
    check = LinkCheck(THREE.geometry, lambda points: np.ones(len(points)))
    for method in CLEAR_METHODS:
        assert solve(THREE, targets(3, 1)[0], method, np.random.default_rng(0), check) is None


def test_swapped_straight_stages_count_as_two_bodies():
    """Both reach one pose, but a slab where a disc would be allows one of them only."""
    lift = np.array([[0, 7], [7, 0]])
    poses = forward(THREE.stages, lift)
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-15)

    def slab(points):
        return (np.abs(points[:, 2] - 1.0) < 0.01).astype(float)

    check = LinkCheck(THREE.geometry, slab)
    np.testing.assert_array_equal(check.free(lift), [False, True])
    two = BinaryArm(2)
    found = solve(two, poses[0], "kd-tree", np.random.default_rng(0), check)
    np.testing.assert_array_equal(found.word, [7, 0])


def test_what_cannot_be_solved_is_named():
    rng, target = np.random.default_rng(0), targets(3, 1)[0]
    with pytest.raises(ValueError, match="method guess: expected one of exhaustive"):
        solve(THREE, target, "guess", rng)
    with pytest.raises(ValueError, match="exhaustive with 10 stages"):
        solve(BinaryArm(10), target, "exhaustive", rng)
    with pytest.raises(ValueError, match="genetic and obstacles"):
        solve(THREE, target, "genetic", rng, LinkCheck(THREE.geometry, wall))
    with pytest.raises(ValueError, match="12 finite"):
        solve(THREE, target[:6], "kd-tree", rng)
    with pytest.raises(ValueError, match="weight 0"):
        build_tree(THREE.part(2).poses, 0.0)
    assert set(CLEAR_METHODS) < set(METHODS)
