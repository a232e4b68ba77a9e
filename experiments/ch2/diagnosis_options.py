"""Options of ``ch2-diagnosis``."""

import dataclasses
from typing import ClassVar

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of the diagnosis."""

    targets: ClassVar[tuple[str, ...]] = ("sim", "quantised", "emulated")
