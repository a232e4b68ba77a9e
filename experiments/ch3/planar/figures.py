"""Figures 3-12 to 3-21: worlds, curves with their bands, paths and maps."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.ch3.planar.trial import TARGET, PlanarRun
from experiments.ch3.planar.worlds import World
from experiments.harness.figure_style import COLOURS, plain_name
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray
from perception.planar.map import Grid
from perception.planar.raycast import RangeSensor
from perception.voxels.occupancy import State

GREYS = {State.UNKNOWN: 0.65, State.FREE: 1.0, State.OCCUPIED: 0.0}
"""Shades of all our maps; the thesis has grey for free and white for unknown."""
FIGURES = {
    "unstructured": ("figure_3-12", "figure_3-13", "figure_3-14", "figure_3-15"),
    "unstructured_two": (None, "figure_3-16", "figure_3-17", "figure_3-18"),
    "indoor": ("figure_3-19", "figure_3-20", "figure_3-21", "indoor_maps"),
    "picture": ("picture_world", "picture_curves", "picture_paths", "picture_maps"),
}
"""World, curves, paths and maps of each group of trials that is drawn."""
BAND = (25.0, 75.0)
ROBOT_COLOURS = ((220, 40, 40), (0, 170, 190), (240, 150, 0), (60, 160, 60), (150, 80, 200))
ARC = 16
"""Number of corners along the edge of a drawn sector."""

MethodRuns = Mapping[str, Sequence[PlanarRun]]
"""Runs by method, each in the order of the seeds."""


def draw_group(name: str, runs: MethodRuns, world: World, output: Output) -> None:
    """Draw the figures of one group of runs.

    Args:
        name: Name of the group; only those of `FIGURES` are drawn.
        runs: Runs of the group.
        world: World of the first seed, of which single runs are shown.
        output: Receives the figures.
    """
    if name not in FIGURES:
        return
    world_name, curve_name, path_name, map_name = FIGURES[name]
    if world_name is not None:
        output.figure(world_name, world_figure(world))
    output.figure(curve_name, curve_figure(runs))
    peer = "random" if "random" in runs else next(iter(runs))
    shown = {method: runs[method][0] for method in (peer, "information") if method in runs}
    output.figure(path_name, path_figure(shown, world))
    output.figure(map_name, map_figure(shown, world))


def shades(states: NDArray[np.int8]) -> FloatArray:
    """Return grey levels in 0..1 for an array of `State`."""
    return np.array([GREYS[state] for state in State])[states]


def picture_points(cells: NDArray[Any], grid: Grid) -> FloatArray:
    """Return (..., 2) x and y [cells] of cells (..., 2) in a picture, the far side on top."""
    return np.stack([cells[..., 1] + 0.5, grid.rows - cells[..., 0] - 0.5], axis=-1)


def sector(at: FloatArray, heading: float, sensor: RangeSensor, grid: Grid) -> FloatArray:
    """Return the outline (ARC + 2, 2) of a field of view in a picture [cells].

    Args:
        at: (2,) position of the robot in the picture [cells].
        heading: Direction of the sector's middle from the x axis [rad].
        sensor: Field of view and depth of field.
        grid: Grid of the world.
    """
    angles = heading + np.linspace(-0.5, 0.5, ARC) * sensor.fov
    edge = at + sensor.depth / grid.cell * np.stack([np.cos(angles), -np.sin(angles)], axis=1)
    return np.vstack([at, edge, at])


def world_figure(world: World) -> Figure:
    """Draw the world to be mapped and the start of the first robot."""
    figure, (axes,) = _pictures([np.where(world.occupied, 0.0, 1.0)], world)
    axes.plot(*world.grid.centre(world.start), "r.", label="start")
    axes.legend(loc="upper right")
    return figure


def curve_figure(runs: MethodRuns) -> Figure:
    """Draw fraction mapped and distance over scans: medians, and the middle half of the seeds."""
    figure = Figure(figsize=(11, 5.2))
    left, right = figure.subplots(1, 2)
    for method, chosen in runs.items():
        longest = max(len(run.fraction) for run in chosen)
        for axes, key in ((left, "fraction"), (right, "metres")):
            # A run that has ended stays as it was.
            curves = [getattr(run, key) for run in chosen]
            rows = np.array([np.pad(row, (0, longest - len(row)), "edge") for row in curves])
            scans = np.arange(1, longest + 1)
            colour = COLOURS[method]
            axes.plot(scans, np.median(rows, axis=0), color=colour, label=plain_name(method))
            low, high = np.percentile(rows, BAND, axis=0)
            axes.fill_between(scans, low, high, color=colour, alpha=0.15, linewidth=0)
    left.axhline(TARGET, color="k", linewidth=0.6, linestyle=":")
    left.set(ylabel="fraction mapped", ylim=(0.0, 1.0))
    right.set(ylabel="distance moved, all robots [m]")
    right.set_yscale("symlog", linthresh=100.0)
    figure.subplots_adjust(bottom=0.26)
    lines = left.get_legend_handles_labels()
    figure.legend(*lines, loc="lower center", ncols=4, title="median and middle half")
    for axes in (left, right):
        axes.set_xlabel("scan number of each robot")
        axes.grid(alpha=0.3)
    return figure


def path_figure(shown: Mapping[str, PlanarRun], world: World) -> Figure:
    """Draw the robots' paths over the world."""
    figure, grid = _pictures([np.where(world.occupied, 0.0, 1.0)] * len(shown), world)
    for axes, (method, run) in zip(grid, shown.items(), strict=True):
        for robot in np.unique(run.stops[:, 0]):
            colour = np.array(ROBOT_COLOURS[robot]) / 255.0
            for cells, style, width in ((run.paths, "-", 0.8), (run.stops, ".", 0.0)):
                x, y = world.grid.centre(cells[cells[:, 0] == robot, 1:]).T
                axes.plot(x, y, style, color=colour, linewidth=width, markersize=3)
        axes.set_title(f"{plain_name(method)}, {run.metres[-1]:.0f} m")
    return figure


def map_figure(shown: Mapping[str, PlanarRun], world: World) -> Figure:
    """Draw the maps at the end of the runs."""
    figure, grid = _pictures([shades(run.states) for run in shown.values()], world)
    for axes, (method, run) in zip(grid, shown.items(), strict=True):
        mapped, scans = run.fraction[-1], len(run.fraction)
        axes.set_title(f"{plain_name(method)}: {mapped:.0%} after {scans} scans")
    return figure


def draw_picture(axes: Axes, picture: FloatArray, grid: Grid) -> None:
    """Draw grey levels (rows, columns), 0 to 1, over the ground [m]."""
    extent = (0.0, grid.columns * grid.cell, 0.0, grid.rows * grid.cell)
    axes.imshow(picture, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent)
    axes.set(xlabel="x [m]", ylabel="y [m]")


def _pictures(pictures: Sequence[FloatArray], world: World) -> tuple[Figure, Sequence[Axes]]:
    """Return a figure with a row of pictures of a world, and the axes of each."""
    figure = Figure(figsize=(5 * len(pictures), 5))
    grid = figure.subplots(1, len(pictures), squeeze=False)[0]
    for axes, picture in zip(grid, pictures, strict=True):
        draw_picture(axes, picture, world.grid)
    return figure, grid
