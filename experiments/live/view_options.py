"""Options of ``view``."""

import dataclasses
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the view.

    Attributes:
        subject: rover, mission (its field and rovers), braid, or a file that MuJoCo reads.
        browser: Show a page in the browser even where there is a display.
        port: Port of the page on this machine; 0 for a free one.
        seed: Seed of the field of the mission.
    """

    subject: Annotated[str, tyro.conf.Positional] = "rover"
    browser: bool = False
    port: int = 0
    seed: int = 10

    def __post_init__(self) -> None:
        """Refuse ports that are none.

        Raises:
            OptionError: Naming the option.
        """
        if not 0 <= self.port < 1 << 16:
            raise OptionError(f"--port: expected 0 to 65535, got {self.port}")
