"""``living-twin``: what a twin beside a rover notices, and what it foresees.

Each seed makes a rover within its tolerances, and a twin of the drawing learns it at work. Then one
thing happens to it, or nothing. Others swing a load or drive with it on a slope, which may tip them
over, and look ahead; in missions something happens midway. Cells, sizes, motions and measures are
in ``docs/living_twin.md``.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from rich.progress import track
from scipy import stats

from experiments.harness.intervals import CONFIDENCE, distribution, error_bars, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from experiments.living.ahead import KINDS, LIKELY, AheadTrial, Foreseen, foresee
from experiments.living.boards import OnBoards, watch_boards
from experiments.living.kills import Killed, kill_often
from experiments.living.living_twin_options import PARTS, Options
from experiments.living.missions import (
    CHANGES,
    LivingMission,
    measure_missions,
    run_living_mission,
)
from experiments.living.trial import LivingTrial, Told, Watched, watch

CELLS = (
    ("load base", 1.0), ("load base", 2.0),
    ("load gripper", 0.1), ("load gripper", 0.2),
    ("spring wheel", 0.5), ("spring wheel", 0.7),
    ("drag wheel", 1.0), ("drag wheel", 3.0),
    ("grip wheel", 0.5), ("grip wheel", 0.7),
    ("grip all", 0.3), ("grip all", 0.5),
    ("supply joint", 0.3), ("supply joint", 0.6),
    ("battery", 0.15), ("battery", 0.3),
    ("zero joint", 0.035), ("zero joint", 0.087),
    ("zero tilt", 0.017), ("zero tilt", 0.035),
    ("blocked wheel", 1.0), ("blocked joint", 1.0),
    ("stuck wheel", 1.0), ("stuck joint", 1.0),
)  # fmt: skip
"""What happens, with its size as of `happenings.happen`; of parts one is chosen at random."""
LOOSE = (("loose camera", 0.017), ("loose camera", 0.035))
"""What happens to rovers with images."""
QUICK = (("load gripper", 0.2),)
QUICK_PARTS = ("changes", "ahead")
SECONDS = 12.0, 8.0, 2.0  # Of a quick run: learning, and unchanged, also on boards [s].
DELAY, RIGHT, COVERED, ALARMS = 3.0, 0.9, 0.9, 1.0  # Bars; the last is of ten hours.
WITHIN = stats.norm.ppf(0.5 + CONFIDENCE / 2)
NEES = 0.7, 1.5
"""Bar of the squared errors of predictions one second ahead, over their bands."""
LOST, BACK = 1.0, 10.0
"""Bars of a program that is killed: what its log lacks, and when it is back [s]."""
MISSES = 0.01
FORESEEN, FALSE_STOPS, TOOK = 0.95, 0.05, 0.5
"""Bars on boards and of looking ahead, whose last is the time that it takes in the median [s]."""


def run(options: Options, output: Output) -> None:
    """Run the chosen parts.

    Args:
        options: ``quick`` takes one rover, one happening, short times and few motions.
        output: Receives ``detection_delay_s``, ``isolation_fraction`` and ``size_coverage95``, also
            by cell, ``right_linear`` and ``covered_linear`` beside ``right_tried`` and
            ``covered_tried``, ``false_alarms_per_10h``, ``surprise`` and ``prediction_nees``; of
            looking ahead ``tip_foreseen_fraction`` and ``false_stop_fraction``, also by kind of
            motion, and ``look_ahead_s``; on boards ``deadline_miss_fraction`` and
            ``false_alarms_on_boards``; of programs that are killed ``kill_lost_s``, ``kill_back_s``
            and ``kill_moved``; of missions ``mission_success/<change>/<with or without>`` and
            ``mission_p/<change>``.
    """
    parts = {
        "changes": _changes, "ahead": _ahead, "boards": _boards, "kills": _kills,
        "missions": _missions,
    }  # fmt: skip
    for part in options.parts or (QUICK_PARTS if options.quick else PARTS):
        parts[part](options, output)


def _seconds(options: Options) -> tuple[float, float, float]:
    """Return the time of learning, and of nothing happening in simulation and on boards [s]."""
    return SECONDS if options.quick else (options.learning, options.unchanged, options.on_boards)


def _changes(options: Options, output: Output) -> None:
    """Watch rovers to which each thing happens, and others to which nothing does."""
    learning, unchanged, _ = _seconds(options)
    cells = QUICK if options.quick else CELLS
    seeds = options.job_seeds(30, 1)
    together = [cells, *([] if options.quick else [(each,) for each in LOOSE])]
    trials = [LivingTrial(seed, each, learning) for each in together for seed in seeds]
    trials += [LivingTrial(seed, (), learning, unchanged) for seed in seeds]
    results = sweep(watch, trials, options, output, label="rovers")
    shares = _measure(trials, results, output)
    _measure_alarms([each for each in results if not each.told], output)
    output.table("rovers", *_rovers(trials, results))
    output.table("changes", *_changed(trials, results))
    output.figure("changes", _figure(shares))


def _boards(options: Options, output: Output) -> None:
    """Let a rover work on emulated boards, and count what its twin missed and named."""
    learning, _, seconds = _seconds(options)
    (seed,) = options.job_seeds(1, 1)[:1]
    measure_boards(watch_boards(seed, learning, seconds), output)


def _kills(options: Options, output: Output) -> None:
    """Kill a program that owns a rover, and look at what is lost and what comes back."""
    (seed,) = options.job_seeds(1, 1)[:1]
    count = min(options.kills, 1) if options.quick else options.kills
    measure_kills(list(track(kill_often(seed, count), "kills", total=count)), output)


def _missions(options: Options, output: Output) -> None:
    """Run missions in whose midst something happens, with and without a twin."""
    seeds, changes = options.job_seeds(30, 1), list(CHANGES)[: 2 if options.quick else None]
    trials = [
        LivingMission(seed, change, watched)
        for change in changes
        for watched in (True, False)
        for seed in seeds
    ]
    measure_missions(trials, sweep(run_living_mission, trials, options, output, label="missions"),
                     output)  # fmt: skip


def measure_kills(found: Sequence[Killed], output: Output) -> None:
    """Measure what became of programs that were killed.

    Args:
        found: What became of each kill.
        output: Receives the measures.
    """
    lost, back = (distribution(each) for each in zip(*((k.lost, k.back) for k in found)))
    output.measure("kill_lost_s", lost)
    output.measure("kill_back_s", back)
    moved = sum(each.moved for each in found)
    output.measure("kill_moved", moved)
    for what, most, bar in (
        ("lost", max(each.lost for each in found), LOST),
        ("until it is back", max(each.back for each in found), BACK),
    ):
        output.check(f"{what}, most [s]", most, f"<= {bar:g}", most <= bar)
    output.check("rovers that moved by themselves", moved, "= 0", moved == 0)


def measure_boards(result: OnBoards, output: Output) -> None:
    """Measure a rover on boards.

    Args:
        result: What its twin did.
        output: Receives the measures.
    """
    output.measure("deadline_miss_fraction", result.late)
    output.check("ticks missed on boards", result.late, f"<= {MISSES:g}", result.late <= MISSES)
    output.measure("boards_ticks", result.ticks)
    count = len(result.alarms)
    output.measure("false_alarms_on_boards", count)
    output.check("false alarms on boards", count, "= 0", count == 0)


def _ahead(options: Options, output: Output) -> None:
    """Let rovers move on slopes, and compare what they foresaw with what came."""
    seeds = options.job_seeds(150, 3)
    trials = [AheadTrial(seed, kind) for kind in KINDS for seed in seeds]
    results = sweep(foresee, trials, options, output, label="motions")
    measure_ahead(list(zip(trials, results, strict=True)), output)


def measure_ahead(pairs: Sequence[tuple[AheadTrial, Foreseen]], output: Output) -> None:
    """Count tips that were foreseen, and stops that were not needed.

    Args:
        pairs: Motions and what was foreseen of them.
        output: Receives the measures, a table and a figure.
    """
    kinds = {"": pairs, **{f"/{kind}": [p for p in pairs if p[0].kind == kind] for kind in KINDS}}
    bars = {
        "tip_foreseen_fraction": ("tips foreseen", f">= {FORESEEN:g}", FORESEEN, 1.0),
        "false_stop_fraction": ("false stops", f"<= {FALSE_STOPS:g}", 0.0, FALSE_STOPS),
    }
    for end, some in kinds.items():
        for key, (label, bar, low, high) in bars.items():
            tipped = key == "tip_foreseen_fraction"
            chosen = [each.foretold for _, each in some if each.over == tipped]
            if not chosen:
                continue
            share = success_fraction(chosen)
            output.measure(f"{key}{end}", share)
            if not end:
                output.check(label, share["mean"], bar, low <= share["mean"] <= high)
    took = distribution(each.took for _, each in pairs)
    output.measure("look_ahead_s", took)
    output.check(
        "looking ahead, median [s]", took["median"], f"<= {TOOK:g}", took["median"] <= TOOK
    )
    columns = ["seed", "kind", "slope [deg]", "load [kg]", "tipped [s]", "largest probability"]
    rows: list[list[object]] = [
        [trial.seed, trial.kind, float(np.degrees(each.slope)), each.load, each.tipped,
         float(np.max(each.chances))]
        for trial, each in pairs
    ]  # fmt: skip
    output.table("ahead", columns, rows)
    output.figure("ahead", _ahead_figure(pairs))


def _ahead_figure(pairs: Sequence[tuple[AheadTrial, Foreseen]]) -> Figure:
    """Draw the largest probability of each motion, by whether the rover tipped over."""
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    grid = np.linspace(0.0, 1.0, 21)
    for axes, kind in zip(figure.subplots(1, 2, sharex=True), KINDS, strict=True):
        for tipped, label in ((True, "tipped over"), (False, "did not")):
            chances = [
                float(np.max(each.chances))
                for trial, each in pairs
                if trial.kind == kind and each.over == tipped
            ]
            axes.hist(chances, grid, histtype="step", label=f"{label} ({len(chances)})")
        axes.axvline(LIKELY, color="0.4", lw=0.8, ls=":")
        axes.set(title=f"{kind}s", xlabel="largest probability that was foreseen")
        axes.legend()
    figure.axes[0].set_ylabel("motions")
    return figure


def _measure(
    trials: Sequence[LivingTrial], results: Sequence[Watched], output: Output
) -> dict[str, tuple[dict[str, float | int], list[float]]]:
    """Measure the changes; return by cell the share that is named right, and the delays."""
    cells: dict[str, list[Told]] = {}
    for trial, result in zip(trials, results, strict=True):
        for (name, size), told in zip(trial.happenings, result.told, strict=True):
            cells.setdefault(f"{name} {size:g}", []).append(told)
    found: dict[str, tuple[dict[str, float | int], list[float]]] = {}
    for name, each in cells.items():
        share = success_fraction(result.right for result in each)
        output.measure(f"isolation_fraction/{name}", share)
        delays = [result.delay for result in each if result.found]
        if delays:
            output.measure(f"detection_delay_s/{name}", distribution(delays))
        found[name] = share, delays
    changed = [result for each in cells.values() for result in each]
    right = success_fraction(result.right for result in changed)
    output.measure("isolation_fraction", right)
    output.check("named right", right["mean"], f">= {RIGHT:g}", right["mean"] >= RIGHT)
    # What was never named counts as later than any.
    delays = distribution(result.delay if result.found else np.inf for result in changed)
    output.measure("detection_delay_s", delays)
    soon = delays["median"] <= DELAY
    output.check("delay, median [s]", delays["median"], f"<= {DELAY:g}", soon)
    sizes = [_covered(result) for result in changed if result.right and not result.whole]
    if sizes:
        covered = success_fraction(sizes)
        output.measure("size_coverage95", covered)
        enough = covered["mean"] >= COVERED
        output.check("size within its 95 % band", covered["mean"], f">= {COVERED:g}", enough)
    _measure_suspected(changed, output)
    return found


def _measure_suspected(changed: Sequence[Told], output: Output) -> None:
    """Measure what innovations say as far as they are linear in a change, before it is tried out.

    Beside it stands what was named of the same changes, of those that have a size.
    """
    suspected = [result for result in changed if result.suspected and not result.whole]
    if not suspected:
        return
    as_linear = [
        dataclasses.replace(
            each,
            found=each.suspected,
            found_size=each.suspected_size,
            sigma=each.suspected_sigma,
        )
        for each in suspected
    ]
    for key, results in (("linear", as_linear), ("tried", suspected)):
        output.measure(f"right_{key}", success_fraction(result.right for result in results))
        sizes = [_covered(result) for result in results if result.right]
        if sizes:
            output.measure(f"covered_{key}", success_fraction(sizes))


def _covered(result: Told) -> bool:
    return abs(result.found_size - result.size) <= WITHIN * result.sigma


def _measure_alarms(results: Sequence[Watched], output: Output) -> None:
    """Count what was named of unchanged rovers, with the interval of a Poisson count."""
    count = sum(len(each.alarms) for each in results)
    hours = sum(each.seconds for each in results) / 3600.0
    tail = (1.0 - CONFIDENCE) / 2.0
    low = float(stats.chi2.ppf(tail, 2 * count)) / 2.0 if count else 0.0
    high = float(stats.chi2.ppf(1.0 - tail, 2 * count + 2)) / 2.0
    rate, low, high = (10.0 * each / hours for each in (count, low, high))
    centre = dict.fromkeys(("median", "mean", "p95"), rate)
    output.measure("false_alarms_per_10h", {**centre, "low": low, "high": high, "n": len(results)})
    output.measure("watched_hours", hours)
    output.check("false alarms in ten hours", rate, f"<= {ALARMS:g}", rate <= ALARMS)
    output.measure("surprise", distribution(each.surprise for each in results))
    foreseen = [each.nees for each in results if np.isfinite(each.nees)]
    if foreseen:
        nees = distribution(foreseen)
        output.measure("prediction_nees", nees)
        low, high = NEES
        output.check(
            "predictions within their bands", nees["mean"], f"{low:g} to {high:g}",
            low <= nees["mean"] <= high,
        )  # fmt: skip


def _rovers(
    trials: Sequence[LivingTrial], results: Sequence[Watched]
) -> tuple[list[str], list[list[object]]]:
    columns = [
        "seed", "things that happened", "watched before [s]", "named before", "surprise",
        "prediction nees",
    ]  # fmt: skip
    rows: list[list[object]] = [
        [
            trial.seed, len(each.told), each.seconds, "; ".join(each.alarms), each.surprise,
            each.nees,
        ]
        for trial, each in zip(trials, results, strict=True)
    ]  # fmt: skip
    return columns, rows


def _changed(
    trials: Sequence[LivingTrial], results: Sequence[Watched]
) -> tuple[list[str], list[list[object]]]:
    columns = [
        "seed", "happening", "size", "true size", "delay [s]", "named", "named size", "sigma",
        "suspected", "suspected size", "suspected sigma",
    ]  # fmt: skip
    rows: list[list[object]] = [
        [
            trial.seed, told.name, size, told.size, told.delay, told.found, told.found_size,
            told.sigma, told.suspected, told.suspected_size, told.suspected_sigma,
        ]
        for trial, each in zip(trials, results, strict=True)
        for (_, size), told in zip(trial.happenings, each.told, strict=True)
    ]  # fmt: skip
    return columns, rows


def _figure(cells: dict[str, tuple[dict[str, float | int], list[float]]]) -> Figure:
    """Draw by cell how many are named right, and how soon something is named."""
    figure = Figure(figsize=(9.0, 1.5 + 0.28 * len(cells)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(cells))[::-1]
    values, bars = error_bars([share for share, _ in cells.values()])
    left.barh(places, values, xerr=bars, height=0.7)
    left.axvline(RIGHT, color="0.4", lw=0.8, ls=":")
    left.set(xlabel="named right (95 % interval)", xlim=(0.0, 1.05))
    left.set_yticks(places, list(cells))
    for place, (_, delays) in zip(places, cells.values(), strict=True):
        right.plot(delays, np.full(len(delays), place), "|", color="0.5")
        if delays:
            right.plot(np.median(delays), place, "o", color="C0")
    right.axvline(DELAY, color="0.4", lw=0.8, ls=":")
    right.set_xlabel("time until something is named [s]; dots: medians; dotted: bars")
    return figure
