"""Options of ``appe-workspace``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

MAX_STAGES = 6


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of appe-workspace.

    Attributes:
        stages: Number of the arm's stages.
        extension: Extension of a leg when its actuator is on, in radii.
    """

    stages: int = 5
    extension: float = 0.3

    def __post_init__(self) -> None:
        """Refuse arms that cannot be listed.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        if not 1 <= self.stages <= MAX_STAGES:
            raise OptionError(f"--stages {self.stages}: expected 1 to {MAX_STAGES}")
        if not 0.0 < self.extension <= 0.5:  # noqa: PLR2004
            raise OptionError(f"--extension {self.extension}: expected more than 0, up to 0.5")
