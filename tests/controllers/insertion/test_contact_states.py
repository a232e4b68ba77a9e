"""Constructed contacts are named from their wrench and a believed pose."""

import numpy as np
import pytest

from controllers.insertion.contact import STATES, contacts_of, pose_in_state, wrench_cone
from controllers.insertion.contact_states import WrenchNoise, classify
from tests.controllers.insertion.test_contact import SHAPE, pose_of

SIGMAS = np.array([5e-4, 5e-4, np.radians(0.5)])
COVARIANCE = np.diag(SIGMAS**2)
NOISE = WrenchNoise()


def wrench_of(state: int, side: int, shares: np.ndarray) -> np.ndarray:
    contacts = contacts_of(SHAPE, pose_of(state, side), state, side)
    return wrench_cone(contacts, SHAPE.friction) @ shares[: 2 * len(contacts)]


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("state", STATES)
def test_noisy_wrench_and_pose_name_the_state_and_its_side(state, side):
    rng = np.random.default_rng([state, side + 1])
    right = 0
    for _ in range(10):
        wrench = wrench_of(state, side, rng.uniform(0.3, 1.5, 4))
        felt = wrench + rng.normal(size=3) * NOISE.sigma(wrench)
        believed = pose_of(state, side) + rng.normal(size=3) * SIGMAS
        found = classify(SHAPE, felt, NOISE, believed, COVARIANCE)
        right += (found.state, found.side) == (state, side)
    assert right >= 9


def test_wrench_distinguishes_states_that_the_pose_leaves_ambiguous():
    """One believed pose between two states: the force's direction decides."""
    pose = pose_of(5, 1)
    shares = np.array([1.0, 1.0, 0.0, 0.0])
    cone = wrench_cone(contacts_of(SHAPE, pose, 5, 1), SHAPE.friction)
    wall, mouth = cone @ shares, cone @ shares[::-1]
    assert classify(SHAPE, wall, NOISE, pose, COVARIANCE).state == 6
    assert classify(SHAPE, mouth, NOISE, pose, COVARIANCE).state == 2
    assert classify(SHAPE, wall + mouth, NOISE, pose, COVARIANCE).state == 5


def test_a_point_beyond_the_end_of_its_feature_speaks_against_a_state():
    """Beyond the face's outer end no corner touches it, however well wrench and gap agree."""
    costs = []
    for place in (0.5 * SHAPE.wall, SHAPE.wall + 2e-3):
        pose = pose_in_state(SHAPE, 3, 1, 0.08, 0.5 * SHAPE.wall)
        pose[0] += place - 0.5 * SHAPE.wall
        contacts = contacts_of(SHAPE, pose, 3, 1)
        wrench = wrench_cone(contacts, SHAPE.friction) @ np.ones(2)
        costs.append(classify(SHAPE, wrench, NOISE, pose, COVARIANCE).cost)
    # 2 mm beyond, with variances of two directions of which the gap takes one.
    assert costs[1] - costs[0] == pytest.approx((2e-3 / SIGMAS[0]) ** 2, rel=0.35)


def test_estimated_pose_brings_the_features_together():
    wrench = wrench_of(5, 1, np.ones(4))
    found = classify(SHAPE, wrench, NOISE, pose_of(5, 1) + 0.7 * SIGMAS, COVARIANCE)
    assert found.state == 5
    for contact in contacts_of(SHAPE, found.pose, 5, found.side):
        assert abs(contact.gap) < 1e-6
    assert found.margin > 0.0


@pytest.mark.parametrize(
    "wrench, pose, message",
    [
        (np.array([np.nan, 0, 0]), np.zeros(3), "wrench"),
        (np.ones(2), np.zeros(3), "wrench"),
        (np.ones(3), np.array([0, np.inf, 0]), "pose"),
        (np.zeros(3), np.zeros(3), "without force"),
    ],
)
def test_what_cannot_be_classified_is_refused(wrench, pose, message):
    with pytest.raises(ValueError, match=message):
        classify(SHAPE, wrench, NOISE, pose, COVARIANCE)
