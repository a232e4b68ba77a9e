"""Clocks of robots that agree neither with each other's nor with the world's."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from models.datasheets import ClockSheet
from twin.robot import Command, Lifecycle, Observation, Robot

_CLOCKS = 13  # Stream of random numbers of a connection's seed.


@dataclasses.dataclass(frozen=True)
class RobotClock:
    """A clock that runs evenly.

    Attributes:
        offset: Its time when the world's is zero [s].
        drift: Its gain on the world's time, as a share of that.
    """

    offset: float
    drift: float

    def read(self, time: float) -> float:
        """Return its time at a time of the world [s]."""
        return self.offset + (1.0 + self.drift) * time


class ClockedRobot:
    """A robot whose observations carry the times of its own clock.

    Args:
        robot: Robot that stamps its observations with the world's time.
        clock: Clock of the robot.
    """

    def __init__(self, robot: Robot, clock: RobotClock) -> None:
        self.name, self.description = robot.name, robot.description
        self._robot, self._clock = robot, clock

    @property
    def fault(self) -> str:
        """Reason for the state ERROR; empty in the other states."""
        return self._robot.fault

    @property
    def lifecycle(self) -> Lifecycle:
        """Current state."""
        return self._robot.lifecycle

    def activate(self) -> None:
        """Activate the robot."""
        self._robot.activate()

    def observe(self) -> Observation:
        """Return the latest observation, with all its times by the robot's clock."""
        time, *channels = self._robot.observe()
        read = self._clock.read
        return Observation(read(time), *(c._replace(stamp=read(c.stamp)) for c in channels))

    def command(self, command: Command) -> Command:
        """Drive, and return the duty that was applied."""
        return self._robot.command(command)

    def deactivate(self) -> None:
        """Zero all axes of the robot and go to INACTIVE."""
        self._robot.deactivate()


def give_clocks(robots: Mapping[str, Robot], clock: ClockSheet, seed: int) -> dict[str, Robot]:
    """Return robots with a clock each, of which a further robot changes none.

    Args:
        robots: Robots by name, in the order of the scene.
        clock: How far a clock is off, at most.
        seed: Random seed of the connection.
    """
    clocked: dict[str, Robot] = {}
    for index, (name, robot) in enumerate(robots.items()):
        rng = np.random.default_rng([seed, _CLOCKS, index])
        own = RobotClock(rng.uniform(0.0, clock.offset), rng.uniform(-clock.drift, clock.drift))
        clocked[name] = ClockedRobot(robot, own)
    return clocked
