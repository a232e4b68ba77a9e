"""Options of ``ch3-swarm``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

SIZES, QUICK_SIZES = (1, 2, 5, 10, 20, 50), (2, 5, 20)
LARGEST = 200


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch3-swarm.

    Attributes:
        robots: Sizes of the swarm (by default 1 2 5 10 20 50; with --quick, 2 5 20).
    """

    robots: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse sizes out of range.

        Raises:
            OptionError: Naming the size.
        """
        super().__post_init__()
        for size in self.robots:
            if not 1 <= size <= LARGEST:
                raise OptionError(f"--robots {size}: expected 1 to {LARGEST}")

    def sizes(self) -> tuple[int, ...]:
        """Return the sizes to run, each once, in order."""
        return tuple(sorted(set(self.robots or (QUICK_SIZES if self.quick else SIZES))))
