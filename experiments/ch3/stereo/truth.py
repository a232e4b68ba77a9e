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
"""Greatest distance from an occupied voxel at which a piece of true surface is mapped [m]."""
SAMPLES = 2000
"""Greatest number of surface estimates that are compared with the truth."""
BACK = 0.06
"""Distance before an estimate from which the true surface is searched for [m]."""
LOST = 0.04
"""An estimate farther from the true surface is counted apart: it belongs to another one [m]."""
_CUBE = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
_AROUND = _CUBE[_CUBE.any(axis=1)] / np.linalg.norm(_CUBE[_CUBE.any(axis=1)], axis=1)[:, None]


def true_surface(
    scene: StereoScene, reach: tuple[float, float], rng: np.random.Generator
) -> FloatArray:
    """Return (N, 3) pieces of surface [m], scene frame, that the arms can see: 2 cm each.

    Args:
        scene: Scene whose arms are moved about.
        reach: Nearest and farthest depth that counts [m].
        rng: Random generator for the postures of the arms.
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
    """Return the share of true surface that is mapped, and the number of occupied voxels.

    Args:
        voxels: Map of the scene.
        pieces: (N, 3) pieces of true surface [m], map frame.
    """
    cells, _ = voxels.occupied_cells()
    if not len(cells):
        return 0.0, 0
    distance, _ = KDTree(voxels.grid.centres(cells)).query(pieces, distance_upper_bound=WITHIN)
    return float(np.mean(np.isfinite(distance))), len(cells)


def pose_errors(
    views: Sequence[StereoView], cameras: Mapping[tuple[str, float], RigidTransform]
) -> FloatArray:
    """Return (2, L) errors of the cameras' positions [m], by the arm and corrected by fiducials.

    Args:
        views: Views taken.
        cameras: True transforms from camera to map, by robot and time stamp.
    """
    errors = [np.zeros((2, 0))]
    for view in views:
        if view.prediction is not None and view.correction is not None:
            true = cameras[view.robot, view.time].translation
            poses = (view.prediction, view.correction.camera)
            estimates = np.array([p.transform_camera_to_world.translation for p in poses])
            errors.append(np.linalg.norm(estimates - true, axis=1)[:, None])
    return np.hstack(errors)


def surface_errors(
    surface: Surface,
    scene: StereoScene,
    transform_scene_to_map: RigidTransform,
    rng: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Return squared normalised errors of the map's surface, and the share that is nowhere near.

    The error of an estimate is its distance from the nearest true surface that faces one of 26
    directions, over the standard deviation of its covariance across that surface: its position
    along the surface cannot be compared.

    Args:
        surface: Surface estimates of the map.
        scene: Scene with the true surface.
        transform_scene_to_map: True transform from the scene to the map's frame.
        rng: Random generator that chooses the estimates to compare.
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
    errors, normals = (np.array(part) for part in zip(*hits))
    near = np.abs(errors) < LOST
    variances = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    return errors[near] ** 2 / variances[near], 1.0 - float(np.mean(near))


def _nearest(scene: StereoScene, point: FloatArray) -> tuple[float, FloatArray]:
    """Return the distance to the nearest surface [m], infinite if far, and its normal (3,)."""
    best, normal = np.inf, np.array([0.0, 0.0, 1.0])
    geom = np.array([-1], np.int32)
    for direction in _AROUND:
        start, across = point - BACK * direction, np.zeros(3)
        depth = mujoco.mj_ray(
            scene.model, scene.data, start, direction, SHOWN_GROUPS, 1, -1, geom, across
        )
        error = (depth - BACK) * float(direction @ across)
        if depth >= 0.0 and abs(error) < abs(best):
            best, normal = error, across
    return best, normal
