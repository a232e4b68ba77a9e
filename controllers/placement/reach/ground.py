"""Where a rover may drive, from a voxel map: free ground, and shortest paths on it."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike, NDArray

from controllers.mapping.planar_paths import Paths, shortest_paths
from controllers.placement.task import FREE_BELOW
from perception.voxels.bricks import NEVER
from perception.voxels.map import MapWindow

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class Ground:
    """What stands on level ground.

    Attributes:
        probability: (rows, columns) that something is in the way; NaN where not known. Row along y.
        corner: (2,) x, y of the outer corner of cell (0, 0) [m], world.
        cell: Side of a cell [m].
    """

    probability: FloatArray
    corner: FloatArray
    cell: float

    def cells(self, points: ArrayLike) -> tuple[IntArray, BoolArray]:
        """Return (N, 2) row and column of points (N, 2) [m], and (N,) whether they are inside."""
        index = np.floor((np.asarray(points, dtype=float) - self.corner) / self.cell)[..., ::-1]
        inside = np.all((index >= 0) & (index < self.probability.shape), axis=-1)
        return np.where(inside[..., None], index, 0.0).astype(np.int64), inside

    def centres(self, cells: ArrayLike) -> FloatArray:
        """Return (N, 2) x, y of the middles of cells (N, 2) [m]."""
        return (np.asarray(cells, dtype=float)[..., ::-1] + 0.5) * self.cell + self.corner

    def gaps(self, lengths: FloatArray) -> FloatArray:
        """Return (rows, columns) how far cells are from where a length is finite, at most less [m].

        Points may be anywhere in their cells.
        """
        apart = np.asarray(scipy.ndimage.distance_transform_edt(~np.isfinite(lengths)))
        return np.maximum(apart - 2.0**0.5, 0.0) * self.cell


def ground_of(window: MapWindow) -> Ground:
    """Return the ground below a window of voxels.

    Args:
        window: From above what the wheels climb to above the highest part of a driving rover. A
            cell is as occupied as its most occupied voxel, and unknown if one of them is.
    """
    highest, lowest = window.values.max(axis=2), window.values.min(axis=2)
    chance = window.table[highest.astype(np.int64) + 128]
    chance[lowest == NEVER] = np.nan
    return Ground(chance.T, window.grid.corner[:2], window.grid.resolution)


@dataclasses.dataclass(frozen=True)
class Drives:
    """Where a rover can get to from where it stands.

    Attributes:
        ground: The ground.
        start: (2,) where the rover is [m], world.
        enterable: (rows, columns) where its middle may be: all within its radius is free.
        paths: From its cell.
        farthest: Longer ways were not looked for [m].
    """

    ground: Ground
    start: FloatArray
    enterable: BoolArray
    paths: Paths
    farthest: float

    def lengths(self, places: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return whether places (N, 2 or more) x, y are free, and (N,) how far away [m]."""
        cells, inside = self.ground.cells(places[:, :2])
        row, column = cells.T
        free = inside & self.enterable[row, column]
        return free, np.where(free, self.paths.lengths[row, column], np.inf)

    def gaps(self, points: FloatArray) -> FloatArray:
        """Return (N,) how far points (N, 2) are from where the rover can be, at most less [m]."""
        cells, inside = self.ground.cells(points)
        return np.where(inside, self._gaps[*cells.T], 0.0)

    @functools.cached_property
    def _gaps(self) -> FloatArray:
        return self.ground.gaps(self.paths.lengths)

    def way(self, place: ArrayLike) -> FloatArray:
        """Return (n, 2) points of the shortest path to a place [m], both ends included.

        Raises:
            ValueError: If no path leads there.
        """
        goal = np.asarray(place, dtype=float)[None, :2]
        cells, inside = self.ground.cells(goal)
        if not inside[0]:
            raise ValueError(f"place {goal[0]} m: outside of the map of the ground")
        between = self.ground.centres(self.paths.to((int(cells[0, 0]), int(cells[0, 1]))))
        return np.vstack([self.start, between[1:-1], goal])


def drives(ground: Ground, place: ArrayLike, radius: float, farthest: float) -> Drives:
    """Return where a rover can get to.

    Where it stands is free, known or not: it could not have been seen from there.

    Args:
        ground: What is known of the ground.
        place: (2,) x, y of the rover's middle [m], world.
        radius: Of a circle about its middle that holds it [m].
        farthest: Longest way to look for [m].

    Raises:
        ValueError: If the rover is not on the map.
    """
    start = np.asarray(place, dtype=float)[:2]
    cells, inside = ground.cells(start[None])
    if not inside[0]:
        raise ValueError(f"rover at {start} m: outside of the map of the ground")
    free = ground.probability < FREE_BELOW
    rows, columns = np.indices(free.shape)
    off = ground.centres(np.stack([rows, columns], axis=-1)) - start
    # Two cells more, so that the first step out of this disc is not lost to rounding.
    free |= np.hypot(off[..., 0], off[..., 1]) <= radius + 2.0 * ground.cell
    apart = scipy.ndimage.distance_transform_edt(np.pad(free, 1))
    assert isinstance(apart, np.ndarray)
    # The distance is to the middle of the next cell that is not free; its corner is nearer.
    enterable = apart[1:-1, 1:-1] * ground.cell >= radius + ground.cell / 2.0**0.5
    paths = shortest_paths(enterable, (int(cells[0, 0]), int(cells[0, 1])), ground.cell, farthest)
    return Drives(ground, start, enterable, paths, farthest)
