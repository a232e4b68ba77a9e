"""Defocus and motion blur, with one point-spread function for each block of pixels.

Points of a blurred image are spread over the grid by Keys' cubic, which keeps moments up to the
second: so the widths are exact, however small. Pixels that would come from beyond the image are
those of its edge.
"""

import math
from typing import Any, NamedTuple

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray
from twin.optics.flow import BLOCK

LEAST = 0.3
"""Width of a block's blur below which it is left out [px]."""
LARGEST_DISC = 16.0
"""Largest circle of confusion that is drawn, in columns [px]; beyond stands what is too near."""
LARGEST_STREAK = 32.0
"""Longest way in an exposure that is drawn [px]."""
_STEP = 0.05  # Between the tabulated diameters [px].
_POINTS = 256  # On a disc.
_REACH = 2  # Of Keys' cubic [px].

FloatImage = NDArray[np.float32]


class Defocus:
    """Blur by discs of a table.

    Args:
        aspect: Focal length in rows over that in columns: rows are finer by it.
    """

    def __init__(self, aspect: float) -> None:
        self._finer = max(aspect, 1.0)
        self._half = math.ceil(0.5 * LARGEST_DISC * self._finer) + _REACH
        count = round(LARGEST_DISC / _STEP) + 1
        size = 2 * self._half + 1
        self._table = np.zeros((count, size, size), np.float32)
        # Points of one density, whose variances along both axes are a disc's.
        turn = np.arange(_POINTS) * math.pi * (3.0 - math.sqrt(5.0))
        radius = np.sqrt((np.arange(_POINTS) + 0.5) / _POINTS)
        disc = 0.5 * np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
        disc -= disc.mean(axis=0)
        disc *= 0.25 / disc.std(axis=0)
        for index in range(count):
            _spread(disc * [index * _STEP, index * _STEP * aspect], self._table[index])

    def apply(self, image: FloatImage, diameters: FloatArray) -> FloatImage:
        """Return a blurred image (height, width).

        Args:
            image: (height, width) light.
            diameters: Width of the disc in columns at each block [px].
        """
        if diameters.max() < LEAST:
            return image
        discs = np.where(diameters < LEAST, 0.0, np.minimum(diameters, LARGEST_DISC))
        which = np.rint(discs / _STEP).astype(np.int64)
        result = np.zeros_like(image)
        _blur_by_table(_padded(image, self._half), which, self._finer, self._table, result)
        return result


def smear(image: FloatImage, motion: FloatArray) -> FloatImage:
    """Return an image (height, width) that moved while it was exposed.

    Args:
        image: (height, width) light at the middle of the exposure.
        motion: (rows, columns, 2) way of each block in the exposure [px].
    """
    length = np.linalg.norm(motion, axis=-1)
    if length.max() < LEAST:
        return image
    motion = motion * np.minimum(1.0, LARGEST_STREAK / np.maximum(length, LEAST))[..., None]
    half = math.ceil(0.5 * float(np.abs(motion).max())) + _REACH
    result = np.zeros_like(image)
    _blur_along(_padded(image, half), motion, half, result)
    return result


def _padded(image: FloatImage, half: int) -> FloatImage:
    """Return an image of whole blocks with a margin."""
    down, right = (-side % BLOCK for side in image.shape)
    padded = cv2.copyMakeBorder(image, half, half + down, half, half + right, cv2.BORDER_REPLICATE)
    return np.asarray(padded, dtype=np.float32)


@numba.njit(cache=True, inline="always")
def _keys(x: float) -> float:
    """Return Keys' cubic of a distance [px]."""
    x = abs(x)
    if x < 1.0:
        return 1.0 + x * x * (1.5 * x - 2.5)
    if x < 2.0:
        return 2.0 + x * (-4.0 + x * (2.5 - 0.5 * x))
    return 0.0


@numba.njit(cache=True)
def _spread(points: FloatArray, kernel: Any) -> None:
    """Fill a point-spread function with points (N, 2), column and row from its middle [px]."""
    half = kernel.shape[0] // 2
    kernel[:] = 0.0
    share = 1.0 / points.shape[0]
    for i in range(points.shape[0]):
        left, top = math.floor(points[i, 0]) - 1, math.floor(points[i, 1]) - 1
        for row in range(top, top + 4):
            weight = share * _keys(row - points[i, 1])
            for column in range(left, left + 4):
                at = column - points[i, 0]
                kernel[half + row, half + column] += weight * _keys(at)


class _Window(NamedTuple):
    """A block, and how far its light comes from.

    Attributes:
        row: First row of the block.
        column: First column of the block.
        along: Reach of the point-spread function in rows [px].
        across: Reach of the point-spread function in columns [px].
    """

    row: int
    column: int
    along: int
    across: int


@numba.njit(cache=True, fastmath=True, inline="always")
def _blur_block(padded: Any, kernel: Any, window: _Window, result: Any) -> None:
    """Convolve one block with a symmetric point-spread function."""
    total = np.zeros((BLOCK, BLOCK), np.float32)
    half, row, column = kernel.shape[0] // 2, window.row, window.column
    for down in range(half - window.along, half + window.along + 1):
        for right in range(half - window.across, half + window.across + 1):
            weight = kernel[down, right]
            if weight == 0.0:
                continue
            for y in range(BLOCK):
                for x in range(BLOCK):
                    total[y, x] += weight * padded[row + down + y, column + right + x]
    for y in range(min(BLOCK, result.shape[0] - row)):
        for x in range(min(BLOCK, result.shape[1] - column)):
            result[row + y, column + x] = total[y, x]


@numba.njit(cache=True, inline="always")
def _reach(width: float) -> int:
    """Return how far from its middle a blur is spread [px]."""
    return math.ceil(0.5 * width) + _REACH if width > 0.0 else 0


@numba.njit(cache=True, fastmath=True)
def _blur_by_table(padded: Any, which: Any, finer: float, table: Any, result: Any) -> None:
    """Convolve each block with the point-spread function of its index (rows, columns)."""
    for i in range(which.shape[0]):
        for j in range(which.shape[1]):
            reach = _reach(which[i, j] * _STEP * finer)
            window = _Window(i * BLOCK, j * BLOCK, reach, reach)
            _blur_block(padded, table[which[i, j]], window, result)


@numba.njit(cache=True, fastmath=True)
def _blur_along(padded: Any, motion: Any, half: int, result: Any) -> None:
    """Convolve each block with the straight line of its way (rows, columns, 2) [px]."""
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    for i in range(motion.shape[0]):
        for j in range(motion.shape[1]):
            across, along = motion[i, j, 0], motion[i, j, 1]
            length = math.hypot(across, along)
            if length < LEAST:
                kernel[half, half] = 1.0
                _blur_block(padded, kernel, _Window(i * BLOCK, j * BLOCK, 0, 0), result)
                continue
            count = math.ceil(length) + 2
            points = np.empty((count, 2))
            # Evenly spaced, with the variance of a line: 1 / 12 of its length squared.
            scale = 1.0 / math.sqrt(1.0 - 1.0 / count**2)
            for k in range(count):
                place = scale * ((k + 0.5) / count - 0.5)
                points[k, 0], points[k, 1] = place * across, place * along
            _spread(points, kernel)
            rows, columns = _reach(abs(along)), _reach(abs(across))
            window = _Window(i * BLOCK, j * BLOCK, max(rows, _REACH), max(columns, _REACH))
            _blur_block(padded, kernel, window, result)
