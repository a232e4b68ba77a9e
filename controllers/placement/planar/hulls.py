"""Occluders on the plane and their expansion by the target (thesis 4.2.3.3 (i) and (ii)).

Expanding an occluder by the mirrored target shrinks the target to a point: if the line from camera
to that point misses the hull of the sum, the whole target is visible.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from controllers.placement.task import FloatArray, Target

IntArray = NDArray[np.int64]

FLAT = 1e-9
"""A sum of occluder and target is flat if its area is less of its circumference squared."""

# The compiler's decorator has no types.
_njit: Any = numba.njit(cache=True)


@dataclasses.dataclass(frozen=True)
class Occluder:
    """Something that may hide a target on the plane.

    Attributes:
        name: Used in answers and errors.
        points: (K, 2) points whose convex hull is the occluder [m], world.
    """

    name: str
    points: FloatArray

    def __post_init__(self) -> None:
        """Check and freeze the points.

        Raises:
            ValueError: Naming the occluder.
        """
        points = np.array(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:  # noqa: PLR2004
            raise ValueError(f"occluder {self.name!r}: points {points.shape}, expected (K, 2)")
        if not np.all(np.isfinite(points)):
            raise ValueError(f"occluder {self.name!r}: a coordinate is not finite")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)


@dataclasses.dataclass(frozen=True)
class Hulls:
    """Expanded occluders as seen from one target.

    Attributes:
        names: Of the occluders.
        points: (V, 2) corners of all hulls [m], from the target, each hull anticlockwise.
        starts: (H + 1,) where each hull's corners begin.
    """

    names: tuple[str, ...]
    points: FloatArray
    starts: IntArray

    def hull(self, index: int) -> FloatArray:
        """Return one hull's corners (K, 2) [m], from the target."""
        return self.points[self.starts[index] : self.starts[index + 1]]


def hull_corners(name: str, points: FloatArray) -> FloatArray:
    """Return the corners (K, 2) of points' convex hull [m], anticlockwise.

    Args:
        name: Of whose hull it is, for the error.
        points: (N, 2) [m].

    Raises:
        ValueError: If all points are in one line or at one place.
    """
    flat = f"occluder {name!r}: its {len(points)} points are in one line with nothing to widen them"
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise ValueError(flat + "; give it a thickness") from None
    if hull.volume <= FLAT * hull.area**2:
        raise ValueError(flat + "; give it a thickness")
    return points[hull.vertices]


def expand(occluders: Sequence[Occluder], target: Target) -> Hulls:
    """Expand occluders by a target: hull of the Minkowski sum with the mirrored outline.

    An occluder may be a line, where the target's outline gives the sum an area.

    Args:
        occluders: On the plane.
        target: On the plane.

    Returns:
        The hulls, relative to the target's position.

    Raises:
        ValueError: If the target is not on the plane, or a sum is flat; it names the offender.
    """
    if len(target.position) != 2:  # noqa: PLR2004
        raise ValueError(f"target {target.name!r}: has three coordinates, expected a planar one")
    hulls: list[FloatArray] = []
    for occluder in occluders:
        sums = (occluder.points - target.position)[:, None] - target.outline
        hulls.append(hull_corners(occluder.name, sums.reshape(-1, 2)))
    starts = np.cumsum([0, *(len(hull) for hull in hulls)]).astype(np.int64)
    points = np.concatenate(hulls) if hulls else np.zeros((0, 2))
    return Hulls(tuple(o.name for o in occluders), np.ascontiguousarray(points), starts)


@_njit
def convex_sum(first: FloatArray, second: FloatArray, out: FloatArray) -> int:
    """Write the Minkowski sum of two convex polygons by merging their edges by direction.

    For scenes drawn by the thousand, where no general hull is needed.

    Args:
        first: (N, 2) corners anticlockwise; two corners are a line.
        second: (M, 2) corners anticlockwise.
        out: (N + M, 2) takes the corners, anticlockwise.

    Returns:
        How many corners the sum has.
    """
    n, m = len(first), len(second)
    i = j = 0
    for k in range(1, n):
        if first[k, 1] < first[i, 1] or (first[k, 1] == first[i, 1] and first[k, 0] < first[i, 0]):
            i = k
    for k in range(1, m):
        if second[k, 1] < second[j, 1] or (
            second[k, 1] == second[j, 1] and second[k, 0] < second[j, 0]
        ):
            j = k
    a = b = count = 0
    while a < n or b < m:
        p, q = (i + a) % n, (j + b) % m
        out[count, 0] = first[p, 0] + second[q, 0]
        out[count, 1] = first[p, 1] + second[q, 1]
        count += 1
        p2, q2 = (p + 1) % n, (q + 1) % m
        turn = (first[p2, 0] - first[p, 0]) * (second[q2, 1] - second[q, 1]) - (
            first[p2, 1] - first[p, 1]
        ) * (second[q2, 0] - second[q, 0])
        # Both begin at their lowest corners, so the edges' directions rise from 0 to a full turn.
        if b >= m or (a < n and _before(first, p, p2, second, q, q2, turn)):
            a += 1
        else:
            b += 1
    return count


@_njit
def _before(
    first: FloatArray, p: int, p2: int, second: FloatArray, q: int, q2: int, turn: float
) -> bool:
    """Tell whether one edge's direction, from 0 to a full turn, comes before another's."""
    down_first = _downwards(first, p, p2)
    down_second = _downwards(second, q, q2)
    if down_first != down_second:
        return down_second
    return turn >= 0.0


@_njit
def _downwards(corners: FloatArray, a: int, b: int) -> bool:
    """Tell whether an edge's direction is from half a turn on."""
    dy = corners[b, 1] - corners[a, 1]
    return dy < 0.0 or (dy == 0.0 and corners[b, 0] < corners[a, 0])
