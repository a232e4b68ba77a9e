"""Options of ``appe-placement``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

MOST_STAGES = 5


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of appe-placement.

    Attributes:
        stages: Number of BRAID's stages. --seeds sets the number of settings.
    """

    stages: int = MOST_STAGES

    def __post_init__(self) -> None:
        """Refuse what cannot be listed.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        if not 1 <= self.stages <= MOST_STAGES:
            raise OptionError(f"--stages {self.stages}: expected 1 to {MOST_STAGES}")
