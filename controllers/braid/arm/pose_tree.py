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


@numba.njit(cache=True)
def _build(points, order, levels):
    nodes = 2 ** (levels + 1) - 1
    low, high = np.empty((nodes, 12)), np.empty((nodes, 12))
    span = np.empty((nodes, 2), dtype=np.int64)
    span[0, 0], span[0, 1] = 0, points.shape[0]
    for node in range(nodes):
        first, end = span[node, 0], span[node, 1]
        low[node], high[node] = points[order[first]], points[order[first]]
        for k in range(first + 1, end):
            for d in range(12):
                value = points[order[k], d]
                low[node, d] = min(low[node, d], value)
                high[node, d] = max(high[node, d], value)
        if 2 * node + 2 < nodes:
            axis = np.argmax(high[node] - low[node])
            middle = (first + end) // 2
            _halve(points, order, first, end, middle, axis)
            span[2 * node + 1, 0], span[2 * node + 1, 1] = first, middle
            span[2 * node + 2, 0], span[2 * node + 2, 1] = middle, end
    return low, high, span


@numba.njit(cache=True)
def _halve(points, order, first, end, middle, axis):
    """Order the indices so that none before the middle lies above it (Hoare's selection)."""
    left, right = first, end - 1
    while left < right:
        pivot = points[order[(left + right) // 2], axis]
        i, j = left, right
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            right = j
        elif middle >= i:
            left = i
        else:
            return


@numba.njit(cache=True)
def _gap(tree, node, at, bound):
    """Return the squared distance from a place to a box, or something above the bound."""
    total = 0.0
    for d in range(12):
        over = max(tree.low[node, d] - at[d], at[d] - tree.high[node, d])
        if over > 0.0:
            total += over * over
            if total >= bound:
                break
    return total


@numba.njit(cache=True)
def _frame_gap(tree, row, bound):
    """Return the squared distance from a row to the box of all poses, axes not turned."""
    total = 0.0
    for d in range(12):
        over = max(tree.frame[0, d] - row[d], row[d] - tree.frame[1, d])
        if over > 0.0:
            total += (tree.scale[d] * over) ** 2
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
    if _frame_gap(tree, row, bound) >= bound:
        return -1, bound
    at = _turned(tree, row)
    best = -1
    nodes, gaps = np.empty(_DEPTH, dtype=np.int64), np.empty(_DEPTH)
    nodes[0], gaps[0], size = 0, _gap(tree, 0, at, bound), 1
    inner = 2**tree.levels - 1
    while size > 0:
        size -= 1
        node = nodes[size]
        if gaps[size] >= bound:
            continue
        if node < inner:
            left, right = 2 * node + 1, 2 * node + 2
            a, b = _gap(tree, left, at, bound), _gap(tree, right, at, bound)
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
    if _frame_gap(tree, row, bound) >= bound:
        return 0
    at = _turned(tree, row)
    nodes, count = np.empty(_DEPTH, dtype=np.int64), 0
    nodes[0], size = 0, 1
    inner = 2**tree.levels - 1
    while size > 0:
        size -= 1
        node = nodes[size]
        if _gap(tree, node, at, bound) >= bound:
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
