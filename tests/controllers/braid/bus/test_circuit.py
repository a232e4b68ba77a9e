"""The sampled bus against a reference that reads trains as text, and against filters of SciPy."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from controllers.braid.bus.circuit import BusCircuit, PowerBus, rc_delay, with_rc_buffer
from controllers.braid.bus.code import AddressCode, PulseTiming, shortest_commands
from controllers.braid.bus.trains import OneFault, Train, random_faults, segments, trains_of

CODES = [
    AddressCode(5),
    AddressCode(5, spacing=2, broadcast=True),
    AddressCode(5, mode="set", spacing=2),
    AddressCode(5, spacing=4, tolerance=1, broadcast=True),
]


def bus_of(code, seed=0, **values):
    return PowerBus(code, np.random.default_rng(seed), BusCircuit(**values))


def reference(code, word, trains):
    """What a decoder of text makes of the trains: one "p" each pulse, "F" the flag."""
    text = "".join("p" * sum(train.pulses) + "F" * train.flag for train in trains)
    meaning = {}
    for command in range(1, code.commands + 1):
        middle = code.spacing * command - code.spacing // 2
        for pulses in range(middle - code.tolerance, middle + code.tolerance + 1):
            meaning[pulses] = command
    word = list(word)
    for run in re.findall(r"p*F", text):
        command = meaning.get(len(run) % 2**code.counter_bits - 1, 0)
        if command == 0:
            continue
        if command > code.singles:
            word = [command - code.singles - 1] * len(word)
        elif code.mode == "set":
            word[(command - 1) // 2] = command % 2
        else:
            word[command - 1] = 1 - word[command - 1]
    return word


TRAINS = st.lists(
    st.builds(
        Train,
        st.lists(st.sampled_from([0, 1, 1, 1, 2]), max_size=14).map(tuple),
        st.sampled_from([True, True, True, False]),
    ),
    min_size=1,
    max_size=8,
)


@pytest.mark.parametrize("code", CODES)
@settings(max_examples=60, deadline=None)
@given(trains=TRAINS, seed=st.integers(0, 1000))
def test_chips_read_any_train_as_the_reference_does(code, trains, seed):
    bus = bus_of(code, seed)
    start = np.random.default_rng(seed).integers(0, 2, code.actuators)
    bus.preset(start)
    words = bus.send(trains)
    assert words.shape == (len(trains), code.actuators)
    np.testing.assert_array_equal(words[-1], reference(code, start, trains))
    np.testing.assert_array_equal(bus.word, words[-1])


@pytest.mark.parametrize("buffer", ["flag", "rc"])
def test_random_words_arrive_one_after_another_despite_moderate_noise(buffer):
    code = AddressCode(15)
    circuit, timing = BusCircuit(noise=0.2), PulseTiming()
    if buffer == "rc":
        circuit, timing = with_rc_buffer(circuit, code, timing, 1.3)
    rng = np.random.default_rng(1)
    bus, word = PowerBus(code, rng, circuit, timing), np.zeros(15, bool)
    for goal in rng.random((150, 15)) < 0.5:
        bus.send(trains_of(code, shortest_commands(code, word, goal, timing)))
        np.testing.assert_array_equal(bus.word, goal)
        word = goal


def test_flag_is_counted_then_latched_and_clears_the_counter_when_it_falls():
    bus = bus_of(AddressCode(5), sample=1e-6)
    trace = bus.observe(trains_of(bus.code, [3]))
    assert trace.counts.max() == 4
    latched = np.flatnonzero(trace.words[:, 2])[0]
    assert trace.counts[latched] == 4
    assert 300e-6 < trace.time[latched] < 320e-6  # The flag starts after three periods.
    assert trace.counts[-1] == 0
    cleared = trace.time[np.flatnonzero(trace.counts == 4)[-1]]
    assert 400e-6 < cleared < 420e-6
    assert not np.any(trace.words[:, [0, 1, 3, 4]])


def test_levels_are_those_of_the_thesis():
    exact = {"divider_sigma": 0.0, "actuator_current": 0.0}
    trace = bus_of(AddressCode(5), sample=1e-6, **exact).observe([Train((1, 1))])
    pulse, flag = trace.time < 150e-6, trace.time > 200e-6
    assert trace.signal[pulse].max() == pytest.approx(2.0, abs=0.01)
    assert trace.signal[flag].max() == pytest.approx(5.0, abs=0.01)
    assert trace.flag[pulse].max() == pytest.approx(0.8, abs=0.01)
    assert trace.flag[flag].max() == pytest.approx(2.0, abs=0.01)
    assert trace.line.min() == pytest.approx(12.0, abs=1e-9)
    assert trace.line[pulse].max() == pytest.approx(16.0, abs=0.01)


def test_line_and_debouncer_agree_with_filters_of_scipy():
    circuit = BusCircuit(divider_sigma=0.0, actuator_current=0.0, clamp_drop=9.0, sample=1e-6)
    bus = PowerBus(AddressCode(3), np.random.default_rng(0), circuit)
    trains = [Train((1, 2, 1)), Train((0, 1))]
    trace = bus.observe(trains)
    volts = {0.0: 0.0, 1.0: 4.0, 2.0: 10.0}
    pieces = [piece for train in trains for piece in segments(train, bus.timing)]
    steps = [np.full(round(seconds / 1e-6), volts[level]) for level, seconds in pieces]
    drive = np.concatenate(steps)

    def low_pass(values, time):
        share = np.exp(-1e-6 / time)
        return signal.lfilter([1 - share], [1, -share], values)

    line = low_pass(drive, circuit.edge)
    divided = (line - low_pass(line, circuit.coupling)) / 2.0
    np.testing.assert_allclose(trace.line - 12.0, line, atol=1e-9)
    np.testing.assert_allclose(trace.signal, divided, atol=1e-9)
    np.testing.assert_allclose(trace.debounced, low_pass(divided, circuit.debounce), atol=1e-9)


def test_clamp_keeps_a_long_train_countable_and_its_absence_does_not():
    code, long = AddressCode(300), 300
    words = {}
    for clamp in (1e-4, 10.0):
        bus = bus_of(code, coupling=5e-3, clamp=clamp)
        words[clamp] = bus.send(trains_of(code, [long]))[-1]
    np.testing.assert_array_equal(np.flatnonzero(words[1e-4]), [long - 1])
    assert not words[10.0][long - 1]


def test_a_glitch_shorter_than_the_debouncer_is_not_counted():
    code = AddressCode(5)
    for high, counted in ((3e-6, 0), (50e-6, 4)):
        timing = PulseTiming(high=high)
        bus = PowerBus(code, np.random.default_rng(0), BusCircuit(sample=1e-6), timing)
        trace = bus.observe([Train((1, 1, 1, 1), flag=False)])
        assert trace.counts[-1] == counted


def test_rc_delay_is_the_time_at_which_the_capacitor_reaches_the_threshold():
    # 1.3 V of 5 V: 0.301 RC; 0.63 RC would be the delay to 2.34 V.
    assert rc_delay(1.0, 1.3, 5.0) == pytest.approx(0.3011, abs=1e-4)
    assert rc_delay(2.0, 5.0 * (1 - np.exp(-1.0)), 5.0) == pytest.approx(2.0)
    code = AddressCode(5)
    exact = BusCircuit(rc_sigma=0.0, threshold_sigma=0.0, divider_sigma=0.0, sample=1e-6)
    circuit, timing = with_rc_buffer(exact, code, PulseTiming(), 1.5)
    trace = PowerBus(code, np.random.default_rng(0), circuit, timing).observe(trains_of(code, [2]))
    start = trace.time[np.flatnonzero(trace.counts)[0]]
    latched = trace.time[np.flatnonzero(trace.words[:, 1])[0]]
    assert latched - start == pytest.approx(1.5 * 500e-6, abs=5e-6)


def test_rc_buffers_that_are_too_quick_cut_a_train():
    code = AddressCode(5)
    circuit, timing = with_rc_buffer(BusCircuit(rc_sigma=0.0), code, PulseTiming(), 1.1)
    circuit = dataclasses.replace(circuit, rc_time=0.5 * circuit.rc_time)
    bus = PowerBus(code, np.random.default_rng(0), circuit, timing)
    word = bus.send(trains_of(code, [5]))[-1]
    assert not word[4] and word.any()


def test_refused_trains_change_no_latch():
    bus = bus_of(AddressCode(5, spacing=2))
    bus.send([Train((1, 1)), Train((1,)), Train(())])
    assert bus.word.tolist() == [True, False, False, False, False]
    assert bus.sense() == 1


def test_random_faults_come_at_their_rates_and_one_fault_once():
    faults = random_faults(np.random.default_rng(0), missed=0.1, extra=0.05, missed_flag=0.2)
    sent = [faults(Train((1,) * 10)) for _ in range(4000)]
    pulses = np.array([train.pulses for train in sent])
    assert np.mean(pulses == 0) == pytest.approx(0.1, abs=0.01)
    assert np.mean(pulses == 2) == pytest.approx(0.05, abs=0.01)
    assert np.mean([not train.flag for train in sent]) == pytest.approx(0.2, abs=0.03)
    trains = [Train((1, 1)), Train((1, 1, 1)), Train((1,))]
    for kind, index, hit in (("missed", 4, 1), ("extra", 0, 0), ("missed_flag", 2, 2)):
        fault = OneFault(kind, index)
        after = [fault(train) for train in trains]
        changed = [old != new for old, new in zip(trains, after)]
        assert changed == [place == hit for place in range(3)]


def test_bad_values_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="debounce: expected a positive number, got 0"):
        BusCircuit(debounce=0.0)
    with pytest.raises(ValueError, match="noise: expected 0 or more, got -1"):
        BusCircuit(noise=-1.0)
    with pytest.raises(ValueError, match="edge: expected a positive number, got nan"):
        BusCircuit(edge=float("nan"))
    with pytest.raises(ValueError, match="actuator_current: expected a positive number to sense"):
        bus_of(AddressCode(3), actuator_current=0.0).sense()
    with pytest.raises(ValueError, match="threshold: expected below the logic supply"):
        BusCircuit(threshold=4.9)
    with pytest.raises(ValueError, match="margin: expected more than 1"):
        with_rc_buffer(BusCircuit(), AddressCode(3), PulseTiming(), 1.0)
    with pytest.raises(ValueError, match="rc_time and quiet"):
        PowerBus(AddressCode(3), rng, BusCircuit(rc_time=1e-3))
    with pytest.raises(ValueError, match="missed: expected a probability, got 2"):
        random_faults(rng, missed=2.0)
    with pytest.raises(ValueError, match="at most 1"):
        random_faults(rng, missed=0.6, extra=0.6)
    with pytest.raises(ValueError, match="fault 'lost'"):
        OneFault("lost", 0)
    with pytest.raises(ValueError, match="do not fit"):
        segments(Train((1,) * 9), PulseTiming(quiet=5e-4))
