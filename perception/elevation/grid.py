"""Cells of a level grid: row r, column c is the square from ``corner + cell * (c, r)`` on."""

import dataclasses
import functools

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.voxels.grid import MapError

MOST_CELLS = 4000
"""Most cells along a side."""


@dataclasses.dataclass(frozen=True)
class ElevationGrid:
    """Where the cells of an elevation map lie; x grows with the column, y with the row.

    Attributes:
        corner: (2,) x and y of the corner of the first cell, the lowest of all cells [m].
        shape: Number of rows along y and of columns along x.
        cell: Side of a cell [m].
    """

    corner: tuple[float, float]
    shape: tuple[int, int]
    cell: float = 0.05

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            MapError: Naming what is impossible.
        """
        if not all(1 <= count <= MOST_CELLS for count in self.shape):
            raise MapError(f"{self}: expected 1 to {MOST_CELLS} rows and columns")
        if not (np.isfinite([self.cell, *self.corner]).all() and self.cell > 0.0):
            raise MapError(f"{self}: expected a positive cell and a finite corner")

    @property
    def size(self) -> int:
        """Number of cells."""
        return self.shape[0] * self.shape[1]

    @property
    def centres(self) -> FloatArray:
        """Centres (rows, columns, 2) of all cells [m], read-only."""
        return _centres(self)

    def centres_of(self, cells: ArrayLike) -> FloatArray:
        """Return the centres (..., 2), x and y [m], of cells (..., 2), row and column."""
        return (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.cell + self.corner

    def cells_of(self, points: ArrayLike) -> IntArray:
        """Return the cells (..., 2), row and column, that hold points (..., 2), x and y [m].

        Beyond the grid the count goes on, below zero too: see `inside`.

        Raises:
            MapError: If a coordinate is not finite.
        """
        places = np.asarray(points, dtype=float)
        if not np.isfinite(places).all():
            raise MapError("points: a coordinate is not finite")
        scaled = (places[..., ::-1] - self.corner[::-1]) / self.cell
        return np.floor(scaled).astype(np.int64)

    def inside(self, cells: ArrayLike) -> BoolArray:
        """Return (...,), whether cells (..., 2), row and column, are of the grid."""
        index = np.asarray(cells)
        return np.all((index >= 0) & (index < np.array(self.shape)), axis=-1)

    def box_about(self, place: FloatArray, radius: float) -> tuple[tuple[slice, slice], FloatArray]:
        """Return the box of cells that holds a disc, and their distances from its middle [m].

        Args:
            place: (2,) middle of the disc [m].
            radius: Radius of the disc [m].
        """
        corners = self.cells_of([place - radius, place + radius]) + [[0], [1]]
        (top, left), (bottom, right) = np.clip(corners, 0, self.shape).tolist()
        cells = np.moveaxis(np.mgrid[top:bottom, left:right], 0, -1)
        apart = np.hypot(*np.moveaxis(self.centres_of(cells) - place, -1, 0))
        return (slice(top, bottom), slice(left, right)), apart


@functools.lru_cache(maxsize=8)  # A mission asks for those of two grids at each look.
def _centres(grid: ElevationGrid) -> FloatArray:
    """Return the centres (rows, columns, 2) of all cells of a grid [m]."""
    rows, columns = np.indices(grid.shape, dtype=float)
    centres = grid.centres_of(np.stack([rows, columns], axis=-1))
    centres.flags.writeable = False
    return centres
