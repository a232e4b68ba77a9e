"""What a robot's target says of where it is: simulated, emulated, or on which ports."""

import dataclasses
import datetime
import math
from collections.abc import Mapping
from pathlib import Path

from twin.hardware.calibration.calibration import (
    MOST_DAYS,
    Calibration,
    calibration_path,
    load_calibration,
)

TARGETS: Mapping[str, str] = {
    "sim": "simulated rovers, sensors as in the datasheets",
    "quantised": "simulated rovers that count as their boards do, without wires",
    "emulated": "boards emulated in another process, over their real protocols",
    "serial:PORT[,analogue=PORT][,wrench=HOST][,stereo=LEFT:RIGHT][,robot=NAME]"
    "[,calibration=FILE][,most_days=N][,home=YAW:SHOULDER:ELBOW:WRIST][,radio=PORT]"
    "[,slow_down=N][,serial:PORT...]": (
        "real boards; home: the arm's angles in its jig [rad]; slow_down: of emulated boards; each "
        "further robot begins with serial:"
    ),
}
"""Targets of `connect`, and what each is."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """Where one robot's boards are.

    Attributes:
        bus: Serial port of the motor boards.
        analogue: Serial port of the analogue board; empty for none.
        wrench: Host, or host:port, of the force/torque sensor; empty for none.
        stereo: One or two captures, as "0:1" or "left.avi:right.avi", or the file of an emulator,
            "rover1.frames"; empty for none.
        robot: Name of the robot.
        calibration: File of its calibration; unless given, that of `calibration_path`.
        most_days: Largest age of the calibration [days].
        home: (4,) joint angles of the arm in its jig [rad]; empty if it is not in the jig.
        radio: Serial port of the radio modem; empty for none.
        slow_down: Wall-clock time over the boards' time; above 1 for slowed emulated boards.
        emulated: Whether the boards are emulated, so that a calibration's age does not matter.
        patient: Whether the boards' time is stopped during a call. Then a call may take long,
            and a busy machine changes nothing.
    """

    bus: str
    analogue: str = ""
    wrench: str = ""
    stereo: str = ""
    robot: str = "rover1"
    calibration: Path | None = None
    most_days: int = MOST_DAYS
    home: tuple[float, ...] = ()
    radio: str = ""
    slow_down: float = 1.0
    emulated: bool = False
    patient: bool = False

    @classmethod
    def parse(cls, words: str) -> "Wiring":
        """Parse the wiring given behind ``serial:``.

        Args:
            words: "/dev/ttyACM0,analogue=/dev/ttyACM1,wrench=192.168.1.1,stereo=0:1,robot=rover1,
                calibration=FILE,most_days=365,home=0:0.9:-1.4:0.1"; all but the first may be left
                out. `home` are the arm's present joint angles [rad].

        Raises:
            ValueError: Naming the word that is wrong, and those that there are.
        """
        bus, *others = words.split(",")
        options: dict[str, str] = {}
        names = ("analogue", "wrench", "stereo", "robot", "calibration", "most_days", "home")
        names += ("radio", "slow_down")
        for word in others:
            name, equals, value = word.partition("=")
            if not equals or name not in names:
                raise ValueError(
                    f"serial: {word!r} is not understood; expected PORT[,NAME=VALUE...] with "
                    f"names {', '.join(names)}"
                )
            options[name] = value
        if not bus:
            raise ValueError("serial: name the motor boards' port first, as serial:/dev/ttyACM0")
        _, colon, port = options.get("wrench", "").partition(":")
        if colon and not (port.isdecimal() and 0 < int(port) < 65536):
            raise ValueError(
                f"serial: wrench={options['wrench']} has no port number behind its colon"
            )
        try:
            slow_down = float(options.get("slow_down", "1"))
        except ValueError:
            slow_down = math.nan
        if not 1.0 <= slow_down < math.inf:
            raise ValueError(f"serial: slow_down={options['slow_down']} is no factor of 1 or more")
        days, path = options.get("most_days", str(MOST_DAYS)), options.get("calibration")
        if not days.isdecimal():
            raise ValueError(f"serial: most_days={days} is no whole number of days")
        return cls(
            bus,
            analogue=options.get("analogue", ""),
            wrench=options.get("wrench", ""),
            stereo=options.get("stereo", ""),
            robot=options.get("robot", "rover1"),
            calibration=Path(path) if path else None,
            most_days=int(days),
            home=_joint_angles(options.get("home", "")),
            radio=options.get("radio", ""),
            slow_down=slow_down,
            patient=slow_down > 1.0,
        )

    @classmethod
    def parse_all(cls, words: str) -> "tuple[Wiring, ...]":
        """Return the wirings of several robots.

        Args:
            words: Words as for `parse`, each robot's but the first behind ``,serial:``.

        Raises:
            ValueError: As `parse`; or if two robots have one name or port, or unlike `slow_down`.
        """
        found = tuple(cls.parse(part) for part in words.split(",serial:"))
        for what in ("robot", "bus", "analogue", "wrench", "stereo", "radio"):
            values = [getattr(wiring, what) for wiring in found if getattr(wiring, what)]
            twice = {value for value in values if values.count(value) > 1}
            if twice:
                raise ValueError(f"serial: two robots have {what}={twice.pop()}")
        if len({wiring.slow_down for wiring in found}) > 1:
            raise ValueError("serial: slow_down must be the same for all robots")
        return found

    def load_calibration(self) -> Calibration:
        """Read the robot's calibration.

        Raises:
            CalibrationError: If it is missing, wrong, another robot's or stale.
        """
        path = self.calibration or calibration_path(self.robot)
        today = None if self.emulated else datetime.date.today()
        return load_calibration(path, self.robot, today, self.most_days)


def _joint_angles(words: str) -> tuple[float, ...]:
    try:
        angles = tuple(float(word) for word in words.split(":") if words)
    except ValueError:
        angles = (math.nan,)
    if angles and not (len(angles) == 4 and all(map(math.isfinite, angles))):
        raise ValueError(f"serial: home={words} is not four joint angles [rad], as 0:0.9:-1.4:0.1")
    return angles


def wirings_of(target: str) -> tuple[Wiring, ...]:
    """Return where a target's real boards are, robot by robot; nothing if it has none.

    Args:
        target: One of `TARGETS`.

    Raises:
        ValueError: If it is unknown or misspelt.
    """
    word, colon, words = target.partition(":")
    if word == "serial" and colon:
        return Wiring.parse_all(words)
    if target not in TARGETS:
        raise ValueError(f"unknown robot {target!r}; available: {', '.join(TARGETS)}")
    return ()
