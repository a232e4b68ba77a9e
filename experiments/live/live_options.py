"""Options of ``live``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of a twin that runs beside a rover.

    Attributes:
        log: Log of a run of one of our rovers, .mcap, as `--log` of an experiment, of drive and of
            play write it.
        robot: Which of the rovers in the log (unless said, the first).
        learning: Time for which the rover is only learned, before changes are looked for, in s.
        out: Folder of what is written: figures, recording for rerun, live.json.
    """

    log: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    robot: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    learning: Annotated[float, tyro.conf.arg(metavar="S")] = 20.0
    out: Path = Path("results/live")

    def __post_init__(self) -> None:
        """Refuse a time that is none.

        Raises:
            OptionError: Naming the option.
        """
        if not 0.0 < self.learning < 1e6:  # noqa: PLR2004
            raise OptionError(f"--learning: expected above 0 s, got {self.learning:g}")
