"""Paths of a rover over mapped ground: what its middle may enter, and the way around the rest.

A rover is a disc about its middle. It may be wherever nothing that is too high to climb is known
within the disc; over what it climbs it drives only where the way around is much longer, and it
rather keeps off both. Unknown ground is free, as a rover sees what is before it, and costs what the
ground costs elsewhere.
"""

import dataclasses
import itertools
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import ArrayLike

from controllers.mapping.planar_paths import shortest_paths
from perception.elevation.grid import ElevationGrid
from perception.elevation.submaps import filled
from perception.geometry.arrays import BoolArray, FloatArray
from perception.geometry.checks import check_numbers

_NO_DISCS = np.zeros((0, 3))
_SWITCH = 1.3
"""How many times as much as another a path may cost to be kept."""
_LEAST = 1e-6
"""Length that a leg must save at least to be one [cells]."""
_CORNER = 1e-9
"""Part of a line within which it passes through the corner of cells."""


@dataclasses.dataclass(frozen=True)
class GroundPathConfig:
    """Size of a rover, and what it climbs.

    Attributes:
        radius: Radius of a disc about the rover's middle that holds it [m].
        climb: Height above the ground about it up to which things are none to go around [m].
        most_climb: Height up to which a rover drives over things at all [m].
        over_cost: How many times its length a path costs over those between, beyond once.
        sure: Distance from the start up to which the map is believed to show what no rover drives
            over [m]; some of what it shows farther away is none, as a nearer look tells.
        far_cost: How many times its length a path costs over that, beyond once.
        margin: Distance beyond the disc within which things are rather gone around, too [m].
        near_cost: How many times its length a path costs at the disc's edge, beyond once.
        unknown_cost: How many times its length a path costs over unknown ground, beyond once.
        corner: Length that each corner of a path costs in the open [m]; beside things times the
            square of what a path costs there, as a rover slides aside while it turns.
        inner: Radius of a disc about the rover's middle in which nothing can stand [m]: what the
            map has within it at the start is none.
        least: Fewest higher cells in a square of three by three that are an obstacle: one alone is
            noise where cells are smaller than rocks.
        pool: Number of cells along each side that make one of the paths' cells: small cells tell
            small rocks, and paths need them not.
    """

    radius: float = 0.28
    climb: float = 0.025
    most_climb: float = 0.05
    over_cost: float = 15.0
    sure: float = 1.5
    far_cost: float = 60.0
    margin: float = 0.25
    near_cost: float = 3.0
    unknown_cost: float = 0.0
    corner: float = 0.15
    inner: float = 0.2
    least: int = 1
    pool: int = 1

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: Naming the wrong one.
        """
        free = {"near_cost", "unknown_cost"}
        names = {field.name for field in dataclasses.fields(self)} - free
        check_numbers("ground path", self, *sorted(names))
        check_numbers("ground path", self, *sorted(free), zero=True)


class MappedRises(NamedTuple):
    """What is mapped of what stands on the ground.

    Attributes:
        grid: Cells of the map, world.
        above: (rows, columns) heights of the cells above the ground about them [m]; NaN where
            unknown.
    """

    grid: ElevationGrid
    above: FloatArray


def obstacles(rises: FloatArray, climb: float, least: int = 1) -> BoolArray:
    """Return the cells (rows, columns) that a rover does not drive over.

    Args:
        rises: (rows, columns) heights above the ground about each cell [m]; NaN where unknown.
        climb: Height above the ground up to which a rover drives over things [m].
        least: Fewest higher cells in a square of three by three for one to be an obstacle.
    """
    higher = rises > climb
    if least > 1:
        counts = cv2.boxFilter(
            higher.view(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        higher &= np.asarray(counts) >= least
    return higher


def plan_path(
    mapped: MappedRises,
    start: ArrayLike,
    goal: ArrayLike,
    discs: ArrayLike | None = None,
    config: GroundPathConfig | None = None,
    kept: FloatArray | None = None,
    doubted: BoolArray | None = None,
) -> FloatArray | None:
    """Return the vertices of a short path of a rover over mapped ground.

    The rover comes no nearer to anything that is within its disc at the start already, and enters a
    further disc that it stands in no deeper.

    Args:
        mapped: What is mapped.
        start: (2,) position of the rover's middle [m], world.
        goal: (2,) position to be reached [m], world.
        discs: (M, 3) further discs that no part of the rover may enter, as other robots: x and
            y of the middle, and radius [m], world.
        config: Size of the rover and what it climbs; the default if not given.
        kept: (N, 2) path from the start to the goal that is kept unless another one is clearly
            cheaper, as turning from one to the other takes time; None for none.
        doubted: (rows, columns) cells that may hold something, as in `path_costs`.

    Returns:
        (N, 2) vertices, start and goal included [m], world; each leg runs over free cells. None if
        there is no path, or one of both is beyond the map, or the rover may not be at the goal.
    """
    config = config or GroundPathConfig()
    grid = _paths_grid(mapped.grid, config.pool)
    begin, end = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    if not grid.inside(grid.cells_of([begin, end])).all():
        return None
    costs = path_costs(mapped, begin, discs, config, doubted)
    path = _path_over(costs, grid, begin, end, config.corner)
    if path is not None and kept is not None:
        old, new = (_cost_of(each, costs, grid, config.corner) for each in (kept, path))
        return kept if old <= _SWITCH * new else path
    return path


def path_lengths(
    mapped: MappedRises,
    start: ArrayLike,
    goals: ArrayLike,
    discs: ArrayLike | None = None,
    config: GroundPathConfig | None = None,
    doubted: BoolArray | None = None,
) -> FloatArray:
    """Return the lengths of a rover's paths from cell to cell to several positions.

    They are lengths over unknown ground that would cost as much, so more than a path's own length
    beside obstacles and over rocks.

    Args:
        mapped: What is mapped.
        start: (2,) position of the rover's middle [m], world; within the map.
        goals: (N, 2) positions to be reached [m], world.
        discs: (M, 3) further discs, as in `plan_path`.
        config: Size of the rover and what it climbs; the default if not given.
        doubted: (rows, columns) cells that may hold something, as in `path_costs`.

    Returns:
        (N,) lengths [m]; infinite where no path leads, and beyond the map.
    """
    config = config or GroundPathConfig()
    grid = _paths_grid(mapped.grid, config.pool)
    begin = np.asarray(start, dtype=float)
    first = tuple(grid.cells_of([begin])[0].tolist())
    cells = grid.cells_of(np.asarray(goals, dtype=float))
    inside = grid.inside(cells)
    lengths = np.full(len(cells), np.inf)
    costs = path_costs(mapped, begin, discs, config, doubted)
    inside[inside] = np.isfinite(costs[*cells[inside].T])
    if inside.any():
        paths = shortest_paths(costs, first, grid.cell, goals=cells[inside])
        lengths[inside] = paths.lengths[*cells[inside].T] / (1.0 + config.unknown_cost)
    return lengths


def standing_places(
    mapped: MappedRises,
    start: ArrayLike,
    room: float | None,
    discs: ArrayLike | None = None,
    config: GroundPathConfig | None = None,
    doubted: BoolArray | None = None,
) -> Callable[[ArrayLike], bool]:
    """Return whether a rover gets to a position (2,) [m], world, and has room there.

    Args:
        mapped: What is mapped.
        start: (2,) position of the rover's middle [m], world; within the map.
        room: Distance from the rover's disc within which nothing stands [m]; None where what is low
            may stand even below the rover.
        discs: (M, 3) further discs, as in `plan_path`.
        config: Size of the rover and what it climbs; the default if not given.
        doubted: (rows, columns) cells that may hold something, as in `path_costs`.
    """
    config = config or GroundPathConfig()
    grid, begin = _paths_grid(mapped.grid, config.pool), np.asarray(start, dtype=float)
    costs = path_costs(mapped, begin, discs, config, doubted)
    first = tuple(grid.cells_of([begin])[0].tolist())
    lengths = shortest_paths(costs, first, grid.cell).lengths
    most = 1.0 + config.near_cost
    if room is None:
        most += config.over_cost
    else:
        most -= config.near_cost * min(room / config.margin, 1.0)
    free = np.isfinite(lengths) & (costs <= most)

    def may_stand(place: ArrayLike) -> bool:
        cells = grid.cells_of(np.asarray(place, dtype=float)[None])
        return bool(grid.inside(cells)[0] and free[*cells[0]])

    return may_stand


def path_costs(
    mapped: MappedRises,
    start: FloatArray,
    discs: ArrayLike | None,
    config: GroundPathConfig,
    doubted: BoolArray | None = None,
) -> FloatArray:
    """Return how many times its length a path of a rover costs in each cell of the paths.

    Args:
        mapped: What is mapped.
        start: (2,) position of the rover's middle [m], world; within the map.
        discs: (M, 3) further discs, as in `plan_path`.
        config: Size of the rover, what it climbs, and what that costs.
        doubted: (rows, columns) cells of the map that may hold something, which costs as much as
            to drive over what can be climbed; None for none.

    Returns:
        (rows, columns) 1 in the open, more beside and over things, over unknown ground and where
        something seems to stand far away, infinite where the rover may not be.
    """
    fine, grid = mapped.grid, _paths_grid(mapped.grid, config.pool)
    further = _NO_DISCS if discs is None else np.asarray(discs, dtype=float).reshape(-1, 3)
    above = mapped.above.copy()
    box, apart = fine.box_about(start, config.inner)
    above[box][apart <= config.inner] = np.nan
    first = tuple(grid.cells_of([start])[0].tolist())
    low, high = (
        obstacles(above, climb, config.least) for climb in (config.climb, config.most_climb)
    )
    if doubted is not None:
        low |= doubted
    low, high = _pooled(low, config.pool), _pooled(high, config.pool)
    # What stands within the disc at the start is each come no nearer.
    box, apart = grid.box_about(start, config.radius)
    held = high[box] & (apart <= config.radius)
    high[box] &= ~held
    points = np.pad(grid.centres[box][held], ((0, 0), (0, 1)))
    by_discs = _disc_gaps(np.vstack([further, points]), grid, start, config)
    low_gaps = np.minimum(_gaps(low, grid.cell), by_discs)
    margins = 1.0 - (low_gaps - config.radius) / config.margin
    costs = 1.0 + config.near_cost * np.clip(margins, 0.0, 1.0)
    costs[low_gaps <= config.radius] += config.over_cost
    unknown = ~_pooled(filled(np.isfinite(mapped.above)), config.pool)
    costs[unknown] = np.maximum(costs[unknown], 1.0 + config.unknown_cost)
    costs[_gaps(high, grid.cell) <= config.radius] = 1.0 + config.far_cost
    box, apart = grid.box_about(start, config.sure)
    costs[box][(costs[box] > config.far_cost) & (apart <= config.sure)] = np.inf
    costs[by_discs <= config.radius] = np.inf
    costs[first] = 1.0
    return costs


def _gaps(obstacles: BoolArray, cell: float) -> FloatArray:
    """Return the distance (rows, columns) of each cell from the nearest obstacle [m]."""
    if not obstacles.any():
        return np.full(obstacles.shape, np.inf)
    away = cv2.distanceTransform(
        (~obstacles).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE, dstType=cv2.CV_32F
    )
    # Of single precision, but squares of whole numbers of cells.
    return cell * np.sqrt(np.rint(np.square(np.asarray(away, dtype=np.float64))))


def _paths_grid(grid: ElevationGrid, pool: int) -> ElevationGrid:
    """Return the grid whose cells are squares of a grid's cells."""
    if pool == 1:
        return grid
    rows, columns = (-(-count // pool) for count in grid.shape)
    return ElevationGrid(grid.corner, (rows, columns), pool * grid.cell)


def _pooled(cells: BoolArray, pool: int) -> BoolArray:
    """Return which squares of cells hold one that is set."""
    if pool == 1:
        return cells
    rows, columns = (-(-count // pool) for count in cells.shape)
    whole = np.zeros((rows * pool, columns * pool), bool)
    whole[: cells.shape[0], : cells.shape[1]] = cells
    offsets = itertools.product(range(pool), repeat=2)
    return np.logical_or.reduce([whole[down::pool, right::pool] for down, right in offsets])


def _disc_gaps(
    discs: FloatArray, grid: ElevationGrid, start: FloatArray, config: GroundPathConfig
) -> FloatArray:
    """Return the distance (rows, columns) of each cell from the nearest disc, where it counts [m].

    A disc that the rover reaches into at the start is as if it were smaller by as much.
    """
    gaps = np.full(grid.shape, np.inf)
    for x, y, size in discs:
        held = min(size, float(np.hypot(*(start - (x, y)))) - config.radius)
        reach = held + config.radius + config.margin
        box, apart = grid.box_about(np.array([x, y]), reach)
        gaps[box] = np.minimum(gaps[box], np.nextafter(apart - held, np.inf))
    return gaps


def _path_over(
    costs: FloatArray, grid: ElevationGrid, start: FloatArray, goal: FloatArray, turn: float
) -> FloatArray | None:
    """Return the vertices (N, 2) of a path over free cells and those of its ends; None if none."""
    first, last = (tuple(cell) for cell in grid.cells_of([start, goal]).tolist())
    corner = np.array(grid.corner)
    paths = shortest_paths(costs, first, grid.cell, goals=np.array([last]))
    if not np.isfinite(paths.lengths[last]):
        return None
    path = np.vstack([start, grid.centres_of(paths.to(last)[1:-1]), goal])
    return shortened(path, costs, corner, grid.cell, turn)


def shortened(
    path: FloatArray, costs: FloatArray, corner: FloatArray, cell: float, turn: float = 0.0
) -> FloatArray:
    """Return the cheapest path (M, 2) over some of a path's points whose legs run over free cells.

    Args:
        path: (N, 2) points, x and y [m]; legs from each to the next may run anywhere.
        costs: (rows, columns) how many times its length a path costs in each cell; infinite where
            it may not be entered.
        corner: (2,) lowest corner of the first cell [m].
        cell: Side of a cell [m].
        turn: Length that each of the path's legs costs in the open beside its own [m].
    """
    places = (path - corner)[:, ::-1] / cell
    return path[_string_pulled(np.ascontiguousarray(places), costs, max(turn / cell, _LEAST))]


@numba.njit(cache=True)
def _string_pulled(places, costs, leg):
    """Return the indices of the points that are kept; places in cells, row and column."""
    count = len(places)
    cheapest, before = np.full(count, np.inf), np.full(count, -1)
    cheapest[0] = 0.0
    for j in range(1, count):
        for i in range(j - 1, -1, -1):
            length = np.hypot(places[j, 0] - places[i, 0], places[j, 1] - places[i, 1])
            # No cell costs less than once its length.
            corner = leg * (1.0 if i == 0 else costs[int(places[i, 0]), int(places[i, 1])] ** 2)
            if cheapest[i] + corner + length >= cheapest[j]:
                continue
            cost = _cost_along(places[i], places[j], costs)
            if i == j - 1 and cost == np.inf:
                cost = length  # The leg from the point before is one of the path itself.
            if cheapest[i] + corner + cost < cheapest[j]:
                cheapest[j], before[j] = cheapest[i] + corner + cost, i
    kept = [count - 1]
    while before[kept[-1]] >= 0:
        kept.append(before[kept[-1]])
    return np.array(kept[::-1])


def _cost_of(path: FloatArray, costs: FloatArray, grid: ElevationGrid, turn: float) -> float:
    """Return what a path (N, 2) costs [m], with what each of its corners costs beside that."""
    places = (path - np.array(grid.corner))[:, ::-1] / grid.cell
    legs = zip(places[:-1], places[1:], strict=True)
    along = sum(float(_cost_along(first, second, costs)) for first, second in legs)
    corners = costs[*places[1:-1].astype(int).T]
    return grid.cell * along + turn * (1.0 + float(np.square(corners).sum()))


@numba.njit(cache=True)
def _cost_along(start, end, costs):
    """Return what a line costs [cells]; infinite past a corner of a cell that is not free."""
    row, column = int(np.floor(start[0])), int(np.floor(start[1]))
    last_row, last_column = int(np.floor(end[0])), int(np.floor(end[1]))
    down, right = end[0] - start[0], end[1] - start[1]
    step_down, step_right = (1 if down > 0 else -1), (1 if right > 0 else -1)
    # Part of the line at which it leaves the row and the column, and what crossing one takes.
    each_row = 1.0 / abs(down) if down != 0.0 else np.inf
    each_column = 1.0 / abs(right) if right != 0.0 else np.inf
    next_row = (row + (down > 0) - start[0]) / down if down != 0.0 else np.inf
    next_column = (column + (right > 0) - start[1]) / right if right != 0.0 else np.inf
    cost, gone = 0.0, 0.0
    while row != last_row or column != last_column:
        if costs[row, column] == np.inf:
            return np.inf
        ahead_row = next_row if row != last_row else np.inf
        ahead_column = next_column if column != last_column else np.inf
        ahead = min(ahead_row, ahead_column)
        cost, gone = cost + (ahead - gone) * costs[row, column], ahead
        corner = abs(ahead_row - ahead_column) < _CORNER
        if corner and (
            costs[row + step_down, column] == np.inf or costs[row, column + step_right] == np.inf
        ):
            return np.inf
        if corner or ahead_row < ahead_column:
            row, next_row = row + step_down, next_row + each_row
        if corner or ahead_row > ahead_column:
            column, next_column = column + step_right, next_column + each_column
    return (cost + (1.0 - gone) * costs[row, column]) * np.hypot(down, right)
