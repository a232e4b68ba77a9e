"""Figures of ``appa-tipover``: the zero-moment point over the footprint, and what guards allow."""

from collections.abc import Mapping

from matplotlib.figure import Figure

from experiments.appa.tipover.trial import TipRun
from models.datasheets import ROVER

Shown = Mapping[str, TipRun]
NAMES = {"unguarded": "as asked for", "planned": "planned ahead", "online": "slowed online"}


def draw_footprints(shown: Shown) -> Figure:
    """Draw the paths of both points over the footprint, a column for each guard.

    Args:
        shown: Results of `run_tip` by guard.
    """
    figure = Figure(figsize=(12, 4.6))
    x, y = 1e3 * ROVER.half_track, 1e3 * ROVER.half_wheelbase
    for column, (guard, result) in enumerate(shown.items()):
        axes = figure.add_subplot(1, len(shown), 1 + column)
        axes.plot([x, -x, -x, x, x], [y, y, -y, -y, y], "k-", linewidth=1, label="footprint")
        point, pressure = 1e3 * result.point, 1e3 * result.pressure
        axes.plot(*point.T, ".-", linewidth=0.6, label="zero-moment point (A-5)")
        axes.plot(*pressure.T, "x", markersize=4, label="centre of pressure")
        end = "tipped" if result.tipped else f"tilted {result.lean_deg:.1f} deg"
        axes.set_title(f"{NAMES[guard]}: {end}", fontsize=10)
        axes.set(aspect="equal", xlim=(-180, 180), ylim=(-180, 180), xlabel="to the right [mm]")
        axes.grid(alpha=0.3)
        if column == 0:
            axes.set(ylabel="forward [mm]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=3, fontsize=9)
    figure.subplots_adjust(bottom=0.2)
    return figure


def draw_progress(shown: Shown) -> Figure:
    """Draw how far the reference has gone over time, and the pressure's margin.

    Args:
        shown: As `draw_footprints`.
    """
    figure = Figure(figsize=(11, 4))
    left, right = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2)
    for guard, result in shown.items():
        time, part = result.gone.T
        left.plot(time, 100.0 * part, label=NAMES[guard])
        right.plot(time, 1e3 * result.margin, linewidth=1, label=NAMES[guard])
    left.set(ylabel="reference, share of the path [%]")
    right.set(ylabel="centre of pressure inside the footprint [mm]", ylim=(0, None))
    for axes in (left, right):
        axes.set(xlabel="time since the motion's beginning [s]")
        axes.grid(alpha=0.3)
    left.legend(fontsize=9)
    figure.subplots_adjust(wspace=0.25)
    return figure
