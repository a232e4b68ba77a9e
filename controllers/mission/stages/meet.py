"""Stage ``meet``: the master finds the card, and the slave identifies how it turns.

The slave turns to and fro before the master's camera and receives how far it truly turned. So both
know the other's pose, and the slave the share of turns that skidding leaves, without a compass.
"""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import marker_guide
from controllers.mapping.searching import aim
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.mission.exchange import CardMet, Exchange, SlotPose, TurnShare
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_to_pose import DriveToPose
from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import transport_covariance
from twin.robot import Command, Observation

PERIOD = 0.01
"""Servo tick [s]."""
_VIEWS = 3  # Views of the slave at rest that are averaged.
_TURN = 0.5  # Turn of the slave to and fro, had its wheels only rolled [rad].
_AROUND = ((0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0))
"""Turns of yaw and wrist from where the card should be, to search for it around there [rad]."""
_SPOT = 3.0  # Time for one of them, with the motion there [s].
_PATIENCE = 15.0  # Time to wait for views, after which it is given up [s].
_GATE = 30.0  # Squared distance, whitened, beyond which it was not the card.
_STIRRED = np.diag(np.square([0.05, 0.05, _TURN, 0.05, 0.05, 0.02]))
"""Covariance of what a turn to and fro may change of the slot's pose in the robot's frame."""


@dataclasses.dataclass(frozen=True, eq=False)
class GuidedSlave:
    """The slave, as the master that guides it has it.

    Attributes:
        belief: Estimates of the master.
        name: Name of the slave.
        exchange: All that passes between the robots.
        transform_card_to_slave: Pose of the card in the slave's frame, its arm at home.
    """

    belief: MissionBelief
    name: str
    exchange: Exchange
    transform_card_to_slave: RigidTransform

    def guide(
        self, card: RigidTransform, tilt: FloatArray, angles: FloatArray, placed: bool
    ) -> MarkerGuide:
        """Return the guide that sees card and slot.

        Args:
            card: Rough transform from the card to the tilted master's frame.
            tilt: (2,) pitch and roll of the master [rad].
            angles: (4,) joint angles at which the camera begins [rad].
            placed: Whether the camera is placed anew, or left where it is.
        """
        robot, drawing = self.belief.robot, self.belief.site.insertion
        slot = self.belief.slot_in_robot(tilt)
        return marker_guide(robot, drawing, slot, card, angles, placed)


class FindCard:
    """The master's part: it searches for the card, and sends where it sees it.

    Args:
        slave: The slave that holds the card.

    Attributes:
        done: Always true: the slave's part ends the stage.
    """

    name = "meet"
    done = True

    def __init__(self, slave: GuidedSlave) -> None:
        self._slave, self._belief = slave, slave.belief
        self._arm, self._name = camera_arm(slave.belief.robot)[0], slave.belief.robot.name
        self._guide: MarkerGuide | None = None
        self._around = iter(_AROUND)
        self._ahead, self._aimed, self._centred = slave.belief.home, 0.0, False
        self._move = ArmMove(slave.belief.home)

    def step(self, seen: Observation) -> Command:
        """Search, aim at the card, and send guidance."""
        if self._guide is None:
            self._guide = self._begin(seen)
        command = self._move.command(seen)
        guidance = None
        if self._move.is_there(seen):
            guidance = self._guide.step(seen)[1]
            if not self._centred and guidance is not None and guidance.card_seen:
                # It shall stay in view while the slave turns.
                self._aim_at(self._guide.transform_card_to_robot, seen)
                self._centred, guidance = True, None
            elif seen.time > self._aimed + _SPOT:
                if self._slave.exchange.read(self._slave.name, CardMet) is None:
                    self._search_on(seen)
        self._slave.exchange.guidance[self._name].send(guidance)
        return command

    def _begin(self, seen: Observation) -> MarkerGuide:
        tilt = tilt_of(seen, self._name)
        card = self._belief.card_in_robot(tilt, self._slave.transform_card_to_slave)
        self._aim_at(card, seen)
        return self._slave.guide(card, tilt, self._belief.home, placed=False)

    def _aim_at(self, card: RigidTransform, seen: Observation) -> None:
        """Bring the card into the middle of the view."""
        centre = card.apply([0.0, -self._belief.site.insertion.card_length / 2.0, 0.0])
        self._ahead, self._aimed = aim(self._arm, centre, self._belief.home), seen.time
        self._move = ArmMove(self._ahead)

    def _search_on(self, seen: Observation) -> None:
        """Turn the camera to the next direction where the card might be."""
        turns = next(self._around, None)
        if turns is not None:
            goal = self._ahead.copy()
            goal[[0, -1]] += turns
            self._move, self._aimed = ArmMove(np.clip(goal, *self._arm.limits.T)), seen.time


class TurnInView:
    """The slave's part: it turns to and fro, and gets from the master how far it truly turned.

    Args:
        belief: Estimates of the slave; gets the turn share, and the slot's pose.
        exchange: All that passes between the robots.
        turns: Whether the slave turns; if not it is only searched for.

    Attributes:
        done: Whether the slave has turned, or was not seen for too long.
    """

    name = "meet"

    def __init__(self, belief: MissionBelief, exchange: Exchange, turns: bool) -> None:
        self.done = False
        self._belief, self._exchange, self._name = belief, exchange, belief.robot.name
        arm = CardArm(belief.robot, belief.site.insertion.tip)
        self._transform_card_to_robot = arm.transform_card_to_robot(belief.home)
        self._pose = SlotPose(belief.transform_slot_to_level, belief.slot_covariance)
        self._rest, self._since = ArmMove(belief.home), math.nan
        self._turns = [_TURN, -_TURN] if turns else []
        self._drive: DriveToPose | None = None
        self._steer = SkidSteer.of(belief.robot)
        self._rolling = Odometry(self._steer)
        self._seen: list[float] = []  # Yaws by the master's views since the last turn [rad].
        self._yaws: list[tuple[float, float]] = []  # Yaws seen and rolled after each turn [rad].

    def step(self, seen: Observation) -> Command:
        """Take guidance, turn, and take guidance again."""
        self._rolling.update(seen, PERIOD)
        views = self._exchange.guidance[self._name].receive()
        if self._drive is not None:
            command = self._drive.step(seen)
            if not self._drive.done:
                return command
            self._drive, self._since, self._seen = None, seen.time, []
            self._rest = ArmMove(self._belief.home)
        command = self._rest.command(seen)
        if math.isnan(self._since):
            if self._rest.is_there(seen):
                self._since = seen.time
            return command
        if seen.inclinometer.usable:
            tilt = np.asarray(seen.inclinometer.value, dtype=float)
            self._pose = dataclasses.replace(self._pose, tilt=tilt)
        for view in views:
            if view.time >= self._since + 1.0 and view.transform_slot_to_card is not None:
                self._take(view.transform_slot_to_card, view.covariance)
        if len(self._seen) >= _VIEWS:
            self._yaws.append((float(np.mean(self._seen)), self._rolling.yaw))
            self._turn_on()
        elif seen.time > self._since + _PATIENCE:
            self._end()
        return command

    def _take(self, transform_slot_to_card: RigidTransform, covariance: FloatArray) -> None:
        """Take the slot's pose by a view of the master, unless it took something else for it."""
        card = self._transform_card_to_robot
        slot, covariance = card * transform_slot_to_card, transport_covariance(card, covariance)
        off = slot * self._pose.transform_slot_to_robot.inv()
        error = np.asarray(off.as_exp_coords())
        expected = self._pose.covariance + covariance + _STIRRED
        if error @ np.linalg.solve(expected, error) > _GATE:
            return
        self._exchange.post(self._name, CardMet())
        forward = transform_slot_to_card.inv().rotation.as_matrix()[:, 1]
        self._seen.append(math.atan2(-forward[2], forward[1]))
        self._pose = SlotPose(slot, covariance, self._pose.tilt, met=True)
        self._belief.transform_slot_to_level, self._belief.slot_covariance = slot, covariance

    def _turn_on(self) -> None:
        """Begin the next turn; after the last one identify the turn share."""
        if self._turns:
            self._drive = DriveToPose(self._steer, [0.0, 0.0, self._turns.pop(0)])
            return
        if len(self._yaws) > 1:
            seen, rolled = np.abs(np.diff(np.array(self._yaws), axis=0)).sum(axis=0)
            self._belief.turn_share = float(seen / rolled)
            self._exchange.post(self._name, TurnShare(self._belief.turn_share))
        self._end()

    def _end(self) -> None:
        self._exchange.post(self._name, self._pose)
        self.done = True
