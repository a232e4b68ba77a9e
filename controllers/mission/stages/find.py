"""Stage ``find``, chapter 3: the master searches for the panel, and maps the searched views."""

import numpy as np

from controllers.insertion.camera_station import stereo_geometry
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import MapperConfig
from controllers.mission.belief import MissionBelief
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.robot import Command, Observation

VOXEL = 0.01
"""Edge of the map's voxels [m]."""
BOX = ((-1.8, -2.4, -0.2), (1.8, 1.4, 0.68))
"""Corners of the map [m], about the panel."""
_SEARCH_SCANS = 20  # All views of the search pattern, and some of possible markers.


class FindPanel:
    """Drives the master's arm until it has found the panel and taken its views.

    Args:
        belief: Estimates of the master; gets the map, and the slot's pose.
        scans: Number of views; exceeded only until the panel is found.
        rng: Random generator for candidate views.

    Attributes:
        mapper: Mapper that takes the views.
    """

    name = "find"

    def __init__(self, belief: MissionBelief, scans: int, rng: np.random.Generator) -> None:
        self._belief, robot = belief, belief.robot
        config = MapperConfig(scans=scans, search_scans=_SEARCH_SCANS)
        voxels, target = VoxelMap(VoxelGrid(VOXEL, *BOX)), belief.site.target
        shared = SharedMap(
            voxels, stereo_geometry(robot), target, config.stereo.stride, config.reach
        )
        self.mapper = StereoMapper({robot.name: robot}, shared, config, rng)

    @property
    def done(self) -> bool:
        """Whether no view is left."""
        return self.mapper.done

    def step(self, seen: Observation) -> Command:
        """Return the command towards the next view."""
        name = self._belief.robot.name
        command = self.mapper.step({name: seen})[name]
        found = self.mapper.localizations.get(name)
        if self.mapper.done and found is not None:
            self._belief.map = self.mapper.shared
            self._belief.localize(found)
        return command
