"""Sub-pixel disparities by least squares on the images, with the slope of the surface.

Block matching takes the disparity as constant in its window. On ground seen from the side it
changes by a tenth of a pixel a row, which spoils the minimum of its cost. Here a plane of disparity
and an offset of brightness are fitted to each window by Gauss-Newton; the fit also tells how
certain the disparity is, and its residual betrays windows that hold no one surface.
"""

# numba's decorator has no types of its own.
# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownParameterType=false, reportMissingParameterType=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

import dataclasses
import math
from typing import NamedTuple

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


class ImageWindow(NamedTuple):
    """A square window of the left image.

    Attributes:
        column: Column of its middle [px].
        row: Row of its middle [px].
        half: Half of its edge [px].
    """

    column: int
    row: int
    half: int


class DisparityPlane(NamedTuple):
    """A plane of disparity over a window, and an offset of brightness.

    Attributes:
        disparity: In the middle of the window [px].
        by_column: Change of disparity per column [-].
        by_row: Change of disparity per row [-].
        offset: Grey level of the left image over that of the right one.
    """

    disparity: float
    by_column: float
    by_row: float
    offset: float


@numba.njit(cache=True)
def _refine(left, right, pixels, starts, half, iterations, result):
    rows, columns = left.shape
    count = (2 * half + 1) ** 2
    normal, target, step = np.zeros((4, 4)), np.zeros(4), np.zeros(4)
    for n in range(pixels.shape[0]):
        u, v = pixels[n, 0], pixels[n, 1]
        if u < half or u >= columns - half or v < half or v >= rows - half:
            continue
        window = ImageWindow(u, v, half)
        d, a, b = starts[n, 0], starts[n, 1], starts[n, 2]
        offset = 0.0
        fitted = False
        for _ in range(iterations):
            plane = DisparityPlane(d, a, b, offset)
            squares = _accumulate(left, right, window, plane, normal, target)
            if squares < 0.0 or not _solve(normal, target, step):
                break
            d, a, b = d + step[0], a + step[1], b + step[2]
            offset += step[3]
            # A window must not fold over itself, and what moved this far has lost its match.
            if abs(d - starts[n, 0]) > 2.0 or abs(a) > 0.7 or abs(b) > 1.5:
                break
            if abs(step[0]) < 1e-3 and half * (abs(step[1]) + abs(step[2])) < 1e-2:
                fitted = True
                break
        if not fitted:
            continue
        plane = DisparityPlane(d, a, b, offset)
        squares = _accumulate(left, right, window, plane, normal, target)
        target[0], target[1], target[2], target[3] = 1.0, 0.0, 0.0, 0.0
        if squares < 0.0 or not _solve(normal, target, step):
            continue
        variance = squares / (count - 4)
        result[n, 0], result[n, 1], result[n, 2] = d, a, b
        result[n, 3] = math.sqrt(step[0] * variance)
        result[n, 4] = math.sqrt(squares / count)
        result[n, 5] = _contrast(left, u, v, half)
        result[n, 6] = _contrast(left, u, v, half // 2)


@numba.njit(cache=True)
def _accumulate(left, right, window, plane, normal, target):
    """Fill the normal equations; return the sum of squares, or -1 where the window leaves."""
    u, v, half = window
    d, a, b, offset = plane
    last = right.shape[1] - 3
    normal[:] = 0.0
    target[:] = 0.0
    squares = 0.0
    for y in range(-half, half + 1):
        row = right[v + y]
        for x in range(-half, half + 1):
            at = u + x - (d + a * x + b * y)
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
            error = left[v + y, u + x] - value - offset
            squares += error * error
            # The picture moves to the left as the disparity grows.
            g1, g2 = gradient * x, gradient * y
            normal[0, 0] += gradient * gradient
            normal[0, 1] += gradient * g1
            normal[0, 2] += gradient * g2
            normal[0, 3] -= gradient
            normal[1, 1] += g1 * g1
            normal[1, 2] += g1 * g2
            normal[1, 3] -= g1
            normal[2, 2] += g2 * g2
            normal[2, 3] -= g2
            target[0] -= gradient * error
            target[1] -= g1 * error
            target[2] -= g2 * error
            target[3] += error
    normal[3, 3] = (2 * half + 1) ** 2
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
def _contrast(image, u, v, half):
    total, squares = 0.0, 0.0
    for y in range(v - half, v + half + 1):
        for x in range(u - half, u + half + 1):
            total += image[y, x]
            squares += image[y, x] * image[y, x]
    count = (2 * half + 1) ** 2
    return math.sqrt(max(squares / count - (total / count) ** 2, 0.0))
