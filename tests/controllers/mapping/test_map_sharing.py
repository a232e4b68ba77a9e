"""Two ends over a channel that loses, repeats, reorders and damages: the same obstacles."""

import struct

import fastcrc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.insertion import guidance
from controllers.mapping.map_sharing import (
    FRAGMENT,
    RECEIPT,
    MapSharing,
    MapSharingConfig,
    completed,
)
from controllers.mapping.messages import PoseMessage, WrenchMessage
from perception.elevation.deltas import STEP, TILE, TileDelta, encode_delta
from perception.elevation.grid import ElevationGrid
from perception.elevation.map import ElevationMap
from perception.elevation.submaps import rises_by_map
from twin.link import MESSAGE_LIMIT, RadioError

pytestmark = pytest.mark.virtual_time

GRID = ElevationGrid((-2.0, -2.0), (80, 80))
TICK = 0.05


def field(rng, grid=GRID):
    """Sloping, wavy ground with boxes of 60 to 90 mm."""
    x, y = np.moveaxis(grid.centres, -1, 0)
    heights = 0.15 * x - 0.1 * y + 0.015 * np.sin(4.0 * x + 1.0) * np.cos(3.0 * y)
    heights += rng.normal(0.0, 0.001, heights.shape)
    for row, column in rng.integers(0, min(grid.shape) - 3, (12, 2)):
        heights[row : row + 2, column : column + 3] += rng.uniform(0.06, 0.09)
    return heights


def map_of(heights, known=True, grid=GRID):
    model = ElevationMap(grid)
    model.heights[...] = np.where(known, heights, np.nan)
    model.variances[...] = np.where(known, 0.002**2, np.nan)
    return model


class Channel:
    """One direction of a radio: loses, delays and repeats messages, and damages some."""

    def __init__(self, rng, loss=0.0, jitter=0.0, repeats=0.0, damage=0.0):
        self._rng, self._loss, self._jitter = rng, loss, jitter
        self._repeats, self._damage, self._queue = repeats, damage, []

    def send(self, message, now):
        assert 0 < len(message) <= MESSAGE_LIMIT
        for _ in range(1 + (self._rng.uniform() < self._repeats)):
            if self._rng.uniform() >= self._loss:
                arrives = now + 0.1 + self._jitter * self._rng.uniform()
                self._queue.append((arrives, self._damaged(message)))

    def _damaged(self, message):
        if self._rng.uniform() >= self._damage:
            return message
        bad = bytearray(message)
        # The first byte tells whose message it is.
        bad[int(self._rng.integers(1, len(bad)))] ^= int(self._rng.integers(1, 256))
        return bytes(bad)

    def poll(self, now):
        arrived = sorted(entry for entry in self._queue if entry[0] <= now)
        self._queue = [entry for entry in self._queue if entry[0] > now]
        return [message for _, message in arrived]


def exchange(ends, channels, until, start=0.0, watch=None):
    """Let two ends send and receive; returns when the last message was handed out."""
    last = start
    for now in np.arange(start, until, TICK):
        for end, out, into in zip(ends, channels, channels[::-1]):
            message = end.next_message(now)
            if message is not None:
                out.send(message, now)
                last = now
            for arrived in into.poll(now):
                end.receive(arrived)
        if watch is not None:
            watch()
    return last


def two_robots(rng, config=None, **faults):
    """Robots that know the left and the right 60 % of a field, and their channels."""
    heights, columns = field(rng), np.arange(GRID.shape[1])
    known = columns < 48, columns >= 32
    maps = [map_of(heights + rng.normal(0.0, 0.001, heights.shape), half) for half in known]
    ends = [MapSharing(model, number, config) for number, model in enumerate(maps, start=1)]
    for end, model in zip(ends, maps):
        end.take(np.flatnonzero(model.known))
    return maps, ends, [Channel(rng, **faults) for _ in ends]


def test_first_bytes_are_no_other_message_s():
    nothing = (0.0, 0.0, 0.0)
    others = {
        PoseMessage(1, 0.0, nothing, nothing, 0.0).pack()[0],
        WrenchMessage(1, 0.0, nothing, nothing).pack()[0],
        guidance.KIND,
        guidance.KIND + 1,
        guidance.KIND + 2,
    }
    assert len(others | {FRAGMENT, RECEIPT}) == 7


def test_without_loss_the_other_s_map_arrives_within_half_a_step():
    maps, ends, channels = two_robots(np.random.default_rng(0))
    exchange(ends, channels, 60.0)
    for end, other in zip(ends, maps[::-1]):
        np.testing.assert_array_equal(end.received.known, other.known)
        assert np.nanmax(np.abs(end.received.heights - other.heights)) <= 0.5 * STEP + 1e-9
        expected = 0.002**2 + STEP**2 / 12.0
        np.testing.assert_allclose(end.received.variances[other.known], expected)
        assert end.tiles_dropped == 0
    # 3840 cells each, in 20 tiles.
    assert max(end.bytes_sent for end in ends) < 3000


@pytest.mark.parametrize("seed", range(4))
def test_with_a_fifth_lost_and_reordered_both_know_the_same_obstacles_within_the_budget(seed):
    rng = np.random.default_rng(seed)
    maps, ends, channels = two_robots(rng, loss=0.2, jitter=0.6, repeats=0.05)
    last = exchange(ends, channels, 150.0)
    ideal = rises_by_map(maps)
    assert (ideal > 0.04).sum() > 20
    for end, own in zip(ends, maps):
        found = rises_by_map([own, end.received])
        assert np.all(found[ideal > 0.035] > 0.025)
        assert not np.any(found[ideal < 0.015] > 0.025)
        assert end.bytes_sent <= 6000
        assert end.tiles_dropped > 0
    # All has its receipt: nothing is sent any more.
    assert last < 120.0


def test_damaged_messages_change_nothing_and_are_made_up_for():
    rng = np.random.default_rng(5)
    maps, ends, channels = two_robots(rng, loss=0.1, damage=0.1, jitter=0.3)
    exchange(ends, channels, 150.0)
    for end, other in zip(ends, maps[::-1]):
        np.testing.assert_array_equal(end.received.known, other.known)
        assert np.nanmax(np.abs(end.received.heights - other.heights)) <= 0.5 * STEP + 1e-9


def test_nothing_is_sent_beyond_budget_or_rate():
    config = MapSharingConfig(budget_bytes=1000, rate_bytes_per_s=100.0)
    (model, _), (end, _), _ = two_robots(np.random.default_rng(6), config)
    other, sent = MapSharing(ElevationMap(GRID), 2), []
    for now in np.arange(0.0, 60.0, 0.01):
        message = end.next_message(now)
        if message is not None:
            sent.append((now, len(message)))
            other.receive(message)
        if (receipt := other.next_message(now)) is not None:
            end.receive(receipt)
    # The rest is kept for receipts, and a delta is sent whole or not at all.
    assert 800 < sum(size for _, size in sent) == end.bytes_sent <= 950
    assert other.received.known.sum() < model.known.sum()
    for begin, _ in sent:
        within = sum(size for at, size in sent if begin <= at < begin + 5.0)
        assert within <= 500 + MESSAGE_LIMIT


def test_tiles_with_obstacles_come_first_and_then_those_with_most_new_cells():
    grid = ElevationGrid((0.0, 0.0), (TILE, 4 * TILE))
    heights, known = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    known[:, :16] = known[:12, 16:32] = known[:5, 32:48] = known[:, 48:] = True
    heights[2:4, 35:37] = 0.08
    model = map_of(heights, known, grid)
    end, other = MapSharing(model, 1), MapSharing(ElevationMap(grid), 2)
    end.take(np.flatnonzero(known))
    order = []
    for now in np.arange(0.0, 5.5, TICK):
        message = end.next_message(now)
        if message is not None:
            cells = other.receive(message)
            order += sorted({int(cell % 64) // TILE for cell in cells})
    assert order[0] == 2 and order[3] == 1
    assert sorted(order) == [0, 1, 2, 3]


def sent_in(end, other, begin, until):
    """Bytes that an end sends over a perfect channel."""
    before = end.bytes_sent
    exchange([end, other], [Channel(np.random.default_rng(0)) for _ in range(2)], until, begin)
    return end.bytes_sent - before


def test_small_changes_wait_until_a_tile_is_quiet_and_less_than_a_step_is_never_sent():
    model = map_of(field(np.random.default_rng(7)), np.arange(80) < 16)
    end, other = MapSharing(model, 1), MapSharing(ElevationMap(GRID), 2)
    cells = np.flatnonzero(model.known)
    end.take(cells)
    sent_in(end, other, 0.0, 40.0)
    model.heights[model.known] += 0.4 * STEP
    end.take(cells)
    assert sent_in(end, other, 40.0, 50.0) == 0
    times, heights = [], model.heights
    for count, now in enumerate(np.arange(50.0, 60.0, TICK)):
        if count < 120 and count % 10 == 0:  # Every half second another cell changes.
            cell = 80 * (count // 10) + 3
            heights.flat[cell] += 2.0 * STEP
            end.take(np.array([cell]))
        message = end.next_message(now)
        if message is not None:
            times.append(now)
            other.receive(message)
    assert len(times) == 1
    assert times[0] == pytest.approx(55.5 + MapSharingConfig().quiet, abs=1.5 * TICK)
    assert np.nanmax(np.abs(other.received.heights - heights)) < STEP + 1e-9


def test_an_obstacle_that_appears_or_goes_is_sent_without_waiting():
    model = map_of(np.zeros(GRID.shape), np.arange(80) < 16)
    end, other = MapSharing(model, 1), MapSharing(ElevationMap(GRID), 2)
    end.take(np.flatnonzero(model.known))
    sent_in(end, other, 0.0, 40.0)
    for now, height in ((40.0, 0.1), (50.0, 0.0)):
        model.heights[20, 5] = height
        end.take(np.array([20 * 80 + 5]))
        assert sent_in(end, other, now, now + 0.5) > 0
        assert other.received.heights[20, 5] == pytest.approx(height)


def test_where_no_receipts_come_little_is_sent_and_later_all_arrives():
    maps, ends, channels = two_robots(np.random.default_rng(8))
    deaf = [Channel(np.random.default_rng(0), loss=1.0) for _ in ends]
    exchange(ends, deaf, 60.0)
    assert all(end.bytes_sent < 6000 for end in ends)
    assert not any(end.received.known.any() for end in ends)
    exchange(ends, channels, 200.0, 60.0)
    for end, other in zip(ends, maps[::-1]):
        np.testing.assert_array_equal(end.received.known, other.known)


@given(st.integers(0, 2**32), st.floats(0.0, 0.9), st.floats(0.0, 5.0), st.floats(0.0, 0.5))
@settings(max_examples=15, deadline=None)
def test_no_loss_or_order_ever_makes_a_height_that_was_not_sent(seed, loss, jitter, repeats):
    """A map that changes: each height received is one that the cell had, and never goes back."""
    rng = np.random.default_rng(seed)
    grid = ElevationGrid((0.0, 0.0), (24, 40))
    model = map_of(np.zeros(grid.shape), grid=grid)
    end, other = MapSharing(model, 1), MapSharing(ElevationMap(grid), 2)
    channels = [Channel(rng, loss, jitter, repeats) for _ in range(2)]
    newest = np.full(grid.shape, -1)
    for epoch in range(5):
        # The height says when it was so.
        model.heights[...] = 0.1 * epoch + 0.005 * rng.integers(0, 8, grid.shape)
        end.take(np.arange(grid.size))

        def watch():
            heights = other.received.heights
            known = np.isfinite(heights)
            epochs = np.floor(heights[known] / 0.1 + 1e-6).astype(int)
            assert np.all(epochs <= epoch)  # noqa: B023
            assert np.all(epochs >= newest[known])
            if (now := epochs == epoch).any():  # noqa: B023
                np.testing.assert_allclose(
                    heights[known][now], model.heights[known][now], atol=1e-9
                )
            newest[known] = epochs

        exchange([end, other], channels, 12.0 * (epoch + 1), 12.0 * epoch, watch)


def fragments(delta, number, robot=2):
    """A delta's messages, cut by hand."""
    message = encode_delta(delta)
    pieces = [message[at : at + 60] for at in range(0, len(message), 60)]
    return [
        bytes([0x17, robot, number, index << 4 | len(pieces) - 1]) + piece
        for index, piece in enumerate(pieces)
    ]


def test_an_older_delta_that_comes_late_only_adds_what_no_newer_one_has():
    end = MapSharing(ElevationMap(GRID), 1)
    newer = TileDelta(2, 7, 1, np.arange(10), np.full(10, 0.2), 0.001)
    older = TileDelta(2, 7, 0, np.arange(5, 15), np.full(10, 0.1), 0.001)
    first = 16 * 80 + 2 * 16  # Tile 7 is the third of the second row.
    for delta, number, cells in ((newer, 1, range(10)), (older, 0, range(10, 15)), (newer, 1, [])):
        (message,) = fragments(delta, number)
        assert end.receive(message).tolist() == [first + cell for cell in cells]
    found = end.received.heights[16, 32:47]
    np.testing.assert_allclose(found, np.repeat([0.2, 0.1], [10, 5]))
    # Revisions are told apart over the end of their byte, too.
    for revision, height, found in ((200, 0.3, 0.3), (10, 0.4, 0.4), (250, 0.5, 0.4)):
        delta = TileDelta(2, 8, revision, np.arange(1), np.array([height]), 0.001)
        end.receive(fragments(delta, revision % 7 + 2)[0])
        assert end.received.heights[16, 48] == pytest.approx(found)


def test_fragments_of_a_delta_come_in_any_order_and_of_others_between():
    rng = np.random.default_rng(13)
    end = MapSharing(ElevationMap(GRID), 1)
    deltas = [
        TileDelta(2, tile, 0, np.arange(256), rng.uniform(-1.0, 1.0, 256), 0.001)
        for tile in range(3)
    ]
    parts = [part for number, delta in enumerate(deltas) for part in fragments(delta, number)]
    assert len(parts) > 15
    changed = np.concatenate([end.receive(parts[i]) for i in rng.permutation(len(parts))])
    assert len(changed) == len(set(changed.tolist())) == 3 * 256
    for tile, delta in enumerate(deltas):
        found = end.received.heights[:16, 16 * tile : 16 * tile + 16]
        assert np.abs(found.ravel() - delta.heights).max() <= 0.5 * STEP + 1e-9


def test_fragments_that_do_not_fit_together_are_no_delta():
    delta = TileDelta(2, 7, 0, np.arange(256), np.random.default_rng(0).uniform(0, 1, 256), 0.001)
    parts = fragments(delta, 0)
    end = MapSharing(ElevationMap(GRID), 1)
    end.receive(parts[2])
    assert len(end.receive(parts[0][:3] + b"\x01" + parts[0][4:])) == 0
    assert not end.received.known.any()


def test_what_a_receipt_misses_is_sent_again_without_waiting_for_patience():
    (model, _), (end, _), _ = two_robots(
        np.random.default_rng(14), MapSharingConfig(patience=1000.0)
    )
    other, count = MapSharing(ElevationMap(GRID), 2), 0
    for now in np.arange(0.0, 30.0, TICK):
        message = end.next_message(now)
        if message is not None and message[0] == FRAGMENT:
            count += 1
            if count != 3:
                other.receive(message)
        if (receipt := other.next_message(now)) is not None:
            end.receive(receipt)
    np.testing.assert_array_equal(other.received.known, model.known)
    assert other.tiles_dropped == 1


def test_cells_that_a_newer_delta_has_are_not_sent_again_for_a_lost_one():
    model = map_of(np.zeros(GRID.shape), np.arange(80) < 16)
    model.heights[16:], model.variances[16:] = np.nan, np.nan
    end, other = MapSharing(model, 1), MapSharing(ElevationMap(GRID), 2)
    for begin, height, arrives in ((0.0, 0.0, False), (4.0, 0.05, True)):
        model.heights[:16, :16] = height
        end.take(np.arange(16 * 80))
        for now in np.arange(begin, begin + 1.9, TICK):
            message = end.next_message(now)
            if message is not None and arrives:
                other.receive(message)
            if (receipt := other.next_message(now)) is not None:
                end.receive(receipt)
    np.testing.assert_array_equal(other.received.heights[:16, :16], 0.05)
    assert sent_in(end, other, 5.9, 60.0) == 0


def test_a_number_that_is_damaged_stops_nothing():
    maps, ends, channels = two_robots(np.random.default_rng(15))
    exchange(ends, channels, 2.0)
    ends[1].receive(bytes([FRAGMENT, 1, 130, 0x01]) + b"damaged")
    exchange(ends, channels, 60.0, 2.0)
    np.testing.assert_array_equal(ends[1].received.known, maps[0].known)
    assert ends[0].bytes_sent < 3000


def test_a_receipt_for_another_robot_or_a_damaged_one_confirms_nothing():
    (model, _), (end, _), _ = two_robots(np.random.default_rng(16))
    other = MapSharing(ElevationMap(GRID), 2)
    for now in np.arange(0.0, 6.0, TICK):
        end.next_message(now)
        content = struct.pack(">BBBI", RECEIPT, 5, 11, 0xFFFFFFFF)
        end.receive(content + struct.pack(">H", fastcrc.crc16.genibus(content)))
        content = struct.pack(">BBBI", RECEIPT, 1, 11, 0xFFFFFFFF)
        end.receive(content + struct.pack(">H", 1 ^ fastcrc.crc16.genibus(content)))
    sent_in(end, other, 6.0, 60.0)
    np.testing.assert_array_equal(other.received.known, model.known)


def test_a_map_of_other_cells_is_refused():
    heights = field(np.random.default_rng(9))
    model = map_of(heights)
    end = MapSharing(model, 1)
    small = MapSharing(ElevationMap(ElevationGrid((0.0, 0.0), (20, 20))), 2)
    end.take(np.arange(GRID.size))
    for now in np.arange(0.0, 30.0, TICK):
        message = end.next_message(now)
        if message is not None:
            for cell in small.receive(message):
                assert cell < 400
    assert small.tiles_dropped > 5


def test_strange_messages_are_named_or_ignored():
    end = MapSharing(map_of(field(np.random.default_rng(10))), 1)
    for strange in (b"", b"\x11abc", b"\x14"):
        with pytest.raises(RadioError, match="expected 0x17 or 0x18"):
            end.receive(strange)
    rng = np.random.default_rng(11)
    for _ in range(3000):
        kind = FRAGMENT if rng.uniform() < 0.7 else RECEIPT
        assert len(end.receive(bytes([kind]) + rng.bytes(int(rng.integers(0, 63))))) == 0
    assert not end.received.known.any()


def test_its_own_messages_are_not_the_other_s():
    model = map_of(field(np.random.default_rng(12)))
    end = MapSharing(model, 1)
    end.take(np.arange(GRID.size))
    for now in np.arange(0.0, 20.0, TICK):
        message = end.next_message(now)
        if message is not None:
            end.receive(message)
    assert not end.received.known.any()


def test_impossible_settings_are_named():
    with pytest.raises(ValueError, match="map sharing quiet = 0"):
        MapSharingConfig(quiet=0.0)
    with pytest.raises(ValueError, match="unreceipted = 40: expected up to 28"):
        MapSharingConfig(unreceipted=40)


def test_received_heights_complete_a_map_by_the_tilt_and_height_in_which_both_differ():
    own, received = ElevationMap(GRID), ElevationMap(GRID)
    shape = GRID.shape
    truth = np.random.default_rng(1).normal(0.0, 0.02, shape)
    half = shape[1] // 2
    own.heights[:, : half + 8], own.variances[:, : half + 8] = truth[:, : half + 8], 1e-5
    x, y = np.moveaxis(GRID.centres, -1, 0)
    tilted = truth - 0.06 + 0.02 * x - 0.03 * y
    received.heights[:, half - 8 :] = tilted[:, half - 8 :]
    received.variances[:, half - 8 :] = 4e-5
    whole = completed(own, received)
    np.testing.assert_array_equal(whole[:, : half + 8], truth[:, : half + 8])
    np.testing.assert_allclose(whole[:, half + 8 :], truth[:, half + 8 :], atol=0.003)
    assert not own.known[:, half + 8 :].any()
    # Without a cell in common: as received.
    alone = ElevationMap(GRID)
    alone.heights[0, 0], alone.variances[0, 0] = 5.0, 1e-5
    assert completed(alone, received)[0, -1] == received.heights[0, -1]
