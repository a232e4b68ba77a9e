"""Where the master of ``mission`` stands for the insertion, by the map, and how it gets there."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import CameraStation, best_camera_station
from controllers.mapping.looking import MapperConfig
from controllers.mapping.searching import TargetSearch, aim
from controllers.mapping.shared_map import SharedMap
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_to_pose import DriveToPose
from controllers.placement.mapped_ground import MappedGround
from experiments.ch3.stereo.mapping_scene import head_geometry
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.mission.knowledge import SLOT_IN_SITE, Knowledge, tilt_of
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.stages import HOME, Observations, reference_arm, take_standing
from perception.geometry.se3 import transport_covariance
from perception.registration.target import possible_markers
from twin.describe import describe_rover
from twin.robot import Command, Observation

FloatArray = NDArray[np.float64]

_NEAR_STAND = (0.06, 0.12)  # From the stand [m] and its heading [rad] where it will do.
_MOST_GOES = 4  # Until it stands there, or stays where it is.


def mapped_ground(knowledge: Knowledge) -> MappedGround:
    """Return what the map says of the level ground below the slot.

    Args:
        knowledge: Belief with a map; without one nothing is known to stand anywhere.
    """
    if knowledge.shared is None or knowledge.standing is None:
        return MappedGround(None, RigidTransform.identity())
    to_level = knowledge.slot_in_level * SLOT_IN_SITE.inv()
    to_map = knowledge.standing.transform_level_to_world * to_level
    return MappedGround(knowledge.shared.voxels.surface(), to_map.inv())


def choose_stand(knowledge: Knowledge, width: float) -> CameraStation:
    """Return where the master sees card and slot best of all places that it can drive to.

    Args:
        knowledge: Belief with the map.
        width: Width of the slot [m].

    Raises:
        PlacementError: If there is no place.
    """
    master = (knowledge.slot_in_level * SLOT_IN_SITE.inv()).inv().translation
    return best_camera_station(
        describe_rover(MASTER),
        insertion_drawing(width),
        ground=mapped_ground(knowledge),
        start=master[:2],
    )


class GoToStand:
    """Chapter 4: the master goes where it sees card and slot best, and finds the panel again.

    What it finds there tells how far dead reckoning has missed; if that is too far, it goes on.

    Attributes:
        done: Whether it stands there, or will get no nearer.
        found: Whether it has found the panel from there.
        stand: Where it shall stand.
        stops: How often it has driven and stopped by dead reckoning.
    """

    name = "place"

    def __init__(self, knowledge: Knowledge, stand: CameraStation) -> None:
        """Begin.

        Args:
            knowledge: Gets where the slot is from the new place.
            stand: Where to go, on the level ground below the slot.
        """
        self.done = False
        self.found = False
        self.stand, self.stops = stand, 0
        self._knowledge = knowledge
        self._rest = ArmMove(HOME)
        self._set_off()

    def _set_off(self) -> None:
        """Go to the stand from where the slot is seen now."""
        self._going = DriveToPose(self._knowledge.steer(), self._way(), free=self._free)
        self._fold = ArmMove(HOME)
        self._folded = False
        self._search: TargetSearch | None = None
        self._look: ArmMove | None = None

    def _way(self) -> FloatArray:
        """Return (3,) x to the right, y ahead [m] and turn [rad] to the stand from here."""
        site = self._knowledge.slot_in_level * SLOT_IN_SITE.inv()
        x, y, yaw = self.stand.place
        place = site.apply([x, y, 0.0])
        ahead = site.rotation.apply([-math.sin(yaw), math.cos(yaw), 0.0])
        return np.array([place[0], place[1], math.atan2(-ahead[0], ahead[1])])

    def _free(self, pose: FloatArray) -> bool:
        """Say whether the map has nothing at a pose (3,) given as `_way` is."""
        site = SLOT_IN_SITE * self._knowledge.slot_in_level.inv()
        x, y, _ = site.apply([pose[0], pose[1], 0.0])
        return mapped_ground(self._knowledge).is_free([x, y])

    def _missed(self) -> bool:
        """Say whether it stands too far from where it shall."""
        x, y, turn = self._way()
        return math.hypot(x, y) > _NEAR_STAND[0] or abs(turn) > _NEAR_STAND[1]

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Fold the arm, drive, look for the panel."""
        seen = observations[MASTER]
        rest = self._rest.command(observations[SLAVE])
        if not self._folded:
            self._folded = self._fold.is_there(seen)
            return {MASTER: self._fold.command(seen), SLAVE: rest}
        if not self._going.done:
            return {MASTER: self._going.step(seen), SLAVE: rest}
        if self._look is None:
            self.stops += 1
            self._reckon()
            if self._knowledge.shared is None:
                self.done = True
                return {MASTER: self._fold.command(seen), SLAVE: rest}
            self._begin_search()
        assert self._look is not None
        command = self._look.command(seen)
        if self._look.sees(seen):
            self._take(seen)
        return {MASTER: command, SLAVE: rest}

    def _reckon(self) -> None:
        """Bring the slot into the new frame by dead reckoning."""
        odometry, knowledge = self._going.odometry, self._knowledge
        x, y = odometry.place
        moved = RigidTransform.from_matrix(_planar_pose(x, y, odometry.yaw))
        knowledge.slot_in_level = moved.inv() * knowledge.slot_in_level
        way, turned = odometry.way, odometry.turned
        spread = np.diag(
            np.square(
                [0.02, 0.02, 0.03 + 0.05 * turned, 0.02 + 0.05 * way, 0.02 + 0.05 * way, 0.01]
            )
        )
        carried = transport_covariance(moved.inv(), knowledge.slot_covariance)
        knowledge.slot_covariance = carried + spread

    def _begin_search(self) -> None:
        """Look first where the panel should be."""
        knowledge, arm = self._knowledge, reference_arm()
        config = MapperConfig()
        survey = np.array(config.views.survey)
        extent = knowledge.site.target.extent
        self._search = TargetSearch(arm, HOME, survey, extent, config.search)
        panel = knowledge.slot_in_level * knowledge.site.transform_slot_to_panel.inv()
        self._look = ArmMove(aim(arm, panel.translation, survey))

    def _take(self, seen: Observation) -> None:
        shared, config, arm = self._knowledge.shared, MapperConfig(), reference_arm()
        assert isinstance(shared, SharedMap) and self._search is not None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = tilt_of(seen, MASTER)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        standing = shared.locate(arm, angles, tilt, pair, config.marker_sigma, config.standing)
        if standing is not None:
            take_standing(self._knowledge, standing)
            self.found = True
            if self._missed() and self.stops < _MOST_GOES:
                self._set_off()
            else:
                self.done = True
            return
        hints = possible_markers(pair, head_geometry(), self._knowledge.site.target)
        goal = self._search.after(angles, hints, tilt)
        if goal is None:
            self.done = True
        else:
            self._look = ArmMove(goal)


def _planar_pose(x: float, y: float, yaw: float) -> FloatArray:
    pose = np.eye(4)
    c, s = math.cos(yaw), math.sin(yaw)
    pose[:2] = [[c, -s, 0.0, x], [s, c, 0.0, y]]
    return pose
