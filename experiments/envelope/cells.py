"""Cells of ``mission-envelope``: axes, their levels, and the knowledge that should matter there.

Insertions begin where missions had left the rovers; what makes a field harder takes whole missions.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from experiments.ch5.insertion_setting import Hardship, InsertionTrial
from experiments.mission.scene import Field
from experiments.mission.trial import MissionTrial
from models.card_and_slot.guides import width_of
from models.datasheets import CARD_GUIDE

MEDIUM = CARD_GUIDE.clearances[1]
PROMISING, LEAST_CELLS = 0.3, 10
"""Loss of success in the screening from which on a cell of insertions is confirmed, and how many
are at least."""
POOR = 0.5
"""Loss from which on a cell of whole missions is."""
_NEAREST = {8.0: 3.0, 10.0: 8.0}  # Nearest initial pose of each farthest one [m].


@dataclasses.dataclass(frozen=True)
class Axis:
    """One way in which an insertion, or a whole mission, becomes harder.

    Attributes:
        title: What varies, with its unit.
        levels: Its values, the last the hardest; the first is the default, which whole missions
            leave out: `mission` runs it.
        knowledge: What is left out there, some of what can be, what should matter most first.
        scale: Value in SI units over a level.
        whole: Whether it takes whole missions.
    """

    title: str
    levels: tuple[float, ...]
    knowledge: tuple[str, ...]
    scale: float = 1.0
    whole: bool = False


AXES: Mapping[str, Axis] = {
    "springs": Axis("slave's springs / drawn", (1.0, 0.5, 0.3, 0.2), ("identification", "force")),
    "left_springs": Axis("its left springs / right", (1.0, 0.3), ("identification", "force")),
    "load": Axis("load on its base [kg]", (0.0, 1.0, 2.0, 4.0), ("identification", "force")),
    "clearance": Axis("clearance [mm]", (0.8, 1.6, 0.4),
                      ("force", "replanning", "placement", "cooperation"), 1e-3),
    "relief": Axis("relief [mm]", (20.0, 40.0, 60.0), ("force", "replanning", "placement"), 1e-3),
    "slope": Axis("slope across [deg]", (0.0, 5.0, 10.0, 15.0), ("force", "identification"),
                  math.radians(1.0)),
    "errors": Axis("sensors' errors / default", (1.0, 2.0, 4.0), ("force", "identification")),
    "head_errors": Axis("heads' errors / default", (1.0, 3.0, 6.0), ("force", "placement")),
    "delay": Axis("delay of vision [s]", (0.0, 0.5, 1.0), ("force", "replanning")),
    "loss": Axis("radio's loss", (0.0, 0.2, 0.5), ("replanning", "force")),
    "clutter": Axis("rocks and blocks / default", (0.0, 2.0), ("paths",), whole=True),
    "friction": Axis("least friction", (0.2,), ("panel",), whole=True),
    "distance": Axis("farthest initial pose [m]", (10.0,), ("paths",), whole=True),
}  # fmt: skip
"""Axes by name: those of insertions but the clearance are fields of `Hardship`, the others of
`Field`."""


@dataclasses.dataclass(frozen=True)
class Cell:
    """Insertions or missions at a level of an axis, whole or without something.

    Attributes:
        axis: Name of the axis.
        level: Level, in the axis' unit.
        without: What is left out; empty for nothing.
    """

    axis: str
    level: float
    without: str = ""

    @property
    def whole(self) -> "Cell":
        """The same level with nothing left out."""
        return dataclasses.replace(self, without="")

    @property
    def is_hardest(self) -> bool:
        """Whether this is the last level of its axis, whole or without what matters most there."""
        axis = AXES[self.axis]
        return self.level == axis.levels[-1] and self.without in ("", axis.knowledge[0])

    @property
    def name(self) -> str:
        """Name of what is left out, as in a metric's key."""
        return f"without_{self.without}" if self.without else "whole"

    def trial(self, seed: int) -> InsertionTrial | MissionTrial:
        """Return the insertion, or the mission, of a seed."""
        axis = AXES[self.axis]
        value: Any = self.level * axis.scale
        if axis.whole:
            if self.axis == "distance":
                value = _NEAREST[self.level], self.level
            return MissionTrial(seed, self.without, hardness=Field(**{self.axis: value}))
        clearance = value if self.axis == "clearance" else MEDIUM
        harder = {} if self.axis == "clearance" else {self.axis: value}
        return InsertionTrial(
            width_of(clearance),
            True,
            seed,
            realism="default",
            guides=True,
            hardship=Hardship(**harder),
            without=self.without,
        )


def cells_of(axes: Sequence[str]) -> Iterator[Cell]:
    """Yield all cells of some axes, each level's whole one first."""
    for name in axes:
        for level in AXES[name].levels:
            yield Cell(name, level)
            yield from (Cell(name, level, what) for what in AXES[name].knowledge)


def chosen(shares: Mapping[Cell, float]) -> list[Cell]:
    """Return the cells that are confirmed: those that lost most in the screening.

    Args:
        shares: Success of each cell in the screening.

    Returns:
        Insertions that lost `PROMISING` or more, and at least `LEAST_CELLS`; missions that lost
        `POOR` or more; in their own order.
    """
    lost = {cell: shares[cell.whole] - share for cell, share in shares.items() if cell.without}
    missions = [cell for cell in lost if AXES[cell.axis].whole]
    insertions = [cell for cell in lost if not AXES[cell.axis].whole]
    ranked = sorted(insertions, key=lambda cell: -lost[cell])
    enough = sum(lost[cell] >= PROMISING - 1e-9 for cell in insertions)
    kept = {*ranked[: max(enough, LEAST_CELLS)]}
    kept |= {cell for cell in missions if lost[cell] >= POOR - 1e-9}
    return [cell for cell in lost if cell in kept]
