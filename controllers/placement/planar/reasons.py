"""Why no camera pose on the plane sees a target, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.placement.planar.field import NOTHING, blocked_interval
from controllers.placement.planar.hulls import Hulls
from controllers.placement.planar.kernels import UNKNOWN
from controllers.placement.task import FREE_BELOW, FloatArray, Target

STRAIGHT = 1e-12
"""A camera whose cosine to the normal is no more sees the target edge on."""


def why_unseen(
    target: Target,
    hulls: Hulls,
    around: int,
    rings: FloatArray,
    directions: int,
    probability: FloatArray,
    cell: float,
    origin: tuple[float, float],
) -> str:
    """Return why no candidate sees a target; each counts under its first reason.

    Args:
        target: The target.
        hulls: The occluders, expanded by it.
        around: Which of them contains it, or -1.
        rings: (R,) distances of the candidates [m].
        directions: Number of their directions, evenly from the target's normal on.
        probability: (rows, columns) P of the cells.
        cell: Their side [m].
        origin: Corner of the first [m].
    """
    start = f"no pose sees the target {target.name!r}: "
    if around >= 0:
        return start + f"occluder {hulls.names[around]!r}, expanded by the target, covers it"
    turn = 2.0 * np.pi * np.arange(directions) / directions
    averted = np.cos(turn) <= STRAIGHT
    angles = turn + np.arctan2(target.normal[1], target.normal[0])
    counts, by = np.zeros(3, dtype=int), np.zeros(len(hulls.names), dtype=int)
    for radius in rings:
        blocked = _blocked(hulls, float(radius), angles) & ~averted
        places = target.position + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        taken = _probability(probability, cell, origin, places) >= FREE_BELOW
        hidden = blocked.any(axis=0)
        counts += [averted.sum(), hidden.sum(), np.sum(taken & ~hidden & ~averted)]
        by += blocked.sum(axis=1)
    total = len(rings) * directions
    behind, hid, unfree = (f"{100.0 * count / total:.3g} %" for count in counts)
    most = f" (most by occluder {hulls.names[int(np.argmax(by))]!r})" if by.sum() > 0 else ""
    return start + (
        f"of {total} poses {behind} are behind it, {hid} hidden{most}, {unfree} not known to be "
        "free"
    )


def _blocked(hulls: Hulls, radius: float, angles: FloatArray) -> NDArray[np.bool_]:
    """Return which hulls hide the target in which directions (H, N)."""
    blocked = np.zeros((len(hulls.names), len(angles)), dtype=bool)
    for index in range(len(hulls.names)):
        first, last = hulls.starts[index], hulls.starts[index + 1]
        what, low, high = blocked_interval(hulls.points, first, last, radius)
        if what != NOTHING:
            blocked[index] = (angles - low) % (2.0 * np.pi) <= high - low
    return blocked


def _probability(
    probability: FloatArray, cell: float, origin: tuple[float, float], places: FloatArray
) -> FloatArray:
    """Return P at places (N, 2); `UNKNOWN` outside the map."""
    columns, rows = np.floor((places - origin) / cell).astype(int).T
    within = (rows >= 0) & (columns >= 0)
    within &= (rows < probability.shape[0]) & (columns < probability.shape[1])
    values = np.full(len(places), UNKNOWN)
    values[within] = probability[rows[within], columns[within]]
    return values
