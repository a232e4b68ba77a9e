"""Robots over boards, from the words that say where the boards are."""

import contextlib
import dataclasses
import gc
from collections.abc import Callable, Generator

import numpy as np

from twin.describe import describe_rover
from twin.hardware.analogue.firmata import BAUD, AnalogueBoard
from twin.hardware.background import repeating
from twin.hardware.board_robot import BoardRobot, BoardRobotConfig
from twin.hardware.board_samples import SamplingConfig
from twin.hardware.board_set import WiredBoards
from twin.hardware.calibration.calibration import (
    Calibration,
)
from twin.hardware.cameras.camera import StereoCapture
from twin.hardware.emulator.direct import DirectBoards
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import EmulatedScene, SceneConfig
from twin.hardware.force_torque.net_ft import DEADLINE, PORT, NetForceTorque
from twin.hardware.roboclaw.client import BusTiming, RoboClawBus
from twin.hardware.serial_link import SerialLink
from twin.hardware.wiring import Wiring

BUS_BAUD = 460800
"""Four boards, twice a cycle, at 100 Hz need so much."""
_PATIENCE = 0.25
"""Longest call of emulated boards whose time is stopped during the call [s]."""


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
