"""Samples of the power line through every decoder chip (E.4), compiled."""

from __future__ import annotations

import numba

# Rows of the chips' logic, of their voltages and triggers, and of their component values.
COUNT, LATCH, REFUSED = range(3)
PULSES, FLAG, CAPACITOR = range(3)
UPPER, LOWER, RC_LAG = 2, 3, 4  # After the gains of both paths.


@numba.njit(cache=True)
def _act(chip, pulses, decoding, logic):
    """Let one chip's latch obey a count of address pulses."""
    spacing, tolerance, singles, commands, sets = decoding[:5]
    if pulses <= 0:
        return
    half = spacing // 2
    command = (pulses + half + tolerance) // spacing
    away = pulses - (spacing * command - half)
    if command < 1 or command > commands or abs(away) > tolerance:
        logic[REFUSED, chip] += 1
    elif command > singles:
        logic[LATCH, chip] = command - singles - 1
    elif sets == 0 and command == chip + 1:
        logic[LATCH, chip] ^= 1
    elif sets == 1 and (command - 1) // 2 == chip:
        logic[LATCH, chip] = command % 2


@numba.njit(cache=True)
def _low_pass(signal, gains, lag, voltages, waits, limits):
    """Advance the chips' debouncers by a sample; how many triggers are due."""
    due = 0
    for chip in range(voltages.shape[0]):
        voltages[chip] += lag * (signal * gains[chip] - voltages[chip])
        due += waits[chip] * (voltages[chip] - limits[chip]) > 0.0
    return due


@numba.njit(cache=True)
def _trigger(chip, row, chips, voltages, waits, limits):
    """Turn a Schmitt trigger over if its threshold is passed: 1 up, -1 down, 0 not."""
    if waits[row, chip] * (voltages[row, chip] - limits[row, chip]) <= 0.0:
        return 0
    rises = waits[row, chip] > 0.0
    waits[row, chip] = -waits[row, chip]
    limits[row, chip] = chips[LOWER, chip] if rises else chips[UPPER, chip]
    return 1 if rises else -1


@numba.njit(cache=True)
def _count_and_latch(chips, decoding, voltages, waits, limits, logic):
    """Let the triggers that are due count, latch and clear."""
    for chip in range(chips.shape[1]):
        if _trigger(chip, PULSES, chips, voltages, waits, limits) == 1:
            logic[COUNT, chip] = (logic[COUNT, chip] + 1) % decoding[5]
        if decoding[6] == 1:
            continue
        turn = _trigger(chip, FLAG, chips, voltages, waits, limits)
        if turn == 1:
            # The flag itself was counted before it got here.
            _act(chip, logic[COUNT, chip] - 1, decoding, logic)
        elif turn == -1:
            logic[COUNT, chip] = 0


@numba.njit(cache=True)
def _charge(chips, decoding, threshold, logic_supply, voltages, logic):
    """Advance the RC buffers by a sample; how many took a count."""
    taken = 0
    for chip in range(chips.shape[1]):
        if logic[COUNT, chip] == 0:
            continue
        voltages[chip] += chips[RC_LAG, chip] * (logic_supply - voltages[chip])
        if voltages[chip] > threshold:
            _act(chip, logic[COUNT, chip], decoding, logic)
            voltages[chip] = 0.0
            logic[COUNT, chip] = 0
            taken += 1
    return taken


@numba.njit(cache=True)
def run_chips(
    rises,
    lengths,
    starts,
    values,
    chips,
    decoding,
    line,
    voltages,
    waits,
    limits,
    logic,
    rng,
    words,
    rows,
    trace_words,
):
    """Run all chips over all pieces; fill the words after each train and, if wanted, the trace."""
    edge, couple, clamp, clamp_drop, divider, drop_each, noise, lag, logic_supply, rc_limit = values
    drop = drop_each * logic[LATCH].sum()
    at = 0
    for train in range(starts.shape[0] - 1):
        for piece in range(starts[train], starts[train + 1]):
            for _ in range(lengths[piece]):
                line[0] += edge * (rises[piece] - drop - line[0])
                voltage = line[0]
                if noise > 0.0:
                    voltage += noise * divider * rng.standard_normal()
                low = (voltage - line[1]) / divider < -clamp_drop
                # While it conducts, the diode holds the signal at its drop below zero.
                target = voltage + clamp_drop * divider if low else voltage
                line[1] += (clamp if low else couple) * (target - line[1])
                signal = (voltage - line[1]) / divider
                due = 0
                for row in range(2 - decoding[6]):
                    due += _low_pass(
                        signal, chips[row], lag, voltages[row], waits[row], limits[row]
                    )
                if due > 0:
                    _count_and_latch(chips, decoding, voltages, waits, limits, logic)
                if decoding[6] == 1:
                    due += _charge(
                        chips, decoding, rc_limit, logic_supply, voltages[CAPACITOR], logic
                    )
                if due > 0:
                    drop = drop_each * logic[LATCH].sum()
                if rows.shape[0] > 0:
                    rows[at, 0], rows[at, 1] = voltage, signal
                    rows[at, 2], rows[at, 3] = voltages[PULSES, 0], voltages[FLAG, 0]
                    rows[at, 4] = logic[COUNT, 0]
                    trace_words[at] = logic[LATCH] == 1
                    at += 1
        words[train] = logic[LATCH] == 1
