"""Options of ``calibrate``."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from experiments.harness.contract import OptionError
from experiments.harness.robot_option import wiring_of


@dataclasses.dataclass(frozen=True)
class Options:
    """Options of the calibration of a real robot.

    Attributes:
        robot: Boards of the robot: serial:PORT,analogue=PORT,wrench=HOST[,robot=NAME]
            [,calibration=FILE][,home=YAW:SHOULDER:ELBOW:WRIST]. With home [rad] the motors hold
            the arm there; without, it must hold itself.
        weight: Mass that is hung on the gripper [kg].
        output: File to write the new calibration to; unless given calibration=FILE of the robot, or
            else calibration/NAME.toml, where it is looked for first from then on.
    """

    robot: str
    weight: float = 0.5
    output: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None

    def __post_init__(self) -> None:
        """Refuse robots without the sensors, and weights that are none.

        Raises:
            OptionError: Naming the option.
        """
        wiring = wiring_of(self.robot)
        if not (wiring.analogue and wiring.wrench):
            raise OptionError(f"--robot {self.robot}: needs analogue=PORT and wrench=HOST")
        if not 0.05 <= self.weight <= 5.0:
            raise OptionError(f"--weight: expected 0.05 to 5 kg, got {self.weight}")
        if self.output is not None and not self.output.parent.is_dir():
            raise OptionError(f"--output {self.output}: there is no folder {self.output.parent}")
