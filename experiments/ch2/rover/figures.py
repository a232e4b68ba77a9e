"""Figures 2-9 to 2-12: arm motion, inclinometer reading and convergence on the rover."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.pitch import NAMES, UNITS
from experiments.ch2.rover.trial import RoverIdentification

Results = Mapping[str, list[RoverIdentification]]

COLOURS = {"constant": "tab:red", "information": "tab:blue"}


def draw_arm_motion(trial: RoverIdentification, excitation: str) -> Figure:
    """Draw the shoulder angle over time (Thesis figures 2-9 and 2-10)."""
    figure = Figure(figsize=(7, 3))
    axes = figure.subplots()
    angle = np.asarray(trial.shoulder)
    axes.plot(np.arange(len(angle)) * 0.01, np.rad2deg(angle), color=COLOURS.get(excitation))
    axes.set(xlabel="time [s]", ylabel="shoulder angle [deg]", title=f"{excitation} excitation")
    axes.grid(alpha=0.3)
    return figure


def draw_tilt(results: Results) -> Figure:
    """Draw the inclinometer's pitch under each excitation (Thesis figure 2-11)."""
    figure = Figure(figsize=(7, 1.8 * len(results)))
    rows = figure.subplots(len(results), 1, sharex=True, squeeze=False)
    for axes, (excitation, trials) in zip(rows[:, 0], results.items()):
        trial = trials[0]
        axes.plot(trial.tilt_times, trial.tilt, color=COLOURS.get(excitation, "grey"), lw=1)
        axes.set(ylabel="pitch [rad]", title=excitation)
        axes.grid(alpha=0.3)
    rows[-1, 0].set_xlabel("time [s]")
    figure.tight_layout()
    return figure


def draw_convergence(results: Results, truth: Mapping[str, float]) -> Figure:
    """Draw the estimates over time with the band of the seeds (Thesis figure 2-12)."""
    figure = Figure(figsize=(12, 6))
    grid = figure.subplots(2, 3)
    shown = [name for name in ("constant", "information") if name in results] or list(results)
    for index, (name, unit) in enumerate(zip(NAMES, UNITS)):
        axes = grid.flat[index]
        for excitation in shown:
            histories = np.array([trial.history for trial in results[excitation]])[:, :, index]
            times = REPLAN_PERIOD * np.arange(1, histories.shape[1] + 1)
            low, median, high = np.percentile(histories, [10, 50, 90], axis=0)
            colour = COLOURS.get(excitation, "grey")
            axes.plot(times, median, color=colour, label=excitation)
            axes.fill_between(times, low, high, color=colour, alpha=0.2, lw=0)
        true = truth[name]
        axes.axhline(true, color="black", ls="--", lw=1, label="laboratory")
        axes.set_ylim(min(-true, 0) if name in ("ry", "rz") else 0, 3 * true)
        axes.set(title=name, ylabel=unit, xlabel="time [s]")
        axes.grid(alpha=0.3)
    grid.flat[0].legend(fontsize=8)
    grid.flat[-1].axis("off")
    figure.suptitle("Convergence: median of the seeds and the band of 80 % of them")
    figure.tight_layout()
    return figure


def draw_errors(results: Results, truth: Mapping[str, float]) -> Figure:
    """Draw the average error of every run by excitation, on a logarithmic scale."""
    figure = Figure(figsize=(7, 3.5))
    axes = figure.subplots()
    true = np.array([truth[name] for name in NAMES])
    errors = [
        [100 * np.mean(np.abs(trial.parameters - true) / true) for trial in trials]
        for trials in results.values()
    ]
    axes.boxplot(errors, tick_labels=list(results))
    axes.axhline(10, color="grey", ls=":", label="10 %")
    axes.set(yscale="log", ylabel="average error of five parameters [%]")
    axes.grid(alpha=0.3, axis="y", which="both")
    axes.legend()
    return figure
