"""Lines of sight on a planar grid: what a range scan sees, and how much a view would cover."""

import dataclasses
import math
from typing import Any, NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.planar.beams import Beams, Fan, beams
from perception.planar.map import Grid

SECTOR_SLACK = 1e-9
"""Directions on the edge of a sector belong to it [rad]."""

# The compiler's decorator has no types.
_njit: Any = numba.njit(cache=True)


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
        cells: (n, 2) rows and columns to look from.
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
        cell: Row and column to look from.
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
                if kinds[k] == 1:
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
            if kinds[k] != 1 and exits[k] > measured:
                if measured <= depth and k > first:
                    hit[r, c] = True
                break
            if kinds[k] == 0:
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
