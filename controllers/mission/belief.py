"""What one robot of a mission believes: drawn, then measured or received, stage by stage."""

import dataclasses

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.identification.pitch import PitchEstimate, PitchPrior
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.mission.exchange import Exchange, SlotPose, TurnShare
from controllers.mission.site import SiteDrawing
from controllers.motion.base_tilt import TiltAxis, roll_axis
from controllers.motion.driving import SkidSteer
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, transport_covariance
from twin.description import RobotDescription
from twin.robot import Observation, RobotError


@dataclasses.dataclass
class MissionBelief:
    """What one robot believes.

    Attributes:
        robot: The robot as drawn.
        site: The drawing of the site.
        transform_slot_to_level: From the slot to the robot frame, which for the master is brought
            level.
        slot_covariance: (6, 6) of its twist.
        partner: Where the slot is from the other robot.
        pitch: How the robot pitches on its springs, once it has swung its arm.
        turn_share: Share of rolling wheels' turn that skidding leaves; all of it until identified.
        map: The map; None without.
        localization: Where the robot is on the map, once it has found the panel.
    """

    robot: RobotDescription
    site: SiteDrawing
    transform_slot_to_level: RigidTransform
    slot_covariance: FloatArray
    partner: SlotPose
    pitch: PitchEstimate | None = None
    turn_share: float = 1.0
    map: SharedMap | None = None
    localization: RobotLocalization | None = None

    @classmethod
    def initial(
        cls, robot: RobotDescription, partner: RobotDescription, site: SiteDrawing
    ) -> "MissionBelief":
        """Return what a robot believes at the start, by the drawing alone.

        Args:
            robot: The robot.
            partner: The other robot.
            site: The drawing of the site.
        """
        slot = site.initial_slot(robot.name, robot.centre_height)
        other = site.initial_slot(partner.name, partner.centre_height)
        return cls(robot, site, *slot, SlotPose(*other))

    def steer(self) -> SkidSteer:
        """Return how the robot's wheels move it."""
        return SkidSteer(self.robot.wheel_radius, self.robot.half_track, self.turn_share)

    def springs(self) -> tuple[TiltAxis, TiltAxis]:
        """Return how the robot pitches and rolls; by a guess if it did not swing its arm."""
        if self.pitch is not None:
            pitch = TiltAxis.of(self.pitch.parameters)
        else:
            prior = PitchPrior()
            pitch = TiltAxis(prior.inertia, prior.damping, prior.stiffness, (0.0, 0.0))
        return pitch, roll_axis(pitch, self.robot)

    def slot_in_robot(self, tilt: FloatArray) -> tuple[RigidTransform, FloatArray]:
        """Return the slot in the tilted robot's frame, and its covariance.

        Args:
            tilt: (2,) pitch and roll of the robot [rad].
        """
        upright = tilt_to_level(tilt).inv()
        return (
            upright * self.transform_slot_to_level,
            transport_covariance(upright, self.slot_covariance),
        )

    def card_in_robot(self, tilt: FloatArray, card_in_partner: RigidTransform) -> RigidTransform:
        """Return roughly where the card is that the partner holds, in the tilted robot's frame.

        Args:
            tilt: (2,) pitch and roll of the robot [rad].
            card_in_partner: From the card to the partner's frame, by its joints.
        """
        slot, _ = self.slot_in_robot(tilt)
        return slot * self.partner.transform_slot_to_robot.inv() * card_in_partner

    def localize(self, found: RobotLocalization) -> None:
        """Work out where the slot is, from where the robot is on the map.

        Args:
            found: Where the robot is.
        """
        assert self.map is not None and self.map.transform_target_to_world is not None
        to_world = self.map.transform_target_to_world
        to_level = found.transform_level_to_world.inv()
        covariance = composed_covariance(to_world, found.covariance, self.site.covariance)
        self.localization = found
        slot = to_world * self.site.transform_slot_to_panel
        self.transform_slot_to_level = to_level * slot
        self.slot_covariance = transport_covariance(to_level, covariance)

    def hear(self, exchange: Exchange, partner: str) -> None:
        """Take what the partner has found out of itself.

        Args:
            exchange: All that passes between the robots.
            partner: Name of the other robot.
        """
        self.partner = exchange.read(partner, SlotPose) or self.partner
        share = exchange.read(partner, TurnShare)
        if share is not None:
            self.turn_share = share.share


def tilt_of(seen: Observation, robot: str) -> FloatArray:
    """Return (2,) pitch and roll of a robot [rad].

    Args:
        seen: Observation of the robot.
        robot: Name of the robot.

    Raises:
        RobotError: If its inclinometer says nothing.
    """
    channel = seen.inclinometer
    if not (channel.usable and np.isfinite(channel.value).all()):
        raise RobotError(
            f"the inclinometer of {robot} is {channel.validity.value}: without it the mission "
            "cannot tell how the robot is tilted; check its connection"
        )
    return np.asarray(channel.value, dtype=float)
