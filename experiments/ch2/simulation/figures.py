"""Figures 2-4 to 2-7 of the thesis, and an overview of the errors."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controllers.identification.arm_motion import MODES
from controllers.identification.excitation import REPLAN_PERIOD
from controllers.identification.parameters import NAMES, UNITS
from experiments.ch2.simulation.results import (
    ESTIMATORS,
    Results,
    errors,
    excitations,
    noises,
    shown_group,
)
from experiments.ch2.simulation.trial import PlantIdentification
from experiments.harness.figure_style import COLOURS, plain_name
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray

CONVERGENCE = ("ry", "rz", "mass", "ixx", "by", "k_pitch", "ky")
"""The parameters of Thesis fig. 2-7, in its order."""
TITLES = {
    "ry": "(a) c.g. y",
    "rz": "(b) c.g. z",
    "mass": "(c) base mass",
    "ixx": "(d) inertia x",
    "by": "(e) damping y",
    "k_pitch": "(f) stiffness pitch",
    "ky": "(g) stiffness y",
}


def draw_figures(groups: Results, output: Output) -> None:
    """Write all figures that the trials allow."""
    noise, excitation = shown_group(groups)
    if (noise, "constant") in groups:
        trial = groups[noise, "constant"][0]
        output.figure("figure_2-4", draw_motion(trial, "Constant parameter arm motion"))
    title = f"Variable parameter arm motion ({excitation}, {noise} noise)"
    output.figure("figure_2-5", draw_motion(groups[noise, excitation][0], title))
    output.figure("figure_2-6", draw_information(groups, noise))
    output.figure("figure_2-7", draw_convergence(groups[noise, excitation], excitation))
    if (noise, "constant") in groups and excitation != "constant":
        figure = draw_convergence(groups[noise, "constant"], "constant")
        output.figure("figure_2-7_constant", figure)
    output.figure("overview_errors", draw_overview(groups))


def draw_motion(trial: PlantIdentification, title: str) -> Figure:
    """Draw the arm's angle in the three rotations (Thesis fig. 2-4, 2-5)."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True, sharey=True)
    angles = trial.arm_angles
    times = np.linspace(0, _duration(trial), angles.shape[1])
    for mode, row, ax in zip(MODES, angles, axes):
        ax.plot(times, np.degrees(row), color=COLOURS["ours"], linewidth=0.9)
        ax.set_ylabel(f"mode {mode} [deg]")
        ax.grid(alpha=0.3)
    axes[-1].set_xlabel("time [s]")
    figure.suptitle(title)
    return figure


def draw_information(groups: Results, noise: str) -> Figure:
    """Draw the information on the pitch stiffness (Thesis fig. 2-6)."""
    figure = Figure(figsize=(6.5, 4), layout="constrained")
    ax = figure.subplots()
    index = NAMES.index("k_pitch")
    for excitation in excitations(groups, noise):
        if excitation not in COLOURS:
            continue
        trials = groups[noise, excitation]
        bits = np.array([trial.bits[:, index] for trial in trials])
        colour = COLOURS[excitation]
        _band(ax, _times(trials[0]), bits, colour, f"{excitation} excitation")
    ax.set(xlabel="time [s]", ylabel="mutual information [bit]", ylim=(0, None))
    ax.set_title(f"Information on the stiffness about the pitch axis, {noise} noise")
    ax.grid(alpha=0.3)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(title="median, 5 to 95 % of the runs")
    return figure


def draw_convergence(trials: list[PlantIdentification], excitation: str) -> Figure:
    """Draw how the estimates converge (Thesis fig. 2-7)."""
    figure = Figure(figsize=(10, 10), layout="constrained")
    axes = figure.subplots(4, 2).ravel()
    times = _times(trials[0])
    for name, ax in zip(CONVERGENCE, axes):
        index = NAMES.index(name)
        for estimator in ("kalman", "ours"):
            paths = np.array([trial.histories[estimator][:, index] for trial in trials])
            _band(ax, times, paths, COLOURS[estimator], plain_name(estimator))
        truths = {float(trial.truth[index]) for trial in trials}
        for truth in truths if len(truths) == 1 else ():
            ax.axhline(truth, color="black", linestyle="--", linewidth=1, label="true")
        ax.set(title=TITLES[name], ylabel=f"[{UNITS[index]}]", xlabel="time [s]")
        ax.grid(alpha=0.3)
    handles, labels = axes[0].get_legend_handles_labels()
    axes[-1].axis("off")
    axes[-1].legend(handles, labels, loc="center", title="median, 5 to 95 % of the runs")
    figure.suptitle(f"Convergence under {excitation} excitation, {len(trials)} runs")
    return figure


def draw_overview(groups: Results) -> Figure:
    """Draw the average errors of all runs by excitation and estimator."""
    rows = noises(groups)
    count = max(len(excitations(groups, noise)) for noise in rows)
    figure = Figure(figsize=(max(6.0, 1.6 * count), 3.6 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), 1, squeeze=False, sharey=True)[:, 0]
    for noise, ax in zip(rows, axes):
        names = excitations(groups, noise)
        for offset, estimator in enumerate(ESTIMATORS):
            samples = [errors(groups, noise, name, estimator) for name in names]
            places = np.arange(len(names)) + 0.26 * (offset - 1)
            boxes = ax.boxplot(
                samples, positions=places, widths=0.22, patch_artist=True, manage_ticks=False,
                medianprops={"color": "black"}, flierprops={"markersize": 2},
            )  # fmt: skip
            for box in boxes["boxes"]:
                box.set(facecolor=COLOURS[estimator], alpha=0.75)
            ax.plot([], [], color=COLOURS[estimator], linewidth=6, label=plain_name(estimator))
        ax.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names])
        ax.set(yscale="log", ylabel="average error [%]", title=f"{noise} noise")
        ax.grid(axis="y", which="both", alpha=0.25)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3,
        title="box: middle half of the runs, whiskers: 1.5 times as far",
    )  # fmt: skip
    return figure


def _times(trial: PlantIdentification) -> FloatArray:
    return np.linspace(REPLAN_PERIOD, _duration(trial), len(trial.bits))


def _duration(trial: PlantIdentification) -> float:
    return REPLAN_PERIOD * len(trial.bits)


def _band(ax: Axes, times: FloatArray, rows: FloatArray, colour: str, label: str) -> None:
    low, middle, high = np.percentile(rows, (5, 50, 95), axis=0)
    ax.fill_between(times, low, high, color=colour, alpha=0.2, linewidth=0)
    ax.plot(times, middle, color=colour, label=label)
