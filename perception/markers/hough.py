"""The thesis' marker detector, step by step (section 5.3, eqs. 5-5 to 5-9).

Equalise, threshold, Laplacian, low pass, threshold, tracking Hough transform, region growing. Where
the printed steps fail they are mended: the first threshold comes from the area that the markers
must have at their range; the Laplacian keeps its sign about mid-grey, so that the histogram has its
peak there; the markers are made black first, so that the rim's points lie around a marker and even
one of four pixels keeps a ring; the two bisectors of 5-7 are solved without the slopes of 5-8,
which divide by zero; and the circle test takes place in square pixels. Specks too small for any
marker go before the filters: of some 200 bright spots of textured ground a dozen stay, and the
Hough transform is as much quicker.
"""

import math
from typing import Any, NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.ellipses import (
    MarkerExpectation,
    Markers,
    MeasuredEllipses,
    PixelNoise,
    RegionLimits,
    allocate_ellipses,
    check_image,
    keep_plausible,
    measure_region,
)
from perception.stereo.geometry import StereoGeometry

MID_GREY = 128
BELOW_PEAK = 5
"""The second threshold, in grey levels below the histogram's peak (section 5.3)."""
LEAST_COVERAGE = 0.35
"""Part of a circumference that must be found (section 5.3)."""
_SURPLUS = 1.5  # Bright pixels that are let through, over those of all markers at their nearest.
_UNALIKE = 0.35  # Largest logarithm of a region's area over that of its ellipse.


def equalise(image: ImageArray) -> FloatArray:
    """Return (H, W) parts of all pixels that are no brighter: histogram equalisation to 0..1.

    Eight bits would merge the brightest half per cent of an image, the markers, into one level.
    """
    return _levels(image)[image]


def threshold_level(
    image: ImageArray, geometry: StereoGeometry, expected: MarkerExpectation
) -> int:
    """Return the least grey level of what may be a marker.

    The threshold on the equalised image is the part of it that is not marker: the markers' number,
    size and range give their area, of which one and a half times is let through.
    """
    area = math.pi * expected.radii(geometry)[1] ** 2 * geometry.fx / geometry.fy
    part = min(_SURPLUS * expected.count * area / image.size, 1.0)
    below = _levels(image)
    # The equalised value of a level is the part up to and with it; brighter ones are kept.
    return int(np.searchsorted(below, 1.0 - part)) + 1


def black_markers(image: ImageArray, level: int) -> ImageArray:
    """Return (H, W) 0 where the image is at least as bright as a level, else 255."""
    return np.asarray(cv2.threshold(image, level - 1, 255, cv2.THRESH_BINARY_INV)[1], np.uint8)


def drop_specks(image: ImageArray, fewest: int) -> ImageArray:
    """Return (H, W), the black regions that have enough pixels on white.

    Args:
        image: (H, W) image of `black_markers`.
        fewest: Pixels of a region that stays; those that touch at corners hang together.
    """
    labels = np.asarray(cv2.connectedComponents(255 - image, connectivity=8)[1], np.int32)
    black, kept = image == 0, image.copy()
    regions = labels[black]
    kept[black] = np.where(np.bincount(regions)[regions] < fewest, 255, 0)
    return kept


def fewest_pixels(geometry: StereoGeometry, expected: MarkerExpectation) -> int:
    """Return half the pixels of the farthest and most slanted marker: no marker gives fewer."""
    square = math.pi * geometry.fx / geometry.fy
    return math.floor(0.5 * square * expected.radii(geometry)[0] ** 2 * math.cos(expected.slant))


def signed_laplacian(image: ImageArray) -> ImageArray:
    """Return (H, W), a quarter of the Laplacian (eqs. 5-5 and 5-6) about mid-grey, 8 bits."""
    second = cv2.Laplacian(image, cv2.CV_16S, ksize=1, borderType=cv2.BORDER_REPLICATE)
    # An eighth would lose nothing, but leave gaps in a rim that is cut at five below the peak.
    shown = cv2.addWeighted(second, 0.25, second, 0.0, MID_GREY, dtype=cv2.CV_8U)
    return np.asarray(shown, dtype=np.uint8)


def low_pass(image: ImageArray) -> ImageArray:
    """Return (H, W), the mean over 3 x 3 pixels."""
    return np.asarray(cv2.blur(image, (3, 3), borderType=cv2.BORDER_REPLICATE), np.uint8)


def rim_points(image: ImageArray) -> NDArray[np.bool_]:
    """Return (H, W), where the filtered image is darker than its histogram's peak less five."""
    histogram = cv2.calcHist([image], [0], None, [256], [0, 256])
    return image < int(np.argmax(histogram)) - BELOW_PEAK


def detect_hough(
    image: NDArray[Any], geometry: StereoGeometry, expected: MarkerExpectation
) -> Markers:
    """Find bright markers by the thesis' method.

    Args:
        image: (H, W) uint8, rectified.
        geometry: Geometry of the camera.
        expected: Size, range and number of markers, and the image's noise.

    Raises:
        ValueError: If the image is not grey of 8 bits or not of the geometry's size.
    """
    grey = check_image(image, geometry)
    level = threshold_level(grey, geometry, expected)
    fewest = fewest_pixels(geometry, expected)
    circles = hough_circles(find_rims(grey, level, fewest), geometry, expected)
    largest = expected.radii(geometry)[1]
    half = math.ceil(1.15 * largest) + 6
    square = math.pi * geometry.fx / geometry.fy
    most = math.ceil(1.3 * square * largest**2) + 4
    found = allocate_ellipses(len(circles))
    limits = RegionLimits(half, fewest, most)
    count = _grow_all(grey, circles, level, limits, expected.pixels, found)
    return keep_plausible(found.first(count), geometry, expected)


def find_rims(image: ImageArray, level: int, fewest: int) -> NDArray[np.bool_]:
    """Return the points (H, W) that may lie about markers: all before the circles (fig. 5-8).

    Args:
        image: (H, W) grey image.
        level: Grey level from which on a pixel may be of a marker.
        fewest: Least number of pixels of a marker.
    """
    black = drop_specks(black_markers(image, level), fewest)
    return rim_points(low_pass(signed_laplacian(black)))


def _levels(image: ImageArray) -> FloatArray:
    """Return (256,) parts of the pixels up to each grey level."""
    counts = np.asarray(cv2.calcHist([image], [0], None, [256], [0, 256]), dtype=float)
    return np.cumsum(counts.ravel()) / image.size


@numba.njit(cache=True)
def _grow_all(
    image: Any,
    circles: Any,
    level: int,
    limits: RegionLimits,
    pixels: PixelNoise,
    found: MeasuredEllipses,
) -> int:
    """Grow a region in each circle and write those that are like ellipses; return their number."""
    height, width = image.shape
    tried = np.zeros((height, width), np.bool_)
    count = 0
    for k in range(len(circles)):
        column, row = int(round(circles[k, 0])), int(round(circles[k, 1]))
        if circles[k, 3] <= LEAST_COVERAGE:
            continue
        # The region grows from the brightest pixel, so each of those is tried once.
        best, seed_x, seed_y = -1, 0, 0
        for y in range(max(row - 1, 0), min(row + 2, height)):
            for x in range(max(column - 1, 0), min(column + 2, width)):
                if image[y, x] > best:
                    best, seed_x, seed_y = int(image[y, x]), x, y
        # Whatever is round and dark has a rim as well.
        if best < level or tried[seed_y, seed_x]:
            continue
        tried[seed_y, seed_x] = True
        measured = measure_region(image, column, row, limits, pixels, found, count)
        if measured and found.misfits[count] < _UNALIKE:
            count += 1
    return count


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
        geometry: Geometry of the camera, which makes the pixels square.
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
    limits = CircleLimits(
        geometry.fy / geometry.fx, least, 1.6 * (largest + RING), 2.2 * (largest + RING)
    )
    return _track(
        columns[order].astype(np.int32),
        rows[order].astype(np.int32),
        (geometry.height, geometry.width),
        limits,
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


class CircleLimits(NamedTuple):
    """Sizes of circles, in pixels of the rows.

    Attributes:
        stretch: Width of a pixel over its height.
        least: Least radius, and least length of a chord [px].
        most: Largest radius [px].
        far: Largest distance between points of one circle [px].
    """

    stretch: float
    least: float
    most: float
    far: float


class RimPoints(NamedTuple):
    """Points that may lie on rims, and what the tracking keeps of them.

    Attributes:
        columns: (N,) columns [px].
        rows: (N,) rows [px].
        number: (H, W) number of the point in each pixel, or -1.
        free: (N,) whether a point is on no circle yet.
        mark: (N,) first point of the chain that last held each.
        members: (M,) the chain at hand.
    """

    columns: NDArray[np.int32]
    rows: NDArray[np.int32]
    number: NDArray[np.int32]
    free: NDArray[np.bool_]
    mark: NDArray[np.int32]
    members: NDArray[np.int32]


@numba.njit(cache=True)
def _chain(first: int, points: RimPoints, far: float, stretch: float) -> int:
    """Gather the free points that hang together with one, within a distance of it."""
    columns, rows, index, free, mark, members = points
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
def _track(columns: Any, rows: Any, shape: tuple[int, int], limits: CircleLimits, seed: int) -> Any:
    """Fit circles to three points of a chain at a time, and track those that agree."""
    count = len(columns)
    stretch, least, most, far = limits
    index = np.full(shape, -1, np.int32)
    for k in range(count):
        index[rows[k], columns[k]] = k
    free = np.ones(count, np.bool_)
    mark = np.full(count, -1, np.int32)
    # Half a rim is enough to draw from.
    members = np.empty(8 + int(1.2 * far) + _AROUND, np.int32)
    points = RimPoints(columns, rows, index, free, mark, members)
    circles = np.zeros((512, 4))
    found, state = 0, seed
    for first in range(count):
        if not free[first]:
            continue
        used = _chain(first, points, far, stretch)
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
            for i, value in enumerate((x, y, radius)):
                circles[match, i] = (weight * circles[match, i] + value) / (weight + 1.0)
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
