"""Dynamics of the chain and of the nine coordinates against independent models."""

import numpy as np
import pytest

from controllers.motion.lagrange import controllability_rank, observability_rank
from experiments.appa.control.control import ranks
from experiments.appa.control.plant import model_errors, planar_plant


@pytest.fixture(scope="module")
def plant():
    return planar_plant()


def test_mass_matrix_bias_and_efforts_are_mujocos_at_random_states(plant):
    errors = model_errors(plant, 100, np.random.default_rng(1))
    assert errors.shape == (100, 3)
    assert errors.max() < 1e-12


def test_tip_wrench_enters_by_the_jacobian_transposed(plant):
    """A force along the base's slide is felt there in full, whatever the arm's pose."""
    q, still = np.zeros(9), np.zeros(9)
    push = np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0])
    felt = plant.coordinates.efforts(q, still, still, push) - plant.coordinates.bias(q, still)
    np.testing.assert_allclose(felt[[0, 1, 4]], [2.0, 0.0, 2.0], atol=1e-12)


def test_twelve_states_are_controllable_and_observable_with_springs_by_the_arm_alone(plant):
    found = ranks(plant)
    assert found["controllability/printed"] == found["observability/printed"] == 12
    assert found["controllability/arm_motors_only"] == 12
    assert found["observability/arm_angles_only"] == 12
    assert found["controllability/arm_motors_only_no_springs"] == 6


def test_ranks_are_those_of_a_known_system():
    a = np.array([[0.0, 1.0, 0.0], [-4.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert controllability_rank(a, np.array([[0.0], [1.0], [0.0]])) == 2
    assert observability_rank(a, np.array([[1.0, 0.0, 1.0]])) == 3
