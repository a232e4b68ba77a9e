"""Options of ``ch2-diagnosis``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import SimulatedRobot


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of the diagnosis.

    Attributes:
        robot: Robot that is driven: sim, quantised (counts as the boards do) or emulated (over the
            boards' own protocols).
    """

    robot: SimulatedRobot = "sim"
