"""The radio's frames: no byte error gets past them, and no noise fills a parser."""

import tracemalloc

import fastcrc
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from twin.hardware.radio.frames import Frame, FrameParser, encode_frame

pytestmark = pytest.mark.virtual_time

FRAMES = st.builds(
    Frame,
    st.integers(0, 15),
    st.integers(0, 15),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFF),
    st.binary(min_size=1, max_size=64),
)


def decode(data):
    return FrameParser(64).feed(data)


@given(st.lists(FRAMES, max_size=5), st.data())
def test_frames_come_back_however_the_bytes_are_cut(frames, data):
    line = b"".join(map(encode_frame, frames))
    cut = data.draw(st.integers(0, len(line)))
    parser = FrameParser(64)
    assert parser.feed(line[:cut]) + parser.feed(line[cut:]) == frames
    assert parser.rejected == 0


def test_no_single_byte_error_makes_another_frame():
    body = b"\x11\x01\x00\x00\x04\xd2" + bytes(range(12)) + b"\x00\x00"
    frame = Frame(1, 2, 0xBEEF, 0, body)
    line = encode_frame(frame)
    for place in range(len(line)):
        before, behind = line[:place], line[place + 1 :]
        hit = [before + behind]
        hit += [before + bytes([value]) + behind for value in range(256)]
        hit += [before + bytes([value]) + line[place:] for value in range(256)]
        for data in hit:
            # A second frame follows, as on a busy line.
            assert set(decode(data + line)) <= {frame}


def test_zero_at_either_end_is_seen_where_xmodem_is_blind():
    """Why the CRC is not plain XMODEM: one COBS byte too many puts a zero behind it."""
    content = b"\x10\x12\x34\x05pose"
    crc = fastcrc.crc16.xmodem(content).to_bytes(2, "big")
    longer = cobs.decode(cobs.encode(content + crc) + b"\x01")
    assert longer == content + crc + b"\0"
    assert fastcrc.crc16.xmodem(longer[:-2]).to_bytes(2, "big") == longer[-2:]
    assert fastcrc.crc16.xmodem(b"\0" + content).to_bytes(2, "big") == crc

    line = encode_frame(Frame(1, 0, 0x1234, 5, b"pose"))
    assert decode(line[:-1] + b"\x01\0") == []
    assert decode(b"\x01" + line) == []


def test_stream_without_any_delimiter_is_not_kept():
    parser = FrameParser(64)
    tracemalloc.start()
    for _ in range(1000):
        parser.feed(b"\x01" * 1000)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20_000
    frame = Frame(1, 0, 1, 1, b"x")
    assert parser.feed(b"\0" + encode_frame(frame)) == [frame]
    assert parser.rejected == 1
