"""The compiled inside of `marker_poses`: what poses would show less what was seen, and its fit."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from perception.geometry.se3 import exp_twist, log_twist

_ITERATIONS = 12


@numba.njit(cache=True)
def solve_pose(
    pose: Any,
    normal: Any,
    nudges: Any,
    steps: Any,
    points: Any,
    face: Any,
    radius: float,
    lens: Any,
    ellipses: Any,
    whiten: Any,
    back: Any,
    root: Any,
    count: int,
) -> float:
    """Bring a pose (4, 4) to the least squares by damped Gauss-Newton steps; return its cost.

    Pose and normal equations (6, 6) are overwritten. Cost and equations are those before the last
    step, which gains less than a millionth of the cost unless the steps have run out.
    """
    rows, ahead = np.empty((13, count)), np.empty((1, count))
    poses, trial = np.empty((13, 4, 4)), np.empty((1, 4, 4))
    step = np.empty(6)
    damping, cost = 1e-4, np.inf
    for _ in range(_ITERATIONS):
        for k in range(13):
            poses[k] = nudges[k] @ pose
        write_residuals(poses, points, face, radius, lens, ellipses, whiten, back, root, rows)
        slopes = np.empty((6, count))
        for k in range(6):
            slopes[k] = (rows[k + 1] - rows[k + 7]) / (2.0 * steps[k])
        cost = rows[0] @ rows[0]
        normal[:] = slopes @ slopes.T
        damped = normal.copy()
        for k in range(6):
            damped[k, k] += damping * normal[k, k] + 1e-9
        step[:] = np.linalg.solve(damped, slopes @ rows[0])
        longest = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        step *= -min(1.0, 0.5 / max(longest, 1e-12))
        trial[0] = exp_twist(step) @ pose
        write_residuals(trial, points, face, radius, lens, ellipses, whiten, back, root, ahead)
        there = ahead[0] @ ahead[0]
        if there <= cost:
            pose[:] = trial[0]
            damping *= 0.1
            if cost - there < 1e-6 * (1.0 + cost):
                break
        else:
            damping = max(damping, 1e-6) * 20.0
    return cost


@numba.njit(cache=True)
def write_residuals(
    poses: Any,
    points: Any,
    normal: Any,
    radius: float,
    lens: Any,
    ellipses: Any,
    whiten: Any,
    back: Any,
    root: Any,
    rows: Any,
) -> None:
    """Write whitened residuals (P, R) of poses (P, 4, 4), and those of the prior if there is room.

    The ellipses are those of `marker_ellipses.project_discs`; a disc that is not wholly ahead
    costs 1e6 in each number.
    """
    fx, fy, cx, cy, baseline = lens
    count = len(points)
    seen = np.empty(5)
    for p in range(len(poses)):
        turn, place = np.ascontiguousarray(poses[p, :3, :3]), poses[p, :3, 3]
        n = turn @ normal
        for k in range(count):
            centre = turn @ points[k] + place
            for eye in range(2):
                x, y, z = centre[0] - eye * baseline, centre[1], centre[2]
                square = radius * radius
                d00 = x * x - square * (1.0 - n[0] * n[0])
                d01 = x * y + square * n[0] * n[1]
                d02 = x * z + square * n[0] * n[2]
                d11 = y * y - square * (1.0 - n[1] * n[1])
                d12 = y * z + square * n[1] * n[2]
                d22 = z * z - square * (1.0 - n[2] * n[2])
                first = 5 * (eye * count + k)
                if not (d22 > 0.0 and z > 0.0):
                    rows[p, first : first + 5] = 1e6
                    continue
                u, v = d02 / d22, d12 / d22
                seen[0], seen[1] = fx * u + cx, fy * v + cy
                seen[2] = fx * fx * (u * u - d00 / d22)
                seen[3] = fx * fy * (u * v - d01 / d22)
                seen[4] = fy * fy * (v * v - d11 / d22)
                for i in range(5):
                    total = 0.0
                    for j in range(5):
                        total += whiten[eye, k, i, j] * (seen[j] - ellipses[eye, k, j])
                    rows[p, first + i] = total
        if rows.shape[1] > 10 * count:
            rows[p, 10 * count :] = root @ log_twist(np.ascontiguousarray(poses[p]) @ back)
