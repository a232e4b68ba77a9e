"""Stage ``insert``, chapter 5: the master guides, the slave inserts the card."""

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    guide_config,
    surrogate_sensing,
)
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.mission.exchange import ArmReady, Exchange
from controllers.mission.stages.meet import GuidedSlave
from controllers.motion.arm_move import ArmMove
from controllers.motion.base_tilt import BaseTilt, drawn_springs
from twin.robot import Command, Observation


class GuideInsertion:
    """The master's part: it aims its camera at card and slot, and sends guidance.

    Args:
        slave: Slave that holds the card.
        placed: Whether the camera moves to its best view, or keeps its pose.

    Attributes:
        done: Always true: the slave's part ends the stage.
    """

    name = "insert"
    done = True

    def __init__(self, slave: GuidedSlave, placed: bool) -> None:
        self._slave, self._placed, self._name = slave, placed, slave.belief.robot.name
        self._master: InsertionMaster | None = None
        self._move = ArmMove(slave.belief.home)

    def step(self, seen: Observation) -> Command:
        """Move the arm to its initial pose of the insertion, then guide."""
        exchange = self._slave.exchange
        if self._master is None:
            self._master, self._move = self._begin(seen)
        ready = exchange.read(self._slave.name, ArmReady)
        if ready is not None and ready.ready:
            return self._master.step(seen)
        command = self._move.command(seen)
        exchange.post(self._name, ArmReady(self._move.is_there(seen)))
        return command

    def _begin(self, seen: Observation) -> tuple[InsertionMaster, ArmMove]:
        belief, tilt = self._slave.belief, tilt_of(seen, self._name)
        card = belief.card_in_robot(tilt, self._slave.transform_card_to_slave)
        middle = 0.5 * (belief.slot_in_robot(tilt)[0].translation + card.translation)
        start = aim(camera_arm(belief.robot)[0], middle, belief.home)
        guide = self._slave.guide(card, tilt, start, self._placed)
        master = InsertionMaster(self._name, guide, self._slave.exchange.guidance[self._name])
        return master, ArmMove(guide.begin(), speed=0.5)


class InsertCard:
    """The slave's part: it moves the card to the slot and inserts it.

    Args:
        belief: Estimates of the slave.
        partner: Name of the master.
        exchange: Message exchange between the robots.

    Attributes:
        slave: The slave's part of the insertion.
    """

    name = "insert"

    def __init__(self, belief: MissionBelief, partner: str, exchange: Exchange) -> None:
        robot, drawing = belief.robot, belief.site.insertion
        arm, springs = CardArm(robot, drawing.tip), belief.springs()
        inserter = CardInserter(
            CardInserterConfig(guide_config(drawing, drawn_springs(robot)[0])),
            arm,
            belief.steer(),
            belief.transform_slot_to_level,
            belief.slot_covariance,
            BaseTilt(*springs, arm.mount),
        )
        sensing = surrogate_sensing(robot, drawing.tip, springs)
        self._link = exchange.guidance[robot.name]
        self.slave = InsertionSlave(robot.name, inserter, sensing, self._link)
        self._name, self._partner, self._exchange = robot.name, partner, exchange
        self._move, self._begun = ArmMove(belief.home), False

    @property
    def done(self) -> bool:
        """Whether the card is inserted, or the insertion has failed."""
        return self.slave.inserter.over

    def step(self, seen: Observation) -> Command:
        """Move the arm to its initial pose of the insertion, then insert."""
        if self._begun:
            return self.slave.step(seen)
        self._link.receive(seen.time)  # Discard guidance from before the stage.
        command = self._move.command(seen)
        ready = self._exchange.read(self._partner, ArmReady)
        if ready is not None and ready.ready and self._move.is_there(seen):
            self._exchange.post(self._name, ArmReady(True))
            self._begun = True
        return command
