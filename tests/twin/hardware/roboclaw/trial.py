"""Calls on a bus whose line is damaged, judged by what the boards hold."""

import time

import numpy as np

from tests.twin.hardware.roboclaw.wire import (
    VirtualLink,
    boards_on_a_line,
)
from twin.hardware.emulator.faults import FaultyLine, LineFault, LineFaultConfig
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError

NEW, OLD = 0x80, 0x83  # The second has old firmware.
WORST_CALL = 0.060  # [s]
OVERHEAD = 0.0005  # [s] What the steps of a call themselves take in virtual time.
KINDS = tuple(LineFault)
OLD_BITS = codec.decode_status(b"\x3f\xff")
FIELDS = {
    "B": (0, 255),
    "h": (-32767, 32767),
    "I": (0, 2**32 - 1),
    "i": (-(2**31), 2**31 - 1),
}
# Once is not twice, whatever the code says.
ONCE = {
    BoardCommand.RESET_ENCODERS,
    BoardCommand.SET_ENCODER_1,
    BoardCommand.SET_ENCODER_2,
    BoardCommand.RESET_E_STOP,
}
QUESTIONS = (*codec.READS, BoardCommand.GET_STATUS, BoardCommand.GET_VERSION)
COMMANDS = (*codec.WRITES, *QUESTIONS)


class ScriptedLine(FaultyLine):
    """Damages the next exchanges by a plan: a kind or None, and a seed for the byte, for each."""

    def __init__(self, device):
        super().__init__(device, LineFaultConfig(), np.random.default_rng(0))
        self.script = []

    def _exchange(self, request, now):
        kind, seed = self.script.pop(0) if self.script else (None, 0)
        self._config = LineFaultConfig(float(kind is not None), (kind,) if kind else KINDS)
        self._rng = np.random.default_rng(seed)
        super()._exchange(request, now)


# Truth: what is set in the board directly, and how the board must report it


def scramble(board, rng):
    """Let the board hold new values throughout; return what it must answer to each question."""
    motors = board.motors
    motors.counts = rng.integers(-(2**31), 2**31, 2).tolist()
    currents, volts = rng.integers(-3000, 3001, 2).tolist(), int(rng.integers(100, 340))
    motors.currents, motors.voltage = [0.01 * current for current in currents], 0.1 * volts
    motors.logic, motors.temperature = rng.integers(0, 1000, 2).tolist()
    board.status = Status(int(rng.integers(2**22)) & int(sum(Status)))
    board.timeout, board.pwm_mode = rng.integers(0, 256, 2).tolist()
    rates, duties = (300 * rng.integers(-3000, 3001, 2)).tolist(), rng.integers(-32767, 32768, 2)
    gains, limits = rng.integers(0, 2**32, (2, 4)).tolist(), rng.integers(0, 2**32, 2).tolist()
    for number, channel in enumerate(board.channels):
        channel.offset, channel.rate = 0, float(rates[number])
        channel.turn = motors.counts[number] >> 32
        channel.duty, channel.gains = int(duties[number]), tuple(gains[number])
        channel.current_limit = limits[number]
        channel.target_speed = channel.target_position = None
    back = [int(rate < 0) for rate in rates]
    shown = board.status & OLD_BITS if board.old_firmware else board.status
    return {
        BoardCommand.GET_TIMEOUT: (board.timeout,),
        BoardCommand.GET_ENCODER_1: (motors.counts[0], 2 * back[0]),
        BoardCommand.GET_ENCODER_2: (motors.counts[1], 2 * back[1]),
        BoardCommand.GET_SPEED_1: (rates[0], back[0]),
        BoardCommand.GET_SPEED_2: (rates[1], back[1]),
        BoardCommand.GET_MAIN_VOLTAGE: (volts,),
        BoardCommand.GET_LOGIC_VOLTAGE: (motors.logic,),
        BoardCommand.GET_DUTIES: (0, 0) if board.status & 0xFFFF else tuple(duties.tolist()),
        BoardCommand.GET_CURRENTS: tuple(currents),
        BoardCommand.GET_VELOCITY_PID_1: tuple(gains[0]),
        BoardCommand.GET_VELOCITY_PID_2: tuple(gains[1]),
        BoardCommand.GET_ENCODERS: tuple(motors.counts),
        BoardCommand.GET_RAW_SPEEDS: tuple(rates),
        BoardCommand.GET_TEMPERATURE: (motors.temperature,),
        BoardCommand.GET_CURRENT_LIMIT_1: (limits[0], 0),
        BoardCommand.GET_CURRENT_LIMIT_2: (limits[1], 0),
        BoardCommand.GET_PWM_MODE: (board.pwm_mode,),
        BoardCommand.GET_STATUS: shown,
        BoardCommand.GET_VERSION: "USB Roboclaw 2x15a v4.3.6",
    }


def payload(command, rng):
    """Random values of a write."""
    ranges = [FIELDS[letter] for letter in codec.WRITES[command][1:]]
    return tuple(int(rng.integers(low, high + 1)) for low, high in ranges)


def carried_out(board, command, values):
    """Tell whether the board holds what the write wants."""
    one, two = board.channels
    encoders = board.encoders()
    match command.name.removesuffix("_1").removesuffix("_2"):
        case "SET_TIMEOUT":
            return board.timeout == values[0]
        case "RESET_ENCODERS":
            return encoders == (0, 0)
        case "SET_ENCODER":
            return encoders[command - 22] == values[0]
        case "SET_VELOCITY_PID":
            d, p, i, full = values
            return board.channels[command - 28].gains == (p, i, d, full)
        case "DUTY":
            return board.channels[command - 32].duty == values[0]
        case "DUTY_BOTH":
            return (one.duty, two.duty) == values
        case "SPEED":
            return board.channels[command - 35].target_speed == values[0]
        case "SPEED_BOTH":
            return (one.target_speed, two.target_speed) == values
        case "POSITION":
            return board.channels[command - 65].target_position == (values[3], values[1])
        case "POSITION_BOTH":
            wanted = (values[3], values[1]), (values[7], values[5])
            return (one.target_position, two.target_position) == wanted
        case "SET_CURRENT_LIMIT":
            return board.channels[command - 133].current_limit == values[0]
        case "SET_PWM_MODE":
            return board.pwm_mode == values[0]
        case "RESET_E_STOP":
            return not board.status & 1


class Trial:
    """Calls a bus, and compares each outcome with the boards from behind."""

    def __init__(self, bus, boards, clock, settle=lambda: None):
        self.bus, self.boards, self.clock, self.settle = bus, boards, clock, settle
        self.calls = self.failures = 0
        self.wrong = []
        self.durations = []  # Of each call, on `clock` [s].
        self.wall = []  # And on the wall clock [s].

    def call(self, command, rng):
        """Make one call to a random board whose whole state has just changed."""
        board = self.boards[int(rng.integers(len(self.boards)))]
        truth = scramble(board, rng)
        for each in self.boards:
            each.obeyed.clear()
        values = payload(command, rng) if command in codec.WRITES else None
        begin, wall = self.clock(), time.perf_counter()
        try:
            said = self._ask(board.address, command, values)
        except LinkError:
            said = None
            self.failures += 1
        self.durations.append(self.clock() - begin)
        self.wall.append(time.perf_counter() - wall)
        self.calls += 1
        if said is None:
            self.settle()
        elif values is None and said != truth[command]:
            self.wrong.append((command.name, said, truth[command]))
        elif values is not None and not carried_out(board, command, values):
            self.wrong.append((command.name, values, "acknowledged, but not carried out"))
        self._check_obeyed(board, command, values)

    def _ask(self, address, command, values):
        if values is not None:
            self.bus.write(address, command, *values)
            return True
        if command is BoardCommand.GET_STATUS:
            return self.bus.status(address)
        if command is BoardCommand.GET_VERSION:
            return self.bus.version(address)
        return self.bus.read(address, command)

    def _check_obeyed(self, board, command, values):
        """No board may have done anything else, nor too often."""
        for each in self.boards:
            wanted = [(command, values)] * len(each.obeyed) if each is board else []
            if each.obeyed != wanted:
                self.wrong.append((command.name, each.obeyed, "done where it was not asked for"))
        if command in ONCE and len(board.obeyed) > 1:
            self.wrong.append((command.name, board.obeyed, "done twice"))


def two_boards():
    (new,), line = boards_on_a_line((NEW,))
    (old,), _ = boards_on_a_line((OLD,), old_firmware=True)
    line.boards = {NEW: new, OLD: old}
    return [new, old], line


def virtual_trial(wrap):
    """Return line, link and trial in virtual time; use it under `virtual_time`."""
    boards, device = two_boards()
    line = wrap(device)
    link = VirtualLink(line)
    return line, link, Trial(RoboClawBus(link), boards, lambda: link.now)


def random_calls(trial, line, rng, damaged, most=10**6):
    """Call at random until so many exchanges were damaged."""
    before = sum(line.counts.values())
    for _ in range(most):
        if sum(line.counts.values()) - before >= damaged:
            return
        trial.call(COMMANDS[int(rng.integers(len(COMMANDS)))], rng)
    raise AssertionError(f"{most} calls did not damage {damaged} exchanges")
