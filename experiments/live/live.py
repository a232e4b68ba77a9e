"""``live``: the twin beside a rover: what it did not expect, and what has changed.

It reads the log of whoever drives the rover, or owns the rover and lends it to a person's hand.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress, TextColumn, TimeElapsedColumn

from controllers.motion.teleoperation import Teleoperation
from controllers.sensing.consequences import Consequence, consequence_of
from controllers.sensing.diagnosis import Finding
from controllers.sensing.probing import probe, probes
from experiments.harness.contract import ExperimentError
from experiments.harness.figure_style import use_style
from experiments.harness.live_viewer import LiveViewer
from experiments.live.drive import LONGEST, DrivePage, hand_of, paced, served, told_to_end
from experiments.live.live_options import Options
from experiments.live.page_server import PageServer
from experiments.live.twin_beside import Named, TwinBeside, placement_of
from experiments.live.twin_folder import TwinFolder, next_run, take
from experiments.live.twin_process import TwinProcess
from experiments.live.twin_watch import Watch
from twin.clock import Clock
from twin.logs.log import LogError
from twin.logs.ticks import TickStream
from twin.logs.writing import LogWriter
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop
from twin.robot import Robot, RobotError

SLOWER = 0.5
"""Share of a person's speeds that is left after some changes, until the rover is activated anew."""
_LET_GO = 0.5  # Time after which a motion that was not asked for again begins anew [s].
_LOOK = 0.1  # Wall time between two looks at a log that is written [s].


def run(options: Options) -> int:
    """Run the twin beside a log or a rover; return the exit status.

    Raises:
        ExperimentError: If the log cannot be used, another run has the folder, or nothing can be
            written.
        OptionError: If the rover cannot be as fast, its calibration cannot be used, or the port is
            taken.
    """
    if options.log is not None:
        read(options, options.log)
    else:
        own(options)
    return 0


def read(options: Options, log: Path) -> None:
    """Run the twins of a log's rovers.

    Raises:
        ExperimentError: If it cannot be used, another run has the folder, or nothing can be
            written.
    """
    use_style()
    with told_to_end() as ended, ExitStack() as stack:

        def more() -> bool:
            time.sleep(_LOOK)
            return options.follow and not ended.is_set()

        stream = TickStream(log, more)
        watches: dict[str, Watch] = {}
        viewers: list[LiveViewer] = []
        there: set[str] = set()
        columns = (TextColumn("beside the log, at {task.description}"), TimeElapsedColumn())
        progress = stack.enter_context(Progress(*columns, transient=True))
        task = progress.add_task("its beginning", total=None)
        try:
            for tick in stream:
                if ended.is_set():
                    break
                there.add(tick.robot)
                if options.name in ("", tick.robot):
                    if tick.robot not in watches:
                        watch, path = _watch(stream, tick.robot, options, stack)
                        watches[tick.robot] = watch
                        if options.live:
                            viewers.append(stack.enter_context(closing(LiveViewer(path))))
                    watches[tick.robot].step(tick)
                    progress.update(task, description=f"{tick.seen.time:.1f} s")
        except LogError as error:
            if not (options.follow and ended.is_set()):
                raise ExperimentError(str(error)) from None
        except ValueError as error:
            raise ExperimentError(f"{log}: {error}") from None
        progress.stop()
        if not any(watch.found for watch in watches.values()):
            known = ", ".join(sorted(there)) or "none"
            wanted = f"no rover {options.name!r}" if options.name else "no rover of ours"
            raise ExperimentError(f"{log}: {wanted} that measures; there are {known}")
        for watch in watches.values():
            watch.close({})
        for viewer in viewers:
            viewer.finish()
            viewer.stay()


def _watch(
    stream: TickStream, robot: str, options: Options, stack: ExitStack
) -> tuple[Watch, Path]:
    """Return the twin of one of a log's rovers, and its recording; several have a folder each."""
    several = stream.settings is not None and len(stream.settings.robots) > 1
    out = options.out / robot if several and not options.name else options.out
    placed = placement_of(stream.settings, robot)
    twin = TwinBeside(placed, options.learning, rough=options.rough)
    stack.callback(twin.close)
    stack.enter_context(take(out))
    folder = stack.enter_context(closing(TwinFolder(out, new=True)))
    recording = out / "live.rrd"
    return Watch(folder, twin, placed, recording), recording


def own(options: Options) -> None:
    """Own a rover, lend it to a person's hand, and keep its history.

    Raises:
        ExperimentError: If another run has the folder, or its history cannot be read or written.
        OptionError: If the rover cannot be as fast, its calibration cannot be used, or the port is
            taken.
        RobotError: If the rover could not be stopped.
    """
    with served(options) as (connection, server, ended), ExitStack() as stack:
        (robot,) = connection.robots.values()
        hand = hand_of(robot, options)
        placed = placement_of(connection.settings, robot.name)
        stack.enter_context(take(options.out))
        number, mended = next_run(options.out)
        if np.isfinite(mended):
            print(f"the run before was killed; its log was completed, up to {mended:.2f} s")
        twin = TwinProcess(placed, options.out, number, options.learning, options.rough)
        stack.callback(twin.close)
        twin.wait()
        path = options.out / f"run-{number:03d}"
        log = stack.enter_context(LogWriter(path.with_suffix(".mcap"), connection.settings))
        if options.live:
            viewer = LiveViewer(path.with_suffix(".rrd"))
            stack.enter_context(closing(viewer))
        page = OwnPage(server, robot, hand, options.speed, twin)
        recorders, clock = [page, log, twin], paced(connection)
        while not ended():
            look_on(robot, clock, recorders, lambda: ended() or page.wanted)
            if ended():
                break
            try:
                run_loop(
                    connection.robots, [hand], clock, recorders, LONGEST,
                    lambda: ended() or not page.wanted,
                )  # fmt: skip
            except RobotError as error:
                page.stop(str(error))


def look_on(
    robot: Robot, clock: Clock, recorders: Sequence[LoopRecorder], until: Callable[[], bool]
) -> None:
    """Record what a rover measures that is not active, until a condition holds.

    Nothing is applied to it, which leaves its twin out, too: an arm that rests on its stops tells
    nothing.

    Args:
        robot: The rover.
        clock: Its clock.
        recorders: Recorders of every tick.
        until: Condition, evaluated after each tick.
    """
    step = 0
    while not until():
        tick = Tick(step, clock.time, {robot.name: robot.observe()}, {})
        for recorder in recorders:
            recorder.record(tick)
        clock.tick()
        step += 1


class OwnPage(DrivePage):
    """Shows also what the twin finds, and asks a person to activate the rover.

    Args:
        server: Server of the page.
        robot: The rover.
        hand: Controller that the person drives with.
        speed: Largest speed [m/s].
        twin: The twin.

    Attributes:
        wanted: Whether the person wants the rover to be active.
    """

    def __init__(
        self,
        server: PageServer,
        robot: Robot,
        hand: Teleoperation,
        speed: float,
        twin: TwinProcess,
    ) -> None:
        super().__init__(server, robot, hand, speed)
        self._robot, self._twin, self._hand = robot, twin, hand
        self.wanted, self._why, self._heeded = False, "", 0
        self._time, self._begun, self._asked = 0.0, 0.0, -np.inf

    def record(self, tick: Tick) -> None:
        """Do also what the changes call for that were named."""
        super().record(tick)
        self._time = tick.time
        for each in self._named[self._heeded :]:
            self._heed(each)
        self._heeded = len(self._named)

    @property
    def _named(self) -> Sequence[Named]:
        return self._twin.state.named if self._twin.state is not None else ()

    @property
    def _probed(self) -> Finding | None:
        """The latest change, if a motion tells more of it."""
        latest = self._named[-1].finding if self._named else None
        return latest if latest is not None and probes(latest) else None

    def _heed(self, named: Named) -> None:
        """Hold still, or go on slower, as a change calls for."""
        consequence, why = consequence_of(named.finding, self._robot.description)
        if consequence is Consequence.STOP:
            self._hand.pace, self._why = 0.0, f"holds still, as {why}; activate it anew to go on"
        elif consequence is Consequence.SLOWER and self._hand.pace > 0.0:
            self._hand.pace, self._why = SLOWER, f"slower, as {why}"

    def take(self, told: Mapping[str, Any]) -> None:
        """Take what a person asked for."""
        found = self._probed
        if told.get("identify") and found is not None:
            if self._time > self._asked + _LET_GO:
                self._begun = self._time
            self._asked = self._time
            self._hand.ask(*probe(found, self._robot.description, self._time - self._begun))
        else:
            super().take(told)
        if "activate" in told:
            self.wanted, self._why = told["activate"], ""
            self._hand.reset()

    def stop(self, why: str) -> None:
        """Let the rover be inactive until a person activates it again."""
        self.wanted, self._why = False, why

    def more(self) -> Mapping[str, Any]:
        """Return the rover's state, and what the twin found."""
        found = self._twin.state
        said = "the twin is gone" if not self._twin.alive else "the twin waits for the rover"
        named: Sequence[str] = ()
        if found is not None and self._twin.alive:
            doing = "learns the rover" if found.learning else "looks for changes"
            said = f"the twin {doing}; innovations {found.surprise:.2f} of what it states"
            named = [str(each) for each in found.named]
        state = self._robot.lifecycle.value
        probed = self._probed.name if self._probed is not None else ""
        return {
            "active": self.wanted, "lifecycle": state, "why": self._why, "twin": [said, *named],
            "identify": probed,
        }  # fmt: skip
