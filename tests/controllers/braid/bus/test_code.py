"""Addresses, and word changes that are shortest by a search over all words."""

import heapq
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controllers.braid.bus.code import (
    AddressCode,
    PulseTiming,
    duration,
    rewriting_commands,
    shortest_commands,
)
from controllers.braid.bus.decoder_chips import command_of

CODES = [
    AddressCode(4),
    AddressCode(4, broadcast=True),
    AddressCode(4, spacing=2, broadcast=True),
    AddressCode(3, mode="set", spacing=2, broadcast=True),
    AddressCode(3, mode="set"),
    AddressCode(4, spacing=4, tolerance=1, broadcast=True),
]
TIMINGS = [PulseTiming(), PulseTiming(gap=2e-3), PulseTiming(quiet=5e-3)]


def obeyed(code, word, command):
    """An independent reading of the commands, on tuples."""
    word = list(word)
    if command == code.singles + 1:
        return (0,) * len(word)
    if command == code.singles + 2:
        return (1,) * len(word)
    if code.mode == "toggle":
        word[command - 1] = 1 - word[command - 1]
    else:
        actuator, off = divmod(command - 1, 2)
        word[actuator] = 1 - off
    return tuple(word)


def cheapest_from(code, start, timing):
    """Dijkstra's least times to all words, every command open at every step."""
    found, queue = {}, [(0.0, start)]
    while queue:
        cost, word = heapq.heappop(queue)
        if word in found:
            continue
        found[word] = cost
        for command in range(1, code.commands + 1):
            price = cost + timing.seconds(code.pulses(command))
            heapq.heappush(queue, (price, obeyed(code, word, command)))
    return found


@pytest.mark.parametrize("timing", TIMINGS)
@pytest.mark.parametrize("code", CODES)
def test_no_sequence_of_commands_is_shorter(code, timing):
    words = list(itertools.product((0, 1), repeat=code.actuators))
    for start in words:
        least = cheapest_from(code, start, timing)
        for goal in words:
            commands = shortest_commands(code, start, goal, timing)
            word = start
            for command in commands:
                word = obeyed(code, word, command)
            assert word == goal
            assert duration(code, commands, timing) == pytest.approx(least[goal], abs=1e-12)


@pytest.mark.parametrize("code", [code for code in CODES if code.broadcast])
def test_rewriting_reaches_the_word_from_every_word(code):
    words = list(itertools.product((0, 1), repeat=code.actuators))
    for start, goal in itertools.product(words, words):
        word = np.array(start)
        for command in rewriting_commands(code, goal):
            word = code.obey(word, command)
        assert tuple(word.astype(int)) == goal


def test_rewriting_takes_the_broadcast_that_is_cheaper_by_the_timing():
    code, goal = AddressCode(5, broadcast=True), [1, 1, 1, 0, 0]
    # All off and three trains are 12 pulses; all on and two are 16.
    assert rewriting_commands(code, goal) == (6, 3, 2, 1)
    # With the RC buffer all trains take as long.
    assert rewriting_commands(code, goal, PulseTiming(quiet=1e-3)) == (7, 5, 4)


def test_a_code_without_broadcasts_cannot_be_rewritten():
    with pytest.raises(ValueError, match="no broadcast commands"):
        rewriting_commands(AddressCode(3), [0, 1, 0])


@given(st.integers(1, 40), st.integers(1, 6), st.data())
def test_counts_within_the_tolerance_decode_and_all_others_do_not(actuators, spacing, data):
    tolerance = data.draw(st.integers(0, (spacing - 1) // 2))
    code = AddressCode(actuators, spacing=spacing, tolerance=tolerance)
    meaning = {}
    for command in range(1, code.commands + 1):
        for away in range(-tolerance, tolerance + 1):
            assert code.pulses(command) + away not in meaning
            meaning[code.pulses(command) + away] = command
    for pulses in range(code.pulses(code.commands) + 2 * spacing):
        assert command_of(pulses, code.decoding()) == meaning.get(pulses, 0)


@pytest.mark.parametrize("spacing, tolerance", [(2, 0), (4, 1)])
def test_guarded_addresses_refuse_one_fault_more_and_merged_trains(spacing, tolerance):
    code = AddressCode(15, spacing=spacing, tolerance=tolerance, broadcast=True)
    lengths = [code.pulses(command) for command in range(1, code.commands + 1)]
    for length in lengths:
        for away in (-tolerance - 1, tolerance + 1):
            assert command_of(length + away, code.decoding()) == 0
    for first, second in itertools.product(lengths, lengths):
        # The counter wraps, and the flag is counted.
        wrapped = (first + second + 1) % 2**code.counter_bits - 1
        assert command_of(wrapped, code.decoding()) == 0


def test_in_the_thesis_code_every_missed_pulse_means_another_actuator():
    code = AddressCode(15)
    assert [command_of(code.pulses(k) - 1, code.decoding()) for k in range(1, 16)] == list(
        range(15)
    )


@pytest.mark.parametrize(
    "values, message",
    [
        ({"actuators": 0}, "actuators: expected 1 or more, got 0"),
        ({"actuators": 3, "mode": "flip"}, "mode 'flip'"),
        ({"actuators": 3, "spacing": 0}, "spacing"),
        ({"actuators": 3, "spacing": 2, "tolerance": 1}, "tolerance: expected 0 to 0"),
    ],
)
def test_bad_codes_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        AddressCode(**values)


def test_bad_words_commands_and_times_are_refused():
    code = AddressCode(3)
    with pytest.raises(ValueError, match="expected 3 states of 0 or 1"):
        shortest_commands(code, [0, 1], [0, 1, 0])
    with pytest.raises(ValueError, match="expected 3 states of 0 or 1"):
        code.obey([0, 1, 2], 1)
    with pytest.raises(ValueError, match="command 4: expected 1 to 3"):
        code.pulses(4)
    with pytest.raises(ValueError, match="no broadcast"):
        _ = code.home
    with pytest.raises(ValueError, match="gap: expected a positive time"):
        PulseTiming(gap=0.0)
    with pytest.raises(ValueError, match="high: expected less than the period"):
        PulseTiming(high=1e-3)
