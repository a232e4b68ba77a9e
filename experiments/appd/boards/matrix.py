"""The fault matrix of ``appd-boards``: every fault in every state, on boards with their own clock.

The robot is driven by a program of its own (`host`), which can be killed and stopped. The truth are
the duties of the emulated boards, which are held against the program's words.
"""

import contextlib
import dataclasses
import functools
import json
import os
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from experiments.appd.boards.host import MOTIONS, PERIOD, HostOrder
from experiments.ch5.insertion_scene import SLAVE, place_insertion
from experiments.ch5.insertion_setting import InsertionTrial, prepare
from experiments.ch5.insertion_trial import card_in_slot
from experiments.harness.contract import ExperimentError
from models.compose import RobotPlacement
from models.datasheets import CARD_AND_SLOT
from perception.geometry.arrays import FloatArray
from twin.hardware.calibration.motors import ADDRESSES
from twin.hardware.emulator.faults import BusFault, LineFault, RobotFault
from twin.hardware.emulator.messages import RobotTruth
from twin.hardware.emulator.process import EmulatorProcess
from twin.hardware.emulator.scene import SceneConfig
from twin.loop import run

STATES = tuple(MOTIONS)
LINE_FAULTS = {
    "unplugged": BusFault.UNPLUGGED,
    "silence": RobotFault.BUS_SILENT,
    "garbage": BusFault.GARBAGE,
    "repeated_replies": BusFault.REPEATED,
    "late_replies": BusFault.LATE,
    "reply_wire_cut": BusFault.REPLIES_CUT,
    "request_wire_cut": BusFault.REQUESTS_CUT,
    "board_dead": BusFault.BOARD_DEAD,
    "brown_out": RobotFault.BROWN_OUT,
}
HOST_SIGNALS = {"host_killed": signal.SIGKILL, "host_stopped": signal.SIGSTOP}
BOARD_SIGNALS = {"boards_killed": signal.SIGKILL, "boards_stopped": signal.SIGSTOP}
TRANSIENTS = {
    "one_late_reply": LineFault.LATE,
    "one_repeated_reply": LineFault.MERGED,
    "garbage_of_10_ms": BusFault.GARBAGE,
}
"""Faults that are over before a robot has to stop; each comes again every `PAUSE`."""
CONTROL = "no_fault"
"""As long as a transient's trial: what the machine itself costs."""
MATRIX = (*LINE_FAULTS, *HOST_SIGNALS)
RIDES = (*TRANSIENTS, CONTROL)
FAULTS = (*MATRIX, *BOARD_SIGNALS, *RIDES)
OFTEN = ("reply_wire_cut", "request_wire_cut", "host_killed")
"""Faults with four times as many seeds."""
WITHIN = 0.25
"""Longest time from a fault to zero duty at all boards with power [s]."""
LEAD = (0.4, 0.8)  # [s] of motion before the fault
AFTER = 0.8  # [s] looked at after the fault
PAUSE, TIMES = 1.0, 4
_PATIENCE, _ENDING = 30.0, 5.0  # [s]
_TRIES = 10
_DEPTH = 0.5  # share of the slot's depth at which an insertion is stored


@dataclasses.dataclass(frozen=True)
class MatrixTrial:
    """One fault in one state.

    Attributes:
        fault: One of `FAULTS`.
        state: One of `STATES`.
        seed: Seed of the time and the board.
    """

    fault: str
    state: str
    seed: int


@dataclasses.dataclass(frozen=True)
class MatrixResult:
    """What a fault did.

    Attributes:
        trial: The trial.
        moving: Number of boards that drove a motor when the fault began.
        told: Time from the fault to the host's first error [s]; NaN for none.
        words: The host's first error; empty for none.
        leaked: Number of open files that the host has more in the end.
        active: Whether the robot is still active in the end.
        cycles: Share of the cycles that were done where the fault has to be ridden out.
        zero: Time from the fault to zero duty at all boards with power [s]; infinite if one still
            drives in the end. Where the boards' process was stopped: from its going on.
        true: Whether nothing that the host said of a board's duty was wrong.
        orphans: Number of processes that are left in the end.
    """

    trial: MatrixTrial
    moving: int
    told: float
    words: str
    leaked: int
    active: bool
    cycles: float
    zero: float = 0.0
    true: bool = True
    orphans: int = 0


def deal_matrix(seeds: list[int], quick: bool) -> list[MatrixTrial]:
    """Return the trials of all cells.

    Args:
        seeds: Seeds of each cell; faults of `OFTEN` get four of each.
        quick: Whether each fault is tried in one state only.
    """
    trials: list[MatrixTrial] = []
    for number, fault in enumerate(FAULTS):
        for state in STATES if not quick else [STATES[number % len(STATES)]]:
            turns = 4 if fault in OFTEN and not quick else 1
            trials += [MatrixTrial(fault, state, s + t) for s in seeds for t in range(turns)]
    return trials


def run_matrix_trial(trial: MatrixTrial) -> MatrixResult:
    """Let a host drive, let the fault happen, and look at the boards and the host's words.

    Raises:
        ExperimentError: If the robot stops again and again without a fault.
    """
    rng = np.random.default_rng(trial.seed)
    said = ""
    for _ in range(_TRIES):
        before = set(_descendants(os.getpid()))
        with contextlib.ExitStack() as opened:
            bench = _Bench(trial, opened)
            bench.until(time.monotonic() + float(rng.uniform(*LEAD)))
            started = set(_descendants(os.getpid())) - before
            said = bench.stopped  # A busy machine may do that.
            result = None if said else bench.act(int(rng.choice(ADDRESSES)))
        if result is not None:
            end = time.monotonic() + _ENDING
            while any(map(_alive, started)) and time.monotonic() < end:
                time.sleep(0.01)
            return dataclasses.replace(result, orphans=sum(map(_alive, started)))
    raise ExperimentError(f"the robot stops before the fault: {said}")


class _Bench:
    """Boards and a host that drives them."""

    def __init__(self, trial: MatrixTrial, opened: contextlib.ExitStack) -> None:
        self._trial = trial
        self._said: list[dict[str, Any]] = []
        self._host = subprocess.Popen(
            [sys.executable, "-m", "experiments.appd.boards.host"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            bufsize=1,
        )
        opened.callback(self._end_host)
        self._output = cast("IO[str]", self._host.stdout)
        self._input = cast("IO[str]", self._host.stdin)
        self._robot, scene, state = "rover1", SceneConfig((RobotPlacement("rover1"),)), None
        if trial.state == "insertion":
            self._robot = SLAVE
            scene, physics = insertion_start()
            state = Path(opened.enter_context(tempfile.TemporaryDirectory())) / "state.npy"
            np.save(state, physics)
        self._emulator = EmulatorProcess(scene, state=state, patience=_PATIENCE)
        opened.callback(self._emulator.close)
        truth = self._truth()
        ports = cast("dict[str, str | int]", self._emulator.ports[self._robot])
        order = HostOrder(self._robot, ports, truth["arm_angles"], trial.state)
        self._input.write(json.dumps(dataclasses.asdict(order)) + "\n")
        started = self._hear(_PATIENCE)
        if started is None or "active" not in started:
            self._said.append(started or {"refused": "no answer"})
        self._emulator.run()

    @property
    def stopped(self) -> str:
        """What the host said of a start that failed or a stop so far; empty for nothing."""
        return str(self._said[0]) if self._said else ""

    def _truth(self) -> RobotTruth:
        return self._emulator.state()[self._robot]

    def _hear(self, wait: float) -> dict[str, Any] | None:
        """Return the next line of the host within `wait` [s]."""
        if not select.select([self._output], [], [], wait)[0]:
            return None
        line = self._output.readline()
        return json.loads(line) if line else None

    def until(self, end: float) -> None:
        """Listen to the host until a time [s]."""
        while (left := end - time.monotonic()) > 0.0:
            words = self._hear(left)
            if words is not None:
                self._said.append(words)
            elif self._host.poll() is not None:
                time.sleep(left)

    def act(self, address: int) -> MatrixResult:
        """Let the trial's fault happen, to the board at this address if it is one board's."""
        if self._trial.fault in RIDES:
            return self._ride_out()
        if self._trial.fault in BOARD_SIGNALS:
            return self._lose_boards()
        return self._strike(address)

    def _strike(self, address: int) -> MatrixResult:
        """Let the line or the host fail."""
        fault, before = self._trial.fault, self._truth()
        at, begin = time.monotonic(), before["time"]
        if fault in HOST_SIGNALS:
            self._host.send_signal(HOST_SIGNALS[fault])
        else:
            self._emulator.inject(self._robot, LINE_FAULTS[fault].value, address=address)
            at, begin = time.monotonic(), self._emulator.time
        self.until(at + AFTER)
        truth = self._truth()
        lasting = _lasting(truth, begin)
        if fault == "host_stopped":
            self._host.send_signal(signal.SIGCONT)
            self.until(time.monotonic() + AFTER)
            truth = self._truth()
        result = self._conclude(_moving(before), at)
        return dataclasses.replace(
            result,
            zero=float("inf") if any(truth["codes"]) else max(0.0, *lasting.values()),
            true=_is_true(result, _lasting(truth, begin)),
        )

    def _lose_boards(self) -> MatrixResult:
        """Kill or stop the process of the boards, and let a stopped one go on later."""
        before, at = self._truth(), time.monotonic()
        os.kill(self._emulator.process, BOARD_SIGNALS[self._trial.fault])
        self.until(at + AFTER)
        zero = 0.0
        if self._trial.fault == "boards_stopped":
            os.kill(self._emulator.process, signal.SIGCONT)
            begin = self._truth()["time"]
            self.until(time.monotonic() + AFTER)
            zero = max(0.0, *_lasting(self._truth(), begin).values())
        result = self._conclude(_moving(before), at)
        true = "zero confirmed" not in result.words and bool(result.words)
        return dataclasses.replace(result, zero=zero, true=true)

    def _ride_out(self) -> MatrixResult:
        """Let a short fault, if any, come again and again."""
        at, before = time.monotonic(), self._truth()
        for turn in range(TIMES):
            if self._trial.fault != CONTROL:
                self._emulator.inject(self._robot, TRANSIENTS[self._trial.fault].value, PERIOD)
            self.until(at + (turn + 1) * PAUSE)
        result = self._conclude(_moving(before), at)
        # A deadline that is missed is a cycle that was not done.
        return dataclasses.replace(result, cycles=1.0 - result.cycles * PERIOD / (TIMES * PAUSE))

    def _conclude(self, moving: int, at: float) -> MatrixResult:
        """End the host, and return what it said since a time."""
        with contextlib.suppress(BrokenPipeError):
            self._input.write("\n")
        end: dict[str, Any] = {}
        while (words := self._hear(_PATIENCE)) is not None:
            end |= words
        errors = [words for words in self._said if "error" in words]
        return MatrixResult(
            self._trial,
            moving=moving,
            told=errors[0]["at"] - at if errors else float("nan"),
            words=str(errors[0]["error"]) if errors else "",
            leaked=int(end.get("leaked", 0)),
            active=bool(end.get("active", False)),
            cycles=float(end.get("misses", 0)),
        )

    def _end_host(self) -> None:
        self._host.kill()
        self._host.wait()
        for stream in (self._input, self._output):
            with contextlib.suppress(BrokenPipeError):
                stream.close()


def _moving(truth: RobotTruth) -> int:
    """Return how many boards drive a motor."""
    codes = truth["codes"]
    return sum(any(codes[first : first + 2]) for first in range(0, len(codes), 2))


def _lasting(truth: RobotTruth, begin: float) -> dict[str, float]:
    """Return for how long after a time each board drove a motor, by address [s]."""
    return {address: when + PERIOD - begin for address, when in truth["driven"].items()}


def _is_true(result: MatrixResult, lasting: dict[str, float]) -> bool:
    """Return whether what the host said of the boards' duties is so."""
    found = re.search(r"boards (.*)$", result.words)
    if found is None:
        return result.trial.fault in HOST_SIGNALS and not result.words
    for group in found[1].split("; "):
        last = [lasting[each] for each in re.findall(r"0x\w+", group)]
        if "not reached" in group and result.trial.fault != "unplugged":
            return False
        # The others stop by themselves. A fault begins amid a tick, and a duty is seen once a tick.
        most = result.told + (2.0 * PERIOD if "zero confirmed" in group else WITHIN)
        if last and max(last) > most:
            return False
    return True


@functools.cache
def insertion_start() -> tuple[SceneConfig, FloatArray]:
    """Return a scene of ``ch5-insertion`` and the state of its physics with the card half in.

    Raises:
        ExperimentError: If the card does not get there.
    """
    setting = prepare(InsertionTrial(CARD_AND_SLOT.slot_widths[-1], True, 1))
    depth = setting.team.slave.inserter.config.guide.depth
    with contextlib.closing(setting.simulation) as simulation:

        def half_in() -> bool:
            return card_in_slot(simulation.data)[1] > _DEPTH * depth

        run(setting.robots, [setting.team], simulation, duration=60.0, until=half_in)
        if not half_in():
            raise ExperimentError("the card of the stored insertion does not get into the slot")
        field, robots = place_insertion(setting.scene)
        return SceneConfig(robots, field), simulation.save().physics


def _descendants(process: int) -> list[int]:
    """Return all processes below one."""
    own: list[int] = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            own += [int(word) for word in task.read_text().split()]
    return own + [below for each in own for below in _descendants(each)]


def _alive(process: int) -> bool:
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"
