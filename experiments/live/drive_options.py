"""Options of ``drive``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError, check_new
from experiments.harness.robot_option import check_one_rover
from twin.optics.realism import RealismName


@dataclasses.dataclass(frozen=True)
class HandOptions:
    """Options of a rover that a person drives by hand.

    Attributes:
        robot: Which rover: sim, quantised, emulated, or serial:PORT[,NAME=VALUE...] for real
            boards, as serial:/dev/ttyUSB0,analogue=/dev/ttyACM0,stereo=0:1,home=0:0.9:-1.4:0.1.
        speed: Largest speed of the wheels along the ground [m/s]; the rover as drawn reaches 0.32.
        port: Port of the page on this machine; 0 for a free one.
        realism: How far a simulated rover, its sensors and cameras are from their drawings: ideal,
            default or harsh; images take longer with any but ideal (unless said, ideal).
        seed: Seed of a simulated rover and its sensors' noise (unless said, 0).
    """

    robot: str = "sim"
    speed: Annotated[float, tyro.conf.arg(metavar="M/S")] = 0.15
    port: int = 0
    realism: RealismName | None = None
    seed: Annotated[int | None, tyro.conf.arg(metavar="N")] = None

    def __post_init__(self) -> None:
        """Refuse robots that cannot be driven, and what they have no use for.

        Raises:
            OptionError: Naming the option.
        """
        check_one_rover(self.robot, realism=self.realism, seed=self.seed)
        if not self.speed > 0.0:
            raise OptionError(f"--speed: expected above 0 m/s, got {self.speed}")
        if self.seed is not None and self.seed < 0:
            raise OptionError(f"--seed: expected 0 or more, got {self.seed}")
        if not 0 <= self.port < 1 << 16:
            raise OptionError(f"--port: expected 0 to 65535, got {self.port}")


@dataclasses.dataclass(frozen=True)
class Options(HandOptions):
    """Options of a drive by hand.

    Attributes:
        record: Also write a recording for the rerun viewer, as drive.rrd; it must be new.
        log: Also write what is measured and applied as a log, as drive.mcap; it must be new.
    """

    record: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    log: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def __post_init__(self) -> None:
        """Refuse also files that are there already, or have no place.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        for name, path, suffix in (("record", self.record, ".rrd"), ("log", self.log, ".mcap")):
            if path is not None:
                check_new(name, path, suffix)
