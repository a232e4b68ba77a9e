"""Options of ``appe-inverse``."""

import dataclasses

from experiments.harness import contract

TARGETS, QUICK_TARGETS = 1000, 20


@dataclasses.dataclass(frozen=True)
class Options(contract.SweepOptions):
    """Options of appe-inverse.

    Attributes:
        targets: Number for each kind and number of stages (default 1000; with --quick, 20).
    """

    targets: int | None = None

    def __post_init__(self) -> None:
        """Refuse no targets.

        Raises:
            OptionError: If there are none.
        """
        super().__post_init__()
        contract.check_count("targets", self.targets)

    def count(self) -> int:
        """Return the number of targets of each kind."""
        return self.targets or (QUICK_TARGETS if self.quick else TARGETS)
