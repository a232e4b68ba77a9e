"""Points found in another robot's view, on a slanted plane whose picture is known everywhere."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import RegistrationError
from perception.registration.patch_matching import match_across, surface_normals
from tests.perception.registration.fiducial_views import HEAD
from tests.perception.stereo.textured_plane import TexturedPlane

FIRST = RigidTransform.identity()
PIXELS = np.stack(np.meshgrid(np.arange(120, 420, 60), np.arange(100, 420, 60)), -1).reshape(-1, 2)


def seen_by(plane: TexturedPlane, camera: RigidTransform) -> np.ndarray:
    """How the points that the first camera's PIXELS show appear to another."""
    return HEAD.project(camera.apply(plane.points(PIXELS, FIRST), inverse=True))


def across(degrees: float) -> RigidTransform:
    """A camera turned about what the first one looks at, 0.8 m ahead of both."""
    middle = RigidTransform.from_translation([0.0, 0.0, 0.8])
    turn = RigidTransform.from_exp_coords([0.05, -np.radians(degrees), 0.08, 0.0, 0.0, 0.0])
    return middle * turn * middle.inv()


@pytest.fixture(scope="module")
def scene():
    """A plane that faces between two cameras 55 degrees apart, and what both see."""
    rng = np.random.default_rng(3)
    plane = TexturedPlane(rng, (np.sin(0.45), -0.1, np.cos(0.45)), 0.72)
    second = across(-55.0)
    return plane, second, plane.pair(FIRST, rng), plane.pair(second, rng)


def test_points_are_found_across_a_wide_baseline_as_certainly_as_they_say(scene):
    plane, second, one, two = scene
    seen = plane.image_points(PIXELS, FIRST)
    normals = np.tile(-plane.normal, (len(seen), 1))
    matches = match_across(one, two, seen, normals, HEAD, second)
    truth = seen_by(plane, second)
    error = matches.image_points[matches.found] - truth[matches.found]
    assert matches.found.sum() > 0.7 * len(seen)
    assert np.linalg.norm(second.translation) > 0.7
    assert np.abs(error).max() < 0.25
    ratio = error / matches.sigma[matches.found]
    assert 0.2 < np.mean(ratio**2) < 2.0
    # Perspective within the patch would put all of them aside by more than that.
    assert np.abs(np.median(error, axis=0)).max() < 0.01


def test_a_rough_pose_and_a_normal_some_degrees_off_are_enough(scene):
    plane, second, one, two = scene
    seen = plane.image_points(PIXELS, FIRST)
    tilted = RigidTransform.from_exp_coords([0.05, 0.06, 0, 0, 0, 0]).apply(-plane.normal)
    slip = RigidTransform.from_exp_coords([0.002, -0.002, 0.002, 0.001, 0.001, 0.001])
    matches = match_across(one, two, seen, np.tile(tilted, (len(seen), 1)), HEAD, slip * second)
    error = matches.image_points - seen_by(plane, second)
    assert matches.found.sum() > 0.6 * len(seen)
    assert np.abs(error[matches.found]).max() < 0.3


def test_where_the_surface_faces_away_or_another_picture_is_nothing_is_found(scene):
    plane, second, one, two = scene
    seen = plane.image_points(PIXELS, FIRST)
    normals = np.tile(-plane.normal, (len(seen), 1))
    other = np.random.default_rng(1).integers(0, 255, two.shape).astype(np.uint8)
    assert not match_across(one, other, seen, normals, HEAD, second).found.any()
    assert not match_across(one, np.zeros_like(two), seen, normals, HEAD, second).found.any()
    assert not match_across(one, two, seen, np.full_like(normals, np.nan), HEAD, second).found.any()
    edge = np.cross(plane.normal, [0.0, 1.0, 0.0])
    turned = np.tile(edge, (len(seen), 1))
    assert not match_across(one, two, seen, turned, HEAD, second).found.any()
    assert not match_across(one, two, seen, -normals, HEAD, second).found.any()
    assert not match_across(one, two, np.full_like(seen, np.nan), normals, HEAD, second).found.any()
    assert not match_across(one, two, seen * [1, 1, -1], normals, HEAD, second).found.any()
    assert not len(match_across(one, two, seen[:0], normals[:0], HEAD, second).found)


def test_normals_are_those_of_planes_and_none_of_edges():
    rng = np.random.default_rng(5)
    flat = np.column_stack([rng.uniform(-0.1, 0.1, (3000, 2)), np.full(3000, 1.0)])
    flat[:, 2] += 0.4 * flat[:, 0] + 0.0005 * rng.standard_normal(3000)
    truth = np.array([0.4, 0.0, -1.0]) / np.hypot(1.0, 0.4)
    places = np.array([[0.0, 0.0, 1.0], [0.05, -0.05, 1.02]])
    np.testing.assert_allclose(surface_normals(places, flat), [truth, truth], atol=0.02)
    step = flat.copy()
    step[flat[:, 1] > 0.0, 2] += 0.02
    assert np.isnan(surface_normals(places[:1], step)).all()
    assert np.isfinite(surface_normals(places[1:], step)).all()
    assert np.isnan(surface_normals(places, flat[:5])).all()
    assert np.isnan(surface_normals(places, np.zeros((0, 3)))).all()


def test_bad_shapes_are_refused(scene):
    _, second, one, two = scene
    seen = np.array([[250.0, 250.0, 30.0]])
    with pytest.raises(RegistrationError, match=r"matching pairs of shapes .* expected \(2, 492"):
        match_across(one, two[:, :100], seen, seen, HEAD, second)
    with pytest.raises(RegistrationError, match=r"points of shape \(1, 3\) with normals \(1, 2\)"):
        match_across(one, two, seen, seen[:, :2], HEAD, second)
