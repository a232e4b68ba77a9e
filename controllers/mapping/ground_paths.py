"""Paths of a rover over mapped ground: what its middle may enter, and the way around the rest.

A rover is a disc about its middle. It may be wherever nothing that is too high to climb is known
within the disc; unknown ground is free, as a rover sees what is before it.
"""

import dataclasses
import functools
from collections.abc import Iterator

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from controllers.mapping.planar_paths import Paths, shortest_paths
from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap
from perception.geometry.arrays import BoolArray, FloatArray
from perception.geometry.checks import check_numbers

_NO_DISCS = np.zeros((0, 3))
_LEG = 1e-6
"""Length that a vertex must save to be one, over a cell's side."""
_CORNER = 1e-9
"""Part of a line within which it passes through the corner of cells."""


@dataclasses.dataclass(frozen=True)
class GroundPathConfig:
    """Size of a rover, and what it climbs.

    Attributes:
        radius: Radius of a disc about the rover's middle that holds it [m].
        climb: Height above the ground about it up to which a rover drives over things [m].
        second_climb: The same where there is no path otherwise [m].
        window: Side of the square about a cell whose ground is fitted [m].
        pool: Number of cells along each side that make one of the paths' cells, as high as their
            highest: small cells tell small rocks, and paths need them not.
    """

    radius: float = 0.28
    climb: float = 0.025
    second_climb: float = 0.05
    window: float = 0.9
    pool: int = 1

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: Naming the wrong one.
        """
        check_numbers("ground path", self)


def free_cells(
    rises: FloatArray, radius: float = 0.28, climb: float = 0.025, cell: float = 0.05
) -> BoolArray:
    """Return the cells (rows, columns) that the middle of a rover may enter.

    Args:
        rises: (rows, columns) heights above the ground about each cell [m]; NaN where unknown.
        radius: Radius of a disc about the rover's middle that holds it [m]; the centres of higher
            cells are farther away.
        climb: Height above the ground up to which a rover drives over things [m].
        cell: Side of a cell [m].
    """
    higher = rises > climb
    if not higher.any():
        return np.ones(rises.shape, dtype=bool)
    return np.asarray(distance_transform_edt(~higher, sampling=cell)) > radius


def plan_path(
    elevation: ElevationMap,
    start: ArrayLike,
    goal: ArrayLike,
    obstacles: ArrayLike | None = None,
    config: GroundPathConfig | None = None,
) -> FloatArray | None:
    """Return the vertices of a short path of a rover over mapped ground.

    What is within the rover's disc at the start is ignored, as it stands there already; a disc that
    it stands in is not entered any deeper. The goal may be a cell nearer to something than a rover
    is wide.

    Args:
        elevation: Map of the ground, world.
        start: (2,) position of the rover's middle [m], world.
        goal: (2,) position to be reached [m], world.
        obstacles: (M, 3) further discs that no part of the rover may enter, as other robots: x and
            y of the middle, and radius [m], world.
        config: Size of the rover and what it climbs; the default if not given.

    Returns:
        (N, 2) vertices, start and goal included [m], world; each leg runs over free cells. None if
        there is no path, or one of both is beyond the map.
    """
    config = config or GroundPathConfig()
    grid = _paths_grid(elevation.grid, config.pool)
    begin, end = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    if not grid.inside(grid.cells_of([begin, end])).all():
        return None
    for free in _enterable(elevation, begin, obstacles, config):
        path = _path_over(free, grid, begin, end)
        if path is not None:
            return path
    return None


def path_lengths(
    elevation: ElevationMap,
    start: ArrayLike,
    goals: ArrayLike,
    obstacles: ArrayLike | None = None,
    config: GroundPathConfig | None = None,
) -> FloatArray:
    """Return the lengths of a rover's shortest paths from cell to cell to several positions.

    Where no path leads otherwise, they are those over what the rover can climb as a second choice.

    Args:
        elevation: Map of the ground, world.
        start: (2,) position of the rover's middle [m], world; within the map.
        goals: (N, 2) positions to be reached [m], world.
        obstacles: (M, 3) further discs, as in `plan_path`.
        config: Size of the rover and what it climbs; the default if not given.

    Returns:
        (N,) lengths [m]; infinite where no path leads, and beyond the map.
    """
    config = config or GroundPathConfig()
    grid = _paths_grid(elevation.grid, config.pool)
    begin = np.asarray(start, dtype=float)
    first = tuple(grid.cells_of([begin])[0].tolist())
    cells = grid.cells_of(np.asarray(goals, dtype=float))
    inside = grid.inside(cells)
    lengths = np.full(len(cells), np.inf)
    for free in _enterable(elevation, begin, obstacles, config):
        free[first] = True
        left = inside & np.isinf(lengths)
        left[left] = free[*cells[left].T]
        if left.any():
            paths = shortest_paths(free, first, grid.cell, goals=cells[left])
            lengths[left] = paths.lengths[*cells[left].T]
    return lengths


def _enterable(
    elevation: ElevationMap,
    start: FloatArray,
    obstacles: ArrayLike | None,
    config: GroundPathConfig,
) -> Iterator[BoolArray]:
    """Yield the paths' cells that a rover may enter: by what it climbs, then by what it can."""
    fine, grid = elevation.grid, _paths_grid(elevation.grid, config.pool)
    discs = _NO_DISCS if obstacles is None else np.asarray(obstacles, dtype=float).reshape(-1, 3)
    above = rises(elevation, config.window).copy()
    box, apart = _box_about(start, config.radius, fine)
    above[box][apart <= config.radius] = np.nan
    above = _pooled(above, config.pool)
    kept_clear = _beyond(discs, grid, start, config.radius)
    for climb in (config.climb, config.second_climb):
        yield free_cells(above, config.radius, climb, grid.cell) & kept_clear


def _paths_grid(grid: ElevationGrid, pool: int) -> ElevationGrid:
    """Return the grid whose cells are squares of a grid's cells."""
    if pool == 1:
        return grid
    rows, columns = (-(-count // pool) for count in grid.shape)
    return ElevationGrid(grid.corner, (rows, columns), pool * grid.cell)


def _pooled(above: FloatArray, pool: int) -> FloatArray:
    """Return the highest of each square of cells; NaN where none is known."""
    if pool == 1:
        return above
    rows, columns = (-(-count // pool) for count in above.shape)
    whole = np.full((rows * pool, columns * pool), np.nan)
    whole[: above.shape[0], : above.shape[1]] = above
    bands = functools.reduce(np.fmax, [whole[row::pool] for row in range(pool)])
    return functools.reduce(np.fmax, [bands[:, column::pool] for column in range(pool)])


def _beyond(discs: FloatArray, grid: ElevationGrid, start: FloatArray, radius: float) -> BoolArray:
    """Return the cells (rows, columns) in which a rover is clear of discs, or as far as it was."""
    clear = np.ones(grid.shape, dtype=bool)
    for x, y, size in discs:
        away = min(size + radius, float(np.hypot(*(start - (x, y)))))
        box, apart = _box_about(np.array([x, y]), away, grid)
        clear[box] &= apart >= away
    return clear


def _box_about(
    place: FloatArray, radius: float, grid: ElevationGrid
) -> tuple[tuple[slice, slice], FloatArray]:
    """Return the box of cells that holds a disc, and their distances from its middle [m]."""
    corners = np.clip(grid.cells_of([place - radius, place + radius]) + [[0], [1]], 0, grid.shape)
    (top, left), (bottom, right) = corners.tolist()
    cells = np.moveaxis(np.mgrid[top:bottom, left:right], 0, -1)
    apart = np.hypot(*np.moveaxis(grid.centres_of(cells) - place, -1, 0))
    return (slice(top, bottom), slice(left, right)), apart


def _path_over(
    free: BoolArray, grid: ElevationGrid, start: FloatArray, goal: FloatArray
) -> FloatArray | None:
    """Return the vertices (N, 2) of a path over free cells and those of its ends; None if none."""
    first, last = (tuple(cell) for cell in grid.cells_of([start, goal]).tolist())
    free = free.copy()
    free[first] = free[last] = True
    corner = np.array(grid.corner)
    paths = shortest_paths(free, first, grid.cell, goals=np.array([last]))
    if not np.isfinite(paths.lengths[last]):
        return None
    path = GroundPaths(paths, start, corner, grid.cell).path_to(goal)
    return None if path is None else shortened(path, free, corner, grid.cell)


def shortened(path: FloatArray, free: BoolArray, corner: FloatArray, cell: float) -> FloatArray:
    """Return the shortest path (M, 2) over some of a path's points whose legs run over free cells.

    Args:
        path: (N, 2) points, x and y [m]; legs from each to the next may run anywhere.
        free: (rows, columns) cells that may be entered.
        corner: (2,) lowest corner of the first cell [m].
        cell: Side of a cell [m].
    """
    places = (path - corner)[:, ::-1] / cell
    return path[_string_pulled(np.ascontiguousarray(places), free)]


@dataclasses.dataclass(frozen=True)
class GroundPaths:
    """Shortest paths of a rover over the ground from one position.

    Attributes:
        paths: Shortest paths over the cells of a grid; the start is in its first cell.
        start: (2,) position at which the paths begin [m], ground frame.
        corner: (2,) lowest corner of the first cell [m], ground frame.
        cell: Side of a cell [m].
    """

    paths: Paths
    start: FloatArray
    corner: FloatArray
    cell: float

    def path_to(self, place: ArrayLike) -> FloatArray | None:
        """Return the points (N, 2) of the shortest path to a position (2,) [m], ground frame.

        Both ends are included. None is returned if no path leads to the position's cell or a
        neighbour of it, or if the position is outside of the grid.
        """
        goal, lengths = np.asarray(place, dtype=float), self.paths.lengths
        row, column = np.floor((goal - self.corner) / self.cell).astype(int)[::-1]
        near = np.array([(row + i, column + j) for i in (0, -1, 1) for j in (0, -1, 1)])
        near = near[np.all((near >= 0) & (near < lengths.shape), axis=1)]
        if len(near) and not np.isfinite(lengths[*near[0]]):
            near = near[np.argsort(lengths[*near.T])]
        if not len(near) or not np.isfinite(lengths[*near[0]]):
            return None
        cells = self.paths.to((int(near[0, 0]), int(near[0, 1])))
        between = (cells[1:-1, ::-1] + 0.5) * self.cell + self.corner
        return np.vstack([self.start, between, goal])


@numba.njit(cache=True)
def _string_pulled(places, free):
    """Return the indices of the points that are kept; places in cells, row and column."""
    count = len(places)
    shortest, before = np.full(count, np.inf), np.full(count, -1)
    shortest[0] = 0.0
    for j in range(1, count):
        for i in range(j):
            length = shortest[i] + _LEG
            length += np.hypot(places[j, 0] - places[i, 0], places[j, 1] - places[i, 1])
            # The leg from the point before is one of the path itself.
            if length < shortest[j] and (i == j - 1 or _visible(places[i], places[j], free)):
                shortest[j], before[j] = length, i
    kept = [count - 1]
    while before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return np.array(kept[::-1])


@numba.njit(cache=True)
def _visible(start, end, free):
    """Return whether a line runs over free cells only, and past no corner of one that is not."""
    row, column = int(np.floor(start[0])), int(np.floor(start[1]))
    last_row, last_column = int(np.floor(end[0])), int(np.floor(end[1]))
    down, right = end[0] - start[0], end[1] - start[1]
    step_down, step_right = (1 if down > 0 else -1), (1 if right > 0 else -1)
    # Part of the line at which it leaves the row and the column, and what crossing one takes.
    each_row = 1.0 / abs(down) if down != 0.0 else np.inf
    each_column = 1.0 / abs(right) if right != 0.0 else np.inf
    next_row = (row + (down > 0) - start[0]) / down if down != 0.0 else np.inf
    next_column = (column + (right > 0) - start[1]) / right if right != 0.0 else np.inf
    while row != last_row or column != last_column:
        if not free[row, column]:
            return False
        ahead_row = next_row if row != last_row else np.inf
        ahead_column = next_column if column != last_column else np.inf
        corner = abs(ahead_row - ahead_column) < _CORNER
        if corner and not (free[row + step_down, column] and free[row, column + step_right]):
            return False
        if corner or ahead_row < ahead_column:
            row, next_row = row + step_down, next_row + each_row
        if corner or ahead_row > ahead_column:
            column, next_column = column + step_right, next_column + each_column
    return bool(free[row, column])
