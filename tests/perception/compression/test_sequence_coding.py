"""Runs and LZW: back again, and against Pillow's decoder of GIF."""

import io
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from perception.compression.byte_codes import (
    CodingError,
    lzw_codes,
    lzw_decode,
    lzw_encode,
    lzw_symbols,
    run_length_decode,
    run_length_encode,
)

GIF_FIRST, GIF_CLEAR, GIF_END = 258, 256, 257

symbols = st.one_of(
    st.binary(max_size=300),
    st.lists(st.sampled_from([0, 0, 0, 1]), max_size=700).map(bytes),
    st.tuples(st.binary(min_size=1, max_size=3), st.integers(0, 300)).map(lambda t: t[0] * t[1]),
).map(lambda data: np.frombuffer(data, np.uint8))


@given(symbols)
@settings(max_examples=100, deadline=None)
def test_both_codes_lead_back(data):
    np.testing.assert_array_equal(run_length_decode(run_length_encode(data)), data)
    np.testing.assert_array_equal(lzw_decode(lzw_encode(data)), data)


def test_runs_are_a_zero_and_their_length():
    data = np.array([5, 0, 0, 0, 7, 0] + 300 * [0] + [1], np.uint8)
    assert run_length_encode(data) == bytes([5, 0, 3, 7, 0, 255, 0, 46, 1])


def test_lzw_follows_the_flowchart_by_hand():
    """a, b, ab, aba: the last code is used while it is being made (codes 256, 257, 258)."""
    data = np.frombuffer(b"abababa", np.uint8)
    assert lzw_codes(data).tolist() == [97, 98, 256, 258]
    assert lzw_encode(data) == bytes([0x06, 0x10, 0x62, 0x10, 0x01, 0x02])


def test_codes_have_twelve_bits_and_no_more_than_4096_values():
    data = np.random.default_rng(0).integers(0, 256, 30000, dtype=np.uint8)
    codes = lzw_codes(data)
    # Of noise hardly any code is used twice: which of the last ones are is chance.
    assert 4000 < codes.max() <= 4095
    assert len(lzw_encode(data)) == -(-len(codes) * 12 // 8)
    np.testing.assert_array_equal(lzw_symbols(codes), data)


def gif(image: np.ndarray, codes: np.ndarray) -> bytes:
    """A GIF of codes: width grows with the table, which Pillow builds for itself."""
    bits, count = 0, 0

    def put(code: int, width: int) -> None:
        nonlocal bits, count
        bits |= code << count
        count += width

    pieces, entries, width = [], GIF_FIRST, 9
    put(GIF_CLEAR, width)
    for place, code in enumerate(codes.tolist()):
        put(code, width)
        entries += place > 0
        if entries == 1 << width and width < 12:
            width += 1
        if count > 4096:  # numbers of any size, but short ones are faster
            pieces.append((bits & (1 << 4096) - 1).to_bytes(512, "little"))
            bits, count = bits >> 4096, count - 4096
    put(GIF_END, width)
    pieces.append(bits.to_bytes(-(-count // 8), "little"))
    stream = b"".join(pieces)
    height, across = image.shape
    blocks = [stream[i : i + 255] for i in range(0, len(stream), 255)]
    palette = bytes(np.repeat(np.arange(256, dtype=np.uint8), 3))
    return b"".join(
        [b"GIF89a", struct.pack("<HHBBB", across, height, 0xF7, 0, 0), palette, b","]
        + [struct.pack("<HHHHB", 0, 0, across, height, 0), b"\x08"]
        + [bytes([len(block)]) + block for block in blocks]
        + [b"\x00;"]
    )


@pytest.mark.parametrize("what", ["noise", "few", "constant", "small"])
def test_pillow_decodes_our_codes(what):
    """The same codes but for their names: GIF keeps 256 and 257 for itself.

    Noise fills the table, so that it also shows that it then stays as it is.
    """
    rng = np.random.default_rng(3)
    image = {
        "noise": rng.integers(0, 256, (120, 130), dtype=np.uint8),
        "few": rng.binomial(4, 0.1, (200, 200)).astype(np.uint8),
        "constant": np.full((90, 90), 17, np.uint8),
        "small": rng.integers(0, 256, (3, 5), dtype=np.uint8),
    }[what]
    codes = lzw_codes(image, first=GIF_FIRST)
    with Image.open(io.BytesIO(gif(image, codes))) as opened:
        np.testing.assert_array_equal(np.asarray(opened.convert("L")), image)
    same = codes.astype(int) - 2 * (codes >= GIF_FIRST)
    ours = lzw_codes(image)
    # Two more entries fit in the thesis' table; until then all codes are the same.
    before = min(len(ours), 4096 - GIF_FIRST)
    np.testing.assert_array_equal(same[:before], ours[:before])


def test_damaged_codes_are_refused():
    with pytest.raises(CodingError, match="code 300 at 1 stands for nothing"):
        lzw_symbols(np.array([65, 300], np.uint16))
    with pytest.raises(CodingError, match="code 256 at 0"):
        lzw_symbols(np.array([256], np.uint16))
    with pytest.raises(CodingError, match="takes 1 bytes"):
        lzw_decode(b"a")
    with pytest.raises(CodingError, match="no length"):
        run_length_decode(b"\x05\x00")
    with pytest.raises(ValueError, match="255: expected 256 to 4096"):
        lzw_codes(np.zeros(3, np.uint8), first=255)
    rng = np.random.default_rng(4)
    for _ in range(200):
        try:
            lzw_decode(rng.bytes(rng.integers(0, 60)))
        except CodingError:
            pass
