"""Cells along lines of sight from a cell's centre, tabulated once.

Sensors stand at centres of cells, so the cells along every beam are the same wherever it starts.
A scan has one beam towards every cell (whole numbers, exact also through corners). A fan has even
directions; each crossed cell stands for the area (r2^2 - r1^2) dtheta / 2 of its piece of the ray's
wedge.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, IntArray

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
    """Cells along evenly spread rays, relative to the sensor's cell.

    Ray k covers the directions from k to k + 1 times 2 pi / n, and runs along their middle.

    Attributes:
        starts: (n + 1,) where each ray's cells begin in the arrays below.
        offsets: (m, 2) cells (row, column), near to far.
        areas: (m,) area that the cell stands for [m^2].
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
    lists = [_beam_cells(r, c, depth / cell) for r, c in targets]
    starts = np.concatenate([[0], np.cumsum([len(cells) for cells in lists])])
    flat = np.array([cell_ for cells in lists for cell_ in cells], dtype=float).reshape(-1, 5)
    directions = np.array([math.atan2(r, c) for r, c in targets])
    return Beams(
        directions,
        starts.astype(np.int64),
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
        leave = (2 * kc + 1) / (2 * ac) if along_c else (2 * kr + 1) / (2 * ar)
        leave *= length
        kind = FULL if math.hypot(r, c) <= depth + 1e-9 else BEYOND
        cells.append((r, c, kind, entry, leave))
        if along_c and along_r and leave <= depth:
            # Through a corner: either neighbour would stop the beam.
            cells.append((r, c + step_c, TOUCHED, leave, leave))
            cells.append((r + step_r, c, TOUCHED, leave, leave))
        if along_c:
            c, kc = c + step_c, kc + 1
        if along_r:
            r, kr = r + step_r, kr + 1
        entry = leave
    return cells


@functools.lru_cache(maxsize=16)
def fan(depth: float, cell: float, rays: int) -> Fan:
    """Tabulate evenly spread rays.

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
    lists = [_ray_cells((k + 0.5) * step, depth / cell) for k in range(rays)]
    starts = np.concatenate([[0], np.cumsum([len(cells) for cells in lists])])
    flat = np.array([cell_ for cells in lists for cell_ in cells]).reshape(-1, 4)
    near, far = flat[:, 2] * cell, flat[:, 3] * cell
    return Fan(
        starts.astype(np.int64),
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
