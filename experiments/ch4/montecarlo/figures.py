"""Figures of ``ch4-montecarlo``: the table as a picture, and one test."""

from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from experiments.ch4.montecarlo.scenario import (
    DENSITIES,
    SCENARIO,
    TOLERANCES,
    ObstacleWorld,
    draw_worlds,
)
from experiments.ch4.montecarlo.trial import PLACEMENTS, TARGETS, draw_chance, guide
from experiments.harness.figure_style import BLUE, COLOURS, GREEN, PURPLE, RED
from experiments.harness.intervals import fraction
from perception.geometry.arrays import FloatArray

SHOWN = 1
"""Index of the density whose world is drawn."""


def table_figure(
    success: NDArray[np.bool_], coarse: FloatArray, thesis: NDArray[np.int64]
) -> Figure:
    """Draw success over density, a column for each tolerance, a row for each set of targets.

    Args:
        success: (n, densities, tolerances, placements, targets) of tests.
        coarse: (densities, tolerances, placements, targets) shares with errors of a pixel.
        thesis: (densities, tolerances, placements, targets) shares of the thesis [%].
    """
    figure = Figure(figsize=(11, 6.5))
    grid = np.asarray(figure.subplots(2, len(TOLERANCES), sharex=True, sharey=True))
    for s, t in np.ndindex(len(TARGETS), len(TOLERANCES)):
        axes: Any = grid[s, t]
        for p, placement in enumerate(PLACEMENTS):
            cells = [
                fraction(int(success[:, d, t, p, s].sum()), len(success))
                for d in range(len(DENSITIES))
            ]
            mean, low, high = (
                100.0 * np.array([c[k] for c in cells]) for k in ("mean", "low", "high")
            )
            colour, bars = COLOURS[placement], (mean - low, high - mean)
            axes.errorbar(DENSITIES, mean, bars, color=colour, marker="o", capsize=3)
            axes.plot(DENSITIES, thesis[:, t, p, s], color=colour, linestyle="--", marker="x")
            axes.plot(DENSITIES, 100.0 * coarse[:, t, p, s], color=colour, linestyle=":")
        axes.grid(alpha=0.3)
        axes.set(ylim=(-3, 103), xticks=DENSITIES)
        if s == 0:
            axes.set_title(f"tolerance {TOLERANCES[t]} %")
        else:
            axes.set_xlabel("density [%]")
    grid[0, 0].set_ylabel("success without secondary [%]")
    grid[1, 0].set_ylabel("success with secondary [%]")
    lines = [Line2D([], [], color=COLOURS[name], label=name) for name in PLACEMENTS]
    styles: Any = (("-", "ours, 95 % intervals"), (":", "ours, errors of 1 px"), ("--", "thesis"))
    lines += [Line2D([], [], color="k", linestyle=style, label=name) for style, name in styles]
    figure.legend(handles=lines, loc="lower center", ncols=6, frameon=False)
    figure.subplots_adjust(wspace=0.08, hspace=0.08, bottom=0.13)
    return figure


def track_figure(seed: int) -> Figure:
    """Draw one test, a panel for each placement: obstacles, camera poses, path and sightings."""
    chance = draw_chance(seed)
    world = draw_worlds(chance.candidates)[SHOWN]
    figure = Figure(figsize=(13, 5.2))
    for p, placement in enumerate(PLACEMENTS):
        error, track = guide(SCENARIO, world, chance, p, True)
        axes = figure.add_subplot(1, len(PLACEMENTS), p + 1)
        _draw_world(axes, world)
        _draw_track(axes, track)
        seen = np.count_nonzero(track[:, 3])
        axes.set_title(
            f"{placement}: seen {seen} of {len(track)},\narrives {1e3 * abs(error):.2g} mm off"
        )
        axes.set(xlabel="x [m]", ylabel="y [m]" if p == 0 else "")
    lines: list[Any] = [
        Line2D([], [], color=BLUE, label="camera, primary seen"),
        Line2D([], [], color=GREEN, label="camera, secondary seen"),
        Line2D([], [], color=RED, linestyle="", marker="x", label="camera, nothing seen"),
        Rectangle((0, 0), 1, 1, color="0.88", label="no camera here"),
    ]
    figure.legend(handles=lines, loc="lower center", ncols=4, frameon=False)
    figure.subplots_adjust(wspace=0.15, bottom=0.17)
    return figure


def _draw_world(axes: Any, world: ObstacleWorld) -> None:
    half, width = 0.5 * SCENARIO.side, SCENARIO.width
    extent = (-half, half, -half, half)
    axes.imshow(-world.occupied, cmap="gray", vmin=-8, vmax=0, extent=extent, origin="lower")
    axes.add_collection(PolyCollection(list(world.corners), facecolor="0.45", edgecolor="0.3"))
    axes.add_patch(Rectangle((-0.5 * width - 0.03, -0.04), width + 0.06, 0.04, color="k"))
    for gap, alpha in ((SCENARIO.start, 0.25), (0.01, 0.7)):
        place = (-0.5 * width, gap)
        axes.add_patch(Rectangle(place, width, SCENARIO.length, color=PURPLE, alpha=alpha))
    axes.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")


def _draw_track(axes: Any, track: FloatArray) -> None:
    """Draw the cameras, and lines of sight to the middle of the gap of what they saw."""
    side = 0.5 * SCENARIO.width + SCENARIO.ear
    for gap, x, y, seen, *_ in track:
        if seen == 0:
            axes.plot(x, y, "x", color=RED, markersize=6)
            continue
        colour, goal = (BLUE, side) if seen == 1 else (GREEN, -side)
        axes.plot([x, goal], [y, 0.5 * gap], color=colour, linewidth=0.6)
        axes.plot(x, y, "o", color=colour, markersize=4)
