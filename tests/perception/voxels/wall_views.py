"""A wall before a camera, as the sparse map sees it; several tests share it."""

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.pinhole import Frustum
from perception.stereo.geometry import StereoGeometry
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig

HEAD = StereoGeometry(170, 164, 225.8, 290.4, 84.5, 81.5, 0.038)
FRUSTUM = Frustum(*HEAD.intrinsics, 0.2, 2.0)
GRID = VoxelGrid(0.01, (-0.4, -0.4, -0.2), (0.4, 0.4, 0.8))
SIGMA = np.array([0.03, 0.03, 0.05])
WALL = 0.605  # The plane z = WALL faces a camera at the origin that looks along z.


def wall_scan(rng=None, pose=None):
    """Points (N, 3) of the wall, one a pixel, with the noise of stereo, and their covariances."""
    pose = RigidTransform.identity() if pose is None else pose
    u, v = np.meshgrid(np.arange(HEAD.width), np.arange(HEAD.height))
    rays = HEAD.points(np.stack([u.ravel(), v.ravel(), np.full(u.size, 10.0)], axis=1))
    world = pose.rotation.apply(rays)
    scale = (WALL - pose.translation[2]) / world[:, 2]
    local = rays * scale[:, None]
    if rng is not None:
        noise = SIGMA * rng.standard_normal(local.shape)
        local = HEAD.points(HEAD.project(local) + noise)
    turn = pose.rotation.as_matrix()
    return pose, pose.apply(local), turn @ HEAD.covariance(local, SIGMA) @ turn.T


def scanned(count=2, rng=None, **config):
    voxels = VoxelMap(GRID, VoxelMapConfig(**config))
    for _ in range(count):
        pose, points, covariances = wall_scan(rng)
        voxels.insert(pose, FRUSTUM, points, covariances)
    return voxels


def cone(depths):
    """Points (N, 3) well within the field of view at each of some depths."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.2, 0.2, 9))
    flat = np.stack([x.ravel(), y.ravel(), np.ones(81)], axis=1)
    return np.concatenate([depth * flat for depth in depths])
