"""A target seen far away, on images traced from its CAD: the camera's pose, and the robot's."""

import functools
import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import CameraPose, LocalizationConfig
from controllers.mapping.shared_map import SharedMap
from controllers.mission.behaviours import DRIVING
from perception.registration.target import SeenTarget
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from tests.perception.registration.test_target import CAD, HEAD, at, pair
from twin.describe import describe_rover

FAR_SIGMA = np.full(3, 0.1)


def empty_map() -> SharedMap:
    voxels = VoxelMap(VoxelGrid(0.1, (0, 0, 0), (1, 1, 1)))
    return SharedMap(voxels, HEAD, CAD, 4, (0.2, 2.0))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", [(2.6, 0.6, 0.0), (3.4, -0.7, 0.2)])
def test_the_camera_of_a_far_view_is_within_its_covariance(place: tuple, seed: int) -> None:
    target = at(*place)
    camera = empty_map().sight(pair(target, seed))
    assert camera is not None
    off = target.inv() * camera.transform_camera_to_world.inv()
    xi = np.asarray(off.inv().as_exp_coords())
    assert xi @ np.linalg.solve(camera.covariance, xi) < 22.5
    assert (
        np.linalg.norm(camera.transform_camera_to_world.translation - target.inv().translation)
        < 0.05
    )


def test_a_view_without_the_target_sights_nothing() -> None:
    assert empty_map().sight(np.full((2, 492, 510), 90, np.uint8)) is None


def test_only_where_the_target_may_be_is_searched() -> None:
    target = at(2.6, 0.6, 0.0)
    images, middle = pair(target, 0), np.asarray(target.translation)
    whole = empty_map().sight(images)
    about = middle + np.random.default_rng(0).normal(0.0, 0.1, (20, 3))
    found = empty_map().sight(images, about)
    assert whole is not None and found is not None
    off = whole.transform_camera_to_world.inv() * found.transform_camera_to_world
    np.testing.assert_allclose(off.as_exp_coords(), 0.0, atol=1e-9)
    elsewhere = middle * [-1.0, 1.0, 1.0] - [0.8, 0.0, 0.0]
    behind = -middle
    for places in (elsewhere[None], behind[None], np.zeros((0, 3))):
        assert empty_map().sight(images, places) is None


def test_a_target_in_the_shade_is_sighted_though_not_located() -> None:
    arm, _ = camera_arm(describe_rover("rover1"))
    tilt, config, target = np.zeros(2), LocalizationConfig(), at(1.3, 0.6, 0.0)
    dim = (0.22 * pair(target, 0) + 30.0).astype(np.uint8)
    assert empty_map().locate(arm, DRIVING, tilt, dim, FAR_SIGMA, config) is None
    camera = empty_map().sight(dim, np.asarray(target.translation)[None])
    assert camera is not None
    off = target * camera.transform_camera_to_world
    assert np.linalg.norm(off.translation) < 0.03 and off.rotation.magnitude() < 0.03


def test_a_far_view_defines_the_world_as_a_near_one_does() -> None:
    arm, _ = camera_arm(describe_rover("rover1"))
    tilt, config = np.array([0.02, -0.03]), LocalizationConfig()
    near, far = empty_map(), empty_map()
    images = pair(at(1.3, 0.6, 0.0))
    found = near.locate(arm, DRIVING, tilt, images, FAR_SIGMA, config)
    camera = far.sight(images)
    assert found is not None and camera is not None
    other = far.localized(arm, DRIVING, tilt, camera, config)
    apart = other.transform_level_to_world.inv() * found.transform_level_to_world
    assert apart.rotation.magnitude() < 0.01
    assert np.linalg.norm(apart.translation) < 0.02
    assert far.transform_target_to_world is not None


def random_views(
    distance: float, count: int, markers: int
) -> list[tuple[SeenTarget, RigidTransform]]:
    """Return some of a target's markers in views from a distance, and the camera's poses."""
    rng, views = np.random.default_rng(4), []
    for _ in range(count):
        azimuth = rng.uniform(-0.9, 0.9)
        place = distance * np.array([math.sin(azimuth), -0.15, math.cos(azimuth)])
        ahead = -place / np.linalg.norm(place) + rng.normal(0.0, 0.05, 3)
        to_target = RigidTransform.from_components(
            place, Rotation.align_vectors([ahead, [0.0, -1.0, 0.0]], [[0, 0, 1], [0, 1, 0]])[0]
        )
        indices = np.sort(rng.permutation(len(CAD.points))[:markers])
        image = HEAD.project(np.asarray(to_target.apply(CAD.points[indices], inverse=True)))
        views.append(
            (SeenTarget(indices, image + rng.normal(0.0, FAR_SIGMA, image.shape)), to_target)
        )
    return views


@functools.cache
def poses_in_views(
    distance: float, count: int, markers: int
) -> list[tuple[list[CameraPose], RigidTransform]]:
    """Return the poses that fit each of `random_views`, and the true one."""
    views = random_views(distance, count, markers)
    return [(empty_map().poses_at(seen, FAR_SIGMA), true) for seen, true in views]


@pytest.mark.parametrize(
    ("distance", "count", "markers", "known"),
    [(1.2, 20, 3, 1.0), (3.0, 30, 3, 0.5), (3.5, 40, 3, 0.3), (2.5, 40, 4, 0.9)],
)
def test_far_markers_that_may_be_others_or_turned_to_the_other_side_tell_no_pose(
    distance: float, count: int, markers: int, known: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a look for other markers or the mirrored pose, two of 40 at 3.5 m are wrong."""
    found, wrong, shared = 0, 0, empty_map()
    (seen, _), *_ = random_views(distance, 1, markers)
    for poses, true in poses_in_views(distance, count, markers):
        monkeypatch.setattr(shared, "poses_at", lambda *_, poses=poses: poses)
        camera = shared.camera_at(seen, FAR_SIGMA)
        if camera is None:
            continue
        xi = (true * camera.transform_camera_to_world.inv()).as_exp_coords()
        found += 1
        wrong += xi @ np.linalg.solve(camera.covariance, xi) > 30.0
    assert found >= known * count
    assert wrong == 0


@pytest.mark.parametrize(("distance", "count", "markers"), [(3.5, 40, 3), (3.0, 20, 4)])
def test_one_of_the_poses_that_fit_far_markers_alike_is_the_true_one(
    distance: float, count: int, markers: int
) -> None:
    several, true_ones = 0, 0
    for cameras, true in poses_in_views(distance, count, markers)[:20]:
        apart = [(true * c.transform_camera_to_world.inv()).as_exp_coords() for c in cameras]
        errors = [xi @ np.linalg.solve(c.covariance, xi) for xi, c in zip(apart, cameras)]
        true_ones += min(errors) < 30.0
        several += len(cameras) > 1
    assert several > 0
    assert true_ones >= 19  # The covariance of so far a view is not quite that of its errors.


def test_markers_seen_in_one_line_tell_no_pose() -> None:
    along = np.array([[-0.1, 0.0, 2.0], [0.0, 0.0, 2.0], [0.1, 0.0, 2.0]])
    seen = SeenTarget(np.arange(3), HEAD.project(along))
    assert empty_map().camera_at(seen, FAR_SIGMA) is None
