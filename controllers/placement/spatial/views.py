"""Cameras anywhere in space, rated one by one (thesis eq. 4-1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.placement.spatial import kernels
from controllers.placement.spatial.field import free_caps
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.task import Exponents, Lens, View, resolution

FloatArray = NDArray[np.float64]

Occupancy = Callable[[FloatArray], FloatArray]
"""(N, 3) points [m], world, to (N,) probabilities; NaN where unknown (`VoxelMap.probabilities`)."""

UNKNOWN = 0.5
_ROUNDING = 1e-9
"""A distance this near to a limit of the lens is at it [m]."""


def rate_positions(
    field: TargetField,
    lens: Lens,
    positions: ArrayLike,
    occupancy: Occupancy | None = None,
    exponents: Exponents | None = None,
) -> list[View]:
    """Rate cameras anywhere; the rating is 0 where the target is not seen or the place not free.

    Args:
        field: The target with what may hide it.
        lens: The camera.
        positions: (N, 3) of cameras [m], world, none at the target.
        occupancy: As for `best_view`.
        exponents: Of eq. 4-1; 1 unless said.
    """
    places = np.atleast_2d(np.asarray(positions, dtype=float))
    local = field.to_frame(places)
    distances = np.linalg.norm(local, axis=1)
    directions = local / distances[:, None]
    for limit in (lens.near, lens.far):  # A camera put at the limit is in focus despite rounding.
        distances[np.abs(distances - limit) < _ROUNDING] = limit
    chances = probabilities_at(occupancy, places)
    terms = terms_of(field, lens, exponents or Exponents())
    ratings = kernels.rate_places(field.hulls, terms, directions, distances, chances)
    caps = free_caps(field, places)
    details = resolution(distances, lens, field.target.relation_error)
    return [
        View(field.target.name, places[i], float(distances[i]), float(ratings[i]), float(caps[i]),
             max(float(directions[i, 2]), 0.0), float(details[i]), float(chances[i]))
        for i in range(len(places))
    ]  # fmt: skip


def spherical(field: TargetField, position: ArrayLike) -> tuple[float, float, float]:
    """Return a camera's distance [m], azimuth and elevation above the target's plane [rad]."""
    x, y, z = field.to_frame(np.asarray(position, dtype=float))
    return (
        float(np.sqrt(x * x + y * y + z * z)),
        float(np.arctan2(y, x)),
        float(np.arctan2(z, np.hypot(x, y))),
    )


def probabilities_at(occupancy: Occupancy | None, points: FloatArray) -> FloatArray:
    """Return (N,) P at points; unknown ones are 0.5."""
    if occupancy is None:
        return np.zeros(len(points))
    return np.nan_to_num(np.asarray(occupancy(points), dtype=float), nan=UNKNOWN)


def terms_of(field: TargetField, lens: Lens, exponents: Exponents) -> kernels.Terms:
    """Return what the compiled code needs of a target and a lens."""
    return kernels.Terms(
        float(lens.spread), float(lens.near), float(lens.far), float(field.target.relation_error),
        (float(exponents.depth), float(exponents.resolution), float(exponents.field),
         float(exponents.angle)),
    )  # fmt: skip
