"""Options of ``doctor``."""

import dataclasses
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError
from experiments.harness.robot_option import wiring_of


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the doctor.

    Attributes:
        robot: Robot to examine too, before it moves: serial:PORT[,NAME=VALUE...], or emulated.
        patience: Longest wait for a person at the e-stop [s].
    """

    robot: Annotated[str | None, tyro.conf.arg(metavar="TARGET")] = None
    patience: float = 30.0

    def __post_init__(self) -> None:
        """Refuse a wait that is none, and robots without boards.

        Raises:
            OptionError: Naming the option.
        """
        if not 0.0 < self.patience <= 3600.0:
            raise OptionError(f"--patience: expected 0 to 3600 s, got {self.patience}")
        if self.robot not in (None, "emulated"):
            wiring_of(self.robot, ("emulated", "serial"))
