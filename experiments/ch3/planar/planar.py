"""``ch3-planar``: planar worlds mapped by one and two vision systems (figures 3-12 to 3-21).

Each seed draws an unstructured and an indoor world of 100 x 100 m and a start; every method maps
the same ones. Ranges are free of noise as in the thesis' simulation (``--noise`` adds some), the
map is shared at once, robots are points. The fraction mapped counts the cells that can be seen from
somewhere that can be reached.
"""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from controllers.mapping import Method
from experiments.ch3.planar.explain import evaluation_figure, merging_figure
from experiments.ch3.planar.figures import MethodRuns, draw_group
from experiments.ch3.planar.planar_options import NARROW, WIDE, Options
from experiments.ch3.planar.record import record_trial
from experiments.ch3.planar.trial import (
    TARGET,
    PlanarRun,
    PlanarTrial,
    build_world,
    first_at,
    map_world,
    measure_arrival,
)
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray

THESIS_METHODS: tuple[Method, ...] = ("random", "raster", "max_new", "min_old", "information")
LIMITS = {"unstructured": 200, "narrow": 320, "indoor": 400}
END = 0.95
"""Fraction mapped at which a run ends (with --quick, as soon as it is scored)."""


def run(options: Options, output: Output) -> None:
    """Map all worlds by all methods, score and draw.

    Args:
        options: ``quick`` takes 2 seeds and 2 methods instead of 12 and 7.
        output: Receives the metrics of DESIGN.md, figures, tables, and the recording.
    """
    seeds = options.job_seeds(12, 2)
    if options.world is not None:
        _examine_plan(options, seeds[0])
    groups = make_groups(options, seeds)
    trials = [trial for group in groups.values() for each in group.values() for trial in each]
    found = sweep(map_world, trials, options, output, label="runs")
    results = dict(zip(trials, found, strict=True))
    runs = {
        name: {method: [results[trial] for trial in each] for method, each in group.items()}
        for name, group in groups.items()
    }
    for name, group in groups.items():
        _measure_group(name, seeds, runs[name], output)
        draw_group(name, runs[name], build_world(next(iter(group.values()))[0]), output)
    _measure_ratios(runs, output)
    _judge(output)
    output.measure("plan_ms", distribution(np.concatenate([result.plan_ms for result in found])))
    output.measure("called_wrong_fraction", distribution([r.called_wrong for r in found]))
    if options.explain:
        output.figure("figure_3-6", merging_figure())
        output.figure("figure_3-8", evaluation_figure())
    if options.record:
        shown = next((t for t in trials if t.method == "information"), trials[0])
        record_trial(shown, output.file("run.rrd"))


def _examine_plan(options: Options, seed: int) -> None:
    """Let a bad picture end the run before it begins, and say how large a world it is."""
    trial = PlanarTrial(str(options.world), seed, "information", pixel=options.picture_pixel)
    grid = build_world(trial).grid
    shrunk = " (shrunk: it has more pixels)" if grid.cell > options.picture_pixel else ""
    size = f"{grid.columns} x {grid.rows} cells of {grid.cell:.3g} m{shrunk}"
    print(f"{options.world}: {size}", file=sys.stderr)


def make_groups(
    options: Options, seeds: Sequence[int]
) -> dict[str, dict[Method, list[PlanarTrial]]]:
    """Return the trials of every figure and ratio, by world and team, then by method."""
    shared = PlanarTrial(
        "indoor",
        0,
        "information",
        reading=options.reading,
        utility=options.utility,
        noise=options.noise,
        target=TARGET if options.quick else END,
        pixel=options.picture_pixel,
    )

    def trials(
        world: str, methods: Sequence[Method], sensor: tuple[float, float], limit: int,
        robots: int = 1, cooperative: bool = True,
    ) -> dict[Method, list[PlanarTrial]]:  # fmt: skip
        group = dataclasses.replace(
            shared, world=world, fov_deg=sensor[0], depth=sensor[1], limit=limit, robots=robots,
            cooperative=cooperative,
        )  # fmt: skip
        return {m: [dataclasses.replace(group, method=m, seed=s) for s in seeds] for m in methods}

    methods = options.chosen_methods()
    if options.world is not None:
        sensor, limit = options.picture_sensor, LIMITS["indoor"]
        return {"picture": trials(str(options.world), methods, sensor, limit)}
    groups = {
        "unstructured": trials("unstructured", methods, WIDE, LIMITS["unstructured"]),
        "indoor": trials("indoor", methods, NARROW, LIMITS["indoor"]),
    }
    if "information" in methods:
        only: tuple[Method, ...] = ("information",)
        both: list[Method] = [m for m in THESIS_METHODS if m in methods]
        two = only if options.quick else both
        field, narrow, floor = "unstructured", LIMITS["narrow"], LIMITS["indoor"]
        groups |= {
            "unstructured_one_narrow": trials(field, only, NARROW, narrow),
            "unstructured_two": trials(field, two, NARROW, narrow, 2),
            "indoor_two": trials("indoor", only, NARROW, floor, 2),
        }
        if not options.quick:
            groups |= {
                "unstructured_two_independent": trials(field, only, NARROW, narrow, 2, False),
                "indoor_two_independent": trials("indoor", only, NARROW, floor, 2, False),
            }
    return groups


def _measure_group(name: str, seeds: Sequence[int], runs: MethodRuns, output: Output) -> None:
    """Store when each method had mapped 90 %, and the end of its runs."""
    ending = "" if name == "unstructured" else f"_{name}"
    rows: list[list[Any]] = []
    for method, chosen in runs.items():
        when = measure_arrival(chosen, "scans", f"{ending}/{method}", output)
        last = [float(run.fraction[-1]) for run in chosen]
        output.measure(f"fraction_at_end{ending}/{method}", distribution(last))
        rows += [[method, s, *w, f] for s, w, f in zip(seeds, when.tolist(), last)]
    columns = ("method", "seed", "rounds to 90 %", "metres to 90 %", "fraction at the end")
    output.table(f"runs_{name}", columns, rows)
    if runs.keys() >= {"information", "max_new"}:
        key = f"fraction_difference{ending}/information_minus_max_new"
        output.measure(key, distribution(paired_difference(runs["information"], runs["max_new"])))


def paired_difference(first: Sequence[PlanarRun], second: Sequence[PlanarRun]) -> list[float]:
    """Return the mean lead of the first method scan for scan, until one of both is at 90 %.

    Args:
        first: Runs of the first method, in the order of the seeds.
        second: Runs of the second method, in the order of the seeds.

    Returns:
        Mean difference of the fractions mapped, for each seed.
    """
    means: list[float] = []
    for ours, theirs in zip(first, second, strict=True):
        curves = ours.fraction, theirs.fraction
        last = int(min(first_at(ours)[0], first_at(theirs)[0], *map(len, curves)))
        means.append(float(np.mean(curves[0][:last] - curves[1][:last])))
    return means


def _measure_ratios(runs: Mapping[str, MethodRuns], output: Output) -> None:
    """Store paired ratios; a pair counts where both runs got there."""

    def when(group: str, method: str = "information") -> FloatArray:
        found = [first_at(run) for run in runs.get(group, {}).get(method, ())]
        return np.array(found).reshape(-1, 2)

    def ratio(key: str, above: FloatArray, below: FloatArray, column: int) -> None:
        if len(above) == len(below):
            both = np.isfinite(above[:, 0]) & np.isfinite(below[:, 0])
            if both.any():
                output.measure(key, distribution(above[both, column] / below[both, column]))

    for name, ending, alone in (
        ("unstructured", "", "unstructured_one_narrow"),
        ("indoor", "_indoor", "indoor"),
    ):
        one, largest = when(name), when(name, "max_new")
        ratio(f"distance_ratio{ending}/max_new_over_information", largest, one, 1)
        ratio(f"scans_ratio{ending}/information_over_max_new", one, largest, 0)
        for team in ("two", "two_independent"):
            ratio(f"rounds_ratio_{team}/{name}", when(f"{name}_{team}"), when(alone), 0)


BARS = (
    ("scans_to_90/information", "<=", 80.0),
    ("metres_to_90/information", "<=", 700.0),
    ("distance_ratio/max_new_over_information", ">=", 5.0),
    ("metres_to_90_indoor/information", "<=", 2000.0),
    ("scans_ratio_indoor/information_over_max_new", "<=", 1.25),
    ("rounds_ratio_two/unstructured", "<=", 0.55),
    ("rounds_ratio_two/indoor", "<=", 0.60),
)


def _judge(output: Output) -> None:
    """Hold the medians against the bars."""
    measured = output.metrics()["measured"]
    for key, sign, bound in BARS:
        if key in measured:
            median = measured[key]["median"]
            value = float("inf") if median is None else float(median)
            ok = value <= bound if sign == "<=" else value >= bound
            name = key.replace("_to_90", f" to {TARGET:.0%}").replace("_", " ") + ", median"
            output.check(name, value, f"{sign} {bound:g}", ok)
