"""The thesis' ten ways to compress an image without loss, and the information that is left (C.6).

Ways 1 to 9 predict pixels from their neighbours
(`perception.compression.image_predictors`), 10 is Huffman's code of the image as it is.
Entropies are of one pixel, by the histogram of the whole image. The
ratio of the entropy before and after is how well the prediction fits; what is left after it is
the information that an image truly holds, for which the thesis proposes method 5.
"""

import functools
import struct
from collections.abc import Callable
from typing import Literal, TypeAlias, get_args

import numpy as np

from perception.compression.byte_codes import (
    CodingError,
    entropy,
    huffman_decode,
    huffman_encode,
    lzw_decode,
    lzw_encode,
    mean_word_length,
    run_length_decode,
    run_length_encode,
)
from perception.compression.image_predictors import PREDICTORS, residuals, restored
from perception.geometry.arrays import ByteArray

Coder: TypeAlias = Literal["plain", "run_length", "huffman", "lzw"]

METHODS = (*PREDICTORS, 10)
"""The thesis' numbers."""
BEST_PREDICTOR = 5
"""By Table C-1, at 256 x 256 pixels."""
CODERS: tuple[Coder, ...] = get_args(Coder)

_HUFFMAN = 10
_HEAD = struct.Struct("<BBII")  # Method, coder, height, width.


def coded_bits(image: ByteArray, method: int = BEST_PREDICTOR) -> float:
    """Return how many bits a pixel takes after one of the ten methods.

    For the predictors that is the entropy of their residuals, which a code of single symbols comes
    near but never below; for method 10 the mean length of Huffman's words.

    Args:
        image: (H, W) uint8.
        method: One of `METHODS`.

    Raises:
        ValueError: If the image is no grey picture of bytes or there is no such method.
    """
    if method == _HUFFMAN:
        return mean_word_length(residuals(image, 1))
    _check_method(method)
    return entropy(residuals(image, method))


def compression_ratio(image: ByteArray, method: int) -> float:
    """Return the entropy of an image over `coded_bits`, the compression ratio of Table C-1.

    Args:
        image: (H, W) uint8.
        method: One of `METHODS`.

    Returns:
        1 if neither holds anything, infinity if only the image as it is does.

    Raises:
        ValueError: As `coded_bits`.
    """
    before, after = entropy(image), coded_bits(image, method)
    if after == 0.0:
        return 1.0 if before == 0.0 else float("inf")
    return before / after


def image_information(image: ByteArray, method: int = BEST_PREDICTOR) -> float:
    """Return the information of an image [bit]: `coded_bits` of all its pixels.

    It measures the image, not what is new in it: by itself it chooses the next view of a map no
    better than chance (``appc-compression``), where `perception.voxels.views` does.

    Args:
        image: (H, W) uint8.
        method: One of `METHODS`.

    Raises:
        ValueError: As `coded_bits`.
    """
    return coded_bits(image, method) * image.size


def compress(image: ByteArray, method: int = BEST_PREDICTOR, coder: Coder | None = None) -> bytes:
    """Return an image in fewer bytes, if it is not noise.

    Args:
        image: (H, W) uint8.
        method: One of `METHODS`.
        coder: Code of the residuals (by default none, for method 10 always Huffman's).

    Raises:
        ValueError: As `coded_bits`, or if there is no such coder.
    """
    _check_method(method)
    named = coder or ("huffman" if method == _HUFFMAN else "plain")
    if named not in CODERS or (method == _HUFFMAN and named != "huffman"):
        valid = "huffman" if method == _HUFFMAN else ", ".join(CODERS)
        raise ValueError(f"coder {named} with method {method}: expected {valid}")
    left = residuals(image, 1 if method == _HUFFMAN else method)
    head = _HEAD.pack(method, CODERS.index(named), *image.shape)
    return head + _ENCODE[named](left)


def decompress(coded: bytes) -> ByteArray:
    """Return the image (H, W) uint8 of which `compress` made this.

    Raises:
        CodingError: If it cannot be decoded.
    """
    if len(coded) < _HEAD.size:
        raise CodingError(f"image of {len(coded)} bytes: its head alone takes {_HEAD.size}")
    method, coder, height, width = _HEAD.unpack_from(coded)
    if method not in METHODS or coder >= len(CODERS):
        raise CodingError(f"image coded by method {method}, coder {coder}: there is none such")
    left = _DECODE[CODERS[coder]](coded[_HEAD.size :])
    if left.size != height * width:
        raise CodingError(f"image of {height} x {width} pixels: {left.size} were coded")
    return restored(left.reshape(height, width), 1 if method == _HUFFMAN else method)


def _check_method(method: int) -> None:
    if method not in METHODS:
        raise ValueError(f"method {method}: expected one of {', '.join(map(str, METHODS))}")


_ENCODE: dict[Coder, Callable[[ByteArray], bytes]] = {
    "plain": np.ndarray.tobytes,
    "run_length": run_length_encode,
    "huffman": huffman_encode,
    "lzw": lzw_encode,
}
_DECODE: dict[Coder, Callable[[bytes], ByteArray]] = {
    "plain": functools.partial(np.frombuffer, dtype=np.uint8),
    "run_length": run_length_decode,
    "huffman": huffman_decode,
    "lzw": lzw_decode,
}
