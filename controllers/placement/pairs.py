"""Placement of two cameras at once, with different views that neither camera occludes.

The thesis places one vision system after the other; here both are chosen together. Each camera has
a body, a rod from its lens straight back, which is an occluder for the other one and must not touch
it. Two cameras on the same target must view it from directions far enough apart. Of all such
pairs of candidates the one with the largest product of ratings is returned.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from controllers.placement.spatial.occluders import TargetField
from controllers.placement.spatial.search import (
    DEFAULT,
    Occupancy,
    SearchConfig,
    SpatialTask,
    rate_directions,
    rate_positions,
)
from controllers.placement.task import Lens, PlacementError, View
from perception.geometry.arrays import FloatArray

SEPARATION = np.deg2rad(30.0)
"""Least angle between the directions in which two cameras see the same target [rad]."""


@dataclasses.dataclass(frozen=True)
class VisionSystem:
    """A camera with the body that carries it.

    Attributes:
        name: Name used in errors.
        lens: Lens of the camera.
        body_radius: Radius of the rod that bounds housing and arm [m].
        body_length: Length of that rod, from the lens' principal node straight back [m].

    Raises:
        ValueError: If a size is out of range; the message names the system.
    """

    name: str
    lens: Lens
    body_radius: float = 0.03
    body_length: float = 0.15

    def __post_init__(self) -> None:
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
        fields: Targets with their occluders; each system may watch any of them.
        systems: The two cameras.
        occupancy: Probability of occupancy at points; None if all is free.
        separation: Least angle between two cameras' directions to the same target [rad].
        config: Candidates and exponents; `SearchConfig.refine` has no effect.

    Raises:
        PlacementError: If one of the systems sees no target, or no two views go together.
    """
    rated = [rate_directions(SpatialTask(fields, s.lens, occupancy, config)) for s in systems]
    first, second = _best(rated[0], rated[1], _geometry(fields, systems, separation))
    if first < 0:
        names = " and ".join(repr(s.name) for s in systems)
        raise PlacementError(
            f"no two poses go together for {names}: of {len(rated[0].ratings)} and "
            f"{len(rated[1].ratings)} that see a target, every pair is less than "
            f"{np.rad2deg(separation):g} deg apart, touches or hides the other's view"
        )
    views: list[View] = []
    for system, found, index in zip(systems, rated, (first, second)):
        field, position = fields[int(found.fields[index])], found.positions[index]
        views += rate_positions(field, system.lens, position, occupancy, config.exponents)
    return views[0], views[1]


def go_together(
    fields: Sequence[TargetField],
    systems: tuple[VisionSystem, VisionSystem],
    views: tuple[View, View],
    separation: float = SEPARATION,
) -> bool:
    """Return whether two views are clear of each other, as `best_pair` requires.

    Args:
        fields: Targets with their occluders.
        systems: The two cameras.
        views: View of each camera.
        separation: Least angle between two cameras' directions to the same target [rad].
    """
    names = [field.target.name for field in fields]
    i, j = (names.index(view.target) for view in views)
    a, b = (np.asarray(view.position, dtype=float) for view in views)
    return bool(_together(_geometry(fields, systems, separation), a, i, b, j))


class PairGeometry(NamedTuple):
    """Targets and camera bodies, for compiled code.

    Attributes:
        targets: (T, 3) positions of the targets [m], world.
        target_radii: (T,) radius about its position that holds each target [m].
        body_radii: (2,) radius of each camera's body [m].
        body_lengths: (2,) length of each camera's body [m].
        max_cosine: Greatest cosine between two cameras' directions to the same target.
    """

    targets: FloatArray
    target_radii: FloatArray
    body_radii: FloatArray
    body_lengths: FloatArray
    max_cosine: float


def _geometry(
    fields: Sequence[TargetField], systems: tuple[VisionSystem, VisionSystem], separation: float
) -> PairGeometry:
    return PairGeometry(
        np.array([f.target.position for f in fields]),
        np.array([np.linalg.norm(f.target.outline, axis=1).max() for f in fields]),
        np.array([s.body_radius for s in systems]),
        np.array([s.body_length for s in systems]),
        np.cos(separation),
    )


@numba.njit(cache=True)
def _best(first, second, geometry):
    """Return the indices of the best pair of two `RatedDirections`; -1, -1 if there is none."""
    best, left, right = 0.0, -1, -1
    for i in range(len(first.ratings)):
        if len(second.ratings) == 0 or first.ratings[i] * second.ratings[0] <= best:
            break
        for j in range(len(second.ratings)):
            product = first.ratings[i] * second.ratings[j]
            if product <= best:
                break
            if _together(
                geometry, first.positions[i], first.fields[i], second.positions[j], second.fields[j]
            ):
                best, left, right = product, i, j
                break
    return left, right


@numba.njit(cache=True)
def _together(geometry, a, i, b, j):
    """Whether camera a on target i and camera b on target j keep clear of each other."""
    p, q = geometry.targets[i], geometry.targets[j]
    u, v = (a - p) / np.linalg.norm(a - p), (b - q) / np.linalg.norm(b - q)
    if i == j and np.dot(u, v) > geometry.max_cosine:
        return False
    radii, lengths = geometry.body_radii, geometry.body_lengths
    behind_a, behind_b = a + lengths[0] * u, b + lengths[1] * v
    if _apart(a, behind_a, b, behind_b) <= radii[0] + radii[1]:
        return False
    # The other's lines of sight fill no more than a rod as thick as its target.
    if _apart(b, q, a, behind_a) <= radii[0] + geometry.target_radii[j]:
        return False
    return _apart(a, p, b, behind_b) > radii[1] + geometry.target_radii[i]


@numba.njit(cache=True)
def _apart(a, b, c, d):
    """Return the distance between the segments from a to b and from c to d [m]."""
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
