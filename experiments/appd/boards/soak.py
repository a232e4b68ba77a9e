"""The soak of ``appd-boards``: hours of driving with faults, faster than real time.

Time passes by ticks, so a fault that takes long on the wall clock takes no longer on the robot's.
What the robot reads is held against the shafts' true angles in every cycle, and what it says of a
stop against the duties of the boards.
"""

import collections
import contextlib
import dataclasses
import gc
import os
import re
from collections.abc import Generator
from pathlib import Path

import numpy as np

from experiments.appd.boards.trial import (
    PERIOD,
    ROBOT,
    BoardBench,
    DriveAndSwing,
    fits_a_way,
)
from perception.geometry.arrays import FloatArray
from twin.hardware.board_robot import BoardRobot
from twin.hardware.calibration.motors import ADDRESSES
from twin.hardware.emulator.faults import BusFault, LineFault, RobotFault
from twin.robot import Channel, Lifecycle, RobotError

LASTING = (
    *(kind for kind in RobotFault if kind is not RobotFault.COUNTER_PRESET),
    # A port that was pulled out stays away, which is the end of a line.
    *(kind for kind in BusFault if kind is not BusFault.UNPLUGGED),
)
"""Faults that stop the robot."""
SHORT = tuple(LineFault)
"""Faults of one exchange, which the robot rides out."""
DAMAGED = 0.002
"""Share of the exchanges with the motor boards that are damaged throughout."""
APART = 6.0  # [s] from one fault to the next, on average
LASTING_SHARE = 0.5
STOPPED = 0.5  # [s] looked at from a fault on
WITHIN = 0.25  # [s]
_REMEMBERED = 21  # [cycles] in which a value that is still usable was read
_COUNTS = 2.0
"""Most that an angle may be off: one count of reading and one of homing."""
_WARM = 0.1
"""Share of the soak in which a process may still grow."""
_EVERY = 100  # [cycles] in motion from one look at the memory to the next
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclasses.dataclass(frozen=True)
class SoakTrial:
    """One long drive.

    Attributes:
        duration: Robot time [s].
        seed: Seed of motion, faults and noise.
        core: Which of the processor's cores its two processes share, counted round.
    """

    duration: float
    seed: int
    core: int = 0


@dataclasses.dataclass(frozen=True)
class SoakResult:
    """What a long drive came to.

    Attributes:
        duration: Robot time [s].
        active: Robot time in motion [s].
        cycles: Number of cycles whose values were compared.
        wrong: Number of wrong values, by the kind of the latest fault; "none" before the first.
        damaged: Number of damaged exchanges.
        faults: Number of faults, by kind.
        false: Number of boards said to be at zero that drove.
        zero: Longest time from a fault to zero duty at all boards [s]; infinite if one still drove.
        unexpected: Number of stops without a lasting fault.
        host: (n,) resident memory of the host's process over the drive [byte].
        boards: (n,) of the boards' process [byte].
        opened: Number of open files that the host has more in the end.
    """

    duration: float
    active: float
    cycles: int
    wrong: dict[str, int]
    damaged: int
    faults: dict[str, int]
    false: int
    zero: float
    unexpected: int
    host: FloatArray
    boards: FloatArray
    opened: int


def growth(memory: FloatArray) -> float:
    """Return by what share a process has grown since it was warm.

    Args:
        memory: (n,) resident memory over time, n >= 10 [byte].
    """
    part = round(len(memory) * _WARM)
    return float(np.median(memory[-part:]) / np.median(memory[part : 2 * part])) - 1.0


def run_soak(trial: SoakTrial) -> SoakResult:
    """Drive, break something, look at what the robot says and does, mend it, and go on.

    Raises:
        ExperimentError: If a robot cannot be brought to drive without a fault.
    """
    rng = np.random.default_rng(trial.seed)
    with (
        _one_core(trial.core),
        contextlib.closing(BoardBench(trial.seed % 2**31, DAMAGED)) as bench,
    ):
        return _Soak(bench, rng, trial.duration).run()


@contextlib.contextmanager
def _one_core(number: int) -> Generator[None]:
    """Keep this process and its children on one core: they take turns, and none has to be woken."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(cores)[number % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


class _Soak:
    """One long drive."""

    def __init__(self, bench: BoardBench, rng: np.random.Generator, duration: float) -> None:
        self._bench, self._rng, self._duration = bench, rng, duration
        self._faults: collections.Counter[str] = collections.Counter()
        self._wrong: collections.Counter[str] = collections.Counter()
        self._latest = "none"
        self._active = self._cycles = self._false = self._unexpected = 0
        self._zero = 0.0
        self._memory: list[tuple[float, float]] = []

    def run(self) -> SoakResult:
        """Drive until the time is over."""
        emulator = self._bench.emulator
        before = _opened()
        while emulator.time < self._duration:
            robot = self._bench.renew()
            self._drive(robot)
        self._bench.disconnect()
        host, boards = np.array(self._memory).T
        return SoakResult(
            duration=emulator.time,
            active=self._active * PERIOD,
            cycles=self._cycles,
            wrong=dict(self._wrong),
            damaged=sum(emulator.state()[ROBOT]["damage"].values()),
            faults=dict(self._faults),
            false=self._false,
            zero=self._zero,
            unexpected=self._unexpected,
            host=host,
            boards=boards,
            opened=_opened() - before,
        )

    def _drive(self, robot: BoardRobot) -> None:
        """Drive until the robot stops, or time is over."""
        bench, emulator = self._bench, self._bench.emulator
        motion = DriveAndSwing(bench.angles[4:], self._rng)
        angles = collections.deque([bench.angles], maxlen=_REMEMBERED)
        fault_at = emulator.time + float(self._rng.exponential(APART))
        while emulator.time < self._duration:
            if emulator.time >= fault_at:
                if self._rng.random() < LASTING_SHARE:
                    self._break(robot, motion, angles)
                    return
                self._inject(str(self._rng.choice([kind.value for kind in SHORT])))
                fault_at = emulator.time + float(self._rng.exponential(APART))
            self._cycle(robot, motion, angles)
            if robot.lifecycle is Lifecycle.ERROR:
                self._unexpected += 1
                self._judge_words(robot)
                return

    def _break(
        self, robot: BoardRobot, motion: DriveAndSwing, angles: collections.deque[FloatArray]
    ) -> None:
        """Let a fault last until the robot has stopped, and look at what it says and does."""
        begin = self._bench.emulator.time
        kind = LASTING[self._rng.integers(len(LASTING))].value
        self._inject(kind, STOPPED, int(self._rng.choice(ADDRESSES)))
        driven = [False]
        while self._bench.emulator.time < begin + STOPPED:
            was = robot.lifecycle
            self._cycle(robot, motion, angles)
            if robot.lifecycle is Lifecycle.ERROR and was is not Lifecycle.ERROR:
                self._judge_words(robot)
            driven.append(any(self._bench.codes))
        stopped = robot.lifecycle is Lifecycle.ERROR and not driven[-1]
        last = float(np.flatnonzero(driven)[-1]) * PERIOD if any(driven) else 0.0
        self._zero = max(self._zero, last if stopped else float("inf"))

    def _inject(self, kind: str, duration: float = PERIOD, address: int = ADDRESSES[0]) -> None:
        self._faults[kind] += 1
        self._latest = kind
        self._bench.emulator.inject(ROBOT, kind, duration, address)

    def _cycle(
        self, robot: BoardRobot, motion: DriveAndSwing, angles: collections.deque[FloatArray]
    ) -> None:
        """Let one cycle pass, of a host that does not mind errors."""
        seen = robot.observe()
        if len(angles) > 1:
            count = 1.0 / np.abs(robot.calibration.drive.counts_per_radian)
            self._compare(seen.arm_angles, seen.wheel_speeds, np.array(angles), count)
        if robot.lifecycle is Lifecycle.ACTIVE:
            if self._active % _EVERY == 0:
                process = self._bench.emulator.process
                self._memory.append((_resident(os.getpid()), _resident(process)))
            self._active += 1
            with contextlib.suppress(RobotError):
                robot.command(motion.next_command())
        self._bench.emulator.tick()
        angles.append(self._bench.angles)

    def _compare(
        self, arm: Channel, wheels: Channel, angles: FloatArray, count: FloatArray
    ) -> None:
        """Hold what is read against the shafts' true angles."""
        self._cycles += 1
        if arm.usable:
            off = np.abs(angles[:, 4:] - np.asarray(arm.value, dtype=float))
            self._note(int(np.sum(np.all(off > _COUNTS * count[4:], axis=0))))
        if wheels.usable:
            way = np.asarray(wheels.value, dtype=float) * PERIOD
            self._note(not fits_a_way(way, angles[:, :4], 1.001 * float(count[:4].max())))

    def _note(self, wrong: int) -> None:
        """Count wrong values."""
        if wrong:
            self._wrong[self._latest] += wrong

    def _judge_words(self, robot: BoardRobot) -> None:
        """Count the boards that the robot calls zero though they drive."""
        codes = self._bench.codes
        confirmed = re.search(r"boards ((?:0x\w+(?:, )?)+): zero confirmed", robot.fault)
        for address in confirmed[1].split(", ") if confirmed else ():
            axes = robot.calibration.drive.boards[int(address, 16)]
            self._false += any(codes[axis] for axis in axes if axis >= 0)


def _resident(process: int) -> float:
    """Return the resident memory of a process [byte]."""
    return float(Path(f"/proc/{process}/statm").read_text().split()[1]) * _PAGE


def _opened() -> int:
    """Return the number of open files, less those that only wait to be collected."""
    gc.collect()
    return len(os.listdir("/proc/self/fd"))
