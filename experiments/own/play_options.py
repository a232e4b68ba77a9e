"""Options of ``play``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError, check_new
from experiments.harness.robot_option import check_one_rover
from twin.optics.realism import RealismName

RISK = 0.05
"""Largest probability to tip over, or to touch the ground, unless said otherwise."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of a motion that a rover plays.

    Attributes:
        motion: The motion, .csv or .mcap: a column or topic for each joint of the arm, in radians,
            by its name, with or without that of the rover (rover1/elbow); a table has a column t,
            in seconds.
        log: File of the log that is written, as run.mcap; it must be new.
        robot: Which rover: sim, quantised, emulated, or serial:PORT[,NAME=VALUE...] for real
            boards, as serial:/dev/ttyUSB0,analogue=/dev/ttyACM0,home=0:0.9:-1.4:0.1.
        approach: Speed of the fastest joint on the way to the motion's start, in rad/s.
        realism: How far a simulated rover and its sensors are from their drawings: ideal, default
            or harsh (unless said, ideal).
        seed: Seed of a simulated rover as made and of its sensors (unless said, 0).
        risk: Largest probability to tip the rover over, or to touch the ground, at which it is
            played; 1 for any.
    """

    motion: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    log: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    robot: str = "sim"
    approach: Annotated[float, tyro.conf.arg(metavar="RAD/S")] = 0.5
    realism: RealismName | None = None
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None
    risk: Annotated[float, tyro.conf.arg(metavar="P")] = RISK

    def __post_init__(self) -> None:
        """Refuse robots that cannot play it, and what they have no use for.

        Raises:
            OptionError: Naming the option.
        """
        check_one_rover(self.robot, realism=self.realism, seed=self.seed)
        if self.seed is not None and self.seed < 0:
            raise OptionError(f"--seed: expected 0 or more, got {self.seed}")
        if not self.approach > 0.0:
            raise OptionError(f"--approach: expected above 0 rad/s, got {self.approach:g}")
        if not 0.0 <= self.risk <= 1.0:
            raise OptionError(f"--risk: expected 0 to 1, got {self.risk:g}")
        check_new("log", self.log, ".mcap")
