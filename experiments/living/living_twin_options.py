"""Options of ``living-twin``."""

import dataclasses
from typing import Annotated

import tyro

from experiments.harness import contract
from experiments.harness.contract import OptionError

PARTS = ("changes", "ahead", "boards", "kills", "missions")


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions):
    """Options of what a twin notices.

    Attributes:
        learning: Time for which each twin only learns its rover [s].
        unchanged: Time for which each rover works to which nothing happens, beside that [s].
        on_boards: Time for which a rover on emulated boards works to which nothing happens, beside
            that and in real time [s].
        kills: How often a program that owns a rover is killed.
        parts: Which parts to run (unless said, all; a quick run has changes and ahead alone).
    """

    learning: Annotated[float, tyro.conf.arg(metavar="S")] = 60.0
    unchanged: Annotated[float, tyro.conf.arg(metavar="S")] = 3600.0
    on_boards: Annotated[float, tyro.conf.arg(metavar="S")] = 7200.0
    kills: Annotated[int, tyro.conf.arg(metavar="N")] = 50
    parts: Annotated[tuple[str, ...], contract.some_of(PARTS)] = ()

    def __post_init__(self) -> None:
        """Refuse times that are none, and unknown parts.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for name in ("learning", "unchanged", "on_boards"):
            if not 0.0 < getattr(self, name) < 1e5:  # noqa: PLR2004
                raise OptionError(
                    f"--{name.replace('_', '-')}: expected above 0 s, got {getattr(self, name):g}"
                )
        if not 0 < self.kills < 1e5:  # noqa: PLR2004
            raise OptionError(f"--kills: expected above 0, got {self.kills}")
        if unknown := set(self.parts) - set(PARTS):
            raise OptionError(f"--parts {min(unknown)}: expected some of {', '.join(PARTS)}")
