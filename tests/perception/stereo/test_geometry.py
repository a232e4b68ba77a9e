"""Triangulation and its uncertainty, against finite differences and random draws."""

import numpy as np
import pytest

from perception.stereo.geometry import StereoGeometry

HEAD = StereoGeometry(510, 492, 677.34, 871.25, 254.5, 245.5, 0.038)
POINTS = np.array([[0.02, -0.1, 0.35], [-0.2, 0.15, 1.1], [0.0, 0.0, 2.0]])


def test_projection_and_triangulation_are_inverse():
    np.testing.assert_allclose(HEAD.points(HEAD.project(POINTS)), POINTS, rtol=1e-12)


def test_disparity_is_the_difference_of_two_pinhole_columns():
    right = POINTS - [HEAD.baseline, 0.0, 0.0]
    columns = [HEAD.fx * p[:, 0] / p[:, 2] + HEAD.cx for p in (POINTS, right)]
    np.testing.assert_allclose(HEAD.project(POINTS)[:, 2], columns[0] - columns[1], rtol=1e-12)


def test_jacobian_agrees_with_a_finite_difference():
    step = 1e-6
    for axis in range(3):
        shift = np.eye(3)[axis] * step
        numeric = (HEAD.project(POINTS + shift) - HEAD.project(POINTS - shift)) / (2 * step)
        found = HEAD.projection_jacobian(POINTS)[:, :, axis]
        np.testing.assert_allclose(found, numeric, rtol=1e-6, atol=1e-6)


def test_covariance_is_that_of_triangulated_noise():
    generator = np.random.default_rng(1)
    sigma = np.array([0.05, 0.04, 0.06])
    for point in POINTS:
        seen = HEAD.project(point) + sigma * generator.standard_normal((200_000, 3))
        drawn = np.cov(HEAD.points(seen).T)
        found = HEAD.covariance(point, sigma)
        np.testing.assert_allclose(found, drawn, rtol=0.03, atol=0.02 * np.trace(drawn))


def test_depth_deviation_grows_with_the_square_of_the_range():
    ahead = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    depth = np.sqrt(HEAD.covariance(ahead, np.full(3, 0.05))[:, 2, 2])
    np.testing.assert_allclose(depth[1:] / depth[:-1], 4.0, rtol=1e-12)
    assert depth[1] == pytest.approx(0.05 / (HEAD.fx * HEAD.baseline), rel=1e-12)


def test_what_is_behind_or_infinitely_far_is_nan():
    assert np.isnan(HEAD.project([0.0, 0.0, -1.0])).all()
    assert np.isnan(HEAD.points([254.5, 245.5, 0.0])).all()


def test_no_pair_without_a_baseline():
    with pytest.raises(ValueError, match="baseline"):
        StereoGeometry(510, 492, 677.0, 871.0, 254.5, 245.5, 0.0)
