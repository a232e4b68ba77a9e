"""Boards that are only tables, and a robot over them on a clock that a test turns."""

import math

import numpy as np

from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot, BoardRobotConfig
from twin.hardware.board_set import BoardState, StopReport
from twin.hardware.calibration.calibration import calibration_path, read_calibration
from twin.hardware.roboclaw.codec import Status
from twin.hardware.serial_link import LinkError
from twin.robot import Command, Lifecycle, RobotError

CALIBRATION = read_calibration(calibration_path("rover1"))
PERIOD = 0.01
PINS = {0: 512, 1: 493, 2: 488}  # Centre, roll and pitch, level.
# By hand from calibration/rover1.toml.
PLACES = [(0x80, 1), (0x80, 2), (0x81, 1), (0x81, 2), (0x82, 1), (0x82, 2), (0x83, 1), (0x83, 2)]
FORWARD = np.array([1, -1, 1, -1, 1, 1, 1, 1])
WHEEL_COUNT = 2.0 * math.pi / 200_000  # [rad]
ARM_COUNT = 2.0 * math.pi / 16_384  # [rad]


class Boards:
    """Counters, statuses and sensors that a test sets; notes all that it is asked and sent."""

    addresses = (0x80, 0x81, 0x82, 0x83)
    has_analogue = has_wrench = True
    has_stereo, stereo_fault = False, ""

    def __init__(self):
        self.counters = np.zeros(8, dtype=np.int64)
        self.creep = np.zeros(8, dtype=np.int64)  # Counts from one reading to the next.
        self.statuses = dict.fromkeys(self.addresses, Status.NORMAL)
        self.timeouts = dict.fromkeys(self.addresses, 0.0)
        self.battery = 12.0
        self.pins = dict(PINS)
        self.counts = np.zeros(6, dtype=np.int64)
        self.silent, self.deaf, self.refuses = set(), set(), set()
        self.asked, self.driven = [], []
        self.pair = None
        self.closed = False
        self.halted = self.mute = False
        self.repeated = 0
        self.held_up = 0  # Questions that come to nothing from now on.

    def _hear(self, what, address):
        if self.mute:
            raise LinkError("halted")
        self.asked.append((what, address))
        late = self.held_up > 0
        self.held_up -= late
        if late or address in self.silent:
            raise LinkError(f"{what} of board {address:#x}: no valid answer")

    def configure(self):
        for address in self.addresses:
            self._hear("configure", address)
            self.timeouts[address] = 0.2

    def encoders(self, address):
        self._hear("encoders", address)
        self.counters += self.creep
        axes = [axis for axis, (place, _) in enumerate(PLACES) if place == address]
        one, two = ((int(self.counters[axis]) + 2**31) % 2**32 - 2**31 for axis in axes)
        return one, two

    def reset(self, address):
        """Power on anew."""
        self.counters[[place == address for place, _ in PLACES]] = 0
        self.timeouts[address] = 0.0

    def set_encoder(self, axis, count):
        if axis in self.refuses:
            raise LinkError("does not take an encoder count")
        assert -(2**31) <= count < 2**31
        self.counters[axis] = count

    def drive(self, codes):
        if self.halted:
            raise LinkError("halted")
        self.driven.append(codes.copy())
        if self.silent | self.deaf:
            raise LinkError("DUTY_BOTH: no valid answer")

    def stop(self):
        self.driven.append(np.zeros(8, dtype=np.int64))
        lost = tuple(sorted(self.silent | self.deaf))
        rest = tuple(each for each in self.addresses if each not in lost)
        self.halted, self.mute = True, bool(lost)
        return StopReport(rest, sent=lost, timeout=0.2)

    def keep_stopped(self):
        self.repeated += self.mute

    def resume(self):
        self.halted = self.mute = False

    def analogue(self, pins):
        self.asked += [("pin", pin) for pin in pins]
        return {pin: self.pins.get(pin) for pin in pins}

    def wrench(self):
        self.asked.append(("wrench", 0))
        return self.counts

    def stereo(self, now):
        return self.pair

    def status(self, address):
        self._hear("status", address)
        return self.statuses[address]

    def state(self, address):
        self._hear("state", address)
        timeout = self.timeouts[address]
        return BoardState(address, self.statuses[address], self.battery, (0.0, 0.0), timeout)

    def reset_e_stop(self):
        for address in self.addresses:
            self.statuses[address] &= ~Status.E_STOP

    def close(self):
        self.closed = True

    def taken(self):
        """The codes of the last drive."""
        return self.driven[-1]


class Bench:
    """A robot with its boards, and the clock."""

    def __init__(self, calibration=CALIBRATION, **changes):
        self.time = 0.0
        self.boards = Boards()
        self.config = BoardRobotConfig(**changes)
        self.robot = BoardRobot(
            describe_rover("rover1"), self.boards, calibration, lambda: self.time, self.config
        )

    def homed(self, angles=(0.0, 0.0, 0.0, 0.0)):
        self.robot.configure()
        self.robot.home(np.array(angles))
        return self

    def active(self):
        self.homed().robot.activate()
        return self

    def cycle(self, command=None, moved=0):
        """One tick after which the axes have moved by some counts; returns what is seen."""
        self.time += PERIOD
        self.boards.counters += moved
        seen = self.robot.observe()
        if self.robot.lifecycle is Lifecycle.ACTIVE:
            self.robot.command(command or Command(np.full(4, 0.5), np.full(4, 0.25)))
        return seen

    def cycles_until_error(self, most=100):
        for number in range(1, most + 1):
            try:
                self.cycle()
            except RobotError:
                pass
            if self.robot.lifecycle is Lifecycle.ERROR:
                assert not np.any(self.boards.taken())
                return number
        return None
