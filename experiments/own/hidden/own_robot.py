"""``own-robot``: robots that nobody is told, foreign ones without a line of code for them.

Each robot is its drawing with all parameters in question elsewhere. It plays the motion that was
designed for its drawing; some also play a chirp and a random motion, as long and within the same
limits. Each log is identified, and confirmed by a random motion that was held out. Rovers of ours
on emulated boards close the same loop. The truth scores afterwards.
"""

import dataclasses
import importlib
import time
from collections.abc import Sequence
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from experiments.harness.intervals import distribution, success_fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from experiments.own.hidden import rover_loop
from experiments.own.hidden.formats import FormatTrial, compared
from experiments.own.hidden.hidden_robots import KINDS, Kind, drawn_coordinates, logged
from experiments.own.hidden.motions import Chirp, DesignTrial, commands, designed, fitted, series_of
from experiments.own.hidden.own_robot_options import Options
from experiments.own.hidden.results import Found, RobotResult, RobotTrial, found_in
from experiments.own.hidden.rover_loop import RoverDesign, write_files
from experiments.own.identification import SIGMAS, identify
from perception.geometry.arrays import BoolArray, FloatArray

STEP = 0.001
"""Longest time step of the models, as `identify` takes it unless said [s]."""
RESAMPLES = 2000
Motion = Literal["designed", "chirp", "random"]
MOTIONS: tuple[Motion, ...] = ("designed", "chirp", "random")
_ROVERS = 7  # Stream of random numbers of an experiment's seed.
COMPARED_DURATION, QUICK_COMPARED = 2.5, 1.0
"""Longest runs that are compared in several formats [s]."""
SAME, SAME_SINGLE = 1e-9, 1e-4
COVERED, FALSE, NAMED, MISNAMED = (0.92, 0.98), 0.01, 1.0, 0.02
OVER_CHIRP, OVER_RANDOM, OVER_PEER, HELD_OUT, DELAY = 0.25, 0.5, 1.05, 0.2, 0.5


def run(options: Options, output: Output) -> None:
    """Design motions, identify robots, and score.

    Args:
        options: ``quick`` identifies one cart, from 3.2 s of a motion that is the best of twelve.
        output: Receives ``coverage95``, ``false_confidence_fraction`` and others.
    """
    if options.quick:
        options = dataclasses.replace(
            options,
            robots=("cart",),
            count=1,
            compared=1,
            peer=0,
            duration=3.2,
            generations=1,
            rovers=0,
        )
    root = np.random.SeedSequence(options.seed)
    designs = [
        DesignTrial(kind, options.duration, options.generations, options.seed)
        for kind in options.robots
    ]
    shapes = sweep(designed, designs, options, output, label="motions")
    trials: list[RobotTrial] = []
    for kind, shape, own in zip(options.robots, shapes, root.spawn(len(designs)), strict=True):
        for index, seed in enumerate(own.generate_state(options.count).tolist()):
            motions = MOTIONS if index < options.compared else MOTIONS[:1]
            values = tuple(shape.tolist())
            trials.append(
                RobotTrial(kind, seed, options.duration, values, motions, index < options.peer)
            )
    results = sweep(identified, trials, options, output, label="robots")
    results += _rovers(options, output)
    _formats(options, output)
    _measure(results, output, np.random.default_rng(options.seed))
    output.table("parameters", *_table(results))
    output.figure("deviations", _figure(results))


def _rovers(options: Options, output: Output) -> list[RobotResult]:
    """Close the loop on rovers of ours, and return what was found of each."""
    write_files(output.file("rover"))
    if not options.rovers:
        return []
    duration, generations = options.rover_duration, options.rover_generations
    design = RoverDesign(duration, generations, options.seed)
    (shape,) = sweep(rover_loop.designed, [design], options, output, label="the rover's motion")
    seeds = np.random.SeedSequence([options.seed, _ROVERS]).generate_state(options.rovers)
    trials = [
        RobotTrial("rover", seed, duration, tuple(shape.tolist()), MOTIONS[:1], False)
        for seed in seeds.tolist()
    ]
    results = sweep(rover_loop.identified, trials, options, output, label="rovers")
    for key, bits in (
        ("replay_bits_different", [each.bits for each in results]),
        ("replay_bits_different/emulated", [each.board_bits for each in results]),
    ):
        output.measure(key, distribution(bits))
        output.check(f"{key}, most", max(bits), "= 0", max(bits) == 0)
    return [each.robot for each in results]


def _formats(options: Options, output: Output) -> None:
    """Identify one robot of each kind from the same run in several formats."""
    longest = QUICK_COMPARED if options.quick else COMPARED_DURATION
    duration = min(options.duration, longest)
    trials = [FormatTrial(kind, duration, options.seed) for kind in options.robots]
    found = sweep(compared, trials, options, output, label="formats")
    agree = [each.csv <= SAME and each.lerobot <= SAME_SINGLE for each in found]
    output.measure("formats_agree", success_fraction(agree))
    for key, off, most in (
        ("CSV and MCAP", max(each.csv for each in found), SAME),
        ("LeRobot and MCAP", max(each.lerobot for each in found), SAME_SINGLE),
    ):
        output.check(f"{key}, relative", off, f"<= {most:g}", off <= most)


def identified(trial: RobotTrial) -> RobotResult:
    """Let one robot play its motions, identify it from each, and note what is true."""
    kind = KINDS[trial.kind]
    makes, moves, senses = np.random.SeedSequence(trial.seed).spawn(3)
    truth = drawn_coordinates(kind, np.random.default_rng(makes))
    series = series_of(kind, trial.duration)
    moving, sensing = np.random.default_rng(moves), np.random.default_rng(senses)
    unseen = logged(kind, truth, fitted(kind, series, series.random(moving)), sensing)
    found: list[Found] = []
    peer, peer_seconds = np.zeros(0), 0.0
    parameters = kind.selected()
    for motion in trial.motions:
        log = logged(kind, truth, _commands(kind, trial, motion, moving), sensing)
        begin = time.process_time()
        result = identify(
            kind.spec(), [log], [*kind.parameters, *kind.planted], [unseen], step=STEP
        )
        found.append(found_in(result, truth, time.process_time() - begin))
        if trial.peer and motion == "designed":
            fit_by_peer = importlib.import_module("experiments.own.hidden.peer").fit_by_peer
            spec = kind.spec()
            spec.option.timestep = STEP
            begin = time.process_time()
            peer = fit_by_peer(spec, parameters[: len(parameters) - len(kind.planted)], log)
            peer_seconds = time.process_time() - begin
    names = tuple(each.name for each in parameters)
    return RobotResult(trial, names, len(kind.planted), truth, tuple(found), peer, peer_seconds)


def _commands(
    kind: Kind, trial: RobotTrial, motion: str, generator: np.random.Generator
) -> FloatArray:
    series = series_of(kind, trial.duration)
    if motion == "designed":
        return commands(series, np.array(trial.shape))
    if motion == "chirp":
        return fitted(kind, Chirp(series.home, series.duration, kind.highest), np.ones(1))
    return fitted(kind, series, series.random(generator))


def _measure(
    results: Sequence[RobotResult], output: Output, generator: np.random.Generator
) -> None:
    first = [(each, each.found[0]) for each in results]
    covered = [np.abs(each.off(found))[each.asked] <= SIGMAS for each, found in first]
    coverage = _clustered(covered, generator)
    output.measure("coverage95", coverage)
    output.check_within("coverage", coverage["mean"], COVERED)
    for kind in dict.fromkeys(each.trial.kind for each in results):
        own = [row for row, each in zip(covered, results) if each.trial.kind == kind]
        output.measure(f"coverage95/{kind}", _clustered(own, generator))
        ratios = [found.hold_out for each, found in first if each.trial.kind == kind]
        output.measure(f"hold_out_ratio/{kind}", distribution(ratios))
    false = success_fraction(each.false(found) for each, found in first)
    output.measure("false_confidence_fraction", false)
    output.check("false confidence", false["mean"], f"<= {FALSE:g}", false["mean"] <= FALSE)
    output.measure("good_fraction", success_fraction(not found.doubts for _, found in first))
    planted = [
        not told for each, found in first for told in found.told[len(each.names) - each.planted :]
    ]
    named = success_fraction(planted)
    output.measure("named_unidentifiable_fraction", named)
    output.check("unidentifiable named", named["mean"], f">= {NAMED:g}", named["mean"] >= NAMED)
    plain = [
        not told
        for each, found in first
        for told in found.told[each.asked][found.plain[each.asked]]
    ]
    wrong = success_fraction(plain)
    output.measure("misnamed_identifiable_fraction", wrong)
    output.check("identifiable named", wrong["mean"], f"<= {MISNAMED:g}", wrong["mean"] <= MISNAMED)
    held_out = [found.hold_out for _, found in first]
    output.measure("hold_out_ratio", distribution(held_out))
    output.check("hold-out, worst", max(held_out), f"<= {HELD_OUT:g}", max(held_out) <= HELD_OUT)
    delays = [_delay_error(each, found) for each, found in first if "delay" in each.names]
    output.measure("delay_error_ms", distribution(delays))
    output.check("delay, worst [ms]", max(delays), f"<= {DELAY:g}", max(delays) <= DELAY)
    output.measure("chi_square", distribution(found.chi_square for _, found in first))
    _compare_motions(results, output)
    _compare_peer(results, output)


def _delay_error(result: RobotResult, found: Found) -> float:
    """Return the error of the delay [ms]."""
    index = result.names.index("delay")
    spread = KINDS[result.trial.kind].selected()[index].spread
    return 1e3 * spread * float(abs(found.coordinates[index] - result.truth[index]))


def _compare_motions(results: Sequence[RobotResult], output: Output) -> None:
    compared = [each for each in results if len(each.found) == len(MOTIONS)]
    if not compared:
        return
    for index, motion, most in ((1, "chirp", OVER_CHIRP), (2, "random", OVER_RANDOM)):
        ratios = [
            each.squared_error(each.found[0]) / each.squared_error(each.found[index])
            for each in compared
        ]
        key = f"squared_error_over_{motion}"
        output.measure(key, distribution(ratios))
        for kind in dict.fromkeys(each.trial.kind for each in compared):
            own = [ratio for ratio, each in zip(ratios, compared) if each.trial.kind == kind]
            found = distribution(own)
            output.measure(f"{key}/{kind}", found)
            median = found["median"]
            output.check(f"{kind}: designed over {motion}", median, f"<= {most:g}", median <= most)


def _compare_peer(results: Sequence[RobotResult], output: Output) -> None:
    asked = [each for each in results if len(each.peer)]
    if not asked:
        return
    errors = [
        np.sqrt(
            each.squared_error(each.found[0]) / np.sum((each.peer - each.truth[each.asked]) ** 2)
        )
        for each in asked
    ]
    times = [each.found[0].seconds / each.peer_seconds for each in asked]
    for key, values, most in (("error", errors, OVER_PEER), ("time", times, 1.0)):
        found = distribution(values)
        output.measure(f"sysid_{key}_ratio", found)
        median = found["median"]
        output.check(f"{key} over mujoco.sysid's", median, f"<= {most:g}", median <= most)


def _clustered(rows: Sequence[BoolArray], generator: np.random.Generator) -> dict[str, float]:
    """Return a pooled fraction with its 95 % interval by resampling robots."""
    counts = np.array([[row.sum(), row.size] for row in rows])
    drawn = generator.integers(len(rows), size=(RESAMPLES, len(rows)))
    sums = counts[drawn].sum(axis=1)
    low, high = np.quantile(sums[:, 0] / sums[:, 1], [0.025, 0.975])
    mean = float(counts[:, 0].sum() / counts[:, 1].sum())
    return {
        "median": mean,
        "mean": mean,
        "low": float(low),
        "high": float(high),
        "p95": mean,
        "n": int(counts[:, 1].sum()),
    }


def _table(results: Sequence[RobotResult]) -> tuple[list[str], list[list[object]]]:
    columns = ["robot", "seed", "motion", "parameter", "true", "found", "deviation", "told"]
    rows: list[list[object]] = []
    for each in results:
        for motion, found in zip(each.trial.motions, each.found, strict=True):
            lines = zip(each.names, each.truth, found.coordinates, found.deviations, found.told)
            for name, *numbers, told in lines:
                start = [each.trial.kind, each.trial.seed, motion, name]
                rows.append([*start, *map(float, numbers), bool(told)])
    return columns, rows


def _figure(results: Sequence[RobotResult]) -> Figure:
    """Draw each kind's errors over the deviations stated, and what each motion leaves."""
    kinds = list(dict.fromkeys(each.trial.kind for each in results))
    figure = Figure(figsize=(9, 3.2 * len(kinds)), layout="constrained")
    grid = figure.subplots(len(kinds), 2, squeeze=False)
    for (left, right), kind in zip(grid, kinds, strict=True):
        own = [each for each in results if each.trial.kind == kind]
        names = own[0].names[own[0].asked]
        places = np.arange(len(names))
        for each in own:
            left.plot(places, each.off(each.found[0])[each.asked], ".", color="C0", alpha=0.5)
        left.axhspan(-SIGMAS, SIGMAS, color="0.9", zorder=0)
        left.set_yscale("symlog", linthresh=5.0)
        left.yaxis.set_major_locator(FixedLocator([-100.0, -10.0, -2.0, 0.0, 2.0, 10.0, 100.0]))
        left.yaxis.set_major_formatter("{x:g}")
        left.yaxis.set_minor_locator(NullLocator())
        left.set_ylabel(f"{kind}\nerror [stated deviations]")
        for index, motion in enumerate(MOTIONS):
            rows = [
                (each.found[index].coordinates - each.truth)[each.asked]
                for each in own
                if len(each.found) > index
            ]
            if rows:
                size = np.sqrt(np.mean(np.square(rows), axis=0))
                right.semilogy(places, size, "o-", lw=0.6, ms=4, label=motion)
        right.set_ylabel("error, rms\n[deviations beforehand]")
        right.legend()
        for axes in (left, right):
            axes.set_xticks(places, names, rotation=90, fontsize="xx-small")
    return figure
