"""Persistent fiducials: joint covariance and honest errors."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.registration.fiducial_map import FiducialMap, PosePrior
from perception.registration.motion import RegistrationError, estimate_motion
from tests.perception.registration.fiducial_views import (
    HEAD,
    error_of,
    random_motion,
    random_points,
    sighting,
)

SIGMA = 0.2


def seen(pose, points, generator, sigma=SIGMA):
    image = HEAD.project(pose.apply(points, inverse=True))
    return image + sigma * generator.standard_normal(image.shape)


def explore(seed, steps=8, count=8, fresh=4):
    """A map grown over some steps: the fiducials' truth, the map, and the poses' NEES."""
    generator = np.random.default_rng(seed)
    fiducials = FiducialMap(HEAD, np.full(3, SIGMA))
    truth = random_points(generator, count)
    fiducials.add(seen(RigidTransform.identity(), truth, generator), RigidTransform.identity())
    squares, pose = [], RigidTransform.identity()
    for _ in range(steps):
        pose = random_motion(generator, 2.0, 0.02) * pose
        new = pose.apply(random_points(generator, fresh))
        guess = random_motion(generator, 1.0, 0.01) * pose
        numbers = np.arange(len(truth))[-10:]
        found = fiducials.observe(
            numbers,
            seen(pose, truth[numbers], generator),
            new=seen(pose, new, generator),
            guess=guess,
        )
        truth = np.concatenate([truth, new])
        xi = error_of(found.registration.transform_camera_to_world, pose)
        squares.append(xi @ np.linalg.solve(found.registration.covariance, xi) / 6)
    return truth, fiducials, squares


def test_poses_and_fiducials_of_a_growing_map_are_calibrated():
    poses, points = [], []
    for seed in range(5):
        truth, fiducials, squares = explore(seed)
        poses += squares
        error = (truth - fiducials.positions).ravel()
        joint = error @ np.linalg.solve(fiducials.covariance, error)
        points.append(joint / error.size)
    assert 0.7 < np.mean(poses) < 1.4
    # All fiducials together: their errors' correlation is as said, too.
    assert 0.8 < np.mean(points) < 1.25


def test_covariance_stays_positive_and_symmetric():
    _, fiducials, _ = explore(3, steps=12)
    np.testing.assert_array_equal(fiducials.covariance, fiducials.covariance.T)
    assert np.linalg.eigvalsh(fiducials.covariance).min() > 0.0


def test_seeing_fiducials_again_from_where_they_were_seen_halves_their_variance():
    generator = np.random.default_rng(4)
    truth = random_points(generator, 30)
    image = HEAD.project(truth)
    fiducials = FiducialMap(HEAD, np.full(3, 0.01))
    fiducials.add(image, RigidTransform.identity())
    once = fiducials.covariances()
    fiducials.observe(np.arange(30), image)
    # But for what the pose took: 6 of 90 degrees of freedom.
    ratio = np.trace(fiducials.covariances().sum(axis=0)) / np.trace(once.sum(axis=0))
    assert 0.5 < ratio < 0.56


def test_registered_camera_does_not_drift_where_fresh_fiducials_do():
    generator = np.random.default_rng(5)
    truth = random_points(generator, 12)
    fiducials = FiducialMap(HEAD, np.full(3, SIGMA))
    start = seen(RigidTransform.identity(), truth, generator)
    fiducials.add(start, RigidTransform.identity())
    chained, before, kept, drifted = RigidTransform.identity(), start, [], []
    for _ in range(20):
        pose = random_motion(generator, 2.0, 0.03)
        image = seen(pose, truth, generator)
        found = fiducials.observe(np.arange(12), image).registration
        kept.append(np.linalg.norm(error_of(found.transform_camera_to_world, pose)[3:]))
        moved = estimate_motion(
            "kabsch", sighting(before, SIGMA), sighting(image, SIGMA), reject=False
        )
        chained, before = chained * moved.transform_after_to_before, image
        drifted.append(np.linalg.norm(error_of(chained, pose)[3:]))
    assert np.mean(kept[-5:]) < 1.5 * np.mean(kept[:5])
    assert np.mean(drifted[-5:]) > 5 * np.mean(kept[-5:])


def test_wrong_matches_neither_move_the_pose_nor_the_map():
    generator = np.random.default_rng(6)
    truth = random_points(generator, 12)
    fiducials = FiducialMap(HEAD, np.full(3, SIGMA))
    fiducials.add(seen(RigidTransform.identity(), truth, generator), RigidTransform.identity())
    image = seen(RigidTransform.identity(), truth, generator)
    image[:3] += [60.0, -40.0, 5.0]
    before = fiducials.covariances()
    found = fiducials.observe(np.arange(12), image)
    assert not found.registration.inliers[:3].any()
    assert found.registration.inliers[3:].all()
    error = fiducials.positions - truth
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(fiducials.covariances()), error)
    assert squares.max() < 25
    smaller = np.trace(fiducials.covariances(), axis1=1, axis2=2) / np.trace(
        before, axis1=1, axis2=2
    )
    assert smaller[3:].max() < 0.9


def test_a_view_that_cannot_be_registered_leaves_the_map():
    _, fiducials, _ = explore(7, steps=2)
    positions, covariance = fiducials.positions.copy(), fiducials.covariance.copy()
    generator = np.random.default_rng(8)
    nonsense = np.column_stack([generator.uniform(0, 490, (10, 2)), generator.uniform(15, 40, 10)])
    with pytest.raises(RegistrationError):
        fiducials.observe(np.arange(10), nonsense, new=nonsense)
    np.testing.assert_array_equal(fiducials.positions, positions)
    np.testing.assert_array_equal(fiducials.covariance, covariance)


def test_unknown_and_repeated_numbers_are_refused():
    _, fiducials, _ = explore(9, steps=0)
    image = HEAD.project(fiducials.positions)
    with pytest.raises(RegistrationError, match=r"\[8\]: the map has 0 to 7"):
        fiducials.observe([0, 1, 2, 8], image[:4])
    with pytest.raises(RegistrationError, match="twice"):
        fiducials.observe([0, 1, 2, 2], image[:4])
    with pytest.raises(RegistrationError, match="3 numbers for 4"):
        fiducials.observe([0, 1, 2], image[:4])
    with pytest.raises(RegistrationError, match="not finite"):
        fiducials.observe([0, 1, 2, 3], image[:4], new=[[np.nan, 1.0, 20.0]])


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.full((6, 6), np.nan), r"\[0, 0\] is not finite"),
        (np.eye(3), r"shape \(3, 3\): expected \(6, 6\)"),
        (-np.eye(6), "negative in some direction"),
        (np.eye(6)[[1, 0, 2, 3, 4, 5]], "negative in some direction"),
    ],
)
def test_what_is_no_covariance_of_a_pose_is_refused_and_leaves_the_map(covariance, message):
    _, fiducials, _ = explore(9, steps=0)
    joint, pose = fiducials.covariance.copy(), RigidTransform.identity()
    image = HEAD.project(fiducials.positions)
    with pytest.raises(RegistrationError, match=message):
        fiducials.add(image, pose, covariance)
    with pytest.raises(RegistrationError, match=message):
        fiducials.observe_from(PosePrior(pose, covariance), [0, 1], image[:2], new=image)
    np.testing.assert_array_equal(fiducials.covariance, joint)
