"""A planar occupancy map on a dense grid, and the state of each cell.

Row r, column c is the square from ``cell * (c, r)`` to ``cell * (c + 1, r + 1)``; x grows with the
column, y with the row.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.voxels.occupancy import State, UpdateModel, probability

FREE_BELOW = 0.05
"""A robot may enter a cell whose probability of occupancy is lower (Thesis 3.2.4 (i))."""
SIZES = (2, 4000)
"""Fewest and most cells along a side."""


@dataclasses.dataclass(frozen=True)
class Grid:
    """Where the cells of a planar map lie.

    Attributes:
        rows: Number of cells along y.
        columns: Number of cells along x.
        cell: Side of a cell [m].
    """

    rows: int = 200
    columns: int = 200
    cell: float = 0.5

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        for name in ("rows", "columns"):
            count = getattr(self, name)
            if not SIZES[0] <= count <= SIZES[1]:
                raise ValueError(f"{name}: expected {SIZES[0]} to {SIZES[1]}, got {count}")
        if not (np.isfinite(self.cell) and self.cell > 0.0):
            raise ValueError(f"cell: expected a positive length [m], got {self.cell}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    def centre(self, cells: ArrayLike) -> FloatArray:
        """Return the centres (..., 2) of cells (..., 2), as (x, y) [m] of (row, column)."""
        return (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.cell

    def cell_at(self, points: ArrayLike) -> IntArray:
        """Return the cells (..., 2) (row, column) that hold points (..., 2) (x, y) [m].

        Raises:
            ValueError: If a point is not finite or lies outside.
        """
        points = np.asarray(points, dtype=float)
        if not np.all(np.isfinite(points)):
            raise ValueError("points: a coordinate is not finite")
        cells = np.floor(points[..., ::-1] / self.cell).astype(np.int64)
        if np.any(cells < 0) or np.any(cells >= self.shape):
            size = f"{self.columns * self.cell:g} x {self.rows * self.cell:g} m"
            raise ValueError(f"points: one lies outside the map of {size}")
        return cells


PLANAR_UPDATE = UpdateModel(hit=0.96, miss=0.04, lowest=0.01, highest=0.99)
"""One clear view makes a cell free enough to enter, P = 0.04 < 0.05; OctoMap's clamp at 0.12 would
never let a robot move."""


class PlanarMap:
    """Probability of occupancy of every cell, and which were ever measured.

    Attributes:
        grid: Cells of the map.
        log_odds: (rows, columns) log-odds of occupancy; 0 where never measured.
        measured: (rows, columns) whether a cell was ever measured.
    """

    def __init__(self, grid: Grid, model: UpdateModel = PLANAR_UPDATE) -> None:
        """Start with nothing known.

        Args:
            grid: Cells of the map.
            model: Update of a cell by one measurement.
        """
        self.grid = grid
        self.model = model
        self.log_odds: FloatArray = np.zeros(grid.shape)
        self.measured: BoolArray = np.zeros(grid.shape, dtype=bool)

    def insert(self, passed: BoolArray, hit: BoolArray) -> None:
        """Take one scan; each cell is updated once, and a return outweighs what passed by it.

        Args:
            passed: (rows, columns) cells that a beam went through.
            hit: (rows, columns) cells that a beam came back from.

        Raises:
            ValueError: If a shape is not the map's.
        """
        for name, cells in (("passed", passed), ("hit", hit)):
            if cells.shape != self.grid.shape:
                raise ValueError(f"{name}: expected shape {self.grid.shape}, got {cells.shape}")
        more, less = self.model.steps
        self.log_odds[hit] += more
        self.log_odds[passed & ~hit] += less
        seen = passed | hit
        np.clip(self.log_odds, *self.model.clamps, out=self.log_odds, where=seen)
        self.measured |= seen

    def probability(self) -> FloatArray:
        """Return the probability of occupancy (rows, columns); 0.5 where never measured."""
        return probability(self.log_odds)

    def states(self) -> NDArray[np.int8]:
        """Return the `State` of every cell (rows, columns)."""
        occupied = self.probability() >= self.model.occupied_above
        known = np.where(occupied, State.OCCUPIED, State.FREE)
        return np.where(self.measured, known, State.UNKNOWN).astype(np.int8)

    def enterable(self) -> BoolArray:
        """Return the cells (rows, columns) that a robot may enter: measured, P < 0.05."""
        return self.measured & (self.probability() < FREE_BELOW)
