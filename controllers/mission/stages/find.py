"""Stage ``find``, chapter 3: the master looks for the panel, and maps what it sees on the way."""

from __future__ import annotations

import numpy as np

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.looking import MapperConfig, RobotBrief
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mission.belief import MissionBelief
from perception.stereo.geometry import StereoGeometry
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.description import RobotDescription
from twin.robot import Command, Observation

VOXEL = 0.01
"""Edge of the map's voxels [m]."""
BOX = ((-1.8, -2.4, -0.2), (1.8, 1.4, 0.68))
"""Corners of the map [m], about the panel."""
_SEARCH_SCANS = 20  # All views of the search, and some hints that it follows.


class FindPanel:
    """Drives the master's arm until it has found the panel and taken its views.

    Args:
        belief: Gets the map, and where the slot is from the master.
        scans: Number of views; more only until it has found the panel.
        rng: Random generator for candidate views.

    Attributes:
        mapper: Takes the views.
    """

    name = "find"

    def __init__(self, belief: MissionBelief, scans: int, rng: np.random.Generator) -> None:
        self._belief, robot = belief, belief.robot
        self.mapper = StereoMapper(
            {robot.name: brief(robot)},
            eyes(robot),
            belief.site.target,
            VoxelMap(VoxelGrid(VOXEL, *BOX)),
            MapperConfig(scans=scans, search_scans=_SEARCH_SCANS),
            rng,
        )

    @property
    def done(self) -> bool:
        """Whether no view is left."""
        return self.mapper.done

    def step(self, seen: Observation) -> Command:
        """Look on."""
        name = self._belief.robot.name
        command = self.mapper.step({name: seen})[name]
        found = self.mapper.standings.get(name)
        if self.mapper.done and found is not None:
            self._belief.map = self.mapper.shared
            self._belief.localize(found)
        return command


def brief(robot: RobotDescription) -> RobotBrief:
    """Return what a mapper knows of a robot as drawn."""
    assert robot.arm is not None
    return RobotBrief(camera_arm(robot)[0], robot.arm.home, robot.body_spheres)


def eyes(robot: RobotDescription) -> StereoGeometry:
    """Return the geometry of a robot's stereo head as drawn."""
    head = camera_arm(robot)[1]
    return StereoGeometry(*head.camera.intrinsics, head.baseline)
