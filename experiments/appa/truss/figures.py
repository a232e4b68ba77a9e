"""Figures of ``appa-truss``: a run over time as the thesis shows it, and forces by misalignment."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from controllers.insertion.master_slave import Stage
from experiments.appa.truss.trial import COLUMNS, SQUEEZE, TrussRun

Floats = NDArray[np.float64]
_BEGINS = (Stage.CARRY, Stage.INSERT)
_PLACES = ("s [mm]", "z [mm]", "angle [deg]")
_LOADS = ("along [N]", "up [N]", "moment [N m]")
_JOINTS = ("shoulder", "elbow", "wrist")


def draw_course(course: Floats, name: str) -> Figure:
    """Draw figure A-10, A-11 or A-12: master above, slave below.

    Args:
        course: (n, 41) of `run_truss`.
        name: ``A-10`` (grips: motion and force), ``A-11`` (joints' and bases' motion) or ``A-12``
            (joints' and bases' efforts).

    Raises:
        ValueError: If it is another.
    """
    lengths = np.array([1e3, 1e3, 180.0 / np.pi])
    turns = np.full(3, 180.0 / np.pi)
    panels: dict[str, tuple[tuple[str, str, Floats, Sequence[str], bool], ...]] = {
        "A-10": (
            ("gripper, from its start", "gripper", lengths, _PLACES, True),
            ("gripper on segment", "wrench", np.ones(3), _LOADS, False),
        ),
        "A-11": (
            ("joints, from their start [deg]", "joints", turns, _JOINTS, True),
            ("base, from its start", "base", lengths, _PLACES, True),
        ),
        "A-12": (
            ("motors [N m]", "efforts", np.ones(3), _JOINTS, False),
            ("base on arm", "base_wrench", np.ones(3), _LOADS, False),
        ),
    }
    if name not in panels:
        raise ValueError(f"figure {name!r}: valid are {', '.join(panels)}")
    figure = Figure(figsize=(11, 6.5))
    for row, robot in enumerate(("master", "slave")):
        for column, (title, key, scale, labels, relative) in enumerate(panels[name]):
            axes = figure.add_subplot(2, 2, 1 + 2 * row + column)
            values = course[:, COLUMNS[key]][:, 3 * row : 3 * row + 3]
            values = scale * (values - values[0] if relative else values)
            _lines(axes, course, values, labels)
            axes.set_title(f"{robot}: {title}", fontsize=10)
            if row == 1:
                axes.set_xlabel("time [s]")
    note = "dotted: the way to the mouth begins, the insertion begins"
    figure.text(0.5, 0.02, note, ha="center", fontsize=9)
    figure.subplots_adjust(hspace=0.3, wspace=0.2)
    return figure


def _lines(axes: Axes, course: Floats, values: Floats, labels: Sequence[str]) -> None:
    """Draw lines over time, and when the way and the insertion begin."""
    for line, label in zip(values.T, labels, strict=True):
        axes.plot(course[:, 0], line, linewidth=0.9, label=label)
    for stage in _BEGINS:
        reached = np.flatnonzero(course[:, 1] == list(Stage).index(stage))
        if len(reached):
            axes.axvline(course[reached[0], 0], color="0.6", linewidth=0.8, linestyle=":")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def draw_comparison(results: Mapping[tuple[str, float], Sequence[TrussRun]]) -> Figure:
    """Draw success, contact force, squeeze and moment of every run by way and misalignment.

    Args:
        results: Of `run_truss`, by way and share of the widest misalignment.
    """
    figure = Figure(figsize=(11, 7))
    ways = list(dict.fromkeys(way for way, _ in results))
    shares = sorted({share for _, share in results})
    panels = (
        ("success", "inserted, share of runs"),
        ("contact_peak", "peak contact force [N]"),
        ("squeeze_error_rms", f"squeeze, r.m.s. off {SQUEEZE:g} N [N]"),
        ("moment_peak", "peak moment at a grip [N m]"),
    )
    for index, (key, title) in enumerate(panels):
        axes = figure.add_subplot(2, 2, 1 + index)
        for number, way in enumerate(ways):
            places = np.arange(len(shares)) + 0.22 * (number - (len(ways) - 1) / 2.0)
            values = [[float(getattr(run, key)) for run in results[way, share]] for share in shares]
            middles = [np.mean(v) if key == "success" else np.median(v) for v in values]
            bars = axes.bar(places, middles, 0.2, alpha=0.6, label=way.replace("_", " "))
            if key != "success":
                for place, runs in zip(places, values, strict=True):
                    colour = bars.patches[0].get_facecolor()
                    axes.plot(np.full(len(runs), place), runs, ".", color=colour, markersize=4)
        axes.set_xticks(range(len(shares)), [f"{share:g}" for share in shares])
        axes.set_title(title, fontsize=10)
        axes.grid(axis="y", alpha=0.3)
        if index >= 2:
            axes.set_xlabel("misalignment, of the widest asked for")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(ways), fontsize=9,
                  title="bars: share or median; dots: runs")  # fmt: skip
    figure.subplots_adjust(hspace=0.3, bottom=0.17)
    return figure
