"""Two robots triangulate together, against a general solver, random draws and closed form."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from perception.registration.cooperative import (
    RelativePose,
    fuse_views,
    relative_pose_by_target,
    triangulate_together,
)
from perception.registration.likelihood import solve
from perception.registration.motion import RegistrationError
from perception.registration.reprojection import Pose, Sighting
from perception.stereo.geometry import StereoGeometry

HEAD = StereoGeometry(510, 492, 677.34, 871.25, 254.5, 245.5, 0.038)
OTHER = StereoGeometry(640, 480, 500.0, 500.0, 319.5, 239.5, 0.06)
TARGET = np.array([0.0, 0.0, 1.1])
TURN = np.array([0.1, -1.0, 0.05])
EXACT = np.zeros((6, 6))


def across() -> RigidTransform:
    """A second camera about a metre aside, that looks at the same place."""
    turn = RigidTransform.from_rotation(RigidTransform.from_exp_coords([*TURN, 0, 0, 0]).rotation)
    return RigidTransform.from_translation(TARGET) * turn * RigidTransform.from_translation(-TARGET)


def drawn(rng, count, sigma, geometry=HEAD, truth=None):
    """Points (N, 3) and how both robots see them."""
    points = TARGET + rng.uniform(-0.2, 0.2, (count, 3))
    there = (truth or across()).apply(points, inverse=True)
    views = [HEAD.project(points), geometry.project(there)]
    sigmas = np.broadcast_to(sigma, (count, 3))
    views = [view + sigmas * rng.standard_normal(view.shape) for view in views]
    one, two = (Sighting(v, sigmas, g) for v, g in zip(views, (HEAD, geometry)))
    return points, one, two


def random_prior(rng, degrees=0.2, metres=0.003) -> RelativePose:
    """What odometry might say of the second camera's pose."""
    scale = np.repeat([np.radians(degrees), metres], 3)
    slip = RigidTransform.from_exp_coords(scale * rng.standard_normal(6))
    return RelativePose(slip.inv() * across(), np.diag(scale**2))


def general_solution(one, two, start, points, prior=None):
    """Points and their covariance by a solver that knows nothing of the structure."""

    def residuals(x):
        pose = RigidTransform.from_exp_coords(x[:6]) * start
        places = x[6:].reshape(-1, 3)
        parts = [
            ((s.geometry.project(p) - s.image_points) / s.sigma).ravel()
            for s, p in ((one, places), (two, pose.apply(places, inverse=True)))
        ]
        if prior is not None:
            xi = (prior.transform_second_to_first * pose.inv()).as_exp_coords()
            parts.append(np.linalg.solve(np.linalg.cholesky(prior.covariance), xi))
        return np.concatenate(parts)

    fit = None
    for _ in range(2):  # Again from where it ended, so that xi is 0 and the derivatives are by it.
        begin = np.concatenate([np.zeros(6), points.ravel()])
        fit = least_squares(residuals, begin, xtol=1e-13, ftol=1e-13, gtol=1e-13, x_scale="jac")
        start, points = RigidTransform.from_exp_coords(fit.x[:6]) * start, fit.x[6:].reshape(-1, 3)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    return points, covariance, 2.0 * fit.cost


@pytest.mark.parametrize("known", [False, True])
def test_bundle_is_that_of_a_general_solver(known):
    rng = np.random.default_rng(1)
    points, one, two = drawn(rng, 7, [0.2, 0.2, 0.3], OTHER)
    prior = random_prior(rng) if known else None
    estimate = triangulate_together(one, two, prior)
    places, covariance, cost = general_solution(one, two, across(), points, prior)
    assert estimate.inliers.all()
    np.testing.assert_allclose(estimate.points, places, atol=1e-5)
    sigma = np.sqrt(np.diag(covariance))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(
        estimate.covariance / scale[6:, 6:], (covariance / scale)[6:, 6:], atol=0.01
    )
    mine = estimate.relative.covariance / scale[:6, :6]
    np.testing.assert_allclose(mine, (covariance / scale)[:6, :6], atol=0.01)
    assert estimate.chi_square == pytest.approx(cost / (21 if known else 15), rel=1e-3)


def test_without_noise_points_and_pose_are_exact():
    points, one, two = drawn(np.random.default_rng(2), 6, 1e-9, OTHER)
    estimate = triangulate_together(one, two)
    np.testing.assert_allclose(estimate.points, points, atol=1e-7)
    error = (across() * estimate.relative.transform_second_to_first.inv()).as_exp_coords()
    np.testing.assert_allclose(error, 0.0, atol=1e-7)


def test_covariance_of_all_points_together_is_that_of_the_errors():
    rng = np.random.default_rng(3)
    sigma, runs = np.array([0.1, 0.1, 0.1]), 120
    points, one, two = drawn(rng, 6, 1e-9)
    errors, squares = [], []
    for _ in range(runs):
        noisy = [
            Sighting(
                s.image_points + sigma * rng.standard_normal((6, 3)), np.tile(sigma, (6, 1)), HEAD
            )
            for s in (one, two)
        ]
        estimate = triangulate_together(*noisy)
        if not estimate.inliers.all():
            continue
        error = (estimate.points - points).ravel()
        errors.append(error)
        squares.append(error @ np.linalg.solve(estimate.covariance, error))
    assert len(squares) > 0.97 * runs
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 18 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high
    drawn_variance = np.mean(np.square(errors), axis=0)
    expected = np.diag(triangulate_together(one_with(one, sigma), one_with(two, sigma)).covariance)
    np.testing.assert_allclose(drawn_variance, expected, rtol=0.6)
    assert np.mean(drawn_variance / expected) == pytest.approx(1.0, abs=0.2)


def one_with(sight: Sighting, sigma) -> Sighting:
    return Sighting(sight.image_points, np.broadcast_to(sigma, sight.sigma.shape), sight.geometry)


def test_a_known_pose_makes_the_points_independent_and_much_more_certain():
    rng = np.random.default_rng(4)
    points, one, two = drawn(rng, 6, 0.1)
    unknown = triangulate_together(one, two)
    exact = triangulate_together(one, two, RelativePose(across(), EXACT))
    blocks = exact.covariance.reshape(6, 3, 6, 3)
    assert all(np.abs(blocks[i, :, j]).max() == 0.0 for i in range(6) for j in range(6) if i != j)
    assert np.trace(exact.covariance) < 0.1 * np.trace(unknown.covariance)
    assert np.linalg.norm(exact.points - points, axis=1).max() < 0.001
    np.testing.assert_array_equal(exact.relative.covariance, EXACT)


def test_one_point_with_a_prior_is_the_last_of_a_joint_bundle():
    points, one, two = drawn(np.random.default_rng(5), 9, 0.02)
    index = np.arange(9)
    together = triangulate_together(one, two)
    some = triangulate_together(one.chosen(index < 8), two.chosen(index < 8))
    last = triangulate_together(one.chosen(index == 8), two.chosen(index == 8), some.relative)
    np.testing.assert_allclose(last.points[0], together.points[8], atol=2e-5)
    scale = np.trace(together.covariances[8])
    np.testing.assert_allclose(
        last.covariances[0] / scale, together.covariances[8] / scale, atol=0.01
    )


@pytest.mark.parametrize("known", [False, True])
def test_wrong_matches_are_left_out(known):
    rng = np.random.default_rng(6)
    points, one, two = drawn(rng, 12, 0.1)
    two.image_points[[2, 7]] += [[15.0, 4.0, 0.0], [0.0, 0.0, 4.0]]
    estimate = triangulate_together(one, two, random_prior(rng) if known else None)
    assert np.flatnonzero(~estimate.inliers).tolist() == [2, 7]
    assert estimate.points.shape == (10, 3) and estimate.covariances.shape == (10, 3, 3)
    assert np.linalg.norm(estimate.points - points[estimate.inliers], axis=1).max() < 0.02


def test_fused_points_are_the_product_of_two_gaussians():
    rng = np.random.default_rng(7)
    _, one, two = drawn(rng, 5, 0.2)
    prior = random_prior(rng)
    local = [HEAD.points(s.image_points) for s in (one, two)]
    covariances = [HEAD.covariance(p, 0.2 * np.ones(3)) for p in local]
    estimate = fuse_views(local[0], covariances[0], local[1], covariances[1], prior)
    rotation = prior.transform_second_to_first.rotation.as_matrix()
    for n in range(5):
        place = prior.transform_second_to_first.apply(local[1][n])
        step = 1e-6 * np.eye(6)
        by_pose = (
            np.array([RigidTransform.from_exp_coords(s).apply(place) - place for s in step]).T
            / 1e-6
        )
        other = rotation @ covariances[1][n] @ rotation.T + by_pose @ prior.covariance @ by_pose.T
        weights = [np.linalg.inv(covariances[0][n]), np.linalg.inv(other)]
        covariance = np.linalg.inv(sum(weights))
        np.testing.assert_allclose(estimate.covariances[n], covariance, rtol=1e-4, atol=1e-12)
        mean = covariance @ (weights[0] @ local[0][n] + weights[1] @ place)
        np.testing.assert_allclose(estimate.points[n], mean, atol=1e-7)


def test_fusing_equals_the_bundle_for_small_noise_and_a_known_pose():
    _, one, two = drawn(np.random.default_rng(8), 5, 0.003)
    local = [HEAD.points(s.image_points) for s in (one, two)]
    covariances = [HEAD.covariance(p, np.full(3, 0.003)) for p in local]
    exact = RelativePose(across(), EXACT)
    fused = fuse_views(local[0], covariances[0], local[1], covariances[1], exact)
    estimate = triangulate_together(one, two, exact)
    np.testing.assert_allclose(fused.points, estimate.points, atol=1e-6)
    np.testing.assert_allclose(fused.covariances, estimate.covariances, rtol=0.02, atol=1e-13)


def test_relative_pose_by_a_target_is_consistent_with_its_covariance():
    rng = np.random.default_rng(9)
    markers = np.array([[-0.13, -0.1, 0], [0.08, -0.07, 0], [-0.15, 0.03, 0], [0.16, 0.09, 0]])
    target = RigidTransform.from_translation(TARGET) * RigidTransform.from_exp_coords(
        [0.2, 2.7, 0, 0, 0, 0]
    )
    squares = []
    for _ in range(50):
        seen = []
        for camera in (RigidTransform.identity(), across()):
            exact = HEAD.project(camera.apply(target.apply(markers), inverse=True))
            noisy = exact + 0.05 * rng.standard_normal((4, 3))
            seen.append(Sighting(noisy, np.full((4, 3), 0.05), HEAD))
        estimate = relative_pose_by_target(seen[0], markers, seen[1], markers)
        xi = (across() * estimate.transform_second_to_first.inv()).as_exp_coords()
        squares.append(xi @ np.linalg.solve(estimate.covariance, xi))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * len(squares)) / len(squares)
    assert low < np.mean(squares) < high


def test_points_that_cannot_fix_the_pose_are_refused():
    points, one, two = drawn(np.random.default_rng(10), 8, 0.1)
    index = np.arange(8)
    with pytest.raises(RegistrationError, match="3 fiducials: at least 4"):
        triangulate_together(one.chosen(index < 3), two.chosen(index < 3))
    line = TARGET + np.linspace(-0.2, 0.2, 8)[:, None] * [1.0, 0.3, 0.2]
    straight = [
        Sighting(HEAD.project(p), one.sigma, HEAD)
        for p in (line, across().apply(line, inverse=True))
    ]
    with pytest.raises(RegistrationError, match="in line"):
        triangulate_together(*straight)
    with pytest.raises(RegistrationError, match="8 points seen by the first robot, 7 by"):
        triangulate_together(one, two.chosen(index < 7))
    with pytest.raises(RegistrationError, match="none; at least 1"):
        triangulate_together(one.chosen(index < 0), two.chosen(index < 0))
    broken = one.image_points.copy()
    broken[3, 1] = np.nan
    with pytest.raises(RegistrationError, match=r"first robot: the value at \[3, 1\]"):
        triangulate_together(dataclasses.replace(one, image_points=broken), two)


def test_what_a_known_pose_cannot_explain_is_refused():
    _, one, two = drawn(np.random.default_rng(11), 5, 0.1)
    astray = RelativePose(RigidTransform.from_translation([0.0, 0.5, 0.0]) * across(), EXACT)
    with pytest.raises(RegistrationError, match="none of 5 points fits the relative pose"):
        triangulate_together(one, two, astray)
    with pytest.raises(RegistrationError, match="pose covariance: it is negative"):
        triangulate_together(one, two, RelativePose(across(), -np.eye(6)))


def test_measurements_that_are_none_are_refused():
    points = np.tile(TARGET, (2, 1))
    covariances = np.tile(np.eye(3), (2, 1, 1))
    pose = RelativePose(across(), EXACT)
    with pytest.raises(RegistrationError, match="2 points of the first robot, 1 of the second"):
        fuse_views(points, covariances, points[:1], covariances[:1], pose)
    with pytest.raises(RegistrationError, match="expected \\(N, 3\\) and \\(N, 3, 3\\)"):
        fuse_views(points, covariances[0], points, covariances, pose)
    with pytest.raises(RegistrationError, match="second robot: point 1 is not finite"):
        fuse_views(points, covariances, [TARGET, [0, np.inf, 1]], covariances, pose)
    with pytest.raises(RegistrationError, match="first robot: the covariance of point 0 is neg"):
        fuse_views(points, -covariances, points, covariances, pose)
    with pytest.raises(RegistrationError, match="point 0: both robots say"):
        fuse_views(points, 0.0 * covariances, points, 0.0 * covariances, pose)
    with pytest.raises(RegistrationError, match="pose covariance of shape"):
        fuse_views(points, covariances, points, covariances, RelativePose(across(), np.eye(3)))


def test_fit_from_half_a_radian_off_ends_where_that_from_the_truth_does():
    """Far from the optimum a full Gauss-Newton step overshoots in one of four fits."""
    rng = np.random.default_rng(3)
    _, one, two = drawn(rng, 12, [0.2, 0.2, 0.3])
    best, known, ended = solve(Pose.of(across()), one.known(), two), one.known(), 0
    for _ in range(40):
        off = RigidTransform.from_exp_coords(rng.normal(size=6) * np.repeat([0.5, 0.15], 3))
        try:
            found = solve(Pose.of(off * across()), known, two)
        except RegistrationError:
            continue  # A point lies behind the camera.
        ended += 1
        assert found.cost == pytest.approx(best.cost, rel=1e-6)
        np.testing.assert_allclose(found.pose.rotation, best.pose.rotation, atol=1e-6)
    assert ended > 30
