"""Prediction of pixels from their neighbours, without loss (Thesis appendix C.5, C.6).

With u the row and v the column of a pixel, the thesis' methods 1 to 9 are

    1: nothing                       6: left + (above - corner) / 2
    2: left    I(u, v - 1)           7: above + (left - corner) / 2
    3: above   I(u - 1, v)           8: (above + left) / 2
    4: corner  I(u - 1, v - 1)       9: (above + corner + left) / 3
    5: left + above - corner

Quotients are rounded down and residuals taken modulo 256, so that a residual is a byte again and
nothing is lost. Pixels without the neighbours that a method asks for keep their value.
"""

from typing import Any

import numba
import numpy as np

from perception.geometry.arrays import ByteArray

PREDICTORS = (1, 2, 3, 4, 5, 6, 7, 8, 9)
"""The thesis' numbers; 1 predicts nothing."""


def residuals(image: ByteArray, method: int) -> ByteArray:
    """Return what prediction leaves of an image.

    Args:
        image: (H, W) uint8.
        method: One of `PREDICTORS`.

    Returns:
        (H, W) uint8, modulo 256.

    Raises:
        ValueError: If the image is no grey picture of bytes or there is no such method.
    """
    _check(image, method)
    left: ByteArray = np.empty(image.shape, np.uint8)
    _ENCODERS[method](np.ascontiguousarray(image), left)
    return left


def restored(left: ByteArray, method: int) -> ByteArray:
    """Return the image of which `residuals` with the same method left this.

    Args:
        left: (H, W) uint8.
        method: One of `PREDICTORS`.

    Raises:
        ValueError: As `residuals`.
    """
    _check(left, method)
    image: ByteArray = np.empty(left.shape, np.uint8)
    _restore(np.ascontiguousarray(left), method, image)
    return image


def _check(image: ByteArray, method: int) -> None:
    if image.ndim != 2 or image.dtype != np.uint8:  # noqa: PLR2004
        raise ValueError(f"image of {image.dtype} {image.shape}: expected uint8 (height, width)")
    if method not in _ENCODERS:
        raise ValueError(f"predictor {method}: expected one of {', '.join(map(str, PREDICTORS))}")


# One kernel for each method, and bytes throughout: so the compiler works on many pixels at once.
# ~c is 255 - c, so that halves of differences are means of bytes: floor((x - c) / 2) is
# ceil((x + ~c) / 2) - 128, and a mean rounded up is (x | y) - ((x ^ y) >> 1).


def _keep(image: ByteArray, left: ByteArray) -> None:
    left[:] = image


@numba.njit(cache=True)
def _from_left(image: Any, left: Any) -> None:
    height, width = image.shape
    for u in range(height):
        row, out = image[u], left[u]
        if width:
            out[0] = row[0]
        for v in range(1, width):
            out[v] = row[v] - row[v - 1]


@numba.njit(cache=True)
def _from_above(image: Any, left: Any) -> None:
    height, width = image.shape
    left[:1] = image[:1]
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(width):
            out[v] = row[v] - above[v]


@numba.njit(cache=True)
def _from_corner(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            out[v] = row[v] - above[v - 1]


@numba.njit(cache=True)
def _from_plane(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            out[v] = row[v] - row[v - 1] - above[v] + above[v - 1]


@numba.njit(cache=True)
def _from_left_and_half(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            x, y = above[v], np.uint8(~above[v - 1])
            out[v] = row[v] - row[v - 1] - ((x | y) - ((x ^ y) >> 1)) + 128


@numba.njit(cache=True)
def _from_above_and_half(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            x, y = row[v - 1], np.uint8(~above[v - 1])
            out[v] = row[v] - above[v] - ((x | y) - ((x ^ y) >> 1)) + 128


@numba.njit(cache=True)
def _from_two(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            x, y = above[v], row[v - 1]
            out[v] = row[v] - ((x & y) + ((x ^ y) >> 1))


@numba.njit(cache=True)
def _from_three(image: Any, left: Any) -> None:
    height, width = image.shape
    _copy_edges(image, left)
    for u in range(1, height):
        row, above, out = image[u], image[u - 1], left[u]
        for v in range(1, width):
            total = np.uint32(above[v]) + np.uint32(above[v - 1]) + np.uint32(row[v - 1])
            out[v] = row[v] - total // np.uint32(3)


@numba.njit(cache=True)
def _copy_edges(image: Any, left: Any) -> None:
    left[:1] = image[:1]
    left[:, :1] = image[:, :1]


_ENCODERS: dict[int, Any] = {
    1: _keep,
    2: _from_left,
    3: _from_above,
    4: _from_corner,
    5: _from_plane,
    6: _from_left_and_half,
    7: _from_above_and_half,
    8: _from_two,
    9: _from_three,
}


@numba.njit(cache=True)
def _restore(left: Any, method: int, image: Any) -> None:
    """Add the prediction to each residual, in the order in which pixels become known."""
    height, width = left.shape
    for u in range(height):
        for v in range(width):
            lacks_row, lacks_column = u == 0, v == 0
            if method == 1:
                alone = True
            elif method == 2:
                alone = lacks_column
            elif method == 3:
                alone = lacks_row
            else:
                alone = lacks_row or lacks_column
            if alone:
                image[u, v] = left[u, v]
                continue
            a = np.int64(image[u, v - 1]) if v else 0
            b = np.int64(image[u - 1, v]) if u else 0
            c = np.int64(image[u - 1, v - 1]) if u and v else 0
            if method == 2:
                guess = a
            elif method == 3:
                guess = b
            elif method == 4:
                guess = c
            elif method == 5:
                guess = a + b - c
            elif method == 6:
                guess = a + (b - c) // 2
            elif method == 7:
                guess = b + (a - c) // 2
            elif method == 8:
                guess = (a + b) // 2
            else:
                guess = (a + b + c) // 3
            image[u, v] = (left[u, v] + guess) & 255
