"""Exact visibility of a whole target in space, without expanded hulls.

All lines of sight from a camera to a convex target together are the convex hull of camera and
target. The target is wholly visible if that misses every occluder. Two convex bodies miss each
other if and only if an axis separates them, and one of these does: the normals of their faces, and
the products of an edge of each (separating axis theorem). So the answer is exact for convex
occluders; it measures what expanding the occluders gives up (Thesis figure 4-6).
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
AVERTED = -2
"""The camera is behind the target's plane, in place of the index of an occluder."""
VISIBLE = -1
"""Nothing hides the target, in place of the index of an occluder."""


class _Solid(NamedTuple):
    """Corners (N, 3), normals (F, 3) of the faces and directions (E, 3) of the edges."""

    corners: FloatArray
    normals: FloatArray
    edges: FloatArray


def first_hiding(
    target: Target, occluders: Sequence[Occluder], positions: ArrayLike
) -> NDArray[np.int64]:
    """Return the index (N,) of the first occluder that hides a part, `VISIBLE` or `AVERTED`.

    Args:
        target: Target in three dimensions; the hull of its outline is what must be seen.
        occluders: Bodies that may hide the target, in the order in which they are tried.
        positions: (N, 3) camera positions [m], world.
    """
    places = np.atleast_2d(np.asarray(positions, dtype=float)) - target.position
    result = np.full(len(places), VISIBLE)
    shape = _solid(target.outline)
    result[places @ target.normal <= 0.0] = AVERTED
    for index, occluder in enumerate(occluders):
        solid = _solid(occluder.points - target.position)
        _ask(places, shape, solid, index, result)
    return result


def sees_all(
    target: Target, occluders: Sequence[Occluder], positions: ArrayLike
) -> NDArray[np.bool_]:
    """Return (N,) whether cameras at positions (N, 3) [m], world, see the whole target."""
    return first_hiding(target, occluders, positions) == VISIBLE


def _solid(points: FloatArray) -> _Solid:
    """Return the hull of points; of fewer dimensions where they are."""
    middle = points.mean(axis=0)
    _, extents, axes = np.linalg.svd(points - middle, full_matrices=False)
    size = np.zeros(3)
    size[: len(extents)] = extents
    rank = int(np.count_nonzero(size > _FLAT * max(size[0], 1e-300)))
    nothing = np.empty((0, 3))
    if rank == 0:
        return _Solid(points[:1].copy(), nothing, nothing)
    if rank == 1:
        along = (points - middle) @ axes[0]
        ends = points[[int(np.argmin(along)), int(np.argmax(along))]]
        return _Solid(ends.copy(), nothing, axes[:1].copy())
    if rank == 2:  # noqa: PLR2004
        hull = ConvexHull((points - middle) @ axes[:2].T)
        corners = points[hull.vertices]
        edges = np.roll(corners, -1, axis=0) - corners
        return _Solid(corners.copy(), axes[2:3].copy(), _different(edges))
    hull = ConvexHull(points)
    sides = [hull.points[np.roll(hull.simplices, k, axis=1)[:, :2]] for k in range(3)]
    lines = np.concatenate([side[:, 1] - side[:, 0] for side in sides])
    return _Solid(
        hull.points[hull.vertices].copy(), _different(hull.equations[:, :3]), _different(lines)
    )


def _different(directions: FloatArray) -> FloatArray:
    """Return unit directions, each once, whichever way it points."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    first = np.argmax(np.abs(unit) > 0.5, axis=1)  # noqa: PLR2004
    unit *= np.sign(np.take_along_axis(unit, first[:, None], axis=1))
    _, chosen = np.unique(np.round(unit, 9), axis=0, return_index=True)
    return np.ascontiguousarray(unit[chosen])


@numba.njit(cache=True)
def _ask(places, shape, solid, number, result):
    """Write the index of a solid at the places that it hides and no other did before."""
    rays = np.empty_like(shape.corners)
    for index in range(len(places)):
        if result[index] == VISIBLE and not _missed(places[index], shape, solid, rays):
            result[index] = number


@numba.njit(cache=True)
def _missed(place, shape, solid, rays):
    """Whether the hull of a place and a target misses a solid; ``rays`` is overwritten."""
    count = len(shape.corners)
    for i in range(count):
        for k in range(3):
            rays[i, k] = shape.corners[i, k] - place[k]
    for i in range(len(solid.normals)):
        n = solid.normals[i]
        if _separates(n[0], n[1], n[2], place, shape.corners, solid.corners):
            return True
    for i in range(len(shape.normals)):
        n = shape.normals[i]
        if _separates(n[0], n[1], n[2], place, shape.corners, solid.corners):
            return True
    for i in range(count):
        for j in range(i):
            if _crossed(rays[i], rays[j], place, shape.corners, solid.corners):
                return True
        for j in range(len(solid.edges)):
            if _crossed(rays[i], solid.edges[j], place, shape.corners, solid.corners):
                return True
    for i in range(len(shape.edges)):
        for j in range(len(solid.edges)):
            if _crossed(shape.edges[i], solid.edges[j], place, shape.corners, solid.corners):
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
    """Whether place and first corners lie wholly on one side of the second ones along an axis."""
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
