"""Options of ``ch2-friction``."""

import dataclasses
from typing import ClassVar

from experiments.harness import contract
from twin.optics.realism import RealismName


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of the friction estimation.

    Attributes:
        realism: How far robots and their sensors are from their drawings: ideal, default or harsh;
            with any but ideal each seed has a robot of its own.
    """

    targets: ClassVar[tuple[str, ...]] = ("sim", "quantised", "emulated")
    realism: RealismName = "default"
