"""What four wheels on the ground can hold: their normal forces and the friction in use.

The derivation stands in `friction`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def normal_forces(force: FloatArray, moment: FloatArray, wheels: FloatArray) -> FloatArray:
    """Return (n, 4) normal forces of the wheels [N]; a wheel that would have to pull gives none.

    Args:
        force: (n, 3) by the ground on the rover, body frame [N].
        moment: (n, 3) of it about the centre of gravity [N m].
        wheels: (4, 3) contacts, front left, front right, rear left, rear right [m].
    """
    half_track, height = float(wheels[1, 0]), -float(wheels[0, 2])
    front, rear = float(wheels[0, 1]), float(wheels[2, 1])
    ahead = moment[:, 0] - height * force[:, 1]
    front_share = (ahead - rear * force[:, 2]) / (front - rear)
    rear_share = force[:, 2] - front_share
    across = (-moment[:, 1] - height * force[:, 0]) / half_track
    shares = (front_share - across, front_share + across, rear_share, rear_share)
    return np.maximum(np.stack(shares, axis=1) / 2.0, 0.0)


def friction_in_use(
    force: FloatArray, moment: FloatArray, normals: FloatArray, wheels: FloatArray, rounds: int = 60
) -> FloatArray:
    """Return (n,) the smallest friction coefficient with which wheels can hold a load.

    The motion that dissipates least for one unit of the load's power is found by iteratively
    reweighted least squares (Weiszfeld's method for sums of lengths).

    Args:
        force: (n, 2) horizontal [N].
        moment: (n,) about the vertical through the origin of `wheels` [N m].
        normals: (n, 4) normal forces [N].
        wheels: (4, 2) contacts [m].
        rounds: Iterations.
    """
    load = np.concatenate([force, moment[:, None]], axis=1)
    # velocity of contact i = rows[i] @ (vx, vy, w)
    rows = np.zeros((len(wheels), 2, 3))
    rows[:, 0, 0] = rows[:, 1, 1] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -wheels[:, 1], wheels[:, 0]
    squares = np.einsum("wij,wik->wjk", rows, rows)
    speeds = np.ones_like(normals)
    dissipated: FloatArray = np.full(len(load), np.inf)
    floor = 1e-9 * np.eye(3)
    for _ in range(rounds):
        weights = np.einsum("nw,wjk->njk", (normals + 1e-6) / speeds, squares) + floor
        motion = np.linalg.solve(weights, load[..., None])[..., 0]
        power = np.sum(motion * load, axis=1)
        motion /= np.maximum(power, 1e-12)[:, None]
        lengths = np.linalg.norm(np.einsum("wij,nj->nwi", rows, motion), axis=2)
        dissipated = np.minimum(dissipated, np.sum(normals * lengths, axis=1))
        speeds = np.maximum(lengths, 1e-6 * np.max(lengths, axis=1, keepdims=True) + 1e-12)
    loaded = np.linalg.norm(load, axis=1) > 1e-9
    return np.where(loaded, 1.0 / np.maximum(dissipated, 1e-9), 0.0)
