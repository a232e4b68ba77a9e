"""Options of ``ch5-contact``."""

import dataclasses

from experiments.harness import contract
from twin.optics.realism import RealismName


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch5-contact.

    Attributes:
        realism: How far the hand and its sensor are from their drawings: ideal, default or harsh;
            with any but ideal each seed has a hand of its own.
    """

    realism: RealismName = "default"
