"""Estimates of one rover of a mission: first from drawings, then measured or received."""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.identification.pitch import PitchEstimate
from controllers.insertion.camera_station import stereo_geometry
from controllers.insertion.watching import Surroundings
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_view import MapperConfig
from controllers.mapping.visual_odometry import levelled
from controllers.mission.navigator import Navigator
from controllers.mission.radio import SlotPose
from controllers.mission.site import SiteDrawing
from controllers.motion.base_tilt import TiltAxis, drawn_springs, roll_axis
from controllers.motion.driving import SkidSteer
from controllers.placement.mapped_ground import GroundConfig, MappedGround
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, transport_covariance
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.description import RobotDescription
from twin.robot import Observation, RobotError

_SLIDING = 0.12
"""Standard deviation of a turn share as drawn. Assumption: loads that differ, rocks and rolling
friction move it by a quarter."""
_FRICTION = 0.5  # Friction of the ground as long as nothing is known of it. Assumption.
_RELIEF = 0.03  # Deviation from the field's plane of the ground that a rover stands on [m].
_REACH = 0.9  # Distance from the rover within which its arm may touch things [m].
_PARTNER = 0.27  # Radius of a disc that holds a rover [m].
_UNSURE = 0.1  # Most by which a rover's disc is larger where its place is not known well [m].
_VOXEL = 0.01  # Edge of the map's voxels [m].
_BOX = ((-2.4, -2.4, -0.5), (2.4, 2.4, 0.8))  # Corners of the voxel map, about the panel [m].


@dataclasses.dataclass
class MissionBelief:
    """Estimates of one rover.

    Attributes:
        robot: Description of the rover.
        site: Drawing of the site.
        map: Voxel map of the site, whose frame the panel defines.
        navigator: Odometry, elevation map and drive of the rover.
        localization: Localization of the rover on the map; None before it has found the panel.
        partner: Slot in the other rover's frame, which says where that stands; None before it has
            been received.
        pitch: Identified pitch dynamics on the springs; None before the identification, and where
            it failed.
        identification: Latest identification of the pitch dynamics, used or not; None before it.
        doubts: Why the latest identification is not used, in words; none if it is.
    """

    robot: RobotDescription
    site: SiteDrawing
    map: SharedMap
    navigator: Navigator
    localization: RobotLocalization | None = None
    partner: SlotPose | None = None
    pitch: PitchEstimate | None = None
    identification: PitchEstimate | None = None
    doubts: tuple[str, ...] = ()

    @classmethod
    def initial(
        cls, robot: RobotDescription, site: SiteDrawing, without: str = ""
    ) -> "MissionBelief":
        """Return a rover's estimates at the start, from drawings alone.

        Args:
            robot: Description of the rover.
            site: Drawing of the site.
            without: Part of a mission that is left out; empty for none.
        """
        config, geometry = MapperConfig(), stereo_geometry(robot)
        voxels = VoxelMap(VoxelGrid(_VOXEL, *_BOX))
        panel = SharedMap(voxels, geometry, site.target, config.stereo.stride, config.reach)
        share = drawn_turn_share(robot)
        steer = dataclasses.replace(
            SkidSteer.of(robot, share.share, share.deviation), slide=drawn_slide(robot)
        )
        navigator = Navigator(
            robot,
            panel,
            steer,
            blind=without == "paths",
            guarded=without != "guard",
            once=without == "panel",
        )
        return cls(robot, site, panel, navigator)

    @property
    def home(self) -> FloatArray:
        """(n,) joint angles of the arm at home [rad]."""
        assert self.robot.arm is not None
        return self.robot.arm.home

    def springs(self) -> tuple[TiltAxis, TiltAxis]:
        """Return pitch and roll dynamics; those of the drawing where none were identified."""
        if self.pitch is None:
            return drawn_springs(self.robot)
        pitch = TiltAxis.of(self.pitch)
        return pitch, roll_axis(pitch, self.robot)

    @property
    def transform_ground_to_map(self) -> RigidTransform:
        """Transform from the ground frame to that of the map, once the panel was found."""
        assert self.map.transform_target_to_world is not None
        return self.map.transform_target_to_world * self.site.transform_panel_to_ground.inv()

    def localize(self, found: RobotLocalization) -> None:
        """Take over a localization by the panel, measured at the navigator's latest pair.

        Args:
            found: Localization of the rover.
        """
        self.navigator.localize(found)
        self.localization = found
        self.navigator.keep_off = self.structures
        self.navigator.partner = self.partner_in_map

    def stay(self) -> None:
        """Take over the localization that odometry gives where the panel does not show itself.

        Its height drifts, which the ground does not: where that tells more, it counts, too.
        """
        found = self.navigator.localization()
        to_map = self.transform_ground_to_map
        standing = stood(found, to_map, self.robot.centre_height)
        if standing is not None:
            self.localize(standing)
        else:
            self.localization = found

    def place_in_ground(self) -> FloatArray:
        """Return the rover's x, y [m] and yaw [rad] in the ground frame, (3,)."""
        to_ground = self.transform_ground_to_map.inv()
        pose = to_ground * self.navigator.odometry.level_pose()
        x, y, _ = pose.translation
        ahead = pose.rotation.apply([0.0, 1.0, 0.0])
        return np.array([x, y, math.atan2(-ahead[0], ahead[1])])

    def slot_in_level(self) -> tuple[RigidTransform, FloatArray]:
        """Return the slot's pose in the levelled rover's frame, and its covariance (6, 6)."""
        assert self.localization is not None and self.map.transform_target_to_world is not None
        to_world = self.map.transform_target_to_world
        to_level = self.localization.transform_level_to_world.inv()
        covariance = composed_covariance(
            to_world, self.localization.robot_covariance(), self.site.covariance
        )
        slot = to_level * to_world * self.site.transform_slot_to_panel
        return slot, transport_covariance(to_level, covariance)

    def slot_in_robot(self, tilt: FloatArray) -> tuple[RigidTransform, FloatArray]:
        """Return the slot's pose in the tilted rover's frame, and its covariance (6, 6).

        Args:
            tilt: (2,) pitch and roll of the rover [rad].
        """
        slot, covariance = self.slot_in_level()
        upright = tilt_to_level(tilt).inv()
        return upright * slot, transport_covariance(upright, covariance)

    def slot_now(self) -> SlotPose | None:
        """Return the slot in the rover's frame by odometry; None before the rover is localized."""
        to_world = self.map.transform_target_to_world
        if self.localization is None or to_world is None:
            return None
        pose, pose_covariance = self.navigator.odometry.estimate()
        covariance = composed_covariance(to_world, pose_covariance, self.site.covariance)
        slot = pose.inv() * to_world * self.site.transform_slot_to_panel
        return SlotPose(slot, transport_covariance(pose.inv(), covariance))

    def card_in_robot(
        self, tilt: FloatArray, partner: SlotPose, transform_card_to_partner: RigidTransform
    ) -> RigidTransform:
        """Return the approximate pose of the partner's card in the tilted rover's frame.

        Args:
            tilt: (2,) pitch and roll of the rover [rad].
            partner: Slot in the partner's frame.
            transform_card_to_partner: Pose of the card in the partner's frame, by its joints.
        """
        slot, _ = self.slot_in_robot(tilt)
        return slot * partner.transform_slot_to_robot.inv() * transform_card_to_partner

    def discs(self) -> FloatArray:
        """Return discs (K, 3) that hold site and other rover: x, y, radius [m], ground frame."""
        discs, there = self.site.structures, self._partner_in_ground()
        if self.partner is None or there is None:
            return discs
        turn = there.rotation.as_matrix()
        place = turn @ self.partner.covariance[3:, 3:] @ turn.T
        unsure = min(2.0 * math.sqrt(place[0, 0] + place[1, 1]), _UNSURE)
        return np.vstack([discs, [*there.translation[:2], _PARTNER + unsure]])

    def mapped_ground(self) -> MappedGround:
        """Return what is mapped: the voxels of the site, and what paths lead around.

        Where the site's structures and the other rover stand, the voxels alone tell.
        """
        to_ground = self.transform_ground_to_map.inv()
        columns = np.asarray(to_ground.apply(self.navigator.columns(GroundConfig().climb)))
        discs = self.discs()
        apart = np.linalg.norm(columns.reshape(-1, 1, 3)[..., :2] - discs[:, :2], axis=2)
        further = columns.reshape(-1, 3)[np.all(apart > discs[:, 2], axis=1)]
        return MappedGround(self.map.voxels.surface(), to_ground, further=further)

    def surroundings(self, transform_slot_to_robot: RigidTransform) -> Surroundings:
        """Return what is mapped about the arm and before the slot, in the robot's frame.

        Args:
            transform_slot_to_robot: Pose of the slot in the robot's frame.
        """
        to_ground, ground = self.site.insertion.transform_slot_to_ground, self.mapped_ground()
        normal = to_ground.rotation.apply([0.0, 0.0, 1.0])
        before = ground.before(np.asarray(to_ground.translation), normal)
        points, hiding = (
            np.asarray((transform_slot_to_robot * to_ground.inv()).apply(each)).reshape(-1, 3)
            for each in (ground.points, before)
        )
        near = np.linalg.norm(points, axis=1) < _REACH
        return Surroundings.of(points[near], hiding)

    def partner_place(self) -> FloatArray | None:
        """Return (2,) the other rover's place in the ground frame [m]; None if it is unknown."""
        there = self._partner_in_ground()
        return None if there is None else np.asarray(there.translation)[:2]

    def partner_in_map(self) -> FloatArray:
        """Return (K, 2) the other rover's place in the frame of the map [m]; none if unknown."""
        place = self.partner_place()
        if place is None:
            return np.zeros((0, 2))
        return np.asarray(self.transform_ground_to_map.apply([*place, 0.0]))[None, :2]

    def _partner_in_ground(self) -> RigidTransform | None:
        """Return the other rover's pose in the ground frame; None if it is unknown."""
        if self.partner is None:
            return None
        ground = self.site.insertion.transform_slot_to_ground
        return ground * self.partner.transform_slot_to_robot.inv()

    def structures(self) -> FloatArray:
        """Return these discs (K, 3) in the frame of the map, once the panel was found [m]."""
        discs = self.discs()
        flat = np.column_stack([discs[:, :2], np.zeros(len(discs))])
        return np.column_stack([self.transform_ground_to_map.apply(flat)[:, :2], discs[:, 2]])


def stood(
    found: RobotLocalization, transform_ground_to_world: RigidTransform, height: float
) -> RobotLocalization | None:
    """Return a localization corrected by the height of a rover that stands on the field.

    Args:
        found: Localization without that.
        transform_ground_to_world: Transform from the field's plane to the world.
        height: Height of the rover's frame above that plane [m].

    Returns:
        The localization; None where its own height is as sure as the ground's.
    """
    normal = transform_ground_to_world.rotation.apply([0.0, 0.0, 1.0])
    place = found.transform_level_to_world.translation
    row = np.concatenate([np.cross(place, normal), normal])  # Height above the plane by the twist.
    covariance = found.robot_covariance()
    gain = covariance @ row
    variance = float(row @ gain)
    if variance < _RELIEF**2:
        return None
    gain /= variance + _RELIEF**2
    lacks = height - float((place - transform_ground_to_world.translation) @ normal)
    moved = RigidTransform.from_exp_coords(gain * lacks) * found.transform_level_to_world
    left = covariance - np.outer(gain, row @ covariance)
    return dataclasses.replace(
        found,
        transform_level_to_world=levelled(moved),
        covariance=0.5 * (left + left.T),
        by_arm=np.zeros_like(found.by_arm),
    )


@dataclasses.dataclass(frozen=True)
class TurnShare:
    """Turn share of a skidding rover.

    Attributes:
        share: Actual turn over that of rolling wheels.
        deviation: Standard deviation of the share.
    """

    share: float
    deviation: float


def drawn_turn_share(robot: RobotDescription) -> TurnShare:
    """Return the turn share of a rover whose four tyres carry and grip alike.

    Turning at w, each slides by v - w t along and w l across, at half the track t and the wheelbase
    l: their moments t (v - w t) - l (w l) vanish at w t / v = t^2 / (t^2 + l^2), on any ground.

    Args:
        robot: Description of the robot.
    """
    track, base = robot.half_track**2, robot.half_wheelbase**2
    return TurnShare(track / (track + base), _SLIDING)


def drawn_slide(robot: RobotDescription) -> float:
    """Return the slide of a rover whose tyres all carry and grip alike, as of `SkidSteer` [m/rad].

    While rolling wheels would turn at w, each scrubs at v = w t l / sqrt(t^2 + l^2), with half the
    track t and the wheelbase l. A slow slide u turns these velocities by as little; over the four
    tyres that leaves a force of m g mu u / (2 v), which holds the rover on a slope s at
    u = 2 v s / mu.

    Args:
        robot: Description of the robot.
    """
    track, base = robot.half_track, robot.half_wheelbase
    return 2.0 * track * base / (_FRICTION * math.hypot(track, base))


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
