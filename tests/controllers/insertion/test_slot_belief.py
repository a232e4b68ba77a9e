"""The slave's belief is the least-squares one, however late the looks come."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.guidance import Guidance
from controllers.insertion.slot_belief import BeliefConfig, SlotBelief
from perception.geometry.se3 import adjoint

SLOT = RigidTransform.from_components([0.02, 0.8, 0.3], Rotation.from_euler("zx", [0.1, -0.05]))
PRIOR = np.diag([4e-3**2] * 3 + [2e-3**2] * 3)
STILL = BeliefConfig(rest_drift=(0.0, 0.0))
"""Without drift, for comparison with a belief about a slot at rest."""


def look(time: float, card: RigidTransform, slot: RigidTransform, noise_covariance) -> Guidance:
    return Guidance(time, True, True, card.inv() * slot, np.asarray(noise_covariance, dtype=float))


def small(rng: np.random.Generator, turn=1e-3, place=5e-4) -> RigidTransform:
    xi = rng.normal(size=6) * ([turn] * 3 + [place] * 3)
    return RigidTransform.from_exp_coords(xi)


def cards(rng: np.random.Generator, count: int) -> list[RigidTransform]:
    """Places of the card as it comes nearer."""
    return [
        RigidTransform.from_components(
            [0.01, 0.4 + 0.02 * n, 0.3], Rotation.from_rotvec(0.1 * rng.normal(size=3))
        )
        for n in range(count)
    ]


def batch(believed: RigidTransform, seen, covariances) -> tuple[RigidTransform, np.ndarray]:
    """The weighted least-squares pose of prior and looks at once, with its covariance."""

    def whitened(xi):
        pose = RigidTransform.from_exp_coords(xi) * SLOT
        rows = [np.linalg.solve(np.linalg.cholesky(PRIOR), (pose * believed.inv()).as_exp_coords())]
        for one, noise_covariance in zip(seen, covariances, strict=True):
            error = (pose * one.inv()).as_exp_coords()
            rows.append(np.linalg.solve(np.linalg.cholesky(noise_covariance), error))
        return np.concatenate(rows)

    found = least_squares(whitened, np.zeros(6), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return RigidTransform.from_exp_coords(found.x) * SLOT, covariance


def test_posterior_is_that_of_a_batch_least_squares_fit():
    rng = np.random.default_rng(0)
    believed = small(rng, 4e-3, 2e-3) * SLOT
    belief = SlotBelief(believed, PRIOR, STILL)
    noise = np.diag([1e-3**2] * 3 + [3e-4**2] * 3)
    own = np.diag([STILL.card[0] ** 2] * 3 + [STILL.card[1] ** 2] * 3)
    seen, covariances = [], []
    for number, card in enumerate(cards(rng, 8)):
        guidance = look(float(number), card, small(rng) * SLOT, noise)
        belief.note(float(number), card.as_matrix(), 0.0, 0.0, 0.25)
        assert belief.take(guidance)
        seen.append(card * guidance.transform_slot_to_card)
        covariances.append(adjoint(card) @ (noise + own) @ adjoint(card).T)
    pose, covariance = batch(believed, seen, covariances)
    mean = RigidTransform.from_matrix(belief.slot_in_start)
    error = (mean * pose.inv()).as_exp_coords()
    # Poses do not form a vector space: a hundredth of a deviation is left.
    assert np.all(np.abs(error) < 0.02 * np.sqrt(np.diag(covariance)))
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    np.testing.assert_allclose(belief.covariance / scale, covariance / scale, atol=0.02)


def test_errors_are_consistent_with_the_covariance():
    rng, squares = np.random.default_rng(1), []
    noise = np.diag([2e-3**2] * 3 + [4e-4**2] * 3)
    for _ in range(50):
        believed = RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), PRIOR)).inv()
        belief = SlotBelief(believed * SLOT, PRIOR, STILL)
        for number, card in enumerate(cards(rng, 3)):
            belief.note(float(number), card.as_matrix(), 0.0, 0.0, 0.25)
            joints = small(rng, *STILL.card)
            guidance = look(number, card, SLOT, noise)
            true = guidance.transform_slot_to_card
            wrong = RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), noise))
            heard = dataclasses.replace(guidance, transform_slot_to_card=joints * wrong * true)
            belief.take(heard)
        error = (SLOT * RigidTransform.from_matrix(belief.slot_in_start).inv()).as_exp_coords()
        squares.append(error @ np.linalg.solve(belief.covariance, error))
    # The mean of 50 squares of six degrees of freedom has a deviation of 0.5.
    assert np.mean(squares) == pytest.approx(6.0, abs=1.5)


def test_late_message_is_applied_at_the_card_pose_of_its_time_stamp():
    rng = np.random.default_rng(2)
    start = small(rng, 4e-3, 2e-3) * SLOT
    prompt, late = SlotBelief(start, PRIOR, STILL), SlotBelief(start, PRIOR, STILL)
    noise = 1e-7 * np.eye(6)
    ways = cards(rng, 40)
    guidance = look(0.10, ways[10], SLOT, noise)
    for tick, card in enumerate(ways):
        for belief in (prompt, late):
            belief.note(0.01 * tick, card.as_matrix(), 0.0, 0.0, 0.01)
        if tick == 10:
            assert prompt.take(guidance)
    assert late.take(guidance)
    np.testing.assert_allclose(late.slot_in_start, prompt.slot_in_start, atol=1e-12)
    np.testing.assert_allclose(late.covariance, prompt.covariance, atol=1e-16)


def test_belief_that_refused_too_often_takes_the_error_into_its_covariance():
    config = dataclasses.replace(STILL, refusals=2)
    belief, card = SlotBelief(SLOT, PRIOR, config), cards(np.random.default_rng(0), 1)[0]
    noise, error = 1e-6 * np.eye(6), np.array([0.02, -0.03, 0.02, 0.03, 0.05, -0.04])
    guidance = look(0.0, card, RigidTransform.from_exp_coords(error) * SLOT, noise)
    belief.note(0.0, card.as_matrix(), 0.0, 0.0, 0.01)
    assert [belief.take(guidance) for _ in range(3)] == [False, False, True]
    own = np.diag(np.repeat(np.square(config.card), 3))
    measured = adjoint(card) @ (noise + own) @ adjoint(card).T
    prior = PRIOR + np.outer(error, error)
    posterior = np.linalg.inv(np.linalg.inv(prior) + np.linalg.inv(measured))
    np.testing.assert_allclose(belief.covariance, posterior, rtol=1e-5, atol=1e-12)
    assert belief.refused == 0


def test_look_older_than_memory_is_not_used():
    belief = SlotBelief(SLOT, PRIOR, STILL)
    card = cards(np.random.default_rng(0), 1)[0]
    guidance = look(0.0, card, SLOT, 1e-7 * np.eye(6))
    assert not belief.take(guidance)  # nothing is remembered yet
    for tick in range(400):
        belief.note(0.01 * tick, card.as_matrix(), 0.0, 0.0, 0.01)
    assert not belief.take(guidance)
    assert not belief.take(dataclasses.replace(guidance, time=3.0, transform_slot_to_card=None))
    np.testing.assert_array_equal(belief.slot_in_start, SLOT.as_matrix())
    assert belief.take(dataclasses.replace(guidance, time=3.0))


def after(way: float, turned: float, period: float = 0.0) -> SlotBelief:
    belief = SlotBelief(SLOT, PRIOR, STILL)
    card = RigidTransform.from_translation([0.0, 0.5, 0.3])
    belief.note(0.0, card.as_matrix(), way, turned, period)
    return belief


def test_pose_covariance_grows_by_driving_and_turning_and_not_at_rest():
    beliefs = [after(way, 0.0) for way in (0.0, 0.2, 0.4)]
    still, driven, farther = (belief.deviation() for belief in beliefs)
    assert still < driven < farther
    assert still < after(0.0, 0.3).deviation()
    # Variances add up along the way: twice the way, twice what it adds.
    once, twice = (belief.covariance - PRIOR for belief in beliefs[1:])
    np.testing.assert_allclose(twice, 2.0 * once, atol=1e-15)
    assert after(0.0, 0.0, 100.0).deviation() == pytest.approx(still)


def test_drift_is_that_of_drawn_errors_of_dead_reckoning():
    """The way's error lies along it, and a turn's grows with the lever to the slot."""
    config = dataclasses.replace(STILL, veer=0.0, bump=0.0)
    way, turned = 0.2, 0.3
    belief = SlotBelief(SLOT, np.zeros((6, 6)), config)
    card = RigidTransform.from_translation([0.0, 0.5, 0.3])
    belief.note(0.0, card.as_matrix(), way, turned, 0.0)
    along = config.drift**2 * way * config.stretch[0]
    yaw = config.turn_drift**2 * turned * config.stretch[1]
    lever = SLOT.translation - card.translation
    # In the slot's plane, whose axes are nearly those of the world.
    place = np.diag([0.1 * along, along]) + yaw * np.outer(
        [-lever[1], lever[0]], [-lever[1], lever[0]]
    )
    axes = SLOT.as_matrix()[:2, :2].T
    largest = np.sqrt(np.linalg.eigvalsh(axes @ place @ axes.T)[-1])
    assert belief.deviation() == pytest.approx(largest, rel=1e-6)


def test_veer_and_bumps_of_the_path_add_to_the_variances_of_turn_tilt_and_height():
    """About the robot itself, where no lever mixes them: rate^2 x way x stretch."""
    config = dataclasses.replace(STILL, drift=0.3, turn_drift=0.4, veer=0.5, bump=0.6)
    belief = SlotBelief(SLOT, np.zeros((6, 6)), config)
    belief.note(0.0, np.eye(4), 0.2, 0.7, 0.0)
    belief.deviation()
    (stretch, bend), way, turned = config.stretch, 0.2, 0.7
    tilt = 0.6**2 * way * stretch
    yaw = 0.4**2 * turned * bend + 0.5**2 * way * stretch
    along = 0.3**2 * way * stretch
    expected = np.diag([tilt, tilt, yaw, 0.1 * along, along, tilt])
    np.testing.assert_allclose(belief.covariance, expected, atol=1e-15)


def test_one_outlier_is_rejected_and_a_persistent_one_accepted():
    belief = after(0.0, 0.0)
    card = RigidTransform.from_translation([0.0, 0.5, 0.3])
    noise = 1e-7 * np.eye(6)
    far = RigidTransform.from_translation([0.05, 0.0, 0.0]) * SLOT
    assert not belief.take(look(0.0, card, far, noise))
    assert belief.innovation > STILL.gate and belief.refused == 1
    assert belief.take(look(0.0, card, SLOT, noise)) and belief.refused == 0
    np.testing.assert_allclose(belief.slot_in_start, SLOT.as_matrix(), atol=1e-9)
    taken = [belief.take(look(0.0, card, far, noise)) for _ in range(STILL.refusals + 1)]
    assert taken == [False] * STILL.refusals + [True]
    np.testing.assert_allclose(belief.slot_in_start[:3, 3], far.translation, atol=1e-3)


def test_deviation_before_the_robot_has_moved_is_the_maps() -> None:
    prior = np.diag([1e-12] * 3 + [9e-6, 4e-6, 1e-6])
    belief = SlotBelief(RigidTransform.identity(), prior, BeliefConfig())
    assert belief.deviation() == pytest.approx(3e-3)


def test_error_of_the_turn_share_moves_the_slot_with_the_turns_since_the_last_view():
    """To and fro it cancels; drawn again and again, the slot strays by its covariance."""
    twist = np.array([0.0, 0.0, 0.03, 0.02, -0.01, 0.0])
    belief = SlotBelief(SLOT, PRIOR, STILL)
    belief.note(0.0, np.eye(4), 0.0, 0.0, 0.0, twist)
    belief.deviation()
    moved = belief.covariance - PRIOR
    np.testing.assert_allclose(moved, np.outer(twist, twist), atol=1e-15)
    rng, strayed = np.random.default_rng(4), []
    for _ in range(2000):
        reckoned = RigidTransform.from_exp_coords(rng.normal() * twist)
        strayed.append((reckoned.inv() * SLOT * SLOT.inv()).as_exp_coords())
    np.testing.assert_allclose(np.cov(np.transpose(strayed)), moved, atol=0.1 * moved.max())
    belief.note(0.0, np.eye(4), 0.0, 0.0, 0.0, twist)
    belief.deviation()
    np.testing.assert_allclose(belief.covariance - PRIOR, moved, atol=1e-15)


def test_late_view_is_moved_on_by_what_the_card_has_moved_since_its_images() -> None:
    """Closed form: the slot is at rest, so where the card went is what the view lacks."""
    belief = SlotBelief(SLOT, PRIOR, STILL)
    path = cards(np.random.default_rng(4), 30)
    guidance = look(0.05, path[5], SLOT, 1e-8 * np.eye(6))
    for tick, card in enumerate(path):
        belief.note(0.01 * tick, card.as_matrix(), 0.0, 0.0, 0.01)
    assert belief.transform_slot_to_card is None
    assert belief.take(guidance)
    assert belief.transform_slot_to_card is not None
    now = (path[-1].inv() * SLOT).as_matrix()
    np.testing.assert_allclose(belief.transform_slot_to_card.as_matrix(), now, atol=1e-12)
    assert not np.allclose(guidance.transform_slot_to_card.as_matrix(), now, atol=0.1)
