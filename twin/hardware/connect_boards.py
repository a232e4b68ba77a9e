"""Robots over boards, from the words that say where the boards are."""

import contextlib
import dataclasses
import datetime
import gc
import math
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np

from twin.describe import describe_rover
from twin.hardware.analogue.firmata import BAUD, AnalogueBoard
from twin.hardware.background import repeating
from twin.hardware.board_robot import BoardRobot, BoardRobotConfig
from twin.hardware.board_samples import SamplingConfig
from twin.hardware.board_set import WiredBoards
from twin.hardware.calibration.calibration import (
    MOST_DAYS,
    Calibration,
    calibration_path,
    load_calibration,
)
from twin.hardware.cameras.camera import StereoCapture
from twin.hardware.emulator.direct import DirectBoards
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig
from twin.hardware.force_torque.net_ft import DEADLINE, PORT, NetForceTorque
from twin.hardware.roboclaw.client import BusTiming, RoboClawBus
from twin.hardware.serial_link import SerialLink

BUS_BAUD = 460800
"""Four boards, twice a cycle, at 100 Hz need so much."""
_PATIENCE = 0.25
"""Longest call of emulated boards whose time is stopped during the call [s]."""


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
        calibration: File of its calibration; the repository's own unless given.
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


def open_boards(wiring: Wiring, calibration: Calibration) -> WiredBoards:
    """Open every port that the user named, and no other.

    Raises:
        LinkError: If one cannot be opened.
        ValueError: If the captures make no pair.
    """
    timing = BusTiming(call=_PATIENCE, ask=4.0 * _PATIENCE) if wiring.patient else BusTiming()
    with contextlib.ExitStack() as opened:
        bus = RoboClawBus(SerialLink(wiring.bus, BUS_BAUD), timing)
        opened.callback(bus.close)
        analogue = force_torque = camera = None
        if wiring.analogue:
            link = SerialLink(wiring.analogue, BAUD)
            analogue = (
                AnalogueBoard(link, deadline=_PATIENCE, silence=_PATIENCE / 5)
                if wiring.patient
                else AnalogueBoard(link)
            )
            opened.callback(analogue.close)
            analogue.open()
        if wiring.wrench:
            host, _, port = wiring.wrench.partition(":")
            deadline = _PATIENCE if wiring.patient else DEADLINE
            force_torque = NetForceTorque(host, int(port or PORT), deadline)
            opened.callback(force_torque.close)
        if wiring.stereo:
            camera = _camera(wiring)
        opened.pop_all()
    return WiredBoards(bus, calibration, analogue, force_torque, camera, wiring.slow_down)


def _camera(wiring: Wiring) -> StereoCapture:
    """Return the captures that are named by device number or file, two or one."""
    words = wiring.stereo
    named = [int(word) if word.isdecimal() else word for word in words.split(":")]
    if len(named) > 2:
        raise ValueError(f"serial: stereo={words} names {len(named)} captures, needs one or two")
    source = named[0] if len(named) == 1 else (named[0], named[1])
    scene_time = wiring.patient and wiring.slow_down == 1.0
    return StereoCapture(source, scene_time=scene_time, slow_down=wiring.slow_down)


def wired_robot(
    wiring: Wiring, clock: Callable[[], float], config: BoardRobotConfig | None = None
) -> BoardRobot:
    """Return a configured robot over its wires, homed if the wiring gives the arm's joint angles.

    Args:
        wiring: Ports of its boards.
        clock: Robot time [s].
        config: Time limits and age limits of the robot.

    Raises:
        CalibrationError: If its calibration cannot be used.
        LinkError: If a port cannot be opened.
        RobotError: If a board does not answer.
    """
    calibration = wiring.load_calibration()
    boards = open_boards(wiring, calibration)
    robot = BoardRobot(describe_rover(wiring.robot), boards, calibration, clock, config)
    try:
        robot.configure()
        if wiring.home:
            robot.home(np.array(wiring.home))
    except BaseException:
        robot.close()
        raise
    return robot


def emulated_wiring(emulator: EmulatorProcess, robot: str) -> Wiring:
    """Return where an emulator serves a robot's boards."""
    ports = emulator.ports[robot]
    return Wiring(
        ports["bus"],
        ports["analogue"],
        f"127.0.0.1:{ports['wrench']}",
        ports.get("stereo", ""),
        robot,
        emulated=True,
    )


def _patience(scene: SceneConfig) -> BoardRobotConfig:
    """Return the usual patience, with two periods of slow cameras."""
    if scene.stereo is None:
        return BoardRobotConfig()
    age = max(SamplingConfig.stereo_age, 2.0 / scene.stereo.rate)
    return BoardRobotConfig(sampling=SamplingConfig(stereo_age=age))


def emulated_robots(emulator: EmulatorProcess, scene: SceneConfig) -> dict[str, BoardRobot]:
    """Return homed robots over the boards of an emulator.

    The emulator's time must pass by ticks.

    Raises:
        LinkError: If a port cannot be opened.
        RobotError: If a board does not answer.
    """
    state = emulator.state()
    robots: dict[str, BoardRobot] = {}
    with contextlib.ExitStack() as opened:
        for placement in scene.robots:
            wiring = dataclasses.replace(emulated_wiring(emulator, placement.name), patient=True)
            robot = wired_robot(wiring, lambda: emulator.time, _patience(scene))
            opened.callback(robot.close)
            robot.home(np.array(state[placement.name]["arm_angles"]))
            robots[placement.name] = robot
        opened.pop_all()
    return robots


def quantised_robots(scene: EmulatedScene, config: SceneConfig) -> dict[str, BoardRobot]:
    """Return homed robots over the counts of a scene, without wires."""
    robots: dict[str, BoardRobot] = {}
    for name, rover in scene.rovers.items():
        boards, patience = DirectBoards(rover), _patience(config)
        robot = BoardRobot(
            rover.description, boards, rover.calibration, lambda: scene.time, patience
        )
        robot.configure()
        robot.home(rover.jig_angles())
        robots[name] = robot
    return robots


@contextlib.contextmanager
def without_pauses() -> Generator[None]:
    """Keep the search for garbage off all that is loaded by now: it would take two cycles."""
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def watched(robot: BoardRobot, period: float = 0.05) -> contextlib.AbstractContextManager[None]:
    """Stop a robot on the wall clock whose controller hangs.

    Args:
        robot: Robot that is watched.
        period: Time between two checks [s].
    """
    return repeating(robot.guard, f"watchdog of {robot.name}", period)
