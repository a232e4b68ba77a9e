"""Options of ``appa-control``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of appa-control."""
