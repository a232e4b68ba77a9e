"""Options of ``appe-mechanism``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

SAGGING, QUICK_SAGGING = (1, 2, 3, 4, 5, 6, 7, 8), (1, 3, 5)
"""Stages of the arms that sag; the driven arm may have as many."""


@dataclasses.dataclass(frozen=True)
class Options(contract.SweepOptions, contract.RecordedOptions):
    """Options of appe-mechanism.

    Attributes:
        stages: Number of stages of the arm that is driven through random words.
        words: Number of random words (default 200; with --quick, 16).
        at_once: Number of legs that are heated together (default: all legs of the arm).
    """

    stages: int = 5
    words: int | None = None
    at_once: int | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        if not 1 <= self.stages <= SAGGING[-1]:
            raise OptionError(f"--stages {self.stages}: expected 1 to {SAGGING[-1]}")
        contract.check_count("words", self.words)
        contract.check_count("at-once", self.at_once)

    def group(self) -> int:
        """Return how many legs are heated together."""
        return self.at_once or 3 * self.stages
