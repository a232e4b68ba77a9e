"""The twin in a process of its own, beside the one that drives a rover."""

import contextlib
import math
import multiprocessing as mp
import os
import queue
import signal
import time
from multiprocessing.connection import Connection as Pipe
from pathlib import Path
from typing import NamedTuple

import threadpoolctl

from experiments.harness.contract import ExperimentError
from experiments.harness.figure_style import use_style
from experiments.live.twin_beside import LOOKING, TwinBeside
from experiments.live.twin_folder import TwinFolder
from experiments.live.twin_watch import TwinState, Watch
from models.compose import RobotPlacement
from twin.hardware.background import end_with_parent
from twin.logs.ticks import RoverTick
from twin.loop import LoopRecorder, Tick
from twin.robot import MISSING, Channel, ImageChannel
from twin.servo import SERVO_PERIOD

WAITING = 400
"""Ticks that may wait for the twin; what comes then is left out."""
_CONTEXT = mp.get_context("spawn")
_LONGEST = 120.0  # Wait for the twin's figures at the end [s].
_LOOK = 0.5  # Wall time between two looks whether a twin that is waited for is gone [s].


class Timed(NamedTuple):
    """A tick on its way to the twin.

    Attributes:
        tick: The tick.
        sent: Wall time at which it was over [s], monotonic.
        lost: Ticks before it that the twin had no time for.
    """

    tick: RoverTick
    sent: float
    lost: int


def handed_on(pair: Channel, latest: float) -> Channel:
    """Return a pair of images that the twin may look at, else that there is none.

    Those that whoever drives has not looked at would be drawn or fetched while the rover waits.

    Args:
        pair: The latest pair.
        latest: Stamp of the one that was handed on last [s].
    """
    read = isinstance(pair, ImageChannel) and pair.drawn
    return pair if read and pair.stamp >= latest + LOOKING else MISSING


class TwinProcess(LoopRecorder):
    """Hands the ticks of a rover to its twin, and never waits for it while the rover is driven.

    `wait` first, and `close` at the end, when the twin writes its figures.

    Args:
        placed: The rover; its name and what it carries.
        folder: Folder of its history.
        number: Number of the run.
        learning: Time for which the rover is only learned [s].
        rough: Whether the ground is uneven, as of `TwinBeside`.

    Attributes:
        state: What the twin told last; None before it told anything.
    """

    def __init__(
        self,
        placed: RobotPlacement,
        folder: Path,
        number: int,
        learning: float,
        rough: bool = False,
    ) -> None:
        self._robot = placed.name
        self._ticks: mp.Queue[Timed | None] = _CONTEXT.Queue(WAITING)
        self._told, tells = _CONTEXT.Pipe(duplex=False)
        words = (placed, folder, number, learning, rough, self._ticks, tells, os.getpid())
        self._process = _CONTEXT.Process(target=_beside, args=words, daemon=True)
        self._process.start()
        tells.close()
        self.state: TwinState | None = None
        self._lost, self._pair = 0, -math.inf

    @property
    def alive(self) -> bool:
        """Whether the twin still runs."""
        return self._process.is_alive()

    def record(self, tick: Tick) -> None:
        """Hand on a tick in which the rover is active, and take what the twin told."""
        self._take()
        if self._robot not in tick.applied:
            return
        seen = tick.observations[self._robot]
        seen = seen._replace(stereo=handed_on(seen.stereo, self._pair))
        if seen.stereo.usable:
            self._pair = seen.stereo.stamp
        taken = RoverTick(self._robot, seen, tick.applied[self._robot])
        try:
            self._ticks.put_nowait(Timed(taken, time.monotonic(), self._lost))
        except queue.Full:
            self._lost += 1

    def wait(self) -> None:
        """Wait until the twin can take ticks.

        Raises:
            ExperimentError: If it cannot, with the reason.
        """
        while not self._told.poll(_LOOK):
            if not self.alive:
                raise ExperimentError("the twin's process ended before it began")
        refused = self._told.recv()
        if refused is not None:
            raise ExperimentError(refused)

    def close(self) -> None:
        """Let the twin take what waits and write its figures."""
        if self.alive:
            with contextlib.suppress(queue.Full):
                self._ticks.put(None, timeout=_LONGEST)
            self._process.join(_LONGEST)
        self._take()
        if self.alive:
            self._process.kill()
        self._ticks.cancel_join_thread()
        self._ticks.close()

    def _take(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while self._told.poll():
                self.state = self._told.recv()


def _beside(
    placed: RobotPlacement,
    path: Path,
    number: int,
    learning: float,
    rough: bool,
    ticks: "mp.Queue[Timed | None]",
    tells: Pipe,
    parent: int,
) -> None:
    """Run the twin until there are no more ticks; the process's main function."""
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # The rover is to be stopped first.
    use_style()
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(contextlib.closing(TwinFolder(path, new=False)))
            begin = time.time() - folder.began
            twin = TwinBeside(placed, learning, begin, folder.memory, rough=rough)
            stack.callback(twin.close)
            watch = Watch(folder, twin, placed, path / f"run-{number:03d}.rrd")
        except (ExperimentError, ValueError, OSError) as error:
            tells.send(str(error))
            return
        tells.send(None)
        # Of matrices so small, threads wait for each other longer than one takes.
        stack.enter_context(threadpoolctl.threadpool_limits(1))
        missed, lost, count = 0, 0, 0
        for timed in iter(ticks.get, None):
            changed = watch.step(timed.tick)
            count += 1
            lost = timed.lost
            missed += time.monotonic() - timed.sent > SERVO_PERIOD
            if changed:
                tells.send(watch.state)
        count += lost
        share = (missed + lost) / max(1, count)
        watch.close({"ticks": count, "deadline_miss_fraction": share})
