"""Options of ``log``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the look into a log.

    Attributes:
        path: A CSV, MCAP or rerun file, or the folder of a rosbag2 or of a LeRobot dataset.
        mapping: TOML file that says which field is which actuator or sensor, with unit, sign, delay
            and frame; without it all fields are listed, or the signals of a log of ours.
    """

    path: Annotated[Path, tyro.conf.Positional]
    mapping: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
