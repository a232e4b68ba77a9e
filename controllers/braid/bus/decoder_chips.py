"""Samples of the power line through every decoder chip (Thesis section E.4), compiled."""

from typing import NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import BoolArray, FloatArray, IntArray

PULSES, FLAG = range(2)
"""Rows of the two detectors: of the address pulses, and of the flag."""


class LineValues(NamedTuple):
    """Power line and logic levels, per sample where it says so.

    Attributes:
        edge: Share of a step that the line takes in one sample.
        coupling: Share of a step that the coupling capacitor takes in one sample.
        clamp: Share of a step that it takes in one sample while the clamp diode conducts.
        clamp_drop: Voltage drop of the clamp diode [V].
        divider: Ratio of the line's voltage to the signal's.
        actuator_drop: Voltage drop of the line by one actuator that is on [V].
        noise: Standard deviation of the signal's noise in each sample [V].
        debounce: Share of a step that a debouncer takes in one sample.
        logic_supply: Supply of the decoders [V].
        rc_limit: Voltage at which the RC buffer takes the count [V].
    """

    edge: float
    coupling: float
    clamp: float
    clamp_drop: float
    divider: float
    actuator_drop: float
    noise: float
    debounce: float
    logic_supply: float
    rc_limit: float


class ChipValues(NamedTuple):
    """Component values of n decoder chips.

    Attributes:
        gains: (2, n) gain from the signal to each detector, rows `PULSES` and `FLAG`.
        upper: (n,) upper threshold of the Schmitt triggers [V].
        lower: (n,) lower threshold of the Schmitt triggers [V].
        rc_lag: (n,) share of a step that the RC buffer takes in one sample.
    """

    gains: FloatArray
    upper: FloatArray
    lower: FloatArray
    rc_lag: FloatArray


class Decoding(NamedTuple):
    """Meaning of a count of pulses, as wired into every chip.

    Attributes:
        spacing: Pulses between neighbouring addresses.
        tolerance: Counts to either side of an address that still mean it.
        singles: Number of commands for one actuator.
        commands: Number of all commands.
        sets: 1 if commands set their actuator, 0 if they toggle it.
        counts: Number of counts after which the counter wraps.
        rc_buffer: 1 if the RC buffer takes the count, 0 if the flag does.
    """

    spacing: int
    tolerance: int
    singles: int
    commands: int
    sets: int
    counts: int
    rc_buffer: int


class BusModel(NamedTuple):
    """Values of a bus that do not change.

    Attributes:
        line: Power line and logic levels.
        chips: Component values of the decoder chips.
        decoding: Meaning of a count of pulses.
    """

    line: LineValues
    chips: ChipValues
    decoding: Decoding


class BusState(NamedTuple):
    """State of a bus with n decoder chips; arrays that `run_chips` writes.

    Attributes:
        line: (2,) voltages of the line and of the coupling capacitor from rest [V].
        voltages: (2, n) voltages of the debouncers [V], rows `PULSES` and `FLAG`.
        waits: (2, n) 1 where a Schmitt trigger waits for its upper threshold, -1 for its lower.
        limits: (2, n) the threshold that it waits for [V].
        capacitors: (n,) voltages of the RC buffers [V].
        counts: (n,) counters.
        latches: (n,) 1 where the actuator is on.
    """

    line: FloatArray
    voltages: FloatArray
    waits: FloatArray
    limits: FloatArray
    capacitors: FloatArray
    counts: IntArray
    latches: IntArray


class LinePieces(NamedTuple):
    """Levels that the master puts on the line, in pieces of constant level.

    Attributes:
        rises: (k,) level of each piece [V].
        lengths: (k,) length of each piece [samples].
        starts: (m + 1,) index of the first piece of each train, and the number of pieces.
    """

    rises: FloatArray
    lengths: IntArray
    starts: IntArray


class Trace(NamedTuple):
    """Signals at the first chip, as an oscilloscope shows them; empty arrays record nothing.

    Attributes:
        time: (s,) time [s].
        line: (s,) voltage of the power line [V]; `run_chips` writes it from rest.
        signal: (s,) signal behind the first divider [V].
        debounced: (s,) voltage into the counter's trigger [V].
        flag: (s,) voltage into the flag's trigger [V].
        counts: (s,) the counter.
        words: (s, n) the latches of all chips.
    """

    time: FloatArray
    line: FloatArray
    signal: FloatArray
    debounced: FloatArray
    flag: FloatArray
    counts: IntArray
    words: BoolArray


@numba.njit(cache=True)
def command_of(pulses, decoding):
    """Return the command that a number of counted address pulses means, 0 if none."""
    half = decoding.spacing // 2
    command = (pulses + half + decoding.tolerance) // decoding.spacing
    away = pulses - (decoding.spacing * command - half)
    known = 1 <= command <= decoding.commands and abs(away) <= decoding.tolerance
    return command if known else 0


@numba.njit(cache=True)
def _act(chip, pulses, decoding, state):
    """Let one chip's latch obey a count of address pulses."""
    command = command_of(pulses, decoding)
    if command > decoding.singles:
        state.latches[chip] = command - decoding.singles - 1
    elif decoding.sets == 0 and command == chip + 1:
        state.latches[chip] ^= 1
    elif decoding.sets == 1 and (command - 1) // 2 == chip:
        state.latches[chip] = command % 2


@numba.njit(cache=True)
def _low_pass(signal, gains, lag, voltages, waits, limits):
    """Advance the chips' debouncers by a sample; return how many triggers are due."""
    due = 0
    for chip in range(voltages.shape[0]):
        voltages[chip] += lag * (signal * gains[chip] - voltages[chip])
        due += waits[chip] * (voltages[chip] - limits[chip]) > 0.0
    return due


@numba.njit(cache=True)
def _trigger(chip, row, chips, state):
    """Turn a Schmitt trigger over if its threshold is passed: 1 up, -1 down, 0 not."""
    waits, limits = state.waits, state.limits
    if waits[row, chip] * (state.voltages[row, chip] - limits[row, chip]) <= 0.0:
        return 0
    rises = waits[row, chip] > 0.0
    waits[row, chip] = -waits[row, chip]
    limits[row, chip] = chips.lower[chip] if rises else chips.upper[chip]
    return 1 if rises else -1


@numba.njit(cache=True)
def _count_and_latch(model, state):
    """Let the triggers that are due count, latch and clear."""
    for chip in range(state.counts.shape[0]):
        if _trigger(chip, PULSES, model.chips, state) == 1:
            state.counts[chip] = (state.counts[chip] + 1) % model.decoding.counts
        if model.decoding.rc_buffer == 1:
            continue
        turn = _trigger(chip, FLAG, model.chips, state)
        if turn == 1:
            # The flag itself was counted before it got here.
            _act(chip, state.counts[chip] - 1, model.decoding, state)
        elif turn == -1:
            state.counts[chip] = 0


@numba.njit(cache=True)
def _charge(model, state):
    """Advance the RC buffers by a sample; return how many took a count."""
    taken = 0
    voltages = state.capacitors
    for chip in range(voltages.shape[0]):
        if state.counts[chip] == 0:
            continue
        voltages[chip] += model.chips.rc_lag[chip] * (model.line.logic_supply - voltages[chip])
        if voltages[chip] > model.line.rc_limit:
            _act(chip, state.counts[chip], model.decoding, state)
            voltages[chip] = 0.0
            state.counts[chip] = 0
            taken += 1
    return taken


@numba.njit(cache=True)
def run_chips(pieces, model, state, rng, trace):
    """Run all chips over all pieces.

    Args:
        pieces: `LinePieces` that the master puts on the line.
        model: `BusModel`.
        state: `BusState`, which is changed.
        rng: Random generator for the signal's noise.
        trace: `Trace`, which is filled as far as it is not empty.

    Returns:
        (m, n) the latches after each train.
    """
    values, decoding, line = model.line, model.decoding, state.line
    words = np.zeros((pieces.starts.shape[0] - 1, state.latches.shape[0]), dtype=np.bool_)
    drop = values.actuator_drop * state.latches.sum()
    at = 0
    for train in range(pieces.starts.shape[0] - 1):
        for piece in range(pieces.starts[train], pieces.starts[train + 1]):
            for _ in range(pieces.lengths[piece]):
                line[0] += values.edge * (pieces.rises[piece] - drop - line[0])
                voltage = line[0]
                if values.noise > 0.0:
                    voltage += values.noise * values.divider * rng.standard_normal()
                low = (voltage - line[1]) / values.divider < -values.clamp_drop
                # While it conducts, the diode holds the signal at its drop below zero.
                target = voltage + values.clamp_drop * values.divider if low else voltage
                line[1] += (values.clamp if low else values.coupling) * (target - line[1])
                signal = (voltage - line[1]) / values.divider
                due = 0
                for row in range(2 - decoding.rc_buffer):
                    due += _low_pass(
                        signal, model.chips.gains[row], values.debounce, state.voltages[row],
                        state.waits[row], state.limits[row],
                    )  # fmt: skip
                if due > 0:
                    _count_and_latch(model, state)
                if decoding.rc_buffer == 1:
                    due += _charge(model, state)
                if due > 0:
                    drop = values.actuator_drop * state.latches.sum()
                if trace.line.shape[0] > 0:
                    trace.line[at], trace.signal[at] = voltage, signal
                    trace.debounced[at] = state.voltages[PULSES, 0]
                    trace.flag[at], trace.counts[at] = state.voltages[FLAG, 0], state.counts[0]
                    trace.words[at] = state.latches == 1
                    at += 1
        words[train] = state.latches == 1
    return words
