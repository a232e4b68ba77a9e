"""A camera's pose is corrected by what it has seen before, on rendered pairs."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.mapping.fiducial_localizer import FiducialLocalizer
from experiments.ch3.stereo.scene import RIG, StereoScene, look_at
from perception.registration.fiducial_map import PosePrior
from perception.stereo.matching import StereoMatcher

pytestmark = pytest.mark.slow
GUESS = np.diag([0.005, 0.005, 0.005, 0.004, 0.004, 0.004]) ** 2


@pytest.fixture(scope="module")
def scene() -> StereoScene:
    return StereoScene(seed=3)


@pytest.fixture(scope="module")
def matcher(scene) -> StereoMatcher:
    return StereoMatcher(scene.geometry)


def look(scene, eye):
    scene.set_rig(look_at(eye, [0.0, 0.2, 0.1]))
    view = scene.capture(RIG)
    return view.pair, view.transform_camera_to_world


def assert_at(camera, prior):
    np.testing.assert_allclose(
        camera.transform_camera_to_world.as_matrix(),
        prior.transform_camera_to_world.as_matrix(),
        atol=1e-12,
    )
    np.testing.assert_allclose(camera.covariance, prior.covariance)


def test_second_view_from_nearby_is_corrected_to_a_millimetre(scene, matcher):
    rng = np.random.default_rng(0)
    localizer = FiducialLocalizer(scene.geometry)
    pair, true = look(scene, [0.0, -0.7, 0.35])
    first = localizer.locate(pair, matcher.match(pair), PosePrior(true, 1e-12 * np.eye(6)))
    assert not first.corrected and len(first.added) >= 10
    pair, true = look(scene, [0.06, -0.68, 0.38])
    off = RigidTransform.from_exp_coords(rng.multivariate_normal(np.zeros(6), GUESS))
    result = localizer.locate(pair, matcher.match(pair), PosePrior(off * true, GUESS))
    assert result.corrected
    error = (true * result.camera.transform_camera_to_world.inv()).as_exp_coords()
    guessed = np.linalg.norm(off.apply(true.translation) - true.translation)
    found = np.linalg.norm(result.camera.transform_camera_to_world.translation - true.translation)
    assert found < 1e-3 < guessed
    # Seven times the expectation of six: one in a million, were all Gaussian.
    assert error @ np.linalg.solve(result.camera.covariance, error) < 42


def test_view_elsewhere_leaves_the_prior_unchanged(scene, matcher):
    localizer = FiducialLocalizer(scene.geometry)
    pair, true = look(scene, [0.0, -0.7, 0.35])
    localizer.locate(pair, matcher.match(pair), PosePrior(true, 1e-12 * np.eye(6)))
    scene.set_rig(look_at([0.0, -0.7, 0.35], [0.9, -0.6, 0.0]))
    view = scene.capture(RIG)
    prior = PosePrior(view.transform_camera_to_world, GUESS)
    result = localizer.locate(view.pair, matcher.match(view.pair), prior)
    assert not result.corrected
    assert_at(result.camera, prior)


def test_black_pair_adds_nothing_and_leaves_the_guess(scene, matcher):
    localizer = FiducialLocalizer(scene.geometry)
    black = np.zeros((2, scene.geometry.height, scene.geometry.width), np.uint8)
    prior = PosePrior(RigidTransform.identity(), GUESS)
    result = localizer.locate(black, matcher.match(black), prior)
    assert_at(result.camera, prior)
    assert not len(result.added) and not len(localizer.fiducials)


def test_shared_error_found_in_one_view_corrects_the_next_that_has_no_known_fiducial(
    scene, matcher
):
    """The robot is 6 mm off its estimate; its third view has no fiducial, but is corrected."""
    localizer = FiducialLocalizer(scene.geometry)
    pair, true = look(scene, [0.0, -0.7, 0.35])
    localizer.locate(pair, matcher.match(pair), PosePrior(true, 1e-12 * np.eye(6)))
    numbers = localizer.fiducials.share(GUESS)
    off = RigidTransform.from_exp_coords([0.004, -0.003, 0.002, 0.006, 0.0, 0.0])
    own = 1e-8 * np.eye(6)
    pair, true = look(scene, [0.06, -0.68, 0.38])
    prior = PosePrior(off.inv() * true, own, numbers, np.eye(6))
    assert localizer.locate(pair, matcher.match(pair), prior).corrected
    scene.set_rig(look_at([0.0, -0.7, 0.35], [0.9, -0.6, 0.0]))
    view = scene.capture(RIG)
    true = view.transform_camera_to_world
    prior = PosePrior(off.inv() * true, own, numbers, np.eye(6))
    result = localizer.locate(view.pair, matcher.match(view.pair), prior)
    assert not result.corrected
    before, after = (
        np.linalg.norm(p.apply([0.0, 0.0, 0.8]) - true.apply([0.0, 0.0, 0.8]))
        for p in (prior.transform_camera_to_world, result.camera.transform_camera_to_world)
    )
    assert after < 1.5e-3 < 4e-3 < before
