"""``appa-truss``: two rovers hold one segment and insert it in a truss stage (Thesis A.4).

Master and slave as in figure A-8, on their suspensions, with their datasheets' sensors and the
9600-baud radio between them. The stage stands elsewhere than the master believes, and the slave
elsewhere than the map says. Compared are the hybrid control, the same without its force half (both
grips hold positions; the insertion still gives way), and the hybrid grips without guidance.
"""

import dataclasses
import math
from typing import Any

from experiments.appa.truss.figures import draw_comparison, draw_course
from experiments.appa.truss.trial import (
    MUTUAL,
    OFFSET,
    TILT,
    WAYS,
    TrussRun,
    TrussTrial,
    run_truss,
)
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

WIDEST = 1.0
SHARES = (0.5, WIDEST, 1.5)
"""Of the widest misalignment asked for; the last lies beyond it."""
QUICK_SHARES = (WIDEST,)
FORCE_BOUND, SUCCESS_BOUND, SQUEEZE_RATIO_BOUND = 10.0, 0.9, 0.5
_FORCES = ("contact_peak", "squeeze_peak", "squeeze_error_rms", "moment_peak")
Results = dict[tuple[str, float], list[TrussRun]]


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of appa-truss."""


def run(options: Options, output: Output) -> None:
    """Insert from every misalignment in every way.

    Args:
        options: ``quick`` takes 2 runs a cell instead of 10, at the widest misalignment alone.
        output: Receives ``truss_success`` (hybrid, widest), and by way and share ``success``,
            ``contact_peak``, ``squeeze_peak``, ``squeeze_error_rms``, ``moment_peak``, ``seconds``.
    """
    seeds = options.job_seeds(10, 2)
    shares = QUICK_SHARES if options.quick else SHARES
    cells = [(way, share) for way in WAYS for share in shares]
    trials = [
        TrussTrial(way, share, seed, traced=(way, share) == ("hybrid", WIDEST) and seed == seeds[0])
        for way, share in cells
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
    for (way, share), runs in results.items():
        cell = f"{way}/{share:g}"
        done = fraction(sum(run.success for run in runs), len(runs))
        output.measure(f"success/{cell}", done)
        if (way, share) == ("hybrid", WIDEST):
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
        for (way, _), runs in results.items()
        if way == "hybrid"
        for run in runs
    )
    output.check("peak contact force [N], hybrid, all", peak, f"<= {FORCE_BOUND:g}",
                 peak <= FORCE_BOUND)  # fmt: skip
    ours, without = (
        float(distribution([run.squeeze_error_rms for run in results[way, WIDEST]])["median"])
        for way in ("hybrid", "position_only")
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
    for (way, share), runs in results.items():
        for seed, run in zip(seeds, runs, strict=True):
            mutual = [1e3 * float(value) for value in run.mutual]
            forces = [getattr(run, key) for key in _FORCES]
            place = [1e3 * run.offset, math.degrees(run.tilt), *mutual]
            end = [run.seconds, run.tries, run.reason]
            rows.append([way, share, seed, *place, run.success, 1e3 * run.depth, *forces,
                         *end])  # fmt: skip
    output.table("truss_runs", columns, rows)
