"""Trials of the fault matrix, and that it finds out words that are not true."""

import dataclasses

import pytest

from experiments.appd.boards.matrix import (
    FAULTS,
    LINE_FAULTS,
    OFTEN,
    STATES,
    WITHIN,
    MatrixResult,
    MatrixTrial,
    _is_true,
    deal_matrix,
    run_matrix_trial,
)

pytestmark = pytest.mark.real_time


def test_every_fault_is_dealt_in_every_state():
    trials = deal_matrix([10, 20], quick=False)
    cells = [(each.fault, each.state) for each in trials]
    for fault in FAULTS:
        for state in STATES:
            assert cells.count((fault, state)) == (8 if fault in OFTEN else 2)
    assert len(set(trials)) == len(trials)
    quick = deal_matrix([1], quick=True)
    assert [each.fault for each in quick] == list(FAULTS)
    assert {each.state for each in quick} == set(STATES)


@pytest.mark.parametrize("fault", ["reply_wire_cut", "host_killed"])
def test_fault_ends_in_zero_duty_and_true_words(fault):
    result = run_matrix_trial(MatrixTrial(fault, "driving", 5))
    assert result.moving == 4
    assert result.zero <= WITHIN and result.true and not result.active
    assert result.orphans == result.leaked == 0
    assert bool(result.words) == (fault != "host_killed")


@pytest.mark.slow
def test_short_fault_is_ridden_out():
    """A machine that stalls stops robots, too; one that has to stop for the fault always does."""

    def rides_out(seed):
        result = run_matrix_trial(MatrixTrial("one_repeated_reply", "arm_moving", seed))
        assert result.moving > 0 and result.active != bool(result.words)
        return result.active

    assert any(map(rides_out, range(5, 10)))


@pytest.mark.slow
def test_insertion_begins_with_the_card_in_the_slot_and_stops():
    result = run_matrix_trial(MatrixTrial("request_wire_cut", "insertion", 5))
    assert result.moving > 0 and result.zero <= WITHIN and result.true
    assert "rover2" in result.words


SAID = "robot 'rover1': it is broken; boards "
FAULT = next(iter(LINE_FAULTS))


@pytest.mark.parametrize(
    ("words", "lasting", "true"),
    [
        ("0x80, 0x81: zero confirmed", (0.1, 0.1), True),
        ("0x80, 0x81: zero confirmed", (0.1, 0.23), False),
        ("0x80, 0x81: zero confirmed", (0.1, 0.21), True),
        ("0x80: zero confirmed; 0x81: sent, not answered; stops by its own", (0.1, 0.3), True),
        ("0x80: zero confirmed; 0x81: sent, not answered; stops by its own", (0.1, 0.6), False),
        ("0x80, 0x81: not reached; stop by their own timeout", (0.2, 0.2), True),
    ],
)
def test_words_are_held_against_the_boards(words, lasting, true):
    result = MatrixResult(MatrixTrial(FAULT, "driving", 0), 4, 0.2, SAID + words, 0, False, 0.0)
    driven = dict(zip(("0x80", "0x81"), lasting, strict=True))
    assert FAULT == "unplugged" and _is_true(result, driven) is true
    silent = dataclasses.replace(result, words="")
    assert not _is_true(silent, driven)
    killed = dataclasses.replace(silent, trial=MatrixTrial("host_killed", "driving", 0))
    assert _is_true(killed, driven)
