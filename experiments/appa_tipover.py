"""``appa-tipover``: swings of a loaded arm that tip the rover, and the guard (Thesis A.3).

Each motion goes from the folded arm to a drawn reach, as asked for and as the guard allows it. The
zero-moment point of eq. A-5 is compared with MuJoCo's centre of pressure all the while.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments import contract
from experiments.appa_tipover_trial import TipTrial, run_tip
from experiments.intervals import distribution
from experiments.output import Output
from experiments.sweep import sweep
from models.datasheets import ROVER

LOADS = (0.5, 1.0, 1.3)
"""In the gripper [kg]: from a tenth to a third of the rover's own weight."""
ZMP_BOUND = 1.0
"""Of the zero-moment point against the centre of pressure [mm]."""


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of appa-tipover."""


def run(options: Options, output: Output) -> None:
    """Run every motion twice.

    Args:
        options: ``quick`` takes 1 motion a load instead of 8.
        output: Receives ``zmp_error_mm``, ``tip_overs_unguarded`` and ``tip_overs_guarded``.
    """
    trials = [
        trial for load in LOADS for seed in options.job_seeds(8, 1) for trial in motions(load, seed)
    ]
    results = sweep(run_tip, trials, options, output, label="runs")
    errors = [
        1e3 * float(np.max(np.linalg.norm(result["point"] - result["pressure"], axis=1)))
        for result in results
        if len(result["point"])
    ]
    output.measure("zmp_error_mm", distribution(errors))
    worst = max(errors)
    output.check(
        "zero-moment point against the centre of pressure, worst [mm]", worst, f"<= {ZMP_BOUND:g}",
        worst <= ZMP_BOUND,
    )  # fmt: skip
    tips = {
        guarded: sum(r["tipped"] for t, r in zip(trials, results) if t.guarded is guarded)
        for guarded in (False, True)
    }
    output.measure("tip_overs_unguarded", tips[False])
    output.measure("tip_overs_guarded", tips[True])
    output.measure("motions", len(trials) // 2)
    slowed = [r["stretch"] for t, r in zip(trials, results) if t.guarded]
    output.measure("guard_stretch", distribution(slowed))
    output.check("tip-overs without guard", tips[False], "> 0", tips[False] > 0)
    output.check("tip-overs with guard", tips[True], "= 0", tips[True] == 0)
    rows = [
        [trial.load, trial.duration, np.degrees(trial.yaw), trial.guarded, result["tipped"],
         result["lean_deg"], result["stretch"], result["part"], result["report"]]
        for trial, result in zip(trials, results)
    ]  # fmt: skip
    columns = ["load [kg]", "asked duration [s]", "yaw [deg]", "guarded", "tipped",
               "largest lean [deg]", "stretch", "part of the way", "guard's report"]  # fmt: skip
    output.table("tip_over_runs", columns, rows)
    # The guarded run with the most to do, beside the same motion without the guard.
    index = max(range(1, len(trials), 2), key=lambda i: results[i]["stretch"])
    output.figure("figure_A-4", _figure(results[index - 1], results[index]))


def motions(load: float, seed: int) -> list[TipTrial]:
    """Return a drawn motion, as asked for and guarded.

    Args:
        load: In the gripper [kg].
        seed: Draws direction, reach and duration.
    """
    rng = np.random.default_rng([seed, round(1e3 * load)])
    yaw = float(rng.uniform(-1.6, 1.6))
    shoulder, elbow = float(rng.uniform(0.2, 0.7)), float(rng.uniform(-0.7, -0.1))
    target = (yaw, shoulder, elbow, float(rng.uniform(-0.3, 0.3)))
    duration = float(rng.uniform(0.5, 1.0))
    return [TipTrial(load, yaw, target, duration, guarded, seed) for guarded in (False, True)]


def _figure(unguarded: Mapping[str, Any], guarded: Mapping[str, Any]) -> Figure:
    """Draw both points' ways over the footprint."""
    figure = Figure(figsize=(9, 4.5))
    x, y = 1e3 * ROVER.half_track, 1e3 * ROVER.half_wheelbase
    for column, (name, result) in enumerate((("as asked", unguarded), ("guarded", guarded))):
        axes = figure.add_subplot(1, 2, 1 + column)
        axes.plot([x, -x, -x, x, x], [y, y, -y, -y, y], "k-", linewidth=1, label="footprint")
        way, pressure = 1e3 * result["point"], 1e3 * result["pressure"]
        axes.plot(way[:, 0], way[:, 1], ".-", linewidth=0.6, label="zero-moment point (A-5)")
        axes.plot(pressure[:, 0], pressure[:, 1], "x", markersize=4, label="centre of pressure")
        axes.set(title=f"{name}: lean {result['lean_deg']:.1f} deg", aspect="equal",
                 xlabel="x [mm]", ylabel="y [mm]")  # fmt: skip
        axes.grid(alpha=0.3)
        if column == 0:
            axes.legend(loc="lower left", fontsize=7)
    return figure
