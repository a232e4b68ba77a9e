"""``mission-envelope``: what knowledge is worth to an insertion, where it becomes harder.

Rovers as made, left where missions had left them, insert a card into guides: whole, and without one
kind of knowledge; where the field is harder to cross, whole missions are run. A screening with few
seeds chooses, by a rule written down beforehand, the cells that other seeds confirm. Axes, rule and
measures: ``docs/mission.md``.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from experiments.ch5.insertion_trial import InsertionOutcome, run_trial
from experiments.envelope.axes import AXES
from experiments.envelope.cells import Cell, cells_of, chosen
from experiments.envelope.envelope_options import Options
from experiments.envelope.figures import draw_envelope
from experiments.harness.intervals import Distribution, holm, mcnemar, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from experiments.mission.trial import MissionResult, run_mission

SCREENED, CONFIRMED = 10, 30
"""Seeds of the screening and of the cells that are confirmed."""
SIGNIFICANT = 0.01
"""Bar of McNemar's p."""
_CONFIRMING = 1_000_003  # Added to the root of the seeds that confirm.
_KINDS: tuple[tuple[str, bool, Callable[[Any], Any]], ...] = (
    ("insertions", False, run_trial),
    ("missions", True, run_mission),
)
Outcomes = Sequence[InsertionOutcome | MissionResult]
Results = dict[Cell, Outcomes]


def run(options: Options, output: Output) -> None:
    """Screen all cells, and confirm those that the rule chooses.

    Args:
        options: ``quick`` takes one seed of the narrowest clearance with and without force
            guidance, or so of the axes that are given, and confirms nothing; ``seeds`` are those
            that confirm.
        output: Receives ``success/<axis>/<level>/<whole or without_what>`` and
            ``mcnemar_p/<axis>/<level>/<what>`` of the confirmed cells, the latter as it is and
            corrected for their number, ``holm_p/<axis>/<level>/<what>``; a table and a figure.
    """
    cells = list(cells_of(options.chosen_axes))
    if options.quick:
        cells = [cell for cell in cells if cell.is_hardest]
    seeds = dataclasses.replace(options, seeds=None).job_seeds(SCREENED, 1)
    screening = _run_all(cells, seeds, "screened", options, output)
    confirmed = screening if options.quick else _confirm(screening, options, output)
    _measure(confirmed, output)
    _tabulate(screening, confirmed, output)
    output.figure("envelope", draw_envelope(_shares(screening), _shares(confirmed)))


def _confirm(screening: Results, options: Options, output: Output) -> Results:
    """Run the cells that the rule chooses with other seeds."""
    shares = {cell: float(_share(results)["mean"]) for cell, results in screening.items()}
    cells = chosen(shares)
    levels = dict.fromkeys(cell.whole for cell in cells)
    others = dataclasses.replace(options, seed=options.seed + _CONFIRMING)
    seeds = others.job_seeds(CONFIRMED, 1)
    return _run_all([*levels, *cells], seeds, "confirmed", options, output)


def _run_all(
    cells: Sequence[Cell], seeds: Sequence[int], label: str, options: Options, output: Output
) -> Results:
    """Run cells, each with the same seeds."""
    results: Results = {}
    for what, whole, function in _KINDS:
        some = [cell for cell in cells if AXES[cell.axis].whole is whole]
        jobs = [cell.trial(seed) for cell in some for seed in seeds]
        found = sweep(function, jobs, options, output, label=f"{what} {label}") if jobs else []
        for at, cell in enumerate(some):
            results[cell] = found[at * len(seeds) : (at + 1) * len(seeds)]
    return results


def _measure(confirmed: Results, output: Output) -> None:
    tests: dict[str, float] = {}
    for cell, results in confirmed.items():
        key = f"{cell.axis}/{cell.level:g}"
        output.measure(f"success/{key}/{cell.name}", _share(results))
        if cell.without:
            pairs = (_flags(each) for each in (confirmed[cell.whole], results))
            tests[f"{key}/{cell.without}"] = mcnemar(*pairs)
    for key, p in tests.items():
        output.measure(f"mcnemar_p/{key}", p)
    for key, p in holm(tests).items():
        output.measure(f"holm_p/{key}", p)
    for what in dict.fromkeys(cell.without for cell in confirmed if cell.without):
        least = min(p for key, p in tests.items() if key.endswith(f"/{what}"))
        bar = f"< {SIGNIFICANT:g}"
        output.check(f"least p of cells without {what}", least, bar, least < SIGNIFICANT)


def _tabulate(screening: Results, confirmed: Results, output: Output) -> None:
    columns = ["axis", "level", "cell", "screened", "confirmed", "low", "high", "seeds",
               "reasons"]  # fmt: skip
    rows = []
    for cell, results in screening.items():
        more = confirmed.get(cell, [])
        share = _share(more) if more else None
        reasons = ", ".join(sorted({r.reason for r in [*results, *more] if r.reason}))
        rows.append(
            [cell.axis, cell.level, cell.name, _share(results)["mean"],
             *(("", "", "", "") if share is None else
               (share["mean"], share["low"], share["high"], share["n"])), reasons]
        )  # fmt: skip
    output.table("envelope", columns, rows)


def _shares(results: Results) -> Mapping[Cell, Distribution]:
    return {cell: _share(each) for cell, each in results.items()}


def _share(results: Outcomes) -> Distribution:
    return success_fraction(_flags(results))


def _flags(results: Outcomes) -> list[bool]:
    return [result.success for result in results]
