"""What changed in a tile of an elevation map, in few bytes, for the radio.

A tile has 16 x 16 cells. A delta of it holds some cells and their heights in steps of 5 mm, and
needs no other delta to be read. Which cells is coded by runs between changes of the mask from
what a neighbour predicts; a height is predicted from its coded neighbours as method 5 of appendix C
does, and what is left is coded by Huffman's words for geometric distributions, so that no table of
words is sent. Of several such codes, and the bytes as they are, the shortest is taken.

On the deltas of eight simulated drives over rough ground (``bench --only compression``), of 87
cells in the mean, that makes 68 bytes in the mean, head and CRC-32 included. Of the same residuals
and masks Huffman's code with its table would make 295 and 277 bytes, run lengths 90 and 31, LZW 83
and 38, zlib 60 and 34; and of masks and heights as they are, 206 bytes, zlib makes 123.
"""

# numba's decorator has no types of its own.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUntypedFunctionDecorator=false, reportUnknownArgumentType=false

import dataclasses
import struct
from typing import Any

import fastcrc
import numba
import numpy as np

from perception.compression.byte_codes import (
    CodingError,
    WordCode,
    canonical_code,
    pack_words,
    unpack_words,
    word_lengths,
)
from perception.elevation.grid import ElevationGrid
from perception.geometry.arrays import BoolArray, ByteArray, FloatArray, IndexArray, IntArray

TILE = 16
"""Cells along a tile."""
STEP = 0.005
"""Step of the heights [m]."""
DEVIATION_STEP = 0.0005
"""Step of their deviation [m]."""
LARGEST = 0x7FFF * STEP
"""Largest height, up or down [m]."""

# Robot, tile, revision, codes, deviation, first height, number of runs of the mask less one.
_HEAD = struct.Struct(">BHBBBhB")
_CRC = struct.Struct(">I")
_CELLS = TILE * TILE
_ESCAPE = 255
"""Symbol of a residual that is no symbol: its 16 bits follow all residuals."""
_RAW = 3
"""Number of the mask's code that is its 256 bits as they are."""


def _codes() -> tuple[WordCode, ...]:
    """Return codes for geometric distributions of means 1/2, 1, 2 to 32, and one of plain bytes.

    Whole numbers throughout, so that all machines make the same words.
    """
    codes: list[WordCode] = []
    for above, below in ((1, 3), (1, 2), (2, 3), (4, 5), (8, 9), (16, 17), (32, 33)):
        counts = [
            10**7 * above**k * (below - above) // below ** (k + 1) + 300000 // (1 + k) ** 2 + 1
            for k in range(_CELLS)
        ]
        codes.append(canonical_code(word_lengths(np.array(counts, np.int64))))
    codes.append(canonical_code(np.full(256, 8, np.int64)))
    return tuple(codes)


_CODES = _codes()
_PLAIN = len(_CODES) - 1


@dataclasses.dataclass(frozen=True)
class TileDelta:
    """Heights of some cells of one tile.

    Attributes:
        robot: Number of the robot whose map it is, 0 to 255.
        tile: Index of the tile in its map, row by row, 0 to 65535.
        revision: Number of the tile's deltas before, modulo 256.
        cells: (K,) flat indices of the cells in the tile, ascending, at least one.
        heights: (K,) heights [m], rounded to steps of 5 mm by the code, within 163 m.
        deviation: Standard deviation of the heights [m], up to 0.127 m.
    """

    robot: int
    tile: int
    revision: int
    cells: IndexArray
    heights: FloatArray
    deviation: float


def tile_counts(grid: ElevationGrid) -> tuple[int, int]:
    """Return the number of tiles along y and along x; those at the far edges may be partial."""
    return -(-grid.shape[0] // TILE), -(-grid.shape[1] // TILE)


def tile_parts(grid: ElevationGrid, tile: int) -> tuple[slice, slice]:
    """Return the rows and columns of a grid that a tile holds.

    Raises:
        ValueError: If the grid has no such tile.
    """
    rows, columns = tile_counts(grid)
    if not 0 <= tile < rows * columns:
        raise ValueError(f"tile {tile}: expected 0 to {rows * columns - 1}")
    row, column = (TILE * index for index in divmod(tile, columns))
    return (
        slice(row, min(row + TILE, grid.shape[0])),
        slice(column, min(column + TILE, grid.shape[1])),
    )


def rounded(heights: FloatArray) -> FloatArray:
    """Return heights as a delta holds them [m]."""
    return np.rint(heights / STEP) * STEP


def encode_delta(delta: TileDelta) -> bytes:
    """Return a delta in few bytes, with a CRC-32 of all of them.

    Raises:
        ValueError: If a number is out of range, or there are no cells.
    """
    mask, steps = _checked(delta)
    code, runs, words = _coded_mask(mask)
    left = residuals_of(steps, mask)[1:]
    kind, parts = _coded_heights(left)
    head = _HEAD.pack(
        delta.robot,
        delta.tile,
        delta.revision,
        code << 3 | kind,
        min(round(delta.deviation / DEVIATION_STEP), 0xFF),
        int(steps[mask][0]),
        runs,
    )
    content = head + pack_words([words, *parts])
    return content + _CRC.pack(fastcrc.crc32.iso_hdlc(content))


def decode_delta(message: bytes) -> TileDelta:
    """Return the delta of which `encode_delta` made this.

    Raises:
        CodingError: If it is damaged.
    """
    if len(message) < _HEAD.size + _CRC.size:
        raise CodingError(
            f"tile of {len(message)} bytes: expected {_HEAD.size + _CRC.size} or more"
        )
    content = message[: -_CRC.size]
    if _CRC.pack(fastcrc.crc32.iso_hdlc(content)) != message[-_CRC.size :]:
        raise CodingError("tile: its CRC is another")
    robot, tile, revision, codes, deviation, first, runs = _HEAD.unpack_from(content)
    packed = content[_HEAD.size :]
    mask, at = _decoded_mask(packed, codes >> 3, runs + 1)
    left, at = _decoded_heights(packed, codes & 7, int(mask.sum()) - 1, at)
    if len(packed) != -(-at // 8):
        raise CodingError(f"tile: {len(packed)} bytes of words, {-(-at // 8)} were read")
    steps = _restored(np.concatenate([[first], left]), mask)[mask]
    cells = np.flatnonzero(mask)
    return TileDelta(robot, tile, revision, cells, steps * STEP, deviation * DEVIATION_STEP)


def _checked(delta: TileDelta) -> tuple[BoolArray, IntArray]:
    """Return which cells (16, 16) a delta holds, and their heights in steps.

    Raises:
        ValueError: If a number is out of range, or there are no cells.
    """
    for name, most in (("robot", 0xFF), ("tile", 0xFFFF), ("revision", 0xFF)):
        value = getattr(delta, name)
        if not 0 <= value <= most:
            raise ValueError(f"tile delta: {name} {value} is not within 0 to {most}")
    if not 0.0 <= delta.deviation < np.inf:
        raise ValueError(f"tile delta: deviation {delta.deviation} is not finite and positive")
    cells, heights = delta.cells, delta.heights
    ascending = bool(len(cells)) and bool(np.all(np.diff(cells) > 0))
    if not ascending or cells[0] < 0 or cells[-1] >= _CELLS:
        raise ValueError(f"tile delta: cells {cells}: expected indices below {_CELLS}, ascending")
    if heights.shape != cells.shape or not np.all(np.abs(heights) <= LARGEST):
        raise ValueError(f"tile delta: heights {heights}: expected one a cell, up to {LARGEST} m")
    mask, steps = np.zeros(_CELLS, dtype=bool), np.zeros(_CELLS, np.int64)
    mask[cells], steps[cells] = True, np.rint(heights / STEP)
    return mask.reshape(TILE, TILE), steps.reshape(TILE, TILE)


def _surprises(mask: BoolArray, predictor: int) -> BoolArray:
    """Return (16, 16) where a mask is not as predicted; done again it gives the mask back.

    Args:
        mask: (16, 16) cells.
        predictor: 0 for none, 1 for the cell above, 2 for left, above and corner as in method 5,
            modulo 2.
    """
    found = mask.copy()
    if predictor > 0:
        found[1:] ^= mask[:-1]
    if predictor > 1:
        found[:, 1:] ^= mask[:, :-1]
        found[1:, 1:] ^= mask[:-1, :-1]
    return found


def _unsurprised(found: BoolArray, predictor: int) -> BoolArray:
    """Return the mask (16, 16) of which `_surprises` made this."""
    mask = found.copy()
    if predictor > 0:
        mask = np.logical_xor.accumulate(mask, axis=0)
    if predictor > 1:
        mask = np.logical_xor.accumulate(mask, axis=1)
    return mask


def _shortest(symbols: ByteArray) -> tuple[int, int]:
    """Return the number of bits that symbols take in the best code for them, and its index."""
    bits = [int(code.lengths[symbols].sum()) for code in _CODES]
    best = int(np.argmin(bits))
    return bits[best], best


def _coded_mask(mask: BoolArray) -> tuple[int, int, tuple[ByteArray, WordCode]]:
    """Return a mask's code (its predictor and words), the number of runs less one, and symbols."""
    plain = np.packbits(mask)
    best, found = 8 * plain.size, (_RAW << 3 | _PLAIN, 0, (plain, _CODES[_PLAIN]))
    for predictor in range(_RAW):
        ends = np.flatnonzero(_surprises(mask, predictor))
        runs = np.diff(ends, prepend=-1) - 1
        bits, code = _shortest(runs.astype(np.uint8))
        if bits < best:
            best = bits
            found = predictor << 3 | code, len(runs) - 1, (runs.astype(np.uint8), _CODES[code])
    return found


def _decoded_mask(packed: bytes, code: int, runs: int) -> tuple[BoolArray, int]:
    """Return the mask (16, 16), and where its words end [bit].

    Raises:
        CodingError: If it is none.
    """
    predictor, words = code >> 3, _CODES[code & 7]
    if predictor == _RAW:
        plain, at = unpack_words(packed, _CODES[_PLAIN], _CELLS // 8)
        mask = np.unpackbits(plain).astype(bool).reshape(TILE, TILE)
    else:
        lengths, at = unpack_words(packed, words, runs)
        ends = np.cumsum(lengths.astype(np.int64) + 1) - 1
        if ends[-1] >= _CELLS:
            raise CodingError(f"tile: its runs go on to cell {ends[-1]}")
        found = np.zeros(_CELLS, dtype=bool)
        found[ends] = True
        mask = _unsurprised(found.reshape(TILE, TILE), predictor)
    if not mask.any():
        raise CodingError("tile: holds no cells")
    return mask, at


def _coded_heights(left: IntArray) -> tuple[int, list[tuple[ByteArray, WordCode]]]:
    """Return the code of residuals, and their symbols."""
    folded = np.where(left >= 0, 2 * left, -2 * left - 1)
    symbols = np.minimum(folded, _ESCAPE).astype(np.uint8)
    escaped = left[folded >= _ESCAPE].astype(">i2").view(np.uint8)
    bits, code = _shortest(symbols)
    if code == _PLAIN or bits + 8 * escaped.size >= 16 * left.size:
        return _PLAIN, [(left.astype(">i2").view(np.uint8), _CODES[_PLAIN])]
    return code, [(symbols, _CODES[code]), (escaped, _CODES[_PLAIN])]


def _decoded_heights(packed: bytes, code: int, count: int, start: int) -> tuple[IntArray, int]:
    """Return residuals (count,), and where their words end [bit].

    Raises:
        CodingError: If the words end too early.
    """
    if code == _PLAIN:
        plain, at = unpack_words(packed, _CODES[_PLAIN], 2 * count, start)
        return plain.view(">i2").astype(np.int64), at
    symbols, at = unpack_words(packed, _CODES[code], count, start)
    folded = symbols.astype(np.int64)
    left = np.where(folded % 2 == 0, folded // 2, -(folded + 1) // 2)
    escapes = np.flatnonzero(symbols == _ESCAPE)
    plain, at = unpack_words(packed, _CODES[_PLAIN], 2 * len(escapes), at)
    left[escapes] = plain.view(">i2")
    return left, at


@numba.njit(cache=True)
def _prediction(steps: Any, mask: Any, row: int, column: int, before: int) -> int:
    """Return what coded neighbours tell of a height; method 5 where there are all three."""
    left = column > 0 and mask[row, column - 1]
    above = row > 0 and mask[row - 1, column]
    if left and above:
        if mask[row - 1, column - 1]:
            return steps[row, column - 1] + steps[row - 1, column] - steps[row - 1, column - 1]
        return (steps[row, column - 1] + steps[row - 1, column]) // 2
    if above:
        return steps[row - 1, column]
    if left:
        return steps[row, column - 1]
    return before


@numba.njit(cache=True)
def residuals_of(steps: Any, mask: Any) -> Any:
    """Return what prediction leaves of coded heights, in their order, as 16-bit numbers.

    Args:
        steps: (16, 16) int64 heights in steps.
        mask: (16, 16) cells that are coded.
    """
    left, count, before = np.empty(mask.sum(), np.int64), 0, 0
    for row in range(TILE):
        for column in range(TILE):
            if mask[row, column]:
                guess = _prediction(steps, mask, row, column, before)
                before = steps[row, column]
                left[count] = (before - guess + 0x8000) % 0x10000 - 0x8000
                count += 1
    return left


@numba.njit(cache=True)
def _restored(left: Any, mask: Any) -> Any:
    """Return the heights (16, 16) of which `residuals_of` made this; 0 where there are none."""
    steps, count, before = np.zeros((TILE, TILE), np.int64), 0, 0
    for row in range(TILE):
        for column in range(TILE):
            if mask[row, column]:
                guess = _prediction(steps, mask, row, column, before)
                before = (guess + left[count] + 0x8000) % 0x10000 - 0x8000
                steps[row, column] = before
                count += 1
    return steps
