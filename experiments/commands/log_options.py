"""Options of ``log``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the look into a log.

    Attributes:
        path: A CSV, MCAP or rerun file, or the folder of a rosbag2 or of a LeRobot dataset.
        mapping: TOML file that says which field is which actuator or sensor, with unit, sign, delay
            and frame; without it all fields are listed, or the signals of a log of ours.
        write: Also write its signals: as a file .mcap, which needs no mapping, or as the folder of
            a LeRobot dataset.
        rate: Frames a second of a LeRobot dataset, in hertz.
        mend: First complete the file .mcap, whose writer was ended: what was not written to its end
            is cut off.
    """

    path: Annotated[Path, tyro.conf.Positional]
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    write: Annotated[Path | None, tyro.conf.arg(metavar="PATH")] = None
    rate: Annotated[int | None, tyro.conf.arg(metavar="HZ")] = None
    mend: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be written.

        Raises:
            OptionError: If it is there already or has no folder, or the rate suits it not.
        """
        if self.write is not None:
            if self.write.exists():
                raise OptionError(f"--write {self.write}: there already; choose another name")
            if not self.write.absolute().parent.is_dir():
                raise OptionError(f"--write {self.write}: there is no folder {self.write.parent}")
        lerobot = self.write is not None and self.write.suffix != ".mcap"
        if lerobot != (self.rate is not None):
            raise OptionError("--rate: needed to write a LeRobot dataset, and only used with it")
        if self.rate is not None and self.rate < 1:
            raise OptionError(f"--rate: expected 1 Hz or more, got {self.rate}")
        if self.mend and self.path.suffix != ".mcap":
            raise OptionError(f"--mend: of a file .mcap only, got {self.path}")
