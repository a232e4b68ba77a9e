"""Options of ``mission-envelope``."""

import dataclasses
from typing import Annotated

from experiments.envelope.axes import AXES
from experiments.harness import contract
from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of mission-envelope.

    Attributes:
        axes: Axes to run (unless said, all).
    """

    axes: Annotated[tuple[str, ...], contract.some_of(AXES)] = ()

    def __post_init__(self) -> None:
        """Refuse unknown axes.

        Raises:
            OptionError: Naming it and the known ones.
        """
        super().__post_init__()
        if unknown := set(self.axes) - set(AXES):
            raise OptionError(f"--axes {min(unknown)}: expected some of {', '.join(AXES)}")

    @property
    def chosen_axes(self) -> tuple[str, ...]:
        """Names of the axes to run."""
        return self.axes or (("clearance",) if self.quick else tuple(AXES))
