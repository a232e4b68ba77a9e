"""A marker detector of today: bright blobs, a first ellipse, and its rim fitted to the grey levels.

The fit models what each pixel should hold if an ellipse of one grey level lies on another, so its
covariance follows from the pixels' noise, and its residuals reveal what is no ellipse.
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
    allocate_ellipses,
    check_image,
    keep_plausible,
)
from perception.stereo.geometry import StereoGeometry

_BAND = 2.5  # Pixels farther than this outside the first ellipse are left out of the fit [px].
_GAP = 1.0  # How far outside a marker something bright may begin [px].
_ITERATIONS = 12
_STEP, _HALT = 2e-3, 0.05  # A fit's last change, and that of one that gets no better [px].
_ABOVE_NOISE = 5.0  # The top hat's floor is the darkest of a window, two deviations down.


def find_blobs(
    image: ImageArray, geometry: StereoGeometry, expected: MarkerExpectation
) -> FloatArray:
    """Return bright spots that may be markers, by their second moments.

    A top hat takes away all that is wider than a marker at its nearest; what stays and exceeds
    six tenths of the least contrast, and the noise, is grouped.

    Args:
        image: (H, W) uint8.
        geometry: Geometry of the camera.
        expected: Sizes and contrast.

    Returns:
        (N, 5) ellipses, rough.
    """
    smallest, largest = expected.radii(geometry)
    narrow = geometry.fx / geometry.fy
    window = math.ceil(2.0 * largest * narrow) + 3, math.ceil(2.0 * largest) + 3
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, window)
    hat = cv2.morphologyEx(image, cv2.MORPH_TOPHAT, kernel)
    level = max(0.6 * expected.contrast, _ABOVE_NOISE * expected.noise)
    bright = np.asarray(cv2.threshold(hat, level, 255, cv2.THRESH_BINARY)[1])
    count, labels, stats, _ = cv2.connectedComponentsWithStats(bright, connectivity=4)
    width, height, area = np.asarray(stats[1:count, 2:]).T
    across, down = width / (2.0 * narrow), height / 2.0
    longest = np.maximum(across, down)
    may_be = (longest > 0.6 * smallest) & (longest < 1.2 * largest + 1.5)
    filled = area / (width * height)
    # An ellipse fills pi/4 of its box when upright, less when it is tilted.
    may_be &= (area >= 4) & ((filled > 0.4) | (area < 12))
    chosen = np.flatnonzero(may_be) + 1
    # Again at half the height: the low threshold joins a marker with faint neighbours.
    sums = _blob_sums(hat, labels, chosen, np.asarray(stats)[chosen, :4])
    pixels = np.maximum(sums[:, 1], 1.0)
    u, v = sums[:, 2] / pixels, sums[:, 3] / pixels
    suu = 4.0 * (sums[:, 4] / pixels - u * u) + 0.1
    suv = 4.0 * (sums[:, 5] / pixels - u * v)
    svv = 4.0 * (sums[:, 6] / pixels - v * v) + 0.1
    area = math.pi * np.sqrt(np.maximum(suu * svv - suv * suv, 1e-9))
    keep = (sums[:, 0] >= expected.contrast) & (pixels >= 3) & (np.abs(area - pixels - 2.0) < area)
    keep &= (np.maximum(suu / narrow**2, svv) > 0.4 * smallest**2) & (area > 2.0)
    keep &= (suv**2 < 0.9 * suu * svv) & (pixels > 0.75 * area)
    return np.stack([u, v, suu, suv, svv], axis=1)[keep]


def detect_blobs(
    image: NDArray[Any], geometry: StereoGeometry, expected: MarkerExpectation
) -> Markers:
    """Find bright markers as blobs that an ellipse fits.

    Args:
        image: (H, W) uint8, rectified.
        geometry: Geometry of the camera.
        expected: Size and range of markers, and the image's noise.

    Raises:
        ValueError: If the image is not grey of 8 bits or not of the geometry's size.
    """
    grey = check_image(image, geometry)
    starts = find_blobs(grey, geometry, expected)
    found, count = allocate_ellipses(len(starts)), 0
    for start in starts:
        if not _stands_alone(grey, start, expected.contrast):
            continue
        fitted = _fit(grey, start, expected.pixels, found, count)
        count += fitted and bool(found.misfits[count] < expected.misfit)
    return keep_plausible(found.first(count), geometry, expected)


@numba.njit(cache=True)
def _blob_sums(hat: Any, labels: Any, chosen: Any, boxes: Any) -> Any:
    """Return of each group its peak, and of its pixels above half of that: sums for moments."""
    sums = np.zeros((len(chosen), 7))
    for k in range(len(chosen)):
        left, top, width, height = boxes[k]
        box = hat[top : top + height, left : left + width].copy()
        for y in range(height):
            for x in range(width):
                if labels[top + y, left + x] != chosen[k]:
                    box[y, x] = 0
        rows, columns = np.nonzero(box > 0.5 * np.max(box))
        x, y = columns + left, rows + top
        moments = (np.sum(x), np.sum(y), np.sum(x * x), np.sum(x * y), np.sum(y * y))
        sums[k] = np.array((np.max(box), len(rows), *moments))
    return sums


@numba.njit(cache=True)
def _peak(image: Any, p: Any) -> float:
    """Return the brightest grey level in the middle of an ellipse."""
    u, v = int(round(p[0])), int(round(p[1]))
    return float(np.max(image[max(v - 1, 0) : v + 2, max(u - 1, 0) : u + 2]))


@numba.njit(cache=True)
def _stands_alone(image: Any, p: Any, contrast: float) -> bool:
    """Return whether all is darker one or two pixels outside an ellipse; textures have neighbours.

    A pixel's width of a face is enough: beyond its edge may be bright ground.
    """
    height, width = image.shape
    around, low = 0.0, 255.0
    peak = _peak(image, p)
    bound = math.sqrt(p[2] * p[4] - p[3] * p[3])
    for k in range(16):
        cos, sin = math.cos(k * math.pi / 8.0), math.sin(k * math.pi / 8.0)
        # The rim along this direction.
        inverse = (p[4] * cos * cos - 2.0 * p[3] * cos * sin + p[2] * sin * sin) / bound**2
        darkest = 255.0
        for gap in (2.0, 1.0):
            reach = 1.0 / math.sqrt(inverse) + gap
            u, v = int(round(p[0] + reach * cos)), int(round(p[1] + reach * sin))
            if not (0 <= u < width and 0 <= v < height):
                return False
            darkest = min(darkest, float(image[v, u]))
        low = min(low, darkest)
        around = max(around, darkest)
    return peak - around > 0.5 * (peak - low) and peak - around > 0.7 * contrast


@numba.njit(cache=True)
def _covered(p: Any, dx: float, dy: float, slopes: Any) -> float:
    """Return the part of a pixel that an ellipse covers, and its slopes by the ellipse.

    Args:
        p: (5,) or longer, an ellipse.
        dx: Columns from its centre [px].
        dy: Rows from its centre [px].
        slopes: (5,), is filled.
    """
    scale = 1.0 / (p[2] * p[4] - p[3] * p[3])
    iuu, iuv, ivv = p[4] * scale, -p[3] * scale, p[2] * scale
    slopes[:] = 0.0
    gx, gy = iuu * dx + iuv * dy, iuv * dx + ivv * dy
    rho = math.sqrt(dx * gx + dy * gy)
    distance = (rho - 1.0) * rho / (math.sqrt(gx * gx + gy * gy) + 1e-12)
    if distance > 1.5:
        return 0.0
    if distance < -1.5:
        return 1.0
    part = 0.0
    for j in range(-1, 2):
        for i in range(-1, 2):
            x, y = dx + i / 3.0, dy + j / 3.0
            gx, gy = iuu * x + iuv * y, iuv * x + ivv * y
            rho = math.sqrt(x * gx + y * gy)
            slope = math.sqrt(gx * gx + gy * gy) + 1e-12
            # A third of a pixel is as wide as its projection on the rim's normal.
            wide = (abs(gx) + abs(gy)) / (3.0 * slope) + 1e-6
            share = 0.5 - (rho - 1.0) * rho / (slope * wide)
            if share >= 1.0:
                part += 1.0
            elif share > 0.0:
                part += share
                slopes[0] += gx / (slope * wide)
                slopes[1] += gy / (slope * wide)
                slopes[2] += gx * gx / (2.0 * slope * wide)
                slopes[3] += gx * gy / (slope * wide)
                slopes[4] += gy * gy / (2.0 * slope * wide)
    slopes /= 9.0
    return part / 9.0


class RimWindow(NamedTuple):
    """Pixels that an ellipse is fitted to, and the first ellipse, by which they are chosen.

    Attributes:
        left: First column [px].
        top: First row [px].
        right: Last column [px].
        bottom: Last row [px].
        first: (5,) first ellipse.
        level: Grey level from which on a pixel more than `_GAP` outside the first ellipse is of
            something else, and left out.
    """

    left: int
    top: int
    right: int
    bottom: int
    first: FloatArray
    level: float


class NormalEquations(NamedTuple):
    """Sums of a weighted least-squares fit, overwritten by it.

    Attributes:
        normal: (7, 7) normal matrix.
        gradient: (7,) right-hand side.
        sums: (3,) weighted squares, squares [grey levels^2], and number of pixels.
    """

    normal: FloatArray
    gradient: FloatArray
    sums: FloatArray


@numba.njit(cache=True)
def _sums(
    image: Any,
    p: Any,
    trial: Any,
    window: RimWindow,
    pixels: PixelNoise,
    equations: NormalEquations,
    equate: bool,
) -> None:
    """Sum up the squares of a trial with the weights of p; if asked, its normal equations too.

    p and trial are an ellipse, the background and the contrast.
    """
    (noise, sampling), (normal, gradient, sums) = pixels, equations
    normal[:] = 0.0
    gradient[:] = 0.0
    sums[:] = 0.0
    jac, slopes, first = np.empty(7), np.empty(5), window.first
    determinant = first[2] * first[4] - first[3] * first[3]
    iuu, iuv, ivv = first[4] / determinant, -first[3] / determinant, first[2] / determinant
    for y in range(window.top, window.bottom + 1):
        for x in range(window.left, window.right + 1):
            dx, dy = x - first[0], y - first[1]
            gx, gy = iuu * dx + iuv * dy, iuv * dx + ivv * dy
            rho = math.sqrt(dx * gx + dy * gy)
            outside, slope = (rho - 1.0) * rho, math.sqrt(gx * gx + gy * gy)
            if outside > _BAND * slope or outside > _GAP * slope and image[y, x] > window.level:
                continue
            part = _covered(p, x - p[0], y - p[1], slopes)
            weight = 1.0 / (noise**2 + (sampling * p[6]) ** 2 * 4.0 * part * (1.0 - part))
            part = _covered(trial, x - trial[0], y - trial[1], slopes)
            error = image[y, x] - trial[5] - trial[6] * part
            sums[0] += weight * error * error
            sums[1] += error * error
            sums[2] += 1.0
            if equate:
                jac[:5] = trial[6] * slopes
                jac[5], jac[6] = 1.0, part
                for i in range(7):
                    gradient[i] += weight * jac[i] * error
                    for j in range(7):
                        normal[i, j] += weight * jac[i] * jac[j]


@numba.njit(cache=True)
def _inverse(matrix: Any) -> Any:
    """Return the inverse of a positive matrix by elimination; LAPACK takes seconds to compile."""
    size = len(matrix)
    left, right = matrix.copy(), np.eye(size)
    for k in range(size):
        pivot = left[k, k]
        left[k] /= pivot
        right[k] /= pivot
        for i in range(size):
            if i != k:
                factor = left[i, k]
                left[i] -= factor * left[k]
                right[i] -= factor * right[k]
    return right


@numba.njit(cache=True)
def _proper(trial: Any, start: Any) -> bool:
    """Return whether a trial is an ellipse, and not far from where the fit started."""
    if min(trial[2], trial[4]) < 0.3 or trial[6] < 1.0:
        return False
    if trial[2] * trial[4] - trial[3] * trial[3] < 0.1:
        return False
    if max(trial[2] - 4.0 * start[2], trial[4] - 4.0 * start[4]) > 4.0:
        return False
    return math.hypot(trial[0] - start[0], trial[1] - start[1]) < _BAND


@numba.njit(cache=True)
def _descend(
    image: Any,
    p: Any,
    window: RimWindow,
    pixels: PixelNoise,
    equations: NormalEquations,
    fixed: bool,
) -> float:
    """Bring an ellipse (7,) nearer to the least squares; return its last change [px], or 0 at rest.

    Weights follow the ellipse. With a rim that is no ellipse's they may chase it for ever; fixed
    ones let it settle.
    """
    start, (normal, gradient, sums) = window.first, equations
    spare = NormalEquations(np.empty((7, 7)), np.empty(7), sums)
    trial, weighing, damping, change = np.empty(7), p.copy(), 1e-3, np.inf
    for _ in range(_ITERATIONS):
        if not fixed:
            weighing[:] = p
        _sums(image, weighing, p, window, pixels, equations, True)
        cost, better = sums[0], False
        for _ in range(4):
            damped = normal.copy()
            for i in range(7):
                damped[i, i] = damped[i, i] * (1.0 + damping) + 1e-9
            step = np.sum(_inverse(damped) * gradient, axis=1)
            change = np.max(np.abs(step[:2]))
            trial[:] = p + step
            if _proper(trial, start):
                _sums(image, weighing, trial, window, pixels, spare, False)
                if sums[0] < cost:
                    better = True
                    break
            damping *= 10.0
        if better:
            p[:] = trial
            damping = max(damping * 0.1, 1e-6)
        # The model has kinks where a part of a pixel is just covered: there a fit may halt.
        if change < (_STEP if better else _HALT):
            return 0.0
        if not better:
            break
    return change


@numba.njit(cache=True)
def _fit(image: Any, start: Any, pixels: PixelNoise, found: MeasuredEllipses, number: int) -> bool:
    """Fit an ellipse of one grey level on another to an image, by weighted least squares.

    Args:
        image: (H, W) uint8.
        start: (5,) first ellipse, rough.
        pixels: Noise of the pixels.
        found: Ellipses, of which one is written; its misfit is the r.m.s. difference over the
            contrast.
        number: Index of the ellipse that is written.

    Returns:
        Whether the fit converged within the image.
    """
    height, width = image.shape
    p = np.empty(7)
    p[:5] = start
    reach_x, reach_y = math.sqrt(p[2]) + _BAND, math.sqrt(p[4]) + _BAND
    left, right = math.floor(p[0] - reach_x), math.ceil(p[0] + reach_x)
    top, bottom = math.floor(p[1] - reach_y), math.ceil(p[1] + reach_y)
    if left < 0 or top < 0 or right >= width or bottom >= height:
        return False
    inside = image[top : bottom + 1, left : right + 1]
    low, high = float(np.min(inside)), _peak(image, start)
    window = RimWindow(left, top, right, bottom, start, 0.5 * (low + high))
    p[5], p[6] = low, max(high - low, 1.0)
    normal, sums = np.empty((7, 7)), np.empty(3)
    equations = NormalEquations(normal, np.empty(7), sums)
    for fixed in (False, True):
        change = _descend(image, p, window, pixels, equations, fixed)
        _sums(image, p, p, window, pixels, equations, True)
        for i in range(7):
            normal[i, i] += 1e-9
        covariance = _inverse(normal)
        # What the weights do not explain, the background's texture or a rim that is no ellipse.
        excess = max(sums[0] / max(sums[2] - 7.0, 1.0), 1.0)
        # A blurred rim leaves the fit wandering, but within what its covariance says.
        own = math.sqrt(excess * max(covariance[0, 0], covariance[1, 1]))
        if change <= max(_HALT, own):
            break
    else:
        return False
    found.ellipses[number] = p[:5]
    found.covariances[number] = excess * covariance[:5, :5]
    found.contrasts[number] = p[6]
    found.misfits[number] = math.sqrt(sums[1] / sums[2]) / p[6]
    return True
