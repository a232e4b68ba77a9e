"""Figures 3-23 and 3-24, tracked fiducials and accumulated error, and cooperative stereo's."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.ch3.motion.scores import Followed, Triangulated
from experiments.harness.figure_style import ORANGE, SKY
from perception.geometry.arrays import FloatArray

LABELS = {
    "single": "one robot",
    "fused": "two, fused",
    "bundle": "two, jointly",
    "bundle_6": "two, jointly, 6 points",
    "bundle_20": "two, jointly, 20 points",
    "target": "jointly, known target",
    "perfect": "pose known exactly",
}


def error_figure(
    groups: Mapping[tuple[str, int], Sequence[Followed]], solvers: Sequence[str], sigma: float
) -> Figure:
    """Draw the accumulated error over the steps, one panel for each range and redundancy.

    Args:
        groups: Results by range and number of fiducials in a view, two numbers for each range.
        solvers: Names of the solvers to draw.
        sigma: Image noise [px], for the title.
    """
    rows = len(groups) // 2
    figure = Figure(figsize=(12, 4.0 * rows), layout="constrained")
    grid = figure.subplots(rows, 2, sharex=True, sharey="row", squeeze=False)
    for axes, ((name, count), group) in zip(grid.flat, groups.items(), strict=True):
        for solver in solvers:
            errors = np.array([result.errors[solver] for result in group])
            steps = np.arange(1, errors.shape[1] + 1)
            low, middle, high = np.percentile(errors, [25, 50, 75], axis=0, method="nearest")
            (line,) = axes.plot(steps, middle, label=solver)
            axes.fill_between(steps, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
            axes.plot(steps, np.sqrt(np.mean(errors**2, axis=0)), ":", color=line.get_color())
        title = f"mean distance {name.removesuffix('mm')} mm, {count} fiducials a view"
        axes.set(title=title, yscale="log")
        axes.grid(alpha=0.3, which="both")
    grid[0, 0].legend(loc="upper left", ncols=2)
    figure.supxlabel("step")
    figure.supylabel("translation error [mm]")
    figure.suptitle(
        f"Accumulated translation error, {sigma:g} px of image noise: "
        "median, quartiles, and r.m.s. (dotted)"
    )
    return figure


def tracking_figure(
    images: Sequence[NDArray[np.uint8]],
    with_previous: Sequence[FloatArray],
    with_next: Sequence[FloatArray],
) -> Figure:
    """Draw left images with their fiducials, as figure 3-23.

    Args:
        images: Left images (H, W) in the order of the views.
        with_previous: (N, 2 or more) columns and rows of the fiducials of each image that were
            tracked from the image before it: squares.
        with_next: (N, 2 or more) columns and rows of the fiducials of each image that were tracked
            to the image after it: circles.
    """
    figure = Figure(figsize=(4.2 * len(images), 4.2), layout="constrained")
    grid = figure.subplots(1, len(images), squeeze=False)[0]
    views = zip(grid, images, with_previous, with_next, strict=True)
    for index, (axes, image, previous, following) in enumerate(views):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        for points, marker, size, colour in (
            (previous, "s", 11, ORANGE),
            (following, "o", 15, SKY),
        ):
            if len(points):
                style = {"markersize": size, "markeredgecolor": colour, "markeredgewidth": 1.6}
                axes.plot(*points[:, :2].T, marker, markerfacecolor="none", **style)
        axes.set_axis_off()
        axes.set_title(f"view {index + 1}")
    figure.suptitle("Fiducials: squares tracked with the previous view, circles with the next")
    return figure


def cooperative_figure(
    groups: Mapping[str, Sequence[Triangulated]], images: NDArray[np.uint8], matches: FloatArray
) -> Figure:
    """Draw r.m.s. errors of points, and what was matched across two robots' views.

    Args:
        groups: Triangulated scenes by kind of data; infinite errors are left out.
        images: (2, H, W) uint8 left images of the two robots.
        matches: (N, 4) column and row of each point in the first and in the second [px].
    """
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    parts: Any = figure.subfigures(2, 1)
    above, below = parts
    grid = above.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (name, runs) in zip(grid, groups.items(), strict=True):
        _draw_cases(axes, runs)
        axes.set_title("rendered pairs" if name == "rendered" else f"drawn, {name}")
    grid[0].set_ylabel("r.m.s. error of points [mm]")
    for axes, image, places, label in zip(
        below.subplots(1, 2), images, (matches[:, :2], matches[:, 2:]), ("first", "second")
    ):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        axes.scatter(*places.T, c=np.linspace(0.0, 1.0, len(places)), cmap="hsv", s=14)
        axes.set_title(f"{label} robot: {len(places)} points that both see")
        axes.set_axis_off()
    figure.suptitle("Cooperative stereo (section 6.2 (a)): median and quartiles")
    return figure


def _draw_cases(axes: Any, runs: Sequence[Triangulated]) -> None:
    colours = {case: f"C{index}" for index, case in enumerate(LABELS)}
    for row, case in enumerate(runs[0].errors):
        finite = [run.errors[case] for run in runs if np.isfinite(run.errors[case])]
        if finite:
            low, middle, high = np.percentile(finite, [25, 50, 75])
            axes.bar(row, middle, color=colours[case], alpha=0.6)
            axes.errorbar(row, middle, [[middle - low], [high - middle]], color="black")
            axes.text(row, high * 1.08, f"{middle:.2g}", ha="center", fontsize="small")
    names = [LABELS[case] for case in runs[0].errors]
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize="small")
    axes.set_yscale("log")
    axes.grid(axis="y", alpha=0.3, which="both")
