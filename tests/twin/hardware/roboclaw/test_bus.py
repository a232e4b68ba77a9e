"""The client of the RoboClaw boards on sound, damaged and dead lines."""

import collections
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.hardware.roboclaw.trial import (
    COMMANDS,
    KINDS,
    NEW,
    OLD,
    ONCE,
    OVERHEAD,
    WORST_CALL,
    ScriptedLine,
    Trial,
    random_calls,
    virtual_trial,
)
from tests.twin.hardware.roboclaw.wire import (
    VirtualLink,
    boards_on_a_line,
    virtual_time,
)
from twin.hardware.emulator.faults import FaultyLine, LineFault, LineFaultConfig
from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.client import BusTiming, RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError

pytestmark = pytest.mark.virtual_time

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
    if command is not BoardCommand.GET_STATUS:  # Whose old layout is shorter than is waited for.
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


@pytest.mark.parametrize(
    "command", [BoardCommand.DUTY_1, BoardCommand.DUTY_BOTH, BoardCommand.SET_TIMEOUT]
)
def test_what_does_not_fit_is_refused_before_the_wire(bench, command):
    _, link, trial = bench
    rest = [0] * (len(codec.WRITES[command]) - 2)
    for wrong in (math.nan, math.inf, 40000, -40000, 0.5, None):
        with pytest.raises(ValueError, match="nothing was sent"):
            trial.bus.write(NEW, command, *rest, wrong)
    assert not link.sent and trial.bus.statistics.transactions == 0


# One fault at a time

CLEAR = [(None, 0)]  # The first exchange of a fresh bus sees the line clear.


def test_idempotent_write_is_repeated_after_a_lost_acknowledgement(bench):
    line, _, trial = bench
    line.script = [*CLEAR, (LineFault.LOSE_REPLY, 0)]
    trial.bus.write(NEW, BoardCommand.DUTY_BOTH, 100, -100)
    assert trial.boards[0].obeyed == [(BoardCommand.DUTY_BOTH, (100, -100))] * 2
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
        motors.counts = [seed, -seed]
        line.script = [(LineFault.LATE, seed)] * 4  # Longer than a call takes.
        before = trial.bus.statistics.failures
        try:
            assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (seed, -seed)
        except LinkError:
            assert trial.bus.statistics.failures == before + 1
        line.script = []
        motors.counts = [-seed - 1, seed + 1]
        assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (-seed - 1, seed + 1)
    assert line.counts[LineFault.LATE] > 40 and trial.bus.statistics.failures > 5


def test_late_acknowledgement_is_not_taken_for_the_next_ones(bench):
    line, _, trial = bench
    board = trial.boards[0]
    trial.bus.write(NEW, BoardCommand.DUTY_1, 1)
    for seed in range(20):
        line.script = [(None, 0)] * trial.bus._suspect + [(LineFault.LATE, seed)]
        with pytest.raises(LinkError):
            trial.bus.write(NEW, BoardCommand.SET_ENCODER_1, seed)
        # Its acknowledgement is still on its way; this one never reaches the board.
        line.script = [(None, 0), *[(LineFault.LOSE_REQUEST, 0)] * 9]
        with pytest.raises(LinkError):
            trial.bus.write(NEW, BoardCommand.DUTY_1, 1000 + seed)
        assert board.channels[0].duty == 1
        line.script = []


def test_repeated_old_reply_before_the_new_one_is_rejected(bench):
    line, _, trial = bench
    board = trial.boards[0]
    board.motors.counts = [1, 2]
    assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (1, 2)
    board.motors.counts = [3, 4]
    line.script = [(LineFault.MERGED, 0)]
    assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (3, 4)
    assert trial.bus.statistics.refused == 1


class Misheard:
    """A board that hears the first write as the question for the speed of motor 1."""

    def __init__(self, device):
        self.device, self.misheard = device, 0

    def feed(self, data, now):
        if data[1:2] == bytes((BoardCommand.DUTY_BOTH,)) and not self.misheard:
            self.misheard += 1
            data = data[:1] + bytes((BoardCommand.GET_SPEED_1,))
        return self.device.feed(data, now)


def test_answer_to_a_damaged_write_is_no_acknowledgement_though_it_begins_like_one():
    (board,), device = boards_on_a_line()
    board.channels[0].rate = -300.0  # In bytes ff ff fe d4.
    link = VirtualLink(Misheard(device))
    with virtual_time(link):
        bus = RoboClawBus(link)
        bus.write(0x80, BoardCommand.DUTY_BOTH, 5, 6)
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


def test_stray_reply_to_the_same_command_is_rejected(bench):
    _, link, trial = bench
    trial.boards[0].motors.counts = [7, 8]
    trial.bus.read(NEW, BoardCommand.GET_ENCODERS)
    crc = codec.checksum(bytes((NEW, BoardCommand.GET_ENCODERS)) + struct.pack(">ii", 1, 1))
    link.stray(struct.pack(">ii", 1, 1) + crc)
    assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (7, 8)


def test_half_a_packet_in_the_boards_buffer_costs_one_retry(bench):
    line, link, trial = bench
    trial.boards[0].motors.counts = [7, 8]
    trial.bus.read(NEW, BoardCommand.GET_ENCODERS)
    line.feed(bytes.fromhex("80 22 12"), link.now)
    assert trial.bus.read(NEW, BoardCommand.GET_ENCODERS) == (7, 8)
    assert trial.bus.statistics.retries == trial.bus.statistics.silent == 1


class Babbler:
    """A device that is silent until it is asked, and sends noise without end from then on."""

    def __init__(self, count):
        self.rng, self.count, self.asked = np.random.default_rng(6), count, False

    def feed(self, data, now):
        self.asked = self.asked or bool(data)
        return self.rng.bytes(self.count) if self.asked else b""


@pytest.mark.parametrize("count", [1, 3, 50])
@pytest.mark.parametrize(
    "command", [BoardCommand.GET_ENCODERS, BoardCommand.DUTY_BOTH, BoardCommand.GET_VERSION]
)
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


@pytest.mark.parametrize("command", [BoardCommand.GET_LOGIC_VOLTAGE, BoardCommand.GET_ENCODERS])
def test_replies_that_take_longer_than_a_call_are_never_accepted_later(command):
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
        trial.bus.read(0x85, BoardCommand.GET_ENCODERS)
    assert link.now - begin <= BusTiming().call + 1e-9
    assert trial.bus.statistics.failures == 1
    trial.call(BoardCommand.GET_ENCODERS, np.random.default_rng(0))
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
        trial.call(BoardCommand.GET_ENCODERS, np.random.default_rng(0))
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
