"""Options of ``appe-inverse``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

TARGETS, QUICK_TARGETS = 1000, 20


@dataclasses.dataclass(frozen=True)
class Options(contract.Options):
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
        if self.targets is not None and self.targets < 1:
            raise OptionError(f"--targets {self.targets}: expected at least 1")

    def count(self) -> int:
        """Return the number of targets of each kind."""
        return self.targets or (QUICK_TARGETS if self.quick else TARGETS)
