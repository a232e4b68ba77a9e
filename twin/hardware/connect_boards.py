"""Robots over boards, from the words that say where the boards are."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import threading
from collections.abc import Callable, Generator
from pathlib import Path

import numpy as np

from twin.hardware.board_robot import BoardRobot
from twin.hardware.board_set import WiredBoards
from twin.hardware.calibration import (
    MOST_DAYS,
    Calibration,
    calibration_path,
    load_calibration,
)
from twin.hardware.emulator.direct import DirectBoards
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig
from twin.hardware.firmata import BAUD, AnalogueBoard
from twin.hardware.force_torque import PORT, NetForceTorque
from twin.hardware.link import SerialLink
from twin.hardware.roboclaw import RoboClawBus

BUS_BAUD = 460800
"""Four boards, twice a cycle, at 100 Hz need so much."""


@dataclasses.dataclass(frozen=True)
class Wiring:
    """Where one robot's boards are.

    Attributes:
        bus: Serial port of the motor boards.
        analogue: Serial port of the analogue board; empty for none.
        wrench: Host, or host:port, of the force/torque sensor; empty for none.
        robot: Whose boards they are.
        calibration: Its file; the repository's own unless given.
        most_days: Largest age of the calibration [days].
        emulated: Whether they are emulated, so that an old calibration is as good as a new one.
    """

    bus: str
    analogue: str = ""
    wrench: str = ""
    robot: str = "rover1"
    calibration: Path | None = None
    most_days: int = MOST_DAYS
    emulated: bool = False

    @classmethod
    def parse(cls, words: str) -> Wiring:
        """Return the wiring that stands behind ``serial:``.

        Args:
            words: "/dev/ttyACM0,analogue=/dev/ttyACM1,wrench=192.168.1.1,robot=rover1,
                calibration=FILE,most_days=365"; all but the first may be left out.

        Raises:
            ValueError: Naming the word that is wrong, and those that there are.
        """
        bus, *others = words.split(",")
        options: dict[str, str] = {}
        names = ("analogue", "wrench", "robot", "calibration", "most_days")
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
        path, days = options.pop("calibration", None), options.pop("most_days", str(MOST_DAYS))
        if not days.isdecimal():
            raise ValueError(f"serial: most_days={days} is no whole number of days")
        file = Path(path) if path else None
        return cls(
            bus,
            options.get("analogue", ""),
            options.get("wrench", ""),
            options.get("robot", "rover1"),
            file,
            int(days),
        )

    def load_calibration(self) -> Calibration:
        """Read the robot's calibration.

        Raises:
            CalibrationError: If it is missing, wrong, another robot's or stale.
        """
        path = self.calibration or calibration_path(self.robot)
        today = None if self.emulated else datetime.date.today()
        return load_calibration(path, self.robot, today, self.most_days)


def open_boards(wiring: Wiring, calibration: Calibration) -> WiredBoards:
    """Open every port that the user named, and no other.

    Raises:
        LinkError: If one cannot be opened.
    """
    with contextlib.ExitStack() as opened:
        bus = RoboClawBus(SerialLink(wiring.bus, BUS_BAUD))
        opened.callback(bus.close)
        analogue = force_torque = None
        if wiring.analogue:
            analogue = AnalogueBoard(SerialLink(wiring.analogue, BAUD))
            opened.callback(analogue.close)
            analogue.open()
        if wiring.wrench:
            host, _, port = wiring.wrench.partition(":")
            # The calibration converts: counts pass as they are.
            force_torque = NetForceTorque(host, 1.0, 1.0, int(port) if port else PORT)
        opened.pop_all()
    return WiredBoards(bus, calibration, analogue, force_torque)


def wired_robot(wiring: Wiring, clock: Callable[[], float]) -> BoardRobot:
    """Return a configured robot over its wires.

    Raises:
        CalibrationError: If its calibration cannot be used.
        LinkError: If a port cannot be opened.
        RobotError: If a board does not answer.
    """
    calibration = wiring.load_calibration()
    boards = open_boards(wiring, calibration)
    robot = BoardRobot(wiring.robot, boards, calibration, clock)
    try:
        robot.configure()
    except BaseException:
        robot.close()
        raise
    return robot


def emulated_wiring(emulator: EmulatorProcess, scene: SceneConfig, robot: str) -> Wiring:
    """Return where an emulator has put a robot's boards."""
    ports = emulator.ports[robot]
    host = f"127.0.0.1:{ports['wrench']}"
    path = scene.calibrations.get(robot)
    return Wiring(ports["bus"], ports["analogue"], host, robot, path, emulated=True)


def emulated_robots(emulator: EmulatorProcess, scene: SceneConfig) -> dict[str, BoardRobot]:
    """Return homed robots over the boards of an emulator.

    Raises:
        LinkError: If a port cannot be opened.
        RobotError: If a board does not answer.
    """
    state = emulator.state()
    robots: dict[str, BoardRobot] = {}
    for placement in scene.robots:
        wiring = emulated_wiring(emulator, scene, placement.name)
        robot = wired_robot(wiring, lambda: emulator.time)
        robot.home(np.array(state[placement.name]["arm_angles"]))
        robots[placement.name] = robot
    return robots


def quantised_robots(scene: EmulatedScene) -> dict[str, BoardRobot]:
    """Return homed robots over the counts of a scene, without wires."""
    robots: dict[str, BoardRobot] = {}
    for name, rover in scene.rovers.items():
        robot = BoardRobot(name, DirectBoards(rover), rover.calibration, lambda: scene.time)
        robot.configure()
        robot.home(rover.angles()[4:])
        robots[name] = robot
    return robots


@contextlib.contextmanager
def watched(robot: BoardRobot, period: float = 0.05) -> Generator[None]:
    """Stop a robot on the wall clock whose controller hangs.

    Args:
        robot: It.
        period: Between looks [s].
    """
    over = threading.Event()

    def watch() -> None:
        while not over.wait(period):
            robot.guard()

    thread = threading.Thread(target=watch, name=f"watchdog of {robot.name}", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
