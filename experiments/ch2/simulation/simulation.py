"""Table 2-1 and figures 2-4 to 2-7: the simplified rover identifies itself by swinging its arm.

Each trial swings the arm for 10 s in each of three rotations, every sample with 10 % noise, and
estimates the 22 parameters in three ways. Every excitation is run on the same noise seeds, so
that differences between excitations are paired.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence

import numpy as np

from experiments.ch2.simulation.figures import draw_figures
from experiments.ch2.simulation.record import record_trial
from experiments.ch2.simulation.results import (
    Results,
    judge,
    measure,
    measure_times,
    shown_group,
    tabulate,
)
from experiments.ch2.simulation.simulation_options import Options
from experiments.ch2.simulation.trial import PlantIdentification, PlantTrial, run_trial
from experiments.ch2.simulation.truths import (
    TABLE_TRUTH,
    Truth,
    load_truth,
    random_truth,
)
from experiments.ch2.simulation.verification import verify
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

FULL_SEEDS, QUICK_SEEDS = 50, 3
WARM_UP = 0.8
TIMED = 1
"""How many trials are repeated alone for their time."""
SHOWN_RATE = 5
"""Every how many samples of the arm's angle are kept for the figures."""


@functools.lru_cache(maxsize=1)
def warm_up() -> None:
    """Load the compiled code, so that no trial's first step is timed with it."""
    run_trial(PlantTrial(TABLE_TRUTH, "information", "relative", 0, WARM_UP))


def identify(trial: PlantTrial) -> PlantIdentification:
    """Run one trial and keep what the tables and figures need."""
    warm_up()
    result = run_trial(trial)
    return dataclasses.replace(result, arm_angles=result.arm_angles[:, ::SHOWN_RATE])


def truths_of(options: Options) -> list[Truth]:
    """Return the true parameter sets to run on.

    Args:
        options: Options of the experiment.

    Raises:
        OptionError: If the truth file is bad.
    """
    if options.truth is not None:
        return [load_truth(options.truth)]
    if options.random_truth is None:
        return [TABLE_TRUTH]
    children = np.random.SeedSequence([options.seed, 22]).spawn(options.random_truth)
    return [random_truth(np.random.default_rng(child)) for child in children]


def trials(options: Options) -> list[PlantTrial]:
    """Return all trials; those of one truth and seed share their noise over the excitations."""
    count = len(options.job_seeds(FULL_SEEDS, QUICK_SEEDS))
    if options.random_truth is not None:
        count = options.seeds or 1
    repeated = [truth for truth in truths_of(options) for _ in range(count)]
    # Each truth has noise of its own: shared, its chance would do the same to all.
    seeds = dataclasses.replace(options, seeds=len(repeated)).job_seeds(FULL_SEEDS, QUICK_SEEDS)
    cases = list(zip(repeated, seeds, strict=True))
    return [
        PlantTrial(truth, excitation, noise, seed, starts=options.starts)
        for (truth, seed), noise, excitation in itertools.product(
            cases, options.chosen_noises(), options.chosen_excitations()
        )
    ]


def timed(jobs: Sequence[PlantTrial], group: tuple[str, str]) -> list[PlantIdentification]:
    """Repeat the first trials of a group alone: in a sweep they share the machine."""
    chosen = [trial for trial in jobs if (trial.noise, trial.excitation) == group]
    warm_up()
    return [run_trial(trial) for trial in chosen[:TIMED]]


def grouped(jobs: Sequence[PlantTrial], finished: Sequence[PlantIdentification]) -> Results:
    """Return the results by noise and excitation, each list in the order of truths and seeds."""
    groups: Results = {}
    for trial, result in zip(jobs, finished, strict=True):
        groups.setdefault((trial.noise, trial.excitation), []).append(result)
    return groups


def run(options: Options, output: Output) -> None:
    """Run the study.

    Args:
        options: Options of the experiment.
        output: Output that receives metrics, checks, tables and figures.
    """
    jobs = trials(options)
    groups = grouped(jobs, sweep(identify, jobs, options, output, label="identifications"))
    own = options.truth is None and options.random_truth is None
    measure(groups, output, of_table=own)
    measure_times(timed(jobs, shown_group(groups)), output)
    judge(groups, output, of_table=own)
    verify(options, output)
    tabulate(groups, output, of_table=own)
    draw_figures(groups, output)
    if options.record:
        shown = shown_group(groups)
        record_trial(groups[shown][0], output.file("run.rrd"))
