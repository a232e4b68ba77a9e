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
    """Swings the arm, and fits all measurements again at the end; if it fails, swings gently.

    Args:
        belief: Estimates of the robot; updated with its pitch dynamics if they can be believed.
        rng: Random generator for the planner of the excitation.

    Attributes:
        done: Whether an identification succeeded, or the last has failed.
    """

    name = "identify"

    def __init__(self, belief: MissionBelief, rng: np.random.Generator) -> None:
        self.done = False
        self._belief = belief
        config = RoverIdentifierConfig(belief.robot.name, SwingingArm.of(belief.robot))
        self._identifier = RoverIdentifier(config, rng)

    def step(self, seen: Observation) -> Command:
        """Return the command of the swing; at its end hold the arm and fit, a step each tick."""
        self._belief.navigator.observe(seen)
        name = self._belief.robot.name
        if not self._identifier.done:
            return self._identifier.step({name: seen})[name]
        command = self._identifier.hold()[name]
        if not self.done and self._identifier.conclude():
            self._judge()
        return command

    def _judge(self) -> None:
        belief = self._belief
        belief.identification = estimate = self._identifier.fit.estimate
        belief.doubts = estimate.doubts(self._identifier.config.prior)
        if belief.doubts and self._identifier.repeat():
            return
        self.done = True
        if not belief.doubts:
            belief.pitch = estimate
