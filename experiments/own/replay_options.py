"""Options of ``replay``."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from experiments.harness.contract import OptionError
from experiments.own.identify_options import STEP


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of a replay.

    Attributes:
        log: A run: a CSV, MCAP or rerun file, or the folder of a rosbag2 or of LeRobot. One that
            `drive --log` wrote of simulated or emulated robots says itself how to simulate it.
        model: Model that the commands drive (MJCF or URDF), such as one of `identify`; needed for
            a log that does not say.
        mapping: TOML file that says which field of the log is which actuator or sensor of the
            model; without it the signals of a log of ours bear its names.
        start: With a model, the run begins at rest under its first commands, or held where joints
            were measured, or moving: then it is sought how.
        step: With a model, longest time step of the simulation, in seconds.
        out: Folder of what is written: figure, table, recording for rerun, replay.json.
    """

    log: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    model: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    start: Literal["rest", "held", "moving"] = "rest"
    step: float = STEP
    out: Path = Path("results/replay")

    def __post_init__(self) -> None:
        """Refuse what does nothing.

        Raises:
            OptionError: If a mapping comes without a model, or the step is none.
        """
        if self.mapping is not None and self.model is None:
            raise OptionError("--mapping: used with --model only")
        if not 0.0 < self.step < 1.0:
            raise OptionError(f"--step: expected above 0 to 1 s, got {self.step:g}")
