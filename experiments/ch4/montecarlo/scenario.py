"""The numbers of ``ch4-montecarlo`` and its worlds; `ch4_montecarlo` tells the reasons.

The goal is the origin; the slot lies along x and faces y. Obstacles are hexagons. The map says
where a camera can be: in a free place that can be reached.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.placement.planar.sight import separated
from models.datasheets import CAMERA, INCH
from perception.geometry.arrays import FloatArray

DENSITIES = (5, 20, 35)  # [%] of the work space, table 4-1
TOLERANCES = (20, 10, 1)  # [%] of the object's width, table 4-1
SIDES = 6
CANDIDATES = 512
"""Obstacles drawn for a test, of which the first ones that leave the way free are taken."""


class Scenario(NamedTuple):
    """Numbers of one scenario, in the form that compiled code takes.

    Attributes:
        side: Side of the square work space [m].
        cell: Side of a cell of the map [m].
        smallest: Radius of the smallest obstacle's circle [m].
        largest: Radius of the largest obstacle's circle [m].
        width: Width of the object [m].
        length: Length of the object [m].
        start: Gap between object and goal at first [m].
        speed: Highest speed of the object [m/s].
        gain: Its speed over its gap [1/s].
        period: Between two pictures [s].
        marker: Radius of a marker [m].
        ear: From a corner to its marker's centre, across the slot [m].
        relation: ST_error of the secondary target [m].
        prior: Standard deviation of the object's place at first [m].
        drift: Standard deviation of what it moves aside, blind, over the distance moved.
        pixel: Standard deviation of a marker's column [px].
        disparity: Standard deviation of a marker's disparity [px].
        focal: Focal length [px].
        baseline: Baseline of the stereo pair [m].
        field_of_view: Field of view [rad].
        pixel_per_metre: `task.Lens.pixel_per_metre` of the same camera [m/m].
        near: Nearest distance in focus [m].
        far: Farthest distance in focus [m].
        head: Radius of the stereo head [m].
        stays: 1 if a random camera stays where it is while it sees a target, else 0.
    """

    side: float = 2.4
    cell: float = 0.01
    smallest: float = 0.05
    largest: float = 0.225
    width: float = 4.25 * INCH
    length: float = 0.18
    start: float = 0.5
    speed: float = 0.25
    gain: float = 1.0
    period: float = 0.25
    marker: float = 0.125 * INCH
    ear: float = 0.25 * INCH
    relation: float = 0.005 * INCH
    prior: float = 0.01
    drift: float = 0.025
    pixel: float = 0.1
    disparity: float = 0.05
    focal: float = CAMERA.pinhole.fx
    baseline: float = CAMERA.baseline
    field_of_view: float = CAMERA.field_of_view[0]
    pixel_per_metre: float = 2.0 * math.tan(CAMERA.field_of_view[0] / 2.0) / CAMERA.width
    near: float = 5.0 * INCH
    far: float = 1.1
    head: float = 0.5 * math.hypot(CAMERA.baseline + CAMERA.housing[0], CAMERA.housing[2])
    stays: float = 1.0


SCENARIO = Scenario()


@numba.njit(cache=True)
def draw_world(
    scenario: Scenario, candidates: FloatArray, densities: FloatArray
) -> tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray]:
    """Draw nested worlds: each denser one has the obstacles of the sparser one, and more.

    Args:
        scenario: The numbers.
        candidates: (M, 4 + `SIDES`) uniform in [0, 1): place, size, turn and shape of obstacles.
        densities: (D,) parts of the work space to cover, ascending.

    Returns:
        Corners (N, `SIDES`, 2) of all obstacles [m], anticlockwise; how many of them each density
        has (D,), -1 where the candidates do not suffice; the part that they cover (D,); and the
        probability (D, rows, columns) that a camera cannot be in a cell, 0 or 1.
    """
    rows = int(round(scenario.side / scenario.cell))
    taken = np.zeros((rows, rows), dtype=np.bool_)
    covered = np.zeros((rows, rows), dtype=np.bool_)
    corners = np.empty((len(candidates), SIDES, 2))
    counts = np.full(len(densities), -1)
    parts = np.zeros(len(densities))
    occupied = np.ones((len(densities), rows, rows))
    way = _way(scenario, scenario.marker + 2.0 * scenario.drift * scenario.start)
    _keep_off_way(scenario, taken)
    count = cells = level = 0
    for candidate in candidates:
        while level < len(densities) and cells >= densities[level] * rows * rows:
            counts[level], parts[level] = count, cells / (rows * rows)
            occupied[level] = _unreachable(taken)
            level += 1
        if level == len(densities):
            break
        hexagon = corners[count]
        _hexagon(scenario, candidate, hexagon)
        if separated(way[0, 0], way[0, 1], way, hexagon):
            cells += _cover(scenario, hexagon, covered, taken)
            count += 1
    return corners[:count], counts, parts, occupied


@numba.njit(cache=True)
def _way(scenario: Scenario, margin: float) -> FloatArray:
    """Return the corners (4, 2) of what object and markers pass, widened by a margin [m]."""
    x = 0.5 * scenario.width + scenario.ear + margin
    low, high = -margin, scenario.start + scenario.length + margin
    return np.array([[-x, low], [x, low], [x, high], [-x, high]])


@numba.njit(cache=True)
def _hexagon(scenario: Scenario, candidate: FloatArray, out: FloatArray) -> None:
    """Write one obstacle's corners: on a circle, at irregular angles."""
    x, y = scenario.side * (candidate[0] - 0.5), scenario.side * (candidate[1] - 0.5)
    radius = scenario.smallest + (scenario.largest - scenario.smallest) * candidate[2]
    for i in range(SIDES):
        turn = candidate[3] + (i + 0.8 * (candidate[4 + i] - 0.5)) / SIDES
        out[i, 0] = x + radius * math.cos(2.0 * math.pi * turn)
        out[i, 1] = y + radius * math.sin(2.0 * math.pi * turn)


@numba.njit(cache=True)
def _cover(
    scenario: Scenario,
    hexagon: FloatArray,
    covered: NDArray[np.bool_],
    taken: NDArray[np.bool_],
) -> int:
    """Mark the cells that an obstacle covers, and those where a camera would touch it.

    A camera may be anywhere in a cell, so half a diagonal is added to its radius.

    Returns:
        How many cells it covers that were not.
    """
    rows, cell, half = len(covered), scenario.cell, 0.5 * scenario.side
    reach = scenario.head + 0.5 * math.sqrt(2.0) * cell
    first, last = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    for axis in range(2):
        low, high = np.min(hexagon[:, axis]) - reach, np.max(hexagon[:, axis]) + reach
        first[axis] = max(int((low + half) / cell), 0)
        last[axis] = min(int((high + half) / cell) + 1, rows)
    new = 0
    for row in range(first[1], last[1]):
        for column in range(first[0], last[0]):
            if taken[row, column] and covered[row, column]:
                continue
            away = _distance(hexagon, (column + 0.5) * cell - half, (row + 0.5) * cell - half)
            if away <= reach:
                taken[row, column] = True
            if away <= 0.0 and not covered[row, column]:
                covered[row, column] = True
                new += 1
    return new


@numba.njit(cache=True)
def _distance(hexagon: FloatArray, x: float, y: float) -> float:
    """Return the distance of a place from an obstacle [m]; 0 within it."""
    inside, least = True, np.inf
    for i in range(len(hexagon)):
        j = (i + 1) % len(hexagon)
        ex, ey = hexagon[j, 0] - hexagon[i, 0], hexagon[j, 1] - hexagon[i, 1]
        dx, dy = x - hexagon[i, 0], y - hexagon[i, 1]
        if ex * dy - ey * dx < 0.0:
            inside = False
        t = min(max((dx * ex + dy * ey) / (ex * ex + ey * ey), 0.0), 1.0)
        least = min(least, (dx - t * ex) ** 2 + (dy - t * ey) ** 2)
    return 0.0 if inside else math.sqrt(least)


@numba.njit(cache=True)
def _keep_off_way(scenario: Scenario, taken: NDArray[np.bool_]) -> None:
    """Mark the cells where a camera would touch the object on its way."""
    _cover(scenario, _way(scenario, scenario.marker), np.zeros_like(taken), taken)


@numba.njit(cache=True)
def _unreachable(taken: NDArray[np.bool_]) -> FloatArray:
    """Return 0 for cells that are free and joined with the border by free cells, else 1."""
    rows = len(taken)
    occupied = np.ones((rows, rows))
    stack = np.empty((rows * rows, 2), dtype=np.int64)
    size = 0
    for i in range(rows):
        for row, column in ((0, i), (rows - 1, i), (i, 0), (i, rows - 1)):
            if not taken[row, column] and occupied[row, column] > 0.0:
                occupied[row, column] = 0.0
                stack[size, 0], stack[size, 1] = row, column
                size += 1
    while size > 0:
        size -= 1
        row, column = stack[size, 0], stack[size, 1]
        for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            r, c = row + dr, column + dc
            if 0 <= r < rows and 0 <= c < rows and occupied[r, c] > 0.0 and not taken[r, c]:
                occupied[r, c] = 0.0
                stack[size, 0], stack[size, 1] = r, c
                size += 1
    return occupied
