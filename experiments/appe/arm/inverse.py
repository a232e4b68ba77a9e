"""``appe-inverse``: words for targets by seven searches, and words that keep clear of obstacles.

As in E.3.2: targets at random, time, displacement and angle of each method, for 5, 10 and 20
stages. Targets are poses of stages whose legs have any length between short and long. Orientations
drawn uniformly, as the thesis seems to have them, are shown beside: hardly any is within reach, so
they measure the draw rather than the search. All lengths are in radii of the discs.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.arm.inverse import METHODS
from experiments.appe.arm.inverse_options import Options
from experiments.appe.arm.inverse_trial import (
    CLEAR_STAGES,
    EQUAL_TIME,
    ClearTrial,
    ClearWords,
    Solved,
    TargetTrial,
    methods_for,
    solve_scenes,
    solve_targets,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import concatenated, seeded_chunks, sweep

Results = dict[str, Solved]

STAGES = (5, 10, 20)
PLANTED, QUICK_PLANTED = 100, 8
SCENES, QUICK_SCENES = 200, 8
CHUNK = 50
"""Number of targets in a job."""
EXACT, PLANTED_COST = 1e-9, 1e-9
MEET_MS, RATIO = 30.0, 0.65
OBSTACLES = ("balls", "voxels")
"""Form of a scene's obstacles: a function of places, or the occupied voxels of a map."""
CHOSEN = {5: "kd-tree", 10: "meet", 20: "walk"}
"""The method to use with so many stages."""
COLOURS = {name: f"C{index}" for index, name in enumerate(METHODS)}
COLOURS[EQUAL_TIME] = COLOURS["exchange"]  # dashed
LABELS = {EQUAL_TIME: "exchange, equal time"}
MEASURED = {
    "cost": ("cost", 1.0),
    "displacement": ("displacement", 1.0),
    "angle": ("angle_deg", 180.0 / np.pi),
    "ms": ("ms", 1.0),
}
"""Name in the results, and factor of its unit, of each field of `Solved`."""


def run(options: Options, output: Output) -> None:
    """Solve all targets, then the scenes.

    Args:
        options: ``quick`` takes 20 targets of each kind, 8 of the planted, and 8 scenes.
        output: Receives ``<cost, displacement, angle_deg or ms>/<kind>/<stages>/<method>``,
            ``exact_match_fraction/5``, ``planted_recovered_fraction/10``,
            ``ms_per_target/<stages>``, ``cost_ratio_over_exchange/20`` and
            ``clear_found_fraction/<balls or voxels>/<method>``.
    """
    cases = [(kind, stages) for kind in ("reachable", "random") for stages in STAGES]
    cases.append(("planted", 10))
    planted = QUICK_PLANTED if options.quick else PLANTED
    counts = {"reachable": options.count(), "random": options.count(), "planted": planted}
    trials = [
        TargetTrial(stages, kind, seed, size)
        for kind, stages in cases
        for seed, size in seeded_chunks(counts[kind], CHUNK, options.seed)
    ]
    solved = sweep(solve_targets, trials, options, output, label="targets")
    results = {case: _joined(case, trials, solved) for case in cases}
    for (kind, stages), result in results.items():
        _measure(kind, stages, result, output)
    _check_exact(results, output)
    _check_heuristics(results, output)
    chunks = seeded_chunks(QUICK_SCENES if options.quick else SCENES, CHUNK, options.seed)
    for kind in OBSTACLES:
        scenes = [ClearTrial(seed, size, kind == "voxels") for seed, size in chunks]
        found = sweep(solve_scenes, scenes, options, output, label=kind)
        _measure_scenes(kind, concatenated(found), output)
    output.figure("inverse", _figure(results))


def _joined(
    case: tuple[str, int], trials: Sequence[TargetTrial], solved: Sequence[Results]
) -> Results:
    parts = [result for trial, result in zip(trials, solved) if (trial.kind, trial.stages) == case]
    return {name: concatenated([part[name] for part in parts]) for name in parts[0]}


def _measure(kind: str, stages: int, result: Results, output: Output) -> None:
    rows = []
    for method in methods_for(stages):
        row: list[Any] = [method]
        for field, (name, factor) in MEASURED.items():
            summary = distribution(factor * getattr(result[method], field))
            output.measure(f"{name}/{kind}/{stages}/{method}", summary)
            row += [summary["median"], summary["p95"]]
        rows.append(row)
    names = ("cost [r]", "displacement [r]", "angle [deg]", "time [ms]")
    columns = ["method", *(f"{name}, {part}" for name in names for part in ("median", "p95"))]
    output.table(f"inverse_{kind}_{stages}", columns, rows)


def _check_exact(results: Mapping[tuple[str, int], Results], output: Output) -> None:
    """Hold the exact methods against each other, and planted words against zero."""
    five = results["reachable", 5]
    off = np.maximum(
        np.abs(five["kd-tree"].cost - five["exhaustive"].cost),
        np.abs(five["meet"].cost - five["exhaustive"].cost),
    )
    match = fraction(int(np.sum(off <= EXACT)), len(off))
    output.measure("exact_match_fraction/5", match)
    output.check("5 stages: equal to brute force", match["median"], "== 1", match["median"] == 1.0)
    planted = results["planted", 10]["meet"].cost
    recovered = fraction(int(np.sum(planted <= PLANTED_COST)), len(planted))
    output.measure("planted_recovered_fraction/10", recovered)
    share = recovered["median"]
    output.check("10 stages: planted poses recovered", share, "== 1", share == 1.0)
    for stages, method in CHOSEN.items():
        output.measure(
            f"ms_per_target/{stages}", distribution(results["reachable", stages][method].ms)
        )
    for kind in ("reachable", "planted"):
        median = float(np.median(results[kind, 10]["meet"].ms))
        name = f"10 stages: exact search in ms, median, {kind}"
        output.check(name, median, f"<= {MEET_MS:g}", median <= MEET_MS)


def _check_heuristics(results: Mapping[tuple[str, int], Results], output: Output) -> None:
    twenty = results["reachable", 20]
    ours, peer = (np.median(twenty[m].cost) for m in (CHOSEN[20], EQUAL_TIME))
    ratio = float(ours / peer)
    output.measure("cost_ratio_over_exchange/20", ratio)
    share = np.median(twenty[EQUAL_TIME].ms / twenty[CHOSEN[20]].ms)
    output.measure("time_ratio_of_exchange/20", float(share))
    name = "20 stages: median cost over the exchange heuristic's at equal time"
    output.check(name, ratio, f"<= {RATIO:g}", ratio <= RATIO)
    exact = [result for result in results.values() if "meet" in result]
    better = sum(int(np.sum(r["genetic"].cost < r["meet"].cost - EXACT)) for r in exact)
    output.measure("genetic_better_than_exact", better)
    output.check("targets where genetic search beats the exact one", better, "== 0", better == 0)


def _measure_scenes(kind: str, found: ClearWords, output: Output) -> None:
    """Compare the searches among clear words with the exhaustive one."""
    exists = np.isfinite(found.exhaustive)
    for name, scenes in (("with_clear_word", exists), ("nearest_word_touches", found.touches)):
        output.measure(f"scenes/{kind}/{name}", fraction(int(scenes.sum()), len(scenes)))
    collisions = int(found.collisions.sum())
    output.check(f"{kind}: words found clear that touch", collisions, "== 0", collisions == 0)
    if exists.any():
        output.measure(f"scenes/{kind}/cost_clear", distribution(found.exhaustive[exists]))
    output.measure(f"scenes/{kind}/cost_ignoring", distribution(found.ignoring))
    for method, cost in (("kd-tree", found.kd_tree), ("neighbourhood", found.neighbourhood)):
        share = int(np.isfinite(cost[exists]).sum()) / max(int(exists.sum()), 1)
        output.measure(f"clear_found_fraction/{kind}/{method}", share)
        name = f"{CLEAR_STAGES} stages, {kind}: {method} finds a clear word where there is one"
        output.check(name, share, "== 1", share == 1.0)


def _figure(results: Mapping[tuple[str, int], Results]) -> Figure:
    """Draw the distribution of costs, a row for each kind of target."""
    figure = Figure(figsize=(14, 11))
    panels = figure.subplots(2, 3).flat
    for axes, (kind, stages) in zip(panels, itertools.product(("reachable", "random"), STAGES)):
        methods = methods_for(stages)
        for index, method in enumerate(methods):
            result = results[kind, stages][method]
            time = float(np.median(result.ms))
            digits = max(1 - int(np.floor(np.log10(max(time, 1e-3)))), 0)
            axes.plot(
                np.sort(result.cost),
                np.arange(1, len(result.cost) + 1) / len(result.cost),
                "--" if method == EQUAL_TIME else "-",
                color=COLOURS[method],
                linewidth=1.0 + 0.5 * (len(methods) - index),  # what is beneath shows
                label=f"{LABELS.get(method, method)}, {time:.{digits}f} ms",
            )
        axes.set(title=f"{stages} stages, {kind}", xlabel="cost [r]", ylabel="targets")
        axes.grid(alpha=0.3)
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.17), "frameon": False}
        axes.legend(ncols=2, **below)
    figure.subplots_adjust(left=0.05, right=0.98, wspace=0.2, hspace=0.5, bottom=0.15, top=0.96)
    return figure
