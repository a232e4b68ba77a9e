"""Stage ``meet``: the master finds the card, and the slave learns how it turns.

The slave turns to and fro before the master's camera and hears how far it truly turned. So both
know where the other is, and the slave what skidding leaves of its turns, without a compass.
"""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.guidance import Guidance
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import marker_guide_config
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.mission.exchange import CardMet, Exchange, SlotPose, TurnShare
from controllers.mission.stages.find import eyes
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_to_pose import DriveToPose
from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.se3 import transport_covariance
from twin.robot import Command, Observation

PERIOD = 0.01
"""Servo tick [s]."""
_VIEWS = 3  # Pairs in a row from which a robot that stands still is believed.
_TURN = 0.5  # Of the slave to and fro, had its wheels only rolled [rad].
_AROUND = ((0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0))
"""Turns of yaw and wrist from where the card should be, to look for it around there [rad]."""
_SPOT = 3.0  # Time for one of them, with the path there [s].
_PATIENCE = 15.0  # Time for each look-out, after which it is given up [s].
_GATE = 30.0  # Squared distance, whitened, beyond which it was not the card.
_STIRRED = np.diag(np.square([0.05, 0.05, _TURN, 0.05, 0.05, 0.02]))
"""Covariance of what a turn to and fro may change of the slot's pose in the robot's frame."""


class FindCard:
    """The master's part: it looks for the card, and says where it sees it.

    Args:
        belief: What the master believes.
        partner: Name of the slave.
        exchange: All that passes between the robots.
        card_in_partner: From the card to the slave's frame, its arm at home.

    Attributes:
        done: Always true: the slave's part ends the stage.
    """

    name = "meet"
    done = True

    def __init__(
        self,
        belief: MissionBelief,
        partner: str,
        exchange: Exchange,
        card_in_partner: RigidTransform,
    ) -> None:
        assert belief.robot.arm is not None
        self._belief, self._partner, self._exchange = belief, partner, exchange
        self._card_in_partner = card_in_partner
        self._arm, self._home = camera_arm(belief.robot)[0], belief.robot.arm.home
        self._guide: MarkerGuide | None = None
        self._around = iter(_AROUND)
        self._ahead, self._looked, self._centred = self._home, 0.0, False
        self._move = ArmMove(self._home)

    def step(self, seen: Observation) -> Command:
        """Look, here and there."""
        if self._guide is None:
            self._guide = self._begin(seen)
        command = self._move.command(seen)
        guidance = None
        if self._move.is_there(seen):
            guidance = self._guide.step(seen)[1]
            if not self._centred and guidance is not None and guidance.card_seen:
                # It shall stay in view while the slave turns.
                self._aim_at(self._guide.card, seen)
                self._centred, guidance = True, None
            elif seen.time > self._looked + _SPOT:
                if self._exchange.read(self._partner, CardMet) is None:
                    self._look_elsewhere(seen)
        self._exchange.guidance[self._belief.robot.name].send(guidance)
        return command

    def _begin(self, seen: Observation) -> MarkerGuide:
        belief = self._belief
        tilt = tilt_of(seen, belief.robot.name)
        card = belief.card_in_robot(tilt, self._card_in_partner)
        self._aim_at(card, seen)
        config = marker_guide_config(belief.robot, belief.site.insertion, placed=False)
        slot = belief.slot_in_robot(tilt)
        return MarkerGuide(config, self._arm, eyes(belief.robot), slot, card, None)

    def _aim_at(self, card: RigidTransform, seen: Observation) -> None:
        """Bring the card into the middle of the view."""
        centre = card.apply([0.0, -self._belief.site.insertion.card_length / 2.0, 0.0])
        self._ahead, self._looked = aim(self._arm, centre, self._home), seen.time
        self._move = ArmMove(self._ahead)

    def _look_elsewhere(self, seen: Observation) -> None:
        """Turn the camera to the next place where the card might be."""
        turns = next(self._around, None)
        if turns is None:
            return
        goal = self._ahead.copy()
        goal[[0, -1]] += turns
        self._move = ArmMove(np.clip(goal, *self._arm.limits.T))
        self._looked = seen.time


class TurnInView:
    """The slave's part: it turns to and fro, and hears how far it truly turned.

    Args:
        belief: Gets the share of a turn, and where the slot is from the slave.
        exchange: All that passes between the robots.
        turns: Whether the slave turns; if not it is only looked for.

    Attributes:
        done: Whether it has turned, or was not seen for too long.
    """

    name = "meet"

    def __init__(self, belief: MissionBelief, exchange: Exchange, turns: bool) -> None:
        assert belief.robot.arm is not None
        self.done = False
        self._belief, self._exchange = belief, exchange
        self._home = belief.robot.arm.home
        arm = CardArm(belief.robot, belief.site.insertion.tip)
        self._card = RigidTransform.from_matrix(arm.card_in_robot(self._home))
        self._pose = SlotPose(belief.transform_slot_to_level, belief.slot_covariance)
        self._rest, self._since = ArmMove(self._home), math.nan
        self._turns = [_TURN, -_TURN] if turns else []
        self._going: DriveToPose | None = None
        self._steer = SkidSteer(belief.robot.wheel_radius, belief.robot.half_track)
        self._rolling = Odometry(self._steer)
        self._heard: list[float] = []
        self._yaws: list[tuple[float, float]] = []

    def step(self, seen: Observation) -> Command:
        """Hear, turn, and hear again."""
        self._rolling.update(seen, PERIOD)
        looks = self._exchange.guidance[self._belief.robot.name].receive()
        if self._going is not None:
            command = self._going.step(seen)
            if not self._going.done:
                return command
            self._going, self._since, self._heard = None, seen.time, []
            self._rest = ArmMove(self._home)
        command = self._rest.command(seen)
        if math.isnan(self._since):
            if self._rest.is_there(seen):
                self._since = seen.time
            return command
        if seen.inclinometer.usable:
            tilt = np.asarray(seen.inclinometer.value, dtype=float)
            self._pose = dataclasses.replace(self._pose, tilt=tilt)
        for look in looks:
            if look.time >= self._since + 1.0 and look.transform_slot_to_card is not None:
                self._hear(look)
        if len(self._heard) >= _VIEWS:
            self._yaws.append((float(np.mean(self._heard)), self._rolling.yaw))
            self._go_on()
        elif seen.time > self._since + _PATIENCE:
            self._end()
        return command

    def _hear(self, look: Guidance) -> None:
        assert look.transform_slot_to_card is not None
        slot = self._card * look.transform_slot_to_card
        covariance = transport_covariance(self._card, look.covariance)
        off = slot * self._pose.transform_slot_to_robot.inv()
        error = np.asarray(off.as_exp_coords())
        expected = self._pose.covariance + covariance + _STIRRED
        if error @ np.linalg.solve(expected, error) > _GATE:
            return  # Something else was taken for the card.
        self._exchange.post(self._belief.robot.name, CardMet())
        forward = look.transform_slot_to_card.inv().rotation.as_matrix()[:, 1]
        self._heard.append(math.atan2(-forward[2], forward[1]))
        self._pose = SlotPose(slot, covariance, self._pose.tilt, met=True)
        self._belief.transform_slot_to_level, self._belief.slot_covariance = slot, covariance

    def _go_on(self) -> None:
        if self._turns:
            self._going = DriveToPose(self._steer, [0.0, 0.0, self._turns.pop(0)])
            return
        if len(self._yaws) > 1:
            seen, rolled = np.abs(np.diff(np.array(self._yaws), axis=0)).sum(axis=0)
            self._belief.turn_share = float(seen / rolled)
            self._exchange.post(self._belief.robot.name, TurnShare(self._belief.turn_share))
        self._end()

    def _end(self) -> None:
        self._exchange.post(self._belief.robot.name, self._pose)
        self.done = True
