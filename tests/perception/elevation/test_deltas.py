"""Deltas of tiles: back again from any tile, and never another one from a damaged message."""

import dataclasses
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from perception.compression.byte_codes import CodingError
from perception.elevation.deltas import (
    LARGEST,
    STEP,
    TILE,
    TileDelta,
    decode_delta,
    encode_delta,
    rounded,
    tile_counts,
    tile_parts,
)
from perception.elevation.grid import ElevationGrid

CELLS = TILE * TILE


def tile_of(rng, share=1.0, deviation=0.0015):
    """A sloping tile with rocks and noise, a part of it known."""
    y, x = 0.05 * np.indices((TILE, TILE))
    heights = rng.uniform(-1.0, 1.0) + rng.normal(0.0, 0.15) * x + rng.normal(0.0, 0.15) * y
    heights += 0.02 * np.sin(rng.uniform(6.0, 14.0) * x + rng.uniform(0.0, 6.0))
    for row, column in rng.integers(0, TILE, (3, 2)):
        heights[row : row + 3, column : column + 2] += rng.uniform(0.02, 0.1)
    heights += rng.normal(0.0, deviation, heights.shape)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    along = np.cos(angle) * x + np.sin(angle) * y
    mask = along <= np.quantile(along, share)
    cells = np.flatnonzero(mask)
    return TileDelta(3, 77, 200, cells, heights.ravel()[cells], deviation)


def assert_same(found, wanted):
    assert (found.robot, found.tile, found.revision) == (wanted.robot, wanted.tile, wanted.revision)
    np.testing.assert_array_equal(found.cells, wanted.cells)
    np.testing.assert_allclose(found.heights, wanted.heights, atol=0.5 * STEP + 1e-9)
    assert found.deviation == pytest.approx(min(wanted.deviation, 0.1275), abs=0.00026)


any_mask = st.one_of(
    arrays(bool, CELLS),
    st.tuples(st.integers(0, 255), st.integers(1, 256)).map(
        lambda ends: (np.arange(CELLS) >= ends[0]) & (np.arange(CELLS) < ends[0] + ends[1])
    ),
    st.integers(0, 255).map(lambda cell: np.arange(CELLS) == cell),
).filter(np.any)
any_steps = st.one_of(
    arrays(np.int64, CELLS, elements=st.integers(-0x7FFF, 0x7FFF)),
    arrays(np.int64, CELLS, elements=st.integers(-3, 3)),
    arrays(np.int64, CELLS, elements=st.sampled_from([-0x7FFF, 0, 1, 200, 0x7FFF])),
)
byte = st.integers(0, 255)


@st.composite
def any_delta(draw):
    cells = np.flatnonzero(draw(any_mask))
    heights = STEP * draw(any_steps)[cells]
    numbers = draw(byte), draw(st.integers(0, 0xFFFF)), draw(byte)
    return TileDelta(*numbers, cells, heights, draw(st.floats(0.0, 0.2)))


@given(any_delta())
@settings(max_examples=200, deadline=None)
def test_any_tile_comes_back_to_the_step(delta):
    message = encode_delta(delta)
    found = decode_delta(message)
    assert_same(found, delta)
    np.testing.assert_array_equal(found.heights, rounded(delta.heights))
    # Even noise takes no more than it is: head and CRC, the mask's bits, 16 bits a height.
    assert len(message) <= 13 + CELLS // 8 + 2 * (len(delta.cells) - 1)


@given(st.integers(0, 2**32), st.floats(0.02, 1.0))
@settings(max_examples=50, deadline=None)
def test_tiles_of_real_ground_come_back_within_half_a_step(seed, share):
    delta = tile_of(np.random.default_rng(seed), share)
    assert_same(decode_delta(encode_delta(delta)), delta)


def test_differences_that_are_all_alike_likely_come_back_too():
    """No cell has a neighbour, and every byte is as likely: plain bytes would be the best words."""
    rng = np.random.default_rng(4)
    cells = np.flatnonzero(np.indices((TILE, TILE)).sum(axis=0) % 2)
    for most in (100, 127, 128, 200):
        steps = np.cumsum(rng.integers(-most, most, len(cells)))
        delta = TileDelta(1, 2, 3, cells, STEP * steps, 0.001)
        assert_same(decode_delta(encode_delta(delta)), delta)


@given(any_delta(), st.data())
@settings(max_examples=200, deadline=None)
def test_any_damage_is_refused(delta, data):
    message = encode_delta(delta)
    bits = data.draw(st.sets(st.integers(0, 8 * len(message) - 1), min_size=1, max_size=40))
    damaged = bytearray(message)
    for bit in bits:
        damaged[bit >> 3] ^= 128 >> (bit & 7)
    with pytest.raises(CodingError, match="tile"):
        decode_delta(bytes(damaged))


@given(any_delta(), st.binary(max_size=70), st.data())
@settings(max_examples=100, deadline=None)
def test_what_was_cut_off_added_or_exchanged_is_refused(delta, strange, data):
    message = encode_delta(delta)
    at = data.draw(st.integers(0, len(message)))
    for damaged in (message[:at] + strange + message[at:], message[:at], message[at:], strange):
        if damaged == message:
            continue
        with pytest.raises(CodingError, match="tile"):
            decode_delta(damaged)


def test_none_of_30000_damaged_messages_becomes_another_tile():
    """Bits, bursts, bytes lost or doubled, pieces of other tiles: none decodes at all."""
    rng = np.random.default_rng(0)
    messages = [encode_delta(tile_of(rng, rng.uniform(0.05, 1.0))) for _ in range(300)]
    silent = 0
    for count in range(30000):
        message = bytearray(messages[count % 300])
        other = messages[int(rng.integers(300))]
        at, size = int(rng.integers(len(message))), int(rng.integers(1, 9))
        kind = count // 300 % 5
        if kind == 0:
            for bit in rng.integers(8 * len(message), size=size):
                message[bit >> 3] ^= 1 << (bit & 7)
        elif kind == 1:
            message[at : at + size] = rng.bytes(len(message[at : at + size]))
        elif kind == 2:
            del message[at : at + size]
        elif kind == 3:
            message[at:at] = message[at : at + size]
        else:
            message[at:] = other[at:]
        if bytes(message) in (messages[count % 300], other):
            continue
        try:
            decode_delta(bytes(message))
            silent += 1
        except CodingError:
            pass
    assert silent == 0


def sealed(content):
    """A message whose CRC is right, whatever it holds."""
    return content + zlib.crc32(content).to_bytes(4, "big")


def test_what_is_sealed_but_no_tile_is_refused():
    delta = tile_of(np.random.default_rng(1), 0.5)
    good = encode_delta(delta)[:-4]
    assert_same(decode_delta(sealed(good)), delta)
    for content, message in (
        (good + b"\0", "bytes of words"),
        (good[:-1], "ends before"),
        (good[:4] + b"\xff" + good[5:9] + bytes(32), "holds no cells"),
        (good[:4] + b"\x38" + good[5:8] + b"\x01" + b"\xff" * 2, "its runs go on"),
    ):
        with pytest.raises(CodingError, match=message):
            decode_delta(sealed(content))
    rng = np.random.default_rng(2)
    for _ in range(2000):
        content = good[:4] + rng.bytes(int(rng.integers(5, 90)))
        try:
            found = decode_delta(sealed(content))
            assert_same(decode_delta(encode_delta(found)), found)
        except CodingError:
            pass


def test_a_message_of_one_version_is_read_by_the_next():
    """Head: robot 3, tile 77, revision 200; first height 20 steps; 4 cells of a plane."""
    delta = TileDelta(3, 77, 200, np.array([0, 1, 16, 17]), np.array([0.1, 0.11, 0.09, 0.1]), 0.002)
    assert encode_delta(delta).hex() == GOLDEN
    assert_same(decode_delta(bytes.fromhex(GOLDEN)), delta)


GOLDEN = "03004dc81a040014030f6650a961746b"


def test_a_tile_of_ground_takes_a_fifth_of_its_numbers_and_half_of_what_zlib_makes_of_them():
    rng = np.random.default_rng(3)
    ours, numbers, deflated = 0, 0, 0
    for share in np.linspace(0.1, 1.0, 100):
        delta = tile_of(rng, share)
        mask = np.packbits(np.isin(np.arange(CELLS), delta.cells)).tobytes()
        plain = mask + np.rint(delta.heights / STEP).astype(">i2").tobytes()
        ours += len(encode_delta(delta))
        numbers += len(plain)
        deflated += len(zlib.compress(plain, 9))
    assert ours < 0.3 * numbers
    assert ours < 0.6 * deflated


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"robot": 256}, "robot 256 is not within 0 to 255"),
        ({"tile": -1}, "tile -1"),
        ({"revision": 300}, "revision 300"),
        ({"deviation": np.nan}, "deviation nan"),
        ({"cells": np.array([], np.intp)}, "cells"),
        ({"cells": np.array([3, 2])}, "cells"),
        ({"cells": np.array([3, 256])}, "cells"),
        ({"heights": np.array([0.0])}, "heights"),
        ({"heights": np.array([0.0, np.nan])}, "heights"),
        ({"heights": np.array([0.0, LARGEST + 0.01])}, "heights"),
    ],
)
def test_what_cannot_be_sent_is_named(changes, message):
    good = TileDelta(1, 2, 3, np.array([4, 5]), np.array([0.0, 0.1]), 0.001)
    with pytest.raises(ValueError, match=message):
        encode_delta(dataclasses.replace(good, **changes))


def test_tiles_cover_a_grid_once():
    grid = ElevationGrid((0.0, 0.0), (40, 70))
    assert tile_counts(grid) == (3, 5)
    times = np.zeros(grid.shape, dtype=int)
    for tile in range(15):
        times[tile_parts(grid, tile)] += 1
    assert np.all(times == 1)
    assert tile_parts(grid, 14) == (slice(32, 40), slice(64, 70))
    with pytest.raises(ValueError, match="tile 15: expected 0 to 14"):
        tile_parts(grid, 15)
