"""What one fault does to a word, under each protocol."""

import numpy as np
import pytest

from controllers.braid.bus.circuit import BusCircuit, PowerBus
from controllers.braid.bus.code import AddressCode
from controllers.braid.bus.master import BusMaster, Protocol, planned_commands, protocols
from controllers.braid.bus.trains import FAULT_KINDS, OneFault, Train, random_faults

START, GOAL = np.array([0, 1, 1, 0, 1, 0], bool), np.array([1, 1, 0, 0, 1, 1], bool)


def outcomes(name, kind, start, goal):
    """Yield the latches and the outcome for the fault at every place where it can be."""
    protocol = protocols(start.size)[name]
    bus = PowerBus(protocol.code, np.random.default_rng(0))
    commands = planned_commands(protocol, bus, start, goal)
    pulses = sum(protocol.code.pulses(command) for command in commands)
    for place in range(len(commands) if kind == "missed_flag" else pulses):
        bus.preset(start)
        master = BusMaster(protocol, bus, OneFault(kind, place))
        master.believe(start)
        outcome = master.change(goal)
        yield bus.word, outcome


@pytest.mark.parametrize("goal", [GOAL, START ^ np.eye(6, dtype=bool)[3]])
@pytest.mark.parametrize("kind", FAULT_KINDS)
@pytest.mark.parametrize("name", ["parity", "repeat"])
def test_parity_and_repetition_mend_one_fault_wherever_it_is(name, kind, goal):
    for word, outcome in outcomes(name, kind, START, goal):
        np.testing.assert_array_equal(word, goal)
        np.testing.assert_array_equal(outcome.believed, goal)
        assert not outcome.failed
        assert (outcome.resent > 0) == (name == "parity")


@pytest.mark.parametrize("kind", ["missed", "extra"])
def test_correcting_decoders_mend_one_pulse(kind):
    for word, _ in outcomes("correct", kind, START, GOAL):
        np.testing.assert_array_equal(word, GOAL)


def test_correcting_decoders_move_no_wrong_actuator_when_a_flag_is_missed():
    for word, _ in outcomes("correct", "missed_flag", START, GOAL):
        assert not np.any((word != GOAL) & (START == GOAL))


@pytest.mark.parametrize("kind", ["missed", "extra"])
def test_one_pulse_error_gives_an_undetected_wrong_word_in_the_thesis_protocol(kind):
    for word, outcome in outcomes("thesis", kind, START, GOAL):
        wrong = np.flatnonzero(word != GOAL)
        # The right actuator is skipped, and its neighbour toggled if there is one.
        assert len(wrong) == 1 and wrong[0] in (0, 5) or len(wrong) == 2 and np.ptp(wrong) == 1
        assert not outcome.failed


def test_words_keep_right_with_parity_while_toggles_drift():
    errors = {}
    for name in ("thesis", "parity"):
        rng = np.random.default_rng(3)
        protocol = protocols(6)[name]
        bus = PowerBus(protocol.code, rng, BusCircuit())
        master = BusMaster(
            protocol, bus, random_faults(rng, missed=3e-3, extra=3e-3, missed_flag=1e-3)
        )
        errors[name] = 0
        for goal in rng.random((150, 6)) < 0.5:
            assert not master.change(goal).failed
            errors[name] += np.count_nonzero(bus.word != goal)
    # Two faults in one word pass a parity bit, but are written over with the next goal.
    assert errors["thesis"] > 50 and errors["parity"] < 0.05 * errors["thesis"]


def test_foreign_change_is_found_and_the_word_written_anew():
    protocol = protocols(6)["parity"]
    bus = PowerBus(protocol.code, np.random.default_rng(0))
    master = BusMaster(protocol, bus)
    master.change(START)
    bus.preset(~START & np.array([1, 0, 0, 0, 0, 0], bool))
    outcome = master.change(GOAL)
    np.testing.assert_array_equal(bus.word, GOAL)
    assert outcome.rewritten == 1 and not outcome.failed


def test_dead_line_is_reported_and_the_word_written_anew_once_it_lives():
    protocol = protocols(6)["parity"]
    bus = PowerBus(protocol.code, np.random.default_rng(0))
    dead = [True]
    master = BusMaster(
        protocol, bus, lambda train: Train((0,) * len(train.pulses), False) if dead[0] else train
    )
    assert master.change(GOAL).failed
    dead[0] = False
    bus.preset(~GOAL)
    assert not master.change(GOAL).failed
    np.testing.assert_array_equal(bus.word, GOAL)


def test_unsafe_protocols_are_refused():
    with pytest.raises(ValueError, match="rounds: only a code that sets"):
        Protocol(AddressCode(3), rounds=2)
    with pytest.raises(ValueError, match="rounds: only a code that sets"):
        Protocol(AddressCode(3, mode="set", broadcast=True), rounds=2)
    with pytest.raises(ValueError, match="verify: expected a code with broadcasts"):
        Protocol(AddressCode(3), verify=True)
    with pytest.raises(ValueError, match="attempts"):
        Protocol(AddressCode(3), attempts=0)
    bus = PowerBus(AddressCode(3), np.random.default_rng(0))
    with pytest.raises(ValueError, match="bus: wired for"):
        BusMaster(Protocol(AddressCode(3, spacing=2)), bus)
