"""The map that robots share, and how a look enters it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import (
    CameraPose,
    LocalizationConfig,
    RobotLocalization,
    camera_in_level,
    level_target,
    localize,
)
from perception.geometry.pinhole import Frustum
from perception.geometry.se3 import transform_points_with_covariance, transport_covariance
from perception.registration.checks import RegistrationError
from perception.registration.closed_form import kabsch_pose
from perception.registration.likelihood import solve
from perception.registration.reprojection import KnownPoints, Sighting
from perception.registration.target import SeenTarget, TargetCad, find_target
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
ImageArray = NDArray[np.uint8]

_KNOWN = 1e-10  # Variance of what a CAD says [m^2].
_MISFIT = 6.0  # Squared normalised residuals per degree of freedom of markers that do not fit.


class SharedMap:
    """Voxels, and the target that fixes their frame.

    Attributes:
        voxels: The map, in the world that the target defines.
        transform_target_to_world: None until a robot has seen the target.
    """

    def __init__(
        self,
        voxels: VoxelMap,
        geometry: StereoGeometry,
        cad: TargetCad,
        stride: int,
        reach: tuple[float, float],
    ) -> None:
        """Start with nothing known.

        Args:
            voxels: An empty map.
            geometry: Of all stereo heads.
            cad: The target's markers.
            stride: Of the pixels that are matched.
            reach: Nearest and farthest depth that enters the map [m].
        """
        self.voxels = voxels
        self.transform_target_to_world: RigidTransform | None = None
        self._geometry, self._cad, self._reach = geometry, cad, reach
        frustum = Frustum(*geometry.intrinsics, *reach)
        self._frustum = frustum.resized(geometry.width // stride, geometry.height // stride)

    def locate(
        self,
        arm: SerialChain,
        angles: FloatArray,
        tilt: FloatArray,
        pair: ImageArray,
        sigma: ArrayLike,
        config: LocalizationConfig,
    ) -> RobotLocalization | None:
        """Return where a robot stands if it sees the target; the first one defines the world.

        Args:
            arm: Its kinematics.
            angles: (joints,) of its arm [rad].
            tilt: (2,) pitch and roll [rad].
            pair: (2, H, W) uint8.
            sigma: (3,) deviations of a marker's column, row and disparity [px].
            config: How well arm and inclinometer tell where the camera is.
        """
        target = find_target(pair, self._geometry, self._cad, sigma)
        if target is None:
            return None
        camera = self._camera_at(target, np.asarray(sigma, dtype=float))
        if camera is None:
            return None
        if self.transform_target_to_world is None:
            in_level = camera_in_level(arm, angles, tilt)
            to_level = in_level * camera.transform_camera_to_world.inv()
            self.transform_target_to_world = level_target(to_level)
        to_world = self.transform_target_to_world
        in_world = CameraPose(
            to_world * camera.transform_camera_to_world,
            transport_covariance(to_world, camera.covariance),
        )
        return localize(arm, angles, tilt, in_world, config)

    def _camera_at(self, target: SeenTarget, sigma: FloatArray) -> CameraPose | None:
        """Return where the camera is in the target's frame; None if the markers do not fit.

        Three markers are enough: their distances have told which they are.
        """
        markers = self._cad.points[target.indices]
        known = KnownPoints(markers, np.broadcast_to(_KNOWN * np.eye(3), (len(markers), 3, 3)))
        sight = Sighting(
            target.image_points, np.broadcast_to(sigma, (len(markers), 3)), self._geometry
        )
        seen = self._geometry.points(target.image_points)
        try:
            start = kabsch_pose(markers, seen, np.ones(len(markers)))
            found = solve(start, known, sight)
        except RegistrationError:
            return None
        if found.cost > _MISFIT * (3 * len(markers) - 6):
            return None
        return CameraPose(found.pose.transform(), found.covariance)

    def fuse(self, camera: CameraPose, seen: StereoPoints, left_out: FloatArray) -> int:
        """Put what a camera saw into the map.

        Args:
            camera: Where it was.
            seen: Points in its frame.
            left_out: (M, 4) spheres, centre and radius [m], world: robots, which move.

        Returns:
            How many points were used.
        """
        near, far = self._reach
        inside = (seen.points[:, 2] >= near) & (seen.points[:, 2] <= far)
        points, covariances = transform_points_with_covariance(
            camera.transform_camera_to_world,
            camera.covariance,
            seen.points[inside],
            seen.covariances[inside],
        )
        kept = ~within(points, left_out)
        return self.voxels.insert(
            camera.transform_camera_to_world, self._frustum, points[kept], covariances[kept]
        )

    def occupied_and_free(self, points: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return (N,) which points [m] lie in what was measured occupied, and which are free."""
        occupied = self.voxels.states(points) == State.OCCUPIED
        free = self.voxels.probabilities(points) < 0.05  # noqa: PLR2004
        return np.asarray(occupied), np.asarray(free)


def within(points: FloatArray, spheres: FloatArray) -> BoolArray:
    """Return (N,), whether points (N, 3) lie in one of the spheres (M, 4), centre and radius."""
    hit = np.zeros(len(points), np.bool_)
    for *centre, radius in spheres:
        offset = points - centre
        hit |= np.einsum("ij,ij->i", offset, offset) < radius**2
    return hit
