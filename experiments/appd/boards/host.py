"""``python -m experiments.appd.boards.host``: the program that drives a robot in a matrix trial.

A process of its own, because it is killed and stopped. The first line on the standard input says
what to do, as JSON of a `HostOrder`; what happens is told in lines of JSON on the standard output;
a second line, or its end, ends the program.
"""

import contextlib
import dataclasses
import json
import os
import select
import sys
import time

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.clock import WallClock
from twin.hardware.board_robot import BoardRobot
from twin.hardware.connect_boards import watched, wired_robot, without_pauses
from twin.hardware.serial_link import LinkError
from twin.hardware.wiring import Wiring
from twin.robot import ArmMode, Command, Lifecycle, Observation, RobotError, WheelMode

PERIOD = 0.01  # [s]
SPEED = 3.0  # [rad/s] of the wheels when driving
FEED = 0.3  # [rad/s] of the wheels when a card is pushed on
SWING, RATE = 0.15, 6.0  # [rad], [rad/s] of the joints


@dataclasses.dataclass(frozen=True)
class HostOrder:
    """What a host is to do.

    Attributes:
        robot: Name of the robot.
        ports: Ports of its boards, as `twin.hardware.emulator.messages.Ports`.
        angles: (4,) joint angles of the arm [rad].
        motion: One of `MOTIONS`.
    """

    robot: str
    ports: dict[str, str | int]
    angles: list[float]
    motion: str


def _idle(time: float, start: FloatArray) -> Command:
    return Command()


def _drive(time: float, start: FloatArray) -> Command:
    return Command(np.full(4, SPEED), start, WheelMode.SPEED, ArmMode.POSITION)


def _swing(time: float, start: FloatArray) -> Command:
    swung = start + SWING * np.sin(RATE * time) * np.array([1.0, 1.0, -1.0, 1.0])
    return Command(arm=swung, arm_mode=ArmMode.POSITION)


def _insert(time: float, start: FloatArray) -> Command:
    return Command(np.full(4, FEED), start, WheelMode.SPEED, ArmMode.POSITION)


MOTIONS = {"idle": _idle, "driving": _drive, "arm_moving": _swing, "insertion": _insert}
"""Command at a time since the start [s], from the arm's joint angles (4,) at the start [rad]."""


def _say(**words: object) -> None:
    print(json.dumps({"at": time.monotonic(), **words}), flush=True)


def _drive_until_told(robot: BoardRobot, clock: WallClock, order: HostOrder) -> None:
    """Drive, and go on looking at the robot when it has failed, as a program for people does."""
    move, start = MOTIONS[order.motion], np.array(order.angles)
    cycles, failed = 0, False
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        try:
            seen: Observation = robot.observe()
            if not failed:
                robot.command(move(seen.time, start))
                cycles += 1
        except RobotError as error:
            failed = True
            _say(error=str(error))
        clock.tick()
    statistics = robot.statistics
    _say(
        cycles=cycles,
        active=robot.lifecycle is Lifecycle.ACTIVE,
        lost=statistics.lost_boards,
        misses=clock.misses,
    )


def main() -> None:
    """Drive one robot as the first line says."""
    line = sys.stdin.readline()
    if not line:
        return  # Who started it has ended.
    order = HostOrder(**json.loads(line))
    before = len(os.listdir("/proc/self/fd"))
    ports = order.ports
    wiring = Wiring(
        str(ports["bus"]),
        str(ports["analogue"]),
        f"127.0.0.1:{ports['wrench']}",
        robot=order.robot,
        emulated=True,
    )
    clock = WallClock(PERIOD)
    with contextlib.ExitStack() as opened:
        try:
            robot = wired_robot(wiring, lambda: clock.time)
            opened.callback(robot.close)
            robot.home(np.array(order.angles))
            opened.enter_context(watched(robot))
            opened.enter_context(without_pauses())
            robot.activate()
        except (LinkError, RobotError) as error:
            _say(refused=str(error))
            return
        _say(active=True)
        _drive_until_told(robot, clock, order)
    _say(leaked=len(os.listdir("/proc/self/fd")) - before)


if __name__ == "__main__":
    main()
