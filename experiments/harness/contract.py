"""What every experiment shares: its options and its errors."""

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import tyro


class ExperimentError(RuntimeError):
    """The experiment cannot continue; reported in one line, exit status 1."""


class OptionError(ValueError):
    """An option, or a file that an option names, is bad; reported in one line, exit status 2."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of every experiment; an experiment extends them with its own.

    Attributes:
        quick: A smaller, honest run (less than a minute on two cores).
        seeds: Number of random repetitions (unless said, the experiment's own number).
        jobs: Number of processes that share a sweep (unless said, one for each core).
        seed: Root of all randomness; the same seed gives the same run.
        out: Folder of results; this experiment writes to OUT/NAME/.
        record: Also write a recording for the rerun viewer, OUT/NAME/run.rrd.
        live: As --record, and show the recording in the rerun viewer as it grows: in a window, or
            without a display on a page of this machine until Ctrl+C.
        resume: Keep the finished jobs of an interrupted sweep; the code must be the same.
        backend: Workers of a sweep: local processes (loky) or a Dask cluster (dask).
        scheduler: Address of the Dask scheduler, for instance tcp://10.0.0.1:8786.
    """

    quick: bool = False
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    seed: int = 0
    out: Path = Path("results")
    record: bool = False
    live: bool = False
    resume: bool = False
    backend: Literal["loky", "dask"] = "loky"
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None

    def __post_init__(self) -> None:
        """Refuse what no experiment could run with.

        An experiment with rules of its own calls this from its own ``__post_init__``.

        Raises:
            OptionError: If a number is out of range or the scheduler does not suit the backend.
        """
        for name in ("seeds", "jobs"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise OptionError(f"--{name}: expected at least 1, got {value}")
        if self.seed < 0:
            raise OptionError(f"--seed: expected 0 or more, got {self.seed}")
        if (self.backend == "dask") != (self.scheduler is not None):
            raise OptionError("--scheduler: needed with --backend dask, and only used with it")

    def job_seeds(self, full: int, quick: int) -> list[int]:
        """Return one seed for each repetition, all derived from ``seed``.

        More repetitions extend the list and leave its beginning as it was.

        Args:
            full: Number of repetitions unless given by ``--seeds``.
            quick: Number of repetitions with ``--quick``.
        """
        count = self.seeds if self.seeds is not None else (quick if self.quick else full)
        return [int(word) for word in np.random.SeedSequence(self.seed).generate_state(count)]


@dataclasses.dataclass(frozen=True)
class SimulatedOptions(Options):
    """Options of an experiment that sets or scores by what only a simulation knows.

    Attributes:
        targets: Robots on which the experiment runs.
        robot: Which robot: sim or, where boards serve as well, quantised or emulated.
    """

    targets: ClassVar[tuple[str, ...]] = ("sim",)
    robot: str = "sim"

    def __post_init__(self) -> None:
        """Refuse robots whose payload, ground or tilt could not be set.

        Raises:
            OptionError: If the robot is not simulated, or as `Options`.
        """
        super().__post_init__()
        if self.robot not in self.targets:
            raise OptionError(
                f"--robot {self.robot}: what this experiment sets is known of simulated robots "
                f"only; available: {', '.join(self.targets)}"
            )
