"""``ch4-stereo``: camera placement among blocks, in space (figures 4-12, 4-13).

A work-piece with round holes lies among simple blocks. A CAD model of it with a stated uncertainty
is given, the rating is optimised in space, and the camera's view from there is rendered.

1. The check with a closed form: a long wall whose edge, expanded by the hole, is at 60 deg of
   elevation behind the hole. The thesis' answer (5 in, 0, pi/3) is its exact optimum.
2. Arrangements of blocks drawn at random: the visible share of the hole, by rendering, from the
   planned pose and from random free poses in focus.
3. Random scenes: fast and exhaustive search, expanded hulls and exact sight compared.
4. Two cameras placed at once.
"""

from typing import Any

import numpy as np

from controllers.placement.pairs import SEPARATION, VisionSystem, best_pair, go_together
from controllers.placement.spatial.occluders import TargetField, expand
from controllers.placement.spatial.search import SpatialTask, best_view, rate_positions, spherical
from controllers.placement.task import View
from experiments.ch4.spatial import figures
from experiments.ch4.spatial.blocks import (
    BlocksTrial,
    RenderedBlocks,
    hole_of,
    occluders_of,
    plan_view,
    random_places,
    rating_cloud,
    run_blocks,
)
from experiments.ch4.spatial.record import record_placement
from experiments.ch4.spatial.search import LENS, SpatialSearchTrial, run_search
from experiments.ch4.spatial.stereo_options import Options
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.blocks import FIGURE_4_12
from models.datasheets import INCH

SCENES, QUICK_SCENES = 200, 24
ARRANGEMENTS, QUICK_ARRANGEMENTS = 60, 8
SYSTEMS = (VisionSystem("first", LENS), VisionSystem("second", LENS))
COUNTS = range(3, 21)
"""Numbers of solids of random scenes."""


def run(options: Options, output: Output) -> None:
    """Run all four parts.

    Args:
        options: ``quick`` takes fewer scenes and arrangements.
        output: Receives ``optimum_...``, ``search_match_fraction``, ``search_speedup/spatial``,
            ``hull_false_visible``, ``hull_given_up_fraction``, ``visible_fraction/...`` and more.
    """
    run_search(SpatialSearchTrial(0, 3, True))  # Compiles, so that no trial's time counts it.
    _wall(output)
    _figure_scene(options, output)
    _searches(options, output)
    _rendered(options, output)


def _wall(output: Output) -> None:
    """Find the optimum of the scene that has a closed form."""
    field = expand(hole_of(FIGURE_4_12), occluders_of(FIGURE_4_12.blocks))
    view = best_view(SpatialTask([field], LENS))
    goals = ((5.0, 0.05), (0.0, 0.5), (60.0, 0.5))
    for (name, value), (thesis, bound) in zip(_spherical_units(field, view).items(), goals):
        output.measure(f"optimum_{name}", value, thesis=thesis)
        off = abs(value - thesis)
        output.check(f"optimum {name} off the thesis'", off, f"<= {bound:g}", off <= bound)
    output.figure("figure_4-12_wall", figures.wall_curve(field, LENS, view))


def _spherical_units(field: TargetField, view: View) -> dict[str, float]:
    """Return a view's distance [inch], azimuth and elevation [deg], by their metrics' names."""
    distance, azimuth, elevation = spherical(field, view.position)
    angles = {"theta_deg": azimuth, "phi_deg": elevation}
    return {"r_inch": distance / INCH} | {k: float(np.rad2deg(a)) for k, a in angles.items()}


def _figure_scene(options: Options, output: Output) -> None:
    """Plan in the scene of figure 4-12 from an uncertain model, and render the planned view."""
    rng = np.random.default_rng(options.seed)
    hole = int(options.target.removeprefix("hole"))
    believed, field, occupancy, view = plan_view(FIGURE_4_12, rng, hole)
    for name, value in _spherical_units(field, view).items():
        output.measure(f"uncertain_{name}", value)
    output.measure("uncertain_free_cap_deg", np.rad2deg(view.free_cap))
    rendered = RenderedBlocks(FIGURE_4_12)
    cloud = rating_cloud(field, occupancy)
    output.figure("figure_4-12", figures.scene(field, view, cloud, FIGURE_4_12))
    output.figure("figure_4-4_sphere", figures.sphere(field, view, LENS))
    others = random_places(field, occupancy, rng, 3)
    views = [view, *rate_positions(field, LENS, others, occupancy)]
    aim = field.target.position
    images = [rendered.picture(v.position, aim) for v in views]
    names = ("optimal pose", "random pose 1", "random pose 2", "random pose 3")
    output.figure("figure_4-13", figures.pictures(views, images, names))
    pair = _pair(field, occupancy, output)
    shots = [rendered.picture(v.position, aim) for v in pair]
    output.figure("two_cameras", figures.pictures(pair, shots, ("first camera", "second camera")))
    if options.record:
        record_placement(output.file("run.rrd"), field, believed, cloud, views, images, aim)


def _pair(field: TargetField, occupancy: Any, output: Output) -> tuple[View, View]:
    """Place two cameras at once."""
    pair = best_pair([field], SYSTEMS, occupancy)
    alone = best_view(SpatialTask([field], LENS, occupancy))
    rays = [(v.position - field.target.position) / v.distance for v in pair]
    apart = float(np.rad2deg(np.arccos(np.clip(rays[0] @ rays[1], -1.0, 1.0))))
    output.measure("pair_separation_deg", apart)
    product = pair[0].rating * pair[1].rating
    output.measure("pair_product_over_best_squared", product / alone.rating**2)
    fits = go_together([field], SYSTEMS, pair) and apart >= np.rad2deg(SEPARATION) - 1e-9
    output.check("two cameras keep clear of each other, deg apart", apart, ">= 30", fits)
    return pair


def _searches(options: Options, output: Output) -> None:
    """Compare searches, and hulls with exact sight, on random scenes."""
    count = options.scenes or (QUICK_SCENES if options.quick else SCENES)
    words = np.random.SeedSequence((options.seed, 1)).generate_state(count)
    trials = [
        SpatialSearchTrial(int(word), COUNTS[i % len(COUNTS)], i % 2 == 1)
        for i, word in enumerate(words)
    ]
    # What is timed runs alone, one scene after the other.
    results = [run_search(trial) for trial in trials]
    matches = sum(result.match for result in results)
    output.measure("search_match_fraction", matches / count)
    output.measure("search_scenes", count)
    output.check("fast search as good as all candidates", matches / count, "= 1", matches == count)
    slow, fast = np.array([(r.slow_s, r.fast_s) for r in results]).T
    ratio = float(slow.sum() / fast.sum())
    output.measure("search_speedup/spatial", ratio)
    output.check("exhaustive over fast search, processor time", ratio, ">= 3", ratio >= 3.0)  # noqa: PLR2004
    output.measure("search_ms/fast", distribution(1e3 * fast))
    output.measure("search_ms/exhaustive", distribution(1e3 * slow))
    output.measure("refined_over_exhaustive", distribution([r.gain for r in results]))
    sights = [(r.hull, r.exact, r.distance) for r in results]
    hull, exact, far = np.concatenate(sights, axis=1)
    wrong = int(np.count_nonzero((hull == 1) & (exact == 0)))
    output.measure("hull_false_visible", wrong)
    output.measure("hull_cases", len(hull))
    output.check(f"false visibles in {len(hull)} views", wrong, "= 0", wrong == 0)
    lost = int(np.count_nonzero((hull == 0) & (exact == 1)))
    output.measure("hull_given_up_fraction", fraction(lost, int(exact.sum())))
    rows = [
        [t.seed, t.occluders, int(t.patchy), int(r.seen), int(r.match), r.gain,
         1e3 * r.slow_s, 1e3 * r.fast_s, float(r.exact.mean()), float(r.hull.mean())]
        for t, r in zip(trials, results)
    ]  # fmt: skip
    columns = ("seed", "occluders", "partly unknown", "seen", "match", "refined / exhaustive",
               "exhaustive [ms]", "fast [ms]", "visible", "visible by hulls")  # fmt: skip
    output.table("searches", columns, rows)
    output.figure("searches", figures.searches(trials, results, hull, exact, far))


def _rendered(options: Options, output: Output) -> None:
    """Score planned and random views by rendering."""
    seeds = options.job_seeds(ARRANGEMENTS, QUICK_ARRANGEMENTS)
    trials = [BlocksTrial(seed, options.blocks) for seed in seeds]
    results = sweep(run_blocks, trials, options, output, label="arrangements")
    placed = [result for result in results if result is not None]
    output.measure("placed_fraction", fraction(len(placed), len(results)))
    if not placed:
        return
    optimal = np.array([result.optimal for result in placed])
    others = np.concatenate([result.random for result in placed])
    output.measure("visible_fraction/optimal", distribution(optimal))
    output.measure("visible_fraction/random", distribution(others))
    pixels = np.array([result.pixels for result in placed])
    drawn = np.concatenate([result.random_pixels for result in placed])
    output.measure("target_pixels/optimal", distribution(pixels))
    output.measure("target_pixels/random", distribution(drawn))
    least = float(optimal.min())
    output.check("least part of the hole seen from a planned pose", least, ">= 0.98", least >= 0.98)  # noqa: PLR2004
    columns = ("seed", "placed", "seen from the plan", "mean seen at random", "free cap [deg]",
               "elevation [deg]")  # fmt: skip
    rows: list[list[Any]] = []
    for seed, result in zip(seeds, results):
        rows.append([seed, 0, "", "", "", ""])
        if result is not None:
            angles = np.rad2deg([result.cap, result.elevation]).tolist()
            rows[-1][1:] = [1, result.optimal, float(np.mean(result.random)), *angles]
    output.table("arrangements", columns, rows)
    output.figure("seen", figures.seen(optimal, others, pixels, drawn))
