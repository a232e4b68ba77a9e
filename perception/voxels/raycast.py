"""Rays through a grid of voxels, marked cell by cell.

The walk is that of Amanatides and Woo in the arithmetic that OctoMap uses (32-bit points, 64-bit
steps), so that both visit the same cells: "A Fast Voxel Traversal Algorithm for Ray Tracing", 1987.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

KERNEL: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
"""Options of kernels that make no arrays. Without numba's runtime they count no references: handing
a tuple of arrays from one to another would else cost a third of their time. Such a tuple is handed
over word by word, some hundred of them: what is called for each brick, group or part is inlined."""
PASSED, HIT = 1, 2
"""Marks of a cell in one scan: a ray went through it; a ray ended in it, which outweighs."""
MARGIN = 2
"""Cells about a scan's marks: rounding may carry a ray one cell past its end."""


@numba.njit(**KERNEL, inline="always")
def whole(value: float) -> int:
    """Return the floor; `math.floor` is a call, which costs more than all around it."""
    nearer_zero = int(value)
    return nearer_zero - 1 if value < nearer_zero else nearer_zero


@numba.njit(cache=True)
def mark_rays(
    marks: NDArray[np.uint8],
    first: NDArray[np.int64],
    resolution: float,
    origin: NDArray[np.float32],
    ends: NDArray[np.float32],
    length: NDArray[np.float32],
    hit: NDArray[np.bool_],
) -> None:
    """Mark what each ray goes through, from the origin's cell to the one before its end's.

    Args:
        marks: (nx, ny, nz) to mark, zero before; must hold all rays and MARGIN more.
        first: (3,) key of the cell [0, 0, 0]; a cell's key is floor(coordinate / resolution).
        resolution: Side of a cell [m].
        origin: (3,) where rays start [m].
        ends: (N, 3) where they end [m].
        length: (N,) distance of ends from the origin [m].
        hit: (N,) whether the end is something that was met.
    """
    flat = marks.reshape(-1)
    strides = (marks.shape[1] * marks.shape[2], marks.shape[2], 1)
    factor = 1.0 / resolution
    key = np.empty(3, np.int64)
    start = 0
    for axis in range(3):
        key[axis] = math.floor(factor * origin[axis])
        start += (key[axis] - first[axis]) * strides[axis]
    step = np.empty(3, np.int64)
    t = np.empty(3)
    dt = np.empty(3)
    for ray in range(ends.shape[0]):
        goal = 0
        for axis in range(3):
            goal += (math.floor(factor * ends[ray, axis]) - first[axis]) * strides[axis]
        if goal != start:
            far = length[ray]
            for axis in range(3):
                direction = np.float32((ends[ray, axis] - origin[axis]) / far)
                sign = 1 if direction > 0.0 else (-1 if direction < 0.0 else 0)
                step[axis] = sign * strides[axis]
                if sign == 0:
                    t[axis] = math.inf
                    dt[axis] = math.inf
                else:
                    border = (key[axis] + 0.5) * resolution
                    border += np.float32(sign * resolution * 0.5)
                    t[axis] = (border - origin[axis]) / direction
                    dt[axis] = resolution / abs(direction)
            _walk(flat, start, goal, step, t, dt, float(far))
        if hit[ray]:
            flat[goal] = HIT


@numba.njit(cache=True, inline="always")
def _walk(
    flat: NDArray[np.uint8],
    start: int,
    goal: int,
    step: NDArray[np.int64],
    t: NDArray[np.float64],
    dt: NDArray[np.float64],
    far: float,
) -> None:
    """Walk to the goal, or until the ray's length is used up; a hit's mark is never lowered."""
    tx, ty, tz = t
    dx, dy, dz = dt
    sx, sy, sz = step
    cell = start
    flat[cell] |= PASSED
    while True:
        x_first = tx < ty
        nearest = tx if x_first else ty
        z_first = not nearest < tz
        y_first = not (x_first or z_first)
        x_first = x_first and not z_first
        cell += sx if x_first else (sz if z_first else sy)
        tx = tx + dx if x_first else tx
        ty = ty + dy if y_first else ty
        tz = tz + dz if z_first else tz
        if cell == goal or min(tx, ty, tz) > far:
            break
        flat[cell] |= PASSED


@numba.njit(cache=True)
def apply_marks(
    log_odds: NDArray[np.float32],
    marks: NDArray[np.uint8],
    offset: NDArray[np.int64],
    miss: float,
    hit: float,
    lowest: float,
    highest: float,
) -> None:
    """Add a scan to a grid's log-odds (NaN: never measured) where both overlap, with clamping.

    Args:
        log_odds: (nx, ny, nz), changed.
        marks: (mx, my, mz) of the scan.
        offset: (3,) cell of the grid at marks[0, 0, 0]; may lie outside.
        miss: What a passed cell receives.
        hit: What a hit cell receives.
        lowest: Clamp.
        highest: Clamp.
    """
    low = np.maximum(offset, 0)
    high = np.minimum(offset + np.array(marks.shape), np.array(log_odds.shape))
    for x in range(low[0], high[0]):
        for y in range(low[1], high[1]):
            row = marks[x - offset[0], y - offset[1]]
            for z in range(low[2], high[2]):
                mark = row[z - offset[2]]
                if mark != 0:
                    change = np.float32(hit) if mark >= HIT else np.float32(miss)
                    old = log_odds[x, y, z]
                    new = (old if old == old else np.float32(0.0)) + change
                    log_odds[x, y, z] = min(max(new, np.float32(lowest)), np.float32(highest))
