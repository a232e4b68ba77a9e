"""Parameters and worlds of ``ch4-montecarlo``; `montecarlo` gives their reasons.

The goal is the origin; the slot lies along x and faces y. Obstacles are hexagons. A camera position
is free on the map if it is clear of obstacles and can be reached.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
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
"""Obstacles drawn for a test, of which the first ones clear of the object's path are used."""


class Scenario(NamedTuple):
    """Parameters of one scenario, for compiled code.

    Attributes:
        side: Side of the square work space [m].
        cell: Side of a cell of the map [m].
        smallest: Radius of the smallest obstacle's circle [m].
        largest: Radius of the largest obstacle's circle [m].
        width: Width of the object [m].
        length: Length of the object [m].
        start: Gap between object and goal at first [m].
        speed: Highest speed of the object [m/s].
        gain: Speed of the object over its gap [1/s].
        period: Time between two pictures [s].
        marker: Radius of a marker [m].
        ear: Distance from a corner to its marker's centre, across the slot [m].
        relation: ST_error of the secondary target [m].
        prior: Standard deviation of the object's initial position [m].
        drift: Standard deviation of the lateral drift over the distance moved without sightings.
        pixel: Standard deviation of a marker's column [px].
        disparity: Standard deviation of a marker's disparity [px].
        focal: Focal length [px].
        baseline: Baseline of the stereo pair [m].
        field_of_view: Field of view [rad].
        pixel_per_metre: `task.Lens.pixel_per_metre` of the same camera [m/m].
        near: Nearest distance in focus [m].
        far: Farthest distance in focus [m].
        head: Radius of the stereo head [m].
        stays: 1 if a random camera does not move while it sees a target, else 0.
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


class ObstacleWorld(NamedTuple):
    """One test's obstacles and map.

    Attributes:
        corners: (N, `SIDES`, 2) corners of the obstacles [m], anticlockwise.
        occupied: (rows, columns) probability that a camera cannot be in a cell, 0 or 1.
        covered: Share of the work space that the obstacles cover.
    """

    corners: FloatArray
    occupied: FloatArray
    covered: float = 0.0


def draw_worlds(
    candidates: FloatArray, scenario: Scenario = SCENARIO, densities: Sequence[float] = DENSITIES
) -> list[ObstacleWorld]:
    """Draw nested worlds: each denser one has the obstacles of the sparser one, and more.

    Args:
        candidates: (M, 4 + `SIDES`) uniform in [0, 1): position, size, turn and shape of obstacles.
        scenario: Parameters of the scenario.
        densities: Densities of the obstacles, ascending [%].

    Raises:
        ValueError: If a density cannot be reached with the candidates.
    """
    rows = round(scenario.side / scenario.cell)
    taken, covered = np.zeros((2, rows, rows), dtype=bool)
    _cover(scenario, _passage(scenario, scenario.marker), np.zeros_like(taken), taken)
    passage = _passage(scenario, scenario.marker + 2.0 * scenario.drift * scenario.start)
    hexagons: list[FloatArray] = []
    worlds: list[ObstacleWorld] = []
    left, cells = iter(candidates), 0
    for density in densities:
        while cells < density / 100.0 * rows * rows:
            candidate = next(left, None)
            if candidate is None:
                raise ValueError(f"density {density} %: not reached by {len(candidates)} obstacles")
            hexagon = _hexagon(scenario, candidate)
            if separated(passage[0, 0], passage[0, 1], passage, hexagon):
                cells += _cover(scenario, hexagon, covered, taken)
                hexagons.append(hexagon)
        share = cells / (rows * rows)
        worlds.append(ObstacleWorld(np.array(hexagons), _unreachable(taken), share))
    return worlds


def _passage(scenario: Scenario, margin: float) -> FloatArray:
    """Return the corners (4, 2) of the area swept by object and markers plus a margin [m]."""
    x = 0.5 * scenario.width + scenario.ear + margin
    low, high = -margin, scenario.start + scenario.length + margin
    return np.array([[-x, low], [x, low], [x, high], [-x, high]])


@numba.njit(cache=True)
def _hexagon(scenario: Scenario, candidate: FloatArray) -> FloatArray:
    """Return one obstacle's corners (`SIDES`, 2) [m]: on a circle, at irregular angles."""
    x, y = scenario.side * (candidate[0] - 0.5), scenario.side * (candidate[1] - 0.5)
    radius = scenario.smallest + (scenario.largest - scenario.smallest) * candidate[2]
    corners = np.empty((SIDES, 2))
    for i in range(SIDES):
        turn = candidate[3] + (i + 0.8 * (candidate[4 + i] - 0.5)) / SIDES
        corners[i, 0] = x + radius * math.cos(2.0 * math.pi * turn)
        corners[i, 1] = y + radius * math.sin(2.0 * math.pi * turn)
    return corners


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
        Number of cells that are newly covered.
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
    """Return the distance of a point from an obstacle [m]; 0 within it."""
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


def _unreachable(taken: NDArray[np.bool_]) -> FloatArray:
    """Return 0 for cells that are free and joined with the border by free cells, else 1."""
    cells = np.pad(taken.astype(np.uint8), 1)
    cv2.floodFill(cells, None, (0, 0), (2,))
    return np.where(cells[1:-1, 1:-1] == 2, 0.0, 1.0)  # noqa: PLR2004
