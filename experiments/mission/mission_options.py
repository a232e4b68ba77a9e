"""Options of ``mission``."""

import dataclasses
from typing import Annotated, Literal

from controllers.mission.config import OMITTABLE
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.robot_option import check_robot
from twin.optics.realism import RealismName

DEMONSTRATION = 10
"""Seed of the mission of ``--quick``: the first from 1 on whose rovers both begin within 4 m of the
slot, as their initial poses are drawn; chosen before it was run, for it is short."""


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of mission.

    Attributes:
        robot: Robots that are driven: sim, quantised (counts as the boards do), emulated (over the
            boards' own protocols) or both robots' boards, serial:PORT,...,serial:PORT,...
        without: What further missions of the same seeds do without, one at a time: points of the
            map for paths (they are planned as if nothing stood on the ground), occluders (so is the
            camera station chosen), the panel once it was found, the guard against tipping over, or
            cooperation (what the master sees of card and slot).
        loss: Share of the radio's messages that are lost in further missions of the same seeds; 0
            for none.
        realism: How far simulated robots, their sensors and cameras are from their drawings: ideal,
            default or harsh; with any but ideal each seed has robots of its own.
        only: Last stage to run, or all.
    """

    robot: str = "sim"
    without: Annotated[tuple[str, ...], contract.some_of(OMITTABLE)] = ()
    loss: float = 0.0
    realism: RealismName = "default"
    only: Literal["identify", "search", "map", "place", "approach", "all"] = "all"

    def __post_init__(self) -> None:
        """Refuse unknown robots and parts.

        Raises:
            OptionError: Naming it and the known ones.
        """
        super().__post_init__()
        check_robot(self.robot)
        if unknown := set(self.without) - set(OMITTABLE):
            raise OptionError(f"--without {min(unknown)}: expected some of {', '.join(OMITTABLE)}")
        if not 0.0 <= self.loss < 1.0:
            raise OptionError(f"--loss {self.loss}: expected a share of messages, 0 to 1")
        missions = len(self.mission_seeds) * len(self.cells)
        if self.robot.startswith("serial:") and missions > 1:
            raise OptionError("--robot serial: one mission at a time, with --quick")

    @property
    def mission_seeds(self) -> list[int]:
        """Seeds of the missions of each cell."""
        if self.quick and self.seeds is None and self.seed == 0:
            return [DEMONSTRATION]
        return self.job_seeds(40, 1)

    @property
    def cells(self) -> tuple[str, ...]:
        """Kinds of missions: whole ones, ``without_<part>``, and ``with_loss``."""
        lost = ("with_loss",) if self.loss else ()
        return ("", *(f"without_{part}" for part in self.without), *lost)
