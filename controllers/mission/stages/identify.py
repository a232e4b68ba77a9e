"""Stage ``identify``, chapter 2: a rover swings its arm and identifies its pitch dynamics."""

import numpy as np

from controllers.identification.rover_identifier import PitchSwing
from controllers.mission.belief import MissionBelief
from twin.robot import Command, Observation


class SwingArm:
    """Swings the arm until the pitch dynamics are identified, or cannot be.

    Args:
        belief: Estimates of the robot; updated with its pitch dynamics if they can be believed.
        rng: Random generator for the planner of the excitation.
    """

    name = "identify"

    def __init__(self, belief: MissionBelief, rng: np.random.Generator) -> None:
        self._belief, self._swing = belief, PitchSwing(belief.robot, rng)

    @property
    def done(self) -> bool:
        """Whether an identification succeeded, or the last has failed."""
        return self._swing.done

    def step(self, seen: Observation) -> Command:
        """Return the next command."""
        belief, swing = self._belief, self._swing
        belief.navigator.observe(seen)
        name = belief.robot.name
        command = swing.step({name: seen})[name]
        belief.identification, belief.doubts = swing.estimate, swing.doubts
        if swing.done and not swing.doubts:
            belief.pitch = swing.estimate
        return command
