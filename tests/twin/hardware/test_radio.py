"""The radio: what a byte error can do to either link, and what it cannot."""

import contextlib
import math
import time
import tracemalloc
from collections import deque

import fastcrc
import numpy as np
import pytest
from cobs import cobs
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.hardware.emulator.modem import Line, ModemConfig, PtyModems, VirtualModems
from twin.hardware.link import LinkError, SerialLink
from twin.hardware.radio import FramedConfig, FramedLink, Outcome, RadioError
from twin.hardware.radio_channel import SerialChannel
from twin.hardware.radio_frames import Frame, FrameParser, encode_frame
from twin.hardware.radio_handshake import (
    ACKNOWLEDGE,
    END_OF_BYTE,
    END_OF_DATA,
    RECEIVED_OK,
    TRANSMIT,
    HandshakeConfig,
    HandshakeLink,
)
from twin.hardware.radio_messages import (
    MapDelta,
    PoseMessage,
    WrenchMessage,
    pack_map_change,
    unpack,
)

pytestmark = pytest.mark.virtual_time

FRAMES = st.builds(
    Frame,
    st.integers(0, 15),
    st.integers(0, 15),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFF),
    st.binary(min_size=1, max_size=64),
)
TIMES = st.floats(-1e3, 1e6)
ANGLES = st.floats(-100.0, 100.0)


def vector(most):
    return st.tuples(*[st.floats(-most, most)] * 3)


class Wire:
    """A channel whose bytes the test carries by hand."""

    def __init__(self):
        self.time = 0.0
        self.out = deque()
        self.into = b""

    def now(self):
        return self.time

    def write(self, data):
        self.out.append(bytes(data))

    def read(self):
        data, self.into = self.into, b""
        return data


def framed(seed=0, **numbers):
    """A link on a wire carried by hand, with a line that is never busy."""
    wire = Wire()
    config = FramedConfig(**{"baud": 10**9, **numbers})
    return FramedLink(wire, np.random.default_rng(seed), config), wire


def carry(source, target):
    """Carry everything that was written."""
    target.into += b"".join(source.out)
    source.out.clear()


def decode(data):
    return FrameParser(64).feed(data)


def pump(modems, links, until, each=None):
    """Run both links in virtual time; return what each end was given."""
    messages, outcomes = ([], []), ([], [])
    while modems.time < until:
        for index, link in enumerate(links):
            polled = link.poll()
            messages[index].extend(polled.messages)
            outcomes[index].extend(polled.outcomes)
        if each is not None:
            each()
        event = min(modems.next_arrival(), *(link.next_event() for link in links))
        modems.time = min(max(modems.time, event), until)
    return messages, outcomes


# Messages


@given(
    st.integers(0, 255), TIMES, vector(32.7), st.tuples(ANGLES, ANGLES, ANGLES), st.floats(0, 65.5)
)
def test_pose_comes_back_within_half_a_step_in_20_bytes(robot, stamp, place, attitude, deviation):
    data = PoseMessage(robot, stamp, place, attitude, deviation).pack()
    back = unpack(data)
    assert len(data) == 20 and isinstance(back, PoseMessage)
    assert back.robot == robot
    assert [back.time, *back.position, back.deviation] == pytest.approx(
        [stamp, *place, deviation], abs=0.51e-3
    )
    for sent, got in zip(attitude, back.attitude):
        assert abs(math.remainder(sent - got, math.tau)) < 0.51 * math.pi / 2**15


@given(st.integers(0, 255), TIMES, vector(327.0), vector(32.7))
def test_wrench_comes_back_within_half_a_step(robot, stamp, force, moment):
    back = unpack(WrenchMessage(robot, stamp, force, moment).pack())
    assert isinstance(back, WrenchMessage)
    assert back.force == pytest.approx(force, abs=0.51e-2)
    assert [back.time, *back.moment] == pytest.approx([stamp, *moment], abs=0.51e-3)


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 255)), max_size=100))
def test_map_change_comes_back_whole_and_says_how_much_is_left(pairs):
    voxels, occupancies = [p[0] for p in pairs], [p[1] for p in pairs]
    messages = list(pack_map_change(2, 7, voxels, occupancies))
    parts = [unpack(message) for message in messages]
    assert all(len(message) <= 64 for message in messages)
    assert all(isinstance(part, MapDelta) and part.revision == 7 for part in parts)
    assert [int(v) for part in parts for v in part.voxels] == voxels
    assert [int(v) for part in parts for v in part.occupancies] == occupancies
    assert not parts or parts[-1].remaining == 0
    assert [part.remaining for part in parts] == [
        len(pairs) - sum(p.voxels.size for p in parts[: i + 1]) for i in range(len(parts))
    ]


def test_message_that_cannot_be_told_is_refused():
    good = PoseMessage(1, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    with pytest.raises(RadioError, match="position nan is not finite"):
        PoseMessage(1, 0.0, (math.nan, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="attitude inf is not finite"):
        PoseMessage(1, 0.0, good.position, (0.0, math.inf, 0.0), 0.0).pack()
    with pytest.raises(RadioError, match="position 40.0 is not within"):
        PoseMessage(1, 0.0, (40.0, 0.0, 0.0), good.attitude, 0.0).pack()
    with pytest.raises(RadioError, match="3 voxels with 2 occupancies"):
        pack_map_change(1, 0, [1, 2, 3], [1, 2])
    for wrong in ([256], [-1], [0.5]):
        with pytest.raises(RadioError, match="occupancy is no integer within 0 to 255"):
            pack_map_change(1, 0, [1], wrong)
    with pytest.raises(RadioError, match="type 0x21 is unknown; known: 0x11, 0x12, 0x13"):
        unpack(b"\x21" + good.pack()[1:])
    for wrong in (good.pack()[:-1], good.pack() + b"\0", b"\x13\x01\0\0\0\0", b"\x13"):
        with pytest.raises(RadioError, match="wrong length"):
            unpack(wrong)
    with pytest.raises(RadioError, match="empty"):
        unpack(b"")


# Frames


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
        got, told = iter(sent[own]), dict(outcomes[own])
        assert all(message in got for message in messages[1 - own])  # in this order, each once
        assert sorted(told) == tickets[own] and len(outcomes[own]) == 6
        arrived = set(messages[1 - own])
        assert all(sent[own][i] in arrived for i, t in enumerate(tickets[own]) if told[t])
    if rate == 1e-3:
        assert [len(each) for each in messages] == [6, 6]


# The framed link


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
    assert second.statistics.duplicates == 1
    carry(back, there)
    assert first.poll().outcomes == [Outcome(ticket, True)]
    assert first.statistics.retransmissions == 1


def test_repeated_bytes_of_the_line_deliver_nothing_twice():
    (first, there), (second, back) = framed(1), framed(2)
    first.send(b"message")
    first.send_latest(b"value")
    first.poll()
    line = b"".join(there.out)
    back.into = line + line
    assert sorted(second.poll().messages) == [b"message", b"value"]
    assert second.statistics.duplicates == 2


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


def test_restarted_receiver_goes_on_from_the_oldest_on_the_way():
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


def test_what_cannot_be_delivered_is_said_and_the_link_recovers():
    (first, there), (second, back) = framed(1, deliver_within=1.0), framed(2)
    tickets = [first.send(bytes([index])) for index in range(12)]
    told = []
    for step in range(12):  # nothing is carried
        there.time = 0.1 * step
        told += first.poll().outcomes
    assert told == [Outcome(ticket, False) for ticket in tickets]
    assert (first.pending, first.statistics.resets) == (0, 1)
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
    assert first.statistics.superseded > 400 and first.statistics.latest_missed == 0


def test_link_polled_at_100_hz_keeps_the_line_busy():
    modems = VirtualModems(ModemConfig(), np.random.default_rng(0))
    first, second = (FramedLink(e, np.random.default_rng(i)) for i, e in enumerate(modems.ends))
    for tick in range(300):
        modems.time = tick * 0.01
        while first.pending < 16:
            first.send(bytes(20))
        first.poll()
        second.poll()
    assert modems.lines[0].carried > 0.97 * 3.0 * 960.0
    assert modems.lines[0].overflow == 0


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
    for numbers in ({"error_rate": 2.0}, {"delay": -1.0}, {"buffer": 0}):
        with pytest.raises(ValueError, match=next(iter(numbers))):
            ModemConfig(**numbers)


# Noise


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


# The thesis' handshake


def shake(message, spoil=None):
    """Carry a message byte by byte; `spoil(count, byte)` returns what becomes of each."""
    there, back = Wire(), Wire()
    config = HandshakeConfig(send_within=1.0, receive_within=0.9)
    first, second = HandshakeLink(there, config), HandshakeLink(back, config)
    first.send(message)
    got, told, count = [], [], 0
    for _ in range(200):
        for source, target, link in ((there, back, second), (back, there, first)):
            for byte in b"".join(source.out):
                data = bytes([byte])
                target.into += data if spoil is None else spoil(count, data)
                count += 1
            source.out.clear()
            polled = link.poll()
            got, told = got + polled.messages, told + polled.outcomes
        there.time = back.time = there.time + 0.01
    return got, told, second


@given(st.binary(min_size=1, max_size=40))
def test_handshake_carries_any_bytes_over_a_clean_line(message):
    got, told, _ = shake(message)
    assert got == [message]
    assert told == [Outcome(1, True)]


def test_handshake_sends_what_the_thesis_says():
    wire = Wire()
    link = HandshakeLink(wire)
    link.send(b"ab")
    for answer in (ACKNOWLEDGE, RECEIVED_OK):
        wire.into = bytes([answer])
        link.poll()
    expected = [[TRANSMIT], [ord("a"), END_OF_BYTE], [ord("b"), END_OF_DATA]]
    assert list(wire.out) == [bytes(each) for each in expected]


def test_handshake_delivers_a_changed_byte_and_calls_it_sent():
    got, told, _ = shake(b"\x10\x20\x30", lambda n, b: b"\x21" if b == b"\x20" else b)
    assert got == [b"\x10\x21\x30"]
    assert told == [Outcome(1, True)]


def test_handshake_takes_data_for_a_command_after_a_lost_byte():
    """No escaping: without its first byte the command is data, and data ends the message."""
    message = bytes([0x10, END_OF_DATA, 0x30])
    lost = [False]

    def lose_first(count, byte):
        if byte == b"\x10" and not lost[0]:
            lost[0] = True
            return b""
        # Noise in place of the received-ok that will not come.
        return byte + (bytes([END_OF_DATA]) if lost[0] and byte[0] == END_OF_BYTE else b"")

    got, _, _ = shake(message, lose_first)
    assert got == [bytes([END_OF_BYTE])]


def test_handshake_stalls_on_a_lost_received_ok_until_its_deadline():
    got, told, second = shake(b"abc", lambda n, b: b"" if b[0] == RECEIVED_OK else b)
    assert got == []
    assert told == [Outcome(1, False)]
    assert second.receive_failures == 1 and not second.receiving


def test_handshake_calls_a_message_sent_whose_end_was_lost():
    got, told, second = shake(b"abc", lambda n, b: b"" if b[0] == END_OF_DATA else b)
    assert got == []
    assert told == [Outcome(1, True)]
    assert second.receive_failures == 1


def test_handshake_stalls_when_both_begin_at_once():
    modems = VirtualModems(ModemConfig(), np.random.default_rng(0))
    links = [HandshakeLink(end) for end in modems.ends]
    for link in links:
        link.send(b"after you")
    messages, outcomes = pump(modems, links, 1.5)
    assert messages == ([], [])
    assert outcomes == ([Outcome(1, False)], [Outcome(1, False)])


def test_handshake_refuses_what_it_cannot_do():
    wire = Wire()
    link = HandshakeLink(wire, HandshakeConfig(message_limit=4))
    with pytest.raises(RadioError, match="of 5 bytes: 1 to 4"):
        link.send(bytes(5))
    link.send(b"a")
    with pytest.raises(RadioError, match="it sends a message"):
        link.send(b"b")
    other = HandshakeLink(wire)
    wire.into = bytes([TRANSMIT])
    other.poll()
    with pytest.raises(RadioError, match="it receives a message"):
        other.send(b"b")


# Modems


def test_modem_paces_delays_and_hits_as_it_is_told():
    line = Line(ModemConfig(delay=0.01), np.random.default_rng(0))
    line.put(bytes(96), 1.0)
    assert line.next_arrival() == pytest.approx(1.0 + 1 / 960 + 0.01)
    assert len(line.take(1.06)) == 48
    assert len(line.take(1.1101)) == 48
    line.put(bytes(2000), 2.0)
    assert line.overflow == 2000 - 1024
    for kinds, expected in (((1, 0, 0), 1.0), ((0, 1, 0), 0.99), ((0, 0, 1), 1.01)):
        flip, loss, insertion = kinds
        config = ModemConfig(
            error_rate=0.01, flip=flip, loss=loss, insertion=insertion, buffer=10**6
        )
        line = Line(config, np.random.default_rng(1))
        line.put(bytes(100_000), 0.0)
        assert line.hits == pytest.approx(1000, abs=120)
        assert len(line.take(math.inf)) == pytest.approx(expected * 1e5, abs=150)


def exchange(links, now, wait, messages):
    """Send messages one after another; return what arrived, what was told and how long it took."""
    begin, got, told = now(), [], []
    for message in messages:
        links[0].send(message)
        done = False
        while not done:
            polled = links[0].poll()
            told += [outcome.confirmed for outcome in polled.outcomes]
            got += links[1].poll().messages
            done = bool(polled.outcomes)
            if not done:
                wait()
    end = now()
    for _ in range(20):
        wait()
        got += links[1].poll().messages
    return got, told, end - begin


def make_links(kind, ends):
    if kind == "framed":
        return [FramedLink(end, np.random.default_rng(i)) for i, end in enumerate(ends)]
    config = HandshakeConfig(send_within=0.4, receive_within=0.35)
    return [HandshakeLink(end, config) for end in ends]


def exchange_over_ports(kind, config, seed, messages):
    with PtyModems(config, np.random.default_rng(seed)) as modems:
        ports = [SerialLink(port, 9600) for port in modems.ports]
        links = make_links(kind, [SerialChannel(port) for port in ports])
        result = exchange(links, time.monotonic, lambda: time.sleep(0.001), messages)
        for port in ports:
            port.close()
    return result


@pytest.mark.real_time
@pytest.mark.parametrize("kind", ["handshake", "framed"])
def test_real_ports_at_the_real_pace_agree_with_virtual_time(kind):
    rng = np.random.default_rng(3)
    messages = [rng.bytes(8) for _ in range(6)]
    config, seed = ModemConfig(error_rate=0.01, delay=0.002), 5
    modems = VirtualModems(config, np.random.default_rng(seed))

    def advance():
        modems.time += 0.001

    virtual = exchange(make_links(kind, modems.ends), lambda: modems.time, advance, messages)
    assert virtual[2] > 0.1
    for _ in range(3):  # Another process may hold this one up: once of three times must agree.
        measured = exchange_over_ports(kind, config, seed, messages)
        if measured[:2] == virtual[:2] and measured[2] == pytest.approx(virtual[2], rel=0.3):
            return
    assert measured == (*virtual[:2], pytest.approx(virtual[2], rel=0.3))


@pytest.mark.real_time
def test_port_that_is_gone_is_one_clear_error():
    modems = PtyModems(ModemConfig(), np.random.default_rng(0))
    port = SerialLink(modems.ports[0], 9600)
    link = FramedLink(SerialChannel(port), np.random.default_rng(0))
    modems.close()
    with pytest.raises(LinkError, match=modems.ports[0]):
        for _ in range(3):
            link.send_latest(b"x")
            link.poll()
    port.close()
