"""Options of ``appd-radio``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of the radio experiment.

    Attributes:
        delay: Delay of the modems, one way [s]; the framed link's advantage grows with it.
    """

    delay: float = 0.005

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: If the delay is out of range or the robot unknown.
        """
        super().__post_init__()
        if not 0.0 <= self.delay <= 0.05:
            raise OptionError(f"--delay: expected 0 to 0.05 s, got {self.delay}")
