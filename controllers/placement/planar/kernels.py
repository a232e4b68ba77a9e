"""The searches for the best view on the plane, compiled.

Candidates are camera poses on rings about the target: distances from ``rings``, ascending and in
focus, and directions 2 pi k / ``directions`` from the target's normal. All functions share their
arguments:

- ``points``, ``starts``: the expanded occluders, as in `planar_field`; none contains the target;
- ``place``: (4,) the target's x, y [m], direction of its normal [rad] and relation_error [m];
- ``probability``, ``cell``, ``x0``, ``y0``: (rows, columns) P of the cells, their side, and the
  corner of the first [m];
- ``spread``, ``exponents``: of `task.rate_view`.

A search returns rating [1/m], direction from the normal [rad], distance [m], free cap [rad] and P;
the rating is ``floor`` if nothing rates higher.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from controllers.placement.planar.field import free_cap, grow_blocked, nearest_and_farthest
from controllers.placement.task import FREE_BELOW, rate_view

UNKNOWN = 0.5
HALVINGS = 40
"""Of the interval that holds an arc's optimum: to 3e-12 rad."""


@numba.njit(cache=True)
def probability_at(probability, cell, x0, y0, x, y):
    """Return the probability of occupancy at a place; `UNKNOWN` outside the map."""
    column, row = math.floor((x - x0) / cell), math.floor((y - y0) / cell)
    if row < 0 or column < 0 or row >= probability.shape[0] or column >= probability.shape[1]:
        return UNKNOWN
    return probability[row, column]


@numba.njit(cache=True)
def search_rings(
    points, starts, place, rings, directions, probability, cell, x0, y0, spread, exponents, floor
):
    """Rate every candidate, as the thesis does; the reference.

    It is no straw man: what is hidden is united once a ring, and each direction takes the arc that
    it lies in from the one before.
    """
    reach = nearest_and_farthest(points, starts)
    lows, highs = np.empty(2 * starts.size + 1), np.empty(2 * starts.size + 1)
    count, inner = 0, -1.0
    best, best_angle, best_radius, best_cap, best_p = floor, 0.0, 0.0, 0.0, UNKNOWN
    near, far = rings[0], rings[-1]
    for radius in rings:
        count = grow_blocked(
            points, starts, reach, place[2], inner, radius, lows, highs, count
        )  # fmt: skip
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
            x = place[0] + radius * math.cos(place[2] + angle)
            y = place[1] + radius * math.sin(place[2] + angle)
            p = probability_at(probability, cell, x0, y0, x, y)
            rating = rate_view(
                radius, cap, math.cos(angle), p, spread, near, far, place[3], exponents
            )
            if rating > best:
                best, best_angle, best_radius, best_cap, best_p = rating, angle, radius, cap, p
    return best, best_angle, best_radius, best_cap, best_p


@numba.njit(cache=True)
def rise(angle, low, high, field, oblique):
    """Return the slope of log(cap^field cos^oblique) on an arc; it falls all along the arc."""
    side = 1.0 / (angle - low) if angle - low < high - angle else -1.0 / (high - angle)
    return field * side - oblique * math.tan(angle)


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
    cap = max(min(angle - low, high - angle), 0.0)
    return angle, cap**field * max(math.cos(angle), 0.0) ** oblique


@numba.njit(cache=True)
def search_arcs(
    points, starts, place, rings, directions, probability, cell, x0, y0, spread, exponents, floor
):
    """Find the best candidate from the free arcs and their bounds; the same as `search_rings`.

    Rings are taken from near to far. Nothing farther can do better than the best of this ring's
    arcs at the next ring's resolution, as both fall with distance. On an arc the rating but for P
    has a single peak, so its candidates are taken from the peak down, until even P = 0 is no
    better than what is found.
    """
    reach = nearest_and_farthest(points, starts)
    lows, highs = np.empty(2 * starts.size + 1), np.empty(2 * starts.size + 1)
    count, inner = 0, -1.0
    best, best_angle, best_radius, best_cap, best_p = floor, 0.0, 0.0, 0.0, UNKNOWN
    field, oblique = exponents[2], exponents[3]
    step, most = 2.0 * math.pi / directions, np.inf
    near, far = rings[0], rings[-1]
    for radius in rings:
        sharp = (1.0 / (radius * spread + place[3])) ** exponents[1]
        if sharp * most <= best:
            break
        count = grow_blocked(
            points, starts, reach, place[2], inner, radius, lows, highs, count
        )  # fmt: skip
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
                left_cap, right_cap = left * step - low, high - right * step
                left_cap = min(left_cap, high - left * step)
                right_cap = min(right_cap, right * step - low)
                value_left = value_right = -1.0
                if left_cap > 0.0:
                    value_left = left_cap**field * max(math.cos(left * step), 0.0) ** oblique
                if right_cap > 0.0:
                    value_right = right_cap**field * max(math.cos(right * step), 0.0) ** oblique
                value = max(value_left, value_right)
                if value <= 0.0 or sharp * value * (1.0 + 1e-12) <= best:
                    break
                if value_left >= value_right:
                    k, left = left, left - 1
                else:
                    k, right = right, right + 1
                angle = 2.0 * math.pi * k / directions
                x = place[0] + radius * math.cos(place[2] + angle)
                y = place[1] + radius * math.sin(place[2] + angle)
                p = probability_at(probability, cell, x0, y0, x, y)
                if p >= FREE_BELOW:
                    continue
                cap = min(angle - low, high - angle)
                if cap <= 0.0:
                    continue
                rating = rate_view(
                    radius, cap, math.cos(angle), p, spread, near, far, place[3], exponents
                )
                if rating > best:
                    best, best_angle, best_radius = rating, angle, radius
                    best_cap, best_p = cap, p
    return best, best_angle, best_radius, best_cap, best_p


@numba.njit(cache=True)
def rate_pose(
    points, starts, place, angle, radius, probability, cell, x0, y0, spread, exponents, near, far
):
    """Rate one camera pose; return rating [1/m], free cap [rad] and P.

    Args:
        points: As for the searches.
        starts: As for the searches.
        place: As for the searches.
        angle: Direction of the camera from the target's normal [rad].
        radius: Its distance [m].
        probability: As for the searches.
        cell: As for the searches.
        x0: As for the searches.
        y0: As for the searches.
        spread: As for the searches.
        exponents: As for the searches.
        near: Nearest distance in focus [m].
        far: Farthest [m].
    """
    x = place[0] + radius * math.cos(place[2] + angle)
    y = place[1] + radius * math.sin(place[2] + angle)
    p = probability_at(probability, cell, x0, y0, x, y)
    cap = free_cap(points, starts, place[2], angle, radius)
    if cap <= 0.0:
        return 0.0, cap, p
    rating = rate_view(radius, cap, math.cos(angle), p, spread, near, far, place[3], exponents)
    return rating, cap, p


@numba.njit(cache=True)
def climb(
    points, starts, place, angle, radius, turn, stride, probability, cell, x0, y0, spread,
    exponents, near, far,
):  # fmt: skip
    """Improve a pose between the candidates by a pattern search whose step halves to 1/4096.

    Args:
        points: As for the searches.
        starts: As for the searches.
        place: As for the searches.
        angle: Where to begin [rad].
        radius: Where to begin [m].
        turn: First step of the direction [rad].
        stride: First step of the distance [m].
        probability: As for the searches.
        cell: As for the searches.
        x0: As for the searches.
        y0: As for the searches.
        spread: As for the searches.
        exponents: As for the searches.
        near: Nearest distance in focus [m].
        far: Farthest [m].

    Returns:
        As the searches.
    """
    best, best_cap, best_p = rate_pose(
        points, starts, place, angle, radius, probability, cell, x0, y0, spread, exponents, near,
        far,
    )  # fmt: skip
    for _ in range(12):
        better = True
        while better:
            better = False
            for i in range(8):
                a = angle + turn * (-1, 0, 1, -1, 1, -1, 0, 1)[i]
                r = radius + stride * (-1, -1, -1, 0, 0, 1, 1, 1)[i]
                r = min(max(r, near), far)
                rating, cap, p = rate_pose(
                    points, starts, place, a, r, probability, cell, x0, y0, spread, exponents,
                    near, far,
                )  # fmt: skip
                if rating > best * (1.0 + 1e-9):
                    best, best_cap, best_p, angle, radius = rating, cap, p, a, r
                    better = True
                    break
        turn, stride = 0.5 * turn, 0.5 * stride
    return best, angle, radius, best_cap, best_p


@numba.njit(cache=True)
def rate_places(
    points, starts, place, places, probability, cell, x0, y0, spread, exponents, near, far
):
    """Rate cameras at places (N, 2) [m], world; return their ratings (N,) [1/m].

    Args:
        points: As for the searches.
        starts: As for the searches.
        place: As for the searches.
        places: (N, 2) of the cameras [m], world.
        probability: As for the searches.
        cell: As for the searches.
        x0: As for the searches.
        y0: As for the searches.
        spread: As for the searches.
        exponents: As for the searches.
        near: Nearest distance in focus [m].
        far: Farthest [m].
    """
    ratings = np.empty(len(places))
    for i in range(len(places)):
        dx, dy = places[i, 0] - place[0], places[i, 1] - place[1]
        ratings[i], _, _ = rate_pose(
            points, starts, place, math.atan2(dy, dx) - place[2], math.sqrt(dx * dx + dy * dy),
            probability, cell, x0, y0, spread, exponents, near, far,
        )  # fmt: skip
    return ratings
