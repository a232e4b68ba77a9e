"""Sub-pixel disparities by least squares on the images, with the slope of the surface.

Block matching takes the disparity as constant in its window. On ground seen from the side it
changes by a tenth of a pixel a row, which spoils the minimum of its cost. Here a plane of disparity
and an offset of brightness are fitted to each window by Gauss-Newton; the fit also yields how
certain the disparity is, and its residual betrays windows that hold no one surface.
"""

# numba's decorator has no types of its own.
# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray


@dataclasses.dataclass(frozen=True)
class Refinement:
    """Fits of N windows; all NaN where a fit left the images or did not converge.

    Attributes:
        disparities: (N,) in the middle of the window [px].
        slopes: (N, 2) change of disparity per column and per row [-].
        sigmas: (N,) standard deviation of the disparity that image noise explains [px].
        residuals: (N,) r.m.s. difference of the two windows [grey levels].
        contrasts: (N,) r.m.s. of the left window about its mean [grey levels].
        inner_contrasts: (N,) r.m.s. of the middle half of the window about its mean [grey levels].
    """

    disparities: FloatArray
    slopes: FloatArray
    sigmas: FloatArray
    residuals: FloatArray
    contrasts: FloatArray
    inner_contrasts: FloatArray


def refine(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    pixels: NDArray[np.int64],
    starts: FloatArray,
    half: int,
    iterations: int = 15,
) -> Refinement:
    """Fit a plane of disparity to the window about each pixel.

    Args:
        left: (H, W) image, rows aligned with `right`.
        right: (H, W) image.
        pixels: (N, 2) column and row in the left image.
        starts: (N, 3) disparity [px] and its slopes by column and row to start from; the
            disparity within a pixel or so.
        half: Half of the window's edge [px]; it has 2 half + 1 pixels a side.
        iterations: Most steps of Gauss-Newton.
    """
    result = np.full((len(pixels), 7), np.nan)
    _refine(left, right, pixels, starts, half, iterations, result)
    sigmas, residuals, contrasts, inner = result[:, 3:].T
    return Refinement(result[:, 0], result[:, 1:3], sigmas, residuals, contrasts, inner)


@numba.njit(cache=True)
def _refine(left, right, pixels, starts, half, iterations, result):
    rows, columns = left.shape
    count = (2 * half + 1) ** 2
    normal, target, step, plane = np.zeros((4, 4)), np.zeros(4), np.zeros(4), np.zeros(4)
    for n in range(pixels.shape[0]):
        u, v = pixels[n, 0], pixels[n, 1]
        if u < half or u >= columns - half or v < half or v >= rows - half:
            continue
        window = left[v - half : v + half + 1, u - half : u + half + 1]
        strip = right[v - half : v + half + 1]
        plane[:3] = starts[n]
        plane[3] = 0.0
        fitted = False
        for _ in range(iterations):
            squares = _accumulate(window, strip, u, plane, normal, target)
            if squares < 0.0 or not _solve(normal, target, step):
                break
            plane += step
            # A window must not fold over itself, and what moved this far has lost its match.
            moved = abs(plane[0] - starts[n, 0])
            if moved > 2.0 or abs(plane[1]) > 0.7 or abs(plane[2]) > 1.5:
                break
            if abs(step[0]) < 1e-3 and half * (abs(step[1]) + abs(step[2])) < 1e-2:
                fitted = True
                break
        if not fitted:
            continue
        squares = _accumulate(window, strip, u, plane, normal, target)
        target[:] = 0.0
        target[0] = 1.0
        if squares < 0.0 or not _solve(normal, target, step):
            continue
        result[n, :3] = plane[:3]
        result[n, 3] = math.sqrt(step[0] * (squares / (count - 4)))
        result[n, 4] = math.sqrt(squares / count)
        result[n, 5] = _contrast(window)
        inner = half - half // 2
        result[n, 6] = _contrast(window[inner : 2 * half + 1 - inner, inner : 2 * half + 1 - inner])


@numba.njit(cache=True)
def _accumulate(window, strip, column, plane, normal, target):
    """Fill the normal equations of a window's plane of disparity and offset of brightness.

    Args:
        window: (2 half + 1, 2 half + 1) window of the left image.
        strip: (2 half + 1, W) the same rows of the right image.
        column: Column of the window's middle [px].
        plane: (4,) disparity in the middle [px], its change per column and per row, and the grey
            level of the left image over that of the right one.
        normal: (4, 4) normal matrix, of which the upper triangle is written.
        target: (4,) right-hand side, written.

    Returns:
        The sum of squares, or -1 where the window leaves the right image.
    """
    half, last = window.shape[0] // 2, strip.shape[1] - 3
    d, a, b, offset = plane[0], plane[1], plane[2], plane[3]
    normal[:] = 0.0
    target[:] = 0.0
    squares = 0.0
    for y in range(-half, half + 1):
        row = strip[y + half]
        for x in range(-half, half + 1):
            at = column + x - (d + a * x + b * y)
            k = int(math.floor(at))
            if k < 1 or k > last:
                return -1.0
            t = at - k
            p, q, r, s = row[k - 1], row[k], row[k + 1], row[k + 2]
            # Catmull-Rom: the curve through q and r with central differences as slopes.
            c1 = 0.5 * (r - p)
            c2 = p - 2.5 * q + 2.0 * r - 0.5 * s
            c3 = 0.5 * (s - p) + 1.5 * (q - r)
            value = q + t * (c1 + t * (c2 + t * c3))
            gradient = c1 + t * (2.0 * c2 + t * 3.0 * c3)
            error = window[y + half, x + half] - value - offset
            squares += error * error
            # The picture moves to the left as the disparity grows.
            slopes = (gradient, gradient * x, gradient * y, -1.0)
            for i in range(4):
                target[i] -= slopes[i] * error
                for j in range(i, 4):
                    normal[i, j] += slopes[i] * slopes[j]
    return squares


@numba.njit(cache=True)
def _solve(normal, target, solution):
    """Solve by Cholesky from the upper triangle; False where a direction is not seen."""
    lower = np.zeros((4, 4))
    for i in range(4):
        for j in range(i + 1):
            total = normal[j, i]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-6 * normal[i, i] + 1e-12:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(4):
        total = target[i]
        for k in range(i):
            total -= lower[i, k] * solution[k]
        solution[i] = total / lower[i, i]
    for i in range(3, -1, -1):
        total = solution[i]
        for k in range(i + 1, 4):
            total -= lower[k, i] * solution[k]
        solution[i] = total / lower[i, i]
    return True


@numba.njit(cache=True)
def _contrast(window):
    """Return the r.m.s. of a window about its mean."""
    total, squares = 0.0, 0.0
    for y in range(window.shape[0]):
        for x in range(window.shape[1]):
            total += window[y, x]
            squares += window[y, x] * window[y, x]
    return math.sqrt(max(squares / window.size - (total / window.size) ** 2, 0.0))
