"""Options of ``ch2-payload``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError, SimulatedRobot
from twin.optics.realism import RealismName


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of the payload identification.

    Attributes:
        robot: Robot that is driven: sim, quantised (counts as the boards do) or emulated (over the
            boards' own protocols).
        duration: Time for which the arm swings, with the box and, if made, before without [s].
        realism: How far robots and their sensors are from their drawings: ideal, default or harsh;
            with any but ideal each seed has a robot of its own, which swings empty first.
    """

    robot: SimulatedRobot = "sim"
    duration: float = 30.0
    realism: RealismName = "default"

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: If the robot is unknown or the swing too short.
        """
        super().__post_init__()
        if not 3.0 <= self.duration <= 600.0:
            raise OptionError(f"--duration: expected 3 to 600 s, got {self.duration}")
