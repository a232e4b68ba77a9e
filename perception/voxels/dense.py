"""A dense occupancy grid with the rays of OctoMap: same clouds in, same cells occupied and free.

Rays are walked as by Amanatides and Woo ("A Fast Voxel Traversal Algorithm for Ray Tracing", 1987)
in the arithmetic that OctoMap uses (32-bit points, 64-bit steps), so that both visit the same
cells.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import math

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import FloatArray
from perception.voxels.grid import MapError, VoxelGrid, checked_points
from perception.voxels.occupancy import State, UpdateModel, log_odds

MOST_CELLS = 2**29
"""Of a grid, or of a scan's box: 2 GB of log-odds, 0.5 GB of marks."""


class DenseVoxelMap:
    """Log-odds of every voxel of a box, updated ray by ray.

    In a scan each voxel is updated once: by a hit if a ray ended in it, else by a miss if one
    passed through. Rays may start and end outside of the box; what lies outside is not kept.

    Attributes:
        grid: The box.
        model: Update of a voxel by hits and misses.
        log_odds: (nx, ny, nz) float32; NaN where nothing was measured.
    """

    def __init__(self, grid: VoxelGrid, model: UpdateModel | None = None) -> None:
        """Start with a map of which nothing is known.

        Raises:
            MapError: If the box has too many voxels.
        """
        if np.prod(grid.shape, dtype=float) > MOST_CELLS:
            raise MapError(f"{grid}: {grid.shape} voxels, at most {MOST_CELLS} can be dense")
        self.grid = grid
        self.model = UpdateModel() if model is None else model
        self.log_odds = np.full(grid.shape, np.nan, dtype=np.float32)
        self._marks = np.zeros(0, dtype=np.uint8)

    def insert(self, origin: ArrayLike, points: ArrayLike, max_range: float = -1.0) -> None:
        """Add a scan.

        Args:
            origin: (3,) where the rays start [m], world.
            points: (N, 3) where they end [m], world. May be empty: nothing was seen.
            max_range: Longer rays are free up to here and end in nothing [m]; negative: no limit.

        Raises:
            MapError: If a number is not finite or the scan is too large; the map is unchanged.
        """
        start = checked_points(np.reshape(origin, (1, -1)), "origin")[0].astype(np.float32)
        ends = checked_points(points).astype(np.float32)
        if not np.isfinite(max_range):
            raise MapError(f"max_range: {max_range}")
        if len(ends) == 0:
            return
        offset = ends - start
        length = _norm(offset)
        hit = (length <= max_range) if max_range >= 0.0 else np.ones(len(ends), dtype=bool)
        direction = offset[~hit] / length[~hit, None].astype(np.float32)
        ends[~hit] = start + direction * np.float32(max_range)
        length = _norm(ends - start).astype(np.float32)
        marks, first = self._cleared_marks(start, ends)
        mark_rays(marks, first, self.grid.resolution, start, ends, length, hit)
        (hit_step, miss_step), (low, high) = self.model.steps, self.model.clamps
        apply_marks(self.log_odds, marks, first - self.grid.first, miss_step, hit_step, low, high)

    def _cleared_marks(
        self, start: NDArray[np.float32], ends: NDArray[np.float32]
    ) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
        """Return marks for the box of a scan, all zero, and the key of its first cell."""
        factor = 1.0 / self.grid.resolution
        low = np.floor(np.minimum(start, ends.min(axis=0)) * factor).astype(np.int64) - MARGIN
        high = np.floor(np.maximum(start, ends.max(axis=0)) * factor).astype(np.int64) + MARGIN + 1
        shape = high - low
        if np.prod(shape, dtype=float) > MOST_CELLS:
            raise MapError(f"scan: spans {shape.tolist()} voxels, expected at most {MOST_CELLS}")
        size = int(np.prod(shape))
        if self._marks.size < size:
            self._marks = np.empty(size, dtype=np.uint8)
        marks = self._marks[:size]
        marks.fill(0)
        return marks.reshape(shape), low

    def cell_states(self) -> NDArray[np.int8]:
        """Return (nx, ny, nz) states of all voxels."""
        known = ~np.isnan(self.log_odds)
        occupied = self.log_odds >= np.float32(log_odds(self.model.occupied_above))
        return (known.astype(np.int8) * State.FREE + occupied).astype(np.int8)

    def counts(self) -> dict[State, int]:
        """Return how many voxels are in each state."""
        found = np.bincount(self.cell_states().ravel(), minlength=len(State))
        return {state: int(found[state]) for state in State}


def _norm(vectors: NDArray[np.float32]) -> FloatArray:
    """Return lengths: a sum of squares in 32 bits, and its root in 64."""
    x, y, z = vectors.T
    return np.sqrt((x * x + y * y + z * z).astype(float))


PASSED, HIT = 1, 2
"""Marks of a cell in one scan: a ray went through it; a ray ended in it, which outweighs."""
MARGIN = 2
"""Cells about a scan's marks: rounding may carry a ray one cell past its end."""


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
        marks: (mx, my, mz) marks of the scan.
        offset: (3,) cell of the grid at marks[0, 0, 0]; may lie outside.
        miss: Log-odds added to a passed cell.
        hit: Log-odds added to a hit cell.
        lowest: Lower clamp of the log-odds.
        highest: Upper clamp of the log-odds.
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
