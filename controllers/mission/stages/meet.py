"""Stage ``meet``: the master finds the card, and the slave identifies its turn share.

The slave turns to and fro before the master's camera and receives the measured turns. This gives
both robots the other's pose, and the slave the ratio of its turns to those of rolling wheels,
without a compass.
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
_TURN = 0.35  # Turn of the slave to and fro, by the turn share as drawn [rad].
_AROUND = ((0.0, -0.25), (0.0, 0.25), (0.25, 0.0), (-0.25, 0.0))
"""Turns of yaw and wrist from the card's expected direction, in the order of the search [rad]."""
_SPOT = 3.0  # Time for one direction of the search, with the motion there [s].
_PATIENCE = 15.0  # Longest time to wait for views [s].
_GATE = 30.0  # Squared Mahalanobis distance beyond which a detection is not the card.
_STIRRED = np.diag(np.square([0.05, 0.05, 0.05, 0.05, 0.05, 0.02]))
"""Covariance of what else a turn on rocks may change of the slot's pose in the robot's frame."""


@dataclasses.dataclass(frozen=True, eq=False)
class GuidedSlave:
    """The slave from the point of view of the master that guides it.

    Attributes:
        belief: Estimates of the master.
        name: Name of the slave.
        exchange: Message exchange between the robots.
        transform_card_to_slave: Pose of the card in the slave's frame, with its arm at home.
    """

    belief: MissionBelief
    name: str
    exchange: Exchange
    transform_card_to_slave: RigidTransform

    def guide(
        self, card: RigidTransform, tilt: FloatArray, angles: FloatArray, placed: bool
    ) -> MarkerGuide:
        """Return the master's guide, which measures card and slot.

        Args:
            card: Approximate transform from the card to the tilted master's frame.
            tilt: (2,) pitch and roll of the master [rad].
            angles: (4,) initial joint angles [rad].
            placed: Whether the camera moves to its best view, or keeps its pose.
        """
        robot, drawing = self.belief.robot, self.belief.site.insertion
        slot = self.belief.slot_in_robot(tilt)
        return marker_guide(robot, drawing, slot, card, angles, placed)


class FindCard:
    """The master's part: it searches for the card, and sends its measured pose.

    Args:
        slave: Slave that holds the card.

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
                # Centred, the card stays in view while the slave turns.
                self._aim_at(self._guide.transform_card_to_robot, seen)
                self._centred, guidance = True, None
            elif seen.time > self._aimed + _SPOT:
                if self._slave.exchange.read(self._slave.name, CardMet) is None:
                    self._search_on(seen)
        self._slave.exchange.guidance[self._name].send(guidance, seen.time)
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
    """The slave's part: it turns to and fro, and receives its turns as measured by the master.

    Args:
        belief: Estimates of the slave; updated with the turn share and the slot's pose.
        exchange: Message exchange between the robots.
        turns: Whether the slave turns; if not the master only searches for it.

    Attributes:
        done: Whether the slave has turned, or was not detected for too long.
    """

    name = "meet"

    def __init__(self, belief: MissionBelief, exchange: Exchange, turns: bool) -> None:
        self.done = False
        self._belief, self._exchange, self._name = belief, exchange, belief.robot.name
        arm = CardArm(belief.robot, belief.site.insertion.tip)
        self._transform_card_to_robot = arm.transform_card_to_robot(belief.home)
        self._tilt, self._met = np.zeros(2), False
        self._rest, self._since = ArmMove(belief.home), math.nan
        self._turns = [_TURN, -_TURN] if turns else []
        self._drive: DriveToPose | None = None
        self._rolling = Odometry(SkidSteer.of(belief.robot))
        # Yaws measured by the master since the last turn [rad], and their variances.
        self._seen: list[tuple[float, float]] = []
        # After each turn the yaw as measured, its variance, and that of rolling wheels [rad].
        self._yaws: list[tuple[float, float, float]] = []

    def step(self, seen: Observation) -> Command:
        """Average guidance at rest, turn, and average guidance again."""
        self._rolling.update(seen, PERIOD)
        views = self._exchange.guidance[self._name].receive(seen.time)
        if self._drive is not None:
            command = self._drive.step(seen)
            if not self._drive.done:
                return command
            self._belief.reckon(self._drive.odometry)
            self._drive, self._since, self._seen = None, seen.time, []
            self._rest = ArmMove(self._belief.home)
        command = self._rest.command(seen)
        if math.isnan(self._since):
            if self._rest.is_there(seen):
                self._since = seen.time
            return command
        if seen.inclinometer.usable:
            self._tilt = np.asarray(seen.inclinometer.value, dtype=float)
        for view in views:
            if view.time >= self._since + 1.0 and view.transform_slot_to_card is not None:
                self._take(view.transform_slot_to_card, view.covariance)
        if len(self._seen) >= _VIEWS:
            # Views of one pose share most of their error: three tell hardly more than one.
            yaw, variance = np.mean(self._seen, axis=0).tolist()
            self._yaws.append((yaw, variance, self._rolling.yaw))
            self._turn_on()
        elif seen.time > self._since + _PATIENCE:
            self._end()
        return command

    def _take(self, transform_slot_to_card: RigidTransform, covariance: FloatArray) -> None:
        """Update the slot's pose from guidance, unless another object was mistaken for the card."""
        card, belief = self._transform_card_to_robot, self._belief
        slot, in_robot = card * transform_slot_to_card, transport_covariance(card, covariance)
        error = np.asarray((slot * belief.transform_slot_to_level.inv()).as_exp_coords())
        expected = belief.slot_covariance + in_robot + _STIRRED
        if error @ np.linalg.solve(expected, error) > _GATE:
            return
        self._exchange.post(self._name, CardMet())
        to_slot = transform_slot_to_card.inv().rotation.as_matrix()
        forward, normal = to_slot[:, 1], to_slot[0]
        variance = float(normal @ covariance[:3, :3] @ normal)
        self._seen.append((math.atan2(-forward[2], forward[1]), variance))
        self._met = True
        belief.transform_slot_to_level, belief.slot_covariance = slot, in_robot

    def _turn_on(self) -> None:
        """Begin the next turn; after the last one identify the turn share."""
        if self._turns:
            self._drive = DriveToPose(self._belief.steer(), [0.0, 0.0, self._turns.pop(0)])
            return
        if len(self._yaws) > 1:
            yaws, variances, rolled = np.transpose(self._yaws)
            drawn = self._belief.turn_share
            self._belief.turn_share = turn_share(yaws, variances, rolled, drawn)
            self._exchange.post(self._name, self._belief.turn_share)
        self._end()

    def _end(self) -> None:
        belief = self._belief
        pose = SlotPose(
            belief.transform_slot_to_level, belief.slot_covariance, self._tilt, self._met
        )
        self._exchange.post(self._name, pose)
        self.done = True


def turn_share(
    yaws: FloatArray, variances: FloatArray, rolled: FloatArray, drawn: TurnShare
) -> TurnShare:
    """Return the share of rolling wheels' turns that a robot kept in turns to and fro.

    Args:
        yaws: (N,) measured yaw before, between and after the turns [rad].
        variances: (N,) variance of each.
        rolled: (N,) yaw of rolling wheels at the same times [rad].
        drawn: The share before.

    Returns:
        The mean of what was measured and `drawn`, by their variances; its deviation is that of a
        turn to come, which may differ as these do.
    """
    turns, rolls = np.diff(yaws), np.diff(rolled)
    signs = np.sign(rolls)
    shares, rolls = turns / rolls, np.abs(rolls)
    found = float(signs @ turns / rolls.sum())
    # A yaw between two turns to opposite sides counts twice.
    ends = np.concatenate([[0.0], signs, [0.0]])
    measured = float(np.square(ends[:-1] - ends[1:]) @ variances) / rolls.sum() ** 2
    scatter = float(np.var(shares, ddof=1)) if len(shares) > 1 else 0.0
    variance = measured + scatter / len(shares)
    weight = drawn.deviation**2 / (drawn.deviation**2 + variance)
    share = drawn.share + weight * (found - drawn.share)
    return TurnShare(share, math.sqrt(weight * variance + scatter))
