"""Both rovers of ``mission``: stage after stage, each from what the ones before have told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import CardInserter, CardInserterConfig
from controllers.insertion.guidance import GuidanceLink
from controllers.insertion.team import (
    InsertionMaster,
    InsertionSlave,
    InsertionTeam,
    guide_config,
    surrogate_sensing,
)
from controllers.mapping.searching import aim
from controllers.motion.arm_move import ArmMove
from controllers.motion.base_tilt import BaseTilt
from experiments.ch5.insertion_identify import rover_springs
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.mission.knowledge import Knowledge, tilt_of
from experiments.mission.meet import Meet
from experiments.mission.place import GoToStand, choose_stand
from experiments.mission.scene import MASTER, SLAVE, Site
from experiments.mission.stages import (
    HOME,
    FindPanel,
    MapTogether,
    MissionStage,
    Observations,
    SwingArms,
    marker_guide,
    reference_arm,
)
from models.card_and_slot.stand import TIP
from twin.describe import describe_rover
from twin.link import Link
from twin.robot import Command

FloatArray = NDArray[np.float64]

STAGES = ("identification", "mapping", "placement")
"""What a mission can be tried without."""


class InsertCard:
    """Chapter 5: the master watches, the slave inserts."""

    name = "insert"

    def __init__(
        self,
        knowledge: Knowledge,
        width: float,
        placed: bool,
        arm: CardArm,
        links: tuple[GuidanceLink, GuidanceLink],
    ) -> None:
        """Begin.

        Args:
            knowledge: All that was found out.
            width: Of the slot [m].
            placed: Whether the camera is placed for the task, or looks from where it is.
            arm: The slave's, with the card.
            links: Ends of the radio, of the master and of the slave.
        """
        self._knowledge, self._width, self._placed = knowledge, width, placed
        self._arm, self._links = arm, links
        self.team: InsertionTeam | None = None
        self._moves: dict[str, ArmMove] = {}

    @property
    def done(self) -> bool:
        """Whether the card is in, or the slave has given up."""
        return self.team is not None and self.team.slave.inserter.over

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Bring both arms to where the insertion begins, then insert."""
        if self.team is None:
            self.team = self._begin(observations)
        if self._moves:
            commands = {n: m.command(observations[n]) for n, m in self._moves.items()}
            if all(move.is_there(observations[name]) for name, move in self._moves.items()):
                self._moves = {}
            return commands
        return self.team.step(observations)

    def _begin(self, observations: Observations) -> InsertionTeam:
        knowledge = self._knowledge
        tilt = tilt_of(observations[MASTER], MASTER)
        slot, covariance = knowledge.slot_in_master(tilt)
        card = knowledge.card_in_master(tilt, self._arm.card_in_robot(HOME))
        eyes = marker_guide(self._width, slot, covariance, card, self._placed)
        middle = 0.5 * (slot.translation + card.translation)
        goal = eyes.begin(aim(reference_arm(), middle, HOME))
        self._moves = {MASTER: ArmMove(goal, speed=0.5), SLAVE: ArmMove(HOME)}
        inserter = CardInserter(
            CardInserterConfig(guide_config(insertion_drawing(self._width), rover_springs()[0])),
            self._arm,
            knowledge.steer(),
            knowledge.slot_in_slave,
            knowledge.slave_covariance,
            BaseTilt(*knowledge.springs(SLAVE), self._arm.mount),
        )
        sensing = surrogate_sensing(describe_rover(SLAVE, card=True), TIP, knowledge.springs(SLAVE))
        master, slave = self._links
        return InsertionTeam(
            InsertionMaster(MASTER, eyes, master), InsertionSlave(SLAVE, inserter, sensing, slave)
        )


class MissionTeam:
    """Runs the stages; a `twin.robot.Controller`.

    Attributes:
        knowledge: What both know.
        stage: The present one.
        ended: Names of the stages so far and when they ended [s].
    """

    def __init__(
        self,
        site: Site,
        width: float,
        rng: np.random.Generator,
        without: str = "",
        scans: tuple[int, int] = (4, 3),
    ) -> None:
        """Drop both rovers.

        Args:
            site: The drawing.
            width: Of the slot [m].
            rng: Source of randomness.
            without: One of `STAGES` that is left out; empty for none.
            scans: Looks of the master alone, and of each robot when both have met.
        """
        self.knowledge = Knowledge.as_told(site)
        self.ended: list[tuple[str, float]] = []
        self._width, self._rng = width, rng
        self.links: Mapping[str, Link] = {}
        self._without, self._scans = without, scans
        self._arm = CardArm(describe_rover(SLAVE, card=True), TIP)
        self._stages = self._all()
        self.stage: MissionStage = next(self._stages)
        self.over = False

    def reset(self) -> None:
        """Nothing is learnt that a new run could not be made for."""

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Go on with the present stage, or begin the next."""
        if self.stage.done and not self.over:
            time = max(seen.time for seen in observations.values())
            self.ended.append((self.stage.name, time))
            following = next(self._stages, None)
            if following is None:
                self.over = True
            else:
                self.stage = following
        return self.stage.step(observations)

    @property
    def insertion(self) -> InsertionTeam | None:
        """The last stage's team, once it has begun."""
        return self.stage.team if isinstance(self.stage, InsertCard) else None

    def _all(self) -> Iterator[MissionStage]:
        knowledge, width = self.knowledge, self._width
        identify, explore = self._rng.spawn(2)
        if self._without != "identification":
            yield SwingArms(knowledge, identify)
        first, further = self._scans
        if self._without != "mapping":
            yield FindPanel(knowledge, first, explore)
        turns = self._without != "identification"
        links = GuidanceLink(self.links[MASTER]), GuidanceLink(self.links[SLAVE])
        yield Meet(knowledge, width, self._arm, links, turns)
        if knowledge.shared is not None:
            yield MapTogether(knowledge, further, explore)
        placed = self._without != "placement"
        if placed:
            yield GoToStand(knowledge, choose_stand(knowledge, width))
        yield InsertCard(knowledge, width, placed, self._arm, links)
