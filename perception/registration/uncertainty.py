"""How the uncertainty of a pose enters that of points and of other poses (Thesis eq. 3-9, 3-20).

The covariance of a transform is that of xi = (rotation vector, translation) [rad, m] in
``true = RigidTransform.from_exp_coords(xi) * estimate``: in the frame that it transforms into.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.stereo.geometry import StereoGeometry

FloatArray = NDArray[np.float64]


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """Return (..., 3, 3) matrices [v]x with [v]x w = v x w."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    cross = np.zeros((*vectors.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    return cross


def point_motion(points: FloatArray) -> FloatArray:
    """Return (..., 3, 6), how points (..., 3) move with xi of the pose that placed them."""
    motion = np.zeros((*points.shape, 6))
    motion[..., :3] = -cross_matrix(points)
    motion[..., 3:] = np.eye(3)
    return motion


def adjoint(transform: RigidTransform) -> FloatArray:
    """Return (6, 6), by which xi before the transform is one after it."""
    rotation, shift = transform.rotation.as_matrix(), transform.translation
    return np.block([[rotation, np.zeros((3, 3))], [cross_matrix(shift) @ rotation, rotation]])


def composed_covariance(
    first: RigidTransform, first_covariance: ArrayLike, second_covariance: ArrayLike
) -> FloatArray:
    """Return the (6, 6) covariance of ``first * second``, both uncertain and independent.

    Args:
        first: The transform applied last.
        first_covariance: (6, 6) of it.
        second_covariance: (6, 6) of the one applied first.
    """
    carried = adjoint(first)
    return np.asarray(first_covariance) + carried @ np.asarray(second_covariance) @ carried.T


def inverse_covariance(transform: RigidTransform, covariance: ArrayLike) -> FloatArray:
    """Return the (6, 6) covariance of the inverse of an uncertain transform."""
    carried = adjoint(transform.inv())
    return carried @ np.asarray(covariance) @ carried.T


def transform_points_with_covariance(
    transform: RigidTransform,
    transform_covariance: ArrayLike,
    points: ArrayLike,
    covariances: ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Return points and covariances where an uncertain pose puts them (eq. 3-9 and 3-20).

    The pose's error is common to all the points: the covariances are each point's own, and say
    nothing of how points are correlated.

    Args:
        transform: From the points' frame to another.
        transform_covariance: (6, 6) of it; zeros if it is known.
        points: (N, 3) [m].
        covariances: (N, 3, 3) [m^2].

    Returns:
        (N, 3) [m] and (N, 3, 3) [m^2], in the other frame.
    """
    rotation = transform.rotation.as_matrix()
    moved = np.asarray(points, dtype=float) @ rotation.T + transform.translation
    by_pose = point_motion(moved)
    spread = rotation @ np.asarray(covariances, dtype=float) @ rotation.T
    pose = by_pose @ np.asarray(transform_covariance, dtype=float) @ np.swapaxes(by_pose, -1, -2)
    return moved, spread + pose


def update_points_by_view(
    points: ArrayLike,
    covariances: ArrayLike,
    image_points: ArrayLike,
    sigma: ArrayLike,
    geometry: StereoGeometry,
    transform_camera_to_world: RigidTransform,
    transform_covariance: ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Take a view of known points in, by the extended Kalman filter of eq. 3-20.

    R_k holds the image noise and what the uncertain pose adds to it. The pose's error is taken to
    be new in each view: where it is not, use `registration_map.FiducialMap`, which keeps track.

    Args:
        points: (N, 3) [m], world: x_k.
        covariances: (N, 3, 3) [m^2]: P_k.
        image_points: (N, 3) columns, rows, disparities [px]: z_k.
        sigma: Their standard deviations [px], (3,) or (N, 3).
        geometry: Of the cameras.
        transform_camera_to_world: Where the left camera is.
        transform_covariance: (6, 6) of it.

    Returns:
        Points (N, 3) [m] and covariances (N, 3, 3) [m^2] after the update.
    """
    state, before = np.asarray(points, dtype=float), np.asarray(covariances, dtype=float)
    rotation = transform_camera_to_world.rotation.as_matrix()
    seen = (state - transform_camera_to_world.translation) @ rotation
    by_point = geometry.projection_jacobian(seen) @ rotation.T
    by_pose = -by_point @ point_motion(state)
    noise = np.eye(3) * (np.asarray(sigma, dtype=float) ** 2)[..., None, :]
    noise = noise + by_pose @ np.asarray(transform_covariance) @ np.swapaxes(by_pose, -1, -2)
    crossed = by_point @ before
    gain = np.swapaxes(
        np.linalg.solve(crossed @ np.swapaxes(by_point, -1, -2) + noise, crossed), -1, -2
    )
    error = np.asarray(image_points, dtype=float) - geometry.project(seen)
    after = before - gain @ crossed
    return state + (gain @ error[..., None])[..., 0], 0.5 * (after + np.swapaxes(after, -1, -2))
