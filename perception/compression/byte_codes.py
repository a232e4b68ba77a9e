"""Shannon entropy of bytes, and codes of sequences of bytes (Thesis appendix C.2 to C.4).

Huffman's code comes within a bit of the entropy; runs of zeros and LZW (figure C-1) shorten what
repeats itself.
"""

import heapq
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import ByteArray, IntArray

CodeArray = NDArray[np.uint16]

_BYTES = 256
LZW_BITS = 12
LZW_CODES = 1 << LZW_BITS
"""Entries of LZW's table."""
_LONGEST_RUN = 255
_SLOTS = 4 * LZW_CODES
_LONGEST = 64
"""Longest code word [bit]; Huffman's tree reaches it from 10^13 symbols on."""
_HEAD = struct.Struct("<Q256B")  # Number of symbols, and the length of each one's word.


class CodingError(ValueError):
    """Coded data is damaged, or was not coded in this way."""


class WordCode(NamedTuple):
    """Code of symbols by words none of which begins with another, as Huffman's.

    Attributes:
        lengths: (n,) length of each symbol's word [bit]; 0 for symbols without.
        words: (n,) the words, right-aligned.
        order: (n,) symbols in ascending order of their words; those without come first.
    """

    lengths: IntArray
    words: NDArray[np.uint64]
    order: IntArray


def entropy(symbols: ByteArray) -> float:
    """Return the Shannon entropy of the histogram of bytes [bit per symbol]; 0 of nothing.

    Args:
        symbols: uint8 of any shape.
    """
    counts = histogram(symbols)
    share = counts[counts > 0] / max(symbols.size, 1)
    # Rounding makes -0 and less of a sure thing.
    return max(0.0, -float(np.sum(share * np.log2(share))))


def histogram(symbols: ByteArray) -> IntArray:
    """Return (256,) how often each byte occurs.

    Args:
        symbols: uint8 of any shape.

    Raises:
        ValueError: If it holds other than bytes.
    """
    if symbols.dtype != np.uint8:
        raise ValueError(f"symbols of {symbols.dtype}: expected uint8")
    return np.bincount(symbols.ravel(), minlength=_BYTES).astype(np.int64)


def word_lengths(counts: IntArray) -> IntArray:
    """Return (n,) lengths of Huffman's code words [bit]; 0 for symbols that do not occur.

    The two rarest nodes get a common parent until one is left. A lone symbol gets one bit.

    Args:
        counts: (n,) how often each symbol occurs.
    """
    lengths = np.zeros(len(counts), np.int64)
    # The order of creation breaks ties, so that a histogram has one code.
    nodes = [(int(count), order, [order]) for order, count in enumerate(counts) if count > 0]
    if len(nodes) == 1:
        lengths[nodes[0][1]] = 1
    heapq.heapify(nodes)
    order = len(counts)
    while len(nodes) > 1:
        first, second = heapq.heappop(nodes), heapq.heappop(nodes)
        leaves = first[2] + second[2]
        lengths[leaves] += 1
        heapq.heappush(nodes, (first[0] + second[0], order, leaves))
        order += 1
    return lengths


def mean_word_length(symbols: ByteArray) -> float:
    """Return the mean length of Huffman's words for bytes [bit per symbol]; 0 of nothing.

    Args:
        symbols: uint8 of any shape.
    """
    counts = histogram(symbols)
    return float(counts @ word_lengths(counts)) / max(int(counts.sum()), 1)


def huffman_encode(symbols: ByteArray) -> bytes:
    """Return bytes in Huffman's code: their number, 256 word lengths, and the words.

    Words of one length are consecutive numbers in the order of their symbols (a canonical code),
    so that the lengths alone determine them.

    Args:
        symbols: uint8 of any shape.
    """
    code = canonical_code(word_lengths(histogram(symbols)))
    return _HEAD.pack(symbols.size, *code.lengths.tolist()) + pack_words([(symbols, code)])


def huffman_decode(coded: bytes) -> ByteArray:
    """Return (n,) bytes from what `huffman_encode` made of them.

    Raises:
        CodingError: If they cannot be decoded.
    """
    if len(coded) < _HEAD.size:
        raise CodingError(f"Huffman code of {len(coded)} bytes: its head alone takes {_HEAD.size}")
    count, *listed = _HEAD.unpack_from(coded)
    lengths = np.array(listed, np.int64)
    packed = np.frombuffer(coded, np.uint8, offset=_HEAD.size)
    # Kraft's inequality: there are no more words than these.
    words = sum(1 << (_LONGEST - int(length)) for length in lengths if 0 < length <= _LONGEST)
    if lengths.max() > _LONGEST or words > 1 << _LONGEST:
        raise CodingError("Huffman code: its word lengths are not those of a code")
    if count > 8 * packed.size:
        raise CodingError(f"Huffman code: {count} symbols cannot be in {packed.size} bytes")
    return unpack_words(coded[_HEAD.size :], canonical_code(lengths), int(count))[0]


def canonical_code(lengths: IntArray) -> WordCode:
    """Return the code whose words of one length are consecutive, in the order of their symbols.

    Args:
        lengths: (n,) length of each symbol's word [bit], up to 64; 0 for symbols without.
    """
    order = np.argsort(lengths, kind="stable").astype(np.int64)
    words = np.zeros(len(lengths), np.uint64)
    word, before = 0, 0
    for symbol in order:
        length = int(lengths[symbol])
        if not length:
            continue
        word <<= length - before
        words[symbol] = word
        word, before = word + 1, length
    return WordCode(lengths, words, order)


def pack_words(parts: Sequence[tuple[ByteArray, WordCode]]) -> bytes:
    """Return the words of sequences of symbols one after the other; bits of 0 fill the last byte.

    Args:
        parts: Symbols of any shape, and the code of them.
    """
    words = np.concatenate([code.words[symbols.ravel()] for symbols, code in parts])
    lengths = np.concatenate([code.lengths[symbols.ravel()] for symbols, code in parts])
    packed: ByteArray = np.zeros(-(-int(lengths.sum()) // 8), np.uint8)
    _pack(words, lengths, packed)
    return packed.tobytes()


def unpack_words(
    packed: bytes, code: WordCode, count: int, start: int = 0
) -> tuple[ByteArray, int]:
    """Return symbols (count,) from what `pack_words` made of them, and where they end [bit].

    Args:
        packed: Words one after the other.
        code: Code of the symbols.
        count: Number of symbols.
        start: Where the first word begins [bit].

    Raises:
        CodingError: If they end too early, or a word is none.
    """
    symbols = np.empty(count, np.uint8)
    given = np.frombuffer(packed, np.uint8)
    end = int(_unpack(given, code.lengths, code.order, symbols, start))
    if end < 0:
        raise CodingError(f"Huffman code: ends before its {count} symbols")
    return symbols, end


@numba.njit(cache=True)
def _pack(words: Any, lengths: Any, packed: Any) -> None:
    at = 0
    for index in range(words.size):
        word = words[index]
        for place in range(lengths[index] - 1, -1, -1):
            if (word >> np.uint64(place)) & np.uint64(1):
                packed[at >> 3] |= 128 >> (at & 7)
            at += 1


@numba.njit(cache=True)
def _unpack(packed: Any, lengths: Any, order: Any, symbols: Any, start: int) -> int:
    """Read words bit by bit, and return where they end; -1 if too early or if a word is none."""
    of_length = np.zeros(66, np.int64)
    for length in lengths:
        of_length[length] += 1
    at, end = start, 8 * packed.size
    for index in range(symbols.size):
        # word - first is the index among the words of this length, if it is one.
        word, first, before, length = np.int64(0), np.int64(0), of_length[0], 0
        while True:
            if at == end or length == 64:
                return -1
            word = (word << 1) | ((packed[at >> 3] >> (7 - (at & 7))) & 1)
            at, length = at + 1, length + 1
            first <<= 1
            if word - first < of_length[length]:
                symbols[index] = order[before + word - first]
                break
            first += of_length[length]
            before += of_length[length]
    return at


def run_length_encode(symbols: ByteArray) -> bytes:
    """Return bytes in which each run of zeros is a zero and its length (C.2).

    A length is a byte, so that a run of more than 255 zeros is written as several.

    Args:
        symbols: uint8 of any shape.
    """
    flat = np.ravel(symbols).astype(np.uint8)
    zero, index = flat == 0, np.arange(flat.size)
    before = np.maximum.accumulate(np.where(zero, -1, index))  # The last symbol that is not zero.
    length = (index - before - 1) % _LONGEST_RUN + 1
    ends = ~zero | (length == _LONGEST_RUN) | ~np.append(zero[1:], False)
    written = np.column_stack([ends, ends & zero])
    return np.column_stack([flat, length])[written].astype(np.uint8).tobytes()


def run_length_decode(coded: bytes) -> ByteArray:
    """Return (n,) bytes from what `run_length_encode` made of them.

    Raises:
        CodingError: If a run has no length.
    """
    given = np.frombuffer(coded, np.uint8)
    zero = given == 0
    is_length = np.append(False, zero)
    if np.any(is_length & np.append(zero, True)):
        raise CodingError("run-length code: a zero is followed by no length")
    is_length = is_length[:-1]
    return np.repeat(np.where(is_length, 0, given), np.where(is_length, given, ~zero))


def lzw_codes(symbols: ByteArray, first: int = _BYTES) -> CodeArray:
    """Return the codes that LZW writes for bytes.

    Codes below 256 are single bytes; each code written adds its sequence and the
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


def lzw_symbols(codes: CodeArray, first: int = _BYTES) -> ByteArray:
    """Return the bytes that LZW's codes encode.

    Args:
        codes: (n,) uint16.
        first: Code of the first sequence, as in `lzw_codes`.

    Raises:
        CodingError: If a code has no sequence yet.
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
        CodingError: If they cannot be decoded.
    """
    count = len(coded) * 8 // LZW_BITS
    if -(-count * LZW_BITS // 8) != len(coded):
        raise CodingError(f"LZW: no number of 12-bit codes takes {len(coded)} bytes")
    packed = np.frombuffer(coded + bytes(-len(coded) % 3), np.uint8).astype(np.uint16)
    one, two, three = packed.reshape(-1, 3).T
    codes = np.stack([one << 4 | two >> 4, (two & 15) << 8 | three], axis=1).ravel()
    return lzw_symbols(codes[:count].astype(np.uint16))


def _check_first(first: int) -> None:
    if not _BYTES <= first <= LZW_CODES:
        raise ValueError(f"LZW's first sequence has code {first}: expected 256 to {LZW_CODES}")


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
    """Return the number of decoded bytes, and fill in each entry's; -1 - index of a bad code."""
    entries, size = first, 0
    for index in range(codes.size):
        code = np.int64(codes[index])
        if index and entries < LZW_CODES:
            # The entry is the code before and one byte; this very code may already name it.
            lengths[entries] = lengths[codes[index - 1]] + 1
            entries += 1
        if code >= entries or _BYTES <= code < first:
            return -1 - index
        size += lengths[code]
    return size


@numba.njit(cache=True)
def _read_codes(codes: Any, first: int, lengths: Any, symbols: Any) -> None:
    """Write each sequence; an entry is a position in what was written."""
    starts = np.zeros(LZW_CODES, np.int64)
    entries, at = first, 0
    for index in range(codes.size):
        code = np.int64(codes[index])
        if index and entries < LZW_CODES:
            starts[entries] = at - lengths[codes[index - 1]]
            entries += 1
        if code < _BYTES:
            symbols[at] = code
            at += 1
            continue
        # Byte by byte: an entry may reach into what is just being written.
        for offset in range(lengths[code]):
            symbols[at] = symbols[starts[code] + offset]
            at += 1
