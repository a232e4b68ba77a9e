"""``fieldtwin drive``: a person drives a rover and moves its arm, on a page in the browser.

The page shows what the rover observes, and nothing else of its scene.
"""

import contextlib
import dataclasses
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from rich.console import Console

from controllers.motion.teleoperation import Teleoperation
from experiments.harness.contract import OptionError
from experiments.harness.robot_option import check_calibrations
from experiments.live.drive_options import HandOptions, Options
from experiments.live.page_server import PageServer, jpeg
from models.compose import ROUGH
from twin.camera import StereoConfig
from twin.clock import Clock, PacedClock, WallClock
from twin.connect import Connection, connect
from twin.logs.writing import SENSORS, LogWriter
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop
from twin.recording.record import Recorder
from twin.robot import Channel, Observation, Robot, RobotError
from twin.sensors import CHANNELS

PAGE = Path(__file__).with_name("drive.html")
LONGEST = 1e6
"""Robot time after which a drive ends [s]."""
_FIELD = dataclasses.replace(ROUGH, shadows=False)  # They take half of an image's time.
_PERIOD = 0.05  # Robot time between two states that are shown [s].


class DriveTold(TypedDict, total=False):
    """What a page may tell.

    Attributes:
        drive: Speed ahead and turning to the left, -1 to 1.
        arm: Rates of the arm's joints, -1 to 1.
        identify: Whether the twin is to move the rover, so that it learns more.
        activate: Whether the rover is to be active.
    """

    drive: tuple[float, float]
    arm: tuple[float, float, float, float]
    identify: bool
    activate: bool


def run(options: Options) -> int:
    """Let a person drive until Ctrl+C is pressed; return the exit status.

    Raises:
        OptionError: If the rover cannot be as fast, its calibration cannot be used, or the port is
            taken.
        RobotError: If the rover fails; it was stopped.
    """
    with served(options) as (connection, server, ended):
        drive(connection, server, options, ended)
    return 0


@contextlib.contextmanager
def served(
    options: HandOptions,
) -> Iterator[tuple[Connection, PageServer, Callable[[], bool]]]:
    """Yield a connection with a rover, its page, and whether Ctrl+C was pressed.

    Raises:
        OptionError: If its calibration cannot be used, or the port is taken.
        RobotError: If it could not be stopped.
    """
    check_calibrations(options.robot)
    with (
        contextlib.closing(PageServer(PAGE, DriveTold, options.port)) as server,
        connect(
            options.robot,
            field=_FIELD,
            realism=options.realism or "ideal",
            stereo=StereoConfig(),
            seed=options.seed or 0,
        ) as connection,
        told_to_end() as ended,
    ):
        where = f"open {server.url} in a browser to drive; Ctrl+C ends it"
        Console().print(where, soft_wrap=True)
        try:
            yield connection, server, ended.is_set
        except KeyboardInterrupt as at_once:
            # What the loop adds to it says how far the stop is confirmed.
            if notes := getattr(at_once, "__notes__", []):
                raise RobotError("; ".join(notes)) from None


@contextlib.contextmanager
def told_to_end() -> Iterator[threading.Event]:
    """Let the first Ctrl+C set an event, so that all recorders end with a whole tick.

    Another one interrupts at once.
    """
    told = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def tell(*_: object) -> None:
        told.set()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, tell)
    try:
        yield told
    finally:
        signal.signal(signal.SIGINT, before)


def drive(
    connection: Connection, server: PageServer, options: Options, ended: Callable[[], bool]
) -> None:
    """Let a person drive the rover of a connection.

    Args:
        connection: Connection with one rover.
        server: Server of its page.
        options: Options of the drive.
        ended: Whether the person ended it, asked after each tick.

    Raises:
        OptionError: If the rover cannot be as fast.
        RobotError: If the rover fails; it was stopped.
    """
    (robot,) = connection.robots.values()
    hand = hand_of(robot, options)
    recorders: list[LoopRecorder] = [DrivePage(server, robot, hand, options.speed)]
    with contextlib.ExitStack() as stack:
        if options.record is not None:
            recorder = Recorder(options.record, connection.robots, connection.simulation)
            recorders.append(stack.enter_context(recorder))
        if options.log is not None:
            recorders.append(stack.enter_context(LogWriter(options.log, connection.settings)))
        run_loop(connection.robots, [hand], paced(connection), recorders, LONGEST, ended)


def hand_of(robot: Robot, options: HandOptions) -> Teleoperation:
    """Return the controller that a person drives a rover with.

    Raises:
        OptionError: If the rover cannot be as fast.
    """
    try:
        return Teleoperation(robot.description, options.speed)
    except ValueError as error:
        raise OptionError(f"--speed: {error}") from None


def paced(connection: Connection) -> Clock:
    """Return the clock of a connection, whose time passes no faster than the wall's."""
    if connection.simulation is None and connection.emulator is None:
        return connection.clock
    return PacedClock(connection.clock, WallClock(connection.clock.period))


class DrivePage(LoopRecorder):
    """Shows on a page what a rover observes, and hands on what a person asks there.

    Args:
        server: Server of the page.
        robot: The rover.
        hand: Controller that the person drives with.
        speed: Largest speed [m/s].
    """

    def __init__(self, server: PageServer, robot: Robot, hand: Teleoperation, speed: float) -> None:
        self._server, self._name, self._hand = server, robot.name, hand
        joints = list(robot.description.joint_names)
        self._about = {"robot": robot.name, "speed": speed, "joints": joints}
        self._next, self._pair, self._eyes = 0.0, float("nan"), b""

    def record(self, tick: Tick) -> None:
        """Take what the person asks, and show the robot now and then, if a page is open."""
        for told in self._server.taken():
            self.take(told)
        if tick.time >= self._next and self._server.watched:
            self._next = tick.time + _PERIOD
            self._show(tick.observations[self._name])

    def take(self, told: Mapping[str, Any]) -> None:
        """Take what a person asked for."""
        if "closed" in told:
            self._hand.rest()
        elif "drive" in told:
            ahead, left = told["drive"]
            self._hand.ask(ahead, left, told["arm"])

    def more(self) -> Mapping[str, Any]:
        """Return what else the page is to show; here nothing."""
        return {}

    def _show(self, seen: Observation) -> None:
        stereo = seen.stereo
        if stereo.usable and stereo.stamp != self._pair:
            # Drawn here, where it is read first: without a page nothing is.
            self._pair, self._eyes = stereo.stamp, jpeg(np.hstack(list(stereo.value)))
        sensors = [shown(name, getattr(seen, name)) for name in CHANNELS]
        eyes = {"pair": self._pair if self._eyes else None, "eyes": stereo.validity.value}
        about = {**self._about, "time": seen.time, **eyes, "sensors": sensors, **self.more()}
        self._server.show(self._eyes, about)


def shown(name: str, channel: Channel) -> Mapping[str, Any]:
    """Return a channel as the page shows it: its values are none while it is missing."""
    values = [round(float(value), 3) for value in channel.value]
    state = channel.validity.value
    return {"name": name, "unit": SENSORS[name][0], "values": values, "validity": state}
