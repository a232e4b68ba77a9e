"""Stage ``identify``, chapter 2: a rover swings its arm and identifies its pitch dynamics."""

import numpy as np

from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from controllers.mission.belief import MissionBelief
from twin.robot import Command, Observation


class SwingArm:
    """Swings the arm, and fits all measurements again at the end.

    Args:
        belief: Estimates of the robot; updated with its pitch dynamics.
        rng: Random generator for the planner of the excitation.
    """

    name = "identify"

    def __init__(self, belief: MissionBelief, rng: np.random.Generator) -> None:
        assert belief.robot.arm is not None
        self._belief = belief
        config = RoverIdentifierConfig(belief.robot.name, SwingingArm.of(belief.robot.arm))
        self._identifier = RoverIdentifier(config, rng)

    @property
    def done(self) -> bool:
        """Whether the pitch dynamics are identified."""
        return self._belief.pitch is not None

    def step(self, seen: Observation) -> Command:
        """Return the command of the swing; at its end hold the arm and fit, a step each tick."""
        name = self._belief.robot.name
        if not self._identifier.done:
            return self._identifier.step({name: seen})[name]
        if not self.done and self._identifier.conclude():
            self._belief.pitch = self._identifier.fit.estimate
        return self._identifier.hold()[name]
