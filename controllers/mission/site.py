"""The drawing of a site in a field, and what is known of the rovers' initial poses.

Poses are given in the ground frame: on the ground below the middle of the slot's mouth, z normal to
the ground's plane, y into the slot. The plane may slope.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.drawing import InsertionDrawing
from perception.geometry.arrays import FloatArray
from perception.registration.target import TargetCad
from twin.description import RobotDescription

_PANEL_MARGIN = 0.08
"""Width of the panel beside its markers [m]."""
_SLOT_DISCS = ((0.0, 0.08, 0.12), (0.0, 0.22, 0.12))
"""Discs that hold the slot with its walls, and its plinth: x, y and radius [m], ground frame."""


@dataclasses.dataclass(frozen=True, eq=False)
class SiteDrawing:
    """Drawing of the site, known to both rovers, and initial poses as far as they are known.

    Attributes:
        insertion: Drawing of card and slot.
        target: Markers of the panel.
        transform_slot_to_panel: Transform from the slot to the panel.
        covariance: (6, 6) covariance of the twist xi in
            ``true = from_exp_coords(xi) * transform_slot_to_panel``.
        initial_poses: x, y [m] and yaw [rad] at which each rover is believed to begin, by its name.
        initial_error: Greatest error of an initial pose, in x and y [m] and in yaw [rad].
        card_place: x, y [m] and yaw [rad] from which the rover with the card inserts it.
    """

    insertion: InsertionDrawing
    target: TargetCad
    transform_slot_to_panel: RigidTransform
    covariance: FloatArray
    initial_poses: Mapping[str, tuple[float, float, float]]
    initial_error: tuple[float, float]
    card_place: tuple[float, float, float]

    @property
    def transform_panel_to_ground(self) -> RigidTransform:
        """Transform from the panel to the ground frame."""
        return self.insertion.transform_slot_to_ground * self.transform_slot_to_panel.inv()

    @property
    def structures(self) -> FloatArray:
        """(K, 3) discs that hold panel, slot and plinth: x, y and radius [m]."""
        x, y, _ = self.transform_panel_to_ground.translation
        return np.array([[x, y, self.target.extent / 2.0 + _PANEL_MARGIN], *self.slot_discs])

    @property
    def slot_discs(self) -> FloatArray:
        """(K, 3) discs that hold slot and plinth, which hide the panel: x, y and radius [m]."""
        return np.array(_SLOT_DISCS)

    def draw_initial_poses(self, robot: str, count: int, rng: np.random.Generator) -> FloatArray:
        """Return (count, 3) x, y [m] and yaw [rad] at which a rover may have begun.

        Args:
            robot: Name of the rover.
            count: Number of poses.
            rng: Random generator for the poses.
        """
        far, turn = self.initial_error
        errors = rng.uniform(-1.0, 1.0, (count, 3)) * [far, far, turn]
        return np.array(self.initial_poses[robot]) + errors


@dataclasses.dataclass(frozen=True)
class MissionRoles:
    """Roles of the rovers.

    Attributes:
        master: Rover with the camera.
        slave: Rover that holds the card.
    """

    master: RobotDescription
    slave: RobotDescription
