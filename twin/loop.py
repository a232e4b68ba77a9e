"""The loop: observe, decide, command, record, wait; the same for every kind of robot."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from twin.clock import Clock
from twin.robot import Command, Controller, Lifecycle, Observation, Robot, RobotError

_ERROR = Lifecycle.ERROR


class Tick(NamedTuple):
    """One tick of the loop.

    Attributes:
        step: Number of the tick, from 0.
        time: Robot time [s].
        observations: Observation of each robot, by robot name.
        applied: Duty applied to each robot, after limits, by robot name.
    """

    step: int
    time: float
    observations: Mapping[str, Observation]
    applied: Mapping[str, Command]


class LoopRecorder:
    """Receiver of the ticks of a run; the base of all recorders."""

    def record(self, tick: Tick) -> None:
        """Record one tick."""
        raise NotImplementedError

    def flush(self) -> None:
        """Write everything recorded so far, when a run ends; here nothing is buffered."""


@dataclasses.dataclass(frozen=True)
class RunSummary:
    """Length of a run.

    Attributes:
        duration: Robot time that passed [s].
        wall: Wall time that passed [s].
    """

    duration: float
    wall: float


def run(
    robots: Mapping[str, Robot],
    controllers: Sequence[Controller],
    clock: Clock,
    recorders: Sequence[LoopRecorder] = (),
    duration: float = 10.0,
    until: Callable[[], bool] | None = None,
) -> RunSummary:
    """Run controllers on robots for a while.

    Robots are activated first and, however the run ends, deactivated last; one robot's error
    stops all. Controllers are not reset: that is left to the caller.

    Args:
        robots: Robots by name.
        controllers: Controllers, which get all observations; no two may command the same robot.
        clock: Clock that paces the loop.
        recorders: Recorders of every tick, in this order; they are flushed, not closed.
        duration: Robot time to run for, at most [s].
        until: Condition that ends the run, evaluated after each tick.

    Returns:
        Length of the run.

    Raises:
        RobotError: If a robot fails; an error at the end of the run is a note of the one before.
        ValueError: If a controller commands an unknown robot, or two command the same.
    """
    begin, wall = clock.time, time.perf_counter()
    try:
        for robot in robots.values():
            robot.activate()
        for step in range(round(duration / clock.period)):
            observations: dict[str, Observation] = {}
            for name, robot in robots.items():
                observations[name] = robot.observe()
                if robot.lifecycle is _ERROR:
                    raise RobotError(f"robot {name!r} is in error: {robot.fault}")
            applied: dict[str, Command] = {}
            for controller in controllers:
                for name, command in controller.step(observations).items():
                    if name in applied or name not in robots:
                        raise _wrong_target(name, robots)
                    applied[name] = robots[name].command(command)
            if recorders:
                tick = Tick(step, clock.time, observations, applied)
                for recorder in recorders:
                    recorder.record(tick)
            clock.tick()
            if until is not None and until():
                break
    except BaseException as error:
        try:
            _end(robots, recorders)
        except RobotError as another:
            # The error that ended the run is the one to report.
            error.add_note(f"and at the end: {another}")
        raise
    _end(robots, recorders)
    return RunSummary(clock.time - begin, time.perf_counter() - wall)


def _wrong_target(name: str, robots: Mapping[str, Robot]) -> ValueError:
    if name in robots:
        return ValueError(f"two controllers command robot {name!r}")
    return ValueError(f"a controller commands unknown robot {name!r}; there are {list(robots)}")


def _end(robots: Mapping[str, Robot], recorders: Sequence[LoopRecorder]) -> None:
    """Deactivate every robot and flush, even when one of them cannot be reached any more."""
    errors: list[RobotError] = []
    for robot in robots.values():
        try:
            robot.deactivate()
        except RobotError as error:
            errors.append(error)
    for recorder in recorders:
        recorder.flush()
    if errors:
        raise errors[0]
