"""The emulated RoboClaw boards, their line and its faults."""

import math

import numpy as np
import pytest

from tests.twin.hardware.roboclaw.wire import (
    StillMotors,
    boards_on_a_line,
)
from twin.hardware.emulator.faults import FaultyLine, LineFault, LineFaultConfig
from twin.hardware.emulator.roboclaw_board import VERSION, RoboClawBoard, RoboClawLine
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, Status

pytestmark = pytest.mark.virtual_time


def exchange(line, request, now=0.0):
    return line.feed(bytes.fromhex(request), now)


def test_board_does_not_answer_what_is_damaged_unknown_or_anothers():
    (board,), line = boards_on_a_line()
    assert exchange(line, "80 0f") == bytes.fromhex("00 2b 64")
    assert exchange(line, "80 22 7f ff 80 01 ca 57") == b""
    assert exchange(line, "80 63") == exchange(line, "80 ff") == b""
    assert exchange(line, "81 0f") == exchange(line, "00 0f") == b""
    assert not board.obeyed
    assert exchange(line, "80 22 7f ff 80 01 ca 56") == b"\xff"
    assert board.duties() == (32767, -32767)


@pytest.mark.parametrize(("gap", "answer"), [(0.0099, b"\xff"), (0.0101, b"")])
def test_board_drops_half_a_packet_after_ten_milliseconds(gap, answer):
    (board,), line = boards_on_a_line()
    assert exchange(line, "80 22 7f ff", 1.0) == b""
    line.feed(b"", 1.0 + gap / 2)  # Nothing heard is no byte.
    assert exchange(line, "80 01 ca 56", 1.0 + gap) == answer
    assert exchange(line, "80 0f", 2.0) == bytes.fromhex("00 2b 64")
    assert len(board.obeyed) == len(answer)


def test_bytes_one_by_one_and_packets_together_are_answered_alike():
    _, line = boards_on_a_line((0x80, 0x81))
    request = bytes.fromhex("80 22 7f ff 80 01 ca 56 81 0f 80 30")
    together = line.feed(request, 0.0)
    assert together == b"".join(line.feed(request[n : n + 1], 0.0) for n in range(len(request)))
    assert together[0] == 0xFF and together[4:] == bytes.fromhex("7f ff 80 01 8a 8f")


def test_watchdog_stops_the_motors_and_only_then():
    (board,), line = boards_on_a_line()
    line.tick(0.0, 0.01)
    exchange(line, "80 0e 05 48 f0")  # Half a second.
    exchange(line, "80 22 7f ff 80 01 ca 56")
    for step in range(1, 50):
        line.tick(0.01 * step, 0.01)
        assert board.duties() == (32767, -32767)
    line.tick(0.5, 0.01)
    assert board.duties() == (0, 0)


def test_overcurrent_latches_and_an_error_stops_the_motors():
    (board,), line = boards_on_a_line()
    exchange(line, "80 22 7f ff 80 01 ca 56")
    board.motors.currents = [0.0, -15.01]  # The limit is 15 A.
    line.tick(0.0, 0.01)
    board.motors.currents = [0.0, 0.0]
    line.tick(0.01, 0.01)
    assert board.status == Status.CURRENT_ERROR_2 and board.duties() == (0, 0)
    board.reset()
    assert board.status == Status.NORMAL and board.timeout == 0


def test_encoder_wraps_at_32_bits_and_counts_from_reset():
    motors = StillMotors()
    motors.counts = [1000, 0]
    board = RoboClawBoard(0x80, motors)
    assert board.encoders()[0] == 0
    board.preset(2**31 - 1)
    motors.counts = [1001, -1]
    assert board.encoders() == (-(2**31), 2**31 - 2)
    board.reset()
    assert board.encoders() == (0, 0)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("read_between", [False, True])
def test_encoder_tells_once_that_its_counter_left_the_range_of_32_bits(number, read_between):
    """The maker's manual: 0 to 4,294,967,295; bit 0 underflow, 1 backward, 2 overflow."""
    motors = StillMotors()
    board = RoboClawBoard(0x80, motors)
    command = (BoardCommand.GET_ENCODER_1, BoardCommand.GET_ENCODER_2)[number]

    def status(*path):
        for step, count in enumerate(path):
            motors.counts[number] = count
            board.tick(0.01 * step, 0.01)
            if read_between:
                board.answer(BoardCommand.GET_ENCODERS)  # Which tells no status, and clears none.
        return board.answer(command)[4]

    assert status(0, 40, 80) == 0
    assert status(40) == 2
    assert status(-1) == 1 | 2
    assert status(-1) == 0
    assert status(3, 4) == 4
    assert status(5, -5, -6, 5, 6) == 1 | 4
    assert status(6) == 0
    assert status(2**31 - 1, 2**31 + 1) == 0  # Where a signed reading wraps, the counter does not.
    assert status(2**32 - 1, 2**32, 2**32 + 1) == 4
    board.obey((BoardCommand.SET_ENCODER_1, BoardCommand.SET_ENCODER_2)[number], (-3,))
    assert status(2**32 + 1) == 0
    assert status(2**32 + 4) == 4


def test_speed_command_reaches_its_speed_and_position_command_its_position():
    (board,), line = boards_on_a_line()
    speed = 0.0
    line.feed(codec.encode_write(0x80, BoardCommand.SPEED_1, 20000), 0.0)
    for step in range(2000):
        line.tick(0.01 * step, 0.01)
        speed += 0.2 * (44000 * board.duties()[0] / 32767 - speed)
        board.motors.counts[0] += round(0.01 * speed)
    assert board.channels[0].rate == pytest.approx(20000, rel=0.01)
    target = board.encoders()[0] - 5000
    line.feed(codec.encode_write(0x80, BoardCommand.POSITION_1, 1, 30000, 1, target, 1), 20.0)
    for step in range(2000):
        line.tick(20.0 + 0.01 * step, 0.01)
        speed += 0.2 * (44000 * board.duties()[0] / 32767 - speed)
        board.motors.counts[0] += round(0.01 * speed)
    assert abs(board.encoders()[0] - target) <= 5


class Echo:
    """Answers each request with the next number, in four bytes."""

    def __init__(self):
        self.heard = []

    def feed(self, data, now):
        self.heard.append(data)
        return (0x10203040 + len(self.heard)).to_bytes(4, "big")


def damaged(kind):
    """Return what goes in and comes out in 200 exchanges, 50 ms apart, with one kind of damage."""
    echo = Echo()
    line = FaultyLine(echo, LineFaultConfig(1.0, (kind,), 0.03), np.random.default_rng(8))
    at_once, later = [], []
    for number in range(200):
        at_once.append(line.feed(b"abcdefgh", 0.05 * number))
        later.append(line.due(0.05 * number + 0.03))
    assert line.counts[kind] == (0 if kind is LineFault.WRONG_ACKNOWLEDGE else 200)
    return echo.heard, at_once, later


def bits(one, other):
    return (int.from_bytes(one, "big") ^ int.from_bytes(other, "big")).bit_count()


def clean(number):
    return (0x10203041 + number).to_bytes(4, "big")


def test_each_line_fault_has_its_effect():
    heard, out, _ = damaged(LineFault.FLIP_REQUEST)
    assert {bits(data, b"abcdefgh") for data in heard} == {1, 2, 3}
    heard, out, _ = damaged(LineFault.FLIP_REPLY)
    assert {bits(reply, clean(n)) for n, reply in enumerate(out)} == {1, 2, 3}
    heard, out, _ = damaged(LineFault.LOSE_REQUEST)
    assert not heard and not any(out)
    heard, out, _ = damaged(LineFault.LOSE_REPLY)
    assert len(heard) == 200 and not any(out)
    heard, _, _ = damaged(LineFault.LOSE_BYTE)
    assert {len(data) for data in heard} == {7} and len(set(heard)) == 8
    _, out, later = damaged(LineFault.LATE)
    assert not any(out) and later == [clean(n) for n in range(200)]
    _, out, _ = damaged(LineFault.MERGED)
    assert out[1:] == [clean(n - 1) + clean(n) for n in range(1, 200)]
    _, out, _ = damaged(LineFault.TRUNCATED)
    assert all(clean(n).startswith(reply) for n, reply in enumerate(out))
    assert {len(reply) for reply in out} == {0, 1, 2, 3}
    _, out, _ = damaged(LineFault.WRONG_ACKNOWLEDGE)
    assert out == [clean(n) for n in range(200)]  # No acknowledgement, no wrong one.


def test_bytes_keep_their_order_and_a_silent_line_carries_none():
    echo = Echo()
    line = FaultyLine(echo, LineFaultConfig(0.5, (LineFault.LATE,)), np.random.default_rng(9))
    out = b"".join(line.feed(b"?", 0.001 * number) for number in range(200)) + line.due(9.0)
    assert out == b"".join(clean(n) for n in range(200))
    line.silent = True
    assert line.feed(b"?", 10.0) == b"" and len(echo.heard) == 200


def test_seeded_damage_repeats():
    def run():
        line = FaultyLine(Echo(), LineFaultConfig(0.5), np.random.default_rng(10))
        return [line.feed(b"abc", 0.01 * number) for number in range(100)], line.counts

    assert run() == run()


@pytest.mark.parametrize("rate", [-0.1, 1.1, math.nan])
def test_share_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="needs 0 to 1"):
        LineFaultConfig(rate)


def test_version_is_the_emulated_one():
    _, line = boards_on_a_line()
    assert isinstance(line, RoboClawLine)
    reply = exchange(line, "80 15")
    assert reply[:-2] == VERSION.encode() and len(reply[:-2]) <= codec.LONGEST_VERSION
