"""Calibration of one robot as a TOML file: constants that convert counts to SI units and back.

Every section holds the constants of one kind of board with both directions of the conversion: a
client decodes readings with the one, an emulated board generates them with the other. A round trip
errs by half a count at most.
"""

import dataclasses
import datetime
import json
import math
import reprlib
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from perception.geometry.files import SETTINGS, read_toml, replace_file
from twin.hardware.calibration.motors import AxisCalibration, DriveCalibration, JointCalibration
from twin.hardware.calibration.section import CalibrationError, Section, from_table, require
from twin.hardware.calibration.sensors import (
    AnalogueCalibration,
    AngleSensor,
    ForceTorqueCalibration,
    TiltCalibration,
)

__all__ = [
    "AnalogueCalibration",
    "AngleSensor",
    "AxisCalibration",
    "Calibration",
    "CalibrationError",
    "DriveCalibration",
    "ForceTorqueCalibration",
    "JointCalibration",
    "LimitCalibration",
    "TiltCalibration",
    "calibration_path",
    "check_age",
    "load_calibration",
    "own_calibration_path",
    "read_calibration",
    "write_calibration",
]

SCHEMA: Final = 1
"""Version of the file format; files of other versions are rejected."""
FOLDER: Final = Path(__file__).parent
"""Folder of the calibrations that come with the package: those of the emulated boards."""
OWN_FOLDER: Final = Path("calibration")
"""Folder of a user's own calibrations, in the working directory."""
MOST_DAYS: Final = 365
"""Largest age of a section [days]."""
TIMEOUT_STEP: Final = 0.1
"""Resolution of the motor boards' serial timeout [s]."""
TIMEOUT_STEPS: Final = 255
"""Largest serial timeout, in multiples of `TIMEOUT_STEP`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class LimitCalibration(Section):
    """Voltage and timeout limits of a robot; `AxisCalibration` holds the current limits.

    Attributes:
        least_battery: Main battery voltage below which nothing is driven [V].
        most_battery: Main battery voltage above which nothing is driven [V].
        serial_timeout: Time without a packet after which a motor board stops its motors [s].
    """

    least_battery: float
    most_battery: float
    serial_timeout: float

    def __post_init__(self) -> None:
        """Reject limits that no board accepts.

        Raises:
            CalibrationError: Naming the key and its value.
        """
        require(
            0.0 < self.least_battery < self.most_battery < math.inf,
            "least_battery and most_battery",
            (self.least_battery, self.most_battery),
            "positive volts, least below most",
        )
        steps = self.serial_timeout / TIMEOUT_STEP
        whole = math.isclose(steps, round(steps), abs_tol=1e-6) if math.isfinite(steps) else False
        require(
            whole and 1 <= round(steps) <= TIMEOUT_STEPS,
            "serial_timeout",
            self.serial_timeout,
            "0.1 to 25.5 s in steps of 0.1 s",
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration of one robot.

    Attributes:
        robot: Name of the robot.
        drive: Motors and encoders.
        analogue: Analogue board and centre potentiometer.
        inclinometer: Roll and pitch axes of the inclinometer.
        force_torque: Force/torque sensor under the arm.
        limits: Limits at which the robot must stop.
    """

    robot: str
    drive: DriveCalibration
    analogue: AnalogueCalibration
    inclinometer: TiltCalibration
    force_torque: ForceTorqueCalibration
    limits: LimitCalibration

    def __post_init__(self) -> None:
        """Reject two sensors on one analogue input.

        Raises:
            CalibrationError: Naming the pins.
        """
        tilt = self.inclinometer
        pins = (self.analogue.centre.pin, tilt.roll.pin, tilt.pitch.pin)
        require(len(set(pins)) == 3, "pins of centre, roll and pitch", pins, "three different")


def calibration_path(robot: str) -> Path:
    """Return the path of a robot's calibration file: of the user's own if there is one."""
    own = own_calibration_path(robot)
    return own if own.exists() else FOLDER / f"{robot}.toml"


def own_calibration_path(robot: str) -> Path:
    """Return the path of the user's own calibration file of a robot, which need not exist."""
    return OWN_FOLDER / f"{robot}.toml"


def load_calibration(
    path: Path, robot: str, today: datetime.date | None, most_days: float = MOST_DAYS
) -> Calibration:
    """Read the calibration of a given robot, and check its age.

    Args:
        path: TOML file.
        robot: Name of the robot.
        today: Current date; None to accept any age, as for emulated boards.
        most_days: Largest age [days]; `math.inf` for any but the future.

    Raises:
        CalibrationError: If the file is unreadable, invalid, stale or of another robot.
    """
    calibration = read_calibration(path)
    if calibration.robot != robot:
        raise CalibrationError(
            f"{path}: robot is {reprlib.repr(calibration.robot)}, wanted {robot!r}; give that "
            f"robot's file, as {calibration_path(robot)}, or calibrate it"
        )
    if today is not None:
        try:
            check_age(calibration, today, most_days)
        except CalibrationError as error:
            raise CalibrationError(f"{path}: {error}") from None
    return calibration


def check_age(calibration: Calibration, today: datetime.date, most_days: float = MOST_DAYS) -> None:
    """Reject a calibration with a section that is too old or dated in the future.

    Raises:
        CalibrationError: Naming the section, its date and the remedy.
    """
    for name, section in _sections(calibration).items():
        days = (today - section.calibrated_on).days
        if days < 0:
            raise CalibrationError(
                f"{name}.calibrated_on is {section.calibrated_on}, after today ({today}); "
                "set the clock or the date"
            )
        if days > most_days:
            raise CalibrationError(
                f"{name}.calibrated_on is {section.calibrated_on}, {days} days ago, needs at most "
                f"{most_days}; calibrate this section again and set its date, or allow a larger age"
            )


def read_calibration(path: Path) -> Calibration:
    """Read a calibration of any robot and age.

    Raises:
        CalibrationError: If it is unreadable or invalid, naming file, key and value.
    """
    try:
        table = read_toml(path, SETTINGS)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise CalibrationError(f"{path}: is not TOML ({error})") from None
    schema = table.pop("schema", None)
    if schema != SCHEMA:
        shown = reprlib.repr(schema)
        raise CalibrationError(f"{path}: schema is {shown}, this version reads {SCHEMA}")
    try:
        return from_table(Calibration, table)
    except ValueError as error:  # Also for an int of too many digits to be shown.
        raise CalibrationError(f"{path}: {error}") from None


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration as commented TOML; the file is replaced atomically.

    Raises:
        OSError: If it cannot be written; the file before it stays.
    """
    text = calibration_text(calibration)
    replace_file(path, lambda stream: stream.write(text.encode()))


_HEADER = """\
# Calibration of one robot: the numbers by which its boards' counts become SI units.
# What each key means: twin/hardware/calibration/calibration.py.
"""
_REMARKS: Mapping[str, str] = types.MappingProxyType(
    {
        "counts_per_turn": "of the output shaft",
        "current_limit": "A",
        "lower": "rad",
        "upper": "rad",
        "zero_volts": "V at angle zero",
        "volts_per_radian": "V/rad",
        "reference": "V",
        "direction": "1 or -1",
        "rotation": "sensor to arm base frame, rows",
        "bias": "N and N m, sensor frame, without load",
        "least_battery": "V",
        "most_battery": "V",
        "serial_timeout": "s",
    }
)


def calibration_text(calibration: Calibration) -> str:
    """Return a calibration as the text of its file."""
    lines = [_HEADER, f"schema = {SCHEMA}", f"robot = {_literal('robot', calibration.robot)}"]
    for name, section in _sections(calibration).items():
        lines += _table_lines(name, section)
    return "\n".join(lines) + "\n"


def _table_lines(name: str, record: Any) -> list[str]:
    """Return the lines of a table: its own keys first, then its subtables."""
    lines, below = ["", f"[{name}]"], list[str]()
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            below += _table_lines(f"{name}.{field.name}", value)
            continue
        remark = _REMARKS.get(field.name)
        if field.name == "volts_per_radian":
            remark = f"V/rad; {1000.0 * math.radians(value):.3f} mV/degree"
        line = f"{field.name} = {_literal(field.name, value)}"
        lines.append(f"{line}  # {remark}" if remark else line)
    return lines + below


def _literal(key: str, value: Any) -> str:
    """Return a value as a TOML literal."""
    if isinstance(value, tuple):
        items = typing.cast("tuple[Any, ...]", value)
        return f"[{', '.join(_literal(key, item) for item in items)}]"
    if isinstance(value, str):
        # TOML has the escapes of JSON, and requires one more.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, datetime.date):
        return value.isoformat()
    return f"{value:#04x}" if key == "address" else repr(value)


def _sections(calibration: Calibration) -> dict[str, Section]:
    """Return the sections by name."""
    return {name: value for name, value in vars(calibration).items() if isinstance(value, Section)}
