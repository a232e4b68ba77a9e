"""Exponential coordinates against SciPy's."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.twists import exp_twist, log_twist


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 9e-5, 1.1e-4, 0.01, 1.0, 3.0, np.pi - 1e-6])
def test_exponential_coordinates_are_scipys(size):
    rng = np.random.default_rng(5)
    for _ in range(20):
        axis = rng.normal(size=3)
        xi = np.concatenate([size * axis / np.linalg.norm(axis), rng.normal(size=3)])
        matrix = exp_twist(xi)
        np.testing.assert_allclose(
            matrix, RigidTransform.from_exp_coords(xi).as_matrix(), atol=1e-9
        )
        np.testing.assert_allclose(log_twist(matrix), xi, atol=1e-7)


def test_logarithm_of_half_turns_gives_them_back():
    for axis in (*np.eye(3), np.array([0.6, 0.0, -0.8]), np.array([-0.48, 0.6, 0.64])):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_rotvec(np.pi * axis).as_matrix()
        matrix[:3, 3] = [0.3, -0.2, 0.1]
        np.testing.assert_allclose(exp_twist(log_twist(matrix)), matrix, atol=1e-9)
