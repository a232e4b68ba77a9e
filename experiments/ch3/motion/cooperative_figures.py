"""Figure of cooperative stereo: errors of each way to triangulate, and points matched across."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

Errors = Mapping[str, FloatArray]
LABELS = {
    "single": "one robot",
    "fused": "two, fused",
    "bundle": "two, jointly",
    "bundle_6": "two, jointly, 6 points",
    "bundle_20": "two, jointly, 20 points",
    "target": "jointly, known target",
    "perfect": "pose known exactly",
}


def cooperative_figure(
    groups: Mapping[str, Errors], images: NDArray[np.uint8], matches: FloatArray
) -> Figure:
    """Draw r.m.s. errors of points, and what was matched across two robots' views.

    Args:
        groups: By kind of data and case, (runs,) errors [mm]; infinite ones are left out.
        images: (2, H, W) left images of the two robots.
        matches: (N, 4) column and row in the first and in the second [px].
    """
    figure = Figure(figsize=(12, 8.5), layout="constrained")
    parts: Any = figure.subfigures(2, 1)
    above, below = parts
    grid = above.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (name, errors) in zip(grid, groups.items(), strict=True):
        _draw_errors(axes, errors)
        axes.set_title("rendered pairs" if name == "rendered" else f"drawn, {name}")
    grid[0].set_ylabel("r.m.s. error of points [mm]")
    for axes, image, places, label in zip(
        below.subplots(1, 2), images, (matches[:, :2], matches[:, 2:]), ("first", "second")
    ):
        axes.imshow(image, cmap="gray", vmin=0, vmax=255)
        colours = np.linspace(0.0, 1.0, max(len(places), 1))[: len(places)]
        axes.scatter(places[:, 0], places[:, 1], c=colours, cmap="hsv", s=14)
        axes.set_title(f"{label} robot: {len(places)} points that both see", fontsize="medium")
        axes.set_axis_off()
    figure.suptitle("Cooperative stereo (section 6.2 (a)): median and quartiles")
    return figure


def _draw_errors(axes: Any, errors: Errors) -> None:
    colours = {case: f"C{index}" for index, case in enumerate(LABELS)}
    for row, (case, values) in enumerate(errors.items()):
        finite = values[np.isfinite(values)]
        if len(finite):
            low, middle, high = np.percentile(finite, [25, 50, 75])
            axes.bar(row, middle, color=colours[case], alpha=0.6)
            axes.errorbar(row, middle, [[middle - low], [high - middle]], color="black")
            axes.text(row, high * 1.08, f"{middle:.2g}", ha="center", fontsize="small")
    names = [LABELS[case] for case in errors]
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize="small")
    axes.set_yscale("log")
    axes.grid(axis="y", alpha=0.3, which="both")
