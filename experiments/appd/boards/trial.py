"""Fault trials of ``appd-boards``: the emulated rover drives, something breaks, what still turns?

The truth are the duty codes that drive the eight motors, read at the emulator beside the wires.
"""

import contextlib
import dataclasses
import time
from collections.abc import Callable

import numpy as np

from experiments.harness.contract import ExperimentError
from models.compose import RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.hardware.board_robot import BoardRobot
from twin.hardware.calibration.motors import ADDRESSES
from twin.hardware.connect_boards import emulated_wiring, watched, wired_robot
from twin.hardware.emulator.faults import RobotFault
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
from twin.hardware.serial_link import LinkError
from twin.robot import ArmMode, Command, Lifecycle, RobotError, WheelMode

ROBOT = "rover1"
HOST_FAULTS = ("controller_hang", "host_killed", "nan_command")
WRAP = RobotFault.COUNTER_PRESET.value
STOPPING = (*(kind.value for kind in RobotFault if kind.value != WRAP), *HOST_FAULTS)
KINDS = (*STOPPING, WRAP)
TIMEOUT = 0.2
"""Longest patience of all: the boards' serial timeout, and the tilt's age [s]."""
PERIOD = 0.01  # [s]
LEAD = (20, 60)  # [cycles] of driving before the fault
AFTER = 40  # [cycles] looked at from the fault on
SPEED = (2.0, 7.0)  # [rad/s] of the wheels
SWING = 0.25  # [rad] of the arm's joints
WHEEL_BOARDS = ADDRESSES[:2]
REST = 0.3  # [s] after which nothing moves that is not driven
LONG = 0.3  # [s] of silence after which the host gives up
DURATIONS = {
    # Long enough that the robot must stop, and often over before the boards' own timeout.
    RobotFault.BUS_SILENT.value: (0.05, 0.08),
    RobotFault.BROWN_OUT.value: (0.05, 0.4),
    RobotFault.NO_WRENCH.value: (0.15, 0.4),
    RobotFault.NO_ANALOGUE.value: (0.3, 0.4),
}
_TRIES = 3
_STALLS, _STALL = 10, 1.0
"""How often a busy machine may keep the robot from starting, and the wait between [s]."""
_REMEMBERED = 21  # [cycles] a speed that still counts is of two readings within these


@dataclasses.dataclass(frozen=True)
class Batch:
    """Trials that share one emulator.

    Attributes:
        kinds: Faults of the trials, of `KINDS`.
        seed: Seed of the time, the board, the motion and all noise.
    """

    kinds: tuple[str, ...]
    seed: int


def deal(count: int, seeds: list[int]) -> list[Batch]:
    """Return batches, one for each seed, that together hold every fault equally often."""
    kinds = [KINDS[number % len(KINDS)] for number in range(count)]
    shares = (tuple(kinds[first :: len(seeds)]) for first in range(len(seeds)))
    return [Batch(share, seed) for share, seed in zip(shares, seeds) if share]


def fits_a_way(way: FloatArray, angles: FloatArray, count: float) -> bool:
    """Return whether each axis truly went this way a cycle, to a count, between two readings.

    A busy machine misses readings; then the way is the mean over the cycles between two.

    Args:
        way: (A,) measured angle a cycle [rad].
        angles: (N, A) true angles after each cycle, the latest last [rad].
        count: Angle of one count [rad].
    """
    first, last = np.triu_indices(len(angles), k=1)
    off = np.abs(angles[last] - angles[first] - way * (last - first)[:, None])
    return bool(np.all(np.any(off <= count, axis=0)))


@dataclasses.dataclass(frozen=True)
class FaultTrial:
    """What one fault did to a rover in motion.

    Attributes:
        kind: Fault, one of `KINDS`.
        moving: Number of motors driven when the fault began.
        stop_time: Time from the fault until no axis is driven [s]; infinite if one still is.
        active: Whether the robot stayed active.
        wrong: Number of wrong speeds.
        early: Number of stops before the fault, on a busy machine.
        fault: Error that the robot reported.
    """

    kind: str
    moving: int
    stop_time: float
    active: bool
    wrong: int
    early: int
    fault: str


def run_batch(batch: Batch) -> list[FaultTrial]:
    """Run trials one after another.

    Raises:
        ExperimentError: If a robot cannot be brought to drive without a fault.
    """
    rng = np.random.default_rng(batch.seed)
    with contextlib.closing(BoardBench(batch.seed % 2**31)) as bench:
        return [_FaultInjection(bench, kind, rng).run() for kind in batch.kinds]


class BoardBench:
    """An emulated rover whose boards are switched off and on between trials.

    Attributes:
        emulator: The process with boards and physics.
        robot: The robot over them, with the deadlines of a real one.
    """

    def __init__(self, seed: int, line_faults: float = 0.0) -> None:
        """Start the emulator.

        Args:
            seed: Seed of all noise.
            line_faults: Share of the exchanges with the motor boards that are damaged.
        """
        scene = SceneConfig((RobotPlacement(ROBOT),), seed=seed)
        self.emulator = EmulatorProcess(scene, line_faults)
        self.robot: BoardRobot | None = None

    @property
    def codes(self) -> list[int]:
        """The duty codes (8,) that drove the motors in the last tick."""
        return self.emulator.state()[ROBOT]["codes"]

    @property
    def angles(self) -> FloatArray:
        """The shafts' true angles (8,) [rad]."""
        return np.array(self.emulator.state()[ROBOT]["angles"])

    def renew(self, preset: int | None = None) -> BoardRobot:
        """Switch all boards off and on, connect anew and home.

        Args:
            preset: Address of a board whose counters then stand just before their wrap.

        Raises:
            ExperimentError: If that fails again and again.
        """
        self.disconnect()
        self.wait(REST)
        said = ""
        for _ in range(_STALLS):
            for address in ADDRESSES:
                self.emulator.inject(ROBOT, RobotFault.BOARD_RESET.value, 0.0, address)
            self.emulator.tick()
            try:
                wiring = emulated_wiring(self.emulator, ROBOT)
                self.robot = wired_robot(wiring, lambda: self.emulator.time)
                self.robot.home(self.angles[4:])
                if preset is not None:
                    self.emulator.inject(ROBOT, WRAP, 0.0, preset)
                    self.emulator.tick()
                self.robot.activate()
                return self.robot
            except (LinkError, RobotError) as error:
                # A machine that is busy elsewhere may miss a deadline of a millisecond.
                self.disconnect()
                said = str(error)
                time.sleep(_STALL)
        raise ExperimentError(f"the emulated rover cannot be set up: {said}")

    def wait(self, duration: float) -> None:
        """Let time pass [s]."""
        for _ in range(round(duration / PERIOD)):
            self.emulator.tick()

    def disconnect(self) -> None:
        """Close the ports, with all axes zeroed."""
        if self.robot is not None:
            self.robot.close()
            self.robot = None

    def close(self) -> None:
        """End the process."""
        self.disconnect()
        self.emulator.close()


class DriveAndSwing:
    """All eight motors turn: wheels the same way, joints to and fro about where they were.

    Args:
        start: (4,) joint angles at the start [rad].
        rng: Random generator of speeds and frequencies.
    """

    def __init__(self, start: FloatArray, rng: np.random.Generator) -> None:
        self._start = start
        self._wheels = rng.choice((-1.0, 1.0)) * rng.uniform(*SPEED) * rng.uniform(0.85, 1.0, 4)
        self._rates = rng.uniform(4.0, 8.0, 4)  # [rad/s]
        self._cycle = 0

    def next_command(self) -> Command:
        """Return the next cycle's command."""
        self._cycle += 1
        goal = self._start + SWING * np.sin(self._rates * self._cycle * PERIOD)
        return Command(self._wheels, goal, WheelMode.SPEED, ArmMode.POSITION)


class _FaultInjection:
    """One fault."""

    def __init__(self, bench: BoardBench, kind: str, rng: np.random.Generator) -> None:
        self._bench, self._kind, self._rng = bench, kind, rng
        self._address = int(rng.choice(WHEEL_BOARDS if kind == WRAP else ADDRESSES))
        self._lead = int(rng.integers(*LEAD))
        # Half of the hosts stop at the first error; the others go on asking and commanding.
        self._gives_up = bool(rng.random() < 0.5)
        low, high = DURATIONS.get(kind, (0.0, 0.0))
        self._duration = float(rng.uniform(low, high)) if high else 1e9
        if kind == RobotFault.BUS_SILENT.value and self._gives_up:
            self._duration = LONG
        self._wrong = self._early = 0

    def run(self) -> FaultTrial:
        """Drive, inject the fault, and observe what stops."""
        robot, motion = self._driving()
        moving = int(np.count_nonzero(self._bench.codes))
        codes = self._after()(robot, motion)
        driven = np.flatnonzero(np.any(codes, axis=1))
        last = int(driven[-1]) + 1 if driven.size else 0
        killed = self._kind == "host_killed"
        ended = robot.lifecycle is Lifecycle.ERROR or killed
        result = FaultTrial(
            kind=self._kind,
            moving=moving,
            stop_time=last * PERIOD if last < len(codes) and ended else float("inf"),
            active=robot.lifecycle is Lifecycle.ACTIVE,
            wrong=self._wrong,
            early=self._early,
            fault="" if killed else robot.fault,
        )
        if self._duration < 1.0:
            self._bench.wait(self._duration)
        if killed:
            self._bench.robot = None
        return result

    def _driving(self) -> tuple[BoardRobot, DriveAndSwing]:
        """Return the robot in motion; one that a busy machine stopped is started again."""
        said = ""
        for _ in range(_TRIES):
            robot = self._bench.renew(self._address if self._kind == WRAP else None)
            motion = DriveAndSwing(self._bench.angles[4:], self._rng)
            # The counters must not wrap before they are looked at.
            for _ in range(0 if self._kind == WRAP else self._lead):
                self._cycle(robot, motion.next_command())
            if robot.lifecycle is Lifecycle.ACTIVE:
                return robot, motion
            self._early, said = self._early + 1, robot.fault
        raise ExperimentError(f"the emulated rover stops without a fault: {said}")

    def _cycle(self, robot: BoardRobot, command: Command | None) -> None:
        """Let one cycle pass, of a host that does not mind errors."""
        robot.observe()
        if command is not None:
            with contextlib.suppress(RobotError):
                robot.command(command)
        self._bench.emulator.tick()

    def _after(self) -> Callable[[BoardRobot, DriveAndSwing], list[list[int]]]:
        """Return what makes this trial's fault happen, and returns the codes from then on."""
        own = {
            "controller_hang": self._hang,
            "host_killed": self._kill,
            "nan_command": self._command_nan,
            WRAP: self._wrap,
        }
        return own.get(self._kind, self._inject)

    def _inject(self, robot: BoardRobot, motion: DriveAndSwing) -> list[list[int]]:
        bench = self._bench
        bench.emulator.inject(ROBOT, self._kind, self._duration, self._address)
        codes: list[list[int]] = []
        gone = False
        while len(codes) < AFTER:
            if gone:
                bench.emulator.tick()
            else:
                self._cycle(robot, motion.next_command())
            codes.append(bench.codes)
            if self._gives_up and not gone and robot.lifecycle is Lifecycle.ERROR:
                gone = True
                # As `twin.loop.run` does when a robot fails.
                with contextlib.suppress(RobotError):
                    robot.deactivate()
        return codes

    def _hang(self, robot: BoardRobot, motion: DriveAndSwing) -> list[list[int]]:
        """Nobody commands; only the watchdog's thread runs, on the wall clock."""
        codes: list[list[int]] = []
        with watched(robot):
            due = time.monotonic()
            # How long after a look of the watchdog it hangs is left to chance.
            for cycle in range(-int(self._rng.integers(1, 7)), AFTER):
                if cycle < 0:
                    self._cycle(robot, motion.next_command())
                else:
                    self._bench.emulator.tick()
                    codes.append(self._bench.codes)
                due += PERIOD
                time.sleep(max(0.0, due - time.monotonic()))
        return codes

    def _kill(self, robot: BoardRobot, motion: DriveAndSwing) -> list[list[int]]:
        """The kernel closes the ports of a process that it kills; nothing more is sent."""
        robot.boards.close()
        codes: list[list[int]] = []
        for _ in range(AFTER):
            self._bench.emulator.tick()
            codes.append(self._bench.codes)
        return codes

    def _command_nan(self, robot: BoardRobot, motion: DriveAndSwing) -> list[list[int]]:
        command = None
        with contextlib.suppress(ValueError):
            command = Command(np.full(4, np.nan))
        codes: list[list[int]] = []
        for _ in range(AFTER):
            self._cycle(robot, command)
            codes.append(self._bench.codes)
        return codes

    def _wrap(self, robot: BoardRobot, motion: DriveAndSwing) -> list[list[int]]:
        """Drive through the wrap, and hold every speed against the true angles."""
        count = 2.0 * np.pi / robot.calibration.drive.front_left.counts_per_turn
        angles, codes = [self._bench.angles[:4]], [self._bench.codes]
        before, compared = self._counters(robot), 0
        for _ in range(self._lead + AFTER):
            self._cycle(robot, motion.next_command())
            angles.append(self._bench.angles[:4])
            speeds = robot.observe().wheel_speeds
            if speeds.usable:
                compared += 1
                way = np.asarray(speeds.value, dtype=float) * PERIOD
                self._wrong += not fits_a_way(way, np.array(angles[-_REMEMBERED:]), 1.001 * count)
            codes.append(self._bench.codes)
        if compared < AFTER:
            raise ExperimentError(
                f"only {compared} speeds could be compared: the machine is too busy"
            )
        after = self._counters(robot)
        if all(was * now > 0 for was, now in zip(before, after)):
            raise ExperimentError(f"no counter wrapped: {before} became {after}")
        return codes

    def _counters(self, robot: BoardRobot) -> tuple[int, int]:
        """Return the counters of the trial's board; a busy machine may have to ask again."""
        for _ in range(_TRIES):
            with contextlib.suppress(LinkError):
                return robot.boards.encoders(self._address)
        raise ExperimentError(f"board {self._address:#x} does not answer")
