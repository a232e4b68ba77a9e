"""A robot over boards whose request wire, reply wire or both are cut, in virtual time.

The boards are the emulated ones with their own timeouts; what they do is read behind the wires.
"""

import itertools

import numpy as np
import pytest

from tests.twin.hardware.board_tables import CALIBRATION, PERIOD
from tests.twin.hardware.roboclaw.wire import VirtualLink, boards_on_a_line, virtual_time
from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot
from twin.hardware.board_set import WiredBoards
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand
from twin.hardware.serial_link import LinkError
from twin.robot import Command, Lifecycle, RobotError

pytestmark = pytest.mark.virtual_time

WITHIN = 0.25  # [s] from the cut to zero duty at all boards.
ADDRESSES = (0x80, 0x81, 0x82, 0x83)


def stops_all(data):
    """Whether these bytes are zero duty for every board, in any order."""
    packets = {data[n : n + 8] for n in range(0, len(data), 8)}
    return packets == {codec.encode_write(a, BoardCommand.DUTY_BOTH, 0, 0) for a in ADDRESSES}


class Wires:
    """Two wires to the boards; after a number of exchanges some of them are cut."""

    def __init__(self, line):
        self.line, self.time = line, 0.0
        self.cut, self.cut_at = set(), None
        self.left = None  # Exchanges until the cut.
        self.disturb = lambda reply: reply

    def feed(self, data, now):
        self.run(now)
        if not data:
            return b""
        if self.left == 0 and self.cut_at is None:
            self.cut_at = now
        if self.left:
            self.left -= 1
        gone = self.cut if self.cut_at is not None else set()
        reply = b"" if "requests" in gone else self.line.feed(data, now)
        return b"" if "replies" in gone else self.disturb(reply)

    def run(self, now):
        """Let the boards live until now, a tick at a time."""
        while self.time + PERIOD <= now:
            self.time += PERIOD
            self.line.tick(self.time, PERIOD)


class Rig:
    """A robot on four boards behind wires that can be cut."""

    def __init__(self):
        self.boards, line = boards_on_a_line(ADDRESSES)
        self.wires = Wires(line)
        self.link = VirtualLink(self.wires)
        self.bus = RoboClawBus(self.link)
        wired = WiredBoards(self.bus, CALIBRATION)
        self.robot = BoardRobot(describe_rover("rover1"), wired, CALIBRATION, lambda: self.link.now)

    def start(self):
        self.robot.configure()
        self.robot.home(np.zeros(4))
        self.robot.activate()
        return self

    def cycle(self):
        self.link.now += PERIOD
        self.robot.observe()
        if self.robot.lifecycle is Lifecycle.ACTIVE:
            self.robot.command(Command(np.full(4, 0.54), np.full(4, 0.25)))

    def driven(self):
        """Addresses of the boards with a motor at a duty."""
        return {board.address for board in self.boards if any(board.duties())}

    def watch_the_stop(self, act):
        """Act until the robot is in ERROR; return its words and how long the boards drove on.

        The time is from the cut; boards that have stopped must not start again.
        """
        while self.robot.lifecycle is not Lifecycle.ERROR:
            try:
                act()
            except RobotError as error:
                said = str(error)
                break
            said = self.robot.fault
        assert not self.confirmed(said) & self.driven()
        last = self.wires.cut_at
        sent = len(self.link.sent)
        for _ in range(90):
            if self.driven():
                last = self.link.now
            try:
                self.cycle()
            except RobotError:  # Not configured: there is nothing to observe.
                self.wires.run(self.link.now)
        if "not answered" in said:
            # Else a board's own timeout would never act.
            assert all(map(stops_all, (data for _, data in self.link.sent[sent:])))
            assert self.link.sent[-1][0] < self.link.now - 0.2
        return said, last - self.wires.cut_at

    def confirmed(self, said):
        words = said.rpartition("boards ")[2].split(";")
        (group,) = [each for each in words if each.endswith("zero confirmed")] or [""]
        return {address for address in ADDRESSES if hex(address) in group}


@pytest.fixture
def rig():
    made = Rig()
    with virtual_time(made.link):
        yield made


def drop_every_third(rig):
    """The bus asks and probes again and again."""
    numbers = itertools.count()
    rig.wires.disturb = lambda reply: b"" if next(numbers) % 3 == 2 else reply


def noise_in_every_fifth(rig):
    """The bus waits again and again until the line is clear."""
    numbers = itertools.count()
    rig.wires.disturb = lambda reply: reply + bytes(7) if next(numbers) % 5 == 4 else reply


DISTURBED = {"moving": None, "probing": drop_every_third, "resynchronising": noise_in_every_fifth}
CUTS = [("requests",), ("replies",), ("requests", "replies")]


@pytest.mark.parametrize("cut", CUTS, ids="+".join)
@pytest.mark.parametrize("state", DISTURBED)
@pytest.mark.parametrize("exchange", range(0, 40, 5))
def test_cut_wire_stops_all_motors_and_nothing_is_said_that_is_not_so(rig, state, cut, exchange):
    rig.start()
    for _ in range(5):
        rig.cycle()
    assert rig.driven() == set(ADDRESSES)
    if DISTURBED[state]:
        DISTURBED[state](rig)
    rig.wires.cut, rig.wires.left = cut, exchange
    said, lasted = rig.watch_the_stop(rig.cycle)
    assert lasted <= WITHIN
    assert said.endswith(
        "boards 0x80, 0x81, 0x82, 0x83: sent, not answered; stop by their own timeout of 200 ms"
    )


@pytest.mark.parametrize("cut", CUTS, ids="+".join)
@pytest.mark.parametrize("exchange", range(0, 60, 6))
@pytest.mark.parametrize("before", ["configured", "active"])
def test_cut_wire_while_a_robot_starts_leaves_no_motor_driven(rig, cut, exchange, before):
    """Also motors that a program before this one left driven."""
    if before == "active":
        rig.start()
        rig.robot.deactivate()
    for board in rig.boards:
        board.timeout = 2
        board.obey(BoardCommand.DUTY_BOTH, (9000, -9000))
    rig.wires.cut, rig.wires.left = cut, exchange

    def begin():
        if before == "active":
            rig.robot.activate()
        else:
            rig.start()
        rig.cycle()

    said, lasted = rig.watch_the_stop(begin)
    assert lasted <= WITHIN
    assert "not answered" in said or rig.robot.lifecycle is Lifecycle.INACTIVE  # Not homed.


@pytest.mark.parametrize("dead", ADDRESSES)
@pytest.mark.parametrize("exchange", range(9))
def test_dead_board_is_told_beside_those_that_confirm(rig, dead, exchange):
    rig.start()
    for _ in range(5):
        rig.cycle()
    rig.wires.left = exchange
    rig.wires.line.boards.pop(dead).reset()
    said, lasted = rig.watch_the_stop(rig.cycle)
    others = ", ".join(hex(address) for address in ADDRESSES if address != dead)
    assert said.endswith(
        f"boards {others}: zero confirmed; {dead:#x}: sent, not answered; "
        "stops by its own timeout of 200 ms"
    )
    assert lasted <= WITHIN


def test_port_that_is_gone_is_told_and_not_waited_for(rig, monkeypatch):
    rig.start().cycle()

    def gone(*_):
        raise LinkError("virtual: gone")

    for call in ("write", "read"):
        monkeypatch.setattr(rig.link, call, gone)
    begin = rig.link.now
    report = rig.robot.boards.stop()
    assert rig.link.now == begin
    assert str(report) == (
        "boards 0x80, 0x81, 0x82, 0x83: not reached; stop by their own timeout of 200 ms"
    )


def test_zeros_are_sent_for_longer_than_the_boards_wait_and_then_nothing(rig):
    rig.start().cycle()
    rig.wires.left, rig.wires.cut = 0, {"replies"}
    rig.link.now += 0.16
    begin, before = rig.link.now, len(rig.link.sent)
    rig.robot.guard()
    assert "no command" in rig.robot.fault
    assert rig.link.now - begin < 0.06  # What is known is told soon.
    for _ in range(60):
        rig.link.now += PERIOD
        rig.robot.guard()  # As its thread does.
    zeros = [time for time, data in rig.link.sent[before:] if stops_all(data)]
    assert zeros[0] == begin
    assert max(np.diff(zeros)) < 0.05 and 0.2 < zeros[-1] - begin < 0.4
    for call in (
        lambda: rig.bus.read(0x80, BoardCommand.GET_ENCODERS),
        lambda: rig.bus.write(0x80, BoardCommand.SET_ENCODER_1, 0),
        lambda: rig.bus.send(0x80, BoardCommand.DUTY_BOTH, 0, 0),
        lambda: rig.bus.status(0x80),
    ):
        sent = len(rig.link.sent)
        with pytest.raises(LinkError, match="halted; nothing is sent before activation"):
            call()
        assert len(rig.link.sent) == sent


def test_boards_that_did_not_confirm_are_left_alone_until_their_timeout_has_acted(rig):
    rig.start().cycle()
    rig.wires.left, rig.wires.cut = 0, {"requests"}
    rig.robot.boards.stop()
    begin = rig.link.now
    rig.wires.cut = set()
    rig.bus.resume()
    assert rig.link.now - begin > 0.2
    assert rig.bus.read(0x80, BoardCommand.GET_TIMEOUT) == (2,)


def test_thread_amid_a_command_sends_no_duty_after_a_stop(rig, monkeypatch):
    """It waits for an acknowledgement while another thread stops the robot, and asks again then."""
    rig.start().cycle()
    reports = []

    def stop_meanwhile(*_):  # Instead of the acknowledgement, which is lost.
        monkeypatch.undo()
        reports.append(rig.robot.boards.stop())
        return b""

    monkeypatch.setattr(rig.link, "read", stop_meanwhile)
    with pytest.raises(LinkError, match="halted"):
        rig.bus.write(0x80, BoardCommand.DUTY_BOTH, 9000, 9000)
    assert reports[0].complete and not rig.driven()
