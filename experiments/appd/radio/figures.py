"""Figures of ``appd-radio``."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from experiments.appd.radio.demo import ROBOTS, Conversation
from experiments.appd.radio.trial import FATES, LINKS, PooledTrials, RadioTrial
from experiments.harness.figure_style import BLUE, COLOURS, ORANGE, RED

_FATE_COLOURS = {"intact": "0.8", "wrong": RED, "vanished": ORANGE, "given_up": "0.3"}
_FATE_LABELS = {
    "intact": "intact",
    "wrong": "wrong, not reported",
    "vanished": "vanished, reported as delivered",
    "given_up": "given up, reported to the sender",
}
_ROVER_COLOURS = dict(zip(ROBOTS, (BLUE, ORANGE)))
_SHOWN = 20.0  # [s] of the first trial
_BLOCK = 100  # ticks over which the line's occupation is averaged


def draw_fates(rows: Sequence[PooledTrials]) -> Figure:
    """Draw what became of the messages, for each link and error rate."""
    figure = Figure(figsize=(9, 4))
    for link, axes in zip(LINKS, figure.subplots(1, 2)):
        chosen = [row for row in rows if row.link == link]
        places, bottom = np.arange(len(chosen)), np.zeros(len(chosen))
        for fate in FATES:
            shares = np.array([100.0 * getattr(row, fate) / row.sent for row in chosen])
            axes.bar(
                places, shares, bottom=bottom, color=_FATE_COLOURS[fate], label=_FATE_LABELS[fate]
            )
            bottom += shares
        axes.set_xticks(places, [f"{row.error_rate:g}" for row in chosen])
        axes.set(title=link, xlabel="byte error rate [-]", ylabel="messages [%]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False)
    figure.set_layout_engine("tight", rect=(0.0, 0.07, 1.0, 1.0))
    return figure


def draw_goodput(rates: Sequence[PooledTrials], delays: Sequence[PooledTrials]) -> Figure:
    """Draw goodput over the byte error rate, and over the modems' delay at one of them."""
    figure = Figure(figsize=(10, 4))
    left, right = figure.subplots(1, 2)
    for link in LINKS:
        rows = [row for row in rates if row.link == link]
        keys = ("low", "median", "high")
        low, middle, high = np.array([[row.goodput[key] for row in rows] for key in keys])
        interval, places = (middle - low, high - middle), np.arange(len(rows))
        left.errorbar(
            places, middle, interval, fmt="o-", capsize=3, color=COLOURS[link], label=link
        )
        left.set_xticks(places, [f"{row.error_rate:g}" for row in rows])
        rows = [row for row in delays if row.link == link]
        right.plot(
            [1e3 * row.delay for row in rows],
            [row.goodput["median"] for row in rows],
            "o-",
            color=COLOURS[link],
            label=link,
        )
    left.set(xlabel="byte error rate [-]", ylabel="intact payload [bytes/s]")
    right.set(xlabel="delay of the modems, one way [ms]", ylabel="intact payload [bytes/s]")
    right.set_title(f"byte error rate {delays[0].error_rate:g}")
    for axes in (left, right):
        axes.set_yscale("log")
        axes.axhline(960.0, color="k", linestyle="--", linewidth=0.8, label="line")
        axes.grid(alpha=0.3, which="both")
    left.legend(title="median, 95 % interval")
    right.legend(title="median")
    return figure


def draw_progress(trials: Sequence[RadioTrial]) -> Figure:
    """Draw the first seconds of one trial of each link: what arrived, wrong messages and stalls."""
    figure = Figure(figsize=(10, 6))
    for trial, axes in zip(trials, figure.subplots(len(trials), 1)):
        arrival = np.sort(trial.arrival[trial.arrival <= _SHOWN])
        axes.step(arrival, np.arange(1, arrival.size + 1), where="post", color="0.4")
        for key, style, label in (
            ("wrong_at", "rX", "wrong message handed over"),
            ("stall_at", "kv", "stalled until the deadline"),
        ):
            times = getattr(trial, key)
            times = times[times <= _SHOWN]
            height = np.searchsorted(arrival, times, side="right")
            axes.plot(times, height, style, markersize=6, label=f"{label}: {times.size}")
        axes.set(title=trial.link, xlabel="time [s]", ylabel="intact messages", xlim=(0, _SHOWN))
        axes.legend(loc="upper left")
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def draw_latency(trials: Mapping[str, Sequence[RadioTrial]]) -> Figure:
    """Draw the share of all messages that arrived intact within a time, a message a second."""
    figure = Figure(figsize=(10, 4))
    for link, axes in zip(LINKS, figure.subplots(1, 2)):
        for trial in trials[link]:
            times = np.sort(trial.latency)
            shares = np.arange(1, times.size + 1) / trial.sent
            ends = np.append(1e3 * times, 2000.0), np.append(shares, shares[-1])
            axes.step(*ends, where="post", label=f"{trial.error_rate:g}")
        axes.set(title=link, xlabel="within [ms]", ylabel="arrived intact [-]", xlim=(20, 2000))
        axes.set(ylim=(0.0, 1.02), xscale="log")
        axes.legend(title="byte error rate")
        axes.grid(alpha=0.3, which="both")
    return figure


def draw_conversation(result: Conversation, period: float) -> Figure:
    """Draw what each rover knows of the other against time.

    Args:
        result: Result of `experiments.appd.radio.demo.converse`.
        period: Period of the loop [s].
    """
    figure = Figure(figsize=(10, 11))
    paths, age, force, line = figure.subplots(4, gridspec_kw={"height_ratios": (2, 1, 1, 0.8)})
    truth = result.truth
    most = max(float(np.nanmax(result.rovers[name].age)) for name in ROBOTS)
    for index, (name, other) in enumerate(zip(ROBOTS, reversed(ROBOTS))):
        colour, own, heard = _ROVER_COLOURS[name], result.rovers[name], result.rovers[other]
        paths.plot(*truth[:, 1 + 2 * index : 3 + 2 * index].T, "k:", linewidth=1.0)
        paths.plot(*own.sent[:, 1:].T, color=colour, linewidth=0.8, label=f"{name}, own estimate")
        positions = heard.received
        paths.plot(*positions[:, 2:].T, ".", color=colour, label=f"{name}, received by {other}")
        age.plot(truth[:, 0], 1e3 * heard.age, color=colour, linewidth=0.8)
        lost = _lost(own.sent[:, 0], positions[:, 1])
        age.plot(lost, np.zeros(lost.size), "x", color=colour, label=f"{name}: {lost.size} lost")
        force.plot(*own.measured.T, color=colour, linewidth=0.8, label=f"{name}, as sent")
        force.plot(*heard.forces[:, ::2].T, ".", color=colour, label=f"received by {other}")
        starts = own.bytes_sent[::_BLOCK]
        share = 100.0 * np.diff(starts) / (960.0 * _BLOCK * period)
        ends = truth[::_BLOCK, 0][1:]
        line.step(ends, share, where="pre", color=colour, label=f"{name} sends")
    paths.plot([], [], "k:", label="truth (for this figure only)")
    paths.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    age.set(ylabel="age of the known pose [ms]", ylim=(-50.0, 1300.0 * most))
    force.set(ylabel="vertical force on the arm [N]")
    line.set(xlabel="time [s]", ylabel="line in use [%]", ylim=(0.0, 50.0))
    for axes in (paths, age, force, line):
        if axes is not paths:
            axes.set_xlim(0.0, truth[-1, 0])
        place = "upper center" if axes is paths else "upper right"
        axes.legend(loc=place, ncols=1 if axes is paths else 2)
        axes.grid(alpha=0.3)
    figure.tight_layout()
    return figure


def _lost(sent: np.ndarray, received: np.ndarray) -> np.ndarray:
    """Return the times of what was sent and not received, but for what is on its way at the end."""
    done = sent[sent < sent[-1]]
    return done[~np.isin(np.round(1e3 * done), np.round(1e3 * received))]
