"""Rigid motions against SciPy's, against draws and against the definition of the cross product."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.se3 import (
    adjoint,
    composed_covariance,
    cross_matrix,
    exp_twist,
    inverse_covariance,
    log_twist,
    point_jacobian,
    transform_points_with_covariance,
    transport_covariance,
    write_near_log,
)
from tests.perception.registration.fiducial_views import random_motion


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
        if size <= 3.0:
            near = np.empty(6)
            write_near_log(np.concatenate([matrix[:3, 3], matrix[:3, :3].ravel()]), near)
            np.testing.assert_allclose(near, xi, atol=1e-6)


def test_logarithm_of_half_turns_gives_them_back():
    for axis in (*np.eye(3), np.array([0.6, 0.0, -0.8]), np.array([-0.48, 0.6, 0.64])):
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_rotvec(np.pi * axis).as_matrix()
        matrix[:3, 3] = [0.3, -0.2, 0.1]
        np.testing.assert_allclose(exp_twist(log_twist(matrix)), matrix, atol=1e-9)


def test_cross_matrix_multiplies_like_the_cross_product():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose((cross_matrix(a) @ b[..., None])[..., 0], np.cross(a, b))


def test_adjoint_brings_a_small_motion_behind_a_transform():
    rng = np.random.default_rng(2)
    pose, xi = random_motion(rng, 80.0, 2.0), rng.normal(size=6)
    before = pose * RigidTransform.from_exp_coords(xi)
    after = RigidTransform.from_exp_coords(adjoint(pose) @ xi) * pose
    np.testing.assert_allclose(after.as_matrix(), before.as_matrix(), atol=1e-12)


def test_point_jacobian_is_the_finite_difference():
    points, step = np.random.default_rng(3).normal(size=(4, 3)), 1e-6
    for axis in range(6):
        xi = np.zeros(6)
        xi[axis] = step
        ahead, back = (RigidTransform.from_exp_coords(s * xi).apply(points) for s in (1, -1))
        slope = (ahead - back) / (2 * step)
        np.testing.assert_allclose(point_jacobian(points)[..., axis], slope, atol=1e-9)


def random_covariance(generator, size, scale):
    root = scale * generator.standard_normal((size, size))
    return root @ root.T


def test_points_placed_by_an_uncertain_pose_have_the_covariance_of_draws():
    generator = np.random.default_rng(10)
    pose, point = random_motion(generator, 40.0, 1.0), np.array([[0.1, -0.2, 1.0]])
    covariance = random_covariance(generator, 6, 0.004)
    own = random_covariance(generator, 3, 0.002)
    xi = generator.multivariate_normal(np.zeros(6), covariance, 40_000)
    local = generator.multivariate_normal(point[0], own, 40_000)
    drawn = RigidTransform.from_exp_coords(xi).apply(pose.apply(local))
    moved, propagated = transform_points_with_covariance(pose, covariance, point, own[None])
    np.testing.assert_allclose(moved[0], pose.apply(point[0]))
    np.testing.assert_allclose(propagated[0], np.cov(drawn.T), atol=0.03 * np.trace(propagated[0]))


def test_covariances_of_products_and_inverses_are_those_of_draws():
    generator = np.random.default_rng(11)
    first, second = random_motion(generator, 40.0, 1.0), random_motion(generator, 40.0, 1.0)
    covariances = [random_covariance(generator, 6, 0.003) for _ in range(2)]
    turns = [
        RigidTransform.from_exp_coords(generator.multivariate_normal(np.zeros(6), c, 20_000))
        for c in covariances
    ]
    product = (turns[0] * first * turns[1] * second) * (first * second).inv()
    expected = composed_covariance(first, *covariances)
    drawn = np.cov(product.as_exp_coords().T)
    np.testing.assert_allclose(drawn, expected, atol=0.04 * np.trace(expected))
    inverse = (turns[0] * first).inv() * first
    expected = inverse_covariance(first, covariances[0])
    drawn = np.cov(inverse.as_exp_coords().T)
    np.testing.assert_allclose(drawn, expected, atol=0.04 * np.trace(expected))


def test_covariance_in_another_frame_is_that_of_draws():
    generator = np.random.default_rng(12)
    pose, covariance = random_motion(generator, 40.0, 1.0), random_covariance(generator, 6, 0.003)
    xi = generator.multivariate_normal(np.zeros(6), covariance, 20_000)
    drawn = (pose * RigidTransform.from_exp_coords(xi) * pose.inv()).as_exp_coords()
    expected = transport_covariance(pose, covariance)
    np.testing.assert_allclose(np.cov(drawn.T), expected, atol=0.04 * np.trace(expected))
