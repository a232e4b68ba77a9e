"""What one rover knows while it crosses a field: its site as drawn, and where it stands in it."""

import dataclasses
import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.crossing.navigator import Navigator
from controllers.crossing.site import FieldDrawing
from controllers.insertion.camera_station import stereo_geometry
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.belief import drawn_turn_share
from controllers.motion.driving import SkidSteer
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import composed_covariance, transport_covariance
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.description import RobotDescription

_PARTNER = 0.3  # Radius of a disc that holds a rover [m].
_VOXEL = 0.01  # Edge of the map's voxels [m].
_BOX = ((-2.4, -2.4, -0.5), (2.4, 2.4, 0.8))  # Corners of the voxel map, about the panel [m].


@dataclasses.dataclass
class FieldKnowledge:
    """Estimates of one rover.

    Attributes:
        robot: Description of the rover.
        site: Drawing of the site.
        map: Voxel map of the site, whose frame the panel defines.
        navigator: Odometry, elevation map and drive of the rover.
        localization: Localization of the rover on the map; None before it has found the panel.
        partner: (2,) place of the other rover [m], ground frame; None where it has not told it.
    """

    robot: RobotDescription
    site: FieldDrawing
    map: SharedMap
    navigator: Navigator
    localization: RobotLocalization | None = None
    partner: FloatArray | None = None

    @classmethod
    def initial(
        cls, robot: RobotDescription, site: FieldDrawing, blind: bool = False
    ) -> "FieldKnowledge":
        """Return a rover's estimates at the start, from drawings alone.

        Args:
            robot: Description of the rover.
            site: Drawing of the site.
            blind: Whether paths are planned as if nothing stood on the ground.
        """
        config, geometry = MapperConfig(), stereo_geometry(robot)
        voxels = VoxelMap(VoxelGrid(_VOXEL, *_BOX))
        panel = SharedMap(voxels, geometry, site.target, config.stereo.stride, config.reach)
        share = drawn_turn_share(robot)
        steer = SkidSteer.of(robot, share.share, share.deviation)
        return cls(robot, site, panel, Navigator(robot, panel, steer, blind=blind))

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

    def stay(self) -> None:
        """Take over the localization that odometry gives where the panel does not show itself."""
        self.localization = self.navigator.localization()

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

    def discs(self) -> FloatArray:
        """Return discs (K, 3) that hold site and other rover: x, y, radius [m], ground frame."""
        discs = self.site.structures
        if self.partner is None:
            return discs
        return np.vstack([discs, [*self.partner, _PARTNER]])

    def structures(self) -> FloatArray:
        """Return these discs (K, 3) in the frame of the map, once the panel was found [m]."""
        discs = self.discs()
        flat = np.column_stack([discs[:, :2], np.zeros(len(discs))])
        return np.column_stack([self.transform_ground_to_map.apply(flat)[:, :2], discs[:, 2]])
