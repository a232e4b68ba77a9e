"""Options of ``ch4-stereo``."""

import dataclasses

from experiments.harness import contract
from experiments.harness.contract import OptionError
from models.work_piece import HOLES


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.RecordedOptions):
    """Options of ch4-stereo.

    Attributes:
        scenes: Random scenes in which the searches are compared (200 by default; with --quick,
            24). --seeds sets the number of rendered arrangements.
        blocks: Blocks of a rendered arrangement.
        target: The hole to watch in the scene of figure 4-12: hole0, hole1 or hole2.
    """

    scenes: int | None = None
    blocks: int = 8
    target: str = "hole0"

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        contract.check_count("scenes", self.scenes)
        if not 1 <= self.blocks <= 12:  # noqa: PLR2004
            raise OptionError(f"--blocks {self.blocks}: expected 1 to 12")
        names = [f"hole{index}" for index in range(len(HOLES))]
        if self.target not in names:
            raise OptionError(f"--target {self.target}: the work-piece has {', '.join(names)}")
