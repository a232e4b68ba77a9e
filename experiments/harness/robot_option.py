"""The option ``--robot`` of experiments and commands, checked before a robot is connected."""

from collections.abc import Sequence

from experiments.harness.contract import OptionError
from twin.hardware.calibration.calibration import CalibrationError
from twin.hardware.wiring import TARGETS, Wiring, wirings_of


def check_robot(target: str) -> None:
    """Refuse a target that `twin.connect.connect` does not know; no file is read.

    Args:
        target: Value of the option.

    Raises:
        OptionError: If it is unknown or misspelt.
    """
    try:
        wirings_of(target)
    except ValueError as error:
        raise OptionError(f"--robot: {error}") from None


def check_one_rover(target: str, **simulated: object) -> None:
    """Refuse several robots, and options of simulated ones beside real boards.

    Args:
        target: Value of the option.
        simulated: Options that only simulated robots have, by name; None where not given.

    Raises:
        OptionError: Naming the option.
    """
    check_robot(target)
    wirings = wirings_of(target)
    if len(wirings) > 1:
        raise OptionError(f"--robot: one rover is driven at a time, got {len(wirings)}")
    for name, value in simulated.items():
        if wirings and value is not None:
            raise OptionError(f"--{name}: real boards have none; leave it out")


def check_calibrations(target: str) -> None:
    """Refuse real robots without a calibration that can be used, before anything is opened.

    Args:
        target: Value of the option.

    Raises:
        OptionError: If a calibration is missing, damaged, stale or another robot's.
    """
    try:
        for wiring in wirings_of(target):
            wiring.load_calibration()
    except CalibrationError as error:
        raise OptionError(f"--robot: {error}") from None


def wiring_of(target: str, available: Sequence[str] = ("serial",)) -> Wiring:
    """Return the ports of a real robot's boards.

    Args:
        target: ``serial:PORT[,NAME=VALUE...]``.
        available: Beginnings of the targets that the caller takes, for the error message.

    Raises:
        OptionError: If it is something else.
    """
    word, colon, words = target.partition(":")
    if word != "serial" or not colon:
        boards = [name for name in TARGETS if name.startswith(tuple(available))]
        others = [name for name in TARGETS if name not in boards]
        raise OptionError(
            f"--robot {target!r}: no real boards; available: {', '.join(boards)}; "
            f"not available here: {', '.join(others)}"
        )
    try:
        return Wiring.parse(words)
    except ValueError as error:
        raise OptionError(f"--robot {error}") from None
