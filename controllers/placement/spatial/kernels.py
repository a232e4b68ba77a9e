"""The compiled part of the search in space: candidates one by one, and best first."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from controllers.placement.spatial.field import signed_cap
from controllers.placement.task import FREE_BELOW, rate_view

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SAFE = 1.0 + 1e-12  # Keeps a bound above what it bounds in spite of rounding.


class Candidates(NamedTuple):
    """What a search chooses among: every direction of a tree at every ring.

    Attributes:
        centres: (N, 3) of the tree's triangles, target's frame.
        radii: (N,) [rad].
        first_leaf: Number of the first triangle of the last level.
        rings: (R,) distances, growing [m].
        occupancy: (leaves, R) P at each candidate.
        ring: (N,) first ring at which a leaf within the triangle is free, R if none.
        lowest: (N,) least P of all leaves within the triangle.
    """

    centres: FloatArray
    radii: FloatArray
    first_leaf: int
    rings: FloatArray
    occupancy: FloatArray
    ring: IntArray
    lowest: FloatArray


class Terms(NamedTuple):
    """What the rating depends on besides the place; see `task.rate_view`."""

    spread: float
    near: float
    far: float
    relation_error: float
    exponents: tuple[float, float, float, float]


class Heap(NamedTuple):
    """A binary heap, the largest key first.

    Attributes:
        keys: (C,) ratings, or bounds of them.
        items: (C,) what they are of.
        size: (1,) how many.
    """

    keys: FloatArray
    items: IntArray
    size: IntArray


@numba.njit(cache=True)
def rate(terms, radius, cap, cosine, occupancy):
    """Return eq. 4-1 of one view; 0 where the target is hidden, whatever the exponents."""
    if cap <= 0.0 or cosine <= 0.0:
        return 0.0
    return rate_view(
        radius, cap, cosine, occupancy, terms.spread, terms.near, terms.far, terms.relation_error,
        terms.exponents,
    )  # fmt: skip


@numba.njit(cache=True)
def rate_places(hulls, terms, directions, distances, occupancy):
    """Return (N,) ratings of cameras in directions (N, 3) of the target's frame."""
    ratings = np.empty(len(directions))
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        cap, _ = signed_cap(hulls, x, y, z, distances[i])
        ratings[i] = rate(terms, distances[i], cap, z, occupancy[i])
    return ratings


@numba.njit(cache=True)
def best_of_all(hulls, terms, directions, rings, occupancy):
    """Rate every candidate, one by one; return the best rating, its direction and ring."""
    best, leaf, ring = 0.0, -1, -1
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        for k in range(len(rings)):
            if occupancy[i, k] >= FREE_BELOW:
                continue
            cap, _ = signed_cap(hulls, x, y, z, rings[k])
            rating = rate(terms, rings[k], cap, z, occupancy[i, k])
            if rating > best:
                best, leaf, ring = rating, i, k
    return best, leaf, ring


@numba.njit(cache=True)
def best_of_each(hulls, terms, candidates, ratings, chosen):
    """Fill in, for every direction, the best rating over the rings (leaves,) and its ring."""
    rings = candidates.rings
    for leaf in range(len(ratings)):
        node = candidates.first_leaf + leaf
        centre = candidates.centres[node]
        ratings[leaf], chosen[leaf] = 0.0, -1
        for k in range(candidates.ring[node], len(rings)):
            cap, _ = signed_cap(hulls, centre[0], centre[1], centre[2], rings[k])
            if cap <= 0.0:
                break
            rating = rate(terms, rings[k], cap, centre[2], candidates.occupancy[leaf, k])
            if rating > ratings[leaf]:
                ratings[leaf], chosen[leaf] = rating, k
            if _bound(terms, rings[k], cap, centre[2], candidates.lowest[node]) <= ratings[leaf]:
                break


@numba.njit(cache=True)
def count_reasons(hulls, directions, rings, occupancy, hiding):
    """Count the candidates that are not free; add to `hiding` (H,) those that each hull hides."""
    not_free = 0
    for i in range(len(directions)):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        for k in range(len(rings)):
            if occupancy[i, k] >= FREE_BELOW:
                not_free += 1
                continue
            cap, hull = signed_cap(hulls, x, y, z, rings[k])
            if cap <= 0.0 and hull >= 0:
                hiding[hull] += 1
    return not_free


@numba.njit(cache=True)
def start(hulls, terms, candidates, heap):
    """Put the whole half sphere on an empty heap."""
    for node in range(min(4, len(candidates.centres))):
        _open(hulls, terms, candidates, heap, node)


@numba.njit(cache=True)
def following(hulls, terms, candidates, heap):
    """Return the next best candidate: rating, leaf and ring; leaf -1 when there is none left.

    On the heap are triangles with a bound of all that is within, leaves with a bound from some ring
    on, and rated candidates. What comes off first is beaten by nothing that is left.
    """
    rings = len(candidates.rings)
    while heap.size[0] > 0:
        key, item = _pop(heap)
        node, rest = item // (2 * rings), item % (2 * rings)
        if rest % 2 == 1:
            return key, node - candidates.first_leaf, rest // 2
        if node >= candidates.first_leaf:
            _try_leaf(hulls, terms, candidates, heap, node, rest // 2)
        else:
            for child in range(4 * node + 4, 4 * node + 8):
                _open(hulls, terms, candidates, heap, child)
    return 0.0, -1, -1


@numba.njit(cache=True)
def _bound(terms, radius, cap, cosine, occupancy):
    """Return `rate` without the sharp ends: what no view in a box can beat."""
    exponents = terms.exponents
    return _SAFE * (
        (1.0 / (radius * terms.spread + terms.relation_error)) ** exponents[1]
        * min(cap, 0.5 * np.pi) ** exponents[2]
        * cosine ** exponents[3]
        * (1.0 - occupancy)
    )


@numba.njit(cache=True)
def _open(hulls, terms, candidates, heap, node):
    """Put a triangle on the heap, if anything in it may be seen from.

    Resolution and free cap fall with the distance, so its nearest free ring bounds it; the cap is
    1-Lipschitz in the direction.
    """
    ring = candidates.ring[node]
    if ring >= len(candidates.rings):
        return
    if node >= candidates.first_leaf:
        _try_leaf(hulls, terms, candidates, heap, node, ring)
        return
    centre, width = candidates.centres[node], candidates.radii[node]
    radius = candidates.rings[ring]
    cap, _ = signed_cap(hulls, centre[0], centre[1], centre[2], radius)
    if cap + width <= 0.0:
        return
    turned = max(0.0, np.arccos(min(max(centre[2], -1.0), 1.0)) - width)
    bound = _bound(terms, radius, cap + width, np.cos(turned), candidates.lowest[node])
    _push(heap, bound, 2 * len(candidates.rings) * node)


@numba.njit(cache=True)
def _try_leaf(hulls, terms, candidates, heap, node, ring):
    """Rate a direction at one ring, and keep a bound for the rings beyond it."""
    leaf, rings = node - candidates.first_leaf, len(candidates.rings)
    centre = candidates.centres[node]
    cap, _ = signed_cap(hulls, centre[0], centre[1], centre[2], candidates.rings[ring])
    if cap <= 0.0:
        return  # Farther away it is hidden as well.
    occupancy = candidates.occupancy[leaf, ring]
    item = 2 * (rings * node + ring)
    rating = rate(terms, candidates.rings[ring], cap, centre[2], occupancy)
    if rating > 0.0:
        _push(heap, rating, item + 1)
    if ring + 1 < rings:
        radius = candidates.rings[ring + 1]
        bound = _bound(terms, radius, cap, centre[2], candidates.lowest[node])
        _push(heap, bound, item + 2)


@numba.njit(cache=True)
def _push(heap, key, item):
    keys, items = heap.keys, heap.items
    at = heap.size[0]
    heap.size[0] = at + 1
    while at > 0:
        above = (at - 1) // 2
        if keys[above] >= key:
            break
        keys[at], items[at] = keys[above], items[above]
        at = above
    keys[at], items[at] = key, item


@numba.njit(cache=True)
def _pop(heap):
    keys, items = heap.keys, heap.items
    top, found = keys[0], items[0]
    size = heap.size[0] - 1
    heap.size[0] = size
    key, item = keys[size], items[size]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= size:
            break
        if below + 1 < size and keys[below + 1] > keys[below]:
            below += 1
        if keys[below] <= key:
            break
        keys[at], items[at] = keys[below], items[below]
        at = below
    if size > 0:
        keys[at], items[at] = key, item
    return top, found
