import select
import time

import numpy as np
import pyfirmata2
import pyfirmata2.pyfirmata2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.hardware.serving import Served
from twin.hardware.analogue import firmata_codec as codec
from twin.hardware.analogue.firmata import BAUD, AnalogueBoard
from twin.hardware.analogue.firmata_codec import Message, Parser
from twin.hardware.emulator.firmata_board import FirmataBoard
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.serial_link import LinkError, SerialLink

FAULTS = ("flip", "lose", "late", "twice", "cut", "merge")
WORST_CALL = 0.024  # [s] Three times the deadline.
STALL = 0.5  # [s] A busy machine may stop a call for a while; a client that hangs takes longer.


class Wire(Served):
    """Runs a board behind a pseudo-terminal, and damages what passes at a given rate."""

    def __init__(self, board, rng=None, rate=0.0, kinds=FAULTS):
        self.board, self.rate, self.kinds = board, rate, kinds
        self.rng = rng or np.random.default_rng(0)
        self.faults = dict.fromkeys(kinds, 0)
        self.port = PseudoTerminal()
        self.inject = b""
        self._held = []  # (due, bytes) to the host.
        self._merged = b""
        self._delay = 0.0  # [s]
        super().__init__()

    def close(self):
        self.port.close()

    def serve(self):
        ready, _, _ = select.select([self.port], [], [], 0.001)
        now = time.monotonic()
        heard = self._damaged(self.port.read(), False) if ready else b""
        said = self.board.feed(heard, now) + self.inject
        self.inject = b""
        if said:
            self._delay = 0.0
            damaged = self._damaged(said, True)
            self._held.append((now + self._delay, damaged))
        # What comes after late bytes waits behind them: a wire does not reorder.
        while self._held and self._held[0][0] <= now:
            self.port.write(self._held.pop(0)[1])

    def _damaged(self, data, to_host):
        data, self._merged = self._merged + data if to_host else data, b""
        if not data or self.rng.random() >= self.rate:
            return data
        kind = str(self.rng.choice(self.kinds))
        if kind in ("late", "merge") and not to_host:
            return data
        self.faults[kind] += 1
        place = int(self.rng.integers(len(data)))
        if kind == "flip":
            bit = 1 << int(self.rng.integers(8))
            return data[:place] + bytes((data[place] ^ bit,)) + data[place + 1 :]
        if kind == "lose":
            return data[:place] + data[place + 1 :]
        if kind == "late":
            self._delay = float(self.rng.uniform(0.001, 0.03))
            return data
        if kind == "merge":
            self._merged = data
            return b""
        return data * 2 if kind == "twice" else data[:place]


@pytest.fixture
def board():
    counts = {pin: 100 * pin + 7 for pin in range(6)}
    emulated = FirmataBoard(counts.__getitem__)
    emulated.counts = counts
    return emulated


def wait_until(condition, longest=2.0):
    end = time.monotonic() + longest
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)


PROMPT = {"deadline": 0.008, "silence": 0.003}  # As by default.
PATIENT = {"deadline": 0.5, "silence": 0.1}  # Where a busy machine must not lose a value.


def take_until(theirs, condition):
    """Let pyfirmata2 take what comes until then."""

    def taken():
        while theirs.bytes_available():
            theirs.iterate()
        return condition()

    wait_until(taken)


def opened(wire, **changes):
    client = AnalogueBoard(SerialLink(wire.port.name, BAUD), **{**PATIENT, **changes})
    client.firmware = client.open(2.0)
    return client


def test_polled_values_are_the_boards(board):
    with Wire(board) as wire:
        client = opened(wire)
        assert client.firmware == "StandardFirmata.ino 2.5"
        for _ in range(100):
            board.counts.update({0: 1023, 3: 0, 5: 511})
            assert client.poll([0, 3, 5]) == {0: 1023, 3: 0, 5: 511}
            board.counts.update({0: 0, 3: 1023, 5: 512})
            assert client.poll([5, 0, 3, 5]) == {0: 0, 3: 1023, 5: 512}
        client.close()


def test_open_board_sends_nothing_unasked(board):
    with Wire(board) as wire:
        client = opened(wire)
        client.poll([0, 1, 2])
        time.sleep(0.1)
        assert client._link.read(1, 0.0) == b""
        client.close()


def test_two_polls_must_agree_within_the_window(board):
    steps = iter(range(10_000))
    noisy = FirmataBoard(lambda pin: 500 + 10 * (next(steps) % 2) * pin)
    with Wire(noisy) as wire:
        client = opened(wire)
        assert client.poll([1]) == {1: None}
        assert client.poll([0]) == {0: 500}
        wide = AnalogueBoard(client._link, window=10, **PATIENT)
        assert wide.poll([1])[1] in (500, 510)
        client.close()


def test_silent_board_is_missing_within_the_deadline(board):
    with Wire(board) as wire:
        client = opened(wire, **PROMPT)
        board.feed = lambda data, now: b""
        start = time.monotonic()
        assert client.poll([0, 1]) == {0: None, 1: None}
        assert time.monotonic() - start < STALL
        client.close()


def test_babbling_board_cannot_hold_a_call(board):
    with Wire(board) as wire:
        client = opened(wire, **PROMPT)
        noise = np.random.default_rng(1).bytes(4000)
        board.feed = lambda data, now: noise
        for _ in range(20):
            start = time.monotonic()
            assert client.poll([0, 1]) == {0: None, 1: None}
            assert time.monotonic() - start < STALL
        client.close()


def test_reset_of_the_board_is_noticed_and_quietened(board):
    with Wire(board) as wire:
        client = opened(wire)
        assert board._interval == pytest.approx(16.383)
        board.power_cycle()
        time.sleep(0.01)
        assert client.poll([0])[0] == 7
        assert board._interval == pytest.approx(16.383)
        client.close()


def test_values_above_full_scale_and_of_other_pins_are_refused(board):
    with Wire(board) as wire:
        client = opened(wire)
        honest = board.feed

        def feed(data, now):
            lies = codec.analogue_message(0, 1024) * 2 + codec.analogue_message(4, 33) * 2
            answer = honest(data, now)
            echo = answer.find(bytes((codec.END_SYSEX,))) + 1
            return answer[:echo] + lies + answer[echo:] if answer else b""

        board.feed = feed
        assert client.poll([0, 1]) == {0: 7, 1: 107}
        client.close()


def test_port_without_a_board_is_named():
    port = PseudoTerminal()
    client = AnalogueBoard(SerialLink(port.name, BAUD))
    with pytest.raises(LinkError, match=f"{port.name}: no Firmata board answers"):
        client.open(0.1)
    client.close()
    port.close()


def test_firmware_that_does_not_answer_polls_is_named(board):
    board._set_reported = lambda pin, on: b""
    with Wire(board) as wire, pytest.raises(LinkError, match="flash StandardFirmata"):
        opened(wire)


def test_impossible_pin_is_refused(board):
    with Wire(board) as wire:
        client = opened(wire)
        with pytest.raises(ValueError, match="16 is outside 0 to 15"):
            client.poll([16])
        client.close()


def faulted_calls(board, calls, rate, seed, waiting_time):
    """Polls of a damaged link; the truth jumps before each, so a stale value is a wrong one."""
    rng = np.random.default_rng(seed)
    wrong, durations, readings = [], [], 0
    with Wire(board, np.random.default_rng(seed + 1)) as wire:
        client = opened(wire, **PROMPT)
        wire.rate = rate
        for _ in range(calls):
            truth = {pin: int(rng.integers(0, 1024)) for pin in (0, 1, 2)}
            board.counts.update(truth)
            start = waiting_time()
            values = client.poll([0, 1, 2])
            durations.append(waiting_time() - start)
            readings += sum(value is not None for value in values.values())
            wrong += [v for p, v in values.items() if v is not None and abs(v - truth[p]) > 2]
        wire.rate = 0.0
        time.sleep(0.04)
        board.power_cycle()  # Half a message may stand in its buffer.
        client._deadline = 0.5
        assert None not in client.poll([0, 1, 2]).values()
        client.close()
    return readings, wrong, max(durations), wire.faults


@pytest.mark.chosen_seed  # It shows every kind of damage.
@pytest.mark.parametrize("rate", [0.05, 0.3])
def test_damaged_link_gives_no_wrong_and_no_stale_value(board, rate, waiting_time):
    readings, wrong, longest, faults = faulted_calls(board, 400, rate, 5, waiting_time)
    assert not wrong
    assert all(faults.values())
    assert longest < WORST_CALL
    # Of 1200 polls; a busy machine answers too late, so how many more is its own affair.
    assert readings > 120


def test_pyfirmata2_reads_the_emulated_board(board, monkeypatch):
    monkeypatch.setattr(pyfirmata2.pyfirmata2, "BOARD_SETUP_WAIT_TIME", 0.3)
    with Wire(board) as wire:
        # Its own detection of pins fails on the pull-up mode that Firmata 2.5 reports.
        theirs = pyfirmata2.Arduino(wire.port.name)
        try:
            # What the board said by itself may have been flushed when the port was opened.
            theirs.sp.write(bytes((codec.REPORT_VERSION,)) + codec.sysex(codec.REPORT_FIRMWARE))
            take_until(theirs, lambda: theirs.firmata_version and theirs.firmware)
            assert theirs.get_firmata_version() == (2, 5)
            assert theirs.firmware == "StandardFirmata.ino" and theirs.firmware_version == (2, 5)
            theirs.add_cmd_handler(
                codec.CAPABILITY_RESPONSE, theirs._handle_report_capability_response
            )
            theirs.send_sysex(codec.CAPABILITY_QUERY, [])
            theirs._layout = None
            take_until(theirs, lambda: theirs._layout is not None)
            assert theirs._layout["analog"] == tuple(range(6))
            assert theirs._layout["pwm"] == (3, 5, 6, 9, 10, 11)
            assert theirs._layout["disabled"] == (0, 1)
            board.counts.update({0: 0, 1: 1023, 2: 511, 3: 512, 4: 1, 5: 1022})
            seen = {pin: [] for pin in range(6)}
            for pin in range(6):
                theirs.analog[pin].register_callback(seen[pin].append)
                theirs.get_pin(f"a:{pin}:i")
            start = time.monotonic()
            theirs.samplingOn(10)
            wait_until(lambda: min(map(len, seen.values())) >= 20)
            elapsed = time.monotonic() - start
            for pin, values in seen.items():
                assert set(values) == {round(board.counts[pin] / 1023, 4)}
                assert len(values) <= elapsed / 0.010 + 10
            theirs.analog[0].disable_reporting()
            wait_until(lambda: not board._reported[0])
            assert board._reported == [False, True, True, True, True, True]
        finally:
            theirs.exit()


def test_pyfirmata2_sets_up_an_arduino_and_its_pins(board, monkeypatch):
    monkeypatch.setattr(pyfirmata2.pyfirmata2, "BOARD_SETUP_WAIT_TIME", 0.3)
    with Wire(board) as wire:
        theirs = pyfirmata2.Arduino(wire.port.name)
        try:
            theirs.get_pin("d:9:p").write(0.5)
            theirs.get_pin("d:13:o").write(1)
            theirs.get_pin("d:2:u")
            wait_until(lambda: board._modes[2] == 11)
            assert (board._modes[9], board._modes[13], board._modes[2]) == (3, 1, 11)
        finally:
            theirs.exit()


def test_board_reports_at_its_sampling_interval(board):
    assert board.due(0.0).startswith(bytes((codec.REPORT_VERSION, 2, 5)))
    assert board.feed(codec.report_analogue(1, True), 0.0) == codec.analogue_message(1, 107)

    def reports(start):
        return sum(bool(board.due(start + 0.001 * k)) for k in range(1, 1001))

    assert reports(0.0) == pytest.approx(1000 / 19, abs=1)
    board.feed(codec.sysex(codec.SAMPLING_INTERVAL, codec.fourteen_bits(100)), 1.0)
    assert reports(1.0) == pytest.approx(10, abs=1)
    board.feed(codec.sysex(codec.SAMPLING_INTERVAL, codec.fourteen_bits(1)), 2.0)
    assert reports(2.0) == pytest.approx(100, abs=10)
    board.feed(bytes((codec.SYSTEM_RESET,)), 3.0)
    assert reports(3.0) == 0


@given(st.integers(0, 15), st.integers(0, 16383), st.binary(max_size=20))
def test_analogue_messages_are_read_back_whatever_came_before(pin, value, before):
    parser = Parser()
    parser.feed(before)
    message = codec.analogue_message(pin, value)
    expected = Message(codec.ANALOGUE_MESSAGE, pin, codec.fourteen_bits(value))
    assert parser.feed(message)[-1] == expected


@given(st.lists(st.integers(0, 127), max_size=63), st.integers(0, 127), st.data())
def test_sysex_is_read_back_in_any_pieces(data, kind, draw):
    wire = codec.sysex(kind, data)
    cut = draw.draw(st.integers(0, len(wire)))
    parser = Parser()
    messages = parser.feed(wire[:cut]) + parser.feed(wire[cut:])
    assert messages == [Message(codec.START_SYSEX, 0, bytes((kind, *data)))]


@settings(deadline=None)
@given(st.binary(max_size=400))
def test_parser_and_board_take_any_bytes(data):
    parser, board = Parser(), FirmataBoard(lambda pin: 5)
    for message in parser.feed(data):
        assert len(message.data) <= 64
    board.feed(data, 0.0)


def test_a_million_random_bytes_raise_nothing_and_keep_little():
    rng = np.random.default_rng(11)
    parser, board = Parser(), FirmataBoard(lambda pin: 5)
    for _ in range(250):
        data = rng.bytes(4000)
        parser.feed(data)
        board.feed(data, 0.0)
        assert len(parser._data) <= 64 and len(board._data) <= 64
    assert parser.feed(bytes([codec.START_SYSEX]) + bytes(100_000)) == []
    assert len(parser._data) <= 64


def test_bytes_and_numbers_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="seven bits"):
        codec.sysex(1, [128])
    with pytest.raises(ValueError, match="14 bits"):
        codec.analogue_message(0, 16384)
