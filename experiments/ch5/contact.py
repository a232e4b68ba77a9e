"""``ch5-contact``: six contact states told apart, and insertion by force from misalignment.

The card sits in a compliant hand at the slot (`models/card_and_slot`). Nothing is seen: the guide
gets the wrench with 2 % noise and the sensor's own, and starts up to 4 mm and 6 deg off.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.ch5.contact_figures import (
    draw_courses,
    draw_location,
    draw_states,
    draw_success,
)
from experiments.ch5.contact_record import record_insertion
from experiments.ch5.contact_trial import (
    CLASSIFIED_NOISES,
    NOISES,
    OTHER_SIGMAS,
    RINGS,
    InsertionJob,
    StateJob,
    run_insertion,
    run_states,
)
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import CARD_AND_SLOT, INCH

WAYS = ("guided", "unguided")
IMPOSSIBLE = 4.2 * INCH
"""Width of a slot that the card cannot enter [m]."""
SINGLE = (1, 2, 3, 6)
Cells = dict[tuple[str, float, int], list[dict[str, Any]]]


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of ch5-contact."""


def run(options: Options, output: Output) -> None:
    """Classify the contact states, then insert from every misalignment, guided and not.

    Args:
        options: ``quick`` takes 4 insertions a cell instead of 30, and 1 set of ten poses for each
            state and slot instead of 10.
        output: Receives ``states_classified_fraction``, ``success/<guided or unguided>`` and
            ``peak_force``, the same by cells, and the figures A-5 to A-7.
    """
    _states(options, output)
    cells = _insertions(options, output)
    _impossible(options, output)
    _courses(options, output, cells)


def _states(options: Options, output: Output) -> None:
    """Measure the classifier and the location of the contact point."""
    seeds, widths = options.job_seeds(10, 1), CARD_AND_SLOT.slot_widths
    jobs = [StateJob(state, w, seed) for state in range(1, 7) for w in widths for seed in seeds]
    results = sweep(run_states, jobs, options, output, label="contact states")
    table: list[list[Any]] = []
    right = total = 0
    for state in range(1, 7):
        chosen = [r for job, r in zip(jobs, results) if job.state == state]
        named = np.sum([result["classified"] for result in chosen], axis=0)
        right, total = right + int(named[state - 1]), total + int(named.sum())
        share = fraction(int(named[state - 1]), int(named.sum()))
        output.measure(f"states_classified_fraction/{state}", share)
        value = float(share["mean"])
        output.check(f"state {state} classified at 2 % noise", value, ">= 0.98", value >= 0.98)
        constructed = sum(job.poses for job in jobs if job.state == state)
        drawn = sum(result["drawn"] for result in chosen)
        table.append([state, *named, constructed / drawn, max(r["off_mm"] for r in chosen)])
    output.measure("states_classified_fraction", fraction(right, total))
    for key, name, levels in (
        ("noise", "by_noise", CLASSIFIED_NOISES),
        ("pose_sigma", "by_sigma", OTHER_SIGMAS),
    ):
        mean = np.mean([result[name] for result in results], axis=0)
        for level, value in zip(levels, mean):
            output.measure(f"states_classified_fraction/{key}_{level:g}", float(value))
    columns = ["state", *(f"named {n}" for n in range(1, 7)), "pressed as drawn", "off [mm]"]
    output.table("states", columns, table)
    located = {
        state: np.hstack([r["location_mm"] for job, r in zip(jobs, results) if job.state == state])
        for state in SINGLE
    }
    for index, noise in enumerate(NOISES):
        errors = np.concatenate([located[state][index] for state in SINGLE])
        output.measure(f"contact_point_error_mm/noise_{noise:g}", distribution(errors))
    output.figure("figure_a-5_a-6", draw_states(widths[1]))
    output.figure("figure_a-7", draw_location(NOISES, located))


def _insertions(options: Options, output: Output) -> Cells:
    """Insert from all misalignments and store success and force."""
    seeds = options.job_seeds(30, 4)
    jobs = [
        InsertionJob(width, ring, way == "guided", seed)
        for width in CARD_AND_SLOT.slot_widths
        for ring in RINGS
        for way in WAYS
        for seed in seeds
    ]
    results = sweep(run_insertion, jobs, options, output, label="insertions")
    cells: Cells = {}
    for job, result in zip(jobs, results):
        way = "guided" if job.guided else "unguided"
        cells.setdefault((way, job.width, job.ring), []).append(result)
    for (way, width, ring), cell in cells.items():
        name = f"{way}/{width / INCH:g}/{ring}"
        output.measure(f"success/{name}", _share(cell))
        output.measure(f"peak_force/{name}", distribution(r["peak"] for r in cell))
        output.measure(f"seconds/{name}", distribution(r["seconds"] for r in cell))
    widest = RINGS[-1]
    hard = [
        width
        for width in CARD_AND_SLOT.slot_widths
        if _share(cells["unguided", width, widest])["mean"] <= 0.5
    ]
    output.measure("hard_slots_inch", [round(width / INCH, 4) for width in hard])
    for way in WAYS:
        pooled = [r for width in hard for r in cells[way, width, widest]]
        if pooled:
            output.measure(f"success/{way}", _share(pooled))
    for width in hard:
        value = float(_share(cells["guided", width, widest])["mean"])
        name = f"guided, {width / INCH:g} in, widest misalignment, where unguided <= 0.5"
        output.check(name, value, ">= 0.9", value >= 0.9)
    output.check("slots where unguided <= 0.5", len(hard), ">= 1", len(hard) >= 1)
    peaks = {way: [r["peak"] for k, c in cells.items() if k[0] == way for r in c] for way in WAYS}
    output.measure("peak_force", distribution(peaks["guided"]))
    output.measure("peak_force/unguided", distribution(peaks["unguided"]))
    for way, bound in (("guided", 5.0), ("unguided", 10.0)):
        largest = max(peaks[way])
        output.measure(f"largest_force/{way}", largest)
        output.check(f"largest force, {way} [N]", largest, f"<= {bound:g}", largest <= bound)
    _table(output, jobs, results)
    output.figure("success", draw_success(cells, CARD_AND_SLOT.slot_widths, RINGS))
    return cells


def _share(cell: Sequence[Mapping[str, Any]]) -> Any:
    return fraction(sum(bool(result["success"]) for result in cell), len(cell))


def _table(output: Output, jobs: Sequence[InsertionJob], results: Sequence[Any]) -> None:
    columns = ["slot [in]", "third", "guided", "seed", "offset [mm]", "tilt [deg]", "success",
               "peak [N]", "time [s]", "retreats", "reason"]  # fmt: skip
    rows = [
        [job.width / INCH, job.ring, job.guided, job.seed, 1e3 * r["offset"],
         np.degrees(r["tilt"]), r["success"], r["peak"], r["seconds"], r["tries"], r["reason"]]
        for job, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("insertions", columns, rows)


def _impossible(options: Options, output: Output) -> None:
    """Try a slot that is narrower than the card: no success, and a bounded force."""
    jobs = [InsertionJob(IMPOSSIBLE, 1, True, seed) for seed in options.job_seeds(10, 2)]
    results = sweep(run_insertion, jobs, options, output, label="impossible")
    output.measure("success/impossible", _share(results))
    largest = max(result["peak"] for result in results)
    output.measure("largest_force/impossible", largest)
    failed = not any(result["success"] for result in results)
    ok = failed and largest <= 5.0
    output.check("largest force at a slot that is too narrow [N]", largest, "<= 5, none in", ok)


def _courses(options: Options, output: Output, cells: Cells) -> None:
    """Draw the hardest cell's first misalignment that only the guided way masters."""
    width, ring = CARD_AND_SLOT.slot_widths[-1], RINGS[-1]
    seeds = options.job_seeds(30, 4)
    pairs = zip(seeds, cells["guided", width, ring], cells["unguided", width, ring])
    told = [seed for seed, by, without in pairs if by["success"] and not without["success"]]
    seed = told[0] if told else seeds[0]
    courses = {
        way: run_insertion(InsertionJob(width, ring, way == "guided", seed, trace=True))["course"]
        for way in WAYS
    }
    output.figure("forces", draw_courses(courses))
    if options.record:
        record_insertion(width, courses["guided"], output.file("run.rrd"))
