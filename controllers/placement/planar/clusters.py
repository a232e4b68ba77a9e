"""Occluders from a planar occupancy map: clusters of occupied cells.

The hull of a cluster that is not convex, a room's wall for instance, would hide what stands free
in it. So a cluster is halved across its longer side until its cells fill most of their hull.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

from controllers.placement.planar.hulls import Occluder
from controllers.placement.planar.search import KnownSpace
from controllers.placement.planar.sight import OCCUPIED_ABOVE, own_cells
from controllers.placement.task import FloatArray, Target

Cells = NDArray[np.int64]

FILLED = 0.85
"""Share of a hull that its cells must fill."""
SMALLEST = 2
"""A cluster no more cells wide and high is not halved."""
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])


def occluders_of_map(
    space: KnownSpace, targets: Sequence[Target] = (), filled: float = FILLED
) -> tuple[Occluder, ...]:
    """Gather the occupied cells, P > 0.5, in clusters and return each cluster's hull.

    Args:
        space: The map.
        targets: Cells that touch these targets' outlines are the targets' own, no occluders.
        filled: Share of a hull that its cells must fill, or the cluster is halved; 0 keeps all
            whole.

    Returns:
        Their corners in the world, named ``cluster 1``, ``cluster 2`` and so on; parts of one
        cluster as ``cluster 1.1``.

    Raises:
        ValueError: If ``filled`` is not from 0 up to below 1.
    """
    if not 0.0 <= filled < 1.0:
        raise ValueError(f"filled {filled}: expected from 0 up to below 1")
    opaque = space.probability > OCCUPIED_ABOVE
    for target in targets:
        opaque &= ~own_cells(space, target)
    labels, _ = ndimage.label(opaque, structure=np.ones((3, 3)))
    occluders: list[Occluder] = []
    for number, window in enumerate(ndimage.find_objects(labels), start=1):
        first = np.array([window[0].start, window[1].start])
        parts = _halve(np.argwhere(labels[window] == number) + first, filled)
        for index, corners in enumerate(parts, start=1):
            name = f"cluster {number}" + (f".{index}" if len(parts) > 1 else "")
            world = corners[:, ::-1] * space.cell + np.asarray(space.origin)
            occluders.append(Occluder(name, world))
    return tuple(occluders)


def _halve(cells: Cells, filled: float) -> list[FloatArray]:
    """Return hull corners (K, 2) (row, column) of cells, or of their halves."""
    corners, area = _hull(cells)
    extent = cells.max(axis=0) - cells.min(axis=0) + 1
    if len(cells) >= filled * area or extent.max() <= SMALLEST:
        return [corners]
    axis = int(np.argmax(extent))
    middle = cells[:, axis].min() + extent[axis] // 2
    below = cells[:, axis] < middle
    return _halve(cells[below], filled) + _halve(cells[~below], filled)


def _hull(cells: Cells) -> tuple[FloatArray, float]:
    """Return hull corners (K, 2) of whole cells and the hull's area, in cells.

    Only the first and the last cell of a row can be at the hull.
    """
    low, high = cells.min(axis=0), cells.max(axis=0) + 1
    if len(cells) == np.prod(high - low):
        box = np.array([low, [low[0], high[1]], high, [high[0], low[1]]], dtype=float)
        return box, float(len(cells))
    order = np.lexsort((cells[:, 1], cells[:, 0]))
    cells = cells[order]
    new_row = np.diff(cells[:, 0]) != 0
    ends = cells[np.r_[True, new_row] | np.r_[new_row, True]]
    points = (ends[:, None] + CORNERS).reshape(-1, 2).astype(float)
    hull = ConvexHull(points)
    return points[hull.vertices], float(hull.volume)
