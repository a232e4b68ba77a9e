"""Options of ``living-twin``."""

import dataclasses
from typing import Annotated

import tyro

from experiments.harness import contract
from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of what a twin notices.

    Attributes:
        learning: Time for which each twin only learns its rover [s].
        unchanged: Time for which each rover works to which nothing happens, beside that [s].
    """

    learning: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0
    unchanged: Annotated[float, tyro.conf.arg(metavar="S")] = 240.0

    def __post_init__(self) -> None:
        """Refuse times that are none.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for name in ("learning", "unchanged"):
            if not 0.0 < getattr(self, name) < 1e5:  # noqa: PLR2004
                raise OptionError(f"--{name}: expected above 0 s, got {getattr(self, name):g}")
