"""Directions before a target in a tree, and searches over them: exhaustive, and best first.

The tree is the upper half of an octahedron, each triangle cut into four level by level. The
centres of the last level's triangles are the directions that a search tries. The searches are
compiled.
"""

import functools
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.placement.spatial.field import signed_cap
from controllers.placement.task import FREE_BELOW, rate_view, sharpness
from perception.geometry.arrays import FloatArray, IntArray

MAX_LEVEL = 8
_SAFE = 1.0 + 1e-12  # Keeps a bound above what it bounds in spite of rounding.


class DirectionTree(NamedTuple):
    """All triangles of all levels; those within triangle k are 4 k + 4 to 4 k + 7.

    Attributes:
        centres: (N, 3) unit vectors, z along the target's normal.
        radii: (N,) largest angle from the centre to a point of the triangle [rad].
        first_leaf: Index of the first triangle of the last level.
    """

    centres: FloatArray
    radii: FloatArray
    first_leaf: int

    @property
    def leaves(self) -> FloatArray:
        """(4^(level + 1), 3) directions that a search tries."""
        return self.centres[self.first_leaf :]

    def least(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return (N,) the least of the leaves' values (leaves,) within each triangle."""
        parts = [values]
        while len(parts[0]) > 4:  # noqa: PLR2004
            parts.insert(0, parts[0].reshape(-1, 4).min(axis=1))
        return np.concatenate(parts)


@functools.cache
def direction_tree(level: int) -> DirectionTree:
    """Return the tree down to a level: 4^(level + 1) directions.

    Args:
        level: 0 to `MAX_LEVEL`; at 5 neighbours are about 2 deg apart, at 6 about 1 deg.
    """
    x, y, top = np.eye(3)
    corners = np.array([[x, y, top], [y, -x, top], [-x, -y, top], [-y, x, top]])
    centres: list[FloatArray] = []
    radii: list[FloatArray] = []
    for step in range(level + 1):
        if step:
            corners = _quartered(corners)
        middle = corners.sum(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        centres.append(middle)
        # Half chords keep small angles exact.
        chord = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        radii.append(2.0 * np.arcsin(chord / 2.0))
    first = sum(len(part) for part in centres[:-1])
    return DirectionTree(np.concatenate(centres), np.concatenate(radii), first)


def _quartered(corners: FloatArray) -> FloatArray:
    """Return (4 N, 3, 3) corners of the four parts of each of N triangles, in order."""
    middles = corners + np.roll(corners, -1, axis=1)
    middles /= np.linalg.norm(middles, axis=2, keepdims=True)
    a, b, c = (corners[:, i] for i in range(3))
    ab, bc, ca = (middles[:, i] for i in range(3))
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(part, axis=1) for part in parts], axis=1).reshape(-1, 3, 3)


class TreeCandidates(NamedTuple):
    """Candidates of a search in space: every direction of a tree at every ring.

    Attributes:
        tree: Directions about the target, in its frame.
        rings: (R,) distances from the target [m], ascending.
        occupancy: (leaves, R) probability of occupancy at each candidate.
        ring: (N,) index of the first ring at which a leaf within the triangle is free, R if none.
        lowest: (N,) least probability of occupancy of all leaves within the triangle.
    """

    tree: DirectionTree
    rings: FloatArray
    occupancy: FloatArray
    ring: IntArray
    lowest: FloatArray


@numba.njit(cache=True)
def rate_places(hulls, terms, directions, distances, occupancy):
    """Rate cameras in directions (N, 3) of the target's frame.

    Args:
        hulls: `HullParts` of the expanded occluders.
        terms: `RatingTerms` of the task.
        directions: (N, 3) unit vectors to the cameras, target's frame.
        distances: (N,) distances of the cameras [m].
        occupancy: (N,) probability of occupancy at the cameras.

    Returns:
        (N,) ratings [1/m].
    """
    ratings = np.empty(len(directions))
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        cap, _ = signed_cap(hulls, x, y, z, distances[i])
        ratings[i] = rate_view(terms, distances[i], cap, z, occupancy[i])
    return ratings


@numba.njit(cache=True)
def rate_all(hulls, terms, candidates, hiding):
    """Rate every candidate, and count the reasons of those that see nothing.

    Args:
        hulls: `HullParts` of the expanded occluders.
        terms: `RatingTerms` of the task.
        candidates: `TreeCandidates` of the task.
        hiding: (H,) number of candidates that each hull hides; added to.

    Returns:
        Best rating [1/m] (0 if no candidate sees the target), indices of its direction and its
        ring, and number of candidates that are not free.
    """
    best, leaf, ring, not_free = 0.0, -1, -1, 0
    for i, k in np.ndindex(candidates.occupancy.shape):
        if candidates.occupancy[i, k] >= FREE_BELOW:
            not_free += 1
            continue
        x, y, z = candidates.tree.centres[candidates.tree.first_leaf + i]
        cap, hull = signed_cap(hulls, x, y, z, candidates.rings[k])
        if cap <= 0.0 and hull >= 0:
            hiding[hull] += 1
        rating = rate_view(terms, candidates.rings[k], cap, z, candidates.occupancy[i, k])
        if rating > best:
            best, leaf, ring = rating, i, k
    return best, leaf, ring, not_free


@numba.njit(cache=True)
def in_order(hulls, terms, candidates):
    """Yield negative rating, leaf and ring of every candidate that sees the target, best first.

    A heap holds triangles with a bound of all that is within, leaves with a bound from some ring
    on, and rated candidates. Nothing that is left beats what comes off first.
    """
    rings = len(candidates.rings)
    heap = [(0.0, 0) for _ in range(0)]  # Empty, but its entries have a type.
    for node in range(4):
        _open(hulls, terms, candidates, heap, node)
    while len(heap) > 0:
        key, item = _pop(heap)
        node, rest = item // (2 * rings), item % (2 * rings)
        if rest % 2 == 1:
            yield -key, node - candidates.tree.first_leaf, rest // 2
        elif node >= candidates.tree.first_leaf:
            _try_leaf(hulls, terms, candidates, heap, node, rest // 2)
        else:
            for child in range(4 * node + 4, 4 * node + 8):
                _open(hulls, terms, candidates, heap, child)


@numba.njit(cache=True)
def _bound(terms, radius, cap, cosine, occupancy):
    """Return an upper bound of `rate_view` for all views that are no nearer and no better."""
    return _SAFE * (
        sharpness(terms, radius)
        * min(cap, 0.5 * np.pi) ** terms.field_exponent
        * cosine**terms.angle_exponent
        * (1.0 - occupancy)
    )


@numba.njit(cache=True)
def _open(hulls, terms, candidates, heap, node):
    """Push a triangle on the heap, if the target may be visible from within it.

    Resolution and free cap fall with the distance, so its nearest free ring bounds it; the cap is
    1-Lipschitz in the direction.
    """
    ring = candidates.ring[node]
    if ring >= len(candidates.rings):
        return
    if node >= candidates.tree.first_leaf:
        _try_leaf(hulls, terms, candidates, heap, node, ring)
        return
    centre, width = candidates.tree.centres[node], candidates.tree.radii[node]
    radius = candidates.rings[ring]
    cap, _ = signed_cap(hulls, centre[0], centre[1], centre[2], radius)
    if cap + width <= 0.0:
        return
    turned = max(0.0, np.arccos(min(max(centre[2], -1.0), 1.0)) - width)
    bound = _bound(terms, radius, cap + width, np.cos(turned), candidates.lowest[node])
    _push(heap, bound, 2 * len(candidates.rings) * node)


@numba.njit(cache=True)
def _try_leaf(hulls, terms, candidates, heap, node, ring):
    """Rate a direction at one ring, and push a bound for the rings beyond it."""
    leaf, rings = node - candidates.tree.first_leaf, len(candidates.rings)
    centre = candidates.tree.centres[node]
    cap, _ = signed_cap(hulls, centre[0], centre[1], centre[2], candidates.rings[ring])
    if cap <= 0.0:
        return  # The target is hidden from farther away as well.
    occupancy = candidates.occupancy[leaf, ring]
    item = 2 * (rings * node + ring)
    rating = rate_view(terms, candidates.rings[ring], cap, centre[2], occupancy)
    if rating > 0.0:
        _push(heap, rating, item + 1)
    if ring + 1 < rings:
        radius = candidates.rings[ring + 1]
        bound = _bound(terms, radius, cap, centre[2], candidates.lowest[node])
        _push(heap, bound, item + 2)


@numba.njit(cache=True)
def _push(heap, key, item):
    """Add an entry to a binary heap, a list of (key, item) with the largest key first."""
    at = len(heap)
    heap.append((key, item))
    while at > 0 and heap[(at - 1) // 2][0] < key:
        heap[at] = heap[(at - 1) // 2]
        at = (at - 1) // 2
    heap[at] = (key, item)


@numba.njit(cache=True)
def _pop(heap):
    """Remove the entry with the largest key from a heap."""
    top, last, at = heap[0], heap.pop(), 0
    while 2 * at + 1 < len(heap):
        below = 2 * at + 1
        if below + 1 < len(heap) and heap[below + 1][0] > heap[below][0]:
            below += 1
        if heap[below][0] <= last[0]:
            break
        heap[at] = heap[below]
        at = below
    if len(heap) > 0:
        heap[at] = last
    return top
