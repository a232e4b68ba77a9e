"""Rigid motions, SE(3): exponential and logarithm, adjoint, and how covariances travel with poses.

xi = (rotation, translation) [rad, m] are the exponential coordinates of
`scipy.spatial.transform.RigidTransform`: the transform is the matrix exponential of xi's twist. The
covariance of a transform is that of xi in ``true = RigidTransform.from_exp_coords(xi) * estimate``:
in the frame that it transforms into (Thesis eq. 3-9, 3-20).

`exp_twist`, `log_twist` and `write_near_log` are compiled, for loops that SciPy's objects slow
down.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray

_SMALL = 1e-4  # Angle below which series are used [rad].


def cross_matrix(vectors: ArrayLike) -> FloatArray:
    """Return the matrices (..., 3, 3) [v]x of vectors (..., 3), with [v]x w = v x w."""
    v = np.asarray(vectors, dtype=float)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    cross = np.zeros((*v.shape, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross[..., 1, 0], cross[..., 2, 0], cross[..., 2, 1] = z, -y, x
    return cross


def adjoint(transform: RigidTransform) -> FloatArray:
    """Return the matrix (6, 6) that brings xi from before a transform to after it."""
    rotation, shift = transform.rotation.as_matrix(), transform.translation
    return np.block([[rotation, np.zeros((3, 3))], [cross_matrix(shift) @ rotation, rotation]])


def transport_covariance(transform: RigidTransform, covariance: ArrayLike) -> FloatArray:
    """Return the covariance (6, 6) of xi in another frame.

    Args:
        transform: Known transform from the covariance's frame to the other frame.
        covariance: (6, 6) covariance of xi [rad, m] before the transform.
    """
    carried = adjoint(transform)
    return carried @ np.asarray(covariance, dtype=float) @ carried.T


def composed_covariance(
    first: RigidTransform, first_covariance: ArrayLike, second_covariance: ArrayLike
) -> FloatArray:
    """Return the covariance (6, 6) of ``first * second``, both uncertain and independent.

    Args:
        first: Transform applied last.
        first_covariance: (6, 6) covariance of `first` [rad, m].
        second_covariance: (6, 6) covariance of the transform applied first [rad, m].
    """
    return np.asarray(first_covariance) + transport_covariance(first, second_covariance)


def inverse_covariance(transform: RigidTransform, covariance: ArrayLike) -> FloatArray:
    """Return the covariance (6, 6) of the inverse of an uncertain transform.

    Args:
        transform: Uncertain transform.
        covariance: (6, 6) covariance of `transform` [rad, m].
    """
    return transport_covariance(transform.inv(), covariance)


def point_jacobian(points: ArrayLike) -> FloatArray:
    """Return the derivatives (..., 3, 6) of points (..., 3) [m] by xi of their pose."""
    p = np.asarray(points, dtype=float)
    motion = np.zeros((*p.shape, 6))
    motion[..., :3] = -cross_matrix(p)
    motion[..., 3:] = np.eye(3)
    return motion


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
        transform: Transform from the points' frame to another.
        transform_covariance: (6, 6) covariance of `transform` [rad, m]; zeros if it is known.
        points: (N, 3) points [m] before the transform.
        covariances: (N, 3, 3) covariances of the points [m^2] before the transform.

    Returns:
        Points (N, 3) [m] and covariances (N, 3, 3) [m^2] after the transform.
    """
    rotation = transform.rotation.as_matrix()
    moved = np.asarray(points, dtype=float) @ rotation.T + transform.translation
    by_pose = point_jacobian(moved)
    own = rotation @ np.asarray(covariances, dtype=float) @ rotation.T
    pose = by_pose @ np.asarray(transform_covariance, dtype=float) @ np.swapaxes(by_pose, -1, -2)
    return moved, own + pose


@numba.njit(cache=True)
def exp_twist(xi: Any) -> Any:
    """Return the transform (4, 4) of exponential coordinates (6,) [rad, m]."""
    x, y, z = xi[0], xi[1], xi[2]
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    if angle < _SMALL:
        a, b, c = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / square
        c = (1.0 - a) / square
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    twice = cross @ cross
    result = np.eye(4)
    result[:3, :3] += a * cross + b * twice
    result[:3, 3] = xi[3:] + b * (cross @ xi[3:]) + c * (twice @ xi[3:])
    return result


@numba.njit(cache=True)
def log_twist(pose: Any) -> Any:
    """Return the exponential coordinates (6,) [rad, m] of a rigid transform (4, 4).

    The rotation vector, up to half a turn, comes from the largest part of the quaternion.
    """
    r, out = pose, np.empty(6)
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    if trace > max(r[0, 0], r[1, 1], r[2, 2]):
        real = 1.0 + trace
        out[0], out[1], out[2] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        i = 0
        for k in (1, 2):
            if r[k, k] > r[i, i]:
                i = k
        j, k = (i + 1) % 3, (i + 2) % 3
        real = r[k, j] - r[j, k]
        out[i] = 1.0 + 2.0 * r[i, i] - trace
        out[j], out[k] = r[j, i] + r[i, j], r[k, i] + r[i, k]
    if real < 0.0:
        real, out = -real, -out
    sine = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    half = np.arctan2(sine, real)
    # At small angles the vector part is half the angle, over the quaternion's length.
    scale = 2.0 * half / sine if sine > 1e-12 * real else 2.0 / real
    x, y, z = scale * out[0], scale * out[1], scale * out[2]
    square = x**2 + y**2 + z**2
    angle = np.sqrt(square)
    if angle < _SMALL:
        factor = 1.0 / 12.0 + square / 720.0
    else:
        factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    _write_coordinates(x, y, z, pose[:3, 3], factor, out)
    return out


@numba.njit(cache=True)
def write_near_log(pose: Any, out: Any) -> None:
    """Write exponential coordinates from the antisymmetric part of a rotation; allocates nothing.

    Quicker than `log_twist`, but rough near half a turn, and to 1e-7 of the translation about
    1e-4 rad.

    Args:
        pose: (12,) translation [m], and the rotation matrix row by row.
        out: (6,) exponential coordinates [rad, m], overwritten.
    """
    sine = 0.0
    for d in range(3):
        i, j = (d + 1) % 3, (d + 2) % 3
        out[d] = 0.5 * pose[3 + 3 * j + i]
        out[d] -= 0.5 * pose[3 + 3 * i + j]
        sine += out[d] * out[d]
    sine = np.sqrt(sine)
    cosine = 0.5 * (pose[3] + pose[7] + pose[11] - 1.0)
    angle = np.arctan2(sine, cosine)
    stretch = angle / sine if sine > 1e-9 else 1.0
    factor = 1.0 / 12.0
    if angle > _SMALL:
        factor = (1.0 - 0.5 * angle * sine / (1.0 - cosine)) / (angle * angle)
    x, y, z = stretch * out[0], stretch * out[1], stretch * out[2]
    _write_coordinates(x, y, z, pose, factor, out)


@numba.njit(cache=True)
def _write_coordinates(
    x: float, y: float, z: float, translation: Any, factor: float, out: Any
) -> None:
    """Write exponential coordinates (6,), given the rotation vector x, y, z."""
    p, q, r = translation[0], translation[1], translation[2]
    a, b, c = y * r - z * q, z * p - x * r, x * q - y * p
    out[0], out[1], out[2] = x, y, z
    out[3] = p - 0.5 * a + factor * (y * c - z * b)
    out[4] = q - 0.5 * b + factor * (z * a - x * c)
    out[5] = r - 0.5 * c + factor * (x * b - y * a)
