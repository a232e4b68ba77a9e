"""The truth of a scene, which scores what ``ch3-stereo`` mapped and is used for nothing else."""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from controllers.mapping.stereo_view import StereoView
from experiments.ch3.stereo.scene import SHOWN_GROUPS, StereoScene
from perception.geometry.arrays import FloatArray
from perception.voxels.map import Surface, VoxelMap

TRUTH_VIEWS = 60
TRUTH_CELL = 0.02  # [m]
WITHIN = 0.015
"""A piece of true surface is mapped when the map has an occupied voxel so near [m]."""
SAMPLES = 2000
"""Surface estimates that are compared with the truth."""
BACK = 0.06
"""From so far before an estimate the true surface is sought [m]."""
LOST = 0.04
"""An estimate farther from the true surface is counted apart: it belongs to another one [m]."""
_CUBE = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
_AROUND = _CUBE[_CUBE.any(axis=1)] / np.linalg.norm(_CUBE[_CUBE.any(axis=1)], axis=1)[:, None]


def true_surface(
    scene: StereoScene, reach: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return (N, 3) pieces of surface [m], scene frame, that the arms can see: 2 cm each.

    Args:
        scene: Its arms are moved about.
        reach: Nearest and farthest depth that counts [m].
        rng: Draws postures of the arms.
    """
    geometry = scene.geometry
    columns, rows = np.meshgrid(
        np.linspace(5, geometry.width - 6, 40), np.linspace(5, geometry.height - 6, 40)
    )
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    found = [np.zeros((0, 3))]
    for name in scene.robot_names:
        home, limits, taken = scene.joints(name), scene.joint_limits(name), 0
        while taken < TRUTH_VIEWS:
            scene.set_joints(name, rng.uniform(*limits.T))
            if scene.arm_touches(name):
                continue
            taken += 1
            depths, geoms = scene.true_hits(name, pixels)
            still = scene.model.body_weldid[scene.model.geom_bodyid[geoms]] == 0
            seen = np.column_stack([pixels, geometry.fx * geometry.baseline / depths])
            kept = still & (depths >= reach[0]) & (depths <= reach[1])
            local = geometry.points(seen[kept])
            found.append(scene.transform_camera_to_world(name).apply(local))
        scene.set_joints(name, home)
    points = np.concatenate(found)
    _, first = np.unique(np.floor(points / TRUTH_CELL).astype(int), axis=0, return_index=True)
    return points[first]


def mapped_share(voxels: VoxelMap, pieces: FloatArray) -> tuple[float, int]:
    """Return which share of true surface (N, 3) [m] is mapped, and the number of occupied voxels.

    Args:
        voxels: The map.
        pieces: Of true surface, in the map's frame.
    """
    cells, _ = voxels.occupied_cells()
    if not len(cells):
        return 0.0, 0
    distance, _ = KDTree(voxels.grid.centres(cells)).query(pieces, distance_upper_bound=WITHIN)
    return float(np.mean(np.isfinite(distance))), len(cells)


def pose_errors(
    views: Sequence[StereoView], cameras: Mapping[tuple[str, float], RigidTransform]
) -> tuple[FloatArray, FloatArray]:
    """Return (L,) errors of the cameras' places [m], by the arm and as corrected by fiducials.

    Args:
        views: Views taken.
        cameras: True, by robot and time stamp.
    """
    errors = [np.zeros((0, 2))]
    for view in views:
        if view.prediction is None or view.correction is None:
            continue
        true = cameras[view.robot, view.time].translation
        told = [
            camera.transform_camera_to_world.translation
            for camera in (view.prediction, view.correction.camera)
        ]
        errors.append(np.linalg.norm(np.array(told) - true, axis=1)[None])
    guess, corrected = np.concatenate(errors).T
    return guess, corrected


def surface_errors(
    surface: Surface,
    scene: StereoScene,
    transform_scene_to_map: RigidTransform,
    rng: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Return squared normalised errors of the map's surface, and the share that is nowhere near.

    The error of an estimate is its distance from the nearest true surface that faces one of 26
    directions, over the deviation that its covariance says it has across that surface: where along
    the surface it lies, nothing can tell.

    Args:
        surface: What the map says.
        scene: The truth.
        transform_scene_to_map: True.
        rng: Draws which estimates are compared.
    """
    count = len(surface.means)
    if not count:
        return np.zeros(0), 0.0  # No robot has found the target: there is no map.
    chosen = rng.choice(count, min(SAMPLES, count), replace=False)
    to_scene = transform_scene_to_map.inv()
    means = to_scene.apply(surface.means[chosen])
    turn = to_scene.rotation.as_matrix()
    covariances = turn @ surface.covariances[chosen] @ turn.T
    hits = [_nearest(scene, mean) for mean in means]
    errors = np.array([error for error, _ in hits])
    normals = np.array([normal for _, normal in hits])
    near = np.abs(errors) < LOST
    variances = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    return errors[near] ** 2 / variances[near], 1.0 - float(np.mean(near))


def _nearest(scene: StereoScene, point: FloatArray) -> tuple[float, FloatArray]:
    """Return the distance to the nearest surface [m], infinite if far, and its normal (3,)."""
    best, normal = np.inf, np.array([0.0, 0.0, 1.0])
    for direction in _AROUND:
        depth, across = _hit(scene, point - BACK * direction, direction)
        error = (depth - BACK) * float(direction @ across) if np.isfinite(depth) else np.inf
        if abs(error) < abs(best):
            best, normal = error, across
    return best, normal


def _hit(scene: StereoScene, start: FloatArray, direction: FloatArray) -> tuple[float, FloatArray]:
    """Return depth [m] and normal (3,) of the true surface along a ray; infinity if none."""
    geom, normal = np.array([-1], np.int32), np.zeros(3)
    depth = mujoco.mj_ray(
        scene.model, scene.data, start, direction, SHOWN_GROUPS, 1, -1, geom, normal
    )
    return (depth, normal) if depth >= 0.0 else (np.inf, direction)
