"""Features against poses of a plane whose texture is known everywhere."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from scipy.stats import chi2

from perception.registration.checks import RegistrationError
from perception.registration.features import FeatureMatcher
from perception.stereo.matching import StereoMatcher, StereoPoints
from tests.perception.registration.fiducial_views import HEAD, error_of
from tests.perception.stereo.textured_plane import TexturedPlane

MATCHER = StereoMatcher(HEAD)
FEATURES = FeatureMatcher(HEAD)


def view(plane, pose, rng):
    pair = plane.pair(pose, rng)
    return FEATURES.find(pair[0], MATCHER.match(pair))


@pytest.fixture(scope="module")
def motions():
    """(true motion, found motion) of turns by up to 14 degrees with a guess 5 degrees off."""
    rng = np.random.default_rng(8)
    found = []
    for _ in range(6):
        plane = TexturedPlane(rng, waves=120)
        turn, shift = rng.uniform(-0.25, 0.25, 3), rng.uniform(-0.08, 0.08, 3)
        turn[0] *= 0.5
        motion = RigidTransform.from_exp_coords(np.concatenate([turn, shift]))
        wrong = RigidTransform.from_exp_coords(
            np.concatenate([rng.uniform(-0.08, 0.08, 3), rng.uniform(-0.02, 0.02, 3)])
        )
        before = view(plane, RigidTransform.identity(), rng)
        after = view(plane, motion, rng)
        found.append((motion, FEATURES.motion(before, after, wrong * motion)))
    return found


def test_large_turns_are_measured_to_a_milliradian(motions):
    errors = np.array([error_of(found.transform_after_to_before, true) for true, found in motions])
    assert np.abs(errors[:, :3]).max() < 1e-3
    assert np.abs(errors[:, 3:]).max() < 1.5e-3
    assert min(found.inliers.sum() for _, found in motions) > 30


def test_covariance_of_a_motion_holds_its_errors(motions):
    total = 0.0
    for true, found in motions:
        error = error_of(found.transform_after_to_before, true)
        total += error @ np.linalg.solve(found.covariance, error)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * len(motions))
    # Features of one patch share the error of its disparity: at most three times as much.
    assert low / 6.0 < total < 3.0 * high


def test_views_of_different_ground_give_no_motion():
    rng = np.random.default_rng(3)
    start = RigidTransform.identity()
    before, after = (view(TexturedPlane(rng), start, rng) for _ in range(2))
    with pytest.raises(RegistrationError):
        FEATURES.motion(before, after, start)


def test_a_blank_view_has_no_features():
    pair = np.full((2, HEAD.height, HEAD.width), 90, np.uint8)
    assert len(FEATURES.find(pair[0], MATCHER.match(pair)).descriptors) == 0


def test_features_lie_where_dots_do():
    rng, width, height = np.random.default_rng(5), HEAD.width, HEAD.height
    rows, columns = np.indices((height, width))
    u, v = np.meshgrid(np.arange(40.0, width - 40.0, 40.0), np.arange(40.0, height - 40.0, 40.0))
    dots = np.column_stack([u.ravel(), v.ravel()])
    dots += rng.uniform(-4.0, 4.0, dots.shape)
    image = np.full(rows.shape, 60.0)
    for (u, v), size in zip(dots, rng.uniform(3.0, 5.0, len(dots))):
        image += 120.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / (2.0 * size**2))
    far = np.full(len(dots), 40.0)
    places, none = HEAD.points(np.column_stack([dots, far])), np.zeros((len(dots), 3, 3))
    points = StereoPoints(places, none, dots, far, np.zeros(len(dots)))
    found = FEATURES.find(np.rint(image).astype(np.uint8), points).sight.image_points[:, :2]
    apart = np.linalg.norm(found[:, None] - dots, axis=2)
    off = (found - dots[apart.argmin(axis=1)])[apart.min(axis=1) < 1.0]
    assert len(off) > 0.5 * len(dots)
    np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=0.05)
    assert off.std() < 0.2
