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

# numba's decorator has no types of its own.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from typing import Any

import numba
import numpy as np

from perception.geometry.arrays import ByteArray

PREDICTORS = (1, 2, 3, 4, 5, 6, 7, 8, 9)
"""The thesis' numbers; 1 predicts nothing."""

_ufunc: Any = numba.vectorize(cache=True)


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
    pixels, width = np.ascontiguousarray(image).ravel(), image.shape[1]
    left = np.empty_like(pixels)
    row, column = _first_predicted(method, len(image))
    first = row * width + column
    left[:first] = pixels[:first]
    count = max(image.size - first, 0)
    starts = (max(first - offset, 0) for offset in (0, 1, width, width + 1))
    _LEFT_BY[method](*(pixels[start : start + count] for start in starts), out=left[first:])
    left = left.reshape(image.shape)
    left[:, :column] = image[:, :column]
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
    image = np.array(left, order="C")
    _restore(image, method, _first_predicted(method, len(left)))
    return image


def _check(image: ByteArray, method: int) -> None:
    if image.ndim != 2 or image.dtype != np.uint8:  # noqa: PLR2004
        raise ValueError(f"image of {image.dtype} {image.shape}: expected uint8 (height, width)")
    if method not in PREDICTORS:
        raise ValueError(f"predictor {method}: expected one of {', '.join(map(str, PREDICTORS))}")


def _first_predicted(method: int, height: int) -> tuple[int, int]:
    """Return the first row and column of the pixels with the neighbours that a method asks for."""
    return {1: (height, 0), 2: (0, 1), 3: (1, 0)}.get(method, (1, 1))


# Bytes throughout, so that the compiler works on many pixels at once. ~c is 255 - c, so that halves
# of differences are means of bytes: floor((x - c) / 2) is ceil((x + ~c) / 2) - 128, and a mean
# rounded up is (x | y) - ((x ^ y) >> 1).


@_ufunc
def _left_by_none(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return pixel


@_ufunc
def _left_by_left(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return np.uint8(pixel - left)


@_ufunc
def _left_by_above(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return np.uint8(pixel - above)


@_ufunc
def _left_by_corner(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return np.uint8(pixel - corner)


@_ufunc
def _left_by_plane(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return np.uint8(pixel - left - above + corner)


@_ufunc
def _left_by_left_and_half(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    x, y = above, np.uint8(~corner)
    return np.uint8(pixel - left - ((x | y) - ((x ^ y) >> 1)) + 128)


@_ufunc
def _left_by_above_and_half(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    x, y = left, np.uint8(~corner)
    return np.uint8(pixel - above - ((x | y) - ((x ^ y) >> 1)) + 128)


@_ufunc
def _left_by_two(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    return np.uint8(pixel - ((above & left) + ((above ^ left) >> 1)))


@_ufunc
def _left_by_three(pixel: Any, left: Any, above: Any, corner: Any) -> Any:
    total = np.uint32(above) + np.uint32(corner) + np.uint32(left)
    return np.uint8(pixel - total // np.uint32(3))


_LEFT_BY: dict[int, Any] = {
    1: _left_by_none,
    2: _left_by_left,
    3: _left_by_above,
    4: _left_by_corner,
    5: _left_by_plane,
    6: _left_by_left_and_half,
    7: _left_by_above_and_half,
    8: _left_by_two,
    9: _left_by_three,
}


@numba.njit(cache=True)
def _restore(image: Any, method: int, first: tuple[int, int]) -> None:
    """Add the prediction to each residual, in the order in which pixels become known."""
    height, width = image.shape
    for u in range(first[0], height):
        for v in range(first[1], width):
            a, b = np.int64(image[u, v - 1]), np.int64(image[u - 1, v])
            c = np.int64(image[u - 1, v - 1])
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
            image[u, v] = (image[u, v] + guess) & 255
