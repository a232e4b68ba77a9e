"""Exponential coordinates of rigid transforms, compiled, for loops that SciPy's objects slow down.

xi = (rotation, translation) is as in `scipy.spatial.transform.RigidTransform`: the transform is the
matrix exponential of xi's twist.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

_SMALL = 1e-4  # Angle below which series are used [rad].


@numba.njit(cache=True)
def exp_twist(xi: Any) -> Any:
    """Return (4, 4) of exponential coordinates (6,) [rad, m]."""
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
    """Return exponential coordinates (6,) [rad, m] of a rigid transform (4, 4)."""
    turn = _rotation_vector(pose)
    square = turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2
    angle = np.sqrt(square)
    if angle < _SMALL:
        factor = 1.0 / 12.0 + square / 720.0
    else:
        factor = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / square
    place = pose[:3, 3].copy()
    once = _cross(turn, place)
    result = np.empty(6)
    result[:3] = turn
    result[3:] = place - 0.5 * once + factor * _cross(turn, once)
    return result


@numba.njit(cache=True)
def _rotation_vector(pose: Any) -> Any:
    """Return the rotation vector (3,), up to half a turn, by the largest part of the quaternion."""
    r = pose
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    q = np.empty(4)  # w, x, y, z
    if trace > max(r[0, 0], r[1, 1], r[2, 2]):
        q[0] = 1.0 + trace
        q[1], q[2], q[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        i = 0
        for k in (1, 2):
            if r[k, k] > r[i, i]:
                i = k
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = r[k, j] - r[j, k]
        q[1 + i] = 1.0 + 2.0 * r[i, i] - trace
        q[1 + j], q[1 + k] = r[j, i] + r[i, j], r[k, i] + r[i, k]
    if q[0] < 0.0:
        q = -q
    sine = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    half = np.arctan2(sine, q[0])
    # At small angles the vector part is half the angle, over the quaternion's length.
    scale = 2.0 * half / sine if sine > 1e-12 * q[0] else 2.0 / q[0]
    return scale * q[1:]


@numba.njit(cache=True)
def _cross(a: Any, b: Any) -> Any:
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )
