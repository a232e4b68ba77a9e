"""Table 2-1 and figures 2-4 to 2-7: the simplified rover identifies itself by swinging its arm.

Each trial swings the arm for 10 s in each of three rotations, every sample with 10 % noise, and
estimates the 22 parameters in three ways. Every excitation is run on the same noise seeds, so
that differences between excitations are paired.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from controllers.identification.identifier import EXCITATIONS
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
from experiments.ch2.simulation.trial import PlantIdentification, PlantTrial, run_trial
from experiments.ch2.simulation.truths import (
    TABLE_TRUTH,
    Truth,
    load_truth,
    random_truth,
)
from experiments.ch2.simulation.verification import verify
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from experiments.harness.sweep import sweep

FULL_SEEDS, QUICK_SEEDS = 50, 3
QUICK_EXCITATIONS = ("constant", "information")
NOISES = ("fixed", "relative")
WARM_UP = 0.8
TIMED = 1
"""How many trials are repeated alone for their time."""
SHOWN_RATE = 5
"""Every how many samples of the arm's angle are kept for the figures."""


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of ch2-simulation.

    Attributes:
        truth: JSON or TOML file with the 22 true parameters (unless given, Table 2-1's).
        random_truth: Run on this many random plausible parameter sets instead, each with
            --seeds repetitions (1 unless said).
        excitations: Which to compare (unless said, all; with --quick, constant and information).
        noise: Range that the 10 % are taken of: "fixed", the run under the constant excitation;
            "relative", each run's own maximum so far; or "both" (with --quick, fixed).
        starts: Seek each final fit again from the truth and this many draws from the prior, and
            count the fits that missed a better one. Each takes a few seconds.
    """

    truth: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    random_truth: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    excitations: tuple[str, ...] = ()
    noise: Literal["fixed", "relative", "both"] | None = None
    starts: Annotated[int, tyro.conf.arg(metavar="N")] = 0

    def __post_init__(self) -> None:
        """Refuse unknown excitations and contradictions.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for name in self.excitations:
            if name not in EXCITATIONS:
                raise OptionError(f"--excitations {name}: expected {', '.join(EXCITATIONS)}")
        if self.random_truth is not None and self.random_truth < 1:
            raise OptionError(f"--random-truth: expected at least 1, got {self.random_truth}")
        if self.starts < 0:
            raise OptionError(f"--starts: expected at least 0, got {self.starts}")
        if self.random_truth is not None and self.truth is not None:
            raise OptionError("--truth, --random-truth: give one of them")

    def chosen_excitations(self) -> tuple[str, ...]:
        """Return the excitations to run, each once."""
        default = QUICK_EXCITATIONS if self.quick else EXCITATIONS
        return tuple(dict.fromkeys(self.excitations or default))

    def chosen_noises(self) -> tuple[str, ...]:
        """Return the noises to run."""
        noise = self.noise or ("fixed" if self.quick else "both")
        return NOISES if noise == "both" else (noise,)

    def truths(self) -> list[Truth]:
        """Return the true parameter sets to run on.

        Raises:
            OptionError: If the truth file is bad.
        """
        if self.truth is not None:
            return [load_truth(self.truth)]
        if self.random_truth is None:
            return [TABLE_TRUTH]
        children = np.random.SeedSequence([self.seed, 22]).spawn(self.random_truth)
        return [random_truth(np.random.default_rng(child)) for child in children]


@functools.lru_cache(maxsize=1)
def warm_up() -> None:
    """Load the compiled code, so that no trial's first step is timed with it."""
    run_trial(PlantTrial(TABLE_TRUTH, "information", "relative", 0, WARM_UP))


def identify(trial: PlantTrial) -> PlantIdentification:
    """Run one trial and keep what the tables and figures need."""
    warm_up()
    result = run_trial(trial)
    return dataclasses.replace(result, arm_angles=result.arm_angles[:, ::SHOWN_RATE])


def trials(options: Options) -> list[PlantTrial]:
    """Return all trials; those of one truth and seed share their noise over the excitations."""
    count = len(options.job_seeds(FULL_SEEDS, QUICK_SEEDS))
    if options.random_truth is not None:
        count = options.seeds or 1
    repeated = [truth for truth in options.truths() for _ in range(count)]
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
