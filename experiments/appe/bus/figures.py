"""Figures of ``appe-bus``."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.bus.circuit import BusCircuit
from controllers.braid.bus.decoder_chips import Trace
from experiments.appe.bus.trial import FATES, PROTOCOLS, BusTrial
from experiments.harness.figure_style import BLUE, GREEN, ORANGE, PURPLE, RED

COLOURS = {
    "thesis": RED,
    "parity": BLUE,
    "repeat": GREEN,
    "correct": PURPLE,
}
_FAULTS = {
    "missed": "one pulse missed in each word",
    "extra": "one pulse too many in each word",
    "missed_flag": "one flag missed in each word",
}
_FATE_COLOURS = {
    "right": "0.85",
    "told": BLUE,
    "skipped": ORANGE,
    "wrong": RED,
}
_FATE_LABELS = {
    "right": "right",
    "told": "wrong, the master knows",
    "skipped": "actuators did not move",
    "wrong": "wrong actuators moved",
}


def draw_waveform(traces: Mapping[str, Trace], circuit: BusCircuit) -> Figure:
    """Draw what an oscilloscope sees at the first chip, and what the decoders make of it.

    Args:
        traces: Traces by title, side by side.
        circuit: Circuit whose thresholds are drawn.
    """
    figure = Figure(figsize=(7 * len(traces), 9), layout="tight")
    grid = figure.subplots(5, len(traces), squeeze=False)
    half = circuit.hysteresis / 2
    for (line, counter, buffer, count, word), (title, trace) in zip(grid.T, traces.items()):
        time = 1e3 * trace.time
        line.plot(time, trace.line, color="k", linewidth=0.8)
        line.set(title=title, ylabel="power line [V]")
        counter.plot(time, trace.signal, color="0.6", linewidth=0.8, label="divided")
        counter.plot(time, trace.debounced, color=BLUE, linewidth=0.9, label="debounced")
        counter.set(ylabel="to counter [V]")
        buffer.plot(time, trace.flag, color=ORANGE, linewidth=0.9)
        buffer.set(ylabel="to buffer [V]")
        for axes in (counter, buffer):
            thresholds = (circuit.threshold - half, circuit.threshold + half)
            axes.axhspan(*thresholds, color=RED, alpha=0.2)
        count.step(time, trace.counts, where="post", color=BLUE)
        count.set(ylabel="counter")
        for actuator in np.flatnonzero(trace.words.any(axis=0)):
            ends, on = (actuator + 0.1, actuator + 0.9), trace.words[:, actuator]
            word.fill_between(time, *ends, where=on, color=f"C{actuator}", linewidth=0)
        word.set(ylabel="actuator on", xlabel="time [ms]", ylim=(0.0, 6.0))
        word.set_yticks(np.arange(6) + 0.5, [str(actuator) for actuator in range(6)])
        for axes in (line, counter, buffer, count, word):
            axes.grid(alpha=0.3)
            axes.set_xlim(0.0, time[-1])
    grid[1, 0].legend(loc="upper center")  # between the flags
    return figure


def draw_faults(rows: Sequence[BusTrial]) -> Figure:
    """Draw what became of words that one fault befell, for each kind of fault and protocol."""
    kinds = list(dict.fromkeys(row.config.fault for row in rows))
    figure = Figure(figsize=(4 * len(kinds), 4.4))
    for index, kind in enumerate(kinds):
        axes = figure.add_subplot(1, len(kinds), index + 1)
        chosen = [row for row in rows if row.config.fault == kind]
        bottom = np.zeros(len(chosen))
        for fate in FATES:
            shares = np.array([100.0 * row.fates[fate] / row.sent for row in chosen])
            colour, label = _FATE_COLOURS[fate], _FATE_LABELS[fate]
            axes.bar(np.arange(len(chosen)), shares, bottom=bottom, color=colour, label=label)
            bottom += shares
        axes.set_xticks(np.arange(len(chosen)), [row.config.protocol for row in chosen])
        axes.set(title=_FAULTS.get(kind, kind), ylabel="words [%]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False)
    figure.set_layout_engine("tight", rect=(0.0, 0.07, 1.0, 1.0))
    return figure


def draw_rates(found: Mapping[str, Sequence[BusTrial]]) -> Figure:
    """Draw the share of words that are not right against noise and fault rates.

    Args:
        found: Trials by what varies: "noise", "missed" and "extra".
    """
    labels = {
        "noise": "noise on the signal, each sample [V rms]",
        "missed": "probability that a pulse is missed [-]",
        "extra": "probability of an extra pulse [-]",
    }
    figure = Figure(figsize=(15, 4.5), layout="tight")
    for axes, (key, label) in zip(figure.subplots(1, 3), labels.items()):
        curves: dict[tuple[str, str], list[BusTrial]] = {}
        for row in found[key]:
            curves.setdefault((row.config.protocol, row.config.buffer), []).append(row)
        for (name, buffer), rows in curves.items():
            rates = [getattr(row.config, key) for row in rows]
            full, style = (name, "o-") if buffer == "flag" else (f"{name}, RC buffer", "s:")
            axes.plot(rates, _wrong_shares(rows), style, color=COLOURS[name], label=full)
        lowest = 1.0 / max(row.sent for row in found[key])
        axes.set_yscale("symlog", linthresh=lowest)
        axes.set(xlabel=label, ylabel="words not right [-]", ylim=(-0.1 * lowest, 1.5))
        if key != "noise":
            axes.set_xscale("log")
        axes.grid(alpha=0.3)
        axes.legend()
    return figure


def _wrong_shares(rows: Sequence[BusTrial]) -> list[float]:
    return [row.wrong / row.sent for row in rows]


def draw_lasting(rows: Sequence[BusTrial], scattered: Sequence[BusTrial]) -> Figure:
    """Draw how wrong bits gather where words follow each other, and the RC buffers' scatter."""
    figure = Figure(figsize=(12, 4.5), layout="tight")
    left, right = figure.subplots(1, 2)
    for name in PROTOCOLS:
        runs = np.array([row.wrong_bits for row in rows if row.config.protocol == name])
        left.plot(np.arange(1, runs.shape[1] + 1), runs.mean(0), color=COLOURS[name], label=name)
    left.set(xlabel="words sent", ylabel="wrong bits of 15, mean over runs")
    left.set_title(f"a pulse in {1.0 / rows[0].config.missed:.0f} is missed")
    left.legend()
    for margin in dict.fromkeys(row.config.margin for row in scattered):
        chosen = [row for row in scattered if row.config.margin == margin]
        sigmas = [row.config.rc_sigma for row in chosen]
        right.plot(sigmas, _wrong_shares(chosen), "o-", label=f"{margin:g}")
    right.set(xlabel="standard deviation of RC from chip to chip [-]", ylabel="words not right [-]")
    right.set_title("RC buffer, no noise and no faults")
    right.legend(title="delay / longest train")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def draw_durations(durations: Mapping[str, Mapping[int, np.ndarray]]) -> Figure:
    """Draw how long a change between random words takes, by protocol and number of actuators."""
    figure = Figure(figsize=(8, 4.5), layout="tight")
    axes = figure.add_subplot()
    for index, (name, by_count) in enumerate(durations.items()):
        at = np.arange(len(by_count)) + 0.15 * (index - (len(durations) - 1) / 2)
        times = 1e3 * np.array(list(by_count.values()))
        low, middle, high = np.percentile(times, (2.5, 50.0, 97.5), axis=1)
        protocol, _, buffer = name.partition(",")
        mark, error = "s" if buffer else "o", [middle - low, high - middle]
        axes.errorbar(at, middle, error, fmt=mark, color=COLOURS[protocol], capsize=3, label=name)
        axes.set_xticks(np.arange(len(by_count)), [str(count) for count in by_count])
    axes.set(xlabel="actuators", ylabel="time for a change of word [ms]", yscale="log")
    axes.grid(alpha=0.3, which="both")
    axes.legend(title="median, and 95 % of the changes")
    return figure
