"""Cells of ``mission-envelope``, and which of them are confirmed."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from experiments.ch5.insertion_setting import Hardship, InsertionTrial
from experiments.envelope.axes import AXES
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
