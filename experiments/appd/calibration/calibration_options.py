"""Options of ``appd-calibration``."""

import dataclasses

from experiments.harness import contract


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of the calibration of the inclinometers."""
