"""``ch5-contact``: six contact states classified, and insertion by force from misalignment.

The card sits in a compliant hand at the slot (`models/card_and_slot`). Nothing is seen: the guide
gets the wrench with 2 % noise and the sensor's own, and starts up to 4 mm and 6 deg off. Each seed
makes a hand within its springs' tolerances, whose sensor has zero, drift, scale and cross-talk.
Beside the thesis' plain slot there are card guides with a connector, which the card snaps into.
"""

from collections.abc import Sequence

import numpy as np

from experiments.ch5.contact.contact_options import Options
from experiments.ch5.contact.figures import (
    draw_courses,
    draw_location,
    draw_states,
    draw_success,
)
from experiments.ch5.contact.record import record_insertion
from experiments.ch5.contact.seating import measure_seatings
from experiments.ch5.contact.trial import (
    CLASSIFIED_NOISES,
    IMPOSSIBLE,
    NOISES,
    OTHER_SIGMAS,
    RINGS,
    InsertionJob,
    InsertionResult,
    StateJob,
    run_insertion,
    run_states,
)
from experiments.harness.intervals import Distribution, distribution, fraction, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import CARD_AND_SLOT, INCH

METHODS = ("guided", "unguided")
SINGLE = (1, 2, 3, 6)
Cells = dict[tuple[str, float, int], list[InsertionResult]]


def run(options: Options, output: Output) -> None:
    """Classify the contact states, then insert from every misalignment, guided and not.

    Args:
        options: ``quick`` takes 4 insertions a cell instead of 30, 1 set of ten poses for each
            state and slot instead of 10, and 1 insertion a cell into card guides instead of 30.
        output: Receives ``states_classified_fraction``, ``success/<guided or unguided>`` and
            ``peak_force``, the same by cells, the figures A-5 to A-7, and what
            `seating.measure_seatings` tells of card guides.
    """
    _states(options, output)
    cells = _insertions(options, output)
    _impossible(options, output)
    measure_seatings(options, options.realism, output)
    _courses(options, output, cells)


def _states(options: Options, output: Output) -> None:
    """Measure the classifier and the location of the contact point."""
    seeds, widths = options.job_seeds(10, 1), CARD_AND_SLOT.slot_widths
    jobs = [
        StateJob(state, width, seed, realism=options.realism)
        for state in range(1, 7)
        for width in widths
        for seed in seeds
    ]
    results = sweep(run_states, jobs, options, output, label="contact states")
    table: list[list[float]] = []
    right = 0
    for state in range(1, 7):
        chosen = [r for job, r in zip(jobs, results) if job.state == state]
        named = np.sum([result.classified for result in chosen], axis=0)
        right += int(named[state - 1])
        share = fraction(int(named[state - 1]), int(named.sum()))
        output.measure(f"states_classified_fraction/{state}", share)
        value = float(share["mean"])
        output.check(f"state {state} classified at 2 % noise", value, ">= 0.98", value >= 0.98)
        constructed = sum(job.poses for job in jobs if job.state == state)
        drawn = sum(result.drawn for result in chosen)
        table.append([state, *named, constructed / drawn, max(r.off_mm for r in chosen)])
    total = int(np.sum([result.classified for result in results]))
    output.measure("states_classified_fraction", fraction(right, total))
    for key, levels, shares in (
        ("noise", CLASSIFIED_NOISES, [result.by_noise for result in results]),
        ("pose_sigma", OTHER_SIGMAS, [result.by_sigma for result in results]),
    ):
        for level, value in zip(levels, np.mean(shares, axis=0)):
            output.measure(f"states_classified_fraction/{key}_{level:g}", float(value))
    columns = ["state", *(f"named {n}" for n in range(1, 7)), "pressed as drawn", "off [mm]"]
    output.table("states", columns, table)
    located = {
        state: np.hstack([r.location_mm for job, r in zip(jobs, results) if job.state == state])
        for state in SINGLE
    }
    for noise, errors in zip(NOISES, np.hstack(list(located.values()))):
        output.measure(f"contact_point_error_mm/noise_{noise:g}", distribution(errors))
    output.figure("figure_a-5_a-6", draw_states(widths[1]))
    output.figure("figure_a-7", draw_location(NOISES, located))


def _insertions(options: Options, output: Output) -> Cells:
    """Insert from all misalignments and store success and force."""
    widths, seeds, widest = CARD_AND_SLOT.slot_widths, options.job_seeds(30, 4), RINGS[-1]
    jobs = [
        InsertionJob(width, ring, method == "guided", seed, realism=options.realism)
        for width in widths
        for ring in RINGS
        for method in METHODS
        for seed in seeds
    ]
    results = sweep(run_insertion, jobs, options, output, label="insertions")
    cells: Cells = {}
    for job, result in zip(jobs, results):
        method = "guided" if job.guided else "unguided"
        cells.setdefault((method, job.width, job.ring), []).append(result)
    for (method, width, ring), cell in cells.items():
        name = f"{method}/{width / INCH:g}/{ring}"
        output.measure(f"success/{name}", _success(cell))
        output.measure(f"peak_force/{name}", distribution(r.peak for r in cell))
        output.measure(f"seconds/{name}", distribution(r.seconds for r in cell))
    hard = [w for w in widths if _success(cells["unguided", w, widest])["mean"] <= 0.5]
    output.measure("hard_slots_inch", [round(width / INCH, 4) for width in hard])
    for method in METHODS:
        pooled = [r for width in hard for r in cells[method, width, widest]]
        if pooled:
            output.measure(f"success/{method}", _success(pooled))
    for width in hard:
        value = float(_success(cells["guided", width, widest])["mean"])
        name = f"guided, {width / INCH:g} in, widest misalignment, where unguided <= 0.5"
        output.check(name, value, ">= 0.9", value >= 0.9)
    output.check("slots where unguided <= 0.5", len(hard), ">= 1", len(hard) >= 1)
    for method, key, bound in (("guided", "", 5.0), ("unguided", "/unguided", 10.0)):
        peaks = [r.peak for (way, *_), cell in cells.items() if way == method for r in cell]
        output.measure(f"peak_force{key}", distribution(peaks))
        output.measure(f"largest_force/{method}", max(peaks))
        ok = max(peaks) <= bound
        output.check(f"largest force, {method} [N]", max(peaks), f"<= {bound:g}", ok)
    columns = ["slot [in]", "third", "guided", "seed", "offset [mm]", "tilt [deg]", "success",
               "peak [N]", "time [s]", "retreats", "reason"]  # fmt: skip
    rows = [
        [job.width / INCH, job.ring, job.guided, job.seed, 1e3 * r.offset,
         np.degrees(r.tilt), r.success, r.peak, r.seconds, r.tries, r.reason]
        for job, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("insertions", columns, rows)
    output.figure("success", draw_success(cells, widths, RINGS))
    return cells


def _success(cell: Sequence[InsertionResult]) -> Distribution:
    return success_fraction(result.success for result in cell)


def _impossible(options: Options, output: Output) -> None:
    """Try a slot that is narrower than the card: no success, and a bounded force."""
    seeds = options.job_seeds(10, 2)
    jobs = [InsertionJob(IMPOSSIBLE, 1, True, seed, realism=options.realism) for seed in seeds]
    results = sweep(run_insertion, jobs, options, output, label="impossible")
    output.measure("success/impossible", _success(results))
    largest = max(result.peak for result in results)
    output.measure("largest_force/impossible", largest)
    ok = largest <= 5.0 and not any(result.success for result in results)
    output.check("largest force at a slot that is too narrow [N]", largest, "<= 5, none in", ok)


def _courses(options: Options, output: Output, cells: Cells) -> None:
    """Draw the hardest cell's first misalignment that is mastered with guidance alone."""
    width, ring = CARD_AND_SLOT.slot_widths[-1], RINGS[-1]
    seeds = options.job_seeds(30, 4)
    pairs = zip(seeds, cells["guided", width, ring], cells["unguided", width, ring])
    mastered = (seed for seed, by, without in pairs if by.success and not without.success)
    seed = next(mastered, seeds[0])
    courses = {
        method: run_insertion(
            InsertionJob(width, ring, method == "guided", seed, trace=True, realism=options.realism)
        ).course
        for method in METHODS
    }
    output.figure("forces", draw_courses(courses))
    if options.record:
        record_insertion(width, courses["guided"], output.file("run.rrd"))
