"""Ground from a voxel map: free positions of a rover, and the occluders of a target.

Obstacles are the points of the map's surface above level ground. A rover is a disc about its
middle; a position with several obstacle points within the disc is not free, and unknown ground is
free.
"""

import dataclasses
import functools

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from controllers.placement.spatial.occluders import occluders_of_points
from controllers.placement.task import Occluder
from perception.geometry.arrays import FloatArray
from perception.voxels.map import Surface


@dataclasses.dataclass(frozen=True)
class GroundConfig:
    """Size of a rover, and which points are obstacles to it.

    Attributes:
        radius: Radius of a disc about the rover's middle that holds it [m].
        climb: Height above the ground up to which a rover drives over things [m].
        top: Height above the ground from which a rover passes under things [m].
        min_points: Number of surface points within the disc from which on it is not free.
        voxel: Side of the voxels that occluders are made of [m].
        occluder_range: Distance from a target within which mapped points are its occluders [m].
        face: Distance out of a target's plane up to which points are the target's own [m].
    """

    radius: float = 0.30
    climb: float = 0.08
    top: float = 0.45
    min_points: int = 3
    voxel: float = 0.01
    occluder_range: float = 0.9
    face: float = 0.05


class MappedGround:
    """Obstacles on level ground, from the surface of a voxel map.

    Args:
        surface: Surface of a voxel map; None where nothing is mapped.
        transform_map_to_ground: Transform from the map's frame to the ground frame, which is level
            with z = 0 on the ground.
        config: Size of the rover and limits of obstacles.
        further: (M, 3) further points of obstacles [m], ground frame; None for none.

    Attributes:
        points: (N, 3) points of obstacles [m], ground frame.
    """

    def __init__(
        self,
        surface: Surface | None,
        transform_map_to_ground: RigidTransform,
        config: GroundConfig | None = None,
        further: ArrayLike | None = None,
    ) -> None:
        self._config = config or GroundConfig()
        self.points = np.zeros((0, 3))
        if surface is not None and len(surface.means):
            places = transform_map_to_ground.apply(surface.means)
            # A point whose height is as uncertain as it is high is not above the ground.
            sigma = np.sqrt(np.einsum("nii->n", surface.covariances))
            self.points = places[places[:, 2] - sigma > self._config.climb]
        if further is not None:
            self.points = np.vstack([self.points, np.reshape(further, (-1, 3))])

    @functools.cached_property
    def _obstacles(self) -> FloatArray:
        """(M, 2) x and y of the points that touch a rover [m]."""
        low = self.points[:, 2] < self._config.top
        return np.asarray(self.points[low, :2])

    def is_free(self, place: ArrayLike) -> bool:
        """Return whether a rover is free of obstacles at a position (2,) [m], ground frame."""
        x, y = np.asarray(place, dtype=float)
        off = np.hypot(self._obstacles[:, 0] - x, self._obstacles[:, 1] - y)
        return int(np.sum(off < self._config.radius)) < self._config.min_points

    def touches(self, spheres: FloatArray, margin: float) -> bool:
        """Return whether several points of an obstacle are within or near a robot's spheres.

        Args:
            spheres: (N, 4) centre and radius [m], ground frame.
            margin: Distance from a sphere within which a point is near [m].
        """
        tree = cKDTree(self.points)
        near = tree.query_ball_point(spheres[:, :3], spheres[:, 3] + margin)
        return len(set().union(*near)) >= self._config.min_points

    def before(self, position: FloatArray, normal: FloatArray) -> FloatArray:
        """Return the points (K, 3) of obstacles before a target and near it [m], ground frame.

        Args:
            position: (3,) position of the target [m], ground frame.
            normal: (3,) unit vector out of its visible side, ground frame.
        """
        config, away = self._config, self.points - position
        near = np.linalg.norm(away, axis=1) < config.occluder_range
        return self.points[near & (away @ normal > config.face)]

    def occluders(self, position: FloatArray, normal: FloatArray) -> list[Occluder]:
        """Return the obstacles before a target, as convex pieces.

        Args:
            position: (3,) position of the target [m], ground frame.
            normal: (3,) unit vector out of its visible side, ground frame.
        """
        return occluders_of_points(self.before(position, normal), self._config.voxel)
