"""The client of the RoboClaw boards on damaged and dead ports, on the wall clock."""

import collections

import numpy as np
import pytest

from tests.twin.hardware.roboclaw.trial import (
    KINDS,
    NEW,
    WORST_CALL,
    Trial,
    random_calls,
    two_boards,
)
from tests.twin.hardware.roboclaw.wire import BAUD, PtyWire
from twin.hardware.emulator.faults import FaultyLine, LineFaultConfig
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.roboclaw.client import RoboClawBus
from twin.hardware.roboclaw.codec import BoardCommand
from twin.hardware.serial_link import LinkError, SerialLink

pytestmark = pytest.mark.real_time


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
    return sum(damage.values())


def test_damaged_port_gives_no_wrong_value_and_no_long_call(waiting_time):
    plans = [(KINDS, 0.03, 5), (KINDS, 0.3, 60), (KINDS, 1.0, 25)]
    assert wall_clock_damage(plans, 1, waiting_time) >= 90


@pytest.mark.slow
def test_damaged_exchanges_give_no_wrong_value_and_no_long_call(waiting_time):
    plans = [((kind,), 0.3, 20) for kind in KINDS]
    plans += [(KINDS, 0.03, 70), (KINDS, 0.3, 270), (KINDS, 1.0, 130)]
    assert wall_clock_damage(plans, 2, waiting_time) >= 630


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
    assert (
        timed_failure(lambda: bus.read(NEW, BoardCommand.GET_ENCODERS), waiting_time) <= WORST_CALL
    )
    assert timed_failure(lambda: bus.write(NEW, BoardCommand.DUTY_1, 5), waiting_time) <= WORST_CALL
    bus.close()
    port.close()


def test_disconnected_port_is_a_link_error(waiting_time):
    port = PseudoTerminal()
    bus = RoboClawBus(SerialLink(port.name, BAUD))
    port.close()
    for call in (
        lambda: bus.read(NEW, BoardCommand.GET_ENCODERS),
        lambda: bus.write(NEW, BoardCommand.DUTY_1, 5),
        lambda: bus.status(NEW),
        lambda: bus.version(NEW),
    ):
        assert timed_failure(call, waiting_time) <= WORST_CALL
    with pytest.raises(LinkError, match="cannot be opened"):
        SerialLink(port.name, BAUD)
    bus.close()
