"""Figures of ch5-insertion: Table 5-1, and figures 5-11 to 5-14."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from controllers.insertion.card_inserter import InsertionStage
from experiments.ch5.insertion_trial import COURSE, STAGES
from experiments.harness.figure_style import BLUE, COLOURS, ORANGE, RED
from experiments.harness.intervals import Distribution, error_bars
from models.datasheets import INCH
from perception.geometry.arrays import FloatArray, ImageArray


def draw_table(
    shares: Mapping[tuple[str, float], Distribution],
    widths: Sequence[float],
    thesis: Mapping[str, Sequence[float]],
) -> Figure:
    """Draw success by slot width and placement, the thesis' as crosses (Thesis Table 5-1).

    Args:
        shares: Fractions with intervals by placement and width.
        widths: Widths of the slots [m].
        thesis: Fractions of the thesis by placement.
    """
    figure = Figure(figsize=(6.5, 4.0))
    axes = figure.add_subplot()
    place = np.arange(len(widths), dtype=float)
    for offset, placement in ((-0.18, "optimal"), (0.18, "random")):
        mean, errors = error_bars([shares[placement, width] for width in widths])
        axes.bar(place + offset, mean, 0.34, color=COLOURS[placement], label=placement)
        axes.errorbar(place + offset, mean, errors, fmt="none", color="k", capsize=3)
        axes.plot(
            place + offset,
            thesis[placement][-len(widths) :],
            "x",
            color="k",
            label="thesis, of 10" if placement == "random" else None,
        )
    axes.set_xticks(place, [f"{width / INCH:g} in" for width in widths])
    axes.set(xlabel="slot", ylabel="inserted (95 % interval)", ylim=(0.0, 1.05))
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    figure.tight_layout()
    return figure


def draw_steps(steps: Sequence[tuple[float, ImageArray]]) -> Figure:
    """Draw intermediate steps of an insertion (Thesis figure 5-11).

    Args:
        steps: Times [s] and colour pictures.
    """
    figure = Figure(figsize=(10.0, 7.2))
    for axes, (time, picture) in zip(figure.subplots(2, 2).flat, steps):
        _show(axes, picture)
        axes.set_title(f"{time:.1f} s")
    figure.tight_layout()
    return figure


def draw_pairs(pairs: Mapping[str, tuple[ImageArray, Sequence[FloatArray]]]) -> Figure:
    """Draw what the master saw, with the ellipses that were fitted (Thesis figure 5-12).

    Args:
        pairs: Stereo pair (2, H, W) and ellipses (N, 5) of each image, by moment.
    """
    figure = Figure(figsize=(8.0, 3.9 * max(len(pairs), 1)))
    for row, (moment, (pair, ellipses)) in enumerate(pairs.items()):
        for side, name in enumerate(("left", "right")):
            axes = figure.add_subplot(len(pairs), 2, 2 * row + side + 1)
            _show(axes, pair[side])
            for ellipse in ellipses[side]:
                axes.plot(*_outline(ellipse), color=RED, linewidth=1.2)
            axes.set_title(f"{moment}, {name}")
    figure.tight_layout()
    return figure


def _outline(ellipse: FloatArray) -> FloatArray:
    """Return (2, 60) points on an ellipse (5,): centre and second moments suu, suv, svv."""
    root = np.linalg.cholesky(ellipse[[[2, 3], [3, 4]]] + 1e-9 * np.eye(2))
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    return ellipse[:2, None] + root @ [np.cos(angle), np.sin(angle)]


def _show(axes: Axes, picture: ImageArray) -> None:
    axes.imshow(picture, cmap="gray", vmin=0, vmax=255)
    axes.set(xticks=[], yticks=[])


def draw_course(course: FloatArray, title: str) -> Figure:
    """Draw errors and forces over time (Thesis figures 5-13, 5-14).

    Args:
        course: (n, k) rows of `COURSE`.
        title: Title of the figure.
    """
    columns: dict[str, FloatArray] = dict(zip(COURSE, course.T))
    time = columns["time"]
    figure = Figure(figsize=(9.0, 6.4))
    (place, turn), (across, ahead) = figure.subplots(2, 2, sharex=True)
    degree = 180.0 / np.pi
    for axes, column, scale, style, colour, label in (
        (place, "across", 1e3, "-", BLUE, "across, true"),
        (place, "ahead", 1e3, "-", ORANGE, "ahead, true"),
        (place, "seen_across", 1e3, ":", BLUE, "across, last seen"),
        (turn, "turn", degree, "-", BLUE, "true"),
        (turn, "seen_turn", degree, ":", BLUE, "last seen"),
        (across, "force_across", 1.0, "-", "0.7", "measured"),
        (across, "true_across", 1.0, "-", RED, "true"),
        (ahead, "force_ahead", 1.0, "-", "0.7", "measured"),
        (ahead, "true_ahead", 1.0, "-", RED, "true"),
    ):
        axes.plot(time, scale * columns[column], style, color=colour, label=label)
    place.set_ylabel("from the mouth [mm]")
    turn.set_ylabel("angle [deg]")
    across.set(ylabel="force across [N]", xlabel="time [s]")
    ahead.set(ylabel="force ahead [N]", xlabel="time [s]")
    begun = time[columns["stage"] >= STAGES.index(InsertionStage.INSERT)]
    for axes in (place, turn, across, ahead):
        axes.grid(alpha=0.3)
        if begun.size:
            axes.axvline(begun[0], color="k", linestyle="--", linewidth=0.8)
        axes.legend()
    figure.suptitle(f"{title}; dashed: force takes over")
    figure.tight_layout()
    return figure
