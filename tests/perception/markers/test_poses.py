"""Poses of bodies fitted to ellipses whose errors are drawn: as far off as the fit says."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from perception.geometry.pinhole import StereoCalibration
from perception.markers.ellipses import project_discs
from perception.markers.poses import BodyCad, BodyPrior, SeenDiscs, fit_body
from perception.stereo.geometry import CALIBRATION_ERRORS
from tests.perception.markers.marker_pictures import HEAD, RADIUS, seen

SLOT = BodyCad(np.array([[-0.072, 0.015, 0.01], [0.072, 0.015, 0.01]]))


def draw(pose, rng, sigma):
    """Return the discs of a body with errors of the ellipses' centres and axes [px]."""
    truth = seen(pose, SLOT.points)
    axes = np.sqrt(truth[..., [2, 4]])
    deviations = sigma * np.stack(
        [
            np.ones_like(axes[..., 0]),
            np.ones_like(axes[..., 0]),
            2.0 * axes[..., 0],
            np.sqrt(axes.prod(axis=-1)),
            2.0 * axes[..., 1],
        ],
        axis=-1,
    )
    ellipses = truth + deviations * rng.standard_normal(truth.shape)
    covariances = deviations[..., None] ** 2 * np.eye(5)
    disparities = ellipses[0, :, 0] - ellipses[1, :, 0]
    points = HEAD.points(np.column_stack([ellipses[0, :, :2], disparities]))
    return SeenDiscs(ellipses, covariances, points)


def facing(slant, distance):
    turn = Rotation.from_euler("zyx", [0.1, 0.0, np.pi + slant])
    return RigidTransform.from_components([0.015, -0.01, distance], turn)


def error_of(fit, pose):
    return np.asarray((pose * fit.transform_body_to_camera.inv()).as_exp_coords())


@pytest.mark.parametrize("slant", [-0.8, 0.9])
def test_pose_error_of_a_slanted_body_is_consistent_with_its_covariance(slant):
    rng = np.random.default_rng(0)
    pose = facing(slant, 0.4)
    nees, misfits = [], []
    for _ in range(60):
        fit = fit_body(draw(pose, rng, 0.02), HEAD, SLOT, RADIUS)
        xi = error_of(fit, pose)
        nees.append(xi @ np.linalg.solve(fit.covariance, xi))
        misfits.append(fit.misfit)
    # Six degrees of freedom each; of the 20 numbers of four ellipses 14 are left to the misfit.
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * 60) / 60
    assert low < np.mean(nees) < high
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 14 * 60) / (14 * 60)
    assert low < np.mean(misfits) < high


def test_pose_of_a_body_seen_head_on_is_ambiguous_within_its_covariance():
    """Both make ellipses alike: some fits end in the wrong one, and their deviation holds it."""
    rng = np.random.default_rng(1)
    slant = 0.2
    pose = facing(slant, 0.8)
    axis = pose.rotation.apply([1.0, 0.0, 0.0])
    turns, sigmas = [], []
    for _ in range(80):
        fit = fit_body(draw(pose, rng, 0.15), HEAD, SLOT, RADIUS)
        turns.append(error_of(fit, pose)[:3] @ axis)
        sigmas.append(fit.turn_sigma)
    wrong = np.abs(turns) > slant
    assert 5 < np.count_nonzero(wrong) < 60
    ratios = np.abs(turns) / np.array(sigmas)
    assert np.mean(ratios < 3.0) > 0.85 and 0.7 < np.mean(np.square(ratios)) < 4.0


def test_discs_of_a_pose_are_those_that_the_fit_makes_of_it():
    pose = facing(0.5, 0.5)
    exact = draw(pose, np.random.default_rng(3), 1e-6)
    fit = fit_body(exact, HEAD, SLOT, RADIUS)
    np.testing.assert_allclose(error_of(fit, pose), 0.0, atol=1e-5)
    again = project_discs(
        fit.transform_body_to_camera.apply(SLOT.points),
        fit.transform_body_to_camera.rotation.apply(SLOT.normal),
        RADIUS,
        HEAD,
    )
    np.testing.assert_allclose(again, exact.ellipses[0], atol=1e-3)


ROUGH = dataclasses.replace(
    HEAD, calibration=StereoCalibration(focal=2e-4, principal=0.3, eye_turn=3e-4, eye_shift=1e-4)
)
"""A head whose calibration leaves ten times more than the noise of the ellipses in these tests."""


def seen_through(errors, pose, rng, sigma=0.02):
    """Return the discs of a body through a head with given errors of its calibration (9,)."""
    discs = draw(pose, rng, sigma)
    shift = ROUGH.calibration_jacobian(pose.apply(SLOT.points)) @ errors
    ellipses = discs.ellipses.copy()
    ellipses[..., :2] += np.swapaxes(shift, 0, 1)
    disparities = ellipses[0, :, 0] - ellipses[1, :, 0]
    points = ROUGH.points(np.column_stack([ellipses[0, :, :2], disparities]))
    return SeenDiscs(ellipses, discs.covariances, points)


def squares(errors, covariances):
    """Return the mean squared Mahalanobis distance."""
    return np.mean([xi @ np.linalg.solve(c, xi) for xi, c in zip(errors, covariances, strict=True)])


def test_pose_knows_what_its_calibration_leaves_and_how_much_of_it_another_body_shares():
    """Of a single pose it is most of the error; between two bodies in view it nearly cancels.

    Errors are drawn from the calibration's deviations, once for each head and both its bodies.
    """
    rng, count = np.random.default_rng(3), 120
    poses = [facing(-0.7, 0.45), facing(0.8, 0.5)]
    alone, apart = [], []
    stated, without, shared, independent = [], [], [], []
    for _ in range(count):
        errors = rng.standard_normal(CALIBRATION_ERRORS)
        one, two = (
            fit_body(seen_through(errors, pose, rng), ROUGH, SLOT, RADIUS) for pose in poses
        )
        alone.append(error_of(one, poses[0]))
        stated.append(one.covariance)
        without.append(one.covariance - one.by_calibration @ one.by_calibration.T)
        apart.append(error_of(two, poses[1]) - alone[-1])
        both = one.by_calibration @ two.by_calibration.T
        independent.append(one.covariance + two.covariance)
        shared.append(independent[-1] - both - both.T)
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * count) / count
    assert low < squares(alone, stated) < high
    assert squares(alone, without) > 2.0 * high
    assert low < squares(apart, shared) < high
    assert squares(apart, independent) < 0.8 * low


def test_markers_that_a_calibration_forbids_fit_badly_and_those_it_allows_do_not():
    rng = np.random.default_rng(4)
    errors = rng.standard_normal((20, CALIBRATION_ERRORS))
    discs = [seen_through(each, facing(0.8, 0.5), rng) for each in errors]
    exact, stated = (
        np.mean([fit_body(each, head, SLOT, RADIUS).misfit for each in discs])
        for head in (HEAD, ROUGH)
    )
    assert stated < 1.3 and exact > 3.0


def test_pose_that_was_measured_by_the_same_cameras_is_no_independent_prior():
    """Six views of one head: noise averages, the calibration's errors stay."""
    rng, count = np.random.default_rng(5), 30
    pose = facing(0.8, 0.5)
    ends, forgetful = [], []
    for _ in range(count):
        errors = rng.standard_normal(CALIBRATION_ERRORS)
        fit = naive = fit_body(seen_through(errors, pose, rng), ROUGH, SLOT, RADIUS)
        for _ in range(5):
            discs = seen_through(errors, pose, rng)
            place, information = fit.transform_body_to_camera, np.linalg.inv(fit.covariance)
            prior = BodyPrior(place, information, fit.by_calibration)
            fit = fit_body(discs, ROUGH, SLOT, RADIUS, prior)
            information = np.linalg.inv(naive.covariance)
            prior = BodyPrior(naive.transform_body_to_camera, information)
            naive = fit_body(discs, ROUGH, SLOT, RADIUS, prior)
        ends.append((error_of(fit, pose), fit.covariance))
        forgetful.append((error_of(naive, pose), naive.covariance))
    low, high = chi2.ppf([5e-4, 1 - 5e-4], 6 * count) / count
    assert 0.7 * low < squares(*zip(*ends, strict=True)) < 1.2 * high
    assert squares(*zip(*forgetful, strict=True)) > 1.5 * high
