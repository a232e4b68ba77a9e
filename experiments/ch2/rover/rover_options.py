"""Options of ``ch2-rover``."""

import dataclasses
from typing import Annotated, Literal

from controllers.identification import ROVER_EXCITATIONS
from experiments.harness import contract
from experiments.harness.contract import OptionError
from experiments.harness.robot_option import check_robot
from twin.optics.realism import RealismName

Axis = Literal["pitch", "roll"]


@dataclasses.dataclass(frozen=True)
class Options(contract.RepeatedOptions, contract.LoggedOptions):
    """Options of ch2-rover.

    Attributes:
        robot: Which robot: sim, quantised, emulated, or serial:PORT[,NAME=VALUE...] for real
            boards.
        excitations: Which excitations to compare (unless said, all; two with --quick).
        duration: Time of excitation [s].
        realism: How far simulated robots and their sensors are from their drawings: ideal, default
            or harsh; with any but ideal each seed has a robot of its own.
        axis: Tilt to identify: pitch, the arm ahead, or roll, the arm turned aside.
    """

    robot: str = "sim"
    excitations: Annotated[tuple[str, ...], contract.some_of(ROVER_EXCITATIONS)] = ()
    duration: float = 10.0
    realism: RealismName = "default"
    axis: Axis = "pitch"

    def __post_init__(self) -> None:
        """Refuse robots that cannot be, unknown excitations, and durations that hold no window.

        Raises:
            OptionError: Naming the option.
        """
        super().__post_init__()
        check_robot(self.robot)
        for name in self.excitations:
            if name not in ROVER_EXCITATIONS:
                raise OptionError(
                    f"--excitations {name}: unknown; there are {', '.join(ROVER_EXCITATIONS)}"
                )
        if not 1.0 <= self.duration <= 120.0:
            raise OptionError(f"--duration: expected 1 to 120 s, got {self.duration}")

    def chosen(self) -> tuple[str, ...]:
        """Return the excitations to run."""
        if self.excitations:
            return self.excitations
        return ("constant", "information") if self.quick else ROVER_EXCITATIONS
