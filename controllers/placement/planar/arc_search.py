"""Searches for the best view on the plane, compiled.

Candidates are camera poses on rings about the target: distances `rings`, ascending and in focus,
and directions 2 pi k / ``directions`` from the target's normal. A search returns rating [1/m],
direction from the normal [rad], distance [m], free cap [rad] and occupancy; the rating is
``floor`` if no candidate rates higher.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from controllers.placement.planar.field import (
    HullCorners,
    Intervals,
    farthest_corners,
    free_cap,
    grow_blocked,
)
from controllers.placement.task import FREE_BELOW, RatingTerms, rate_view, sharpness
from perception.geometry.arrays import FloatArray

UNKNOWN = 0.5
"""Probability of occupancy outside the map."""
HALVINGS = 40
"""Halvings of the interval that holds an arc's optimum: to 3e-12 rad."""


class OccupancyCells(NamedTuple):
    """An occupancy map of the plane, for compiled code.

    Attributes:
        probability: (rows, columns) probability of occupancy.
        cell: Side of a cell [m].
        x0: x of the first cell's lowest corner [m], world.
        y0: y of the first cell's lowest corner [m], world.
    """

    probability: FloatArray
    cell: float
    x0: float
    y0: float


class ArcTask(NamedTuple):
    """One target, its occluders, and the occupancy map, for compiled code.

    Attributes:
        hulls: Expanded occluders from the target, none of which contains it.
        x: x of the target [m], world.
        y: y of the target [m], world.
        axis: Direction of the target's normal from the world's x axis [rad].
        space: Occupancy map.
        terms: Numbers of the rating.
    """

    hulls: HullCorners
    x: float
    y: float
    axis: float
    space: OccupancyCells
    terms: RatingTerms


@numba.njit(cache=True)
def probability_at(space, x, y):
    """Return the probability of occupancy at a point [m], world; `UNKNOWN` outside the map."""
    probability = space.probability
    column = math.floor((x - space.x0) / space.cell)
    row = math.floor((y - space.y0) / space.cell)
    if row < 0 or column < 0 or row >= probability.shape[0] or column >= probability.shape[1]:
        return UNKNOWN
    return probability[row, column]


@numba.njit(cache=True)
def _occupancy(task, angle, radius):
    """Return the probability of occupancy of a camera pose."""
    x = task.x + radius * math.cos(task.axis + angle)
    y = task.y + radius * math.sin(task.axis + angle)
    return probability_at(task.space, x, y)


@numba.njit(cache=True)
def occupancies(task, angles, radius):
    """Return the probability of occupancy of camera poses in directions (N,), at one distance."""
    values = np.empty(len(angles))
    for i in range(len(angles)):
        values[i] = _occupancy(task, angles[i], radius)
    return values


@numba.njit(cache=True)
def _no_intervals(hulls):
    """Return empty intervals with capacity for all that hulls can hide."""
    capacity = 2 * hulls.starts.size + 1
    return Intervals(np.empty(capacity), np.empty(capacity))


@numba.njit(cache=True)
def search_rings(task, rings, directions, floor):
    """Rate every candidate, as the thesis does; the reference.

    It is a fair reference: what is hidden is united once a ring, and each direction takes the arc
    that it lies in from the one before.

    Args:
        task: `ArcTask`.
        rings: (R,) distances of the candidates [m], ascending.
        directions: Number of directions of a full turn.
        floor: Rating that a candidate must exceed [1/m].
    """
    reach, hidden = farthest_corners(task.hulls), _no_intervals(task.hulls)
    lows, highs = hidden.lows, hidden.highs
    count, inner = 0, -1.0
    best, best_angle, best_radius, best_cap, best_p = floor, 0.0, 0.0, 0.0, UNKNOWN
    for radius in rings:
        count = grow_blocked(task.hulls, reach, task.axis, inner, radius, hidden, count)
        inner, arc = radius, 0
        for k in range(-(directions // 4), directions // 4 + 1):
            angle = 2.0 * math.pi * k / directions
            while arc < count and highs[arc] < angle:
                arc += 1
            low = highs[arc - 1] if arc > 0 else -0.5 * math.pi
            high = lows[arc] if arc < count else 0.5 * math.pi
            cap = min(angle - low, high - angle)
            if cap <= 0.0:
                continue
            p = _occupancy(task, angle, radius)
            rating = rate_view(task.terms, radius, cap, math.cos(angle), p)
            if rating > best:
                best, best_angle, best_radius, best_cap, best_p = rating, angle, radius, cap, p
    return best, best_angle, best_radius, best_cap, best_p


@numba.njit(cache=True)
def rise(angle, low, high, field, oblique):
    """Return the slope of log(cap^field cos^oblique) on an arc; it falls all along the arc."""
    side = 1.0 / (angle - low) if angle - low < high - angle else -1.0 / (high - angle)
    return field * side - oblique * math.tan(angle)


@numba.njit(cache=True)
def arc_value(angle, low, high, field, oblique):
    """Return cap^field cos^oblique of a direction; -1 outside of the arc."""
    cap = min(angle - low, high - angle)
    return cap**field * max(math.cos(angle), 0.0) ** oblique if cap >= 0.0 else -1.0


@numba.njit(cache=True)
def arc_optimum(low, high, field, oblique):
    """Return where on a free arc cap^field cos^oblique is greatest, and how great it is.

    Its logarithm is concave: the optimum is the only stationary point, or the arc's middle.
    """
    a, b = low, high
    for _ in range(HALVINGS):
        middle = 0.5 * (a + b)
        if middle <= low or middle >= high:
            break
        if rise(middle, low, high, field, oblique) > 0.0:
            a = middle
        else:
            b = middle
    angle = 0.5 * (a + b)
    return angle, arc_value(angle, low, high, field, oblique)


@numba.njit(cache=True)
def search_arcs(task, rings, directions, floor):
    """Find the best candidate from the free arcs and their bounds; the same as `search_rings`.

    Rings are searched from near to far. Nothing farther can do better than the best of this ring's
    arcs at the next ring's resolution, as both fall with distance. On an arc the rating but for P
    has a single peak, so its candidates are rated from the peak down, until even P = 0 is no
    better than the best one so far.

    Args:
        task: `ArcTask`.
        rings: (R,) distances of the candidates [m], ascending.
        directions: Number of directions of a full turn.
        floor: Rating that a candidate must exceed [1/m].
    """
    reach, hidden = farthest_corners(task.hulls), _no_intervals(task.hulls)
    lows, highs = hidden.lows, hidden.highs
    count, inner = 0, -1.0
    best, best_angle, best_radius, best_cap, best_p = floor, 0.0, 0.0, 0.0, UNKNOWN
    field, oblique = task.terms.field_exponent, task.terms.angle_exponent
    step, most = 2.0 * math.pi / directions, np.inf
    for radius in rings:
        sharp = sharpness(task.terms, radius)
        if sharp * most <= best:
            break
        count = grow_blocked(task.hulls, reach, task.axis, inner, radius, hidden, count)
        inner, most = radius, 0.0
        for arc in range(count + 1):
            low = highs[arc - 1] if arc > 0 else -0.5 * math.pi
            high = lows[arc] if arc < count else 0.5 * math.pi
            if high <= low:
                continue
            straight = min(max(0.0, low), high)
            coarse = (0.5 * (high - low)) ** field * math.cos(straight) ** oblique
            if sharp * coarse <= best:
                most = max(most, coarse)
                continue
            peak, fine = arc_optimum(low, high, field, oblique)
            most = max(most, fine)
            if sharp * fine * (1.0 + 1e-12) <= best:
                continue
            right = math.floor(peak / step) + 1
            left = right - 1
            while True:
                value_left = arc_value(left * step, low, high, field, oblique)
                value_right = arc_value(right * step, low, high, field, oblique)
                value = max(value_left, value_right)
                if value <= 0.0 or sharp * value * (1.0 + 1e-12) <= best:
                    break
                if value_left >= value_right:
                    k, left = left, left - 1
                else:
                    k, right = right, right + 1
                angle = 2.0 * math.pi * k / directions
                p = _occupancy(task, angle, radius)
                if p >= FREE_BELOW:
                    continue
                cap = min(angle - low, high - angle)
                if cap <= 0.0:
                    continue
                rating = rate_view(task.terms, radius, cap, math.cos(angle), p)
                if rating > best:
                    best, best_angle, best_radius = rating, angle, radius
                    best_cap, best_p = cap, p
    return best, best_angle, best_radius, best_cap, best_p


@numba.njit(cache=True)
def rate_pose(task, angle, radius):
    """Rate one camera pose; return rating [1/m], free cap [rad] and occupancy.

    Args:
        task: `ArcTask`.
        angle: Direction of the camera from the target's normal [rad].
        radius: Distance of the camera from the target [m].
    """
    p = _occupancy(task, angle, radius)
    cap = free_cap(task.hulls, task.axis, angle, radius)
    if cap <= 0.0:
        return 0.0, cap, p
    return rate_view(task.terms, radius, cap, math.cos(angle), p), cap, p


@numba.njit(cache=True)
def climb(task, rings, directions, angle, radius):
    """Improve a pose between the candidates by a pattern search whose step halves to 1/4096.

    Args:
        task: `ArcTask`.
        rings: (R,) distances of the candidates [m], ascending.
        directions: Number of directions of a full turn.
        angle: Direction of the camera to begin at, from the target's normal [rad].
        radius: Distance of the camera to begin at [m].

    Returns:
        The same as the searches.
    """
    near, far = rings[0], rings[-1]
    turn, stride = 0.5 * math.pi / directions, 0.5 * ((far - near) / max(rings.size - 1, 1))
    best, best_cap, best_p = rate_pose(task, angle, radius)
    for _ in range(12):
        better = True
        while better:
            better = False
            for i in range(8):
                a = angle + turn * (-1, 0, 1, -1, 1, -1, 0, 1)[i]
                r = radius + stride * (-1, -1, -1, 0, 0, 1, 1, 1)[i]
                r = min(max(r, near), far)
                rating, cap, p = rate_pose(task, a, r)
                if rating > best * (1.0 + 1e-9):
                    best, best_cap, best_p, angle, radius = rating, cap, p, a, r
                    better = True
                    break
        turn, stride = 0.5 * turn, 0.5 * stride
    return best, angle, radius, best_cap, best_p


@numba.njit(cache=True)
def rate_places(task, places):
    """Rate cameras at places (N, 2) [m], world; return their ratings (N,) [1/m]."""
    ratings = np.empty(len(places))
    for i in range(len(places)):
        dx, dy = places[i, 0] - task.x, places[i, 1] - task.y
        angle = math.atan2(dy, dx) - task.axis
        ratings[i], _, _ = rate_pose(task, angle, math.sqrt(dx * dx + dy * dy))
    return ratings
