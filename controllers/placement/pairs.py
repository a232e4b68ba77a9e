"""Where to put two cameras at once, so that neither hides the other's view nor sees the same.

The thesis places one vision system after the other; here both are chosen together. Each camera has
a body, a rod from its lens straight back, which is an occluder for the other one and must not touch
it. Two cameras on the same target must look at it from directions far enough apart. Of all such
pairs of candidates the one with the largest product of ratings is returned.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.placement.spatial.occluders import TargetField
from controllers.placement.spatial.search import (
    DEFAULT,
    Occupancy,
    Rated,
    SearchConfig,
    rate_directions,
    rate_positions,
)
from controllers.placement.task import Lens, PlacementError, View

FloatArray = NDArray[np.float64]

SEPARATION = np.deg2rad(30.0)
"""Between the directions in which two cameras see the same target [rad]."""


@dataclasses.dataclass(frozen=True)
class VisionSystem:
    """A camera with what it is carried by.

    Attributes:
        name: Used in answers.
        lens: Its lens.
        body_radius: Of the rod that stands for housing and arm [m].
        body_length: Of that rod, from the lens' principal node straight back [m].
    """

    name: str
    lens: Lens
    body_radius: float = 0.03
    body_length: float = 0.15

    def __post_init__(self) -> None:
        """Refuse impossible bodies.

        Raises:
            ValueError: Naming the system.
        """
        if not (0.0 < self.body_radius < np.inf and 0.0 <= self.body_length < np.inf):
            raise ValueError(
                f"vision system {self.name!r}: body of radius {self.body_radius} m and length "
                f"{self.body_length} m, expected a radius above 0 and a length from 0"
            )


def best_pair(
    fields: Sequence[TargetField],
    systems: tuple[VisionSystem, VisionSystem],
    occupancy: Occupancy | None = None,
    separation: float = SEPARATION,
    config: SearchConfig = DEFAULT,
) -> tuple[View, View]:
    """Return the pair of views with the best product of ratings.

    The candidates of a system are all directions of `config` about each target, each at its best
    distance; over all pairs of them the answer is exact.

    Args:
        fields: The targets with what may hide them; each system may watch any of them.
        systems: The two cameras.
        occupancy: As for `spatial_search.best_view`.
        separation: Least angle between two cameras' directions to the same target [rad].
        config: What is tried; `refine` has no effect.

    Raises:
        PlacementError: If one of the systems sees no target, or no two views go together.
    """
    ways = [rate_directions(fields, s.lens, occupancy, config) for s in systems]
    reaches = np.array([np.linalg.norm(f.target.outline, axis=1).max() for f in fields])
    spots = np.array([f.target.position for f in fields])
    bodies = np.array([(s.body_radius, s.body_length) for s in systems])
    first, second = _search(ways[0], ways[1], spots, reaches, bodies, np.cos(separation))
    if first < 0:
        names = " and ".join(repr(s.name) for s in systems)
        raise PlacementError(
            f"no two poses go together for {names}: of {len(ways[0].ratings)} and "
            f"{len(ways[1].ratings)} that see a target, every pair is less than "
            f"{np.rad2deg(separation):g} deg apart, touches or hides the other's view"
        )
    views: list[View] = []
    for system, way, index in zip(systems, ways, (first, second)):
        field = fields[int(way.fields[index])]
        place = way.positions[index][None]
        views += rate_positions(field, system.lens, place, occupancy, config.exponents)
    return views[0], views[1]


def go_together(
    fields: Sequence[TargetField],
    systems: tuple[VisionSystem, VisionSystem],
    views: tuple[View, View],
    separation: float = SEPARATION,
) -> bool:
    """Tell whether two views keep clear of each other, as `best_pair` demands."""
    names = [field.target.name for field in fields]
    numbers = [names.index(view.target) for view in views]
    reaches = np.array([np.linalg.norm(f.target.outline, axis=1).max() for f in fields])
    spots = np.array([f.target.position for f in fields])
    bodies = np.array([(s.body_radius, s.body_length) for s in systems])
    a, b = (np.asarray(view.position, dtype=float) for view in views)
    i, j = numbers
    return bool(_together(
        a, i, b, j, spots, reaches, bodies, np.cos(separation)
    ))  # fmt: skip


def _search(
    first: Rated, second: Rated, spots: FloatArray, reaches: FloatArray, bodies: FloatArray,
    cosine: float,
) -> tuple[int, int]:  # fmt: skip
    return _best(
        first.ratings, first.positions, first.fields,
        second.ratings, second.positions, second.fields, spots, reaches, bodies, cosine,
    )  # fmt: skip


@numba.njit(cache=True)
def _best(ratings, places, targets, others, their, theirs, spots, reaches, bodies, cosine):
    """Return the best pair of two lists in falling order of rating; -1, -1 if none is left."""
    best, first, second = 0.0, -1, -1
    for i in range(len(ratings)):
        if len(others) == 0 or ratings[i] * others[0] <= best:
            break
        for j in range(len(others)):
            if ratings[i] * others[j] <= best:
                break
            if _together(
                places[i], targets[i], their[j], theirs[j], spots, reaches, bodies, cosine
            ):
                best, first, second = ratings[i] * others[j], i, j
                break
    return first, second


@numba.njit(cache=True)
def _together(a, i, b, j, spots, reaches, bodies, cosine):
    """Whether camera a on target i and camera b on target j keep clear of each other."""
    p, q = spots[i], spots[j]
    u, v = (a - p) / np.linalg.norm(a - p), (b - q) / np.linalg.norm(b - q)
    if i == j and np.dot(u, v) > cosine:
        return False
    behind_a, behind_b = a + bodies[0, 1] * u, b + bodies[1, 1] * v
    if _apart(a, behind_a, b, behind_b) <= bodies[0, 0] + bodies[1, 0]:
        return False
    # The other's lines of sight fill no more than a rod as thick as its target.
    if _apart(b, q, a, behind_a) <= bodies[0, 0] + reaches[j]:
        return False
    return _apart(a, p, b, behind_b) > bodies[1, 0] + reaches[i]


@numba.njit(cache=True)
def _apart(a, b, c, d):
    """Return the distance between the segments a to b and c to d, by clamping."""
    u, v, w = b - a, d - c, a - c
    uu, uv, vv = np.dot(u, u), np.dot(u, v), np.dot(v, v)
    uw, vw = np.dot(u, w), np.dot(v, w)
    least = np.inf
    across = uu * vv - uv * uv
    if across > 1e-12 * uu * vv:
        s, t = (uv * vw - vv * uw) / across, (uu * vw - uv * uw) / across
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            return np.linalg.norm(w + s * u - t * v)
    # Else the nearest points are at an end of one of them.
    for end in (0.0, 1.0):
        t = min(max((vw + end * uv) / vv, 0.0), 1.0) if vv > 0.0 else 0.0
        least = min(least, np.linalg.norm(w + end * u - t * v))
        s = min(max((end * uv - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
        least = min(least, np.linalg.norm(w + s * u - end * v))
    return least
