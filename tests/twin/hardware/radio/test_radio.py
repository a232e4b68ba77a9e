"""The framed link: in order, once, or said to be unconfirmed, whatever befalls the bytes."""

import contextlib
import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.mapping.messages import PoseMessage, unpack
from tests.twin.hardware.radio.wire import Wire, carry, framed, pump
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.framed_radio import FramedConfig, FramedLink
from twin.hardware.radio.frames import Frame, FrameParser, encode_frame
from twin.hardware.radio.handshake import HandshakeConfig, HandshakeLink
from twin.link import Outcome, RadioError

pytestmark = pytest.mark.virtual_time


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]),
    st.sampled_from([1e-3, 1e-2, 3e-2, 0.1, 0.5]),
)
def test_no_message_is_wrong_twice_or_out_of_order_under_any_error(seed, kinds, rate):
    rng = np.random.default_rng(seed)
    flip, loss, insertion = kinds
    config = ModemConfig(error_rate=rate, flip=flip, loss=loss, insertion=insertion)
    modems = VirtualModems(config, rng)
    links = [FramedLink(end, rng, FramedConfig(deliver_within=2.5)) for end in modems.ends]
    sent = [[rng.bytes(int(rng.integers(1, 65))) for _ in range(6)] for _ in links]
    tickets = [[link.send(message) for message in own] for link, own in zip(links, sent)]
    messages, outcomes = pump(modems, links, 3.0)
    for own in range(2):
        got, confirmed = iter(sent[own]), dict(outcomes[own])
        assert all(message in got for message in messages[1 - own])  # in this order, each once
        assert sorted(confirmed) == tickets[own] and len(outcomes[own]) == 6
        arrived = set(messages[1 - own])
        assert all(sent[own][i] in arrived for i, t in enumerate(tickets[own]) if confirmed[t])
    if rate == 1e-3:
        assert [len(each) for each in messages] == [6, 6]


def test_lost_acknowledgement_does_not_deliver_twice():
    (first, there), (second, back) = framed(1), framed(2)
    ticket = first.send(b"once")
    first.poll()
    carry(there, back)
    assert second.poll().messages == [b"once"]
    back.out.clear()
    there.time = back.time = 0.2
    assert first.poll().outcomes == []
    carry(there, back)
    assert second.poll().messages == []
    carry(back, there)
    assert first.poll().outcomes == [Outcome(ticket, True)]


def test_repeated_bytes_of_the_line_deliver_nothing_twice():
    (first, there), (second, back) = framed(1), framed(2)
    first.send(b"message")
    first.send_latest(b"value")
    first.poll()
    line = b"".join(there.out)
    back.into = line + line
    assert sorted(second.poll().messages) == [b"message", b"value"]
    assert second.poll().messages == []


def test_restarted_sender_is_heard_though_its_numbers_begin_anew():
    second, back = framed(9)
    for start in range(3):
        first, there = framed(start)
        for index in range(3):
            first.send(bytes([start, index]))
        first.poll()
        carry(there, back)
        assert second.poll().messages == [bytes([start, index]) for index in range(3)]
        back.out.clear()


def test_acknowledgement_of_before_a_restart_confirms_nothing():
    (first, there), (second, back) = framed(1), framed(2)
    first.send(b"old")
    first.poll()
    carry(there, back)
    second.poll()
    restarted, wire = framed(3)
    restarted.send(b"new")
    restarted.poll()
    carry(back, wire)
    assert restarted.poll().outcomes == []
    assert restarted.pending == 1


def test_restarted_receiver_resumes_at_the_oldest_message_in_transit():
    (first, there), (second, back) = framed(1), framed(2)
    for index in range(5):
        first.send(bytes([index]))
    first.poll()
    lines = list(there.out)
    there.out.clear()
    back.into = b"".join([*lines[:2], *lines[3:]])  # the third is lost
    assert second.poll().messages == [b"\0", b"\1"]
    carry(back, there)
    assert [outcome.ticket for outcome in first.poll().outcomes] == [1, 2]
    there.out.clear()

    second, back = framed(5)  # It forgets what it held, and where it was.
    got = []
    for step in range(1, 5):
        there.time = back.time = 0.2 * step
        outcomes = first.poll().outcomes
        carry(there, back)
        got += second.poll().messages
        carry(back, there)
        assert all(outcome.confirmed for outcome in outcomes)
    assert got == [b"\2", b"\3", b"\4"]
    first.poll()
    assert first.pending == 0


def test_undelivered_messages_are_reported_and_the_link_recovers():
    (first, there), (second, back) = framed(1, deliver_within=1.0), framed(2)
    tickets = [first.send(bytes([index])) for index in range(12)]
    confirmed = []
    for step in range(12):  # nothing is carried
        there.time = 0.1 * step
        confirmed += first.poll().outcomes
    assert confirmed == [Outcome(ticket, False) for ticket in tickets]
    assert first.pending == 0
    there.out.clear()
    first.send(b"again")
    first.poll()
    carry(there, back)
    assert second.poll().messages == [b"again"]
    carry(back, there)
    assert first.poll().outcomes == [Outcome(13, True)]


def test_message_that_is_too_long_or_one_too_many_is_refused():
    link, _ = framed(queue_limit=3)
    for send in (link.send, link.send_latest):
        with pytest.raises(RadioError, match="of 65 bytes: 1 to 64 can be sent"):
            send(bytes(65))
        with pytest.raises(RadioError, match="of 0 bytes"):
            send(b"")
    for _ in range(3):
        link.send(b"x")
    with pytest.raises(RadioError, match="queue is full: 3 messages"):
        link.send(b"x")


def test_newer_value_replaces_the_one_that_waits_and_no_message_starves():
    modems = VirtualModems(ModemConfig(), np.random.default_rng(0))
    links = [FramedLink(end, np.random.default_rng(i)) for i, end in enumerate(modems.ends)]
    first, second = links
    sent = [bytes([0x13, index]) * 20 for index in range(20)]
    for message in sent:
        first.send(message)
    got = []
    for tick in range(300):  # far more values than the line can carry
        modems.time = tick * 0.01
        for kind in (0x11, 0x12):
            first.send_latest(bytes([kind]) + tick.to_bytes(2, "big") + bytes(17))
        first.poll()
        got += [(tick, message) for message in second.poll().messages]
    values = [(t, m[0], int.from_bytes(m[1:3], "big")) for t, m in got if m[0] != 0x13]
    assert [m for _, m in got if m[0] == 0x13] == sent
    assert {kind for _, kind, _ in values} == {0x11, 0x12}
    assert max(tick - number for tick, _, number in values) <= 15  # old ones are not queued
    assert len(values) < 200 and first.latest_missed == 0  # Of 600 values.


def test_link_polled_at_100_hz_keeps_the_line_busy():
    modems = VirtualModems(ModemConfig(), np.random.default_rng(0))
    first, second = (FramedLink(e, np.random.default_rng(i)) for i, e in enumerate(modems.ends))
    for tick in range(300):
        modems.time = tick * 0.01
        while first.pending < 16:
            first.send(bytes(20))
        first.poll()
        second.poll()
    assert first.bytes_sent > 0.97 * 3.0 * 960.0
    assert second._parser.rejected == 0  # No byte was lost in a full buffer.


def test_pose_four_times_a_second_takes_eight_percent_and_its_frame_twelve():
    assert 20 * 4 / 960 == pytest.approx(0.083, abs=1e-3)
    pose = PoseMessage(1, 12.345, (1.0, 2.0, 0.0), (0.0, 0.1, 1.0), 0.05).pack()
    assert len(encode_frame(Frame(2, 0, 1, 1, pose))) * 4 / 960 == pytest.approx(0.117, abs=1e-3)


def test_numbers_that_no_link_or_modem_can_have_are_refused():
    for numbers in ({"window": 9}, {"baud": 0}, {"deliver_within": math.nan}, {"message_limit": 0}):
        with pytest.raises(ValueError, match=next(iter(numbers))):
            FramedConfig(**numbers)
    with pytest.raises(ValueError, match="send_within"):
        HandshakeConfig(send_within=0.0)
    for numbers in ({"error_rate": 2.0}, {"packet_loss": 1.1}, {"delay": -1.0}, {"buffer": 0}):
        with pytest.raises(ValueError, match=next(iter(numbers))):
            ModemConfig(**numbers)


def test_a_million_random_bytes_harm_no_parser():
    rng = np.random.default_rng(0)
    noise = rng.bytes(10**6)
    wire, radio = Wire(), Wire()
    links = [(HandshakeLink(wire), wire), (FramedLink(radio, rng), radio)]
    parser = FrameParser(64)
    for begin in range(0, len(noise), 5000):
        if begin == 800_000:
            tracemalloc.start()  # What is kept of the last 200,000 bytes is seen.
        piece = noise[begin : begin + 5000]
        parser.feed(piece)
        for link, end in links:
            end.into, end.time = piece, end.time + 0.001
            link.poll()
            end.out.clear()
        for cut in range(0, 5000, 20):
            with contextlib.suppress(RadioError):
                unpack(piece[cut : cut + 20])
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 20_000 and peak < 150_000
    assert parser.rejected > 1000
