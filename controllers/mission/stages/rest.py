"""A stage in which a robot keeps its arm at home and waits for the other."""

from controllers.mission.belief import MissionBelief
from controllers.motion.arm_move import ArmMove
from twin.robot import Command, Observation


class Rest:
    """Moves the arm home and holds it there.

    Args:
        belief: Estimates of the robot.
        name: Name of the stage.

    Attributes:
        done: Always true: the other robot's part ends the stage.
    """

    done = True

    def __init__(self, belief: MissionBelief, name: str) -> None:
        self.name, self._move = name, ArmMove(belief.home)

    def step(self, seen: Observation) -> Command:
        """Return the command of the arm."""
        return self._move.command(seen)
