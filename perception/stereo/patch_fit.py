"""A patch of one image fitted to another by least squares: place, affine distortion, brightness."""

import dataclasses
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray

FloatImage = NDArray[np.float32]

EVERYTHING = np.ones(6, np.bool_)
"""Place (column, row) and distortion (by column, by row of each) are fitted."""

COLUMN_ONLY = np.array([True, False, True, True, False, False])
"""Rows correspond, as in a rectified pair."""

ITERATIONS = 30
LEAST_STEP = 1e-3  # [px]
LARGEST_CONDITION = 1e8  # Of the normal equations, scaled: beyond it the patch is flat.
MOST_GROWTH = 0.8  # Of a patch's area, and most shrinking.


@dataclasses.dataclass(frozen=True)
class PatchFit:
    """Where a patch was found.

    Attributes:
        place: (2,) column and row of its centre [px].
        warp: (2, 2) from offsets in the first image to offsets in the second.
        correlation: Normalised, of the patches.
        sigma: (2,) standard deviations of the place as the fit's residuals explain them [px]; 0
            for what was not fitted.
    """

    place: FloatArray
    warp: FloatArray
    correlation: float
    sigma: FloatArray


def fit_patch(
    first: FloatImage,
    second: FloatImage,
    centre: FloatArray,
    start: FloatArray,
    warp: FloatArray,
    half: int,
    free: NDArray[np.bool_],
) -> PatchFit | None:
    """Fit ``second(place + warp o)`` to ``gain first(centre + o) + offset`` over a patch.

    Args:
        first: Image of the patch.
        second: Image to find it in.
        centre: (2,) column and row in the first [px].
        start: (2,) column and row in the second to begin from [px].
        warp: (2, 2) to begin from.
        half: Offsets o run from -half to half [px].
        free: (6,) what is fitted: column, row, and the distortion's cc, cr, rc, rr.

    Returns:
        The fit; None if the patch leaves an image, is flat, or the fit does not converge.
    """
    template = sample_patch(first, centre, np.eye(2), half)
    if template is None:
        return None
    place, shape = np.asarray(start, dtype=float), np.asarray(warp, dtype=float)
    steps = np.arange(-half, half + 1, dtype=float)
    right, down = (grid.ravel() for grid in np.meshgrid(steps, steps))
    known = template.ravel().astype(float)
    fitted = np.append(free, [True, True])
    for _ in range(ITERATIONS):
        sampled = _sampled(second, place, shape, half)
        if sampled is None:
            return None
        value, by_x, by_y = sampled
        # Brightness is linear: gain and offset are fitted anew each time, from nothing.
        jacobian = np.column_stack(
            [by_x, by_y, by_x * right, by_x * down, by_y * right, by_y * down, -known]
            + [-np.ones_like(known)]
        )[:, fitted]
        normal = jacobian.T @ jacobian
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-12))
        scaled = normal * np.outer(scale, scale)
        if np.linalg.cond(scaled) > LARGEST_CONDITION:
            return None
        step = np.zeros(8)
        step[fitted] = -scale * np.linalg.solve(scaled, scale * (jacobian.T @ value))
        place = place + step[:2]
        shape = shape + step[2:6].reshape(2, 2)
        if abs(np.linalg.det(shape) - 1.0) > MOST_GROWTH:
            return None
        if np.abs(step[:2]).sum() + half * np.abs(step[2:6]).sum() < LEAST_STEP:
            inverse = np.linalg.inv(scaled) * np.outer(scale, scale)
            deviations = np.zeros(8)
            deviations[fitted] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
            return _judged(place, shape, known, second, half, deviations[:2])
    return None


def _judged(
    place: FloatArray,
    warp: FloatArray,
    known: FloatArray,
    second: FloatImage,
    half: int,
    deviations: FloatArray,
) -> PatchFit | None:
    """Return the fit with its correlation, and `deviations` (2,) times the residuals' deviation."""
    sampled = _sampled(second, place, warp, half)
    if sampled is None:
        return None
    first, other = known - known.mean(), sampled[0] - sampled[0].mean()
    size = np.sqrt((first @ first) * (other @ other))
    if size < 1e-6:
        return None
    correlation = float(first @ other / size)
    residual = (1.0 - correlation**2) * float(other @ other) / (len(known) - 8)
    return PatchFit(place, warp, correlation, deviations * np.sqrt(max(residual, 0.0)))


def sample_patch(
    image: FloatImage, centre: FloatArray, warp: FloatArray, half: int
) -> FloatImage | None:
    """Return (2 half + 1, 2 half + 1) values at ``centre + warp o``; None beyond the image."""
    sampled = _sampled(image, centre, warp, half)
    if sampled is None:
        return None
    edge = 2 * half + 1
    return sampled[0].reshape(edge, edge).astype(np.float32)


def _sampled(
    image: FloatImage, centre: FloatArray, warp: FloatArray, half: int
) -> FloatArray | None:
    """Return (3, n) values and gradients by column and row; None beyond the image."""
    reach = half * np.abs(warp).sum(axis=1)
    height, width = image.shape
    # Each sample needs the 4 x 4 pixels about it.
    if np.any(centre - reach < 1.0) or np.any(centre + reach >= [width - 2.0, height - 2.0]):
        return None
    samples = np.empty((3, (2 * half + 1) ** 2))
    _sample_kernel(
        image,
        float(centre[0]),
        float(centre[1]),
        np.ascontiguousarray(warp, dtype=float),
        half,
        samples,
    )
    return samples


@numba.njit(cache=True)
def _sample_kernel(
    image: Any, column: float, row: float, warp: Any, half: int, samples: Any
) -> None:
    """Interpolate by Catmull-Rom, which does not blur as a linear one does."""
    n = 0
    wx, dx, wy, dy = np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    for r in range(-half, half + 1):
        for c in range(-half, half + 1):
            x = column + warp[0, 0] * c + warp[0, 1] * r
            y = row + warp[1, 0] * c + warp[1, 1] * r
            left, top = int(x), int(y)
            _weights(x - left, wx, dx)
            _weights(y - top, wy, dy)
            value, by_x, by_y = 0.0, 0.0, 0.0
            for j in range(4):
                line, slope = 0.0, 0.0
                for i in range(4):
                    pixel = image[top - 1 + j, left - 1 + i]
                    line += wx[i] * pixel
                    slope += dx[i] * pixel
                value += wy[j] * line
                by_x += wy[j] * slope
                by_y += dy[j] * line
            samples[0, n], samples[1, n], samples[2, n] = value, by_x, by_y
            n += 1


@numba.njit(cache=True)
def _weights(t: float, weights: Any, slopes: Any) -> None:
    weights[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    weights[1] = (1.5 * t - 2.5) * t * t + 1.0
    weights[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    weights[3] = (0.5 * t - 0.5) * t * t
    slopes[0] = (-1.5 * t + 2.0) * t - 0.5
    slopes[1] = (4.5 * t - 5.0) * t
    slopes[2] = (-4.5 * t + 4.0) * t + 0.5
    slopes[3] = (1.5 * t - 1.0) * t
