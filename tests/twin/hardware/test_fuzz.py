"""Random and damaged bytes into every parser: none raises, none keeps more than it must.

A million plainly random bytes into the parsers of Firmata, force/torque sensor and radio stand with
their own tests; here they get valid packets, damaged.
"""

import contextlib
import tracemalloc
from collections import Counter

import numpy as np
import pytest

from controllers.mapping.messages import PoseMessage, WrenchMessage, unpack
from tests.twin.hardware.roboclaw.wire import VirtualLink, boards_on_a_line, virtual_time
from twin.hardware.analogue import firmata_codec
from twin.hardware.emulator.firmata_board import FirmataBoard
from twin.hardware.emulator.net_ft import NetFT
from twin.hardware.force_torque import net_ft as force_torque
from twin.hardware.radio.framed_radio import FramedLink
from twin.hardware.radio.frames import Frame, FrameParser, encode_frame
from twin.hardware.radio.handshake import (
    ACKNOWLEDGE,
    END_OF_BYTE,
    END_OF_DATA,
    RECEIVED_OK,
    TRANSMIT,
    HandshakeLink,
)
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand
from twin.hardware.serial_link import LinkError
from twin.link import RadioError

pytestmark = pytest.mark.virtual_time

ADDRESSES = (0x80, 0x81, 0x82, 0x83)
LONGEST_PACKET = 4 + 33  # [bytes] Both positions.
KEPT = 20_000  # [bytes] By everything in a test, after it was fed.
PEAK = 200_000  # [bytes]


def noise(rng, total):
    """Yield so many random bytes in chunks of 1 to 256, half of them for a board that is there."""
    while total > 0:
        size = min(total, int(2 ** rng.uniform(0.0, 8.0)))
        total -= size
        chunk = rng.bytes(size)
        meant = rng.random() < 0.5
        yield bytes((ADDRESSES[chunk[0] % 4],)) + chunk[1:] if meant else chunk


def mutants(rng, packets, total):
    """Yield so many bytes of packets, most of them damaged in one of six ways."""
    while total > 0:
        packet = packets[int(rng.integers(len(packets)))]
        damaged = mutated(packet, packets, rng)
        total -= len(damaged) + 1
        yield damaged


def mutated(packet, packets, rng):
    place = int(rng.integers(len(packet) + 1))
    match int(rng.integers(7)):
        case 0:
            return flipped(packet, rng)
        case 1:
            return packet[:place]
        case 2:
            return packet[place:]
        case 3:
            return packet[:place] + rng.bytes(int(rng.integers(1, 40))) + packet[place:]
        case 4:
            return packet[:place] + packet[place + 1 :]
        case 5:
            other = packets[int(rng.integers(len(packets)))]
            return packet[:place] + other + packet[place:]
        case _:
            return packet


def flipped(packet, rng):
    """Flip one to eight bits; from four on, a checksum may not see it."""
    changed = bytearray(packet)
    for place in rng.integers(8 * len(packet), size=int(rng.integers(1, 9))).tolist():
        changed[place // 8] ^= 1 << (place % 8)
    return bytes(changed)


@contextlib.contextmanager
def little_memory():
    """Check what is kept, and the most that was held, within."""
    tracemalloc.start()
    try:
        yield
        kept, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < KEPT and peak < PEAK, (kept, peak)


def feed(take, chunks, remembered):
    """Feed chunks; watch the memory of the last ones only, which is slow."""
    chunks = list(chunks)
    for chunk in chunks[:-remembered]:
        take(chunk)
    with little_memory():
        for chunk in chunks[-remembered:]:
            take(chunk)


# RoboClaw


def roboclaw_packets(rng):
    packets = []
    for address in (*ADDRESSES, 0x87):
        for command, layout in codec.WRITES.items():
            bounds = {"B": (0, 255), "h": (-(2**15), 2**15 - 1), "i": (-(2**31), 2**31 - 1)}
            ranges = [bounds.get(letter, (0, 2**32 - 1)) for letter in layout[1:]]
            values = [int(rng.integers(low, high + 1)) for low, high in ranges]
            packets.append(codec.encode_write(address, command, *values))
        packets += [codec.encode_read(address, command) for command in codec.READS]
    return packets


class Bench:
    """Boards that are fed, and tick from time to time."""

    def __init__(self, rng):
        self.boards, self.line = boards_on_a_line(ADDRESSES)
        self.rng, self.now = rng, 0.0
        self.answers = self.writes = 0

    def take(self, chunk):
        self.now += float(self.rng.choice((0.0, 0.001, 0.02)))
        answer = self.line.feed(chunk, self.now)
        # A question of two bytes is answered by 30 at most, but for the status and the version.
        assert len(answer) <= 16 * (len(chunk) + LONGEST_PACKET)
        assert len(self.line._buffer) < LONGEST_PACKET
        self.answers += len(answer)
        for board in self.boards:
            self.writes += len(board.obeyed)
            board.obeyed.clear()
        if self.rng.random() < 0.02:
            for board in self.boards:
                board.motors.counts = self.rng.integers(-1000, 1000, 2).tolist()
            self.line.tick(self.now, 0.01)


def test_a_million_random_bytes_harm_no_motor_board():
    bench = Bench(np.random.default_rng(0))
    feed(bench.take, noise(bench.rng, 1_000_000), 2000)
    assert bench.answers > 3000  # A question may be sound by chance; no write is.
    assert not bench.writes


@pytest.mark.slow
def test_a_million_bytes_of_damaged_packets_harm_no_motor_board():
    bench = Bench(np.random.default_rng(1))
    feed(bench.take, mutants(bench.rng, roboclaw_packets(bench.rng), 1_000_000), 1000)
    assert bench.answers > 10_000 and bench.writes > 1000
    for board in bench.boards:
        assert all(abs(duty) <= codec.FULL_DUTY for duty in board.duties())


class NoisyAnswers:
    """Answers every request with noise; now and then soundly, so that a bus gets past its probe."""

    def __init__(self, rng, device):
        self.rng, self.device, self.said = rng, device, 0

    def feed(self, data, now):
        if not data:
            return b""
        sound = self.device.feed(data, now)
        if sound and self.rng.random() < 0.5:
            sound = flipped(sound, self.rng) if self.rng.random() < 0.5 else sound
            answer = sound + self.rng.bytes(int(self.rng.integers(3)))
        else:
            answer = self.rng.bytes(int(2 ** self.rng.uniform(0.0, 12.0)))
        self.said += len(answer)
        return answer


def roboclaw_calls(bus):
    return [
        *(lambda c=command: bus.read(0x80, c) for command in codec.READS),
        lambda: bus.status(0x80),
        lambda: bus.version(0x80),
        lambda: bus.write(0x80, BoardCommand.DUTY_BOTH, 1, 2),
    ]


def test_a_million_bytes_of_random_answers_harm_no_bus():
    rng = np.random.default_rng(2)
    _, line = boards_on_a_line()
    device = NoisyAnswers(rng, line)
    link = VirtualLink(device)
    bus = RoboClawBus(link)
    calls = roboclaw_calls(bus)
    with virtual_time(link):
        while device.said < 1_000_000:
            bus._suspect = False  # So that more than the probe's answer is parsed.
            with contextlib.suppress(LinkError):
                calls[int(rng.integers(len(calls)))]()
            assert len(link._heard) <= 3 * 4096
            link.sent.clear()
    statistics = bus.statistics
    assert statistics.refused > 100 and statistics.stray > 500_000
    assert statistics.transactions > statistics.failures > 0
    assert len(bus._status_length) <= 1


def test_a_million_random_bytes_are_refused_by_the_reply_parsers():
    rng = np.random.default_rng(3)
    parsers = [
        lambda reply: codec.checked(0x80, BoardCommand.GET_VERSION, reply),
        lambda reply: codec.decode_status_reply(0x80, reply),
        *(lambda r, c=command: codec.decode_reply(0x80, c, r) for command in codec.READS),
    ]
    asked = accepted = place = 0
    data = rng.bytes(1_000_000)
    while place < len(data):
        size = int(rng.integers(0, 25))
        reply, place = data[place : place + size], place + max(1, size)
        for _ in range(4):
            asked += 1
            accepted += parsers[asked % len(parsers)](reply) is not None
    # By chance one in 65536, where the length fits; that is what two bytes can do.
    assert accepted < 5 * asked / 65536


# Firmata


def firmata_messages(rng):
    values = rng.integers(0, 1024, 32).tolist()
    answers = [firmata_codec.analogue_message(n % 16, v) for n, v in enumerate(values)]
    kinds = (
        firmata_codec.REPORT_FIRMWARE,
        firmata_codec.CAPABILITY_QUERY,
        firmata_codec.ANALOGUE_MAPPING_QUERY,
        firmata_codec.SAMPLING_INTERVAL,
        firmata_codec.PIN_STATE_QUERY,
    )
    exclusive = [
        firmata_codec.sysex(kind, rng.integers(0, 128, size).tolist())
        for kind in kinds
        for size in (0, 1, 2, 30)
    ]
    reports = [firmata_codec.report_analogue(pin, bool(pin % 2)) for pin in range(16)]
    short = [bytes((firmata_codec.SYSTEM_RESET,)), bytes((firmata_codec.REPORT_VERSION,))]
    return answers + exclusive + reports + short


def test_damaged_firmata_messages_harm_neither_end():
    rng = np.random.default_rng(4)
    parser, board = firmata_codec.Parser(), FirmataBoard(lambda pin: 5)
    tally = Counter()

    def take(chunk):
        tally["chunks"] += 1
        tally["messages"] += len(parser.feed(chunk))
        board.feed(chunk, 0.001 * tally["chunks"])
        assert len(parser._data) <= 64 and len(board._data) <= 64

    feed(take, mutants(rng, firmata_messages(rng), 300_000), 500)
    assert tally["messages"] > 1000


# Force/torque sensor


def test_damaged_records_and_requests_harm_neither_end():
    rng = np.random.default_rng(5)
    sensor = NetFT(lambda: (1, -2, 3, -4, 5, -6))
    records = [
        force_torque.encode_record(
            force_torque.Record(n, 7 * n, 0, tuple(rng.integers(-9, 9, 6).tolist()))
        )
        for n in range(20)
    ]
    requests = [
        force_torque.encode_request(command, samples)
        for command in (0, 2, 3, 0x41, 0x42)
        for samples in (0, 1, 2**32 - 1)
    ]
    tally = Counter()

    def take(chunk):
        tally["chunks"] += 1
        tally["records"] += force_torque.decode_record(chunk) is not None
        sent = sensor.answer(chunk, "host", 0.0001 * tally["chunks"])
        assert sum(map(len, sent)) <= 100 * 36  # Records of 36 bytes.

    feed(take, mutants(rng, records + requests, 300_000), 500)
    assert 1000 < tally["records"] < tally["chunks"]


# Radio


class Channel:
    """A line that delivers given bytes, and accepts what is sent."""

    def __init__(self):
        self.into, self.time, self.sent = b"", 0.0, 0

    def now(self):
        return self.time

    def write(self, data):
        self.sent += len(data)

    def read(self):
        data, self.into = self.into, b""
        return data


def radio_messages():
    return [
        PoseMessage(1, 12.5, (1.0, 2.0, 0.0), (0.0, 0.1, 1.0), 0.05).pack(),
        WrenchMessage(2, 0.5, (1.0, -2.0, 3.0), (0.1, 0.2, -0.3)).pack(),
    ]


def test_damaged_radio_frames_are_bounded_and_raise_nothing():
    rng = np.random.default_rng(6)
    frames = [
        encode_frame(Frame(kind, age, session, sequence, body))
        for kind in range(5)
        for age, session, sequence in ((0, 1, 0), (3, 1, 2), (15, 9, 255))
        for body in (b"\x05", *radio_messages())
    ]
    channel, parser = Channel(), FrameParser(64)
    link = FramedLink(channel, rng)
    tally = Counter()

    def take(chunk):
        tally["frames"] += len(parser.feed(chunk))
        channel.into, channel.time = chunk, channel.time + 0.01
        link.poll()
        assert len(parser._buffer) <= 72
        assert len(link._held) <= 8 and link.pending == 0

    feed(take, mutants(rng, frames, 300_000), 500)
    assert tally["frames"] > 500 and parser.rejected > 500 and channel.sent > 0


def test_damaged_radio_messages_are_refused_by_name():
    rng = np.random.default_rng(7)
    read = refused = 0
    for message in mutants(rng, radio_messages(), 300_000):
        try:
            unpack(message)
            read += 1
        except RadioError:
            refused += 1
    assert read > 500 and refused > 500


@pytest.mark.parametrize("sending", [False, True])
def test_damaged_handshakes_are_bounded_and_raise_nothing(sending):
    rng = np.random.default_rng(8)
    text = b"".join(bytes((byte, END_OF_BYTE)) for byte in b"a message")
    packets = [
        bytes((TRANSMIT,)) + text + bytes((0x55, END_OF_DATA)),
        bytes((ACKNOWLEDGE,)) + bytes((RECEIVED_OK,)) * 9,
        bytes((TRANSMIT,)) + text * 30,
    ]
    channel = Channel()
    link = HandshakeLink(channel)
    tally = Counter()

    def take(chunk):
        channel.into, channel.time = chunk, channel.time + 0.05
        if sending and not link.pending and link._received is None:
            link.send(b"ten bytes.")
        result = link.poll()
        tally["messages"] += len(result.messages)
        tally["confirmed"] += sum(outcome.confirmed for outcome in result.outcomes)
        assert len(link._received or b"") <= 1024 and link.pending <= 1

    feed(take, mutants(rng, packets, 100_000), 200)
    assert tally["confirmed" if sending else "messages"] > 20
