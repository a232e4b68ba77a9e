"""Shannon entropy of bytes, and Huffman's code that comes within a bit of it (appendix C.3)."""

import heapq
import struct
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import ByteArray

CountArray = NDArray[np.int64]

_BYTES = 256
_LONGEST = 64
"""Longest code word [bit]; Huffman's tree reaches it from 10^13 symbols on."""
_HEAD = struct.Struct("<Q256B")  # Number of symbols, and the length of each one's word.


class CodingError(ValueError):
    """Coded data is damaged, or was not coded in this way."""


def entropy(symbols: ByteArray) -> float:
    """Return the Shannon entropy of the histogram of bytes [bit per symbol]; 0 of nothing.

    Args:
        symbols: uint8 of any shape.
    """
    return histogram_bits(histogram(symbols))


def histogram(symbols: ByteArray) -> CountArray:
    """Return (256,) how often each byte occurs.

    Args:
        symbols: uint8 of any shape.

    Raises:
        ValueError: If it holds other than bytes.
    """
    if symbols.dtype != np.uint8:
        raise ValueError(f"symbols of {symbols.dtype}: expected uint8")
    return np.bincount(symbols.ravel(), minlength=_BYTES).astype(np.int64)


def histogram_bits(counts: ArrayLike) -> float:
    """Return the Shannon entropy of a histogram [bit per symbol].

    Args:
        counts: (n,) how often each symbol occurs.
    """
    seen = np.asarray(counts, dtype=float)
    seen = seen[seen > 0.0]
    if not seen.size:
        return 0.0
    share = seen / seen.sum()
    # Rounding makes -0 and less of a sure thing.
    return max(0.0, float(-np.sum(share * np.log2(share))))


def word_lengths(counts: CountArray) -> NDArray[np.int64]:
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
    so that the lengths alone tell them.

    Args:
        symbols: uint8 of any shape.
    """
    lengths = word_lengths(histogram(symbols))
    words = _canonical_words(lengths)
    bits = int(histogram(symbols) @ lengths)
    packed: ByteArray = np.zeros(-(-bits // 8), np.uint8)
    _pack(symbols.ravel(), words, lengths, packed)
    return _HEAD.pack(symbols.size, *lengths.tolist()) + packed.tobytes()


def huffman_decode(coded: bytes) -> ByteArray:
    """Return (n,) bytes from what `huffman_encode` made of them.

    Raises:
        CodingError: If they cannot be told.
    """
    if len(coded) < _HEAD.size:
        raise CodingError(f"Huffman code of {len(coded)} bytes: its head alone takes {_HEAD.size}")
    count, *listed = _HEAD.unpack_from(coded)
    lengths = np.array(listed, np.int64)
    packed = np.frombuffer(coded, np.uint8, offset=_HEAD.size)
    if lengths.max() > _LONGEST or _overfull(lengths):
        raise CodingError("Huffman code: its word lengths are not those of a code")
    if count > 8 * packed.size:
        raise CodingError(f"Huffman code: {count} symbols cannot be in {packed.size} bytes")
    symbols = np.empty(int(count), np.uint8)
    if not _unpack(packed, lengths, np.argsort(lengths, kind="stable"), symbols):
        raise CodingError(f"Huffman code: ends before its {count} symbols")
    return symbols


def _overfull(lengths: NDArray[np.int64]) -> bool:
    """Tell whether more words were asked for than there are (Kraft's inequality)."""
    total = sum(1 << (_LONGEST - int(length)) for length in lengths if length)
    return total > 1 << _LONGEST


def _canonical_words(lengths: NDArray[np.int64]) -> NDArray[np.uint64]:
    words = np.zeros(len(lengths), np.uint64)
    word, before = 0, 0
    for symbol in np.argsort(lengths, kind="stable"):
        length = int(lengths[symbol])
        if not length:
            continue
        word <<= length - before
        words[symbol] = word
        word, before = word + 1, length
    return words


@numba.njit(cache=True)
def _pack(symbols: Any, words: Any, lengths: Any, packed: Any) -> None:
    at = 0
    for symbol in symbols:
        word = words[symbol]
        for place in range(lengths[symbol] - 1, -1, -1):
            if (word >> np.uint64(place)) & np.uint64(1):
                packed[at >> 3] |= 128 >> (at & 7)
            at += 1


@numba.njit(cache=True)
def _unpack(packed: Any, lengths: Any, order: Any, symbols: Any) -> bool:
    """Read words bit by bit; false if they end too early or a word is none."""
    of_length = np.zeros(66, np.int64)
    for length in lengths:
        of_length[length] += 1
    at, end = 0, 8 * packed.size
    for index in range(symbols.size):
        # word - first tells which of the words of this length it is, if it is one.
        word, first, before, length = np.int64(0), np.int64(0), of_length[0], 0
        while True:
            if at == end or length == 64:
                return False
            word = (word << 1) | ((packed[at >> 3] >> (7 - (at & 7))) & 1)
            at, length = at + 1, length + 1
            first <<= 1
            if word - first < of_length[length]:
                symbols[index] = order[before + word - first]
                break
            first += of_length[length]
            before += of_length[length]
    return True
