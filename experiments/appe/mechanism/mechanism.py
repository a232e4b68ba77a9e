"""``appe-mechanism``: BRAID as a mechanism in physics, closed loops, detents and muscle wires.

1. A stage without weight, switched by its wires to each of its eight states, beside the exact
   kinematics: with ideal hinges, and with hinges as stiff as their flexures.
2. Its detents: pulls of 0.9 and 1.1 of the barrier, and the least pull that switches a leg.
3. Arms of one to eight stages under their weight: how far the tip sags, how near the detents are
   to giving way, with and without the stereo head.
4. Random words of five stages that carry the head: bits that come out wrong, and speed.
"""

import itertools

import numpy as np

from controllers.braid.bus.drive import DriveConfig
from experiments.appe.mechanism import figures
from experiments.appe.mechanism.bench import make_bench
from experiments.appe.mechanism.mechanism_options import QUICK_SAGGING, SAGGING, Options
from experiments.appe.mechanism.record import record_words
from experiments.appe.mechanism.trial import (
    ArmTrial,
    find_barrier,
    pull,
    run_sag,
    run_words,
    settle_states,
    toggle_course,
)
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import concatenated, seeded_chunks, sweep
from models.braid.build import BraidConfig
from models.datasheets import BRAID

STATE_ERROR = 0.1
"""Bar of a settled state, per cent of the radius."""
HOLDS, TOGGLES = 0.9, 1.1
SAG_WORDS, QUICK_SAG_WORDS = 40, 6
WORDS, QUICK_WORDS = 200, 16
CHUNK = 50
RECORDED = 6
"""Words of the recording."""


def run(options: Options, output: Output) -> None:
    """Run all four parts.

    Args:
        options: ``quick`` takes fewer arms and words.
        output: Receives ``state_error_percent_r``, ``wrong_bits``, ``sag_mm/<stages>``,
            ``detent_load/<stages>``, ``barrier_ratio``, ``real_time_factor`` and more.
    """
    _states(output)
    _detents(options, output)
    _sag(options, output)
    _words(options, output)
    output.figure("figure_E-2_states", figures.states())
    output.figure("figure_E-9_arm", figures.arms())
    output.figure("toggle", figures.toggle(toggle_course()))
    if options.record:
        trial = ArmTrial(options.stages, options.seed, RECORDED, at_once=options.group())
        record_words(trial, output.file("run.rrd"))


def _states(output: Output) -> None:
    """Compare settled states with the exact kinematics."""
    for flexures, suffix in ((True, ""), (False, "/ideal_hinges")):
        place, angle = settle_states(flexures)
        percent = 100.0 * place / BRAID.radius
        output.measure(f"state_error_percent_r{suffix}", float(percent.max()))
        output.measure(f"state_error_deg{suffix}", float(np.rad2deg(angle.max())))
        good = int(np.count_nonzero(percent <= STATE_ERROR))
        kind = "stiff flexures" if flexures else "ideal hinges"
        name = f"states within {STATE_ERROR:g} % of r, {kind}"
        output.check(name, good, f"== {len(percent)}", good == len(percent))


def _detents(options: Options, output: Output) -> None:
    """Pull at legs with less and more than the barrier."""
    bench = make_bench(BraidConfig(1, head=False), gravity=False)
    cases = list(itertools.product(range(3), (True, False)))
    held = sum(not pull(bench, *case, HOLDS * BRAID.barrier) for case in cases)
    switched = sum(pull(bench, *case, TOGGLES * BRAID.barrier) for case in cases)
    output.check(f"pulls of {HOLDS:g} x barrier held", held, f"== {len(cases)}", held == len(cases))
    name = f"pulls of {TOGGLES:g} x barrier that switch"
    output.check(name, switched, f"== {len(cases)}", switched == len(cases))
    output.measure("barrier_N", BRAID.barrier)
    found = [find_barrier(bench, *case) for case in (cases[:1] if options.quick else cases)]
    output.measure("barrier_ratio", distribution(found))


def _sag(options: Options, output: Output) -> None:
    """Let arms of different length sag."""
    counts = QUICK_SAGGING if options.quick else SAGGING
    words = QUICK_SAG_WORDS if options.quick else SAG_WORDS
    (seed,) = np.random.SeedSequence(options.seed).generate_state(1).tolist()
    trials = [ArmTrial(n, seed, words, head) for n in counts for head in (True, False)]
    results = sweep(run_sag, trials, options, output, label="arms")
    rows = []
    for trial, result in zip(trials, results):
        suffix = f"{trial.stages}" if trial.head else f"{trial.stages}/no_head"
        held = result.wrong == 0
        output.measure(f"words_held_fraction/{suffix}", float(held.mean()))
        if not held.any():
            continue
        sag, load = distribution(1e3 * result.sag[held]), float(result.load[held].max())
        most = float(1e3 * result.sag[held].max())
        output.measure(f"sag_mm/{suffix}", sag)
        output.measure(f"sag_mm_max/{suffix}", most)
        output.measure(f"detent_load/{suffix}", load)
        rows.append([trial.stages, int(trial.head), sag["median"], most, load, float(held.mean())])
    columns = ("stages", "head", "median sag [mm]", "greatest sag [mm]", "load / barrier", "held")
    output.table("sag", columns, rows)
    output.figure("sag", figures.sag(trials, results))


def _words(options: Options, output: Output) -> None:
    """Drive an arm through random words."""
    count = options.words or (QUICK_WORDS if options.quick else WORDS)
    chunks = seeded_chunks(count, CHUNK, (options.seed, 1))
    group = options.group()
    trials = [ArmTrial(options.stages, seed, n, at_once=group) for seed, n in chunks]
    results = sweep(run_words, trials, options, output, label="words")
    errors = concatenated([result.errors for result in results])
    wrong = int(errors.wrong.sum())
    output.measure("words", count)
    output.measure("wrong_bits", wrong)
    output.check(f"wrong bits in {count} words", wrong, "== 0", wrong == 0)
    output.measure("words_sag_mm", distribution(1e3 * errors.sag))
    output.measure("words_detent_load", float(errors.load.max()))
    changed = np.concatenate([result.changed for result in results])
    power = BRAID.leg_power * np.minimum(changed, group)
    output.measure("peak_power_W", float(power.max()))
    output.measure("energy_per_leg_J", BRAID.leg_power * DriveConfig().heating)
    seconds = sum(result.seconds for result in results)
    factor = seconds / sum(result.wall for result in results)
    output.measure("real_time_factor", factor)
    output.check("simulated over wall time", factor, "> 1", factor > 1.0)
    output.measure("simulated_s", seconds)
    warnings = sum(result.warnings for result in results)
    output.check("warnings of the physics", warnings, "== 0", warnings == 0)
