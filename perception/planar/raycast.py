"""Lines of sight on a planar grid: what a range scan sees, and how much a view would cover.

Sensors are at centres of cells, so the cells along every beam are the same wherever it starts:
they are tabulated once. A scan has one beam towards every cell (whole numbers, exact also through
corners). A fan has even directions; each crossed cell has the area (r2^2 - r1^2) dtheta / 2 of
its piece of the ray's wedge.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.planar.map import Grid

SECTOR_SLACK = 1e-9
"""Directions on the edge of a sector belong to it [rad]."""

# The compiler's decorator has no types.
_njit: Any = numba.njit(cache=True)


FULL, TOUCHED, BEYOND = 0, 1, 2
"""How a beam meets a cell: goes through it, touches its corner only, or enters it within the depth
of field while the cell's centre lies beyond. All may stop the beam; only the first is measured as
passed."""


class Beams(NamedTuple):
    """Cells along the beams of a scan, relative to the sensor's cell.

    Attributes:
        directions: (n,) angles from the x axis [rad].
        starts: (n + 1,) where each beam's cells begin in the arrays below.
        offsets: (m, 2) cells (row, column), near to far.
        kinds: (m,) `FULL`, `TOUCHED` or `BEYOND`.
        entries: (m,) where the beam enters the cell [m].
        exits: (m,) where it leaves it [m].
    """

    directions: FloatArray
    starts: IntArray
    offsets: IntArray
    kinds: NDArray[np.int8]
    entries: FloatArray
    exits: FloatArray


class Fan(NamedTuple):
    """Cells along evenly spaced rays, relative to the sensor's cell.

    Ray k covers the directions from k to k + 1 times 2 pi / n, and runs along their middle.

    Attributes:
        starts: (n + 1,) where each ray's cells begin in the arrays below.
        offsets: (m, 2) cells (row, column), near to far.
        areas: (m,) area of the cell's piece of the wedge [m^2].
        radii: (m,) middle of the ray's piece [m].
    """

    starts: IntArray
    offsets: IntArray
    areas: FloatArray
    radii: FloatArray

    @property
    def rays(self) -> int:
        """Number of rays."""
        return self.starts.size - 1


@functools.lru_cache(maxsize=16)
def beams(depth: float, cell: float) -> Beams:
    """Tabulate one beam towards every cell whose centre is within the depth of field.

    Args:
        depth: Depth of field [m].
        cell: Side of a cell [m].
    """
    reach = int(depth / cell + 1e-9)
    span = range(-reach, reach + 1)
    primitive = [(r, c) for r in span for c in span if math.gcd(r, c) == 1]
    limit = (depth / cell + 1e-9) ** 2
    targets = [(r, c) for r, c in primitive if r * r + c * c <= limit]
    starts, flat = _tabulated([_beam_cells(r, c, depth / cell) for r, c in targets])
    directions = np.array([math.atan2(r, c) for r, c in targets])
    return Beams(
        directions,
        starts,
        flat[:, :2].astype(np.int64),
        flat[:, 2].astype(np.int8),
        flat[:, 3] * cell,
        flat[:, 4] * cell,
    )


def _beam_cells(row: int, column: int, depth: float) -> list[tuple[int, int, int, float, float]]:
    """Follow a beam from (0, 0) through (row, column) as far as ``depth``, lengths in cells.

    The k-th line of columns is crossed at (2k + 1) / (2 |column|) of the way, that of rows alike;
    compared as whole numbers, so a beam through a corner is known as such.
    """
    length = math.hypot(row, column)
    step_r, step_c = int(np.sign(row)), int(np.sign(column))
    ar, ac = abs(row), abs(column)
    r = c = kr = kc = 0
    entry = 0.0
    cells: list[tuple[int, int, int, float, float]] = []
    while entry <= depth:
        to_r = (2 * kr + 1) * ac if ar else None
        to_c = (2 * kc + 1) * ar if ac else None
        along_c = to_c is not None and (to_r is None or to_c <= to_r)
        along_r = to_r is not None and (to_c is None or to_r <= to_c)
        leave = length * ((2 * kc + 1) / (2 * ac) if along_c else (2 * kr + 1) / (2 * ar))
        kind = FULL if math.hypot(r, c) <= depth + 1e-9 else BEYOND
        cells.append((r, c, kind, entry, leave))
        if along_c and along_r and leave <= depth:
            # Through a corner: either neighbour would stop the beam.
            cells += [
                (r, c + step_c, TOUCHED, leave, leave),
                (r + step_r, c, TOUCHED, leave, leave),
            ]
        if along_c:
            c, kc = c + step_c, kc + 1
        if along_r:
            r, kr = r + step_r, kr + 1
        entry = leave
    return cells


def _tabulated(lists: Sequence[Sequence[tuple[float, ...]]]) -> tuple[IntArray, FloatArray]:
    """Return where each list begins, and the end of the last; and all rows in one array."""
    starts = np.cumsum([0, *map(len, lists)], dtype=np.int64)
    return starts, np.array([row for rows in lists for row in rows], dtype=float)


@functools.lru_cache(maxsize=16)
def fan(depth: float, cell: float, rays: int) -> Fan:
    """Tabulate evenly spaced rays.

    Args:
        depth: Depth of field [m].
        cell: Side of a cell [m].
        rays: Number of rays in the full circle.

    Raises:
        ValueError: If there are fewer than 4 rays.
    """
    if rays < 4:
        raise ValueError(f"rays: expected at least 4, got {rays}")
    step = 2.0 * math.pi / rays
    starts, flat = _tabulated([_ray_cells((k + 0.5) * step, depth / cell) for k in range(rays)])
    near, far = flat[:, 2] * cell, flat[:, 3] * cell
    return Fan(
        starts,
        flat[:, :2].astype(np.int64),
        (far**2 - near**2) * step / 2.0,
        (near + far) / 2.0,
    )


def _ray_cells(angle: float, depth: float) -> list[tuple[float, float, float, float]]:
    """Return row, column, entry and exit of the cells along a ray, lengths in cells."""
    dx, dy = math.cos(angle), math.sin(angle)
    crossings = {0.0, depth}
    for slope in (dx, dy):
        if abs(slope) > 1e-12:
            count = int(depth * abs(slope) + 0.5)
            crossings.update((k + 0.5) / abs(slope) for k in range(count))
    edges = sorted(t for t in crossings if t <= depth)
    cells: list[tuple[float, float, float, float]] = []
    for near, far in zip(edges[:-1], edges[1:]):
        middle = (near + far) / 2.0
        cells.append((round(middle * dy), round(middle * dx), near, far))
    return cells


@dataclasses.dataclass(frozen=True)
class RangeSensor:
    """A planar vision system.

    Attributes:
        fov: Field of view [rad].
        depth: Depth of field: the farthest range that is measured [m].
        noise: Deviation of a range over its square, sigma = noise * L^2 [1/m] (Thesis eq. 3-7).
    """

    fov: float = math.radians(90.0)
    depth: float = 15.0
    noise: float = 0.0

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        if not 0.0 < self.fov <= 2.0 * math.pi:
            raise ValueError(f"fov: expected more than 0 and at most 2 pi rad, got {self.fov}")
        if not (math.isfinite(self.depth) and self.depth > 0.0):
            raise ValueError(f"depth: expected a positive length [m], got {self.depth}")
        if not (math.isfinite(self.noise) and self.noise >= 0.0):
            raise ValueError(f"noise: expected 0 or more [1/m], got {self.noise}")

    @property
    def area(self) -> float:
        """Area of the sector [m^2]."""
        return 0.5 * self.fov * self.depth**2


class PlanarScan(NamedTuple):
    """What one range scan saw.

    Attributes:
        passed: (rows, columns) cells that a beam went through.
        hit: (rows, columns) cells that a beam came back from.
    """

    passed: BoolArray
    hit: BoolArray


def scan(
    occupied: BoolArray,
    grid: Grid,
    cell: tuple[int, int],
    heading: float,
    sensor: RangeSensor,
    generator: np.random.Generator | None = None,
) -> PlanarScan:
    """Simulate a range scan.

    A beam goes towards every cell of the sector, on to the depth of field or the first occupied
    cell. So each cell whose centre is in the sector and in line of sight is seen, and nothing that
    no line of sight reaches.

    Args:
        occupied: (rows, columns) the world.
        grid: Cells of the map.
        cell: Row and column of the sensor.
        heading: Direction of the sector's middle, from the x axis [rad].
        sensor: Field of view, depth of field and noise.
        generator: Random generator for the noise of ranges; not needed without noise.

    Returns:
        What was measured.

    Raises:
        ValueError: If the world has another shape, the sensor is outside or inside an obstacle, or
            noise is asked for without a generator.
    """
    if occupied.shape != grid.shape:
        raise ValueError(f"occupied: expected shape {grid.shape}, got {occupied.shape}")
    row, column = cell
    if not (0 <= row < grid.rows and 0 <= column < grid.columns):
        raise ValueError(f"cell {cell}: outside the map of {grid.shape}")
    if occupied[row, column]:
        raise ValueError(f"cell {cell}: the sensor stands in an obstacle")
    if sensor.noise > 0.0 and generator is None:
        raise ValueError("generator: needed for a sensor with noise")
    table = beams(sensor.depth, grid.cell)
    away = np.abs((table.directions - heading + math.pi) % (2.0 * math.pi) - math.pi)
    chosen = np.flatnonzero(away <= sensor.fov / 2.0 + SECTOR_SLACK)
    deviations = np.zeros(chosen.size)
    if generator is not None and sensor.noise > 0.0:
        deviations = sensor.noise * generator.standard_normal(chosen.size)
    passed, hit = np.zeros(grid.shape, dtype=bool), np.zeros(grid.shape, dtype=bool)
    seen = PlanarScan(passed, hit)
    _scan(occupied, (row, column), chosen, deviations, sensor.depth, table, seen)
    passed[row, column] = True
    return seen


def ray_sums(values: FloatArray, opaque: BoolArray, cells: IntArray, table: Fan) -> FloatArray:
    """Sum values times area along every ray of a fan, as far as the first opaque cell.

    Args:
        values: (layers, rows, columns) worth of each cell by area [1/m^2].
        opaque: (rows, columns) cells that stop a ray; they are not counted.
        cells: (n, 2) rows and columns of the viewpoints.
        table: The fan.

    Returns:
        (layers, n, rays) sums.

    Raises:
        ValueError: If the values are not of the cells that are opaque or not.
    """
    if values.ndim != 3 or values.shape[1:] != opaque.shape:
        expected = ", ".join(map(str, opaque.shape))
        raise ValueError(f"values: expected shape (layers, {expected}), got {values.shape}")
    return _ray_sums(values, opaque, cells, table)


def expected_view(
    opaque: BoolArray, cell: tuple[int, int], heading: float, fov: float, table: Fan
) -> BoolArray:
    """Return the cells (rows, columns) that a view should see, by what is known to be opaque.

    Args:
        opaque: (rows, columns) cells that stop a ray.
        cell: Row and column of the viewpoint.
        heading: Direction of the sector's middle, from the x axis [rad].
        fov: Field of view [rad].
        table: A fan of the sensor's depth of field.
    """
    width, _ = sector_rays(fov, 1, table.rays)
    first = round(heading / (2.0 * math.pi) * table.rays) - width // 2
    seen = np.zeros(opaque.shape, dtype=bool)
    _mark(opaque, (cell[0], cell[1]), first, width, table, seen)
    return seen


def sector_sums(sums: FloatArray, fov: float, headings: int) -> FloatArray:
    """Turn sums along rays into sums over the sectors of all headings, by sliding.

    Args:
        sums: (..., rays) sums along the rays of a fan; ``rays`` is a multiple of ``headings``.
        fov: Field of view [rad]; taken as the nearest whole number of rays.
        headings: Number of headings; heading k is 2 pi k / headings.

    Returns:
        (..., headings) sums.
    """
    rays = sums.shape[-1]
    width, first = sector_rays(fov, headings, rays)
    total = np.concatenate([np.zeros((*sums.shape[:-1], 1)), np.cumsum(sums, axis=-1)], axis=-1)
    last = first + width
    wrapped = total[..., last % rays] + (last // rays) * total[..., -1:]
    begun = total[..., first % rays] + (first // rays) * total[..., -1:]
    return wrapped - begun


def sector_rays(fov: float, headings: int, rays: int) -> tuple[int, IntArray]:
    """Return how many rays a sector takes, and the first ray of each heading's (may be negative).

    Raises:
        ValueError: If the rays are not a multiple of the headings.
    """
    if headings < 1 or rays % headings:
        raise ValueError(f"rays: expected a multiple of the {headings} headings, got {rays}")
    width = max(1, min(rays, round(fov / (2.0 * math.pi) * rays)))
    middle = np.arange(headings, dtype=np.int64) * (rays // headings)
    return width, middle - width // 2


@_njit
def _scan(
    occupied: BoolArray,
    cell: tuple[int, int],
    chosen: IntArray,
    deviations: FloatArray,
    depth: float,
    table: Beams,
    seen: PlanarScan,
) -> None:
    """Follow the chosen beams and mark what they measure."""
    row, column = cell
    starts, offsets, kinds = table.starts, table.offsets, table.kinds
    entries, exits = table.entries, table.exits
    passed, hit = seen.passed, seen.hit
    rows, columns = occupied.shape
    for i in range(chosen.size):
        first, last = starts[chosen[i]], starts[chosen[i] + 1]
        measured = np.inf
        for k in range(first, last):
            r, c = row + offsets[k, 0], column + offsets[k, 1]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                if kinds[k] == TOUCHED:
                    continue
                last = k
                break
            if occupied[r, c]:
                if deviations[i] == 0.0:
                    hit[r, c] = True
                    last = k
                else:
                    # The middle of the chord, so that a range without error falls into the cell.
                    middle = 0.5 * (entries[k] + exits[k])
                    measured = max(middle + deviations[i] * middle * middle, 0.0)
                break
        for k in range(first, last):
            r, c = row + offsets[k, 0], column + offsets[k, 1]
            if r < 0 or r >= rows or c < 0 or c >= columns:
                continue
            if kinds[k] != TOUCHED and exits[k] > measured:
                if measured <= depth and k > first:
                    hit[r, c] = True
                break
            if kinds[k] == FULL:
                passed[r, c] = True


@_njit
def _ray_sums(values: FloatArray, opaque: BoolArray, cells: IntArray, table: Fan) -> FloatArray:
    starts, offsets, areas = table.starts, table.offsets, table.areas
    layers, rows, columns = values.shape
    rays = starts.size - 1
    sums = np.zeros((layers, cells.shape[0], rays))
    for n in range(cells.shape[0]):
        for ray in range(rays):
            for k in range(starts[ray], starts[ray + 1]):
                r, c = cells[n, 0] + offsets[k, 0], cells[n, 1] + offsets[k, 1]
                if r < 0 or r >= rows or c < 0 or c >= columns or opaque[r, c]:
                    break
                for layer in range(layers):
                    sums[layer, n, ray] += values[layer, r, c] * areas[k]
    return sums


@_njit
def _mark(
    opaque: BoolArray, cell: tuple[int, int], first: int, width: int, table: Fan, seen: BoolArray
) -> None:
    (row, column), starts, offsets = cell, table.starts, table.offsets
    rows, columns = opaque.shape
    rays = starts.size - 1
    for i in range(width):
        ray = (first + i) % rays
        for k in range(starts[ray], starts[ray + 1]):
            r, c = row + offsets[k, 0], column + offsets[k, 1]
            if r < 0 or r >= rows or c < 0 or c >= columns or opaque[r, c]:
                break
            seen[r, c] = True
