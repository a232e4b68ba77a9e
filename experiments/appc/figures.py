"""Figure C-2, what predictors leave of pictures, and how well measures of views did."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from experiments.appc.pictures import SIZES, Measured
from experiments.harness.figure_style import BLUE, GREEN, GREY, ORANGE, RED
from perception.compression.byte_codes import entropy
from perception.compression.image_codec import METHODS, coded_bits, compression_ratio
from perception.compression.image_predictors import residuals
from perception.geometry.arrays import ByteArray, FloatArray

SHOWN = (2, 5, 8)
"""Predictors whose residuals are drawn."""
COLOURS = (BLUE, GREEN, ORANGE, GREY)


def draw_methods(
    sets: Mapping[str, Measured],
    thesis: Sequence[Sequence[float]],
    sigma: Sequence[Sequence[float]],
) -> Figure:
    """Draw mean and deviation of the ratios by method, one panel for each size (figure C-2).

    Args:
        sets: Sets of pictures, by name.
        thesis: (10, sizes) mean ratios of the thesis.
        sigma: (10, sizes) deviations of the thesis' ratios.
    """
    figure = Figure(figsize=(15, 8), layout="constrained")
    where = np.arange(len(METHODS))
    width = 0.8 / (len(sets) + 1)
    for column, size in enumerate(SIZES):
        axes = figure.add_subplot(2, 3, column + 1)
        bars = [
            (name, m.ratios[column].mean(axis=0), m.ratios[column].std(axis=0, ddof=1), colour)
            for (name, m), colour in zip(sets.items(), COLOURS)
        ]
        mean, deviation = (np.array(table)[:, column] for table in (thesis, sigma))
        bars.insert(0, ("thesis", mean, deviation, "black"))
        for place, (name, mean, deviation, colour) in enumerate(bars):
            at = where + (place - len(sets) / 2) * width
            axes.bar(at, mean - 1.0, width, bottom=1.0, color=colour, label=name)
            axes.errorbar(at, mean, deviation, fmt="none", ecolor="dimgray", elinewidth=0.6)
        axes.axhline(1.0, color="black", linewidth=0.6)
        axes.set_xticks(where, [str(method) for method in METHODS])
        axes.set(title=f"{size} x {size} px", xlabel="method", ylabel="compression ratio")
        axes.grid(axis="y", alpha=0.3)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4,
        title="mean ratio, and the standard deviation of the pictures",
    )  # fmt: skip
    return figure


def draw_predictors(pictures: Mapping[str, ByteArray]) -> Figure:
    """Draw pictures beside what some predictors leave of them, 0 as middle grey.

    Args:
        pictures: (H, W) uint8 by name.
    """
    columns = 1 + len(SHOWN)
    figure = Figure(figsize=(3.2 * columns, 3.5 * len(pictures)))
    for row, (name, picture) in enumerate(pictures.items()):
        panels = [(picture, f"{name}, {entropy(picture):.2f} bit/px", (0, 255))]
        for method in SHOWN:
            bits, ratio = coded_bits(picture, method), compression_ratio(picture, method)
            title = f"method {method}: {bits:.2f} bit/px, {ratio:.2f}"
            panels.append((residuals(picture, method) + np.uint8(128), title, (88, 168)))
        for column, (image, title, (low, high)) in enumerate(panels, start=1):
            axes = figure.add_subplot(len(pictures), columns, row * columns + column)
            axes.imshow(image, cmap="gray", vmin=low, vmax=high)
            axes.set_title(title, fontsize="small")
            axes.set_axis_off()
    figure.tight_layout()
    return figure


def draw_views(
    names: Sequence[str], share: FloatArray, correlation: FloatArray, drawn: FloatArray
) -> Figure:
    """Draw what each measure's choice brought, and how its ranks agree with what views bring.

    Args:
        names: Names of the measures.
        share: (S, M) of the best view's gain, by scene.
        correlation: (S, M) of ranks.
        drawn: (S,) share of a view drawn at random.
    """
    figure = Figure(figsize=(11, 4.5))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    offsets = np.linspace(-0.2, 0.2, len(share))
    labels = [name.replace("_", " ") for name in names]
    for axes, values, extra in (
        (left, np.column_stack([share, drawn]), ["random"]),
        (right, correlation, []),
    ):
        for column in range(values.shape[1]):
            axes.plot(values[:, column], column + offsets, ".", color=GREY)
            axes.plot(np.mean(values[:, column]), column, "D", color=RED)
        axes.set_yticks(range(values.shape[1]), labels + extra)
        axes.invert_yaxis()
        axes.grid(axis="x", alpha=0.3)
    left.set(xlabel="share of the best view's gain", xlim=(0.0, 1.05))
    right.set(xlabel="rank correlation with the gain")
    right.axvline(0.0, color="black", linewidth=0.6)
    figure.tight_layout()
    return figure
