"""Figures 3-12 to 3-21: worlds, curves with their bands, paths and maps."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.ch3.planar.trial import TARGET, PlanarRun, PlanarTrial, build_world
from experiments.ch3.planar.worlds import World
from experiments.harness.output import Output
from perception.voxels.occupancy import State

GREYS = {State.UNKNOWN: 1.0, State.FREE: 0.65, State.OCCUPIED: 0.0}
"""The thesis' shades: grey is empty, black is obstacle, white is unknown."""
FIGURES = {
    "unstructured": ("figure_3-12", "figure_3-13", "figure_3-14", "figure_3-15"),
    "unstructured_two": (None, "figure_3-16", "figure_3-17", "figure_3-18"),
    "indoor": ("figure_3-19", "figure_3-20", "figure_3-21", "indoor_maps"),
    "picture": ("picture_world", "picture_curves", "picture_paths", "picture_maps"),
}
"""World, curves, paths and maps of each group of trials that is drawn."""
BAND = (25.0, 75.0)
COLOURS = ("tab:red", "tab:cyan")


def draw_group(
    name: str,
    group: Sequence[PlanarTrial],
    results: Mapping[PlanarTrial, PlanarRun],
    output: Output,
) -> None:
    """Draw the figures of one group of trials, its first seed where one run is shown."""
    if name not in FIGURES:
        return
    world_name, curve_name, path_name, map_name = FIGURES[name]
    world = build_world(group[0])
    if world_name is not None:
        output.figure(world_name, world_figure(world))
    output.figure(curve_name, curve_figure(group, results))
    methods = list(dict.fromkeys(trial.method for trial in group))
    pair = ["random" if "random" in methods else methods[0], "information"]
    shown = [next((t for t in group if t.method == m), None) for m in dict.fromkeys(pair)]
    chosen = [trial for trial in shown if trial is not None]
    output.figure(path_name, path_figure(chosen, results, world))
    output.figure(map_name, map_figure(chosen, results, world))


def shades(states: NDArray[np.int8]) -> NDArray[np.float64]:
    """Return grey levels in 0..1 for an array of `State`."""
    lookup = np.array([GREYS[state] for state in State])
    return lookup[states]


def world_figure(world: World) -> Figure:
    """Draw the world to be mapped and where the first robot starts."""
    figure = Figure(figsize=(5, 5))
    axes = figure.add_subplot()
    _show(axes, np.where(world.occupied, 0.0, 1.0), world)
    axes.plot(*world.grid.centre(world.start), "r.", label="start")
    axes.legend(loc="upper right")
    return figure


def curve_figure(
    group: Sequence[PlanarTrial], results: Mapping[PlanarTrial, PlanarRun]
) -> Figure:  # fmt: skip
    """Draw fraction mapped and distance over scans: medians, and the middle half of the seeds."""
    figure = Figure(figsize=(11, 4.5))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for method in dict.fromkeys(trial.method for trial in group):
        chosen = [results[trial] for trial in group if trial.method == method]
        for axes, key in ((left, "fraction"), (right, "metres")):
            rows = _held([getattr(result, key) for result in chosen])
            scans = np.arange(1, rows.shape[1] + 1)
            line = axes.plot(scans, np.median(rows, axis=0), label=method)[0]
            low, high = np.percentile(rows, BAND, axis=0)
            axes.fill_between(scans, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
    left.axhline(TARGET, color="k", linewidth=0.6, linestyle=":")
    left.set(xlabel="scan number of each robot", ylabel="fraction mapped", ylim=(0.0, 1.0))
    right.set(xlabel="scan number of each robot", ylabel="distance moved, all robots [m]")
    right.set_yscale("symlog", linthresh=100.0)
    left.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def path_figure(
    trials: Sequence[PlanarTrial], results: Mapping[PlanarTrial, PlanarRun], world: World
) -> Figure:
    """Draw the robots' paths over the world."""
    figure = Figure(figsize=(5 * len(trials), 5))
    for index, trial in enumerate(trials):
        axes = figure.add_subplot(1, len(trials), index + 1)
        _show(axes, np.where(world.occupied, 0.0, 1.0), world)
        for robot in range(trial.robots):
            for key, style, width in (("paths", "-", 0.8), ("stops", ".", 0.0)):
                cells = getattr(results[trial], key)
                x, y = world.grid.centre(cells[cells[:, 0] == robot, 1:]).T
                axes.plot(x, y, style, color=COLOURS[robot], linewidth=width, markersize=3)
        axes.set_title(f"{trial.method}, {results[trial].metres[-1]:.0f} m")
    return figure


def map_figure(
    trials: Sequence[PlanarTrial], results: Mapping[PlanarTrial, PlanarRun], world: World
) -> Figure:
    """Draw the maps at the end of the runs."""
    figure = Figure(figsize=(5 * len(trials), 5))
    for index, trial in enumerate(trials):
        axes = figure.add_subplot(1, len(trials), index + 1)
        _show(axes, shades(results[trial].states), world)
        mapped, scans = results[trial].fraction[-1], len(results[trial].fraction)
        axes.set_title(f"{trial.method}: {mapped:.0%} after {scans} scans")
    return figure


def _held(rows: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return equally long rows; a run that has ended stays as it was."""
    longest = max(len(row) for row in rows)
    return np.array([np.pad(row, (0, longest - len(row)), mode="edge") for row in rows])


def _show(axes: Axes, picture: NDArray[np.float64], world: World) -> None:
    size = world.grid
    extent = (0.0, size.columns * size.cell, 0.0, size.rows * size.cell)
    axes.imshow(picture, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent)
    axes.set(xlabel="x [m]", ylabel="y [m]")
