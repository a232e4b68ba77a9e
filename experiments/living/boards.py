"""A rover on emulated boards at work in real time, its twin beside it in a process of its own."""

import json
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from controllers.motion.simple_motions import Work
from experiments.live.drive import paced
from experiments.live.twin_process import TwinProcess
from experiments.living.trial import FIELD, ROBOT
from models.compose import RobotPlacement
from twin.connect import connect
from twin.loop import run as run_loop


class OnBoards(NamedTuple):
    """What a twin beside a rover on boards did.

    Attributes:
        seconds: Time for which the rover was watched after the learning [s].
        ticks: Ticks of the rover.
        late: Share of them for which the twin was late by more than a tick, or which it left out.
        alarms: Changes that were named, though nothing happened.
    """

    seconds: float
    ticks: int
    late: float
    alarms: tuple[str, ...]


def watch_boards(seed: int, learning: float, seconds: float) -> OnBoards:
    """Let a rover as made work on emulated boards while its twin runs beside it.

    Args:
        seed: Random seed of the rover, its sensors and its work.
        learning: Time for which the twin only learns [s].
        seconds: Time for which nothing happens after that [s].
    """
    placed = RobotPlacement(ROBOT, stereo=False)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        twin = TwinProcess(placed, folder, 1, learning)
        stack.callback(twin.close)
        twin.wait()
        connection = stack.enter_context(
            connect("emulated", robots=[placed], field=FIELD, realism="default", seed=seed)
        )
        (robot,) = connection.robots.values()
        work = Work(robot.description, np.random.default_rng([seed, 2]))
        run_loop(connection.robots, [work], paced(connection), [twin], learning + seconds)
        twin.close()
        told: dict[str, Any] = json.loads((folder / "live.json").read_text())
    alarms = tuple(each["name"] for each in told["changes"])
    return OnBoards(seconds, told["ticks"], told["deadline_miss_fraction"], alarms)
