"""How the robots of ``mission`` meet: the master finds the card, the slave learns how it turns."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.insertion.card_arm import CardArm
from controllers.insertion.guidance import Guidance, GuidanceLink
from controllers.insertion.marker_guide import MarkerGuide
from controllers.mapping.searching import aim
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_to_pose import DriveToPose
from controllers.motion.driving import Odometry
from experiments.ch5.insertion_identify import rover_steer
from experiments.mission.knowledge import Knowledge, tilt_of
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.stages import HOME, PERIOD, Observations, marker_guide, reference_arm
from models.datasheets import CARD_AND_SLOT
from perception.geometry.se3 import transport_covariance
from twin.robot import Command, Observation

FloatArray = NDArray[np.float64]

_LOOKS = 3  # Pairs in a row from which a robot that stands still is believed.
_TURN = 0.5  # Of the slave to and fro, had its wheels only rolled [rad].
_AROUND = ((0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0))
"""Turns of yaw and wrist from where the card should be, to look for it around there [rad]."""
_SPOT = 3.0  # Time for one of them, the way there included [s].
_GATE = 30.0  # Squared distance, whitened, beyond which it was not the card.
_STIRRED = np.diag(np.square([0.05, 0.05, _TURN, 0.05, 0.05, 0.02]))
"""Covariance of what a turn to and fro may change of the slot's pose in the robot's frame."""


class Meet:
    """The master finds the card; the slave turns to and fro, and hears how far it truly turned.

    So both know where the other is, and the slave what skidding leaves of its turns, without a
    compass.
    """

    name = "meet"

    def __init__(
        self,
        knowledge: Knowledge,
        width: float,
        arm: CardArm,
        links: tuple[GuidanceLink, GuidanceLink],
        turns: bool,
        patience: float = 15.0,
    ) -> None:
        """Begin.

        Args:
            knowledge: Gets the share of a turn, and where the slot is from the slave.
            width: Of the slot [m].
            arm: Of the slave, with the card.
            links: Ends of the radio, of the master and of the slave.
            turns: Whether the slave turns; if not it is only looked for.
            patience: Time for each look-out, after which it is given up [s].
        """
        self.done = False
        self.met = False
        self._knowledge, self._width, self._arm, self._links = knowledge, width, arm, links
        self._marker_guide: MarkerGuide | None = None
        self._master: ArmMove | None = None
        self._slave = ArmMove(HOME)
        self._patience, self._since = patience, math.nan
        self._around = iter(_AROUND)
        self._ahead, self._looked, self._centred = HOME, 0.0, False
        self._turns = [_TURN, -_TURN] if turns else []
        self._going: DriveToPose | None = None
        self._rolling = Odometry(rover_steer())
        self._heard: list[float] = []
        self._yaws: list[tuple[float, float]] = []

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look, turn, and look again."""
        master, slave = observations[MASTER], observations[SLAVE]
        self._rolling.update(slave, PERIOD)
        if self._marker_guide is None:
            self._look_out(master, slave)
        assert self._marker_guide is not None and self._master is not None
        watch = self._master.command(master)
        guidance = None
        if self._master.is_there(master):
            guidance = self._marker_guide.step(master)[1]
            if not self._centred and guidance is not None and guidance.card_seen:
                # It shall stay in view while the slave turns.
                self._aim_at(self._marker_guide.card, master)
                self._centred, guidance = True, None
            elif not self.met and master.time > self._looked + _SPOT:
                self._look_elsewhere(master)
        self._links[0].send(guidance)
        looks = self._links[1].receive()
        return {MASTER: watch, SLAVE: self._answer(slave, looks)}

    def _look_out(self, master: Observation, slave: Observation) -> None:
        tilt = tilt_of(master, MASTER)
        card_in_slave = self._arm.card_in_robot(HOME)
        slot, covariance = self._knowledge.slot_in_master(tilt)
        card = self._knowledge.card_in_master(tilt, card_in_slave)
        self._marker_guide = marker_guide(self._width, slot, covariance, card, plan=False)
        self._aim_at(card, master)

    def _aim_at(self, card: RigidTransform, master: Observation) -> None:
        """Bring the card into the middle of the view."""
        centre = card.apply([0.0, -CARD_AND_SLOT.card_length / 2.0, 0.0])
        self._ahead, self._looked = aim(reference_arm(), centre, HOME), master.time
        self._master = ArmMove(self._ahead)

    def _look_elsewhere(self, master: Observation) -> None:
        """Turn the camera to the next place where the card might be."""
        turns = next(self._around, None)
        if turns is None:
            return
        goal = self._ahead.copy()
        goal[[0, -1]] += turns
        self._master = ArmMove(np.clip(goal, *reference_arm().limits.T))
        self._looked = master.time

    def _answer(self, slave: Observation, looks: list[Guidance]) -> Command:
        if self._going is not None:
            command = self._going.step(slave)
            if not self._going.done:
                return command
            self._going, self._since, self._heard = None, slave.time, []
            self._slave = ArmMove(HOME)
        command = self._slave.command(slave)
        if math.isnan(self._since):
            if self._master is not None and self._slave.is_there(slave):
                self._since = slave.time
            return command
        if slave.inclinometer.usable:
            self._knowledge.slave_tilt = np.asarray(slave.inclinometer.value, dtype=float)
        for look in looks:
            if look.time >= self._since + 1.0 and look.transform_slot_to_card is not None:
                self._hear(look)
        if len(self._heard) >= _LOOKS:
            self._yaws.append((float(np.mean(self._heard)), self._rolling.yaw))
            self._go_on()
        elif slave.time > self._since + self._patience:
            self.done = True
        return command

    def _hear(self, look: Guidance) -> None:
        assert look.transform_slot_to_card is not None
        knowledge = self._knowledge
        card = RigidTransform.from_matrix(self._arm.card_in_robot(HOME))
        slot = card * look.transform_slot_to_card
        spread = transport_covariance(card, look.covariance)
        off = slot * RigidTransform.from_matrix(knowledge.slot_in_slave).inv()
        error = np.asarray(off.as_exp_coords())
        doubt = knowledge.slave_covariance + spread + _STIRRED
        if error @ np.linalg.solve(doubt, error) > _GATE:
            return  # Something else was taken for the card.
        self.met = knowledge.met = True
        forward = look.transform_slot_to_card.inv().rotation.as_matrix()[:, 1]
        self._heard.append(math.atan2(-forward[2], forward[1]))
        knowledge.slot_in_slave = slot.as_matrix()
        knowledge.slave_covariance = spread

    def _go_on(self) -> None:
        if self._turns:
            self._going = DriveToPose(rover_steer(), [0.0, 0.0, self._turns.pop(0)])
            return
        self.done = True
        if len(self._yaws) > 1:
            seen, rolled = np.abs(np.diff(np.array(self._yaws), axis=0)).sum(axis=0)
            self._knowledge.turn_share = float(seen / rolled)
