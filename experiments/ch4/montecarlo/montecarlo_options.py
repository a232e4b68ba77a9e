"""Options of ``ch4-montecarlo``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch4-montecarlo; ``--seeds`` is the number of tests a cell of the table."""
