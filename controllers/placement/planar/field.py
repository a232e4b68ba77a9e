"""Target field visibility on the plane, compiled (Thesis section 4.2.3.3, figures 4-4a and 4-5).

All hulls are hulls of expanded occluders. What a hull hides from distance r is the part of it
within r, projected from the target: an interval of directions that only grows with r. So from
ring to ring outwards, intervals are only added.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray

CONTACT = 1e-9
"""Distance to a hull's edge, over the hull's reach, up to which a target lies on the edge."""
NOTHING, SOMETHING, EVERYTHING = 0, 1, 2
"""What a hull hides: no direction, an interval, or all as the target is inside."""


class HullCorners(NamedTuple):
    """Convex hulls packed into one array: hull h is ``points[starts[h] : starts[h + 1]]``.

    Attributes:
        points: (V, 2) corners of all hulls [m], from the target's position, anticlockwise.
        starts: (H + 1,) index of the first corner of each hull.
    """

    points: FloatArray
    starts: NDArray[np.int64]


class Intervals(NamedTuple):
    """Capacity for disjoint intervals of directions in ascending order.

    Attributes:
        lows: (C,) beginning of each interval [rad].
        highs: (C,) end of each interval [rad].
    """

    lows: FloatArray
    highs: FloatArray


@numba.njit(cache=True)
def blocked_interval(points, first, last, radius):
    """Return what one hull hides from cameras at a distance, exactly.

    The hull and the disc are convex, so the part of the hull within the disc has its extreme
    directions at corners inside the disc or where an edge crosses the circle. All of it lies within
    a quarter turn of the inward normal of the edge that the target is farthest outside of.

    Args:
        points: (V, 2) corners of all hulls [m], from the target, anticlockwise.
        first: Index of the hull's first corner.
        last: Index behind its last corner.
        radius: Distance of the cameras [m].

    Returns:
        `NOTHING`, `SOMETHING` or `EVERYTHING`, and for an interval its ends [rad], the first within
        (-3 pi / 2, pi], the second after it by at most pi.
    """
    outside, nx, ny, reach = -np.inf, 0.0, 0.0, 0.0
    for i in range(first, last):
        j = i + 1 if i + 1 < last else first
        ex, ey = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        length = math.sqrt(ex * ex + ey * ey)
        reach = max(reach, abs(points[i, 0]) + abs(points[i, 1]))
        if length == 0.0:
            continue
        distance = (ex * points[i, 1] - ey * points[i, 0]) / length
        if distance > outside:
            outside, nx, ny = distance, -ey / length, ex / length
    small = CONTACT * reach
    if outside < -small:
        return EVERYTHING, 0.0, 0.0
    low, high = np.inf, -np.inf
    r2 = radius * radius
    for i in range(first, last):
        j = i + 1 if i + 1 < last else first
        ax, ay = points[i, 0], points[i, 1]
        ex, ey = points[j, 0] - ax, points[j, 1] - ay
        a2 = ax * ax + ay * ay
        if small * small < a2 <= r2:
            angle = math.atan2(nx * ay - ny * ax, nx * ax + ny * ay)
            low, high = min(low, angle), max(high, angle)
        square = ex * ex + ey * ey
        if square == 0.0:
            continue
        along = ax * ex + ay * ey
        root = along * along - square * (a2 - r2)
        if root < 0.0:
            continue
        root = math.sqrt(root)
        for sign in (-1.0, 1.0):
            t = (-along + sign * root) / square
            if 0.0 <= t <= 1.0:
                x, y = ax + t * ex, ay + t * ey
                angle = math.atan2(nx * y - ny * x, nx * x + ny * y)
                low, high = min(low, angle), max(high, angle)
    if low > high:
        return NOTHING, 0.0, 0.0
    middle = math.atan2(ny, nx)
    return SOMETHING, middle + low, middle + high


@numba.njit(cache=True)
def farthest_corners(hulls):
    """Return the greatest distance (H,) of each hull from the target [m]."""
    points, starts = hulls.points, hulls.starts
    reach = np.zeros(starts.size - 1)
    for hull in range(starts.size - 1):
        for i in range(starts[hull], starts[hull + 1]):
            distance = math.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2)
            reach[hull] = max(reach[hull], distance)
    return reach


@numba.njit(cache=True)
def hull_around(hulls):
    """Return the index of the first hull that contains the target, or -1."""
    points, starts = hulls.points, hulls.starts
    for hull in range(starts.size - 1):
        what, _, _ = blocked_interval(points, starts[hull], starts[hull + 1], 0.0)
        if what == EVERYTHING:
            return hull
    return -1


@numba.njit(cache=True)
def free_cap(hulls, axis, angle, radius):
    """Return the target field visibility of one camera [rad]; 0 where hidden or averted.

    It is the smallest angle by which the camera can move around the target, either way, until a
    hull hides the target or the camera passes the plane of the target's face.

    Args:
        hulls: `HullCorners` of the expanded occluders.
        axis: Direction of the target's normal [rad].
        angle: Direction from the target to the camera, from the axis [rad].
        radius: Distance of the camera [m].
    """
    points, starts = hulls.points, hulls.starts
    turn = 2.0 * math.pi
    cap = 0.5 * math.pi - abs(angle - turn * math.floor(angle / turn + 0.5))
    if cap <= 0.0:
        return 0.0
    for hull in range(starts.size - 1):
        what, low, high = blocked_interval(points, starts[hull], starts[hull + 1], radius)
        if what == EVERYTHING:
            return 0.0
        if what == NOTHING:
            continue
        after = (angle + axis - low) % turn
        if after <= high - low:
            return 0.0
        cap = min(cap, after - (high - low), turn - after)
    return cap


@numba.njit(cache=True)
def add_blocked(intervals, count, low, high):
    """Unite one more interval with disjoint ones in place; return their new number.

    Args:
        intervals: `Intervals` with capacity for one more.
        count: Number of intervals.
        low: Beginning of the new interval [rad].
        high: End of the new interval [rad].
    """
    lows, highs = intervals.lows, intervals.highs
    begin = 0
    while begin < count and highs[begin] < low:
        begin += 1
    end = begin
    while end < count and lows[end] <= high:
        low, high = min(low, lows[end]), max(high, highs[end])
        end += 1
    shift = 1 - (end - begin)
    if shift == 1:
        for i in range(count - 1, begin - 1, -1):
            lows[i + 1], highs[i + 1] = lows[i], highs[i]
    elif shift < 0:
        for i in range(end, count):
            lows[i + shift], highs[i + shift] = lows[i], highs[i]
    lows[begin], highs[begin] = low, high
    return count + shift


@numba.njit(cache=True)
def grow_blocked(hulls, reach, axis, inner, radius, intervals, count):
    """Add what is hidden at the next distance to what is hidden at the one before.

    Only directions within a quarter turn of the target's normal are stored: beyond, the target is
    averted, and the plane of its face is the edge.

    Args:
        hulls: `HullCorners`, none of which contains the target.
        reach: (H,) result of `farthest_corners` [m].
        axis: Direction of the target's normal [rad].
        inner: Distance of the cameras that the intervals apply to [m]; negative at first.
        radius: Next distance of the cameras [m].
        intervals: `Intervals` of hidden directions from the axis, capacity 2 H + 1.
        count: Number of intervals.

    Returns:
        The new number of intervals.
    """
    points, starts = hulls.points, hulls.starts
    turn, quarter = 2.0 * math.pi, 0.5 * math.pi
    for hull in range(starts.size - 1):
        # A hull hides nothing more once all of it is within the circle.
        if reach[hull] <= inner:
            continue
        what, low, high = blocked_interval(points, starts[hull], starts[hull + 1], radius)
        if what != SOMETHING:
            continue
        begin = (low - axis + math.pi) % turn - math.pi
        end = begin + (high - low)
        if end >= -quarter and begin <= quarter:
            low, high = max(begin, -quarter), min(end, quarter)
            count = add_blocked(intervals, count, low, high)
        if end - turn >= -quarter:
            low, high = -quarter, min(end - turn, quarter)
            count = add_blocked(intervals, count, low, high)
    return count
