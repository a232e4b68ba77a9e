"""The drawing of a mission's site: slot and panel, the card, and the rovers' initial poses.

Poses are given in the ground frame: on level ground below the middle of the slot's mouth, z up,
y into the slot.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.drawing import InsertionDrawing
from perception.geometry.arrays import FloatArray
from perception.registration.target import TargetCad
from twin.description import RobotDescription

_TILT, _HEIGHT = 0.05, 0.03
"""Prior standard deviations of a robot's tilt [rad] and height [m] due to the ground."""


@dataclasses.dataclass(frozen=True, eq=False)
class SiteDrawing:
    """Drawing of the site, known to both robots.

    Attributes:
        insertion: Drawing of card and slot.
        target: Markers of the panel.
        transform_slot_to_panel: Transform from the slot to the panel.
        covariance: (6, 6) covariance of the twist xi in
            ``true = from_exp_coords(xi) * transform_slot_to_panel``.
        initial_poses: x, y [m] and yaw [rad] at which each robot should begin, by robot name,
            ground frame.
        initial_error: Greatest error of an initial pose, in x and y [m] and in yaw [rad].
    """

    insertion: InsertionDrawing
    target: TargetCad
    transform_slot_to_panel: RigidTransform
    covariance: FloatArray
    initial_poses: Mapping[str, tuple[float, float, float]]
    initial_error: tuple[float, float]

    def initial_slot(self, robot: str, height: float) -> tuple[RigidTransform, FloatArray]:
        """Return the slot's pose in a robot's level frame at its initial pose, and its covariance.

        Args:
            robot: Name of the robot.
            height: Height of the robot frame over level ground [m].
        """
        x, y, yaw = self.initial_poses[robot]
        robot_in_site = RigidTransform.from_components(
            [x, y, height], Rotation.from_euler("z", yaw)
        )
        slot = robot_in_site.inv() * self.insertion.transform_slot_to_ground
        far, turn = (error / math.sqrt(3.0) for error in self.initial_error)  # uniform errors
        return slot, np.diag(np.square([_TILT, _TILT, turn, far, far, _HEIGHT]))


@dataclasses.dataclass(frozen=True)
class MissionRoles:
    """Roles of the rovers.

    Attributes:
        master: Rover with the camera.
        slave: Rover that holds the card.
    """

    master: RobotDescription
    slave: RobotDescription
