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

from __future__ import annotations

import math
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from perception.markers.circles import hough_circles
from perception.markers.ellipses import (
    ImageArray,
    MarkerExpectation,
    Markers,
    check_image,
    keep_plausible,
    measure_region,
)
from perception.stereo.geometry import StereoGeometry

FloatArray = NDArray[np.float64]

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
        image: (H, W) of `black_markers`.
        fewest: Pixels of a region that stays; those that touch at corners hang together.
    """
    kept = image.copy()
    _whiten_specks(kept, fewest)
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


def reduce_image(
    image: ImageArray, geometry: StereoGeometry, expected: MarkerExpectation
) -> NDArray[np.bool_]:
    """Return (H, W), the points that may lie about markers: all before the circles (fig. 5-8)."""
    level = threshold_level(image, geometry, expected)
    return _rims(image, level, fewest_pixels(geometry, expected))


def detect_hough(
    image: NDArray[Any],
    geometry: StereoGeometry,
    expected: MarkerExpectation,
    rng: np.random.Generator | None = None,
) -> Markers:
    """Find bright markers by the thesis' method.

    Args:
        image: (H, W) uint8, rectified.
        geometry: Of the camera.
        expected: Size, range and number of markers, and the image's noise.
        rng: Draws points; if None the same ones each time.

    Raises:
        ValueError: If the image is not grey of 8 bits or not of the geometry's size.
    """
    grey = check_image(image, geometry)
    level = threshold_level(grey, geometry, expected)
    fewest = fewest_pixels(geometry, expected)
    circles = hough_circles(_rims(grey, level, fewest), geometry, expected, rng)
    largest = expected.radii(geometry)[1]
    half = math.ceil(1.15 * largest) + 6
    square = math.pi * geometry.fx / geometry.fy
    most = math.ceil(1.3 * square * largest**2) + 4
    found = np.empty((len(circles), 32))
    count = _grow_all(
        grey, circles, level, half, fewest, most, expected.noise, expected.sampling, found
    )
    return keep_plausible(list(found[:count]), geometry, expected)


def _rims(image: ImageArray, level: int, fewest: int) -> NDArray[np.bool_]:
    black = drop_specks(black_markers(image, level), fewest)
    return rim_points(low_pass(signed_laplacian(black)))


def _levels(image: ImageArray) -> FloatArray:
    """Return (256,) parts of the pixels up to each grey level."""
    counts = np.asarray(cv2.calcHist([image], [0], None, [256], [0, 256]), dtype=float)
    return np.cumsum(counts.ravel()) / image.size


@numba.njit(cache=True)
def _grow_all(image: Any, circles: Any, level: int, half: int, fewest: int, most: int,
              noise: float, sampling: float, found: Any) -> int:  # fmt: skip
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
        if measure_region(
            image, column, row, half, fewest, most, noise, sampling, found[count]
        ):  # fmt: skip
            if found[count, 31] < _UNALIKE:
                count += 1
    return count


@numba.njit(cache=True)
def _whiten_specks(image: Any, fewest: int) -> None:
    """Make white, in place, what is black and hangs together in fewer pixels."""
    height, width = image.shape
    seen = np.zeros((height, width), np.bool_)
    group = np.empty((height * width, 2), np.int32)
    for row in range(height):
        for column in range(width):
            if image[row, column] != 0 or seen[row, column]:
                continue
            seen[row, column] = True
            group[0, 0], group[0, 1] = column, row
            done, used = 0, 1
            while done < used:
                c, r = group[done, 0], group[done, 1]
                done += 1
                for y in range(max(r - 1, 0), min(r + 2, height)):
                    for x in range(max(c - 1, 0), min(c + 2, width)):
                        if image[y, x] == 0 and not seen[y, x]:
                            seen[y, x] = True
                            group[used, 0], group[used, 1] = x, y
                            used += 1
            if used < fewest:
                for k in range(used):
                    image[group[k, 1], group[k, 0]] = 255
