"""Options of ``ch5-insertion``."""

import dataclasses
from typing import Annotated

from experiments.harness import contract
from experiments.harness.contract import OptionError
from perception.markers.detector_names import DETECTOR_NAMES
from twin.optics.realism import RealismName

PARTS = ("table", "impossible", "noise", "faults", "guides")


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of ch5-insertion.

    Attributes:
        detector: Marker detector: blob, or tht for the thesis' own.
        realism: How far robots, their sensors and cameras are from their drawings: ideal, default
            or harsh; with any but ideal each seed has robots of its own.
        parts: Which parts to run (unless said, all).
    """

    detector: str = "blob"
    realism: RealismName = "default"
    parts: Annotated[tuple[str, ...], contract.some_of(PARTS)] = ()

    def __post_init__(self) -> None:
        """Refuse unknown detectors and parts.

        Raises:
            OptionError: Naming it and the known ones.
        """
        super().__post_init__()
        if self.detector not in DETECTOR_NAMES:
            raise OptionError(
                f"--detector {self.detector}: expected one of {', '.join(sorted(DETECTOR_NAMES))}"
            )
        if unknown := set(self.parts) - set(PARTS):
            raise OptionError(f"--parts {min(unknown)}: expected some of {', '.join(PARTS)}")
