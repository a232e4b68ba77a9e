"""A rover that swings its arm, identifies its pitch dynamics, and says whether they are good."""

import numpy as np

from controllers.identification.pitch import PitchEstimate
from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from twin.description import RobotDescription
from twin.robot import Command, Observation


class PitchSwing:
    """Swings the arm, and fits all measurements again at the end; if it fails, swings gently.

    Args:
        robot: The robot as drawn.
        rng: Random generator for the planner of the excitation.

    Attributes:
        done: Whether an identification succeeded, or the last has failed.
        estimate: Latest estimate of the pitch dynamics; None before the first.
        doubts: Why it is not to be used; none if it is.
    """

    def __init__(self, robot: RobotDescription, rng: np.random.Generator) -> None:
        self.done = False
        self.estimate: PitchEstimate | None = None
        self.doubts: tuple[str, ...] = ()
        self._robot = robot.name
        config = RoverIdentifierConfig(robot.name, SwingingArm.of(robot))
        self._identifier = RoverIdentifier(config, rng)

    def step(self, seen: Observation) -> Command:
        """Return the command of the swing; at its end hold the arm and fit, a step each tick.

        Args:
            seen: Observation of the robot.
        """
        if not self._identifier.done:
            return self._identifier.step({self._robot: seen})[self._robot]
        command = self._identifier.hold()[self._robot]
        if not self.done and self._identifier.conclude():
            self.estimate = self._identifier.fit.estimate
            self.doubts = tuple(self.estimate.doubts(self._identifier.config.prior))
            self.done = not (self.doubts and self._identifier.repeat())
        return command
