"""Options of ``excite``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError, check_count


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the design of a motion.

    Attributes:
        model: The robot as known so far, MJCF or URDF: as drawn, or model.xml of `identify`.
        parameters: What is to be identified, as `identify` takes it.
        known: identified.json of runs before: the motion is designed for the robot as they found
            it, and for what they left unknown.
        out: File of the motion: .csv or .mcap, with a column or topic for each actuator.
        limits: TOML file with limits beyond the ranges that the model states.
        duration: Duration of the motion, in seconds.
        highest: Highest frequency of the motion, in hertz.
        rate: Samples a second that the robot will log, in hertz.
        period: Time between two commands, in seconds.
        home: Command of each actuator at rest (those of the model's first key frame, else 0).
        generations: Generations of the search, of twelve motions each.
        seed: Seed of the search.
    """

    model: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    parameters: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME[:SPREAD] ...")]
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    known: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    limits: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    duration: float = 10.0
    highest: float = 2.0
    rate: float = 100.0
    period: float = 0.002
    home: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X ...")] = ()
    generations: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what is no motion.

        Raises:
            OptionError: Naming the option and what is expected.
        """
        check_count("generations", self.generations)
        for name, low in (("duration", 3.0), ("highest", 0.0), ("rate", 0.0), ("period", 0.0)):
            if not getattr(self, name) > low:
                raise OptionError(f"--{name}: expected above {low:g}, got {getattr(self, name):g}")
        if self.seed < 0:
            raise OptionError(f"--seed: expected 0 or more, got {self.seed}")
        if self.out.suffix not in (".csv", ".mcap"):
            raise OptionError(f"--out {self.out}: expected a file .csv or .mcap")
