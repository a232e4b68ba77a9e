"""The robots' common map, and the fusion of views into it."""

import itertools
from collections.abc import Iterable, Iterator, Sequence

import numba
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import (
    CameraPose,
    LocalizationConfig,
    RobotLocalization,
    camera_in_level,
    level_target,
    localize,
)
from perception.geometry.arrays import BoolArray, FloatArray, ImageArray
from perception.geometry.pinhole import Frustum
from perception.geometry.se3 import transform_points_with_covariance, transport_covariance
from perception.registration.checks import RegistrationError
from perception.registration.closed_form import kabsch_pose
from perception.registration.likelihood import PoseSolution, solve
from perception.registration.reprojection import KnownPoints, Pose, Sighting
from perception.registration.target import SeenTarget, TargetCad, find_target
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State

_KNOWN = 1e-10  # Variance of a marker's position in the CAD [m^2].
_FAINT = np.full(3, 0.1)
"""Standard deviations of column, row and disparity of a marker that is small or dim [px]."""
_BESIDE = 0.15  # Width beside the markers of a target that is searched, too [m].
_CLEARLY, _ELSEWHERE = 12.0, 22.5
"""By how much squared residuals of another pose must exceed those of the best one, if their squared
normalised distance is more than that."""
_MISFIT = 6.0  # Squared normalised residuals per degree of freedom of markers that do not fit.


class SharedMap:
    """Voxel map whose frame is defined by the target.

    Args:
        voxels: Empty or partial map; the target is at its origin.
        geometry: Geometry of all stereo heads.
        cad: Markers of the target.
        stride: Distance between matched pixels [px].
        reach: Nearest and farthest depth that enters the map [m].

    Attributes:
        voxels: The map, in the world that the target defines.
        geometry: Geometry of all stereo heads.
        cad: Markers of the target.
        transform_target_to_world: Transform from the target to the world; None until a robot has
            detected it.
    """

    def __init__(
        self,
        voxels: VoxelMap,
        geometry: StereoGeometry,
        cad: TargetCad,
        stride: int,
        reach: tuple[float, float],
    ) -> None:
        self.voxels = voxels
        self.transform_target_to_world: RigidTransform | None = None
        self.geometry, self.cad, self._reach = geometry, cad, reach
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
        """Localize a robot by the target in its view; the first detection defines the world.

        Args:
            arm: Chain of the robot's arm, with the left camera as its tool.
            angles: (joints,) joint angles of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
            pair: (2, H, W) uint8 left and right image.
            sigma: (3,) standard deviations of a marker's column, row and disparity [px].
            config: Standard deviations of the camera pose by arm and inclinometer.

        Returns:
            Localization of the robot; None if the target is not detected.
        """
        target = find_target(pair, self.geometry, self.cad, sigma)
        if target is None:
            return None
        camera = self.camera_at(target, np.asarray(sigma, dtype=float))
        return None if camera is None else self.localized(arm, angles, tilt, camera, config)

    def localized(
        self,
        arm: SerialChain,
        angles: FloatArray,
        tilt: FloatArray,
        camera: CameraPose,
        config: LocalizationConfig,
    ) -> RobotLocalization:
        """Localize a robot by its camera's pose; the first one defines the world.

        Args:
            arm: Chain of the robot's arm, with the left camera as its tool.
            angles: (joints,) joint angles of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
            camera: Pose of the left camera in the target's frame.
            config: Standard deviations of the camera pose by arm and inclinometer.
        """
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

    def sight(self, pair: ImageArray, places: FloatArray | None = None) -> CameraPose | None:
        """Return the camera's pose in the frame of a target that is far away or in the shade.

        Args:
            pair: (2, H, W) uint8 left and right image.
            places: (N, 3) where the target's middle may be [m], as in `sights`.

        Returns:
            The pose; None where the target is not seen, or another pose fits it hardly worse.
        """
        poses = self.sights(pair, places)
        return poses[0] if len(poses) == 1 else None

    def sights(self, pair: ImageArray, places: FloatArray | None = None) -> list[CameraPose]:
        """Return the poses that the camera may have in the frame of a target that is far away.

        Args:
            pair: (2, H, W) uint8 left and right image.
            places: (N, 3) where the target's middle may be [m], left camera frame: no other part of
                the images is searched, which takes time. None for anywhere.

        Returns:
            Poses that fit about alike, the best first; none where the target is not seen.
        """
        window = None if places is None else self._window(places)
        if places is not None and window is None:
            return []
        target = find_target(pair, self.geometry, self.cad, _FAINT, far=True, window=window)
        return [] if target is None else self.poses_at(target, _FAINT)

    def _window(self, places: FloatArray) -> tuple[slice, slice] | None:
        """Return the rows and columns that show targets at places (N, 3); None for none of them."""
        geometry, half = self.geometry, 0.5 * self.cad.extent + _BESIDE
        image, near = geometry.project(places), geometry.fx * half / places[:, 2]
        inside = (image[:, :2] >= 0.0) & (image[:, :2] <= [geometry.width, geometry.height])
        shown = inside.all(axis=1)
        if not shown.any():
            return None
        (column, row, disparity), near = image[shown].T, near[shown]
        left, top = min(column - disparity - near), min(row - near)
        right, bottom = max(column + near), max(row + near)
        return (
            slice(max(int(top), 0), min(int(bottom) + 1, geometry.height)),
            slice(max(int(left), 0), min(int(right) + 1, geometry.width)),
        )

    def camera_at(self, target: SeenTarget, sigma: FloatArray) -> CameraPose | None:
        """Return the camera's pose in the target's frame.

        Three markers are enough, if they can be no others. Far away, a flat target that is turned
        to one side looks like one that is turned to the other, and three markers like three others.

        Args:
            target: Markers of the target as a view shows them.
            sigma: (3,) standard deviations of a marker's column, row and disparity [px].

        Returns:
            The pose, whose covariance includes the errors of the head's calibration; None if the
            markers do not fit, or another pose fits them hardly worse.
        """
        poses = self.poses_at(target, sigma)
        return poses[0] if len(poses) == 1 else None

    def poses_at(self, target: SeenTarget, sigma: FloatArray) -> list[CameraPose]:
        """Return the camera's poses that fit a target's markers about alike, the best first.

        Args:
            target: Markers of the target as a view shows them.
            sigma: (3,) standard deviations of a marker's column, row and disparity [px].
        """
        ways: Iterable[Sequence[int]] = [target.indices.tolist()]
        if len(target.indices) < len(self.cad.points):
            ways = itertools.permutations(range(len(self.cad.points)), len(target.indices))
        fits = [fit for way in ways for fit in self._fits(way, target.image_points, sigma)]
        fits.sort(key=lambda fit: fit.cost)
        poses: list[CameraPose] = []
        for fit in fits:
            to_target = fit.pose.transform()
            alike = fit is fits[0] or fit.cost < fits[0].cost + _CLEARLY
            if alike and all(_is_elsewhere(to_target, other) for other in poses):
                poses.append(CameraPose(to_target, fit.covariance))
        return poses

    def _fits(
        self, markers: Sequence[int], image_points: FloatArray, sigma: FloatArray
    ) -> Iterator[PoseSolution]:
        """Yield the camera's poses that fit markers (M,) at image points (M, 3)."""
        points = self.cad.points[list(markers)]
        sight = Sighting(image_points, np.broadcast_to(sigma, (len(points), 3)), self.geometry)
        seen = self.geometry.points(image_points)
        start = kabsch_pose(points, seen, np.ones(len(points)))
        # What errors of the calibration do to the image, markers out of place would do as well.
        moved = (start.rotation @ self.geometry.calibration_shifts(seen)).reshape(-1, 9)
        known = KnownPoints(points, _KNOWN * np.eye(len(moved)) + moved @ moved.T)
        for begin in (start, _mirrored(start, points.mean(axis=0))):
            try:
                found = solve(begin, known, sight)
            except RegistrationError:
                continue
            ahead = found.pose.transform().translation[2] > 0.0
            if ahead and found.cost < _MISFIT * (3 * len(points) - 6):
                yield found

    def fuse(self, camera: CameraPose, points: StereoPoints, excluded: FloatArray) -> int:
        """Fuse the points of a view into the map.

        Args:
            camera: Pose of the left camera.
            points: Matched points, camera frame.
            excluded: (M, 4) spheres about the moving robots: centre and radius [m], world.

        Returns:
            Number of fused points.
        """
        near, far = self._reach
        inside = (points.points[:, 2] >= near) & (points.points[:, 2] <= far)
        places, covariances = transform_points_with_covariance(
            camera.transform_camera_to_world,
            camera.covariance,
            points.points[inside],
            points.covariances[inside],
        )
        kept = ~within(places, excluded)
        return self.voxels.insert(
            camera.transform_camera_to_world, self._frustum, places[kept], covariances[kept]
        )

    def occupied_and_free(self, points: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return (N,), whether points (N, 3) [m] are in occupied voxels, and in free ones."""
        occupied = self.voxels.states(points) == State.OCCUPIED
        free = self.voxels.probabilities(points) < 0.05  # noqa: PLR2004
        return np.asarray(occupied), np.asarray(free)


def _is_elsewhere(to_target: RigidTransform, other: CameraPose) -> bool:
    """Return whether a pose of the camera is beyond what another one's covariance leaves open."""
    xi = (to_target * other.transform_camera_to_world.inv()).as_exp_coords()
    return bool(xi @ np.linalg.solve(other.covariance, xi) > _ELSEWHERE)


def _mirrored(pose: Pose, middle: FloatArray) -> Pose:
    """Return the pose from which a flat target looks alike, but for its perspective.

    Its face is turned as far to the other side of the line of sight. Source: Collins and Bartoli
    (2014), "Infinitesimal plane-based pose estimation".

    Args:
        pose: Pose of the camera in the target's frame.
        middle: (3,) middle of the target [m].
    """
    to_target = pose.transform()
    ray = to_target.translation - middle
    sight, face = ray / np.linalg.norm(ray), np.array([0.0, 0.0, 1.0])
    # The camera goes to the other side of the face's normal, about the target's middle.
    turn, _ = Rotation.align_vectors([2.0 * (face @ sight) * face - sight], [sight])
    about = RigidTransform.from_translation(middle)
    return Pose.of(about * RigidTransform.from_rotation(turn) * about.inv() * to_target)


@numba.njit(cache=True)
def within(points: FloatArray, spheres: FloatArray) -> BoolArray:
    """Return (N,), whether points (N, 3) lie in one of the spheres (M, 4), centre and radius."""
    hit = np.zeros(len(points), np.bool_)
    for point in range(len(points)):
        for sphere in range(len(spheres)):
            square = 0.0
            for axis in range(3):
                square += (points[point, axis] - spheres[sphere, axis]) ** 2
            if square < spheres[sphere, 3] ** 2:
                hit[point] = True
                break
    return hit
