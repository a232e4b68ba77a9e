"""The occupancy map of the plane, and exact visibility of a whole target.

Lines of sight from a camera to all of a convex target fill the convex hull of both, so the target
is wholly visible exactly if that hull meets no occluder. For convex occluders that is decided by
separating axes; on a map by tracing lines of sight from cell to cell. It measures the views
that are lost by expanding the occluders (figure 4-6).
"""

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.placement.task import Target
from perception.geometry.arrays import FloatArray

OCCUPIED_ABOVE = 0.5
"""Probability of occupancy above which a cell hides what is behind it."""
LINES = 33
"""Lines of sight to each side of a target on a map."""


@dataclasses.dataclass(frozen=True)
class KnownSpace:
    """Occupancy map of the plane.

    Attributes:
        probability: (rows, columns) probability of occupancy; the cell of row r and column c is
            the square with its lowest corner at ``origin + cell * (c, r)``. Space outside is
            unknown.
        cell: Side of a cell [m].
        origin: x and y of the first cell's lowest corner [m], world.

    Raises:
        ValueError: If the map is malformed; the message says what is expected.
    """

    probability: FloatArray
    cell: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = np.ascontiguousarray(self.probability, dtype=float)
        if values.ndim != 2 or values.size == 0:  # noqa: PLR2004
            raise ValueError(f"probability: shape {values.shape}, expected (rows, columns)")
        if not np.all((values >= 0.0) & (values <= 1.0)):
            raise ValueError("probability: expected numbers from 0 to 1")
        if not (math.isfinite(self.cell) and self.cell > 0.0):
            raise ValueError(f"cell {self.cell} m: expected a positive length")
        object.__setattr__(self, "probability", values)


@numba.njit(cache=True)
def separated(x: float, y: float, outline: FloatArray, corners: FloatArray) -> bool:
    """Return whether the hull of camera and target misses a convex occluder.

    Axes are the normals of the occluder's and the target's sides and of the lines from the camera
    to the target's corners; all sides of the hull are among them.

    Args:
        x: x of the camera [m], world.
        y: y of the camera [m], world.
        outline: (K, 2) corners of the target in order [m], world.
        corners: (V, 2) corners of the occluder in order [m], world.
    """
    sides, lines = len(corners), len(outline)
    for axis in range(sides + 2 * lines):
        if axis < sides:
            ex = corners[(axis + 1) % sides, 0] - corners[axis, 0]
            ey = corners[(axis + 1) % sides, 1] - corners[axis, 1]
        elif axis < sides + lines:
            i = axis - sides
            ex = outline[(i + 1) % lines, 0] - outline[i, 0]
            ey = outline[(i + 1) % lines, 1] - outline[i, 1]
        else:
            ex = outline[axis - sides - lines, 0] - x
            ey = outline[axis - sides - lines, 1] - y
        low = high = ex * y - ey * x
        for i in range(lines):
            value = ex * outline[i, 1] - ey * outline[i, 0]
            low, high = min(low, value), max(high, value)
        below = above = ex * corners[0, 1] - ey * corners[0, 0]
        for i in range(1, sides):
            value = ex * corners[i, 1] - ey * corners[i, 0]
            below, above = min(below, value), max(above, value)
        if high < below or above < low:
            return True
    return False


def sees_on_map(
    space: KnownSpace, position: FloatArray, target: Target, lines: int = LINES
) -> bool:
    """Return whether lines of sight to a target's outline miss all occupied cells but its own.

    Args:
        space: Occupancy map; a cell hides what is behind it if P > 0.5.
        position: (2,) camera position [m], world.
        target: Planar target with the points of its outline in order.
        lines: Number of lines of sight to each side of the outline.
    """
    outline = target.position + target.outline
    step = np.linspace(0.0, 1.0, lines)[:, None]
    ends = np.concatenate([a + step * (b - a) for a, b in zip(outline, np.roll(outline, -1, 0))])
    opaque = (space.probability > OCCUPIED_ABOVE) & ~own_cells(space, target)
    start = (np.asarray(position, dtype=float) - space.origin) / space.cell
    ends = (ends - space.origin) / space.cell
    return all(clear_line(opaque, *start, *end) for end in ends)


def own_cells(space: KnownSpace, target: Target) -> NDArray[np.bool_]:
    """Return the cells (rows, columns) that the box about a target's outline touches."""
    outline = (target.position + target.outline - space.origin) / space.cell
    low = np.floor(outline.min(axis=0) - 1e-9).astype(int).clip(0)
    high = np.floor(outline.max(axis=0) + 1e-9).astype(int).clip(-1) + 1
    own = np.zeros(space.probability.shape, dtype=bool)
    own[low[1] : high[1], low[0] : high[0]] = True
    return own


@numba.njit(cache=True)
def clear_line(opaque: NDArray[np.bool_], x: float, y: float, x_end: float, y_end: float) -> bool:
    """Return whether a line crosses no opaque cell; outside the map nothing is opaque.

    Args:
        opaque: (rows, columns) cells that block the line.
        x: x of the start [cells].
        y: y of the start [cells].
        x_end: x of the end [cells].
        y_end: y of the end [cells].
    """
    rows, columns = opaque.shape
    column, row = math.floor(x), math.floor(y)
    dx, dy = x_end - x, y_end - y
    step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    next_x = (column + (dx > 0) - x) / dx if dx != 0.0 else np.inf
    next_y = (row + (dy > 0) - y) / dy if dy != 0.0 else np.inf
    while True:
        if 0 <= row < rows and 0 <= column < columns and opaque[row, column]:
            return False
        if min(next_x, next_y) > 1.0:
            return True
        if next_x < next_y:
            column += step_x
            next_x += abs(1.0 / dx)
        else:
            row += step_y
            next_y += abs(1.0 / dy)
