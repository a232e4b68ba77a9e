"""The rover on boards beside the same rover without wires, and in real time at 100 Hz."""

import contextlib
import dataclasses
import subprocess
import sys
import time
from typing import cast

import numpy as np

from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from controllers.motion.simple_motions import WaveMotion
from experiments.appd.boards.trial import PERIOD, ROBOT
from models.compose import RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.clock import WallClock
from twin.connect import LineConfig, connect
from twin.describe import describe_rover
from twin.hardware.board_robot import BoardRobot
from twin.hardware.board_set import WiredBoards
from twin.hardware.connect_boards import (
    BUS_BAUD,
    emulated_wiring,
    watched,
    wired_robot,
    without_pauses,
)
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.serial_link import SerialLink
from twin.loop import LoopRecorder, Tick, run
from twin.robot import Channel, Command, Observation, RobotError

SINKING = 1.5  # [s] until the arm, without power, lies still and can be homed

_QUESTION = bytes(6)


class _Keep(LoopRecorder):
    """Keeps what a robot saw and did."""

    def __init__(self) -> None:
        self.ticks: list[tuple[Observation, Command]] = []

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        self.ticks.append((tick.observations[ROBOT], tick.applied[ROBOT]))


@dataclasses.dataclass(frozen=True)
class IdentityTrial:
    """One identification on boards and without wires.

    Attributes:
        faults: Share of damaged exchanges.
        seed: Random seed of the robot and of the excitation.
        times: Approach, rest and duration of the identification [s].
    """

    faults: float
    seed: int
    times: tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class BoardComparison:
    """How long a robot on boards does the same, to the bit, as one without wires.

    Attributes:
        identical: Cycles until an observation or a command differs in a bit.
        cycles: Cycles that both ran.
        damaged: Number of damaged exchanges.
    """

    identical: int
    cycles: int
    damaged: int


def compare_boards(config: IdentityTrial) -> BoardComparison:
    """Let the identification of ``ch2-rover`` run on quantised and on emulated boards."""
    approach, rest, duration = config.times
    identifier = RoverIdentifierConfig(
        ROBOT,
        SwingingArm.of(describe_rover(ROBOT)),
        approach=approach,
        rest=rest,
        duration=duration,
    )
    kept: dict[str, _Keep] = {}
    damaged = 0
    for target, faults in (("quantised", 0.0), ("emulated", config.faults)):
        keep = kept[target] = _Keep()
        controller = RoverIdentifier(identifier, np.random.default_rng(config.seed))
        seed = config.seed % 2**31
        placements = [RobotPlacement(ROBOT)]
        with connect(target, robots=placements, seed=seed, lines=LineConfig(faults)) as connection:
            with contextlib.suppress(RobotError):  # Then there are fewer cycles than were wanted.
                run(connection.robots, [controller], connection.clock, [keep], identifier.total)
            if connection.emulator is not None:
                damaged = sum(connection.emulator.state()[ROBOT]["damage"].values())
    pairs = zip(kept["quantised"].ticks, kept["emulated"].ticks)
    same = [_bits(one) == _bits(other) for one, other in pairs]
    identical = same.index(False) if False in same else len(same)
    return BoardComparison(
        identical=identical,
        cycles=len(same),
        damaged=damaged,
    )


def _bits(tick: tuple[Observation, Command]) -> bytes:
    """Return all that a tick holds, to the bit."""
    observation, applied = tick
    parts = [np.float64(observation.time).tobytes()]
    for channel in observation[1:]:
        assert isinstance(channel, Channel)
        stamp = np.float64(channel.stamp).tobytes()
        parts += [channel.value.tobytes(), stamp, channel.validity.value.encode()]
    return b"|".join([*parts, applied.wheels.tobytes(), applied.arm.tobytes()])


class _NotedClock(WallClock):
    """A wall clock that notes when each cycle begins, and what the adapter has taken so far."""

    def __init__(self, robot: BoardRobot) -> None:
        super().__init__(PERIOD)
        self._robot = robot
        self.begun: list[float] = []
        self.taken: list[float] = [robot.seconds]

    def tick(self) -> None:
        """Wait for the next deadline."""
        self.taken.append(self._robot.seconds)
        super().tick()
        self.begun.append(time.perf_counter())


@dataclasses.dataclass(frozen=True)
class LoopPace:
    """How well the loop keeps its period with boards.

    Attributes:
        steps: Cycles done.
        misses: Deadlines missed.
        periods: (n - 1,) time from the beginning of one cycle to the next [s].
        adapter: (n,) time that the adapter takes of each cycle [s].
        fault: Report of the robot on stopping; empty if it did not stop.
        exchanges: Exchanges with motor boards in a cycle.
    """

    steps: int
    misses: int
    periods: FloatArray
    adapter: FloatArray
    fault: str
    exchanges: int


@dataclasses.dataclass(frozen=True)
class EchoPace:
    """How well the loop keeps its period with a process that only echoes.

    Attributes:
        steps: Cycles done.
        misses: Deadlines missed.
        exchange: (n,) time of all exchanges of each cycle [s].
    """

    steps: int
    misses: int
    exchange: FloatArray


def keep_pace(duration: float, seed: int) -> LoopPace:
    """Drive emulated boards that run in real time, on the wall clock, as a real robot is driven."""
    emulator = EmulatorProcess(SceneConfig((RobotPlacement(ROBOT),), seed=seed), realtime=True)
    with contextlib.ExitStack() as resources:
        resources.callback(emulator.close)
        time.sleep(SINKING)
        robot_time = WallClock(PERIOD)
        robot = wired_robot(emulated_wiring(emulator, ROBOT), lambda: robot_time.time)
        resources.callback(robot.close)
        boards = cast("WiredBoards", robot.boards)
        robot.home(np.array(emulator.state()[ROBOT]["arm_angles"]))
        robot.activate()
        resources.enter_context(watched(robot))
        resources.enter_context(without_pauses())
        # Made last: what passes before the loop is no deadline missed.
        clock = _NotedClock(robot)
        asked = boards.bus.statistics.transactions
        with contextlib.suppress(RobotError):
            run({ROBOT: robot}, [WaveMotion(ROBOT)], clock, duration=duration)
        exchanges = boards.bus.statistics.transactions - asked
    return LoopPace(
        steps=len(clock.begun),
        misses=clock.misses,
        periods=np.diff(clock.begun),
        adapter=np.diff(clock.taken),
        fault=robot.fault,
        exchanges=round(exchanges / max(1, len(clock.begun))),
    )


def keep_bare_pace(duration: float, exchanges: int) -> EchoPace:
    """Do as many exchanges a cycle with a process that only echoes: what this machine allows.

    Args:
        duration: Duration on the wall clock [s].
        exchanges: Number of questions and answers in a cycle.
    """
    command = [sys.executable, "-m", "experiments.appd.boards.echo_probe"]
    steps, taken = round(duration / PERIOD), list[float]()
    with subprocess.Popen(  # noqa: S603
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as echo:
        assert echo.stdin is not None and echo.stdout is not None
        with contextlib.closing(SerialLink(echo.stdout.readline().strip(), BUS_BAUD)) as link:
            clock = WallClock(PERIOD)
            for _ in range(steps):
                clock.tick()
                begin = time.perf_counter()
                for _ in range(exchanges):
                    link.write(_QUESTION)
                    link.read(len(_QUESTION), time.monotonic() + 0.5)
                taken.append(time.perf_counter() - begin)
        echo.stdin.close()
    return EchoPace(
        steps=steps,
        misses=clock.misses,
        exchange=np.array(taken),
    )
