"""``appa-truss``: two rovers hold one segment and insert it in a truss stage (Thesis A.4).

Master and slave as in figure A-8, on their suspensions, with their datasheets' sensors and the
9600-baud radio between them. The stage's true pose differs from the master's estimate, and the
slave's from that on the map. Compared are the hybrid control, the same without its force half (both
grips hold positions; the insertion still gives way), and the hybrid grips without guidance.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from controllers.insertion.master_slave import Stage
from experiments.appa.truss.trial import (
    COLUMNS,
    METHODS,
    MUTUAL,
    OFFSET,
    SQUEEZE,
    TILT,
    TrussRun,
    TrussTrial,
    run_truss,
)
from experiments.appa.truss.truss_options import Options
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray

WIDEST = 1.0
SHARES = (0.5, WIDEST, 1.5)
"""Of the widest misalignment asked for; the last lies beyond it."""
QUICK_SHARES = (WIDEST,)
FORCE_BOUND, SUCCESS_BOUND, SQUEEZE_RATIO_BOUND = 10.0, 0.9, 0.5
_FORCES = ("contact_peak", "squeeze_peak", "squeeze_error_rms", "moment_peak")
_BEGINS = (Stage.CARRY, Stage.INSERT)
_PLACES = ("s [mm]", "z [mm]", "angle [deg]")
_LOADS = ("along [N]", "up [N]", "moment [N m]")
_JOINTS = ("shoulder", "elbow", "wrist")
Results = dict[tuple[str, float], list[TrussRun]]


def run(options: Options, output: Output) -> None:
    """Insert from every misalignment in every method.

    Args:
        options: ``quick`` takes 2 runs a cell instead of 10, at the widest misalignment alone.
        output: Receives ``truss_success`` (hybrid, widest), and by method and share ``success``,
            ``contact_peak``, ``squeeze_peak``, ``squeeze_error_rms``, ``moment_peak``, ``seconds``.
    """
    seeds = options.job_seeds(10, 2)
    shares = QUICK_SHARES if options.quick else SHARES
    cells = [(method, share) for method in METHODS for share in shares]
    trials = [
        TrussTrial(*cell, seed, traced=cell == ("hybrid", WIDEST) and seed == seeds[0])
        for cell in cells
        for seed in seeds
    ]
    runs = sweep(run_truss, trials, options, output, label="runs")
    size = len(seeds)
    results = {cell: runs[i * size : (i + 1) * size] for i, cell in enumerate(cells)}
    _measure(results, output)
    _check(results, output)
    _table(results, seeds, output)
    course = results["hybrid", WIDEST][0].course
    assert course is not None
    for name in ("A-10", "A-11", "A-12"):
        output.figure(f"figure_{name}", draw_course(course, name))
    output.figure("misalignments", draw_comparison(results))


def _measure(results: Results, output: Output) -> None:
    output.measure("widest_offset_mm", 1e3 * OFFSET)
    output.measure("widest_tilt_deg", math.degrees(TILT))
    output.measure("widest_mutual_mm", 1e3 * MUTUAL)
    for (method, share), runs in results.items():
        cell = f"{method}/{share:g}"
        done = fraction(sum(run.success for run in runs), len(runs))
        output.measure(f"success/{cell}", done)
        if (method, share) == ("hybrid", WIDEST):
            output.measure("truss_success", done)
        for key in (*_FORCES, "seconds"):
            output.measure(f"{key}/{cell}", distribution([getattr(run, key) for run in runs]))


def _check(results: Results, output: Output) -> None:
    """Hold the hybrid control against the bars, at the widest misalignment."""
    hybrid = results["hybrid", WIDEST]
    done = sum(run.success for run in hybrid) / len(hybrid)
    output.check("inserted at the widest misalignment", done, f">= {SUCCESS_BOUND:g}",
                 done >= SUCCESS_BOUND)  # fmt: skip
    peak = max(
        float(run.contact_peak)
        for (method, _), runs in results.items()
        if method == "hybrid"
        for run in runs
    )
    output.check("peak contact force [N], hybrid, all", peak, f"<= {FORCE_BOUND:g}",
                 peak <= FORCE_BOUND)  # fmt: skip
    ours, without = (
        float(distribution([run.squeeze_error_rms for run in results[method, WIDEST]])["median"])
        for method in ("hybrid", "position_only")
    )
    ratio = ours / without
    output.measure("squeeze_error_ratio/hybrid_over_position_only", ratio)
    output.check("squeeze error, hybrid over positions only", ratio, f"<= {SQUEEZE_RATIO_BOUND:g}",
                 ratio <= SQUEEZE_RATIO_BOUND)  # fmt: skip


def _table(results: Results, seeds: list[int], output: Output) -> None:
    columns = ["way", "share", "seed", "offset [mm]", "tilt [deg]", "slave along [mm]",
               "slave up [mm]", "success", "depth [mm]", "contact peak [N]", "squeeze peak [N]",
               "squeeze error [N]", "moment peak [N m]", "time [s]", "tries", "reason"]  # fmt: skip
    rows: list[list[Any]] = []
    for (method, share), runs in results.items():
        for seed, run in zip(seeds, runs, strict=True):
            mutual = [1e3 * float(value) for value in run.mutual]
            forces = [getattr(run, key) for key in _FORCES]
            place = [1e3 * run.offset, math.degrees(run.tilt), *mutual]
            end = [run.seconds, run.tries, run.reason]
            rows.append([method, share, seed, *place, run.success, 1e3 * run.depth, *forces,
                         *end])  # fmt: skip
    output.table("truss_runs", columns, rows)


def draw_course(course: FloatArray, name: str) -> Figure:
    """Draw figure A-10, A-11 or A-12: master above, slave below.

    Args:
        course: (n, 41) course of a run, by `COLUMNS`.
        name: ``A-10`` (grips: motion and force), ``A-11`` (joints' and bases' motion) or ``A-12``
            (joints' and bases' efforts).
    """
    lengths = np.array([1e3, 1e3, 180.0 / np.pi])
    turns = np.full(3, 180.0 / np.pi)
    panels: dict[str, tuple[tuple[str, str, FloatArray, Sequence[str], bool], ...]] = {
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
    figure = Figure(figsize=(11, 6.5))
    for row, robot in enumerate(("master", "slave")):
        for column, (title, key, scale, labels, relative) in enumerate(panels[name]):
            axes = figure.add_subplot(2, 2, 1 + 2 * row + column)
            values = course[:, COLUMNS[key]][:, 3 * row : 3 * row + 3]
            values = scale * (values - values[0] if relative else values)
            for line, label in zip(values.T, labels, strict=True):
                axes.plot(course[:, 0], line, linewidth=0.9, label=label)
            for stage in _BEGINS:
                reached = np.flatnonzero(course[:, 1] == list(Stage).index(stage))
                if len(reached):
                    begin = course[reached[0], 0]
                    axes.axvline(begin, color="0.6", linewidth=0.8, linestyle=":")
            axes.grid(alpha=0.3)
            axes.legend()
            axes.set_title(f"{robot}: {title}")
            if row == 1:
                axes.set_xlabel("time [s]")
    note = "dotted: the carry to the mouth begins, the insertion begins"
    figure.text(0.5, 0.02, note, ha="center", fontsize="small")
    figure.subplots_adjust(hspace=0.3, wspace=0.2)
    return figure


def draw_comparison(results: Results) -> Figure:
    """Draw success, contact force, squeeze and moment of every run by method and misalignment."""
    figure = Figure(figsize=(11, 7))
    methods = list(dict.fromkeys(method for method, _ in results))
    shares = sorted({share for _, share in results})
    panels = (
        ("success", "inserted, share of runs"),
        ("contact_peak", "peak contact force [N]"),
        ("squeeze_error_rms", f"squeeze, r.m.s. off {SQUEEZE:g} N [N]"),
        ("moment_peak", "peak moment at a grip [N m]"),
    )
    for index, (key, title) in enumerate(panels):
        axes = figure.add_subplot(2, 2, 1 + index)
        for number, method in enumerate(methods):
            places = np.arange(len(shares)) + 0.22 * (number - (len(methods) - 1) / 2.0)
            cells = [results[method, share] for share in shares]
            values = [[float(getattr(run, key)) for run in runs] for runs in cells]
            middles = [np.mean(v) if key == "success" else np.median(v) for v in values]
            bars = axes.bar(places, middles, 0.2, alpha=0.6, label=method.replace("_", " "))
            if key != "success":
                for place, runs in zip(places, values, strict=True):
                    colour = bars.patches[0].get_facecolor()
                    axes.plot(np.full(len(runs), place), runs, ".", color=colour, markersize=4)
        axes.set_xticks(range(len(shares)), [f"{share:g}" for share in shares])
        axes.set_title(title)
        axes.grid(axis="y", alpha=0.3)
        if index >= 2:
            axes.set_xlabel("misalignment, of the widest asked for")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(methods),
                  title="bars: share or median; dots: runs")  # fmt: skip
    figure.subplots_adjust(hspace=0.3, bottom=0.17)
    return figure
