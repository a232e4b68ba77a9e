"""What every experiment shares: its options and its errors."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

SimulatedRobot = Literal["sim", "quantised", "emulated"]
"""Robots of which a simulation knows the truth: as it is, or seen through boards."""


class ExperimentError(RuntimeError):
    """The experiment cannot continue; reported in one line, exit status 1."""


class OptionError(ValueError):
    """An option, or a file that an option names, is bad; reported in one line, exit status 2."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of every experiment; an experiment extends them, or those below, with its own.

    Attributes:
        quick: A smaller, honest run (less than a minute on two cores).
        seed: Root of all randomness; the same seed gives the same run.
        out: Folder of results; this experiment writes to OUT/NAME/.
        format: Also write figures as svg or pdf, for papers.
    """

    quick: bool = False
    seed: int = 0
    out: Path = Path("results")
    format: Literal["png", "svg", "pdf"] = "png"

    def __post_init__(self) -> None:
        """Refuse what no experiment could run with.

        An experiment with rules of its own calls this from its own ``__post_init__``.

        Raises:
            OptionError: If the seed is negative.
        """
        if self.seed < 0:
            raise OptionError(f"--seed: expected 0 or more, got {self.seed}")


@dataclasses.dataclass(frozen=True)
class RecordedOptions(Options):
    """Options of an experiment that can be recorded.

    Attributes:
        record: Also write a recording for the rerun viewer, OUT/NAME/run.rrd.
        live: As --record, and show the recording in the rerun viewer as it grows: in a window, or
            without a display on a page of this machine until Ctrl+C.
    """

    record: bool = False
    live: bool = False


@dataclasses.dataclass(frozen=True)
class LoggedOptions(RecordedOptions):
    """Options of an experiment of which a run of robots can be recorded and logged.

    Attributes:
        log: Also write what is measured and applied in the run that is recorded, OUT/NAME/run.mcap:
            for the commands log, replay and identify, and for other tools.
    """

    log: bool = False


@dataclasses.dataclass(frozen=True)
class SweepOptions(Options):
    """Options of an experiment whose jobs several processes share.

    Attributes:
        jobs: Number of processes (unless said, one for each core).
        resume: Keep the finished jobs of an interrupted run; the code must be the same.
        backend: Local processes (loky) or a Dask cluster (dask).
        scheduler: Address of the Dask scheduler, for instance tcp://10.0.0.1:8786.
    """

    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    resume: bool = False
    backend: Literal["loky", "dask"] = "loky"
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None

    def __post_init__(self) -> None:
        """Refuse what no sweep could run with.

        Raises:
            OptionError: If there are no processes, or the scheduler does not suit the backend.
        """
        super().__post_init__()
        check_count("jobs", self.jobs)
        if (self.backend == "dask") != (self.scheduler is not None):
            raise OptionError("--scheduler: needed with --backend dask, and only used with it")


@dataclasses.dataclass(frozen=True)
class RepeatedOptions(SweepOptions):
    """Options of an experiment that is repeated with several seeds.

    Attributes:
        seeds: Number of repetitions, each with a seed of its own (unless said, as many as the
            published figures have).
    """

    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None

    def __post_init__(self) -> None:
        """Refuse no repetition.

        Raises:
            OptionError: If there is none, or as `SweepOptions`.
        """
        super().__post_init__()
        check_count("seeds", self.seeds)

    def job_seeds(self, full: int, quick: int) -> list[int]:
        """Return one seed for each repetition, all derived from ``seed``.

        More repetitions extend the list and leave its beginning as it was.

        Args:
            full: Number of repetitions unless given by ``--seeds``.
            quick: Number of repetitions with ``--quick``.
        """
        count = self.seeds if self.seeds is not None else (quick if self.quick else full)
        return [int(word) for word in np.random.SeedSequence(self.seed).generate_state(count)]


def some_of(names: Iterable[str]) -> Any:
    """Return how the help shows an option that takes some of these names.

    Args:
        names: All that there are.
    """
    return tyro.conf.arg(metavar=f"{{{','.join(names)}}} ...")


def check_new(name: str, path: Path, suffix: str) -> None:
    """Refuse a file to write that has another suffix, is there already, or has no folder.

    Args:
        name: Name of the option, without dashes.
        path: Its value.
        suffix: How the name has to end.

    Raises:
        OptionError: Naming the option.
    """
    option = f"--{name} {path}"
    if path.suffix != suffix:
        raise OptionError(f"{option}: expected a name that ends with {suffix}")
    if path.exists():
        raise OptionError(f"{option}: is there already; name another file")
    if not path.parent.is_dir():
        raise OptionError(f"{option}: there is no folder {path.parent}")


def check_count(name: str, value: int | None) -> None:
    """Refuse a number of things that is below 1.

    Args:
        name: Name of the option, without dashes.
        value: Its value, None where it is not given.

    Raises:
        OptionError: Naming the option.
    """
    if value is not None and value < 1:
        raise OptionError(f"--{name}: expected at least 1, got {value}")
