"""Options of ``appe-bus``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of the bus experiment; none of its own."""
