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


# Without strict order of its sums the loop of `_accumulate` runs on eight pixels at a time. It is
# inlined here: a compiled copy of its own might sum in another order than one from the cache.
@numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _refine(left, right, pixels, starts, half, iterations, result):
    rows, columns = left.shape
    count, right = (2 * half + 1) ** 2, right.ravel()
    normal, target, step, plane = np.zeros((4, 4)), np.zeros(4), np.zeros(4), np.zeros(4)
    lower = np.zeros((4, 4))
    # Pixels of a window in one row, so that they are taken several at a time.
    window, within = np.empty((3, count), np.float32), np.empty(count, np.int32)
    for n in range(pixels.shape[0]):
        u, v = pixels[n, 0], pixels[n, 1]
        if u < half or u >= columns - half or v < half or v >= rows - half:
            continue
        i = 0
        for y in range(-half, half + 1):
            for x in range(-half, half + 1):
                window[0, i], window[1, i], window[2, i] = x, y, left[v + y, u + x]
                within[i] = (v + y) * columns + u + x
                i += 1
        plane[:3] = starts[n]
        plane[3] = 0.0
        fitted, squares = False, 0.0
        for _ in range(iterations):
            if not _inside(u, half, columns, plane):
                break
            squares = _accumulate(window, within, right, plane, normal, target)
            if not _solve(normal, target, lower, step):
                break
            plane += step
            # A window must not fold over itself, and what moved this far has lost its match.
            moved = abs(plane[0] - starts[n, 0])
            if moved > 2.0 or abs(plane[1]) > 0.7 or abs(plane[2]) > 1.5:
                break
            # What is left is a tenth of the step or so.
            if abs(step[0]) < 3e-3 and half * (abs(step[1]) + abs(step[2])) < 2e-2:
                fitted = True
                break
        if not (fitted and _inside(u, half, columns, plane)):
            continue
        target[:] = 0.0
        target[0] = 1.0
        if not _solve(normal, target, lower, step):
            continue
        result[n, :3] = plane[:3]
        result[n, 3] = math.sqrt(step[0] * (squares / (count - 4)))
        result[n, 4] = math.sqrt(squares / count)
        part = left[v - half : v + half + 1, u - half : u + half + 1]
        result[n, 5] = _contrast(part)
        inner = half - half // 2
        result[n, 6] = _contrast(part[inner : 2 * half + 1 - inner, inner : 2 * half + 1 - inner])


@numba.njit(cache=True)
def _inside(column, half, columns, plane):
    """Return whether the right image has all that a window's fit takes from it.

    Args:
        column: Column of the window's middle [px].
        half: Half of the window's edge [px].
        columns: Width of the right image [px].
        plane: (4,) disparity in the middle [px], and its change per column and per row.
    """
    for y in (-half, half):
        for x in (-half, half):
            at = math.floor(column + x - (plane[0] + plane[1] * x + plane[2] * y))
            if at < 1 or at > columns - 3:
                return False
    return True


@numba.njit(cache=True, inline="always")
def _accumulate(window, within, right, plane, normal, target):
    """Fill the normal equations of a window's plane of disparity and offset of brightness.

    Args:
        window: (3, N) columns and rows from the window's middle [px], and left grey levels.
        within: (N,) flat indices of the same pixels.
        right: (H * W,) right image, flat.
        plane: (4,) disparity in the middle [px], its change per column and per row, and the grey
            level of the left image over that of the right one; the window is inside.
        normal: (4, 4) normal matrix, of which the upper triangle is written.
        target: (4,) right-hand side, written.

    Returns:
        The sum of squares.
    """
    # Of single precision, of which the processor takes twice as many at a time.
    d, a, b, offset = (
        np.float32(plane[0]),
        np.float32(plane[1]),
        np.float32(plane[2]),
        np.float32(plane[3]),
    )
    half, zero = np.float32(0.5), np.float32(0.0)
    squares = gg = ggx = ggy = gxgx = gxgy = gygy = zero
    g_sum = gx_sum = gy_sum = g_error = gx_error = gy_error = error_sum = zero
    for i in range(within.size):
        x, y = window[0, i], window[1, i]
        moved = -(d + a * x + b * y)
        whole = np.floor(moved)
        t = moved - whole
        k = np.uint32(within[i] + np.int32(whole))  # Unsigned, as negative indices take a branch.
        p, q = right[k - np.uint32(1)], right[k]
        r, s = right[k + np.uint32(1)], right[k + np.uint32(2)]
        # Catmull-Rom: the curve through q and r with central differences as slopes.
        c1 = half * (r - p)
        c2 = p - (q + q) + (r + r) - half * (q + s)
        c3 = half * (s - p + q - r) + (q - r)
        value = q + t * (c1 + t * (c2 + t * c3))
        g = c1 + t * (c2 + c2 + t * (c3 + c3 + c3))
        error = window[2, i] - value - offset
        gx, gy = g * x, g * y
        squares += error * error
        gg += g * g
        ggx += g * gx
        ggy += g * gy
        gxgx += gx * gx
        gxgy += gx * gy
        gygy += gy * gy
        g_sum += g
        gx_sum += gx
        gy_sum += gy
        g_error += g * error
        gx_error += gx * error
        gy_error += gy * error
        error_sum += error
    # The picture moves to the left as the disparity grows: the slopes are (g, gx, gy, -1).
    normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3] = gg, ggx, ggy, -g_sum
    normal[1, 1], normal[1, 2], normal[1, 3] = gxgx, gxgy, -gx_sum
    normal[2, 2], normal[2, 3] = gygy, -gy_sum
    normal[3, 3] = within.size
    target[0], target[1], target[2], target[3] = -g_error, -gx_error, -gy_error, error_sum
    return squares


@numba.njit(cache=True)
def _solve(normal, target, lower, solution):
    """Solve by Cholesky from the upper triangle; False where a direction is not seen."""
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
