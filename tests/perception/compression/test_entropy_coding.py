"""Huffman's code against the entropy, against brute force, and back."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import entropy as scipy_entropy

from perception.compression.byte_codes import (
    CodingError,
    canonical_code,
    entropy,
    histogram,
    huffman_decode,
    huffman_encode,
    mean_word_length,
    pack_words,
    unpack_words,
    word_lengths,
)

symbols = st.one_of(
    st.binary(max_size=200),
    st.lists(st.sampled_from([0, 0, 0, 0, 1, 7, 255]), max_size=200).map(bytes),
).map(lambda data: np.frombuffer(data, np.uint8))


@given(symbols)
@settings(max_examples=70, deadline=None)
def test_code_leads_back_and_is_within_a_bit_of_the_entropy(data):
    coded = huffman_encode(data)
    np.testing.assert_array_equal(huffman_decode(coded), data)
    if data.size:
        bits = entropy(data)
        assert bits - 1e-9 <= mean_word_length(data) <= bits + 1.0
        assert bits == pytest.approx(scipy_entropy(np.bincount(data), base=2), abs=1e-9)
        assert len(coded) == 264 + -(-round(mean_word_length(data) * data.size) // 8)


@given(st.lists(st.integers(1, 40), min_size=2, max_size=5))
@settings(max_examples=30, deadline=None)
def test_no_code_without_prefixes_is_shorter(counts):
    """All sets of word lengths that Kraft's inequality allows."""
    ours = int(np.dot(counts, word_lengths(np.array(counts))))
    lengths = itertools.product(range(1, len(counts)), repeat=len(counts))
    allowed = [some for some in lengths if sum(2.0**-length for length in some) <= 1.0]
    assert ours == min(int(np.dot(counts, some)) for some in allowed)


@given(symbols, symbols)
@settings(max_examples=50, deadline=None)
def test_sequences_of_two_codes_are_packed_without_a_gap(first, second):
    one, other = (canonical_code(word_lengths(1 + histogram(data))) for data in (first, second))
    packed = pack_words([(first, one), (second, other)])
    bits = int(one.lengths[first].sum() + other.lengths[second].sum())
    assert len(packed) == -(-bits // 8)
    found, middle = unpack_words(packed, one, first.size)
    np.testing.assert_array_equal(found, first)
    found, end = unpack_words(packed, other, second.size, middle)
    np.testing.assert_array_equal(found, second)
    assert end == bits
    with pytest.raises(CodingError, match="ends before"):
        unpack_words(packed, other, 8 * len(packed) + 1, middle)


def test_words_may_be_long():
    """Fibonacci's numbers make the deepest tree: 22 bits here."""
    counts = [1, 1]
    while len(counts) < 23:
        counts.append(counts[-1] + counts[-2])
    data = np.repeat(np.arange(23, dtype=np.uint8), counts)
    assert word_lengths(histogram(data)).max() == 22
    np.testing.assert_array_equal(huffman_decode(huffman_encode(data)), data)


def test_entropy_of_equal_shares_and_of_one_value():
    assert entropy(np.arange(256, dtype=np.uint8)) == pytest.approx(8.0)
    assert entropy(np.full(9, 3, np.uint8)) == 0.0
    assert mean_word_length(np.full(9, 3, np.uint8)) == 1.0
    assert entropy(np.zeros(0, np.uint8)) == 0.0


def test_damaged_codes_are_refused_or_decode_to_as_many_bytes():
    data = np.random.default_rng(0).binomial(20, 0.3, 500).astype(np.uint8)
    coded = huffman_encode(data)
    for broken, message in (
        (coded[:100], "head"),
        (coded[:-1], "ends before"),
        (b"\xff" * 8 + coded[8:], "cannot be in"),
        (coded[:8] + b"\x01" * 256 + coded[264:], "not those of a code"),
    ):
        with pytest.raises(CodingError, match=message):
            huffman_decode(broken)
    rng = np.random.default_rng(1)
    for _ in range(200):
        bad = bytearray(coded)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        try:
            assert huffman_decode(bytes(bad)).size == int.from_bytes(bad[:8], "little")
        except CodingError:
            pass


def test_other_than_bytes_are_named():
    with pytest.raises(ValueError, match="int64: expected uint8"):
        entropy(np.arange(3))
