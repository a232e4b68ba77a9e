"""Estimates of one robot of a mission: first from the drawing, then measured or received."""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.identification.pitch import PitchEstimate
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.mission.exchange import Exchange, SlotPose, TurnShare
from controllers.mission.site import SiteDrawing
from controllers.motion.base_tilt import TiltAxis, drawn_springs, roll_axis
from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, transport_covariance
from twin.description import RobotDescription
from twin.robot import Observation, RobotError

_SLIDING = 0.12
"""Standard deviation of a turn share as drawn. Assumption: loads that differ, rocks and rolling
friction move it by a quarter."""
_UNLIKE = 0.025
"""Standard deviation of two robots' difference: 12 as made scattered by 0.0175 on flat ground."""


@dataclasses.dataclass
class MissionBelief:
    """Estimates of one robot.

    Attributes:
        robot: Description of the robot.
        site: Drawing of the site.
        transform_slot_to_level: Transform from the slot to the robot frame; the master's is level.
        slot_covariance: (6, 6) covariance of the slot's pose, as a twist in the robot frame.
        partner: Pose of the slot in the other robot's frame.
        turn_share: Actual turn of the skidding rover over that of rolling wheels; until identified
            as drawn (`drawn_turn_share`).
        pitch: Identified pitch dynamics on the springs; None before the identification, and where
            it failed.
        identification: Latest identification of the pitch dynamics, used or not; None before it.
        doubts: Why the latest identification is not used, in words; none if it is.
        map: Map of the site; None without one.
        localization: Localization of the robot on the map, once it has found the panel.
    """

    robot: RobotDescription
    site: SiteDrawing
    transform_slot_to_level: RigidTransform
    slot_covariance: FloatArray
    partner: SlotPose
    turn_share: TurnShare
    pitch: PitchEstimate | None = None
    identification: PitchEstimate | None = None
    doubts: tuple[str, ...] = ()
    map: SharedMap | None = None
    localization: RobotLocalization | None = None

    @classmethod
    def initial(
        cls, robot: RobotDescription, partner: RobotDescription, site: SiteDrawing
    ) -> "MissionBelief":
        """Return a robot's estimates at the start, from the drawing alone.

        Args:
            robot: Description of the robot.
            partner: Description of the other robot.
            site: Drawing of the site.
        """
        slot = site.initial_slot(robot.name, robot.centre_height)
        other = site.initial_slot(partner.name, partner.centre_height)
        return cls(robot, site, *slot, SlotPose(*other), drawn_turn_share(robot))

    @property
    def home(self) -> FloatArray:
        """(n,) joint angles of the arm at home [rad]."""
        assert self.robot.arm is not None
        return self.robot.arm.home

    @property
    def transform_ground_to_level(self) -> RigidTransform:
        """Transform from the ground below the slot to the robot frame of the slot's estimate."""
        return self.transform_slot_to_level * self.site.insertion.transform_slot_to_ground.inv()

    def steer(self) -> SkidSteer:
        """Return the kinematics of the robot's wheels with the identified turn share."""
        return SkidSteer.of(self.robot, self.turn_share.share, self.turn_share.deviation)

    def springs(self) -> tuple[TiltAxis, TiltAxis]:
        """Return pitch and roll dynamics; those of the drawing where none were identified."""
        if self.pitch is None:
            return drawn_springs(self.robot)
        pitch = TiltAxis.of(self.pitch)
        return pitch, roll_axis(pitch, self.robot)

    def slot_in_robot(self, tilt: FloatArray) -> tuple[RigidTransform, FloatArray]:
        """Return the slot's pose in the tilted robot's frame, and its covariance (6, 6).

        Args:
            tilt: (2,) pitch and roll of the robot [rad].
        """
        upright = tilt_to_level(tilt).inv()
        covariance = transport_covariance(upright, self.slot_covariance)
        return upright * self.transform_slot_to_level, covariance

    def card_in_robot(
        self, tilt: FloatArray, transform_card_to_partner: RigidTransform
    ) -> RigidTransform:
        """Return the approximate pose of the partner's card in the tilted robot's frame.

        Args:
            tilt: (2,) pitch and roll of the robot [rad].
            transform_card_to_partner: Pose of the card in the partner's frame, by its joints.
        """
        slot, _ = self.slot_in_robot(tilt)
        return slot * self.partner.transform_slot_to_robot.inv() * transform_card_to_partner

    def localize(self, found: RobotLocalization) -> None:
        """Update the slot's pose from the robot's localization on the map.

        Args:
            found: Localization of the robot.
        """
        assert self.map is not None and self.map.transform_target_to_world is not None
        to_world = self.map.transform_target_to_world
        to_level = found.transform_level_to_world.inv()
        covariance = composed_covariance(to_world, found.robot_covariance(), self.site.covariance)
        self.localization = found
        slot = to_world * self.site.transform_slot_to_panel
        self.transform_slot_to_level = to_level * slot
        self.slot_covariance = transport_covariance(to_level, covariance)

    def reckon(self, odometry: Odometry) -> None:
        """Update the slot's pose by the robot's own dead reckoning of a drive.

        Args:
            odometry: Dead reckoning since the slot's pose was that of the belief.
        """
        to_level = odometry.transform_level_to_start().inv()
        before = transport_covariance(to_level, self.slot_covariance)
        self.transform_slot_to_level = to_level * self.transform_slot_to_level
        self.slot_covariance = before + odometry.covariance()

    def receive(self, exchange: Exchange, partner: str) -> None:
        """Take over the slot's pose and the turn share that the partner posted.

        Args:
            exchange: Message exchange between the robots.
            partner: Name of the other robot.
        """
        self.partner = exchange.read(partner, SlotPose) or self.partner
        share = exchange.read(partner, TurnShare)
        if share is not None:
            self.turn_share = TurnShare(share.share, math.hypot(share.deviation, _UNLIKE))


def drawn_turn_share(robot: RobotDescription) -> TurnShare:
    """Return the turn share of a rover whose four tyres carry and grip alike.

    Turning at w, each slides by v - w t along and w l across, at half the track t and the wheelbase
    l: their moments t (v - w t) - l (w l) vanish at w t / v = t^2 / (t^2 + l^2), on any ground.

    Args:
        robot: Description of the robot.
    """
    track, base = robot.half_track**2, robot.half_wheelbase**2
    return TurnShare(track / (track + base), _SLIDING)


def tilt_of(seen: Observation, robot: str) -> FloatArray:
    """Return (2,) pitch and roll of a robot [rad].

    Args:
        seen: Observation of the robot.
        robot: Name of the robot.

    Raises:
        RobotError: If its inclinometer has no usable reading.
    """
    channel = seen.inclinometer
    if not (channel.usable and np.isfinite(channel.value).all()):
        raise RobotError(
            f"the inclinometer of {robot} is {channel.validity.value}: without it the mission "
            "cannot know the robot's tilt; check its connection"
        )
    return np.asarray(channel.value, dtype=float)
