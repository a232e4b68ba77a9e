"""Stage ``insert``, chapter 5: the master guides, the slave inserts the card."""

from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    guide_config,
    marker_guide_config,
    surrogate_sensing,
)
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.mission.exchange import ArmReady, Exchange
from controllers.mission.stages.find import eyes
from controllers.motion.arm_move import ArmMove
from controllers.motion.base_tilt import BaseTilt, drawn_springs
from twin.robot import Command, Observation


class GuideInsertion:
    """The master's part: it brings its camera to card and slot, and tells what it sees.

    Args:
        belief: What the master believes.
        partner: Name of the slave.
        exchange: All that passes between the robots.
        card_in_partner: From the card to the slave's frame, its arm at home.
        placed: Whether the camera is placed for the task, or looks from where it is.

    Attributes:
        done: Always true: the slave's part ends the stage.
    """

    name = "insert"
    done = True

    def __init__(
        self,
        belief: MissionBelief,
        partner: str,
        exchange: Exchange,
        card_in_partner: RigidTransform,
        placed: bool,
    ) -> None:
        self._belief, self._partner, self._exchange = belief, partner, exchange
        self._card_in_partner, self._placed = card_in_partner, placed
        self._master: InsertionMaster | None = None
        self._move: ArmMove | None = None

    def step(self, seen: Observation) -> Command:
        """Bring the arm to where the insertion begins, then guide."""
        if self._master is None or self._move is None:
            self._master, self._move = self._begin(seen)
        ready = self._exchange.read(self._partner, ArmReady)
        if ready is not None and ready.ready:
            return self._master.step(seen)
        command = self._move.command(seen)
        self._exchange.post(self._belief.robot.name, ArmReady(self._move.is_there(seen)))
        return command

    def _begin(self, seen: Observation) -> tuple[InsertionMaster, ArmMove]:
        belief, robot = self._belief, self._belief.robot
        assert robot.arm is not None
        tilt = tilt_of(seen, robot.name)
        slot, covariance = belief.slot_in_robot(tilt)
        card = belief.card_in_robot(tilt, self._card_in_partner)
        arm = camera_arm(robot)[0]
        config = marker_guide_config(robot, belief.site.insertion, self._placed)
        guide = MarkerGuide(config, arm, eyes(robot), (slot, covariance), card, None)
        middle = 0.5 * (slot.translation + card.translation)
        goal = guide.begin(aim(arm, middle, robot.arm.home))
        link = self._exchange.guidance[robot.name]
        return InsertionMaster(robot.name, guide, link), ArmMove(goal, speed=0.5)


class InsertCard:
    """The slave's part: it brings the card to the slot and inserts it.

    Args:
        belief: What the slave believes.
        partner: Name of the master.
        exchange: All that passes between the robots.

    Attributes:
        slave: The insertion.
    """

    name = "insert"

    def __init__(self, belief: MissionBelief, partner: str, exchange: Exchange) -> None:
        robot, drawing = belief.robot, belief.site.insertion
        assert robot.arm is not None
        arm, springs = CardArm(robot, drawing.tip), belief.springs()
        inserter = CardInserter(
            CardInserterConfig(guide_config(drawing, drawn_springs(robot)[0])),
            arm,
            belief.steer(),
            belief.transform_slot_to_level.as_matrix(),
            belief.slot_covariance,
            BaseTilt(*springs, arm.mount),
        )
        sensing = surrogate_sensing(robot, drawing.tip, springs)
        self._link = exchange.guidance[robot.name]
        self.slave = InsertionSlave(robot.name, inserter, sensing, self._link)
        self._name, self._partner, self._exchange = robot.name, partner, exchange
        self._move, self._begun = ArmMove(robot.arm.home), False

    @property
    def done(self) -> bool:
        """Whether the card is in, or the slave has given up."""
        return self.slave.inserter.over

    def step(self, seen: Observation) -> Command:
        """Bring the arm to where the insertion begins, then insert."""
        if self._begun:
            return self.slave.step(seen)
        self._link.receive()  # What is still on the way from before is too old.
        command = self._move.command(seen)
        ready = self._exchange.read(self._partner, ArmReady)
        if ready is not None and ready.ready and self._move.is_there(seen):
            self._exchange.post(self._name, ArmReady(True))
            self._begun = True
        return command
