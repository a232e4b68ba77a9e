"""Options of ``live``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError
from experiments.live.drive_options import HandOptions


@dataclasses.dataclass(frozen=True)
class Options(HandOptions):
    """Options of a twin that runs beside a rover.

    Attributes:
        log: Log of a run of our rovers, .mcap, as --log of an experiment, of drive and of play
            write it; instead of --robot.
        follow: Go on as the log is written, until it is complete or Ctrl+C is pressed.
        name: Which of the rovers in the log (unless said, all).
        robot: Rover to own and drive by hand, instead of --log: sim, quantised, emulated, or
            serial:PORT[,NAME=VALUE...]. It is activated on the page alone.
        learning: Time for which the rover is only learned, before changes are looked for [s].
        rough: The ground is uneven, or more slippery here than there: there neither less grip nor a
            tilt or twist is a change, and what is tried out is named where the seconds after that
            tell the same. On even ground, level or not, a soft spring shows by these.
        out: Folder of what is written; of a rover that is owned the history too, with which the
            next run goes on.
        live: Also show the twin's recording in the rerun viewer as it grows: in a window, or
            without a display on a page of this machine.
    """

    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    follow: bool = False
    name: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    robot: Annotated[str, tyro.conf.arg(metavar="TARGET")] = ""
    learning: Annotated[float, tyro.conf.arg(metavar="S")] = 20.0
    rough: bool = False
    out: Path = Path("results/live")
    live: bool = False

    def __post_init__(self) -> None:
        """Refuse what does not go together.

        Raises:
            OptionError: Naming the option.
        """
        if (self.log is None) == (not self.robot):
            raise OptionError("--log, --robot: expected one of them")
        if not 0.0 < self.learning < 1e6:  # noqa: PLR2004
            raise OptionError(f"--learning: expected above 0 s, got {self.learning:g}")
        if self.robot:
            super().__post_init__()
        for given, name in ((self.follow, "follow"), (self.name, "name")):
            if given and self.log is None:
                raise OptionError(f"--{name}: goes with --log only")
