"""Camera motion by every solver: exact cases, independent optima, and honest covariances."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

from perception.registration import likelihood
from perception.registration.closed_form import kabsch_pose, nearest_rotation
from perception.registration.motion import SOLVERS, RegistrationError, estimate_motion, register
from perception.registration.reprojection import KnownPoints, Pose, Sighting, linearise
from tests.perception.registration.fiducial_views import (
    HEAD,
    error_of,
    random_motion,
    random_points,
    sighting,
    two_views,
)

SIGMA = np.array([0.2, 0.25, 0.3])


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("distance", [0.35, 1.1])
@pytest.mark.parametrize("solver", SOLVERS)
def test_motion_is_exact_without_noise(solver, distance):
    motion, before, after = two_views(rng(1), 8, distance=distance)
    found = estimate_motion(solver, sighting(before, 0.1), sighting(after, 0.1))
    assert np.abs(error_of(found.transform_after_to_before, motion)).max() < 1e-6
    assert found.inliers.all()


def test_after_to_before_takes_points_to_the_frame_before():
    motion, before, after = two_views(rng(2), 6)
    found = estimate_motion(
        "ml", sighting(before, 0.1), sighting(after, 0.1)
    ).transform_after_to_before
    np.testing.assert_allclose(found.apply(HEAD.points(after)), HEAD.points(before), atol=1e-7)


def minimum_by_scipy(before, after, sigma, start):
    """Motion and covariance that an independent fit of motion and points gives."""
    fx, fy, cx, cy, b = HEAD.fx, HEAD.fy, HEAD.cx, HEAD.cy, HEAD.baseline

    def appear(p):
        return np.column_stack(
            [fx * p[:, 0] / p[:, 2] + cx, fy * p[:, 1] / p[:, 2] + cy, fx * b / p[:, 2]]
        )

    def residuals(x):
        points = x[6:].reshape(-1, 3)
        rotation = Rotation.from_rotvec(x[:3]).as_matrix()
        second = (points - x[3:6]) @ rotation
        errors = [(appear(points) - before) / sigma, (appear(second) - after) / sigma]
        return np.concatenate(errors).ravel()

    x0 = np.concatenate(
        [start.rotation.as_rotvec(), start.translation, HEAD.points(before).ravel()]
    )
    fit = least_squares(residuals, x0, xtol=1e-14, ftol=1e-14, gtol=1e-12, x_scale="jac")
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)[:6, :6]
    rotation = Rotation.from_rotvec(fit.x[:3])
    return RigidTransform.from_components(fit.x[3:6], rotation), covariance, 2 * fit.cost


def test_maximum_likelihood_is_the_optimum_that_an_independent_fit_finds():
    motion, before, after = two_views(rng(3), 7, 0.25)
    found = estimate_motion("ml", sighting(before, SIGMA), sighting(after, SIGMA))
    expected, _, cost = minimum_by_scipy(before, after, SIGMA, motion)
    assert np.abs(error_of(found.transform_after_to_before, expected)).max() < 2e-6
    assert found.chi_square == pytest.approx(cost / (3 * 7 - 6), rel=1e-6)


def test_covariance_is_that_of_the_independent_fit():
    motion, before, after = two_views(rng(4), 9, 0.05)
    found = estimate_motion("ml", sighting(before, 0.05), sighting(after, 0.05))
    _, covariance, _ = minimum_by_scipy(before, after, np.full(3, 0.05), motion)
    # That fit's parameters are (rotation vector, translation); ours turn about the origin.
    x = np.concatenate(
        [
            found.transform_after_to_before.rotation.as_rotvec(),
            found.transform_after_to_before.translation,
        ]
    )
    by_x = np.zeros((6, 6))
    for k in range(6):
        ends = []
        for sign in (1.0, -1.0):
            moved = x + sign * 1e-6 * np.eye(6)[k]
            ends.append(RigidTransform.from_components(moved[3:], Rotation.from_rotvec(moved[:3])))
        by_x[:, k] = (
            error_of(found.transform_after_to_before, ends[0])
            - error_of(found.transform_after_to_before, ends[1])
        ) / 2e-6
    expected = by_x @ covariance @ by_x.T
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found.covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.03
    )


@pytest.mark.parametrize("geometry", [HEAD, None])
def test_derivatives_agree_with_finite_differences(geometry):
    generator = rng(5)
    motion = random_motion(generator, 20.0, 0.2)
    points = random_points(generator, 4)
    coordinates = HEAD.project(points) if geometry is not None else points
    known = KnownPoints(coordinates, np.tile(np.eye(3), (4, 1, 1)), geometry)
    look = linearise(Pose.of(motion), coordinates, known, HEAD)

    def predicted(xi, shift):
        pose = Pose.of(RigidTransform.from_exp_coords(xi) * motion)
        return linearise(pose, coordinates + shift, known, HEAD).predicted

    step = 1e-6
    for k in range(6):
        xi = step * np.eye(6)[k]
        numeric = (predicted(xi, 0.0) - predicted(-xi, 0.0)) / (2 * step)
        np.testing.assert_allclose(look.by_pose[..., k], numeric, rtol=1e-5, atol=1e-3)
    for k in range(3):
        shift = step * np.eye(3)[k]
        numeric = (predicted(np.zeros(6), shift) - predicted(np.zeros(6), -shift)) / (2 * step)
        np.testing.assert_allclose(look.by_coordinates[..., k], numeric, rtol=1e-5, atol=1e-4)


def mean_nees(solver, draws, count, sigma=0.25, **options):
    generator, total = rng(6), 0.0
    for _ in range(draws):
        motion, before, after = two_views(generator, count, sigma)
        found = estimate_motion(solver, sighting(before, sigma), sighting(after, sigma), **options)
        xi = error_of(found.transform_after_to_before, motion)
        total += xi @ np.linalg.solve(found.covariance, xi)
    return total / draws / 6


def test_normalised_error_squared_is_one():
    # The mean of 50 draws with 6 degrees of freedom scatters by 0.08.
    assert 0.7 < mean_nees("ml", 50, 6) < 1.35


@pytest.mark.slow
@pytest.mark.parametrize(
    ("solver", "count"), [("ml", 6), ("ml", 30), ("kabsch", 12), ("pnp", 12), ("linear", 20)]
)
def test_normalised_error_squared_of_every_solver_is_one(solver, count):
    # The mean of 200 draws with 6 degrees of freedom scatters by 0.04.
    assert 0.85 < mean_nees(solver, 200, count, reject=solver == "ml") < 1.2


def test_kabsch_is_what_scipy_finds():
    generator = rng(7)
    motion = random_motion(generator, 30.0, 0.5)
    after = random_points(generator, 10)
    before = motion.apply(after) + 0.01 * generator.standard_normal((10, 3))
    weights = generator.uniform(0.5, 2.0, 10)
    pose = kabsch_pose(before, after, weights)
    middle = [np.average(p, axis=0, weights=weights) for p in (before, after)]
    expected, _ = Rotation.align_vectors(before - middle[0], after - middle[1], weights)
    np.testing.assert_allclose(pose.rotation, expected.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(pose.translation, middle[0] - pose.rotation @ middle[1], atol=1e-9)


def test_averaged_rotations_are_projected_on_a_rotation():
    generator = rng(8)
    turns = Rotation.from_rotvec(np.radians(20) * generator.standard_normal((50, 3))).as_matrix()
    mean = turns.mean(axis=0)
    assert np.linalg.det(mean) < 0.9
    projected = nearest_rotation(mean)
    np.testing.assert_allclose(projected @ projected.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(projected) == pytest.approx(1.0)
    assert np.linalg.det(nearest_rotation(np.diag([1.0, 1.0, -1.0]))) == pytest.approx(1.0)


def test_likelihood_is_an_order_more_accurate_than_the_linear_solution():
    generator, errors = rng(9), {"linear": [], "ml": []}
    for _ in range(20):
        motion, before, after = two_views(generator, 6, 0.25)
        for solver, found in errors.items():
            estimate = estimate_motion(
                solver, sighting(before, 0.25), sighting(after, 0.25), reject=False
            )
            shift = estimate.transform_after_to_before.translation - motion.translation
            found.append(np.linalg.norm(shift))
    assert np.median(errors["ml"]) < 0.1 * np.median(errors["linear"])


@pytest.mark.parametrize("guessed", [False, True])
def test_wrong_matches_are_left_out(guessed):
    generator = rng(10)
    for _ in range(4):
        motion, before, after = two_views(generator, 20, 0.1)
        wrong = generator.permutation(20)[:6]
        after[wrong, :2] = generator.uniform((0, 0), (510, 492), (6, 2))
        guess = random_motion(generator, 1.0, 0.01) * motion if guessed else None
        found = estimate_motion("ml", sighting(before, 0.1), sighting(after, 0.1), guess=guess)
        assert not found.inliers[wrong].any()
        assert found.inliers.sum() >= 13
        xi = error_of(found.transform_after_to_before, motion)
        assert xi @ np.linalg.solve(found.covariance, xi) < 30  # Chi-squared, 6: 4e-5.


def test_closed_forms_also_leave_wrong_matches_out():
    motion, before, after = two_views(rng(11), 12, 0.0)
    after[:3, 0] += 40.0
    for solver in SOLVERS:
        found = estimate_motion(solver, sighting(before, 0.1), sighting(after, 0.1))
        assert np.abs(error_of(found.transform_after_to_before, motion)).max() < 1e-6


def test_a_majority_of_wrong_matches_is_refused():
    generator = rng(12)
    _, before, after = two_views(generator, 12, 0.1)
    after[:8, :2] = generator.uniform((0, 0), (510, 492), (8, 2))
    with pytest.raises(RegistrationError, match="agree"):
        estimate_motion("ml", sighting(before, 0.1), sighting(after, 0.1))


def bad_sets():
    _, before, _ = two_views(rng(13), 6)
    line = HEAD.points(before[:1]) + np.linspace(0, 0.3, 6)[:, None] * [[0.5, 0.3, 0.8]]
    nan, behind = before.copy(), before.copy()
    nan[2, 1], behind[3, 2] = np.nan, -1.0
    return [
        (before[:3], "3 fiducials: at least 4"),
        (before[:0], "0 fiducials: at least 4"),
        (HEAD.project(line), "in line"),
        (before[:1] + 0.1 * rng(0).standard_normal((6, 3)), "coincide"),
        (nan, r"\[2, 1\] is not finite"),
        (behind, "fiducial 3 has disparity"),
        (before[:, :2], "expected .N, 3."),
    ]


@pytest.mark.parametrize(("points", "message"), bad_sets())
def test_degenerate_sets_are_refused_by_name(points, message):
    places = np.ones((len(points), 3))
    with pytest.raises(RegistrationError, match=message):
        estimate_motion("ml", sighting(points, 0.25), sighting(points, 0.25))
    with pytest.raises(RegistrationError, match=message):
        register(places, np.tile(np.eye(3), (len(points), 1, 1)), sighting(points))


def test_other_bad_input_is_refused():
    _, before, after = two_views(rng(14), 6)
    with pytest.raises(RegistrationError, match="expected one of linear, recursive"):
        estimate_motion("best", sighting(before, 0.25), sighting(after, 0.25))
    with pytest.raises(RegistrationError, match="6 fiducials before and 5 after"):
        estimate_motion("ml", sighting(before, 0.25), sighting(after[:5]))
    with pytest.raises(RegistrationError, match="positive"):
        estimate_motion("ml", sighting(before, 0.0), sighting(after, 0.0))
    with pytest.raises(RegistrationError, match="map points: the value"):
        register(np.full((6, 3), np.inf), np.tile(np.eye(3), (6, 1, 1)), sighting(before))
    with pytest.raises(RegistrationError, match="map covariances of shape"):
        register(np.ones((6, 3)), np.eye(3), sighting(before))
    with pytest.raises(RegistrationError, match="negative"):
        register(np.ones((6, 3)), np.tile(-np.eye(3), (6, 1, 1)), sighting(before))


def test_linear_solution_refuses_a_plane():
    flat = np.column_stack([rng(15).uniform(-0.3, 0.3, (8, 2)), np.full(8, 1.0)])
    for solver in ("linear", "recursive"):
        with pytest.raises(RegistrationError, match="plane"):
            estimate_motion(
                solver, sighting(HEAD.project(flat), 0.25), sighting(HEAD.project(flat), 0.25)
            )
    found = estimate_motion(
        "ml", sighting(HEAD.project(flat), 0.25), sighting(HEAD.project(flat), 0.25)
    )
    np.testing.assert_allclose(found.transform_after_to_before.as_exp_coords(), 0.0, atol=1e-9)


def registered(generator, count, wrong=0):
    """Pose, its error, and the registration to a map of uncertain points."""
    pose = random_motion(generator, 40.0, 1.0)
    points = random_points(generator, count)
    factors = 0.003 * generator.standard_normal((count, 3, 3))
    covariances = factors @ np.swapaxes(factors, -1, -2) + 1e-6 * np.eye(3)
    drawn = [generator.multivariate_normal(np.zeros(3), c) for c in covariances]
    mapped = pose.apply(points) + np.array(drawn)
    image = HEAD.project(points) + 0.1 * generator.standard_normal((count, 3))
    image[:wrong, :2] = generator.uniform((0, 0), (510, 492), (wrong, 2))
    guess = random_motion(generator, 2.0, 0.03) * pose
    found = register(mapped, covariances, sighting(image, 0.1), guess)
    return found, error_of(found.transform_camera_to_world, pose)


def test_registration_to_uncertain_points_is_calibrated():
    generator, total = rng(16), 0.0
    for _ in range(50):
        found, xi = registered(generator, 8)
        total += xi @ np.linalg.solve(found.covariance, xi)
    assert 0.7 < total / 300 < 1.35


def test_registration_leaves_wrong_matches_out():
    generator = rng(17)
    for _ in range(3):
        found, xi = registered(generator, 20, wrong=6)
        assert not found.inliers[:6].any()
        assert xi @ np.linalg.solve(found.covariance, xi) < 30


def test_registration_to_points_known_exactly():
    generator = rng(18)
    pose = random_motion(generator, 40.0, 1.0)
    points = random_points(generator, 6)
    found = register(pose.apply(points), np.zeros((6, 3, 3)), sighting(HEAD.project(points), 0.1))
    assert np.abs(error_of(found.transform_camera_to_world, pose)).max() < 1e-7


def test_a_joint_covariance_of_independent_points_changes_nothing():
    generator = rng(19)
    points = random_points(generator, 6)
    image = HEAD.project(points) + 0.2 * generator.standard_normal((6, 3))
    blocks = np.tile(1e-5 * np.diag([1.0, 2.0, 3.0]), (6, 1, 1))
    joint = np.zeros((18, 18))
    for k in range(6):
        joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = blocks[k]
    first, second = (register(points, c, sighting(image, 0.2)) for c in (blocks, joint))
    np.testing.assert_allclose(first.covariance, second.covariance, rtol=1e-6)
    difference = error_of(first.transform_camera_to_world, second.transform_camera_to_world)
    assert np.abs(difference).max() < 1e-8


@pytest.mark.parametrize(
    ("solve", "limit"),
    [(likelihood.solve, "ITERATIONS"), (likelihood.solve_relative, "RELATIVE_ITERATIONS")],
)
def test_a_fit_that_has_not_converged_is_no_result(monkeypatch, solve, limit):
    motion, before, after = two_views(rng(20), 8)
    sigma = np.full((8, 3), 0.1)
    known = KnownPoints(before, np.tile(0.01 * np.eye(3), (8, 1, 1)), HEAD)
    sight, far = Sighting(after, sigma, HEAD), Pose.of(random_motion(rng(21), 4.0, 0.05) * motion)
    found = solve(far, known, sight)
    pose = found.pose.transform() if limit == "ITERATIONS" else found.relative
    pose = pose if limit == "ITERATIONS" else pose.transform_second_to_first
    assert np.abs(error_of(pose, motion)).max() < 1e-6
    monkeypatch.setattr(likelihood, limit, 1)
    with pytest.raises(RegistrationError, match="not converged in 1 iterations"):
        solve(far, known, sight)
