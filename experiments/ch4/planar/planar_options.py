"""Options of ``ch4-planar``."""

import dataclasses

import numpy as np

from experiments.harness import contract
from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch4-planar.

    Attributes:
        rings: Number of distances of candidate camera poses.
        directions: Number of directions of candidate camera poses about a target.
        factor: Least rating of a new view over the present one for which the camera moves.
    """

    rings: int = 64
    directions: int = 1024
    factor: float = 1.2

    def __post_init__(self) -> None:
        """Refuse what cannot be searched or would chatter.

        Raises:
            OptionError: Naming the option.
        """
        # Imported here, for it is slow to import (numba), and help does without it.
        from controllers.placement.planar.search import RingCandidates  # noqa: PLC0415

        super().__post_init__()
        try:
            RingCandidates(self.rings, self.directions)
        except ValueError as error:
            raise OptionError(f"--rings, --directions: {error}") from None
        if not (np.isfinite(self.factor) and self.factor >= 1.0):
            raise OptionError(f"--factor {self.factor}: expected 1 or more")
