"""``appd-boards``: the boards of today in the place of the thesis' cards, with all their faults.

An emulated rover drives and one thing breaks: the duty codes at the eight motors must be zero
within the longest timeout and a cycle. The damaged line, the pace of the loop on the wall clock and
the same controller with and without wires are measured besides; figure D-3 is drawn from the
emulated amplifier.
"""

import collections
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from experiments.appd.boards.boards_options import Options
from experiments.appd.boards.figures import (
    dead_band,
    draw_amplifier,
    draw_calls,
    draw_pace,
    draw_stops,
)
from experiments.appd.boards.line import DamagedCalls, call_damaged
from experiments.appd.boards.live import (
    BoardComparison,
    EchoPace,
    IdentityTrial,
    LoopPace,
    compare_boards,
    keep_bare_pace,
    keep_pace,
)
from experiments.appd.boards.matrix import (
    BOARD_SIGNALS,
    CONTROL,
    MATRIX,
    RIDES,
    TRANSIENTS,
    WITHIN,
    MatrixResult,
    deal_matrix,
    run_matrix_trial,
)
from experiments.appd.boards.soak import SoakResult, SoakTrial, growth, run_soak
from experiments.appd.boards.trial import (
    KINDS,
    PERIOD,
    TIMEOUT,
    WRAP,
    FaultTrial,
    deal,
    run_batch,
)
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from twin.hardware.emulator.amplifier import AmplifierConfig

TRIALS = (200, 12)  # full, quick
RATES = {0.03: (4000, 200), 0.1: (4000, 150), 0.3: (2000, 50)}
"""Calls by share of damaged exchanges: full, quick."""
CALL_BOUND = 60.0  # [ms]
PACE = (60.0, 3.0)  # [s] on the wall clock: full, quick
MISS_BOUND = 0.01
LINES = {"clean": 0.0, "faulted": 0.03}
CYCLES = (1000, 100)  # that must be the same to the bit: full, quick
MOTION = (
    (2.0, 1.5, 8.0),
    (0.5, 0.2, 0.4),
)
"""Approach, rest and duration of the identification [s], in full and with --quick."""
STOP_BOUND = TIMEOUT + PERIOD
SOAK = (4.0 * 3600.0, 30.0)  # [s] of robot time: full, quick
GROWTH_BOUND = 0.02


def run(options: Options, output: Output) -> None:
    """Break things, and measure what the adapter does.

    Args:
        options: ``quick`` does 12 fault trials instead of 200, and shortens all else.
        output: Receives ``stopped_fraction``, ``stop_time/<fault>``, ``worst_call_ms``,
            ``wrong_values``, ``miss_fraction``, ``adapter_ms`` and ``identical_cycles/<line>``;
            of the matrix ``matrix_zero_fraction``, ``matrix_zero_ms``,
            ``matrix_message_true_fraction`` and ``matrix_orphans``; of the soak
            ``soak_wrong_values`` and ``soak_growth/<process>``.
    """
    if "trials" in options.parts:
        _run_trials(options, output)
    if "matrix" in options.parts:
        trials = deal_matrix(options.job_seeds(5, 1), options.quick)
        rides = [trial for trial in trials if trial.fault in RIDES]
        stops = [trial for trial in trials if trial.fault not in RIDES]
        faults = sweep(run_matrix_trial, stops, options, output, label="faults")
        # Their cycles are counted: nothing else of ours may run.
        alone = dataclasses.replace(options, jobs=1)
        faults += sweep(run_matrix_trial, rides, alone, output, label="short faults")
        _measure_matrix(faults, output)
    if "soak" in options.parts:
        seeds = options.job_seeds(4, 1)
        share = SOAK[options.quick] / len(seeds)
        drives = [SoakTrial(share, seed, core) for core, seed in enumerate(seeds)]
        _measure_soak(sweep(run_soak, drives, options, output, label="drives"), output)


def _run_trials(options: Options, output: Output) -> None:
    seeds = options.job_seeds(8, 2)
    # What is timed comes first, while nothing else of ours runs.
    pace = keep_pace(PACE[options.quick], seeds[0] % 2**31)
    bare = keep_bare_pace(PACE[options.quick] / 3.0, pace.exchanges)
    draws = np.random.default_rng(seeds[0]).integers(2**31, size=len(RATES)).tolist()
    calls = [
        call_damaged(rate, counts[options.quick], seed)
        for (rate, counts), seed in zip(RATES.items(), draws)
    ]
    batches = sweep(run_batch, deal(TRIALS[options.quick], seeds), options, output, label="rovers")
    lines = [IdentityTrial(share, seeds[0], MOTION[options.quick]) for share in LINES.values()]
    compared = sweep(compare_boards, lines, options, output, label="lines")
    trials = [trial for batch in batches for trial in batch]
    _measure_stops(trials, output)
    _measure_calls(calls, trials, output)
    _measure_pace(pace, PACE[options.quick], output)
    if pace.exchanges:
        _measure_bare_pace(bare, pace, output)
    for name, result in zip(LINES, compared):
        _measure_identity(name, result, CYCLES[options.quick], output)
    _measure_amplifier(output)
    _tabulate(trials, calls, output)


def stop_times(trials: Sequence[FaultTrial]) -> dict[str, list[float]]:
    """Return the times from fault to standstill by fault [s]; infinite for no standstill."""
    found: dict[str, list[float]] = {}
    for trial in sorted(trials, key=lambda each: KINDS.index(each.kind)):
        if trial.kind != WRAP:
            found.setdefault(trial.kind, []).append(trial.stop_time)
    return found


def _measure_stops(trials: Sequence[FaultTrial], output: Output) -> None:
    """Store how often and how soon all motors were let go, and that a wrap stops nothing."""
    times = stop_times(trials)
    every = [value for values in times.values() for value in values]
    stopped = sum(value <= STOP_BOUND + 1e-9 for value in every)
    output.measure("stopped_fraction", fraction(stopped, len(every)))
    output.measure("stop_time", distribution(every))
    for kind, values in times.items():
        output.measure(f"stop_time/{kind}", distribution(values))
        output.measure(f"stop_time_worst/{kind}", max(values))
    share = stopped / len(every)
    output.check(
        f"motors let go within {1e3 * STOP_BOUND:.0f} ms of a fault, of {len(every)} trials",
        share,
        "== 1",
        share == 1.0,
    )
    least = min(trial.moving for trial in trials if trial.kind != WRAP)
    output.check("motors driven when a fault began, fewest", least, ">= 4", least >= 4)
    wraps = [trial for trial in trials if trial.kind == WRAP]
    went_on = sum(trial.active for trial in wraps)
    output.measure("went_on_fraction/counter_wrap", fraction(went_on, len(wraps)))
    output.check(
        f"motion goes on through a counter's wrap, of {len(wraps)} trials",
        went_on / len(wraps),
        "== 1",
        went_on == len(wraps),
    )
    output.measure("started_again", sum(trial.early for trial in trials))
    output.figure("fault_stops", draw_stops(times, STOP_BOUND))


def _measure_calls(
    calls: Sequence[DamagedCalls], trials: Sequence[FaultTrial], output: Output
) -> None:
    """Store the longest call on a damaged line, and that no value was wrong."""
    every = np.concatenate([result.call_ms for result in calls])
    worst = float(every.max())
    wrong = sum(result.wrong for result in calls) + sum(trial.wrong for trial in trials)
    output.measure("worst_call_ms", worst)
    output.measure("late_calls_fraction", fraction(int(np.sum(every > CALL_BOUND)), every.size))
    output.measure("wrong_values", wrong)
    output.measure("damaged_exchanges", sum(result.damaged for result in calls))
    output.measure("failed_calls", sum(result.failures for result in calls))
    output.check(
        f"longest of {every.size} calls on a damaged line, in ms",
        worst,
        f"<= {CALL_BOUND:g}",
        worst <= CALL_BOUND,
    )
    output.check("wrong values, damaged line and wrapped counters", wrong, "== 0", wrong == 0)
    output.figure("calls", draw_calls(calls, CALL_BOUND))


def _measure_pace(result: LoopPace, duration: float, output: Output) -> None:
    """Store how well 100 Hz are kept on the wall clock, and what the adapter takes of a cycle."""
    wanted = round(duration / PERIOD)
    # A robot that stopped has missed all that it did not do.
    missed = min(wanted, result.misses + wanted - result.steps) / wanted
    output.measure("miss_fraction", missed)
    if result.fault:
        output.measure("stopped_after_s", result.steps * PERIOD)
    output.check(
        f"deadlines missed at 100 Hz in {duration:g} s",
        missed,
        f"<= {MISS_BOUND}",
        missed <= MISS_BOUND,
    )
    # A busy machine can stop the robot before a whole cycle was seen.
    if result.periods.size:
        output.measure("period_ms", distribution(1e3 * result.periods))
        output.measure("adapter_ms", distribution(1e3 * result.adapter))
        output.figure("pace", draw_pace(result, PERIOD))


def _measure_bare_pace(bare: EchoPace, pace: LoopPace, output: Output) -> None:
    """Store what an echo costs on this machine, which bounds what the adapter can do."""
    output.measure("exchanges_per_cycle", pace.exchanges)
    output.measure("miss_fraction/echo", bare.misses / bare.steps)
    output.measure("echo_ms", distribution(1e3 * bare.exchange))
    ratio = float(np.median(pace.adapter) / np.median(bare.exchange))
    output.measure("adapter_over_echo", ratio)


def _measure_identity(name: str, result: BoardComparison, least: int, output: Output) -> None:
    """Store for how many cycles a controller saw and did the same with and without wires."""
    identical = result.identical
    output.measure(f"identical_cycles/{name}", identical)
    output.measure(f"identical_cycles/{name}/damaged_exchanges", result.damaged)
    output.check(
        f"cycles alike to the bit with and without wires, {name} line",
        identical,
        f">= {least}",
        identical >= least,
    )


def _measure_matrix(results: Sequence[MatrixResult], output: Output) -> None:
    """Store how soon all duties were zero, and whether the robot's words were true."""
    stops = [each for each in results if each.trial.fault in MATRIX]
    lost = [each for each in results if each.trial.fault in BOARD_SIGNALS]
    rides = [each for each in results if each.trial.fault in TRANSIENTS]
    control = [each.cycles for each in results if each.trial.fault == CONTROL]
    worst = max(each.zero for each in stops)
    late, false = sum(each.zero > WITHIN for each in stops), sum(not each.true for each in results)
    orphans, leaked = (sum(values) for values in zip(*((r.orphans, r.leaked) for r in results)))
    told = max(each.told for each in lost)
    again = max(each.zero for each in lost)
    output.measure("matrix_zero_fraction", fraction(len(stops) - late, len(stops)))
    output.measure("matrix_zero_ms", 1e3 * worst)
    output.measure("matrix_message_true_fraction", fraction(len(results) - false, len(results)))
    output.measure("matrix_orphans", orphans)
    output.measure("matrix_leaked", leaked)
    output.measure("matrix_told_ms/boards_lost", 1e3 * told)
    output.measure("matrix_went_on", fraction(sum(e.active for e in rides), len(rides)))
    output.measure("matrix_cycles_done", distribution([each.cycles for each in rides]))
    output.measure("matrix_cycles_done/no_fault", distribution(control))
    output.check(
        f"zero duty at all boards after the fault, longest of {len(stops)}, in ms",
        1e3 * worst,
        f"<= {1e3 * WITHIN:g}",
        worst <= WITHIN,
    )
    output.check(f"wrong words of the robot, in {len(results)} trials", false, "== 0", not false)
    output.check("processes and open files left", orphans + leaked, "== 0", orphans + leaked == 0)
    output.check(
        "boards whose process is killed or stopped are told lost, longest, in ms",
        1e3 * told,
        f"<= {1e3 * WITHIN:g}",
        told <= WITHIN,
    )
    output.check("drive after the boards' process goes on, in s", again, "<= 1e-6", again <= 1e-6)
    share = sum(each.active for each in rides) / len(rides)
    output.check("robots that go on after short faults", share, ">= 0.95", share >= 0.95)
    cycles = float(np.mean([each.cycles for each in rides]))
    output.check(
        f"cycles done, one short fault a second ({np.mean(control):.3f} without)",
        cycles,
        ">= 0.95",
        cycles >= 0.95,
    )
    rows: list[list[Any]] = []
    for cell in dict.fromkeys((each.trial.fault, each.trial.state) for each in results):
        chosen = [each for each in results if (each.trial.fault, each.trial.state) == cell]
        zero, told = (
            max(1e3 * getattr(each, name) for each in chosen) for name in ("zero", "told")
        )
        words = next((each.words for each in chosen if each.words), "")
        done = np.mean([e.cycles for e in chosen]) if cell[0] in RIDES else ""
        rows.append([*cell, len(chosen), zero, told, sum(e.true for e in chosen), done, words])
    columns = ("fault", "state", "trials", "zero after [ms]", "told after [ms]", "true", "done")
    output.table("matrix", (*columns, "what the robot says, for instance"), rows)


def _measure_soak(results: Sequence[SoakResult], output: Output) -> None:
    """Store whether long drives with faults gave wrong values, false words or growing processes."""
    false = sum(each.false for each in results)
    faults, wrongs = collections.Counter[str](), collections.Counter[str]()
    for each in results:
        faults.update(each.faults)
        wrongs.update(each.wrong)
    wrong = wrongs.total()
    worst = max(each.zero for each in results)
    hours = sum(each.duration for each in results) / 3600.0
    output.measure("soak_hours", hours)
    output.measure("soak_hours/in_motion", sum(each.active for each in results) / 3600.0)
    output.measure("soak_wrong_values", wrong)
    output.measure("soak_compared_cycles", sum(each.cycles for each in results))
    output.measure("soak_damaged_exchanges", sum(each.damaged for each in results))
    output.measure("soak_faults", faults.total())
    output.measure("soak_false_words", false)
    output.measure("soak_unexpected_stops", sum(each.unexpected for each in results))
    output.measure("soak_zero_ms", 1e3 * worst)
    opened = sum(each.opened for each in results)
    output.measure("soak_leaked", opened)
    output.check(f"wrong values in {hours:.2g} hours of driving", wrong, "== 0", wrong == 0)
    output.check("boards called zero that drove", false, "== 0", false == 0)
    output.check(
        f"zero duty after the fault, longest of {faults.total()}, in ms",
        1e3 * worst,
        f"<= {1e3 * WITHIN:g}",
        worst <= WITHIN,
    )
    output.check("open files left", opened, "== 0", opened == 0)
    for name in ("host", "boards"):
        share = max(growth(getattr(each, name)) for each in results)
        output.measure(f"soak_growth/{name}", share)
        output.check(
            f"growth of memory, process of the {name}",
            share,
            f"<= {GROWTH_BOUND}",
            share <= GROWTH_BOUND,
        )
    rows = [[kind, faults[kind], wrongs[kind]] for kind in sorted(faults | wrongs)]
    output.table("soak", ("fault", "times", "wrong values after it"), rows)


def _measure_amplifier(output: Output) -> None:
    """Store what figure D-3's card does, and draw it."""
    card = AmplifierConfig()
    output.measure("amplifier/clock_khz", 1e-3 * card.clock_frequency)
    output.measure("amplifier/clock_duty", card.clock_duty)
    output.measure("amplifier/dead_band_volts", dead_band(card))
    output.figure("figure_d-3", draw_amplifier())


def _tabulate(trials: Sequence[FaultTrial], calls: Sequence[DamagedCalls], output: Output) -> None:
    """Write each fault's times and what the robot said, and the calls by damage."""
    rows: list[list[Any]] = []
    for kind in KINDS:
        chosen = [trial for trial in trials if trial.kind == kind]
        times = 1e3 * np.array([trial.stop_time for trial in chosen])
        said = sorted({trial.fault for trial in chosen if trial.fault})
        wrong = sum(trial.wrong for trial in chosen)
        if kind == WRAP:
            rows.append([kind, len(chosen), 0, "", "", wrong, "goes on, as it must"])
        elif chosen:
            stopped = int(np.sum(times <= 1e3 * STOP_BOUND + 1e-6))
            limits = float(np.median(times)), float(times.max())
            rows.append([kind, len(chosen), stopped, *limits, wrong, said[0] if said else ""])
    columns = ("fault", "trials", "stopped", "median [ms]", "worst [ms]", "wrong values")
    output.table("faults", (*columns, "what the robot says, for instance"), rows)
    heads = ("share damaged", "calls", "damaged exchanges", "retries", "failures", "wrong")
    output.table(
        "calls",
        (*heads, "median [ms]", "99 % [ms]", "worst [ms]"),
        [
            [result.rate, result.call_ms.size, result.damaged, result.retries]
            + [result.failures, result.wrong]
            + [float(np.percentile(result.call_ms, share)) for share in (50, 99, 100)]
            for result in calls
        ],
    )
