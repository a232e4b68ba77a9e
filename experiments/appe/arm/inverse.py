"""``appe-inverse``: words for targets by seven searches, and words that keep clear of obstacles.

As in E.3.2: targets at random, time, displacement and angle of each method, for 5, 10 and 20
stages. Targets are poses of stages whose legs have any length between short and long. Orientations
drawn uniformly, as the thesis seems to have them, are shown beside: hardly any is within reach, so
they measure the draw rather than the search. All lengths are in radii of the discs.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from controllers.braid.arm.inverse import METHODS
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
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import concatenated, sweep

Results = dict[str, Solved]

STAGES = (5, 10, 20)
TARGETS, QUICK_TARGETS = 1000, 20
PLANTED, QUICK_PLANTED = 100, 20
SCENES, QUICK_SCENES = 200, 20
CHUNK = 50
"""Targets of a job."""
EXACT, PLANTED_COST = 1e-9, 1e-9
MEET_MS, RATIO = 30.0, 0.65
OBSTACLES = ("balls", "voxels")
"""How the obstacles of a scene are told: as places, or as the occupied voxels of a map."""
CHOSEN = {5: "kd-tree", 10: "meet", 20: "walk"}
"""The method to use with so many stages."""
COLOURS = {name: f"C{index}" for index, name in enumerate(METHODS)}
COLOURS[EQUAL_TIME] = COLOURS["exchange"]  # dashed
WHAT = {"cost": 1.0, "displacement": 1.0, "angle": 180.0 / np.pi, "ms": 1.0}
NAMES = {"cost": "cost", "displacement": "displacement", "angle": "angle_deg", "ms": "ms"}


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of appe-inverse.

    Attributes:
        targets: Number for each kind and number of stages (default 1000; with --quick, 20).
    """

    targets: int | None = None

    def __post_init__(self) -> None:
        """Refuse no targets.

        Raises:
            OptionError: If there are none.
        """
        super().__post_init__()
        if self.targets is not None and self.targets < 1:
            raise OptionError(f"--targets {self.targets}: expected at least 1")

    def count(self) -> int:
        """Return the number of targets of each kind."""
        return self.targets or (QUICK_TARGETS if self.quick else TARGETS)


def run(options: Options, output: Output) -> None:
    """Solve all targets, then the scenes.

    Args:
        options: ``quick`` takes 20 targets of each kind and 20 scenes.
        output: Receives ``<cost, displacement, angle_deg or ms>/<kind>/<stages>/<method>``,
            ``exact_match_fraction/5``, ``planted_recovered_fraction/10``,
            ``ms_per_target/<stages>``, ``cost_ratio_over_exchange/20`` and
            ``clear_found_fraction/<balls or voxels>/<method>``.
    """
    cases = [(kind, stages) for kind in ("reachable", "random") for stages in STAGES]
    cases.append(("planted", 10))
    planted = QUICK_PLANTED if options.quick else PLANTED
    trials = [
        TargetTrial(stages, kind, seed, size)
        for kind, stages in cases
        for seed, size in _chunks(planted if kind == "planted" else options.count(), options)
    ]
    solved = sweep(solve_targets, trials, options, output, label="targets")
    results = {case: _joined(case, trials, solved) for case in cases}
    for (kind, stages), result in results.items():
        _measure(kind, stages, result, output)
    _check_exact(results, output)
    _check_heuristics(results, output)
    chunks = _chunks(QUICK_SCENES if options.quick else SCENES, options)
    for kind in OBSTACLES:
        scenes = [ClearTrial(seed, size, kind == "voxels") for seed, size in chunks]
        _measure_scenes(kind, sweep(solve_scenes, scenes, options, output, label=kind), output)
    output.figure("inverse", _figure(results))


def _chunks(count: int, options: Options) -> list[tuple[int, int]]:
    """Return seed and size of each job."""
    sizes = [min(CHUNK, count - first) for first in range(0, count, CHUNK)]
    words = np.random.SeedSequence(options.seed).generate_state(len(sizes))
    return [(int(word), size) for word, size in zip(words, sizes)]


def _joined(
    case: tuple[str, int], trials: Sequence[TargetTrial], solved: Sequence[Results]
) -> Results:
    parts = [result for trial, result in zip(trials, solved) if (trial.kind, trial.stages) == case]
    return {name: concatenated([part[name] for part in parts]) for name in parts[0]}


def _measure(kind: str, stages: int, result: Results, output: Output) -> None:
    rows = []
    for method in methods_for(stages):
        row: list[Any] = [method]
        for what, factor in WHAT.items():
            summary = distribution(factor * getattr(result[method], what))
            output.measure(f"{NAMES[what]}/{kind}/{stages}/{method}", summary)
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
    better = 0
    for (_, stages), result in results.items():
        if "meet" in methods_for(stages):
            better += int(np.sum(result["genetic"].cost < result["meet"].cost - EXACT))
    output.measure("genetic_better_than_exact", better)
    output.check("targets where genetic search beats the exact one", better, "== 0", better == 0)


def _measure_scenes(kind: str, solved: Sequence[ClearWords], output: Output) -> None:
    """Compare the searches among clear words with the exhaustive one."""
    exists = np.concatenate([np.isfinite(result.costs["exhaustive"]) for result in solved])
    touches = np.concatenate([result.touches for result in solved])
    output.measure(f"scenes/{kind}/with_clear_word", fraction(int(exists.sum()), len(exists)))
    output.measure(
        f"scenes/{kind}/nearest_word_touches", fraction(int(touches.sum()), len(touches))
    )
    collisions = int(sum(result.collisions for result in solved))
    output.check(f"{kind}: words found clear that touch", collisions, "== 0", collisions == 0)
    best = np.concatenate([result.costs["exhaustive"] for result in solved])
    plain = np.concatenate([result.costs["ignoring"] for result in solved])
    if exists.any():
        output.measure(f"scenes/{kind}/cost_clear", distribution(best[exists]))
    output.measure(f"scenes/{kind}/cost_ignoring", distribution(plain))
    for method in ("kd-tree", "neighbourhood"):
        cost = np.concatenate([result.costs[method] for result in solved])
        found = int(np.sum(np.isfinite(cost) & exists))
        share = found / max(int(exists.sum()), 1)
        output.measure(f"clear_found_fraction/{kind}/{method}", share)
        name = f"{CLEAR_STAGES} stages, {kind}: {method} finds a clear word where there is one"
        output.check(name, share, "== 1", share == 1.0)


def _figure(results: Mapping[tuple[str, int], Results]) -> Figure:
    """Draw how costs are spread, a row for each kind of target."""
    figure = Figure(figsize=(14, 11))
    for row, kind in enumerate(("reachable", "random")):
        for column, stages in enumerate(STAGES):
            axes = figure.add_subplot(2, 3, 3 * row + column + 1)
            result, methods = results[kind, stages], methods_for(stages)
            for index, method in enumerate(methods):
                costs = np.sort(result[method].cost)
                time = float(np.median(result[method].ms))
                share = np.arange(1, len(costs) + 1) / len(costs)
                digits = max(1 - int(np.floor(np.log10(max(time, 1e-3)))), 0)
                name = "exchange, equal time" if method == EQUAL_TIME else method
                label = f"{name}, {time:.{digits}f} ms"
                axes.plot(
                    costs,
                    share,
                    "--" if method == EQUAL_TIME else "-",
                    color=COLOURS[method],
                    linewidth=1.0 + 0.5 * (len(methods) - index),  # what is beneath shows
                    label=label,
                )
            axes.set(title=f"{stages} stages, {kind}", xlabel="cost [r]", ylabel="targets")
            axes.grid(alpha=0.3)
            below = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.17), "frameon": False}
            axes.legend(fontsize=7.5, ncols=2, **below)
    figure.subplots_adjust(left=0.05, right=0.98, wspace=0.2, hspace=0.5, bottom=0.15, top=0.96)
    return figure
