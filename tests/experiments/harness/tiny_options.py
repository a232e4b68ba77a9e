"""Options of the tiny experiment."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of the tiny experiment.

    Attributes:
        mass: Payload [kg].
        fault: Kind of failure to provoke.
        sweep: Number of jobs of a tenth of a second.
    """

    mass: float = 1.0
    fault: str = ""
    sweep: int = 0

    def __post_init__(self):
        super().__post_init__()
        if self.mass <= 0:
            raise OptionError(f"--mass: {self.mass} kg is not positive")
