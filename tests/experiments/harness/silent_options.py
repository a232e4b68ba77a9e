"""Options of an experiment without sweep and recording."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
    """Options of the silent experiment; none of its own."""
