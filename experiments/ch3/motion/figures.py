"""Figures 3-23 and 3-24: tracked fiducials, and how the motion's error accumulates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Groups = Mapping[str, Sequence[Mapping[str, Any]]]


def error_figure(few: Groups, many: Groups, solvers: Sequence[str], sigma: float) -> Figure:
    """Draw the accumulated error over the steps, one panel for each range and redundancy.

    Args:
        few: Results by range, with few fiducials a view; each maps a solver to errors [mm].
        many: The same with many.
        solvers: Which to draw.
        sigma: Image noise [px], for the title.
    """
    figure = Figure(figsize=(12, 4.0 * len(few)), layout="constrained")
    grid = figure.subplots(len(few), 2, sharex=True, sharey="row", squeeze=False)
    for row, name in enumerate(few):
        for axes, group, label in zip(
            grid[row], (few[name], many[name]), ("6 fiducials a view", "30 fiducials a view")
        ):
            for solver in solvers:
                _draw_error(axes, np.array([result[solver] for result in group]), solver)
            axes.set(title=f"mean distance {name.removesuffix('mm')} mm, {label}", yscale="log")
            axes.grid(alpha=0.3, which="both")
        grid[row][0].set_ylabel("translation error [mm]")
    for axes in grid[-1]:
        axes.set_xlabel("step")
    grid[0][0].legend(loc="upper left", ncols=2, fontsize="small")
    figure.suptitle(
        f"Accumulated translation error, {sigma:g} px of image noise: "
        "median, quartiles, and r.m.s. (dotted)"
    )
    return figure


def _draw_error(axes: Any, errors: FloatArray, label: str) -> None:
    steps = np.arange(1, errors.shape[1] + 1)
    low, middle, high = np.percentile(errors, [25, 50, 75], axis=0, method="nearest")
    (line,) = axes.plot(steps, middle, label=label)
    axes.fill_between(steps, low, high, color=line.get_color(), alpha=0.2, linewidth=0)
    axes.plot(steps, np.sqrt(np.mean(errors**2, axis=0)), ":", color=line.get_color())


def tracking_figure(
    images: Sequence[NDArray[np.uint8]],
    with_previous: Sequence[FloatArray],
    with_next: Sequence[FloatArray],
) -> Figure:
    """Draw left images with their fiducials, as figure 3-23.

    Args:
        images: Left images (H, W) in the order of the views.
        with_previous: For each image (N, 2 or more) columns and rows of the fiducials that were
            tracked from the image before it: squares.
        with_next: For each image those tracked to the image after it: circles.
    """
    columns = min(len(images), 3)
    rows = -(-len(images) // columns)
    figure = Figure(figsize=(4.2 * columns, 4.2 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
    views = zip(images, with_previous, with_next, strict=True)
    for index, (axes, (image, previous, following)) in enumerate(zip(grid.ravel(), views)):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        for points, marker, size, colour in (
            (previous, "s", 11, "tab:orange"),
            (following, "o", 15, "tab:cyan"),
        ):
            if len(points):
                axes.plot(
                    points[:, 0],
                    points[:, 1],
                    marker,
                    markersize=size,
                    markerfacecolor="none",
                    markeredgecolor=colour,
                    markeredgewidth=1.6,
                )
        axes.set_title(f"view {index + 1}", fontsize="medium")
    figure.suptitle("Fiducials: squares tracked with the previous view, circles with the next")
    return figure
