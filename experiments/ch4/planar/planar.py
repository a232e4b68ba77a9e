"""``ch4-planar``: cameras are placed on the plane (figures 4-6, 4-8, 4-10 and 4-11).

The exact search is compared with rating every candidate, hulls with exact sight, and a camera
watches a panel of known shape on its way to the target, with hysteresis and without.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.placement.planar.search import best_view
from experiments.ch4.planar.figures import (
    draw_hull_cost,
    draw_instances,
    draw_searches,
    draw_site,
    draw_steps,
    write_film,
)
from experiments.ch4.planar.motion import Moment, MotionTrial, approach, map_site, watch_approach
from experiments.ch4.planar.planar_options import Options
from experiments.ch4.planar.record import record_approach
from experiments.ch4.planar.scenes import two_instances
from experiments.ch4.planar.trials import (
    HullTrial,
    PlanarSearches,
    PlanarSearchTrial,
    compare_searches,
    compare_sights,
    occluded_angles,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import concatenated, sweep

SPEEDUPS = {5: 20.0, 20: 3.0, 35: 3.0}
"""Density [%] and least speed of the fast search over that of the exhaustive one."""
SCENES = 10
"""Number of scenes of a job."""
CASES, QUICK_CASES = 1000, 500
"""Number of cases of a job that compares hulls with exact sight."""
VISION_PERIOD = 250.0
"""Time within which a plan must be ready [ms]."""
WATCHED = ("primary", "secondary")
RADIUS = 40.0
"""Distance of the cameras from the target in figure 4-6 [m]."""


def run(options: Options, output: Output) -> None:
    """Compare searches, hulls and hysteresis, and draw the chapter's planar figures.

    Args:
        options: ``quick`` takes 2 seeds instead of 17; each is 10 scenes a density, up to 10 of
            them 1000 cases of hulls (500), and up to 10 of them an approach of the panel (1).
        output: Receives ``search_match_fraction``, ``search_speedup/<density>``,
            ``hull_false_visible``, ``replacements`` and more.
    """
    seeds = options.job_seeds(17, 2)
    _searches(options, output, seeds)
    _hulls(options, output, seeds[:10])
    tasks = two_instances()
    for name, task, expected in zip(("first", "second"), tasks, WATCHED):
        view = best_view(task)
        output.measure(f"watched/{name}_instance", view.target, thesis=expected)
        agrees = view.target == expected
        output.check(f"{name} instance: watches the {expected} target", agrees, 1, agrees)
    output.figure("figure_4-8", draw_instances(tasks))
    _motion(options, output, seeds[: 1 if options.quick else 10])


def _searches(options: Options, output: Output, seeds: Sequence[int]) -> None:
    """Measure the searches on random scenes of all densities."""
    trials = [
        PlanarSearchTrial(density / 100.0, seed, SCENES, options.rings, options.directions)
        for density in SPEEDUPS
        for seed in seeds
    ]
    results = sweep(compare_searches, trials, options, output, label="searches")
    rows: list[list[Any]] = []
    for index, (density, bound) in enumerate(SPEEDUPS.items()):
        joined = concatenated(results[index * len(seeds) : (index + 1) * len(seeds)])
        speedup = float(joined.exhaustive_s.sum() / joined.fast_s.sum())
        output.measure(f"search_speedup/{density}", speedup)
        output.check(f"search speedup at {density} %", speedup, f">= {bound:g}", speedup >= bound)
        output.measure(f"search_us/{density}", distribution(1e6 * joined.fast_s))
        output.measure(f"placement_ms/{density}", distribution(1e3 * joined.placement_s))
        seen = np.isfinite(joined.gain)
        output.measure(f"scenes_with_a_view/{density}", fraction(int(seen.sum()), seen.size))
        beyond = int(np.sum(joined.distance[seen] > 5.0 + 1e-6))  # noqa: PLR2004
        output.measure(f"optimum_beyond_nearest/{density}", fraction(beyond, max(seen.sum(), 1)))
        if seen.any():
            output.measure(f"climb_gain/{density}", distribution(joined.gain[seen]))
            output.measure(f"cells_rating_fraction/{density}", distribution(joined.cells[seen]))
        rows += [[density, *values] for values in zip(*vars(joined).values())]
    share = float(concatenated(results).matches.mean())
    output.measure("search_match_fraction", share)
    output.check("fast search matches the exhaustive one", share, "== 1", share == 1.0)
    names = [field.name for field in dataclasses.fields(PlanarSearches)]
    output.table("searches", ("density [%]", *names), rows)
    output.figure("searches", draw_searches(rows, names))


def _hulls(options: Options, output: Output, seeds: Sequence[int]) -> None:
    """Measure whether hulls are safe, and the share of views that they lose."""
    cases = QUICK_CASES if options.quick else CASES
    trials = [HullTrial(seed, cases) for seed in seeds]
    results = sweep(compare_sights, trials, options, output, label="hulls")
    false_visible, visible, given_up = np.sum([dataclasses.astuple(r) for r in results], axis=0)
    wrong = int(false_visible.sum())
    output.measure("hull_false_visible", wrong)
    output.measure("hull_cases", cases * len(seeds))
    output.check("hulls see what is hidden", wrong, "== 0", wrong == 0)
    for index, kind in enumerate(("convex", "map")):
        if visible[index] > 0:
            share = fraction(int(given_up[index]), int(visible[index]))
            output.measure(f"hull_given_up_fraction/{kind}", share)
    distances = np.geomspace(1.0, 30.0, 40)
    angles = occluded_angles(distances, RADIUS)
    rows = np.column_stack([distances, np.degrees(angles)])
    output.table("figure_4-6", ("distance [m]", "occluded [deg]", "by the hull [deg]"), rows)
    for place, row in (("near", rows[0]), ("far", rows[-1])):
        output.measure(f"hull_extra_deg/{place}", float(row[2] - row[1]))
    output.figure("figure_4-6", draw_hull_cost(distances, angles))


def _motion(options: Options, output: Output, seeds: Sequence[int]) -> None:
    """Watch the panel approach, and draw and film the first seed's."""
    trials = [MotionTrial(seed, options.factor) for seed in seeds]
    results = sweep(watch_approach, trials, options, output, label="approaches")
    steady, plains = zip(*results)
    for ending, runs in (("", steady), ("/without_hysteresis", plains)):
        output.measure(f"replacements{ending}", distribution([run.moves for run in runs]))
        output.measure(f"camera_metres{ending}", distribution([run.metres for run in runs]))
        placed = sum(run.placed for run in runs)
        output.measure(
            f"placed_fraction{ending}", fraction(placed, sum(len(r.target) for r in runs))
        )
        watched = sum(run.watched for run in runs)
        output.measure(f"watched_fraction{ending}", fraction(watched, max(placed, 1)))
    fewer, more = (sum(run.moves for run in runs) for runs in (steady, plains))
    output.check("moves with hysteresis against without", fewer, f"<= {more}", fewer <= more)
    orders = [_order(r.target) for r in steady]
    turned = sum(order == "primary, secondary" for order in orders)
    output.measure("primary_then_secondary", fraction(turned, len(orders)))
    replan = distribution(np.concatenate([r.replan_ms for r in steady]))
    output.measure("replan_ms", replan)
    p95 = float(replan["p95"])
    output.check("processor time of a replan in ms, 95th percentile", p95, f"<= {VISION_PERIOD:g}",
                 p95 <= VISION_PERIOD)  # fmt: skip
    rows = [
        [seed, run.moves, plain.moves, run.placed, run.watched, len(run.target), order]
        for seed, run, plain, order in zip(seeds, steady, plains, orders)
    ]
    columns = ("seed", "moves", "without hysteresis", "placed", "watched", "steps", "targets")
    output.table("approaches", columns, rows)
    _pictures(trials[0], options, output)


def _order(targets: NDArray[np.int64]) -> str:
    """Return the targets in the order that they were watched in, each change once."""
    changes = targets[np.r_[True, np.diff(targets) != 0]]
    return ", ".join("none" if index < 0 else WATCHED[index] for index in changes)


def _pictures(trial: MotionTrial, options: Options, output: Output) -> None:
    """Draw, film and record one approach."""
    site = map_site(trial.seed)
    moments: list[Moment] = []
    approach(trial, site, moments.append)
    output.figure("figure_4-10", draw_site(site, moments[0]))
    output.figure("figure_4-11", draw_steps(site, moments))
    write_film(site, moments, output.file("approach.gif"))
    if options.record:
        record_approach(site, moments, output.file("run.rrd"))
