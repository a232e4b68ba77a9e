"""A KD-tree of poses whose distance is the cost of reaching one instead of another.

``cost^2 = |dp|^2 + w^2 |dR|_F^2 / 2`` is a distance of 12 coordinates. Stages hardly twist, so
poses lie near few dimensions of them: the tree is built in their principal axes, where boxes are
tight and most comparisons end early.
"""

from typing import NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray, IntArray

LEAF = 12
"""Poses in a leaf at most."""
_DEPTH = 64
_EVEN = np.ones(12)  # Weights of coordinates that are scaled already.


class PoseTree(NamedTuple):
    """Poses sorted into boxes; a tuple, so that compiled code takes it whole.

    Attributes:
        points: (m, 12) coordinates in tree order.
        order: (m,) index of each among the poses given.
        low: (nodes, 12) least corner of each box.
        high: (nodes, 12) greatest corner.
        span: (nodes, 2) first point, and end.
        basis: (12, 12) coordinates of a pose row are ``row @ basis``.
        scale: (12,) what each column of a row weighs in the cost, before the axes are turned.
        frame: (2, 12) least and greatest row: the box of all poses, unturned and unscaled.
        levels: Depth of the tree; node k has children 2 k + 1 and 2 k + 2.
    """

    points: FloatArray
    order: IntArray
    low: FloatArray
    high: FloatArray
    span: IntArray
    basis: FloatArray
    scale: FloatArray
    frame: FloatArray
    levels: int


def build_tree(poses: FloatArray, weight: float) -> PoseTree:
    """Sort poses (m, 12) into a tree.

    Args:
        poses: Rows of position [m] and rotation.
        weight: w of the cost [m]: an angle of 1 rad costs about as much as w.

    Raises:
        ValueError: If there is no pose, or the weight is not positive.
    """
    if len(poses) == 0:
        raise ValueError("no poses to sort")
    if not (np.isfinite(weight) and weight > 0.0):
        raise ValueError(f"weight {weight}: expected a positive length")
    scale = np.concatenate([np.ones(3), np.full(9, weight / np.sqrt(2.0))])
    scaled = poses * scale
    axes = np.linalg.eigh(np.cov(scaled.T) if len(poses) > 1 else np.eye(12))[1][:, ::-1]
    basis = np.ascontiguousarray(scale[:, None] * axes)
    points = poses @ basis
    frame = np.stack([poses.min(axis=0), poses.max(axis=0)])
    levels = max(int(np.ceil(np.log2(len(poses) / LEAF))), 0)
    order = np.arange(len(poses))
    low, high, span = _build(points, order, levels)
    sorted_points = np.ascontiguousarray(points[order])
    return PoseTree(sorted_points, order, low, high, span, basis, scale, frame, levels)


def _build(
    points: FloatArray, order: IntArray, levels: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Halve the points again and again along the longest side of their box; sort ``order`` so."""
    nodes = 2 ** (levels + 1) - 1
    low, high = np.empty((2, nodes, 12))
    span = np.array([[0, len(points)]] * nodes)
    for node in range(nodes):
        first, end = span[node]
        inside = points[order[first:end]]
        low[node], high[node] = inside.min(axis=0), inside.max(axis=0)
        if 2 * node + 2 < nodes:
            axis, middle = np.argmax(high[node] - low[node]), (first + end) // 2
            halves = np.argpartition(inside[:, axis], middle - first)
            order[first:end] = order[first:end][halves]
            span[2 * node + 1], span[2 * node + 2] = (first, middle), (middle, end)
    return low, high, span


@numba.njit(cache=True)
def _gap(low, high, scale, at, bound):
    """Return the squared distance from a place to a box, or something above the bound.

    Args:
        low: (12,) least corner of the box.
        high: (12,) greatest corner of the box.
        scale: (12,) weights of the coordinates.
        at: (12,) place.
        bound: Squared distance beyond which the exact value does not matter.
    """
    total = 0.0
    for d in range(12):
        over = scale[d] * max(low[d] - at[d], at[d] - high[d])
        if over > 0.0:
            total += over * over
            if total >= bound:
                break
    return total


@numba.njit(cache=True)
def _turned(tree, row):
    """Return a row in the coordinates of the tree."""
    at = np.zeros(12)
    for j in range(12):
        for i in range(12):
            at[i] += tree.basis[j, i] * row[j]
    return at


@numba.njit(cache=True)
def nearest(tree, row, bound):
    """Find the pose of least cost below a bound.

    Args:
        tree: A `PoseTree`.
        row: (12,) pose that is wanted.
        bound: Squared cost to stay below.

    Returns:
        Index of the pose and its squared cost; -1 and the bound where none is below it.
    """
    if _gap(tree.frame[0], tree.frame[1], tree.scale, row, bound) >= bound:
        return -1, bound
    at = _turned(tree, row)
    best = -1
    nodes, gaps = np.empty(_DEPTH, dtype=np.int64), np.empty(_DEPTH)
    nodes[0], gaps[0], size = 0, _gap(tree.low[0], tree.high[0], _EVEN, at, bound), 1
    inner = 2**tree.levels - 1
    while size > 0:
        size -= 1
        node = nodes[size]
        if gaps[size] >= bound:
            continue
        if node < inner:
            left, right = 2 * node + 1, 2 * node + 2
            a = _gap(tree.low[left], tree.high[left], _EVEN, at, bound)
            b = _gap(tree.low[right], tree.high[right], _EVEN, at, bound)
            if a < b:
                left, right, a, b = right, left, b, a
            nodes[size], gaps[size] = left, a  # the farther below
            nodes[size + 1], gaps[size + 1] = right, b
            size += 2
            continue
        for k in range(tree.span[node, 0], tree.span[node, 1]):
            total = 0.0
            for d in range(12):
                off = tree.points[k, d] - at[d]
                total += off * off
                if d % 4 == 3 and total >= bound:
                    break
            if total < bound:
                best, bound = tree.order[k], total
    return best, bound


@numba.njit(cache=True)
def gather(tree, row, bound, found, costs):
    """Write indices and squared costs of all poses below a bound as far as they fit; count them.

    Args:
        tree: A `PoseTree`.
        row: (12,) pose that is wanted.
        bound: Squared cost to stay below.
        found: (k,) indices, filled from the front.
        costs: (k,) squared costs, filled alike.
    """
    if _gap(tree.frame[0], tree.frame[1], tree.scale, row, bound) >= bound:
        return 0
    at = _turned(tree, row)
    nodes, count = np.empty(_DEPTH, dtype=np.int64), 0
    nodes[0], size = 0, 1
    inner = 2**tree.levels - 1
    while size > 0:
        size -= 1
        node = nodes[size]
        if _gap(tree.low[node], tree.high[node], _EVEN, at, bound) >= bound:
            continue
        if node < inner:
            nodes[size], nodes[size + 1] = 2 * node + 1, 2 * node + 2
            size += 2
            continue
        for k in range(tree.span[node, 0], tree.span[node, 1]):
            total = 0.0
            for d in range(12):
                total += (tree.points[k, d] - at[d]) ** 2
            if total < bound:
                if count < found.shape[0]:
                    found[count], costs[count] = tree.order[k], total
                count += 1
    return count
