"""Is the coded entropy of a picture a measure by which to choose the next view of chapter 3?

A free stereo head views the field of ``ch3-stereo`` from many places. When the first few views
are in the map, all others are candidates: each is rated by what the map expects there, by the
coded entropy of a picture of what the map expects, and by that of the picture that the camera
really takes there. The last is not known before the head has gone there: it is the most that an
entropy of pictures could do. All are held against the true surface that each view then maps.
"""

import copy
import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform
from scipy.stats import rankdata

from controllers.mapping.stereo_view import MapperConfig
from experiments.appc.pictures import Measured, measure_whole, resampled
from experiments.ch3.stereo.scene import RIG, StereoScene, look_at
from experiments.ch3.stereo.trial import BOX, VOXEL, shared_errors
from experiments.ch3.stereo.truth import TRUTH_CELL, mapped_share
from perception.compression.image_codec import image_information
from perception.geometry.arrays import ByteArray, FloatArray
from perception.geometry.pinhole import Frustum
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoMatcher, StereoPoints
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from perception.voxels.occupancy import State
from perception.voxels.views import (
    PlanningGrid,
    expected_occupancy,
    planning_grid,
    view_information,
)

MEASURES = (
    "information",
    "expected_depth_entropy",
    "expected_depth_coded",
    "expected_unknown_coded",
    "seen_entropy",
    "seen_coded",
)
"""What candidates are rated by: the weighted entropy of unknown cells (`perception.
view_information`), which ``ch3-stereo`` uses; entropies of a picture of the depths that the map
expects, as it is and coded by method 5; of a picture of the chance that a ray ends in the unknown,
coded; and of the picture that the camera takes, as it is and coded."""
PICTURE = 256
"""Edge of the pictures whose entropy is taken [px]."""
EYES, SEEN, HEIGHTS = (-1.1, 1.1), (-0.9, 0.9), (0.25, 0.6)
"""Ranges of the head's position and of its target along x and y, and of its height [m]."""
NOT_DOWN = 0.3
"""Least distance of the head's target along the ground [m]."""
RAYS = 40
"""Rays of a rating along each edge of the view, as in ``ch3-stereo``."""


@dataclasses.dataclass(frozen=True)
class ViewTrial:
    """One scene's comparison; a job of the sweep.

    Attributes:
        seed: Seed of scene and views.
        views: Number of views taken.
        known: Numbers of views in the map at which the others are rated.
    """

    seed: int
    views: int
    known: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class TakenView:
    """A view that was taken.

    Attributes:
        camera: True transform from camera to world.
        picture: (PICTURE, PICTURE) uint8 of the left camera, averaged.
        seen: Points that stereo found in the pair.
    """

    camera: RigidTransform
    picture: ByteArray
    seen: StereoPoints


@dataclasses.dataclass(frozen=True)
class ViewComparison:
    """How well each measure chooses the next view of one scene.

    Attributes:
        known: (D,) number of views in the map at each decision.
        correlation: (D, M) rank correlation of each measure with the true gain.
        share: (D, M) gain of the view that each measure chooses over the best candidate's.
        mean_share: (D,) mean gain of all candidates over the best candidate's.
        picture: (PICTURE, PICTURE) uint8, the first picture taken.
        measured: Compression of all pictures taken.
    """

    known: tuple[int, ...]
    correlation: FloatArray
    share: FloatArray
    mean_share: FloatArray
    picture: ByteArray
    measured: Measured


def compare_views(trial: ViewTrial) -> ViewComparison:
    """Rate views of a scene and map with each; a job of the sweep."""
    scene = StereoScene(seed=trial.seed)
    how = MapperConfig()
    rng = np.random.default_rng((trial.seed, 7))
    taken, images, truth = _take(scene, trial.views, how, rng)
    voxels = VoxelMap(VoxelGrid(VOXEL, *BOX), VoxelMapConfig(correlated_points=shared_errors(how)))
    rows: list[tuple[int, FloatArray, FloatArray, float]] = []
    for number, view in enumerate(taken):
        if number in trial.known:
            gains = _gains(voxels, taken[number:], scene.geometry, truth, how)
            if np.ptp(gains) > 0.0:
                ratings = _ratings(voxels, taken[number:], scene.geometry, how)
                share = gains[ratings.argmax(axis=1)] / gains.max()
                mean = float(np.mean(gains) / gains.max())
                rows.append((number, _correlations(ratings, gains), share, mean))
        if number < max(trial.known):
            _fuse(voxels, view, scene.geometry, how)
    return ViewComparison(
        known=tuple(row[0] for row in rows),
        correlation=np.array([row[1] for row in rows]),
        share=np.array([row[2] for row in rows]),
        mean_share=np.array([row[3] for row in rows]),
        picture=taken[0].picture,
        measured=measure_whole(images),
    )


def _take(
    scene: StereoScene, count: int, how: MapperConfig, rng: np.random.Generator
) -> tuple[list[TakenView], list[ByteArray], FloatArray]:
    """Take views; return them, the left images, and (N, 3) the true surface that is in any [m]."""
    geometry = scene.geometry
    matcher = StereoMatcher(geometry, how.stereo)
    columns, rows = np.meshgrid(
        np.linspace(5, geometry.width - 6, RAYS), np.linspace(5, geometry.height - 6, RAYS)
    )
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    taken, images, found = [], [], []
    for _ in range(count):
        scene.set_rig(draw_view(rng))
        view = scene.capture(RIG)
        camera = view.transform_camera_to_world
        images.append(view.pair[0])
        picture = resampled(view.pair[0], PICTURE)
        taken.append(TakenView(camera, picture, matcher.match(view.pair)))
        depths, _ = scene.true_hits(RIG, pixels)
        kept = (depths >= how.reach[0]) & (depths <= how.reach[1])
        disparities = geometry.fx * geometry.baseline / depths[kept]
        found.append(camera.apply(geometry.points(np.column_stack([pixels[kept], disparities]))))
    points = np.concatenate(found)
    points = points[np.all((points > BOX[0]) & (points < BOX[1]), axis=1)]
    _, first = np.unique(np.floor(points / TRUTH_CELL).astype(int), axis=0, return_index=True)
    return taken, images, points[first]


def draw_view(rng: np.random.Generator) -> RigidTransform:
    """Return a random pose of the head over the field, with some of the ground in view."""
    eye = np.append(rng.uniform(*EYES, 2), rng.uniform(*HEIGHTS))
    while np.linalg.norm(seen_at := rng.uniform(*SEEN, 2) - eye[:2]) < NOT_DOWN:
        pass
    return look_at(eye, [*(eye[:2] + seen_at), 0.05])


def _fuse(voxels: VoxelMap, view: TakenView, geometry: StereoGeometry, how: MapperConfig) -> None:
    near, far = how.reach
    stride = how.stereo.stride
    g = geometry
    frustum = Frustum(*g.intrinsics, near, far)
    depths = view.seen.points[:, 2]
    kept = (depths >= near) & (depths <= far)
    turn = view.camera.rotation.as_matrix()
    voxels.insert(
        view.camera,
        frustum.resized(g.width // stride, g.height // stride),
        view.camera.apply(view.seen.points[kept]),
        turn @ view.seen.covariances[kept] @ turn.T,
    )


def _gains(
    voxels: VoxelMap,
    views: Sequence[TakenView],
    geometry: StereoGeometry,
    truth: FloatArray,
    how: MapperConfig,
) -> FloatArray:
    """Return (N,) what share of the true surface each view would add to the map."""
    before, _ = mapped_share(voxels, truth)
    gains = np.zeros(len(views))
    for index, view in enumerate(views):
        trying = copy.deepcopy(voxels)
        _fuse(trying, view, geometry, how)
        gains[index] = mapped_share(trying, truth)[0] - before
    return gains


def _ratings(
    voxels: VoxelMap, views: Sequence[TakenView], geometry: StereoGeometry, how: MapperConfig
) -> FloatArray:
    """Return (M, N) ratings of each view by each measure."""
    grid = planning_grid(voxels)
    occupancy = expected_occupancy(grid.states)
    cameras = RigidTransform.concatenate([view.camera for view in views])
    rays = geometry.directions(RAYS, RAYS)
    rated = [view_information(grid, occupancy, cameras, rays, how.reach)]
    fine = geometry.directions(PICTURE // 2, PICTURE // 2)
    expected = [expected_pictures(grid, occupancy, v.camera, fine, how.reach) for v in views]
    rated += [
        np.array([image_information(depth, 1) for depth, _ in expected]),
        np.array([image_information(depth) for depth, _ in expected]),
        np.array([image_information(unknown) for _, unknown in expected]),
        np.array([image_information(view.picture, 1) for view in views]),
        np.array([image_information(view.picture) for view in views]),
    ]
    return np.array(rated)


def expected_pictures(
    grid: PlanningGrid,
    occupancy: FloatArray,
    camera: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
) -> tuple[ByteArray, ByteArray]:
    """Return what the map expects a camera to see.

    Args:
        grid: Coarse picture of the map.
        occupancy: (nx, ny, nz) from `expected_occupancy`.
        camera: Transform from camera to world.
        rays: (n * n, 3) unit vectors over the picture, camera frame.
        reach: Nearest and farthest distance along a ray [m].

    Returns:
        (n, n) uint8 each: the mean distance at which a ray ends, in 255ths of the farthest, and
        the chance that it ends in what is unknown, in 255ths.
    """
    near, far = reach
    step = grid.resolution / 2.0
    distances = np.arange(near, far, step)
    direction = camera.rotation.apply(rays)
    shape = np.array(grid.states.shape)
    passes, unknown = np.ones(len(rays)), np.zeros(len(rays))
    depth = np.zeros(len(rays))
    for distance in distances:
        points = camera.translation + distance * direction
        cells = np.floor((points - grid.low) / grid.resolution).astype(int)
        inside = np.all((cells >= 0) & (cells < shape), axis=1)
        at = tuple(np.clip(cells, 0, shape - 1).T)
        p = np.where(inside, occupancy[at], 0.0)
        stops = passes * (1.0 - (1.0 - p) ** (step / grid.resolution))
        depth += stops * distance
        unknown += stops * (inside & (grid.states[at] == State.UNKNOWN))
        passes -= stops
    depth += passes * far
    side = round(np.sqrt(len(rays)))
    return _picture(depth / far, side), _picture(unknown, side)


def _picture(values: FloatArray, side: int) -> ByteArray:
    return np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8).reshape(side, side)


def _correlations(ratings: FloatArray, gains: FloatArray) -> FloatArray:
    """Return (M,) Spearman's rank correlations with the gains; 0 where all views rate the same."""
    ranks = rankdata(gains)
    return np.array(
        [np.corrcoef(rankdata(row), ranks)[0, 1] if np.ptp(row) > 0.0 else 0.0 for row in ratings]
    )
