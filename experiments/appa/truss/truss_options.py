"""Options of ``appa-truss``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of appa-truss."""
