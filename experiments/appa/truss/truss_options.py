"""Options of ``appa-truss``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of appa-truss."""
