"""Options of ``appc-compression``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError

VIEWS, QUICK_VIEWS = 16, 6
KNOWN, QUICK_KNOWN = (1, 2, 4, 6), (1, 3)
"""Views in the map when the others are rated."""


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of appc-compression.

    Attributes:
        views: Number of views taken in each scene (default 16; with --quick, 6).
    """

    views: int | None = None

    def __post_init__(self) -> None:
        """Refuse too few views to choose among.

        Raises:
            OptionError: Naming the number.
        """
        super().__post_init__()
        if self.views is not None and self.count() < max(self.known()) + 2:
            raise OptionError(f"--views {self.views}: expected at least {max(self.known()) + 2}")

    def count(self) -> int:
        """Return how many views are taken in a scene."""
        return self.views if self.views is not None else QUICK_VIEWS if self.quick else VIEWS

    def known(self) -> tuple[int, ...]:
        """Return after how many views the others are rated."""
        return QUICK_KNOWN if self.quick else KNOWN
