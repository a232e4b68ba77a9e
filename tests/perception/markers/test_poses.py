"""Poses of bodies fitted to ellipses whose errors are drawn: as far off as the fit says."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from perception.markers.ellipses import project_discs
from perception.markers.poses import BodyCad, SeenDiscs, fit_body
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
