"""Stage ``insert``, chapter 5: the master guides, the slave inserts the card."""

import dataclasses

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig, InsertionStage
from controllers.insertion.guidance import KINDS, Guidance, GuidanceLink
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    guide_config,
    marker_guide,
    seating_config,
    surrogate_sensing,
)
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.mission.radio import MissionRadio, RadioPort, SlotPose
from controllers.mission.stage import StageError
from controllers.motion.arm_move import ArmMove
from controllers.motion.base_tilt import BaseTilt
from twin.robot import Command, Observation

_GUIDED = (InsertionStage.WAIT, InsertionStage.APPROACH, InsertionStage.ALIGN)


class GuideInsertion:
    """The master's part: it aims its camera at card and slot, and sends guidance.

    Args:
        belief: Estimates of the master.
        radio: The master's end of the radio.
        transform_card_to_slave: Pose of the card in the slave's frame, with its arm at home.
        occluders: Whether what is mapped is taken into account.

    Attributes:
        done: Always true: the slave's part ends the stage.
    """

    name = "insert"
    done = True

    def __init__(
        self,
        belief: MissionBelief,
        radio: MissionRadio,
        transform_card_to_slave: RigidTransform,
        occluders: bool = True,
    ) -> None:
        self._belief, self._radio, self._card = belief, radio, transform_card_to_slave
        self._occluders = occluders
        self._port = RadioPort(radio, KINDS)
        self._master: InsertionMaster | None = None
        self._move = ArmMove(belief.home, guard=belief.navigator.tip_guard)

    @property
    def sent(self) -> Guidance | None:
        """Guidance sent in this tick; None without a new one."""
        return None if self._master is None else self._master.sent

    def step(self, seen: Observation) -> Command:
        """Move the arm to its initial pose of the insertion, then guide."""
        self._belief.navigator.observe(seen)
        partner = self._radio.partner
        if self._master is None and partner.slot is not None:
            self._master, self._move = self._begin(seen, partner.slot)
        if self._master is not None and self._radio.ready and partner.ready:
            return self._master.step(seen)
        self._port.poll()  # Questions of before are not answered.
        command = self._move.command(seen)
        self._radio.ready = self._master is not None and self._move.is_there(seen)
        return command

    def _begin(self, seen: Observation, slave: SlotPose) -> tuple[InsertionMaster, ArmMove]:
        belief, name = self._belief, self._belief.robot.name
        tilt = tilt_of(seen, name)
        slot, card = belief.slot_in_robot(tilt), belief.card_in_robot(tilt, slave, self._card)
        middle = 0.5 * (slot[0].translation + card.translation)
        start = aim(camera_arm(belief.robot)[0], middle, belief.home)
        about = belief.surroundings(slot[0]) if self._occluders else None
        guide = marker_guide(
            belief.robot, belief.site.insertion, slot, card, start, placed=True, about=about
        )
        master = InsertionMaster(name, guide, GuidanceLink(self._port))
        move = ArmMove(guide.begin(), speed=0.5, guard=belief.navigator.tip_guard)
        return master, move


class InsertCard:
    """The slave's part: it moves the card to the slot and inserts it.

    While nothing is heard from the master, it stands still, unless force guides the card already.

    Args:
        belief: Estimates of the slave.
        radio: The slave's end of the radio.
        watched: Whether it goes by what the master sees; else by its own map alone.

    Attributes:
        slave: The slave's part of the insertion.
    """

    name = "insert"

    def __init__(self, belief: MissionBelief, radio: MissionRadio, watched: bool = True) -> None:
        robot, drawing = belief.robot, belief.site.insertion
        arm, springs = CardArm(robot, drawing.tip), belief.springs()
        inserter = CardInserter(
            CardInserterConfig(
                guide_config(drawing, springs[0]), seating_config(drawing), watched=watched
            ),
            arm,
            belief.navigator.steer(),
            *belief.slot_in_level(),
            BaseTilt(*springs, arm.mount),
        )
        sensing = surrogate_sensing(robot, drawing.tip, springs)
        self._link = GuidanceLink(RadioPort(radio, KINDS))
        self.slave = InsertionSlave(robot.name, inserter, sensing, self._link)
        self._belief, self._radio = belief, radio
        self._move = ArmMove(belief.home, guard=belief.navigator.tip_guard)
        self._begun = False
        self._held = Command()

    @property
    def done(self) -> bool:
        """Whether the card is inserted."""
        return self.slave.inserter.stage is InsertionStage.DONE

    def step(self, seen: Observation) -> Command:
        """Move the arm to its initial pose of the insertion, then insert.

        Raises:
            StageError: If the insertion has failed.
        """
        self._belief.navigator.observe(seen)
        inserter = self.slave.inserter
        if not self._begun:
            self._link.receive(seen.time)  # Discard guidance from before the stage.
            self._held = self._move.command(seen)
            self._begun = self._move.is_there(seen) and self._radio.partner.ready
            self._radio.ready = self._begun
            if not self._begun:
                self._radio.wait()
            return self._held
        if self._radio.silent and inserter.stage in _GUIDED:
            self._link.receive(seen.time)
            self._radio.wait()
            return dataclasses.replace(
                self._held, wheels=np.zeros(4), arm_rates=np.zeros_like(self._held.arm_rates)
            )
        self._held = self.slave.step(seen)
        if inserter.stage is InsertionStage.FAILED:
            raise StageError(self.name, inserter.reason)
        return self._held
