"""Stage ``place``, chapter 4: the master drives to the best camera station for card and slot.

The station is chosen on the map. The master drives there by dead reckoning, and localizes itself
by the panel again; if the measured error is too large, it drives again.
"""

import math

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import (
    CameraStation,
    best_camera_station,
    camera_arm,
    stereo_geometry,
)
from controllers.mapping.searching import TargetSearch, aim
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.belief import MissionBelief, tilt_of
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_to_pose import DriveToPose
from controllers.placement.mapped_ground import MappedGround
from perception.geometry.arrays import FloatArray
from perception.registration.target import possible_markers
from twin.robot import Command, Observation

_NEAR_STATION = (0.06, 0.12)  # Tolerances of the station: distance [m] and heading [rad].
_MOST_DRIVES = 4  # Largest number of drives to the station.


def mapped_ground(belief: MissionBelief) -> MappedGround:
    """Return the mapped ground in the ground frame of the slot.

    Args:
        belief: Estimates of the master; without a map no obstacles are known.
    """
    if belief.map is None or belief.localization is None:
        return MappedGround(None, RigidTransform.identity())
    to_map = belief.localization.transform_level_to_world * belief.transform_ground_to_level
    return MappedGround(belief.map.voxels.surface(), to_map.inv())


def choose_station(belief: MissionBelief) -> CameraStation:
    """Return the best camera station for card and slot that the master can reach.

    Args:
        belief: Estimates of the master.

    Raises:
        PlacementError: If there is no station.
    """
    start, ground = belief.transform_ground_to_level.inv().translation[:2], mapped_ground(belief)
    return best_camera_station(belief.robot, belief.site.insertion, ground=ground, start=start)


class PlaceCamera:
    """Drives the master to a camera station, and localizes it there by the panel.

    Args:
        belief: Estimates of the master; updated with the slot's pose at the station.
        station: Camera station to drive to, ground frame.

    Attributes:
        done: Whether the master is at the station, or has ended its last drive.
        station: Camera station to drive to, ground frame.
        stops: Number of drives that have ended by dead reckoning.
    """

    name = "place"

    def __init__(self, belief: MissionBelief, station: CameraStation) -> None:
        self.done = False
        self.station, self.stops = station, 0
        self._belief = belief
        self._set_off()

    def _set_off(self) -> None:
        """Begin a drive to the station, from the present estimate of the slot."""
        self._drive = DriveToPose(self._belief.steer(), self._path(), free=self._free)
        self._fold, self._folded = ArmMove(self._belief.home), False
        self._search: TargetSearch | None = None
        self._look: ArmMove | None = None

    def _path(self) -> FloatArray:
        """Return (3,) the station in the robot frame: x right, y ahead [m] and turn [rad]."""
        site = self._belief.transform_ground_to_level
        x, y, yaw = self.station.place
        place = site.apply([x, y, 0.0])
        ahead = site.rotation.apply([-math.sin(yaw), math.cos(yaw), 0.0])
        return np.array([place[0], place[1], math.atan2(-ahead[0], ahead[1])])

    def _free(self, pose: FloatArray) -> bool:
        """Return whether the map is free at a pose (3,) in the robot frame, as `_path` gives it."""
        ground = self._belief.site.insertion.transform_slot_to_ground
        site = ground * self._belief.transform_slot_to_level.inv()
        x, y, _ = site.apply([pose[0], pose[1], 0.0])
        return mapped_ground(self._belief).is_free([x, y])

    def _missed(self) -> bool:
        """Return whether the master is too far from the station."""
        x, y, turn = self._path()
        return math.hypot(x, y) > _NEAR_STATION[0] or abs(turn) > _NEAR_STATION[1]

    def step(self, seen: Observation) -> Command:
        """Fold the arm, drive, search for the panel."""
        if not self._folded:
            self._folded = self._fold.is_there(seen)
            return self._fold.command(seen)
        if not self._drive.done:
            return self._drive.step(seen)
        if self._look is None:
            self.stops += 1
            self._belief.reckon(self._drive.odometry)
            if self._belief.map is None:
                self.done = True
                return self._fold.command(seen)
            self._begin_search()
        assert self._look is not None
        command = self._look.command(seen)
        if self._look.sees(seen):
            self._take(seen)
        return command

    def _begin_search(self) -> None:
        """Begin the search in the panel's expected direction."""
        belief, config = self._belief, MapperConfig()
        arm, survey = camera_arm(belief.robot)[0], np.array(config.views.survey)
        extent = belief.site.target.extent
        self._search = TargetSearch(arm, belief.home, survey, extent, config.search)
        panel = belief.transform_slot_to_level * belief.site.transform_slot_to_panel.inv()
        self._look = ArmMove(aim(arm, panel.translation, survey))

    def _take(self, seen: Observation) -> None:
        belief, config = self._belief, MapperConfig()
        assert belief.map is not None and self._search is not None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        tilt = tilt_of(seen, belief.robot.name)
        pair = np.asarray(seen.stereo.value, dtype=np.uint8)
        arm = camera_arm(belief.robot)[0]
        found = belief.map.locate(arm, angles, tilt, pair, config.marker_sigma, config.localization)
        if found is not None:
            belief.localize(found)
            if self._missed() and self.stops < _MOST_DRIVES:
                self._set_off()
            else:
                self.done = True
            return
        hints = possible_markers(pair, stereo_geometry(belief.robot), belief.site.target)
        goal = self._search.after(angles, hints, tilt)
        self.done = goal is None
        if goal is not None:
            self._look = ArmMove(goal)
