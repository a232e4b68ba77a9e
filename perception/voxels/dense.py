"""A dense occupancy grid with the rays of OctoMap: same clouds in, same cells occupied and free."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.voxels.grid import MapError, VoxelGrid, checked_points
from perception.voxels.occupancy import State, UpdateModel, log_odds, probability
from perception.voxels.raycast import MARGIN, apply_marks, mark_rays

FloatArray = NDArray[np.float64]

MOST_CELLS = 2**29
"""Of a grid, or of a scan's box: 2 GB of log-odds, 0.5 GB of marks."""


class DenseVoxelMap:
    """Log-odds of every voxel of a box, updated ray by ray.

    In a scan each voxel is updated once: by a hit if a ray ended in it, else by a miss if one
    passed through. Rays may start and end outside of the box; what lies outside is not kept.

    Attributes:
        grid: The box.
        model: What hits and misses say.
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

    def states(self, points: ArrayLike) -> NDArray[np.int8]:
        """Return the state of the voxel about each point.

        Args:
            points: (N, 3) [m], world; those outside of the box are UNKNOWN.

        Returns:
            (N,) of `State`.
        """
        cells, inside = self.grid.cells(checked_points(points))
        return np.where(inside, self.cell_states()[tuple(cells.T)], State.UNKNOWN).astype(np.int8)

    def probabilities(self, points: ArrayLike) -> FloatArray:
        """Return (N,) probabilities of occupancy at (N, 3) points; NaN where never measured."""
        cells, inside = self.grid.cells(checked_points(points))
        return np.where(inside, probability(self.log_odds[tuple(cells.T)]), np.nan)

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
