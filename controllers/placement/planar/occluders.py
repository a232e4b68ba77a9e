"""Occluders on the plane: clusters of a map, and their expansion by the target.

Thesis section 4.2.3.3 (i) and (ii). Expanding an occluder by the mirrored target shrinks the
target to a point: if the line from camera to that point misses the hull of the sum, the whole
target is visible.

On an occupancy map, clusters of occupied cells are occluders. The hull of a cluster that is not
convex, for instance the wall of a room, would hide free space within it. So a cluster is halved
across its longer side until its cells fill most of their hull.
"""

import contextlib
import dataclasses
from collections.abc import Sequence

import numba
import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from controllers.placement.planar.field import HullCorners
from controllers.placement.planar.sight import OCCUPIED_ABOVE, KnownSpace, own_cells
from controllers.placement.task import Occluder, Target
from perception.geometry.arrays import FloatArray, IntArray

FLAT = 1e-9
"""Area of a hull over its circumference squared below which the hull is flat."""
MIN_HULL_FILL = 0.85
"""Share of a hull that the cells of its cluster must fill."""
MAX_UNDIVIDED_CELLS = 2
"""Width and height up to which a cluster is not halved [cells]."""
_CELL_CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


@dataclasses.dataclass(frozen=True)
class ExpandedOccluders:
    """Expanded occluders as seen from one target.

    Attributes:
        names: Names of the occluders, one for each hull.
        hulls: Corners of the hulls, from the target.
    """

    names: tuple[str, ...]
    hulls: HullCorners

    def hull(self, index: int) -> FloatArray:
        """Return the corners (K, 2) of one hull [m], from the target."""
        points, starts = self.hulls
        return points[starts[index] : starts[index + 1]]


def _hull_corners(name: str, points: FloatArray) -> FloatArray:
    """Return the corners (K, 2) of points' convex hull [m], anticlockwise.

    Args:
        name: Name of the occluder, for the error.
        points: (N, 2) points of the expanded occluder [m].

    Raises:
        ValueError: If all points are in one line or at one place.
    """
    hull = None
    with contextlib.suppress(QhullError, ValueError):
        hull = ConvexHull(points)
    if hull is None or hull.volume <= FLAT * hull.area**2:
        raise ValueError(
            f"occluder {name!r}: its {len(points)} points are in one line with nothing to widen "
            "them; give it a thickness"
        )
    return points[hull.vertices]


def expand(occluders: Sequence[Occluder], target: Target) -> ExpandedOccluders:
    """Expand occluders by a target: hull of the Minkowski sum with the mirrored outline.

    An occluder may be a line, where the target's outline gives the sum an area.

    Args:
        occluders: Planar occluders.
        target: Planar target.

    Raises:
        ValueError: If the target or an occluder is not planar, or a sum is flat; the message names
            the offender.
    """
    if len(target.position) != 2:  # noqa: PLR2004
        raise ValueError(f"target {target.name!r}: has three coordinates, expected a planar one")
    hulls: list[FloatArray] = []
    for occluder in occluders:
        if occluder.points.shape[1] != 2:  # noqa: PLR2004
            raise ValueError(f"occluder {occluder.name!r}: has three coordinates, expected two")
        sums = (occluder.points - target.position)[:, None] - target.outline
        hulls.append(_hull_corners(occluder.name, sums.reshape(-1, 2)))
    starts = np.cumsum([0, *(len(hull) for hull in hulls)]).astype(np.int64)
    points = np.concatenate(hulls) if hulls else np.zeros((0, 2))
    names = tuple(occluder.name for occluder in occluders)
    return ExpandedOccluders(names, HullCorners(np.ascontiguousarray(points), starts))


@numba.njit(cache=True)
def convex_sum(first: FloatArray, second: FloatArray, out: FloatArray) -> int:
    """Write the Minkowski sum of two convex polygons by merging their edges by direction.

    For scenes drawn by the thousand, where no general hull is needed.

    Args:
        first: (N, 2) corners of one polygon, anticlockwise; two corners are a line.
        second: (M, 2) corners of the other polygon, anticlockwise.
        out: (N + M, 2) receives the corners of the sum, anticlockwise.

    Returns:
        Number of corners of the sum.
    """
    n, m = len(first), len(second)
    i, j = _lowest(first), _lowest(second)
    a = b = count = 0
    while a < n or b < m:
        p, q = (i + a) % n, (j + b) % m
        out[count, 0] = first[p, 0] + second[q, 0]
        out[count, 1] = first[p, 1] + second[q, 1]
        count += 1
        p2, q2 = (p + 1) % n, (q + 1) % m
        # Both begin at their lowest corners, so the edges' directions rise from 0 to a full turn.
        down_first, down_second = _downwards(first, p, p2), _downwards(second, q, q2)
        turn = (first[p2, 0] - first[p, 0]) * (second[q2, 1] - second[q, 1]) - (
            first[p2, 1] - first[p, 1]
        ) * (second[q2, 0] - second[q, 0])
        before = down_second if down_first != down_second else turn >= 0.0
        if b >= m or (a < n and before):
            a += 1
        else:
            b += 1
    return count


@numba.njit(cache=True)
def _lowest(corners: FloatArray) -> int:
    """Return the index of the lowest corner (K, 2), the leftmost one of several."""
    low = 0
    for k in range(1, len(corners)):
        if _downwards(corners, low, k):
            low = k
    return low


@numba.njit(cache=True)
def _downwards(corners: FloatArray, a: int, b: int) -> bool:
    """Return whether an edge's direction is half a turn or more."""
    dy = corners[b, 1] - corners[a, 1]
    return dy < 0.0 or (dy == 0.0 and corners[b, 0] < corners[a, 0])


def occluders_of_map(space: KnownSpace, targets: Sequence[Target] = ()) -> tuple[Occluder, ...]:
    """Return the hulls of the clusters of occupied cells, P > 0.5, of a map.

    Args:
        space: Occupancy map.
        targets: Targets whose own cells, those that touch their outlines, are no occluders.

    Returns:
        Occluders in the world, named ``cluster 1``, ``cluster 2`` and so on; parts of one cluster
        are named ``cluster 1.1``, ``cluster 1.2``.
    """
    opaque = space.probability > OCCUPIED_ABOVE
    for target in targets:
        opaque &= ~own_cells(space, target)
    labels, _ = ndimage.label(opaque, structure=np.ones((3, 3)))
    occluders: list[Occluder] = []
    for number, window in enumerate(ndimage.find_objects(labels), start=1):
        first = [side.start for side in window]
        parts = _halved(np.argwhere(labels[window] == number) + first)
        for index, corners in enumerate(parts, start=1):
            name = f"cluster {number}" + (f".{index}" if len(parts) > 1 else "")
            occluders.append(Occluder(name, corners[:, ::-1] * space.cell + space.origin))
    return tuple(occluders)


def _halved(cells: IntArray) -> list[FloatArray]:
    """Return hull corners (K, 2) (row, column) of cells, or of their halves."""
    corners, area = _hull(cells)
    extent = cells.max(axis=0) - cells.min(axis=0) + 1
    if len(cells) >= MIN_HULL_FILL * area or extent.max() <= MAX_UNDIVIDED_CELLS:
        return [corners]
    axis = int(np.argmax(extent))
    middle = cells[:, axis].min() + extent[axis] // 2
    below = cells[:, axis] < middle
    return _halved(cells[below]) + _halved(cells[~below])


def _hull(cells: IntArray) -> tuple[FloatArray, float]:
    """Return hull corners (K, 2) of whole cells and the hull's area, in cells."""
    points = (cells[:, None] + _CELL_CORNERS).reshape(-1, 2).astype(float)
    hull = ConvexHull(points)
    return points[hull.vertices], float(hull.volume)
