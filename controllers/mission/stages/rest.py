"""A stage in which a robot keeps its arm at home and waits for the other."""

from controllers.mission.belief import MissionBelief
from controllers.motion.arm_move import ArmMove
from twin.robot import Command, Observation


class Rest:
    """Brings the arm home and keeps it there.

    Args:
        belief: What the robot believes.
        name: Name of the stage.

    Attributes:
        done: Always true: the other robot's part ends the stage.
    """

    done = True

    def __init__(self, belief: MissionBelief, name: str) -> None:
        assert belief.robot.arm is not None
        self.name = name
        self._move = ArmMove(belief.robot.arm.home)

    def step(self, seen: Observation) -> Command:
        """Return where the arm goes."""
        return self._move.command(seen)
