"""The tracking Hough transform: circles through three points at a time (Thesis eqs 5-7 to 5-9).

The two bisectors of 5-7 are solved without the slopes of 5-8, which divide by zero, and the circle
test takes place in square pixels.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from perception.markers.ellipses import MarkerExpectation
from perception.stereo.geometry import StereoGeometry

FloatArray = NDArray[np.float64]

LEAST_TURN = math.pi / 6.0
"""Between the bisectors of two chords, d-theta of section 5.3 [rad]."""
RING = 1.5
"""The rim's points lie so far outside a marker [px]: the low pass cancels those at the rim."""
_BINS = 16  # Of a circumference.
_BESIDE = 0.75  # A point on a circle is at most so far from it [px of the rows].
_AROUND = 24  # Pixels of a square of five about a pixel: so many may join a chain at once.


def hough_circles(
    rims: NDArray[np.bool_],
    geometry: StereoGeometry,
    expected: MarkerExpectation,
    rng: np.random.Generator | None = None,
) -> FloatArray:
    """Return circles by the tracking Hough transform (eqs. 5-7 to 5-9).

    Args:
        rims: (H, W), the points.
        geometry: Of the camera: makes the pixels square.
        expected: Sizes of the markers.
        rng: Draws the points; if None the same ones each time.

    Returns:
        (N, 4) column, row [px], radius [px of the rows], part of the circumference found.
    """
    smallest, largest = expected.radii(geometry)
    rows, columns = np.nonzero(rims)
    draw = rng or np.random.default_rng(0)
    order = draw.permutation(len(rows))
    # A slanted marker's rim is flatter and sharper than its circle.
    least = 0.45 * (smallest + RING)
    return _track(
        columns[order].astype(np.int32),
        rows[order].astype(np.int32),
        geometry.height,
        geometry.width,
        geometry.fy / geometry.fx,
        least,
        1.6 * (largest + RING),
        2.2 * (largest + RING),
        int(draw.integers(1, 2**31)),
    )


@numba.njit(cache=True)
def circle_of_three(
    u1: float, v1: float, u2: float, v2: float, u3: float, v3: float
) -> tuple[float, float, float, float]:
    """Return the circle through three points, and the angle between two chords' bisectors.

    The bisectors' equations (eq. 5-7) are multiplied by the chords' differences, so that points of
    one row need no special case.

    Returns:
        Centre x, y, radius (eq. 5-9), angle [rad]; NaN on a line.
    """
    ax, ay = u2 - u1, v2 - v1
    bx, by = u3 - u2, v3 - v2
    turn = ax * by - ay * bx
    lengths = math.sqrt((ax * ax + ay * ay) * (bx * bx + by * by))
    if abs(turn) <= 1e-12 * lengths or lengths == 0.0:
        return np.nan, np.nan, np.nan, 0.0
    p = 0.5 * (ax * (u1 + u2) + ay * (v1 + v2))
    q = 0.5 * (bx * (u2 + u3) + by * (v2 + v3))
    x, y = (p * by - q * ay) / turn, (q * ax - p * bx) / turn
    radius = math.hypot(x - u1, y - v1) + math.hypot(x - u2, y - v2) + math.hypot(x - u3, y - v3)
    angle = math.acos(min(max((ax * bx + ay * by) / lengths, -1.0), 1.0))
    return x, y, radius / 3.0, angle


@numba.njit(cache=True)
def _chain(first: int, columns: Any, rows: Any, index: Any, free: Any, far: float, stretch: float,
           mark: Any, members: Any) -> int:  # fmt: skip
    """Gather the free points that hang together with one, within a distance of it."""
    height, width = index.shape
    members[0], used, done = first, 1, 0
    mark[first] = first
    while done < used and used < len(members) - _AROUND:
        c, r = columns[members[done]], rows[members[done]]
        done += 1
        # A rim of a few pixels has gaps of one.
        for y in range(max(r - 2, 0), min(r + 3, height)):
            for x in range(max(c - 2, 0), min(c + 3, width)):
                other = index[y, x]
                if other < 0 or mark[other] == first or not free[other]:
                    continue
                across, down = (x - columns[first]) * stretch, y - rows[first]
                if across * across + down * down < far * far:
                    mark[other] = first
                    members[used] = other
                    used += 1
    return used


@numba.njit(cache=True)
def _track(columns: Any, rows: Any, height: int, width: int, stretch: float, least: float,
           most: float, far: float, seed: int) -> Any:  # fmt: skip
    """Fit circles to three points of a chain at a time, and track those that agree."""
    count = len(columns)
    index = np.full((height, width), -1, np.int32)
    for k in range(count):
        index[rows[k], columns[k]] = k
    free = np.ones(count, np.bool_)
    mark = np.full(count, -1, np.int32)
    # Half a rim is enough to draw from.
    members = np.empty(8 + int(1.2 * far) + _AROUND, np.int32)
    circles = np.zeros((512, 4))
    found, state = 0, seed
    for first in range(count):
        if not free[first]:
            continue
        used = _chain(first, columns, rows, index, free, far, stretch, mark, members)
        for _ in range(8 if used >= 5 else 0):
            state = (state * 1103515245 + 12345) % 2147483648
            second = members[(state >> 8) % used]
            state = (state * 1103515245 + 12345) % 2147483648
            third = members[(state >> 8) % used]
            if second == first or third == first or third == second:
                continue
            x1, x2 = columns[first] * stretch, columns[second] * stretch
            x3 = columns[third] * stretch
            y1, y2, y3 = float(rows[first]), float(rows[second]), float(rows[third])
            chords = math.hypot(x2 - x1, y2 - y1), math.hypot(x3 - x2, y3 - y2)
            # Pixels side by side say nothing about a curve.
            if max(chords) >= far or min(chords) < least:
                continue
            x, y, radius, angle = circle_of_three(x1, y1, x2, y2, x3, y3)
            turned = LEAST_TURN < angle < math.pi - LEAST_TURN
            if not turned or not least <= radius <= most:
                continue
            match = -1
            for i in range(found):
                across, down = circles[i, 0] - x, circles[i, 1] - y
                near = 0.5 * min(radius, circles[i, 2])
                if across * across + down * down < near * near:
                    match = i
                    break
            if match < 0:
                if found == len(circles):
                    break
                match = found
                found += 1
            weight = circles[match, 3]
            circles[match, 0] = (weight * circles[match, 0] + x) / (weight + 1.0)
            circles[match, 1] = (weight * circles[match, 1] + y) / (weight + 1.0)
            circles[match, 2] = (weight * circles[match, 2] + radius) / (weight + 1.0)
            circles[match, 3] = weight + 1.0
            free[first], free[second], free[third] = False, False, False
            break
        free[first] = False
    for i in range(found):
        circles[i, 3] = _coverage(index, circles[i], stretch)
        circles[i, 0] /= stretch
    return circles[:found]


@numba.njit(cache=True)
def _coverage(index: Any, circle: Any, stretch: float) -> float:
    """Return the part of a circle along which a point, also of another's three, lies beside it."""
    height, width = index.shape
    covered = np.zeros(_BINS, np.bool_)
    reach = circle[2] + _BESIDE
    left, right = (circle[0] - reach) / stretch, (circle[0] + reach) / stretch
    for y in range(max(int(circle[1] - reach), 0), min(int(circle[1] + reach) + 2, height)):
        for x in range(max(int(left), 0), min(int(right) + 2, width)):
            if index[y, x] >= 0:
                across, down = x * stretch - circle[0], y - circle[1]
                if abs(math.sqrt(across * across + down * down) - circle[2]) < _BESIDE:
                    angle = math.atan2(down, across)
                    covered[int((angle / (2.0 * math.pi) + 0.5) * _BINS) % _BINS] = True
    return np.sum(covered) / _BINS
