"""Options of ``appd-boards``."""

import dataclasses
from typing import Annotated

from experiments.harness import contract
from experiments.harness.contract import OptionError

PARTS = ("trials", "matrix", "soak")


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of the boards' experiment; ``--seeds`` is the number of emulated rovers.

    Attributes:
        parts: Parts to run: trials (faults while time stands still between ticks, damaged lines,
            the pace on the wall clock), matrix (every fault in every state on boards with their own
            clock; 40 minutes on two cores), soak (four hours of the robot's time with faults; up to
            two hours on two slow cores).
    """

    parts: Annotated[tuple[str, ...], contract.some_of(PARTS)] = ("trials",)

    def __post_init__(self) -> None:
        """Refuse unknown parts.

        Raises:
            OptionError: Naming the part.
        """
        for part in self.parts:
            if part not in PARTS:
                raise OptionError(f"--parts {part}: expected some of {', '.join(PARTS)}")
        super().__post_init__()
