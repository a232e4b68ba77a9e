"""Fiducials followed between views of a plane whose truth is known to any fraction of a pixel."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.registration.motion import RegistrationError, estimate_motion
from perception.registration.patch_matching import TrackerConfig, predict, track
from perception.stereo.patch_fit import EVERYTHING, fit_patch, sample_patch
from tests.perception.registration.fiducial_views import HEAD, error_of, random_motion, sighting
from tests.perception.stereo.textured_plane import TexturedPlane

MOTION = RigidTransform.from_exp_coords([0.03, -0.05, 0.06, 0.03, -0.02, 0.04])


@pytest.fixture(scope="module")
def views():
    """Plane, pairs before and after `MOTION`, fiducials before, and where they are after."""
    rng = np.random.default_rng(1)
    plane = TexturedPlane(rng)
    pairs = [plane.pair(pose, rng) for pose in (RigidTransform.identity(), MOTION)]
    columns, rows = np.meshgrid(np.arange(130, 400, 60), np.arange(90, 400, 60))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    before = plane.image_points(pixels, RigidTransform.identity())
    after = HEAD.project(MOTION.apply(HEAD.points(before), inverse=True))
    return plane, pairs, before, after


def test_fiducials_are_found_to_a_twentieth_of_a_pixel(views):
    _, pairs, before, after = views
    guess = random_motion(np.random.default_rng(2), 0.5, 0.005) * MOTION
    coarse = before + [0.0, 0.0, 0.4]
    found = track(*pairs, coarse, HEAD, guess)
    assert found.found.mean() > 0.9
    error = (found.after - after)[found.found]
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.05
    error = (found.before - before)[found.found]
    assert np.sqrt(np.mean(error[:, 2] ** 2)) < 0.05


def test_motion_from_tracked_fiducials_is_within_a_millimetre(views):
    _, pairs, before, _ = views
    tracks = track(*pairs, before, HEAD, MOTION)
    before, after = (sighting(view[tracks.found], 0.05) for view in (tracks.before, tracks.after))
    found = estimate_motion("ml", before, after)
    xi = error_of(found.transform_after_to_before, MOTION)
    assert np.linalg.norm(xi[3:]) < 1e-3
    assert np.linalg.norm(xi[:3]) < np.radians(0.1)


def test_what_left_the_view_or_has_no_texture_is_not_found(views):
    _, pairs, before, _ = views
    away = RigidTransform.from_exp_coords([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert not track(*pairs, before, HEAD, away).found.any()
    flat = np.full_like(pairs[0], 120)
    assert not track(flat, flat, before, HEAD, MOTION).found.any()
    assert not track(pairs[0], flat, before, HEAD, MOTION).found.any()
    behind = RigidTransform.from_translation([0.0, 0.0, 5.0])
    assert not track(*pairs, before, HEAD, behind).found.any()


def test_right_image_is_not_searched_where_the_fiducial_is_not_expected(views):
    _, pairs, before, _ = views
    still = RigidTransform.identity()
    assert track(pairs[0], pairs[0], before, HEAD, still).found.mean() > 0.9
    beyond = before + [0.0, 0.0, 450.0]
    assert not track(pairs[0], pairs[0], beyond, HEAD, still).found.any()


def test_other_images_are_not_taken_for_the_same_place(views):
    _, pairs, before, _ = views
    other = TexturedPlane(np.random.default_rng(9)).pair(MOTION)
    assert track(pairs[0], other, before, HEAD, MOTION).found.mean() < 0.2


def test_nan_is_passed_over_and_bad_shapes_are_refused(views):
    _, pairs, before, _ = views
    lost = before.copy()
    lost[0] = np.nan
    found = track(*pairs, lost, HEAD, MOTION).found
    assert not found[0]
    assert found[1:].sum() > 20
    with pytest.raises(RegistrationError, match="expected .N, 3."):
        track(pairs[0][:, :100], pairs[1], before, HEAD, MOTION)
    with pytest.raises(RegistrationError, match="expected .N, 3."):
        track(*pairs, before[:, :2], HEAD, MOTION)
    assert track(*pairs, np.zeros((0, 3)), HEAD, MOTION).found.shape == (0,)
    with pytest.raises(ValueError, match="patch"):
        TrackerConfig(patch=8)


def test_predicted_distortion_agrees_with_a_finite_difference():
    points = np.array([[200.0, 150.0, 30.0], [300.0, 300.0, 40.0]])
    expected, warps = predict(points, HEAD, MOTION)
    for axis in range(2):
        shift = 1e-4 * np.eye(3)[axis]
        ends = [predict(points + s * shift, HEAD, MOTION)[0][:, :2] for s in (1.0, -1.0)]
        np.testing.assert_allclose(warps[:, :, axis], (ends[0] - ends[1]) / 2e-4, rtol=1e-5)
    np.testing.assert_allclose(
        expected, HEAD.project(MOTION.apply(HEAD.points(points), inverse=True))
    )


def test_patch_fit_recovers_an_affine_distortion_and_brightness():
    rows, columns = np.mgrid[0:120, 0:120].astype(float)

    def texture(x, y):
        return 100 + 30 * np.sin(x / 4) * np.cos(y / 5) + 20 * np.sin(0.3 * x + 0.2 * y)

    warp, place = np.array([[1.05, 0.08], [-0.06, 0.95]]), np.array([62.3, 57.7])
    inverse = np.linalg.inv(warp)
    x = 55 + inverse[0, 0] * (columns - place[0]) + inverse[0, 1] * (rows - place[1])
    y = 60 + inverse[1, 0] * (columns - place[0]) + inverse[1, 1] * (rows - place[1])
    first = texture(columns, rows).astype(np.float32)
    second = (0.8 * texture(x, y) + 12).astype(np.float32)
    fit = fit_patch(first, second, np.array([55.0, 60.0]), place + 0.8, np.eye(2), 8, EVERYTHING)
    assert fit is not None
    np.testing.assert_allclose(fit.place, place, atol=5e-3)
    np.testing.assert_allclose(fit.warp, warp, atol=2e-3)
    assert fit.correlation > 0.9999


def test_patches_beyond_the_image_are_not_sampled():
    image = np.zeros((40, 40), np.float32)
    assert sample_patch(image, np.array([20.0, 20.0]), np.eye(2), 7) is not None
    for centre in ([7.0, 20.0], [20.0, 31.5], [20.0, -3.0]):
        assert sample_patch(image, np.array(centre), np.eye(2), 7) is None
