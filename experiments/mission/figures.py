"""Figures of ``mission``: site after each stage, errors of the estimates, and the ablation."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.harness.intervals import Distribution, error_bars
from experiments.mission.results import after_stage, stages_of
from experiments.mission.trial import MissionResult
from perception.geometry.arrays import FloatArray, ImageArray

COLOURS = {"master": "tab:blue", "slave": "tab:orange"}


def draw_steps(steps: Sequence[tuple[str, float, ImageArray]]) -> Figure:
    """Draw the site at the end of each stage.

    Args:
        steps: Names of the stages, times [s] and colour pictures.
    """
    columns = 2 if len(steps) > 1 else 1
    rows = max(1, -(-len(steps) // columns))
    figure = Figure(figsize=(5.2 * columns, 4.1 * rows))
    for index, (name, time, picture) in enumerate(steps):
        axes = figure.add_subplot(rows, columns, index + 1)
        axes.imshow(picture)
        axes.set_axis_off()
        axes.set_title(f"{name}, {time:.1f} s", fontsize=10)
    figure.tight_layout()
    return figure


def draw_knowledge(results: Sequence[MissionResult]) -> Figure:
    """Draw the errors of the slot's position after each stage, and the expected deviations.

    Args:
        results: Results of missions.
    """
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    names = [name for name in stages_of(results) if name != "insert"]
    place = np.arange(len(names), dtype=float)
    for offset, robot in ((-0.12, "master"), (0.12, "slave")):
        for stage, name in enumerate(names):
            known = after_stage(results, name)
            errors, sigmas = (
                [np.linalg.norm(getattr(ended, f"{robot}_{what}")) for ended in known]
                for what in ("error", "sigma")
            )
            spots = np.full(len(errors), place[stage] + offset)
            axes.plot(
                spots, 1e3 * np.array(errors), "o", color=COLOURS[robot], alpha=0.6, markersize=4,
                label=f"{robot}: true error" if stage == 0 else None,
            )  # fmt: skip
            axes.plot(
                [spots[0] - 0.1, spots[0] + 0.1], [1e3 * float(np.median(sigmas))] * 2, "-",
                color=COLOURS[robot], linewidth=2,
                label=f"{robot}: expected r.m.s. error" if stage == 0 else None,
            )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xticks(place, [f"after {name}" for name in names])
    axes.set(ylabel="position of the slot [mm]", title="Errors of the estimated slot position")
    figure.legend(fontsize=8, ncols=2, loc="outside lower center")
    axes.grid(visible=True, axis="y", alpha=0.3)
    return figure


def draw_worth(
    shares: Mapping[str, Distribution],
    stops: Mapping[str, Sequence[float]],
    off: Mapping[str, Sequence[float]],
) -> Figure:
    """Draw the ablation: cards inserted, first stops of the master, offsets of inserted cards.

    Args:
        shares: Fractions with intervals, by omitted stage; "" for whole missions.
        stops: Distances of first stops from the camera station [m], by omitted stage; empty where
            the master does not drive.
        off: Distances of inserted cards from the slot's middle [m], by omitted stage.
    """
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    inserted, stopped, seated = figure.subplots(1, 3)
    place = np.arange(len(shares), dtype=float)
    mean, errors = error_bars(list(shares.values()))
    colours = ["tab:green", *["tab:orange"] * (len(shares) - 1)]
    inserted.bar(place, mean, 0.6, color=colours)
    inserted.errorbar(place, mean, errors, fmt="none", color="k", capsize=4)
    inserted.set(ylabel="card inserted (95 % interval)", ylim=(0.0, 1.05))
    for spot, colour, kind in zip(place, colours, shares):
        _scatter(stopped, spot, 100.0 * np.asarray(stops[kind], dtype=float), colour, "stays")
        _scatter(seated, spot, 1e3 * np.asarray(off[kind], dtype=float), colour, "none is in")
    stopped.set(ylabel="first stop from the camera station [cm]", ylim=(0.0, None))
    seated.set(ylabel="inserted card from the slot's middle [mm]", ylim=(0.0, None))
    labels = [f"without\n{name}" if name else "whole\nmission" for name in shares]
    for axes in (inserted, stopped, seated):
        axes.set_xticks(place, labels, fontsize=8)
        axes.set_xlim(-0.5, len(place) - 0.5)
    return figure


def _scatter(axes: Axes, spot: float, values: FloatArray, colour: str, without: str) -> None:
    """Draw values beside each other about a position, and their median; without values, a text."""
    places = spot + np.linspace(-0.2, 0.2, len(values))
    axes.plot(places, values, "o", color=colour, alpha=0.7, markersize=4)
    if len(values):
        axes.plot([spot - 0.3, spot + 0.3], [np.median(values)] * 2, "k-", linewidth=2)
    else:
        axes.text(spot, 0.0, without, ha="center", va="bottom")
