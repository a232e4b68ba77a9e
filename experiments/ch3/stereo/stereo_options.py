"""Options of ``ch3-stereo``."""

import dataclasses
from typing import Annotated

import tyro

from experiments.harness import contract
from experiments.harness.contract import OptionError, SimulatedRobot

PARTS = ("noise", "motion", "mapping", "cooperation")


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of stereo mapping.

    Attributes:
        robot: Robots that map: sim, quantised or emulated. The parts noise, motion and cooperation
            need no robot.
        parts: Parts to run (all by default).
        scans: Number of views of each robot (by default 12; with --quick, 3).
    """

    robot: SimulatedRobot = "sim"
    parts: Annotated[tuple[str, ...], contract.some_of(PARTS)] = ()
    scans: Annotated[int | None, tyro.conf.arg(metavar="N")] = None

    def __post_init__(self) -> None:
        """Refuse unknown parts.

        Raises:
            OptionError: Naming the part, or as `contract.Options`.
        """
        super().__post_init__()
        for part in self.parts:
            if part not in PARTS:
                raise OptionError(f"--parts {part}: expected some of {', '.join(PARTS)}")
        contract.check_count("scans", self.scans)
        if self.robot != "sim" and self.parts and "mapping" not in self.parts:
            raise OptionError(f"--robot {self.robot}: add mapping to --parts; the others need none")
        for name in ("record", "log"):
            if getattr(self, name) and self.parts and "mapping" not in self.parts:
                raise OptionError(f"--{name} is of the mapping: add mapping to --parts")
