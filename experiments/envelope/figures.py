"""Figure of ``mission-envelope``: success over the levels of each axis."""

import math
from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.envelope.axes import AXES
from experiments.envelope.cells import Cell
from experiments.harness.figure_style import BLUE, GREEN, ORANGE, PURPLE, RED, SKY, YELLOW
from experiments.harness.intervals import Distribution, error_bars

COLOURS = {
    "whole": "black",
    "without_identification": BLUE,
    "without_force": RED,
    "without_replanning": ORANGE,
    "without_placement": GREEN,
    "without_cooperation": PURPLE,
    "without_paths": SKY,
    "without_panel": YELLOW,
}
_COLUMNS = 4


def draw_envelope(
    screened: Mapping[Cell, Distribution], confirmed: Mapping[Cell, Distribution]
) -> Figure:
    """Draw screened shares as lines, and confirmed ones with their intervals.

    Args:
        screened: Success of every cell in the screening.
        confirmed: Success of the cells that other seeds confirmed.
    """
    axes = list(dict.fromkeys(cell.axis for cell in screened))
    columns = min(_COLUMNS, len(axes))
    rows = math.ceil(len(axes) / columns)
    figure = Figure(figsize=(3.4 * columns, 2.8 * rows + 0.6))
    grid = figure.subplots(rows, columns, squeeze=False)
    for panel, name in zip(grid.flat, axes):
        _draw_axis(panel, name, screened, confirmed)
    for panel in grid.flat[len(axes) :]:
        panel.set_visible(False)
    handles = {
        label: handle
        for panel in grid.flat[: len(axes)]
        for handle, label in zip(*panel.get_legend_handles_labels())
    }
    figure.legend(
        handles.values(), handles.keys(), loc="upper center", ncols=len(handles), frameon=False
    )
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 1.0 - 0.35 / figure.get_figheight()))
    return figure


def _draw_axis(
    panel: Axes,
    name: str,
    screened: Mapping[Cell, Distribution],
    confirmed: Mapping[Cell, Distribution],
) -> None:
    """Draw one axis; levels stand at equal distances."""
    levels = sorted({cell.level for cell in screened if cell.axis == name})
    kinds = list(dict.fromkeys(cell.name for cell in screened if cell.axis == name))
    for shift, kind in enumerate(kinds):
        shares = {c.level: d for c, d in screened.items() if (c.axis, c.name) == (name, kind)}
        label = kind.replace("_", " ")
        values = [shares[level]["mean"] for level in levels]
        panel.plot(range(len(levels)), values, ".-", color=COLOURS[kind], alpha=0.5, label=label)
        again = {c.level: d for c, d in confirmed.items() if (c.axis, c.name) == (name, kind)}
        if again:
            means, errors = error_bars(list(again.values()))
            places = [levels.index(level) + 0.06 * shift for level in again]
            panel.errorbar(places, means, errors, fmt="o", color=COLOURS[kind], capsize=3)
    panel.set_xticks(range(len(levels)), [f"{level:g}" for level in levels])
    panel.set(xlim=(-0.3, len(levels) - 0.6), ylim=(-0.05, 1.05))
    what = "success" if AXES[name].whole else "seated"
    panel.set(xlabel=AXES[name].title, ylabel=f"{what} (95 % interval) [-]")
