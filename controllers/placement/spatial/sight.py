"""Exact visibility of a whole target in space, without expanded hulls.

All lines of sight from a camera to a convex target together are the convex hull of camera and
target. The target is wholly visible if that misses every occluder. Two convex bodies miss each
other if and only if an axis separates them, and one of these does: the normals of their faces, and
the products of an edge of each (separating axis theorem). So the answer is exact for convex
occluders; it measures the views that are lost by expanding them (Thesis figure 4-6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from controllers.placement.task import Occluder, Target
from perception.geometry.arrays import FloatArray

_FLAT = 1e-9
"""Extent of points over their size below which they have one dimension less."""


class _Solid(NamedTuple):
    """Corners (N, 3), normals (F, 3) of the faces and directions (E, 3) of the edges."""

    corners: FloatArray
    normals: FloatArray
    edges: FloatArray


def sees_all(
    target: Target, occluders: Sequence[Occluder], positions: ArrayLike
) -> NDArray[np.bool_]:
    """Return (N,) whether cameras see the whole target, from its visible side.

    Args:
        target: Target in three dimensions; all of the hull of its outline must be visible.
        occluders: Bodies that may hide the target.
        positions: (N, 3) camera positions [m], world.
    """
    places = np.atleast_2d(np.asarray(positions, dtype=float)) - target.position
    seen = places @ target.normal > 0.0
    shape = _solid(target.outline)
    for occluder in occluders:
        _remove_hidden(places, shape, _solid(occluder.points - target.position), seen)
    return seen


def _solid(points: FloatArray) -> _Solid:
    """Return the hull of points; of fewer dimensions where they are."""
    middle = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(points - middle, full_matrices=False)
    rank = int(np.count_nonzero(extents > _FLAT * max(extents[0], 1e-300)))
    if rank <= 1:
        along = (points - middle) @ axes[0]
        ends = points[[int(np.argmin(along)), int(np.argmax(along))]]
        return _Solid(ends, np.empty((0, 3)), axes[:rank].copy())
    if rank == 2:  # noqa: PLR2004
        hull = ConvexHull((points - middle) @ axes[:2].T)
        corners = points[hull.vertices]
        edges = np.roll(corners, -1, axis=0) - corners
        return _Solid(corners, axes[2:3].copy(), _different(edges))
    hull = ConvexHull(points)
    sides = [hull.points[np.roll(hull.simplices, k, axis=1)[:, :2]] for k in range(3)]
    lines = np.concatenate([side[:, 1] - side[:, 0] for side in sides])
    corners = hull.points[hull.vertices]
    return _Solid(corners, _different(hull.equations[:, :3]), _different(lines))


def _different(directions: FloatArray) -> FloatArray:
    """Return unit directions, each once, whichever way it points."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    first = np.argmax(np.abs(unit) > 0.5, axis=1)  # noqa: PLR2004
    unit *= np.sign(np.take_along_axis(unit, first[:, None], axis=1))
    _, chosen = np.unique(np.round(unit, 9), axis=0, return_index=True)
    return np.ascontiguousarray(unit[chosen])


@numba.njit(cache=True)
def _remove_hidden(places, shape, solid, seen):
    """Set ``seen`` to False for the positions from which a solid hides a part of a target."""
    for index in range(len(places)):
        seen[index] = seen[index] and _missed(places[index], shape, solid)


@numba.njit(cache=True)
def _missed(place, shape, solid):
    """Return whether the hull of a camera position and a target misses a solid."""
    rays = shape.corners - place
    for normals in (solid.normals, shape.normals):
        for n in normals:
            if _separates(n[0], n[1], n[2], place, shape.corners, solid.corners):
                return True
    for i in range(len(rays)):
        for j in range(i):
            if _crossed(rays[i], rays[j], place, shape.corners, solid.corners):
                return True
    for edges in (rays, shape.edges):
        for first in edges:
            for second in solid.edges:
                if _crossed(first, second, place, shape.corners, solid.corners):
                    return True
    return False


@numba.njit(cache=True)
def _crossed(a, b, place, first, second):
    x, y, z = (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
    if x * x + y * y + z * z < 1e-24:  # noqa: PLR2004
        return False  # Parallel edges span no face.
    return _separates(x, y, z, place, first, second)


@numba.njit(cache=True)
def _separates(x, y, z, place, first, second):
    """Return whether an axis separates the camera position and first corners from the second."""
    low = high = x * place[0] + y * place[1] + z * place[2]
    for i in range(len(first)):
        value = x * first[i, 0] + y * first[i, 1] + z * first[i, 2]
        low, high = min(low, value), max(high, value)
    under, over = True, True
    for i in range(len(second)):
        value = x * second[i, 0] + y * second[i, 1] + z * second[i, 2]
        under = under and value < low
        over = over and value > high
        if not (under or over):
            return False
    return True
