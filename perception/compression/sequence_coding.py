"""Codes of sequences of bytes: runs of zeros, and LZW (Thesis appendix C.2, C.4, figure C-1)."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from perception.compression.entropy_coding import CodingError
from perception.geometry.arrays import ByteArray

CodeArray = NDArray[np.uint16]

LZW_BITS = 12
LZW_CODES = 1 << LZW_BITS
"""Entries of LZW's table."""
_SYMBOLS = 256
_LONGEST_RUN = 255
_SLOTS = 4 * LZW_CODES


def run_length_encode(symbols: ByteArray) -> bytes:
    """Return bytes in which each run of zeros is a zero and its length (C.2).

    A length is a byte, so that a run of more than 255 zeros is written as several.

    Args:
        symbols: uint8 of any shape.
    """
    flat = np.ascontiguousarray(symbols, np.uint8).ravel()
    coded: ByteArray = np.empty(2 * flat.size, np.uint8)
    return coded[: _write_runs(flat, coded)].tobytes()


def run_length_decode(coded: bytes) -> ByteArray:
    """Return (n,) bytes from what `run_length_encode` made of them.

    Raises:
        CodingError: If a run has no length.
    """
    given = np.frombuffer(coded, np.uint8)
    size = _length_of_runs(given)
    if size < 0:
        raise CodingError("run-length code: a zero is followed by no length")
    symbols: ByteArray = np.zeros(size, np.uint8)
    _read_runs(given, symbols)
    return symbols


def lzw_codes(symbols: ByteArray, first: int = _SYMBOLS) -> CodeArray:
    """Return the codes that LZW writes for bytes.

    Codes below 256 are single bytes; each code written adds the sequence it stands for and the
    byte behind it to the table, until the table has 4096 entries: then it stays as it is.

    Args:
        symbols: uint8 of any shape.
        first: Code of the first sequence. The thesis' is 256; GIF and TIFF begin at 258.

    Returns:
        (n,) uint16, each of 12 bits.

    Raises:
        ValueError: If ``first`` is not within 256..4096.
    """
    _check_first(first)
    flat = np.ascontiguousarray(symbols, np.uint8).ravel()
    codes: CodeArray = np.empty(flat.size, np.uint16)
    return codes[: _write_codes(flat, first, codes)].copy()


def lzw_symbols(codes: CodeArray, first: int = _SYMBOLS) -> ByteArray:
    """Return the bytes that LZW's codes stand for.

    Args:
        codes: (n,) uint16.
        first: As for `lzw_codes`.

    Raises:
        CodingError: If a code stands for nothing yet.
        ValueError: As `lzw_codes`.
    """
    _check_first(first)
    lengths = np.ones(LZW_CODES, np.int64)
    size = _length_of_codes(codes, first, lengths)
    if size < 0:
        raise CodingError(f"LZW: code {int(codes[-size - 1])} at {-size - 1} stands for nothing")
    symbols: ByteArray = np.empty(size, np.uint8)
    _read_codes(codes, first, lengths, symbols)
    return symbols


def lzw_encode(symbols: ByteArray) -> bytes:
    """Return bytes as LZW codes of 12 bits, high bits first; half a byte of 0 may end them.

    Args:
        symbols: uint8 of any shape.
    """
    codes = lzw_codes(symbols)
    even = np.append(codes, np.zeros(len(codes) % 2, np.uint16)).reshape(-1, 2)
    packed = np.empty((len(even), 3), np.uint8)
    packed[:, 0] = even[:, 0] >> 4
    packed[:, 1] = (even[:, 0] & 15) << 4 | even[:, 1] >> 8
    packed[:, 2] = even[:, 1] & 255
    return packed.tobytes()[: -(-len(codes) * LZW_BITS // 8)]


def lzw_decode(coded: bytes) -> ByteArray:
    """Return (n,) bytes from what `lzw_encode` made of them.

    Raises:
        CodingError: If they cannot be told.
    """
    count = len(coded) * 8 // LZW_BITS
    if -(-count * LZW_BITS // 8) != len(coded):
        raise CodingError(f"LZW: no number of 12-bit codes takes {len(coded)} bytes")
    packed = np.frombuffer(coded + bytes(-len(coded) % 3), np.uint8).astype(np.uint16)
    one, two, three = packed.reshape(-1, 3).T
    codes = np.stack([one << 4 | two >> 4, (two & 15) << 8 | three], axis=1).ravel()
    return lzw_symbols(codes[:count].astype(np.uint16))


def _check_first(first: int) -> None:
    if not _SYMBOLS <= first <= LZW_CODES:
        raise ValueError(f"LZW's first sequence has code {first}: expected 256 to {LZW_CODES}")


@numba.njit(cache=True)
def _write_runs(symbols: Any, coded: Any) -> int:
    at, run = 0, 0
    for index in range(symbols.size):
        symbol = symbols[index]
        if symbol:
            coded[at] = symbol
            at += 1
            continue
        run += 1
        last = index + 1 == symbols.size or symbols[index + 1] != 0
        if last or run == _LONGEST_RUN:
            coded[at], coded[at + 1] = 0, run
            at, run = at + 2, 0
    return at


@numba.njit(cache=True)
def _length_of_runs(coded: Any) -> int:
    at, size = 0, 0
    while at < coded.size:
        if coded[at]:
            at, size = at + 1, size + 1
            continue
        if at + 1 == coded.size or coded[at + 1] == 0:
            return -1
        size += coded[at + 1]
        at += 2
    return size


@numba.njit(cache=True)
def _read_runs(coded: Any, symbols: Any) -> None:
    """Write what is not zero; the rest is zero already."""
    at, place = 0, 0
    while at < coded.size:
        if coded[at]:
            symbols[place] = coded[at]
            at, place = at + 1, place + 1
        else:
            place += coded[at + 1]
            at += 2


@numba.njit(cache=True)
def _write_codes(symbols: Any, first: int, codes: Any) -> int:
    """Figure C-1; sequences are found by a hash of the code before and the byte behind it."""
    keys = np.full(_SLOTS, -1, np.int32)
    values = np.empty(_SLOTS, np.uint16)
    written, entries = 0, first
    if symbols.size == 0:
        return 0
    sequence = np.int64(symbols[0])
    for index in range(1, symbols.size):
        symbol = np.int64(symbols[index])
        key = sequence * 256 + symbol
        slot = ((key * 2654435761) >> 8) % _SLOTS
        while keys[slot] != key and keys[slot] >= 0:
            slot = (slot + 1) % _SLOTS
        if keys[slot] == key:
            sequence = np.int64(values[slot])
            continue
        codes[written] = sequence
        written += 1
        if entries < LZW_CODES:
            keys[slot], values[slot] = key, entries
            entries += 1
        sequence = symbol
    codes[written] = sequence
    return written + 1


@numba.njit(cache=True)
def _length_of_codes(codes: Any, first: int, lengths: Any) -> int:
    """Return how many bytes codes stand for, and fill in each entry's; -1 - index of a bad one."""
    entries, size = first, 0
    for index in range(codes.size):
        code = np.int64(codes[index])
        if index and entries < LZW_CODES:
            # The entry is the code before and one byte; this very code may already name it.
            lengths[entries] = lengths[codes[index - 1]] + 1
            entries += 1
        if code >= entries or _SYMBOLS <= code < first:
            return -1 - index
        size += lengths[code]
    return size


@numba.njit(cache=True)
def _read_codes(codes: Any, first: int, lengths: Any, symbols: Any) -> None:
    """Write each sequence; an entry is known by where it stands in what was written."""
    starts = np.zeros(LZW_CODES, np.int64)
    entries, at = first, 0
    for index in range(codes.size):
        code = np.int64(codes[index])
        if index and entries < LZW_CODES:
            starts[entries] = at - lengths[codes[index - 1]]
            entries += 1
        if code < _SYMBOLS:
            symbols[at] = code
            at += 1
            continue
        # Byte by byte: an entry may reach into what is just being written.
        for offset in range(lengths[code]):
            symbols[at] = symbols[starts[code] + offset]
            at += 1
