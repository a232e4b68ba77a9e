"""Options of ``ch2-friction``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import SimulatedRobot
from twin.optics.realism import RealismName


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of the friction estimation.

    Attributes:
        robot: Robot that is driven: sim, quantised (counts as the boards do) or emulated (over the
            boards' own protocols).
        realism: How far robots and their sensors are from their drawings: ideal, default or harsh;
            with any but ideal each seed has a robot of its own.
    """

    robot: SimulatedRobot = "sim"
    realism: RealismName = "default"
