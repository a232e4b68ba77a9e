"""``ch3-swarm``: one to fifty robots map one indoor world together (section 6.2 (d)).

Each round every robot chooses a pose, goes there and scans (75 deg, 10 m). Cooperating robots claim
what they are about to see; independent ones choose for themselves on the common map.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.ch3.planar.record import record_trial
from experiments.ch3.planar.swarm_options import Options
from experiments.ch3.planar.trial import TARGET, PlanarRun, PlanarTrial, map_world, measure_arrival
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray

PLAN_BOUND = 100.0
"""Greatest median planning time of a robot's choice [ms]."""
TEAMS = ("cooperative", "independent")


def run(options: Options, output: Output) -> None:
    """Map every seed's floor by swarms of all sizes, cooperating and not.

    Args:
        options: ``quick`` takes 1 seed instead of 12.
        output: Receives ``rounds_to_90/<n>``, ``metres_to_90/<n>`` and ``plan_ms/<n>``; a
            recording shows the smallest swarm.
    """
    seeds = options.job_seeds(12, 1)
    cases = [(size, team) for size in options.sizes() for team in TEAMS[: 2 if size > 1 else 1]]
    trials = [
        PlanarTrial("indoor", seed, "information", 75.0, 10.0, 400, size, team == TEAMS[0],
                    target=TARGET)
        for size, team in cases
        for seed in seeds
    ]  # fmt: skip
    results = sweep(map_world, trials, options, output, label="runs")
    arrivals: dict[tuple[int, str], FloatArray] = {}
    rows: list[list[Any]] = []
    for index, (size, team) in enumerate(cases):
        chosen = results[index * len(seeds) : (index + 1) * len(seeds)]
        arrivals[size, team] = when = _measure(size, team, chosen, output)
        for seed, arrival, run_ in zip(seeds, when.tolist(), chosen, strict=True):
            rows.append([size, team, seed, *arrival, float(np.mean(run_.plan_ms))])
    columns = ("robots", "team", "seed", "rounds to 90 %", "metres to 90 %", "plan [ms a robot]")
    output.table("swarm_runs", columns, rows)
    output.figure("swarm", _figure(arrivals))
    if options.record:
        record_trial(trials[0], output.file("run.rrd"))


def _measure(size: int, team: str, chosen: Sequence[PlanarRun], output: Output) -> FloatArray:
    """Store one size's metrics; return rounds and metres to 90 % of each run."""
    case = str(size) if team == TEAMS[0] else f"{size}/{team}"
    when = measure_arrival(chosen, "rounds", f"/{case}", output)
    if team == TEAMS[0]:
        plan = distribution(np.concatenate([result.plan_ms for result in chosen]))
        output.measure(f"plan_ms/{case}", plan)
        median = float(plan["median"])
        name = f"choice of one of {size} robots in ms, median"
        output.check(name, median, f"<= {PLAN_BOUND:g}", median <= PLAN_BOUND)
    return when


def _figure(arrivals: Mapping[tuple[int, str], FloatArray]) -> Figure:
    """Draw rounds and metres to 90 % over the size, against a perfect division of the work.

    Args:
        arrivals: (runs, 2) rounds and metres to 90 %, by size and team.
    """
    figure = Figure(figsize=(10, 4.5))
    left, right = figure.subplots(1, 2)
    for team in dict.fromkeys(team for _, team in arrivals):
        sizes = np.array([size for size, each in arrivals if each == team])
        for axes, column in ((left, 0), (right, 1)):
            summaries = [distribution(arrivals[size, team][:, column]) for size in sizes]
            medians, low, high = (
                np.array([summary[key] for summary in summaries])
                for key in ("median", "low", "high")
            )
            finite = np.isfinite(low) & np.isfinite(high)
            bars = [np.where(finite, np.abs(side - medians), 0.0) for side in (low, high)]
            axes.errorbar(sizes, medians, bars, marker="o", capsize=3, label=team)
            if (team, column) == (TEAMS[0], 0):
                ideal = medians[0] * sizes[0] / sizes
                axes.plot(sizes, ideal, "k:", linewidth=0.8, label="evenly divided")
    left.set(yscale="log", ylabel=f"rounds to {TARGET:.0%}")
    right.set(ylabel=f"metres to {TARGET:.0%}, all robots")
    for axes in (left, right):
        axes.set(xscale="log", xlabel="robots")
        axes.grid(alpha=0.3)
        axes.legend(title="median, 95 % interval")
    figure.subplots_adjust(wspace=0.3)
    return figure
