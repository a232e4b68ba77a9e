"""``ch5-insertion``: two rovers insert the card, the master's camera placed optimally or at random.

Rough ground, springs, radio, stereo images, wrench: the controllers get what the robots measure and
nothing else. Trials are paired by their seeds: both placements get the same ground, starts, errors
of the map and noise. Each width of the slot has seeds of its own. Five parts: Table 5-1, what must
fail, ten times the camera noise, faults, and card guides with a connector (``docs/mission.md``).
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from experiments.ch5.contact.trial import IMPOSSIBLE
from experiments.ch5.insertion_faults import ENDS_IN, Fault
from experiments.ch5.insertion_figures import (
    draw_course,
    draw_pairs,
    draw_steps,
    draw_table,
)
from experiments.ch5.insertion_film import film_trial
from experiments.ch5.insertion_options import PARTS, Options
from experiments.ch5.insertion_scene import TOUCH
from experiments.ch5.insertion_setting import NOISE_DB, InsertionTrial
from experiments.ch5.insertion_trial import InsertionOutcome, run_trial
from experiments.harness.intervals import Distribution, distribution, mcnemar, success_fraction
from experiments.harness.output import Output
from experiments.harness.recording import RunFiles
from experiments.harness.sweep import sweep
from models.card_and_slot.guides import width_of
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE, INCH

PLACEMENTS = ("optimal", "random")
THESIS = {
    "optimal": (1.0, 1.0, 0.9),
    "random": (0.7, 0.4, 0.2),
}
"""Table 5-1, by slot width, of ten trials each."""
NOISY_DB = NOISE_DB - 20.0
"""Ten times the noise [dB]."""
MOST_FORCE = 10.0
SEATED, TOUCHED, SEATING_FORCE = 0.9, 0.8, 20.0
"""Bars of the insertion into guides: success at the medium clearance, share that touches them, and
95th percentile of the largest contact forces [N]."""
Results = list[InsertionOutcome]
Cells = dict[tuple[str, float], Results]
Shares = dict[tuple[str, float], Distribution]


def run(options: Options, output: Output) -> None:
    """Run the chosen parts.

    Args:
        options: ``quick`` takes one pair of trials at the narrowest slot and one at a slot that is
            too narrow, instead of 30 pairs at each width, 10 impossible and noisy ones, 3 of
            each fault and 30 into guides of each clearance.
        output: Receives ``success/<optimal or random>/<width>``, ``mcnemar_p/<width>``,
            ``success/impossible`` and more, and the figures 5-11 to 5-14; of guides
            ``success/guides/<clearance in mm>``, ``contact_fraction``, ``contact_force_n`` and
            ``snap_force_n``.
    """
    runs = {
        "table": _table,
        "impossible": _impossible,
        "noise": _noise,
        "faults": _faults,
        "guides": _guides,
    }
    quick = ("table", "impossible")
    base = InsertionTrial(
        CARD_AND_SLOT.slot_widths[-1],
        True,
        0,
        detector=options.detector,
        realism=options.realism,
    )
    for part in options.parts or (quick if options.quick else PARTS):
        runs[part](options, base, output)


def _table(options: Options, base: InsertionTrial, output: Output) -> None:
    """Measure Table 5-1 and draw a success and a failure."""
    widths = CARD_AND_SLOT.slot_widths[-1:] if options.quick else CARD_AND_SLOT.slot_widths
    jobs = [
        dataclasses.replace(base, width=width, optimal=placement == "optimal", seed=seed)
        for width in widths
        for placement in PLACEMENTS
        for seed in width_seeds(options, width)
    ]
    results = sweep(run_trial, jobs, options, output, label="insertions")
    cells: Cells = {}
    for job, result in zip(jobs, results):
        cells.setdefault((_placement(job), job.width), []).append(result)
    shares = {
        (placement, width): _success(cells[placement, width])
        for placement in PLACEMENTS
        for width in widths
    }
    _measure_cells(cells, shares, widths, output)
    _measure_all(jobs, results, output)
    _tabulate(jobs, results, output)
    output.figure("table_5-1", draw_table(shares, widths, THESIS))
    _show(jobs, results, options, output)


def width_seeds(options: Options, width: float) -> list[int]:
    """Return the seeds of a slot's trials, which no other width has.

    Args:
        options: Options of the run.
        width: Width between the slot's walls [m].
    """
    stream = CARD_AND_SLOT.slot_widths.index(width)
    return [
        int(np.random.SeedSequence([seed, stream]).generate_state(1)[0])
        for seed in options.job_seeds(30, 1)
    ]


def _measure_cells(cells: Cells, shares: Shares, widths: Sequence[float], output: Output) -> None:
    for (placement, width), share in shares.items():
        column = CARD_AND_SLOT.slot_widths.index(width)
        key = f"success/{placement}/{width / INCH:g}"
        output.measure(key, share, thesis=THESIS[placement][column])
    for width in widths:
        pair = ([r.success for r in cells[placement, width]] for placement in PLACEMENTS)
        p, name = mcnemar(*pair), f"{width / INCH:g}"
        output.measure(f"mcnemar_p/{name}", p)
        value = float(shares["optimal", width]["mean"])
        output.check(f"optimal, {name} in", value, ">= 29/30", value >= 29.0 / 30.0)
        worse = p < 0.05 and shares["random", width]["mean"] < value
        output.check(f"random lower, {name} in (McNemar p)", p, "< 0.05", worse)
    if len(widths) > 1:
        values = [float(shares["random", width]["mean"]) for width in widths]
        falls = all(a >= b for a, b in zip(values, values[1:])) and values[0] > values[-1]
        output.check("random, widest less narrowest", values[0] - values[-1], "> 0, falling", falls)


def _measure_all(jobs: Sequence[InsertionTrial], results: Results, output: Output) -> None:
    """Store errors, forces and times over all trials."""
    output.measure("peak_force", distribution(r.peak for r in results))
    largest = max(r.peak for r in results)
    output.measure("largest_force", largest)
    output.check("largest contact force [N]", largest, f"<= {MOST_FORCE:g}", largest <= MOST_FORCE)
    pace = distribution(r.seconds / r.wall for r in results)
    output.measure("real_time_factor", pace)
    faster = float(pace["median"]) > 1.0
    output.check("real-time factor with vision, median", float(pace["median"]), "> 1", faster)
    errors = np.abs([r.hand_over for r in results if not math.isnan(r.hand_over[0])])
    if len(errors):
        output.measure("hand_over_mm", distribution(1e3 * errors[:, 0]))
        output.measure("hand_over_deg", distribution(np.degrees(errors[:, 3])))
    output.measure("seconds", distribution(r.seconds for r in results))
    for placement in PLACEMENTS:
        chosen = [r for job, r in zip(jobs, results) if _placement(job) == placement]
        output.measure(f"seen_share/{placement}", distribution(r.seen for r in chosen))
        nees = [r.nees for r in chosen if not math.isnan(r.nees)]
        if nees:
            output.measure(f"guidance_nees/{placement}", distribution(nees))


def _placement(job: InsertionTrial) -> str:
    return "optimal" if job.optimal else "random"


def _success(results: Results) -> Distribution:
    return success_fraction(result.success for result in results)


def _tabulate(jobs: Sequence[InsertionTrial], results: Results, output: Output) -> None:
    columns = ["slot [in]", "placement", "seed", "success", "reason", "time [s]", "peak [N]",
               "across [mm]", "turn [deg]", "camera [m]", "slant [deg]", "seen",
               "moves"]  # fmt: skip
    rows = [
        [job.width / INCH, _placement(job), job.seed, r.success, r.reason, r.seconds, r.peak,
         1e3 * r.hand_over[0], math.degrees(r.hand_over[3]), r.station.distance,
         math.degrees(r.station.slant), r.seen, r.moves]
        for job, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("insertions", columns, rows)


def _show(
    jobs: Sequence[InsertionTrial], results: Results, options: Options, output: Output
) -> None:
    """Run a success and a failure at the narrowest slot again, and draw them."""
    hard = [(j, r) for j, r in zip(jobs, results) if j.width == CARD_AND_SLOT.slot_widths[-1]]
    good = next((j for j, r in hard if j.optimal and r.success), None)
    # A failure that got as far as touching shows more than one that saw nothing.
    failed = [(r.gap, j) for j, r in hard if not j.optimal and not r.success]
    if good is not None:
        film = film_trial(good, RunFiles.of(options, output))
        output.figure("figure_5-11", draw_steps(film.steps()))
        output.figure("figure_5-12", draw_pairs(film.pairs))
        output.figure("figure_5-13", draw_course(film.course, "Optimal placement"))
        film.save(output.file("insertion.gif"))
    if failed:
        _, bad = min(failed, key=lambda entry: entry[0])
        course = run_trial(dataclasses.replace(bad, trace=True)).course
        output.figure("figure_5-14", draw_course(course, "Random placement"))


def _impossible(options: Options, base: InsertionTrial, output: Output) -> None:
    """Try a slot that is narrower than the card: none gets in, and the force stays bounded."""
    seeds = options.job_seeds(10, 1)
    jobs = [dataclasses.replace(base, width=IMPOSSIBLE, seed=seed) for seed in seeds]
    results = sweep(run_trial, jobs, options, output, label="impossible")
    output.measure("success/impossible", _success(results))
    largest = max(result.peak for result in results)
    output.measure("largest_force/impossible", largest)
    ok = not any(r.success for r in results) and largest <= MOST_FORCE
    output.check(
        "slot narrower than the card: largest force [N]", largest, f"<= {MOST_FORCE:g}, none in", ok
    )


def _noise(options: Options, base: InsertionTrial, output: Output) -> None:
    """Raise the cameras' noise tenfold."""
    seeds = options.job_seeds(10, 1)
    jobs = [dataclasses.replace(base, seed=seed, noise_db=NOISY_DB) for seed in seeds]
    share = _success(sweep(run_trial, jobs, options, output, label="noisy cameras"))
    output.measure("success/noise_x10", share)
    ok = float(share["mean"]) <= 0.5
    output.check("optimal with ten times the camera noise", float(share["mean"]), "<= 0.5", ok)


def _faults(options: Options, base: InsertionTrial, output: Output) -> None:
    """Cause each fault; each has a stated end."""
    jobs = [
        dataclasses.replace(base, width=CARD_AND_SLOT.slot_widths[1], seed=seed, fault=fault.name)
        for fault in Fault
        for seed in options.job_seeds(3, 1)
    ]
    results = sweep(run_trial, jobs, options, output, label="faults")
    rows: list[list[object]] = []
    for fault in Fault:
        chosen = [r for j, r in zip(jobs, results) if j.fault == fault.name]
        wanted, reason = ENDS_IN[fault]
        right = [
            r.success == wanted and r.reason.startswith(reason) and r.peak <= MOST_FORCE
            for r in chosen
        ]
        share = success_fraction(right)
        output.measure(f"fault_ends_right/{fault.name.lower()}", share)
        stated = "inserted" if wanted else f"stops: {reason}"
        output.check(f"{fault.value}: {stated}", float(share["mean"]), "== 1", all(right))
        rows += [[fault.value, stated, r.success, r.reason, r.seconds, r.peak] for r in chosen]
    columns = ["fault", "stated end", "inserted", "reason", "time [s]", "peak [N]"]
    output.table("faults", columns, rows)


def _guides(options: Options, base: InsertionTrial, output: Output) -> None:
    """Insert the card into guides until it snaps into their connector, at each clearance."""
    seeds, clearances = options.job_seeds(30, 1), CARD_GUIDE.clearances
    jobs = [
        dataclasses.replace(base, width=width_of(clearance), seed=seed, guides=True)
        for clearance in clearances
        for seed in seeds
    ]
    results = sweep(run_trial, jobs, options, output, label="into guides")
    for index, clearance in enumerate(clearances):
        share = _success(results[index * len(seeds) : (index + 1) * len(seeds)])
        output.measure(f"success/guides/{1e3 * clearance:g}", share)
        if clearance == clearances[1]:
            value = float(share["mean"])
            output.check("into guides, medium clearance", value, f">= {SEATED:g}", value >= SEATED)
    guided = [r for r in results if not math.isnan(r.hand_over[0])]
    if guided:
        touched = success_fraction(r.touch > TOUCH for r in guided)
        output.measure("contact_fraction", touched)
        value = float(touched["mean"])
        output.check("that touch the guides", value, f">= {TOUCHED:g}", value >= TOUCHED)
        forces = distribution(r.peak for r in guided)
        output.measure("contact_force_n", forces)
        most = float(forces["p95"])
        bar = f"<= {SEATING_FORCE:g}"
        output.check("contact force, p95 [N]", most, bar, most <= SEATING_FORCE)
    snaps = [r.snap for r in guided if not math.isnan(r.snap)]
    if snaps:
        output.measure("snap_force_n", distribution(snaps))
    columns = ["clearance [mm]", "seed", "success", "reason", "time [s]", "peak [N]", "snap [N]",
               "across [mm]", "turn [deg]", "yaw [deg]", "roll [deg]"]  # fmt: skip
    rows = [
        [500.0 * (job.width - CARD_AND_SLOT.card_width), job.seed, r.success, r.reason, r.seconds,
         r.peak, r.snap, 1e3 * r.hand_over[0], *np.degrees(r.hand_over[3:])]
        for job, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("guides", columns, rows)
