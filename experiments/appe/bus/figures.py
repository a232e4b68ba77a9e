"""Figures of ``appe-bus``."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.bus.circuit import BusCircuit, Trace
from experiments.appe.bus.trial import FATES, PROTOCOLS, BusTrial

COLOURS = {
    "thesis": "tab:red",
    "parity": "tab:blue",
    "repeat": "tab:green",
    "correct": "tab:purple",
}
_FAULTS = {
    "missed": "one pulse missed in each word",
    "extra": "one pulse too many in each word",
    "missed_flag": "one flag missed in each word",
}
_FATE_COLOURS = {"right": "0.85", "told": "tab:blue", "skipped": "tab:orange", "wrong": "tab:red"}
_FATE_LABELS = {
    "right": "right",
    "told": "wrong, the master knows",
    "skipped": "actuators did not move",
    "wrong": "wrong actuators moved",
}


def draw_waveform(traces: Mapping[str, Trace], circuit: BusCircuit) -> Figure:
    """Draw what an oscilloscope sees at the first chip, and what the decoders make of it.

    Args:
        traces: By title, side by side.
        circuit: Its thresholds are drawn.
    """
    figure = Figure(figsize=(7 * len(traces), 9))
    half = circuit.hysteresis / 2
    for column, (title, trace) in enumerate(traces.items()):
        rows = [figure.add_subplot(5, len(traces), 1 + column + len(traces) * r) for r in range(5)]
        time = 1e3 * trace.time
        rows[0].plot(time, trace.line, color="k", linewidth=0.8)
        rows[0].set(title=title, ylabel="power line [V]")
        rows[1].plot(time, trace.signal, color="0.6", linewidth=0.8, label="divided")
        rows[1].plot(time, trace.debounced, color="tab:blue", linewidth=0.9, label="debounced")
        rows[1].set(ylabel="to counter [V]")
        if column == 0:
            rows[1].legend(fontsize="small", loc="upper center")  # between the flags
        rows[2].plot(time, trace.flag, color="tab:orange", linewidth=0.9)
        rows[2].set(ylabel="to buffer [V]")
        for axes in rows[1:3]:
            axes.axhspan(circuit.threshold - half, circuit.threshold + half, color="tab:red")
            axes.patches[-1].set_alpha(0.2)
        rows[3].step(time, trace.count, where="post", color="tab:blue")
        rows[3].set(ylabel="counter")
        for actuator, states in enumerate(trace.words.T):
            if states.any():
                ends, on = (actuator + 0.1, actuator + 0.9), states > 0
                rows[4].fill_between(time, *ends, where=on, color=f"C{actuator}", linewidth=0)
        rows[4].set(ylabel="actuator on", xlabel="time [ms]", ylim=(0.0, 6.0))
        rows[4].set_yticks(np.arange(6) + 0.5, [str(actuator) for actuator in range(6)])
        for axes in rows:
            axes.grid(alpha=0.3)
            axes.set_xlim(0.0, time[-1])
    figure.tight_layout()
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
    figure.tight_layout(rect=(0.0, 0.07, 1.0, 1.0))
    return figure


def draw_rates(
    noise: Sequence[BusTrial], missed: Sequence[BusTrial], extra: Sequence[BusTrial]
) -> Figure:
    """Draw the share of words that are not right against noise and fault rates."""
    figure = Figure(figsize=(15, 4.5))
    panels = (
        (noise, "noise", "noise on the signal, each sample [V rms]"),
        (missed, "missed", "probability that a pulse is missed [-]"),
        (extra, "extra", "probability of an extra pulse [-]"),
    )
    for index, (rows, key, label) in enumerate(panels):
        axes = figure.add_subplot(1, 3, index + 1)
        for name in PROTOCOLS:
            for buffer, style in (("flag", "o-"), ("rc", "s:")):
                chosen = [
                    r for r in rows if r.config.protocol == name and r.config.buffer == buffer
                ]
                if not chosen:
                    continue
                shares = [1.0 - row.fates["right"] / row.sent for row in chosen]
                wide = name if buffer == "flag" else f"{name}, RC buffer"
                places = [getattr(row.config, key) for row in chosen]
                axes.plot(places, shares, style, color=COLOURS[name], label=wide)
        lowest = 1.0 / max(row.sent for row in rows)
        axes.set_yscale("symlog", linthresh=lowest)
        axes.set(xlabel=label, ylabel="words not right [-]", ylim=(-0.1 * lowest, 1.5))
        if key != "noise":
            axes.set_xscale("log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small")
    figure.tight_layout()
    return figure


def draw_lasting(rows: Sequence[BusTrial], spread: Sequence[BusTrial]) -> Figure:
    """Draw how wrong bits gather where words follow each other, and the RC buffer's spread."""
    figure = Figure(figsize=(12, 4.5))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for name in PROTOCOLS:
        runs = np.array([row.wrong_bits for row in rows if row.config.protocol == name])
        left.plot(np.arange(1, runs.shape[1] + 1), runs.mean(0), color=COLOURS[name], label=name)
    left.set(xlabel="words sent", ylabel="wrong bits of 15, mean over runs")
    left.set_title(f"a pulse in {1.0 / rows[0].config.missed:.0f} is missed")
    left.legend()
    for margin in dict.fromkeys(row.config.margin for row in spread):
        chosen = [row for row in spread if row.config.margin == margin]
        shares = [1.0 - row.fates["right"] / row.sent for row in chosen]
        right.plot([row.config.rc_sigma for row in chosen], shares, "o-", label=f"{margin:g}")
    right.set(xlabel="spread of RC from chip to chip [-]", ylabel="words not right [-]")
    right.set_title("RC buffer, no noise and no faults")
    right.legend(title="delay / longest train")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def draw_durations(durations: Mapping[str, Mapping[int, np.ndarray]]) -> Figure:
    """Draw how long a change between random words takes, by protocol and number of actuators."""
    figure = Figure(figsize=(8, 4.5))
    axes = figure.add_subplot()
    for index, (name, by_count) in enumerate(durations.items()):
        places = np.arange(len(by_count)) + 0.15 * (index - (len(durations) - 1) / 2)
        middles = np.array([1e3 * np.median(times) for times in by_count.values()])
        ends = np.array([1e3 * np.percentile(t, (2.5, 97.5)) for t in by_count.values()]).T
        error = [middles - ends[0], ends[1] - middles]
        protocol, _, buffer = name.partition(",")
        mark = "s" if buffer else "o"
        colour = COLOURS[protocol]
        axes.errorbar(places, middles, error, fmt=mark, color=colour, capsize=3, label=name)
        axes.set_xticks(np.arange(len(by_count)), [str(count) for count in by_count])
    axes.set(xlabel="actuators", ylabel="time for a change of word [ms]", yscale="log")
    axes.grid(alpha=0.3, which="both")
    axes.legend()
    return figure
