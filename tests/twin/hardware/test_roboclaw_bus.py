import collections
import math
import select
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.hardware.roboclaw_wire import (
    BAUD,
    PtyWire,
    StillMotors,
    VirtualLink,
    boards_on_a_line,
    virtual_time,
)
from twin.hardware import link as link_module
from twin.hardware import roboclaw_codec as codec
from twin.hardware.emulator.faults import FaultyLine, LineFault, LineFaultConfig
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.roboclaw_board import VERSION, RoboClawBoard, RoboClawLine
from twin.hardware.link import LinkError, SerialLink
from twin.hardware.roboclaw import BusTiming, RoboClawBus
from twin.hardware.roboclaw_codec import Command, Status

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
    Command.RESET_ENCODERS,
    Command.SET_ENCODER_1,
    Command.SET_ENCODER_2,
    Command.RESET_E_STOP,
}
QUESTIONS = (*codec.READS, Command.GET_STATUS, Command.GET_VERSION)
COMMANDS = (*codec.WRITES, *QUESTIONS)


class ScriptedLine(FaultyLine):
    """Damages the next exchanges as told: a kind or None, and a seed for the place, for each."""

    def __init__(self, device):
        super().__init__(device, LineFaultConfig(), np.random.default_rng(0))
        self.script = []

    def _exchange(self, request, now):
        kind, seed = self.script.pop(0) if self.script else (None, 0)
        self._config = LineFaultConfig(float(kind is not None), (kind,) if kind else KINDS)
        self._rng = np.random.default_rng(seed)
        super()._exchange(request, now)


# Truth: what is set from behind, and how a board must tell of it


def scramble(board, rng):
    """Let the board hold new values throughout; return what it must answer to each question."""
    motors = board.motors
    motors.count = rng.integers(-(2**31), 2**31, 2).tolist()
    currents, volts = rng.integers(-3000, 3001, 2).tolist(), int(rng.integers(100, 340))
    motors.current, motors.volts = [0.01 * current for current in currents], 0.1 * volts
    motors.logic, motors.temperature = rng.integers(0, 1000, 2).tolist()
    board.status = Status(int(rng.integers(2**22)) & int(sum(Status)))
    board.timeout, board.pwm_mode = rng.integers(0, 256, 2).tolist()
    rates, duties = (300 * rng.integers(-3000, 3001, 2)).tolist(), rng.integers(-32767, 32768, 2)
    gains, limits = rng.integers(0, 2**32, (2, 4)).tolist(), rng.integers(0, 2**32, 2).tolist()
    for number, channel in enumerate(board.channels):
        channel.offset, channel.rate = 0, float(rates[number])
        channel.duty, channel.gains = int(duties[number]), tuple(gains[number])
        channel.current_limit = limits[number]
        channel.target_speed = channel.target_position = None
    back = [int(rate < 0) for rate in rates]
    shown = board.status & OLD_BITS if board.old_firmware else board.status
    return {
        Command.GET_TIMEOUT: (board.timeout,),
        Command.GET_ENCODER_1: (motors.count[0], 2 * back[0]),
        Command.GET_ENCODER_2: (motors.count[1], 2 * back[1]),
        Command.GET_SPEED_1: (rates[0], back[0]),
        Command.GET_SPEED_2: (rates[1], back[1]),
        Command.GET_MAIN_VOLTAGE: (volts,),
        Command.GET_LOGIC_VOLTAGE: (motors.logic,),
        Command.GET_DUTIES: (0, 0) if board.status & 0xFFFF else tuple(duties.tolist()),
        Command.GET_CURRENTS: tuple(currents),
        Command.GET_VELOCITY_PID_1: tuple(gains[0]),
        Command.GET_VELOCITY_PID_2: tuple(gains[1]),
        Command.GET_ENCODERS: tuple(motors.count),
        Command.GET_RAW_SPEEDS: tuple(rates),
        Command.GET_TEMPERATURE: (motors.temperature,),
        Command.GET_CURRENT_LIMIT_1: (limits[0], 0),
        Command.GET_CURRENT_LIMIT_2: (limits[1], 0),
        Command.GET_PWM_MODE: (board.pwm_mode,),
        Command.GET_STATUS: shown,
        Command.GET_VERSION: "USB Roboclaw 2x15a v4.3.6",
    }


def payload(command, rng):
    """Random values of a write."""
    ranges = [FIELDS[letter] for letter in codec.WRITES[command][1:]]
    return tuple(int(rng.integers(low, high + 1)) for low, high in ranges)


def carried_out(board, command, values):
    """Tell whether the board holds what the write wants."""
    one, two = board.channels
    encoders = board.encoder(0), board.encoder(1)
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
        if command is Command.GET_STATUS:
            return self.bus.status(address)
        if command is Command.GET_VERSION:
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


# Sound line


@pytest.fixture
def bench():
    """A scripted line, its link, and a trial on it, in virtual time."""
    line, link, trial = virtual_trial(ScriptedLine)
    with virtual_time(link):
        yield line, link, trial


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_sound_line_carries_every_command_at_the_first_try(bench, command):
    _, link, trial = bench
    rng = np.random.default_rng(1)
    for _ in range(10):
        trial.call(command, rng)
    assert not trial.wrong and not trial.failures
    statistics = trial.bus.statistics
    assert statistics.transactions == 10 and statistics.retries == statistics.refused == 0
    if command is not Command.GET_STATUS:  # Whose old layout is shorter than is waited for.
        # First the line was seen clear by another question; since then, only the calls.
        assert len(link.sent) == 11 and statistics.silent == 0


def test_old_status_is_not_waited_for_twice(bench):
    _, link, trial = bench
    trial.boards[1].status = Status.E_STOP
    trial.bus.status(OLD)
    begin = link.now
    assert trial.bus.status(OLD) == Status.E_STOP
    assert link.now - begin < 0.001


def test_board_exchanged_for_one_of_other_firmware_is_understood(bench):
    _, _, trial = bench
    board = trial.boards[1]
    for old_firmware in (True, False, True):
        board.old_firmware, board.status = old_firmware, Status.E_STOP
        assert trial.bus.status(OLD) == Status.E_STOP


@pytest.mark.parametrize("command", [Command.DUTY_1, Command.DUTY_BOTH, Command.SET_TIMEOUT])
def test_what_does_not_fit_is_refused_before_the_wire(bench, command):
    _, link, trial = bench
    rest = [0] * (len(codec.WRITES[command]) - 2)
    for wrong in (math.nan, math.inf, 40000, -40000, 0.5, None):
        with pytest.raises(ValueError, match="nothing was sent"):
            trial.bus.write(NEW, command, *rest, wrong)
    assert not link.sent and trial.bus.statistics.transactions == 0


# One fault at a time

CLEAR = [(None, 0)]  # The first exchange of a fresh bus sees the line clear.


def test_lost_acknowledgement_is_asked_for_again_where_twice_is_once(bench):
    line, _, trial = bench
    line.script = [*CLEAR, (LineFault.LOSE_REPLY, 0)]
    trial.bus.write(NEW, Command.DUTY_BOTH, 100, -100)
    assert trial.boards[0].obeyed == [(Command.DUTY_BOTH, (100, -100))] * 2
    assert trial.bus.statistics.retries == trial.bus.statistics.silent == 1


@pytest.mark.parametrize("command", sorted(ONCE), ids=lambda command: command.name)
@pytest.mark.parametrize(
    "kind",
    [LineFault.LOSE_REPLY, LineFault.LATE, LineFault.TRUNCATED, LineFault.WRONG_ACKNOWLEDGE],
)
def test_what_must_not_run_twice_is_not_sent_again(bench, command, kind):
    line, _, trial = bench
    line.script = [*CLEAR, (kind, 1)]
    values = [5] * (len(codec.WRITES[command]) - 1)
    with pytest.raises(LinkError, match=f"{command.name} to board 0x80"):
        trial.bus.write(NEW, command, *values)
    assert trial.boards[0].obeyed == [(command, tuple(values))]


def test_late_answer_is_not_taken_for_the_next_one(bench):
    line, link, trial = bench
    motors = trial.boards[0].motors
    for seed in range(20):
        motors.count = [seed, -seed]
        line.script = [(LineFault.LATE, seed)] * 4  # Longer than a call takes.
        before = trial.bus.statistics.failures
        try:
            assert trial.bus.read(NEW, Command.GET_ENCODERS) == (seed, -seed)
        except LinkError:
            assert trial.bus.statistics.failures == before + 1
        line.script = []
        motors.count = [-seed - 1, seed + 1]
        assert trial.bus.read(NEW, Command.GET_ENCODERS) == (-seed - 1, seed + 1)
    assert line.counts[LineFault.LATE] > 40 and trial.bus.statistics.failures > 5


def test_late_acknowledgement_is_not_taken_for_the_next_ones(bench):
    line, _, trial = bench
    board = trial.boards[0]
    trial.bus.write(NEW, Command.DUTY_1, 1)
    for seed in range(20):
        line.script = [(None, 0)] * trial.bus._suspect + [(LineFault.LATE, seed)]
        with pytest.raises(LinkError):
            trial.bus.write(NEW, Command.SET_ENCODER_1, seed)
        # Its acknowledgement is still on its way; this one never reaches the board.
        line.script = [(None, 0), *[(LineFault.LOSE_REQUEST, 0)] * 9]
        with pytest.raises(LinkError):
            trial.bus.write(NEW, Command.DUTY_1, 1000 + seed)
        assert board.channels[0].duty == 1
        line.script = []


def test_old_answer_that_comes_again_before_the_new_one_is_not_believed(bench):
    line, _, trial = bench
    board = trial.boards[0]
    board.motors.count = [1, 2]
    assert trial.bus.read(NEW, Command.GET_ENCODERS) == (1, 2)
    board.motors.count = [3, 4]
    line.script = [(LineFault.MERGED, 0)]
    assert trial.bus.read(NEW, Command.GET_ENCODERS) == (3, 4)
    assert trial.bus.statistics.refused == 1


class Misheard:
    """A board that hears the first write as the question for the speed of motor 1."""

    def __init__(self, device):
        self.device, self.misheard = device, 0

    def feed(self, data, now):
        if data[1:2] == bytes((Command.DUTY_BOTH,)) and not self.misheard:
            self.misheard += 1
            data = data[:1] + bytes((Command.GET_SPEED_1,))
        return self.device.feed(data, now)


def test_answer_to_a_damaged_write_is_no_acknowledgement_though_it_begins_like_one():
    (board,), device = boards_on_a_line()
    board.channels[0].rate = -300.0  # In bytes ff ff fe d4.
    link = VirtualLink(Misheard(device))
    with virtual_time(link):
        bus = RoboClawBus(link)
        bus.write(0x80, Command.DUTY_BOTH, 5, 6)
        assert board.duties() == (5, 6)
        assert bus.statistics.refused == bus.statistics.retries == 1


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
def test_single_damage_is_survived_and_counted(bench, kind):
    line, _, trial = bench
    rng = np.random.default_rng(2)
    repeatable = [command for command in COMMANDS if command not in ONCE]
    for seed in range(100):
        line.script = [(None, 0)] * trial.bus._suspect + [(kind, seed)]
        trial.call(repeatable[int(rng.integers(len(repeatable)))], rng)
    assert not trial.wrong and not trial.failures
    assert line.counts[kind] >= 40
    statistics = trial.bus.statistics
    assert statistics.silent + statistics.refused >= 0.9 * line.counts[kind]


# Strays, babble, silence


def test_stray_bytes_before_a_call_are_drained_and_counted(bench):
    _, link, trial = bench
    rng = np.random.default_rng(4)
    for number in range(50):
        link.stray(rng.bytes(number + 1))
        trial.call(COMMANDS[number % len(COMMANDS)], rng)
    assert not trial.wrong and not trial.failures
    assert trial.bus.statistics.stray == sum(range(51))


def test_stray_answer_to_the_same_question_is_not_believed(bench):
    _, link, trial = bench
    trial.boards[0].motors.count = [7, 8]
    trial.bus.read(NEW, Command.GET_ENCODERS)
    crc = codec.checksum(bytes((NEW, Command.GET_ENCODERS)) + struct.pack(">ii", 1, 1))
    link.stray(struct.pack(">ii", 1, 1) + crc)
    assert trial.bus.read(NEW, Command.GET_ENCODERS) == (7, 8)


def test_half_a_packet_in_the_boards_buffer_costs_one_retry(bench):
    line, link, trial = bench
    trial.boards[0].motors.count = [7, 8]
    trial.bus.read(NEW, Command.GET_ENCODERS)
    line.feed(bytes.fromhex("80 22 12"), link.now)
    assert trial.bus.read(NEW, Command.GET_ENCODERS) == (7, 8)
    assert trial.bus.statistics.retries == trial.bus.statistics.silent == 1


class Babbler:
    """A device that is silent until it is asked, and sends noise without end from then on."""

    def __init__(self, count):
        self.rng, self.count, self.asked = np.random.default_rng(6), count, False

    def feed(self, data, now):
        self.asked = self.asked or bool(data)
        return self.rng.bytes(self.count) if self.asked else b""


@pytest.mark.parametrize("count", [1, 3, 50])
@pytest.mark.parametrize("command", [Command.GET_ENCODERS, Command.DUTY_BOTH, Command.GET_VERSION])
def test_babbling_board_cannot_hold_a_call(command, count):
    (board,), _ = boards_on_a_line()
    link = VirtualLink(Babbler(count))
    with virtual_time(link):
        trial = Trial(RoboClawBus(link), [board], lambda: link.now)
        for _ in range(5):
            trial.call(command, np.random.default_rng(0))
    assert trial.failures == 5 and max(trial.durations) <= WORST_CALL


class Slow:
    """A device whose answers take their time."""

    def __init__(self, device, delay):
        self.device, self.delay, self._waiting = device, delay, []

    def feed(self, data, now):
        if data:
            self._waiting.append((now + self.delay, self.device.feed(data, now)))
        out = b""
        while self._waiting and self._waiting[0][0] <= now:
            out += self._waiting.pop(0)[1]
        return out


@pytest.mark.parametrize("command", [Command.GET_LOGIC_VOLTAGE, Command.GET_ENCODERS])
def test_answers_that_take_longer_than_a_call_are_never_believed_later(command):
    for delay in np.arange(0.0065, 0.12, 0.0005).tolist():
        line, link, trial = virtual_trial(lambda device, d=delay: Slow(device, d))
        with virtual_time(link):
            for seed in range(16):
                trial.call(command, np.random.default_rng(seed))
        assert not trial.wrong and line.delay == delay


def test_silence_after_a_failure_is_longer_than_the_boards_gap():
    assert BusTiming().quiet > codec.PACKET_GAP == 0.010  # The manual's ten milliseconds.


def test_silent_board_is_named_at_the_deadline(bench):
    _, link, trial = bench
    begin = link.now
    with pytest.raises(LinkError, match=r"GET_ENCODERS of board 0x85: no valid answer .* virtual"):
        trial.bus.read(0x85, Command.GET_ENCODERS)
    assert link.now - begin <= BusTiming().call + 1e-9
    assert trial.bus.statistics.failures == 1
    assert trial.bus.statistics.worst_call == link.now - begin
    trial.call(Command.GET_ENCODERS, np.random.default_rng(0))
    assert not trial.failures and not trial.wrong


# Arbitrary faults

SCRIPT = st.lists(st.tuples(st.sampled_from((None, *KINDS)), st.integers(0, 2**32 - 1)), max_size=6)
CALLS = st.lists(
    st.tuples(st.sampled_from(COMMANDS), SCRIPT, st.integers(0, 2**32 - 1)),
    min_size=1,
    max_size=8,
)


@settings(max_examples=150, deadline=None)
@given(CALLS)
def test_no_sequence_of_faults_gives_a_wrong_value_or_a_long_call(calls):
    line, link, trial = virtual_trial(ScriptedLine)
    with virtual_time(link):
        for command, script, seed in calls:
            line.script = list(script)
            trial.call(command, np.random.default_rng(seed))
        line.script = []
        # Whatever was, a sound line works again with the next call.
        trial.failures = 0
        trial.call(Command.GET_ENCODERS, np.random.default_rng(0))
    assert not trial.wrong and not trial.failures
    assert max(trial.durations) <= BusTiming().call + OVERHEAD


def virtual_damage(plans, seed):
    """Damage lines in virtual time by plans of (kinds, rate, damaged exchanges)."""
    damage = collections.Counter()
    for number, (kinds, rate, damaged) in enumerate(plans):
        rng = np.random.default_rng([seed, number])
        config = LineFaultConfig(rate, kinds)
        line, link, trial = virtual_trial(lambda device, c=config, r=rng: FaultyLine(device, c, r))
        with virtual_time(link):
            random_calls(trial, line, rng, damaged)
        assert not trial.wrong
        assert max(trial.durations) <= BusTiming().call + OVERHEAD
        assert rate == 1.0 or trial.failures < 0.5 * trial.calls
        damage += line.counts
    assert set(damage) == set(KINDS)
    return sum(damage.values())


def test_each_and_any_damage_in_virtual_time_gives_no_wrong_value():
    plans = [((kind,), rate, 25) for kind in KINDS for rate in (0.3, 1.0)]
    plans += [(KINDS, 0.03, 50), (KINDS, 0.3, 250), (KINDS, 1.0, 250)]
    assert virtual_damage(plans, 6) >= 1000


@pytest.mark.slow
def test_ten_thousand_damaged_exchanges_in_virtual_time_give_no_wrong_value():
    plans = [((kind,), rate, 300) for kind in KINDS for rate in (0.3, 1.0)]
    plans += [(KINDS, 0.03, 300), (KINDS, 0.3, 2500), (KINDS, 1.0, 2000)]
    assert virtual_damage(plans, 7) >= 10_000


# The wall clock


class WaitingTime:
    """For how long the serial links of this thread wanted to wait, and did.

    A busy machine lets a wait end late; that is not the call's doing. That calls do not spin
    instead of waiting is seen in virtual time, where each step takes some.
    """

    def __init__(self):
        self.waited = 0.0

    def select(self, readers, writers, others, timeout):
        begin = time.perf_counter()
        ready = select.select(readers, writers, others, timeout)
        self.waited += min(timeout, time.perf_counter() - begin)
        return ready

    def __call__(self):
        return self.waited


@pytest.fixture
def waiting_time(monkeypatch):
    clock = WaitingTime()
    monkeypatch.setattr(link_module, "select", clock)
    return clock


def wall_clock_damage(plans, seed, waiting_time):
    """Damage a pseudo-terminal's line by plans of (kinds, rate, damaged exchanges)."""
    damage, wall, durations, failures = collections.Counter(), [], [], 0
    for number, (kinds, rate, damaged) in enumerate(plans):
        rng = np.random.default_rng([seed, number])
        boards, device = two_boards()
        line = FaultyLine(device, LineFaultConfig(rate, kinds), rng.spawn(1)[0])
        with PtyWire(line) as wire:
            bus = RoboClawBus(wire.open())
            trial = Trial(bus, boards, waiting_time, wire.settle)
            random_calls(trial, line, rng, damaged)
            bus.close()
        assert not trial.wrong
        wall, durations = wall + trial.wall, durations + trial.durations
        failures += trial.failures
        damage += line.counts
    worst, above = max(wall), sum(duration > WORST_CALL for duration in wall)
    print(
        f"\n{len(wall)} calls, {sum(damage.values())} damaged exchanges, {failures} failures; "
        f"worst call {1e3 * worst:.1f} ms on the wall clock ({above} above the bar), "
        f"{1e3 * max(durations):.1f} ms of it waiting"
    )
    assert set(damage) == set().union(*(kinds for kinds, _, _ in plans))
    assert max(durations) <= WORST_CALL
    return sum(damage.values()), np.percentile(wall, 99)


def test_damaged_port_gives_no_wrong_value_and_no_long_call(waiting_time):
    plans = [(KINDS, 0.03, 5), (KINDS, 0.3, 60), (KINDS, 1.0, 25)]
    damaged, _ = wall_clock_damage(plans, 1, waiting_time)
    assert damaged >= 90


@pytest.mark.slow
def test_damaged_exchanges_give_no_wrong_value_and_no_long_call(waiting_time):
    plans = [((kind,), 0.3, 60) for kind in KINDS]
    plans += [(KINDS, 0.03, 200), (KINDS, 0.3, 800), (KINDS, 1.0, 400)]
    damaged, nearly_all = wall_clock_damage(plans, 2, waiting_time)
    assert damaged >= 1900 and nearly_all <= WORST_CALL


def timed_failure(call, waiting_time):
    """Return how long a call took to fail [s]."""
    begin = waiting_time()
    with pytest.raises(LinkError):
        call()
    return waiting_time() - begin


def test_port_that_takes_nothing_cannot_hold_a_call(waiting_time):
    port = PseudoTerminal()
    serial = SerialLink(port.name, BAUD)
    bus = RoboClawBus(serial)
    with pytest.raises(LinkError, match=f"{port.name}: takes no bytes"):
        for _ in range(1000):
            serial.write(bytes(4096))
    assert timed_failure(lambda: bus.read(NEW, Command.GET_ENCODERS), waiting_time) <= WORST_CALL
    assert timed_failure(lambda: bus.write(NEW, Command.DUTY_1, 5), waiting_time) <= WORST_CALL
    bus.close()
    port.close()


def test_port_that_is_gone_is_a_link_error(waiting_time):
    port = PseudoTerminal()
    bus = RoboClawBus(SerialLink(port.name, BAUD))
    port.close()
    for call in (
        lambda: bus.read(NEW, Command.GET_ENCODERS),
        lambda: bus.write(NEW, Command.DUTY_1, 5),
        lambda: bus.status(NEW),
        lambda: bus.version(NEW),
    ):
        assert timed_failure(call, waiting_time) <= WORST_CALL
    with pytest.raises(LinkError, match="cannot be opened"):
        SerialLink(port.name, BAUD)
    bus.close()


# The emulated board and line


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
    board.motors.current = [0.0, -15.01]  # The limit is 15 A.
    line.tick(0.0, 0.01)
    board.motors.current = [0.0, 0.0]
    line.tick(0.01, 0.01)
    assert board.status == Status.CURRENT_ERROR_2 and board.duties() == (0, 0)
    board.reset()
    assert board.status == Status.NORMAL and board.timeout == 0


def test_encoder_wraps_at_32_bits_and_counts_from_reset():
    motors = StillMotors()
    motors.count = [1000, 0]
    board = RoboClawBoard(0x80, motors)
    assert board.encoder(0) == 0
    board.preset(2**31 - 1)
    motors.count = [1001, -1]
    assert (board.encoder(0), board.encoder(1)) == (-(2**31), 2**31 - 2)
    board.reset()
    assert (board.encoder(0), board.encoder(1)) == (0, 0)


def test_speed_command_reaches_its_speed_and_position_command_its_position():
    (board,), line = boards_on_a_line()
    speed = 0.0
    line.feed(codec.encode_write(0x80, Command.SPEED_1, 20000), 0.0)
    for step in range(2000):
        line.tick(0.01 * step, 0.01)
        speed += 0.2 * (44000 * board.duties()[0] / 32767 - speed)
        board.motors.count[0] += round(0.01 * speed)
    assert board.channels[0].rate == pytest.approx(20000, rel=0.01)
    target = board.encoder(0) - 5000
    line.feed(codec.encode_write(0x80, Command.POSITION_1, 1, 30000, 1, target, 1), 20.0)
    for step in range(2000):
        line.tick(20.0 + 0.01 * step, 0.01)
        speed += 0.2 * (44000 * board.duties()[0] / 32767 - speed)
        board.motors.count[0] += round(0.01 * speed)
    assert abs(board.encoder(0) - target) <= 5


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


def test_each_kind_of_damage_is_what_it_says():
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
