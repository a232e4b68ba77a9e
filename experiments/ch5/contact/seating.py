"""Part of ch5-contact: insertion into card guides, by force, straight ahead and by spiral."""

from collections.abc import Mapping, Sequence

from experiments.ch5.contact.figures import draw_seatings
from experiments.ch5.contact.seating_trial import (
    FRICTIONS,
    RINGS,
    WAYS,
    SeatingJob,
    SeatingResult,
    run_seating,
)
from experiments.harness import contract
from experiments.harness.intervals import Distribution, distribution, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.datasheets import CARD_GUIDE
from twin.optics.realism import RealismName

GUIDED, STRAIGHT, FINER = 0.95, 0.5, 0.05
"""Bars: by force, where straight ahead inserts at most that; and the most that finer physics may
change."""
FORCE = 20.0
"""Bar of the 95th percentile of contact forces [N]."""
Cells = Mapping[tuple[str, float, int], Sequence[SeatingResult]]


def measure_seatings(
    options: contract.RepeatedOptions, realism: RealismName, output: Output
) -> None:
    """Insert the card into guides from every misalignment, in every way.

    Args:
        options: Seeds and processes.
        realism: How far the hand and its sensor are from their drawings.
        output: Receives ``success/<way>/<friction>/<third>``, ``success/<way>/guides``,
            ``success/guided_finer/guides``, ``contact_force_n``, ``snap_force_n`` and a figure.
    """
    clearances = CARD_GUIDE.clearances[1:2] if options.quick else CARD_GUIDE.clearances
    seeds = options.job_seeds(10, 1)
    jobs = [
        SeatingJob(clearance, friction, ring, way, seed, fine, realism)
        for fine, ways in ((False, WAYS), (True, WAYS[:1]))
        for way in ways
        for friction in FRICTIONS
        for ring in RINGS
        for clearance in clearances
        for seed in seeds
    ]
    results = sweep(run_seating, jobs, options, output, label="into card guides")
    named = {name: [] for name in (*WAYS, "guided_finer")}
    cells: dict[tuple[str, float, int], list[SeatingResult]] = {}
    for job, result in zip(jobs, results):
        name = "guided_finer" if job.fine else job.way
        named[name].append(result)
        cells.setdefault((name, job.friction, job.ring), []).append(result)
    for name, chosen in named.items():
        output.measure(f"success/{name}/guides", _success(chosen))
    for (name, friction, ring), chosen in cells.items():
        output.measure(f"success/{name}/{friction:g}/{ring}", _success(chosen))
    guided = named["guided"]
    output.measure("contact_force_n", distribution(result.peak for result in guided))
    output.measure("snap_force_n", distribution(r.snap for r in guided if r.success))
    _check(cells, named, output)
    columns = ["clearance [mm]", "friction", "third", "way", "finer", "seed", "success",
               "peak [N]", "snap [N]", "depth [mm]", "time [s]", "reason"]  # fmt: skip
    rows = [
        [1e3 * job.clearance, job.friction, job.ring, job.way, job.fine, job.seed, r.success,
         r.peak, r.snap, 1e3 * r.depth, r.seconds, r.reason]
        for job, r in zip(jobs, results)
    ]  # fmt: skip
    output.table("seatings", columns, rows)
    output.figure("seatings", draw_seatings(cells))


def _check(cells: Cells, named: Mapping[str, Sequence[SeatingResult]], output: Output) -> None:
    """Hold the results against their bars."""
    hard = [cell for cell in _cells() if _share(cells["straight", *cell]) <= STRAIGHT]
    output.check("cells where straight ahead <= 0.5", len(hard), ">= 1", bool(hard))
    for friction, ring in hard:
        value = _share(cells["guided", friction, ring])
        what = f"into guides by force, friction {friction:g}, third {ring}"
        output.check(what, value, f">= {GUIDED:g}", value >= GUIDED)
    change = abs(_share(named["guided_finer"]) - _share(named["guided"]))
    output.check("change by finer physics", change, f"<= {FINER:g}", change <= FINER)
    peaks = float(distribution(result.peak for result in named["guided"])["p95"])
    output.check("contact force by force, p95 [N]", peaks, f"<= {FORCE:g}", peaks <= FORCE)


def _cells() -> list[tuple[float, int]]:
    return [(friction, ring) for friction in FRICTIONS for ring in RINGS]


def _success(chosen: Sequence[SeatingResult]) -> Distribution:
    return success_fraction(result.success for result in chosen)


def _share(chosen: Sequence[SeatingResult]) -> float:
    return float(_success(chosen)["mean"])
