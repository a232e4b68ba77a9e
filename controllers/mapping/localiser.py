"""Correct a camera's pose by fiducials of the scene, which stay in the map (section 3.2.5).

Arm and inclinometer say roughly where the camera is. Fiducials that earlier looks have put into
the map are sought there; where enough are found they and the arm tell the pose together, and the
map of fiducials is improved. Each look adds new ones. The map also keeps what all looks of a robot
err by alike, for no number of looks averages that away.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.mapping.localization import CameraPose
from perception.registration.fiducial_map import FiducialMap, PosePrior
from perception.registration.fiducials import FiducialConfig, select_fiducials
from perception.registration.patch_matching import TrackerConfig, track
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]
IndexArray = NDArray[np.intp]


@dataclasses.dataclass(frozen=True)
class LocaliserConfig:
    """How fiducials are chosen and found again.

    Attributes:
        fiducials: What makes a good one, and how many a look adds.
        tracker: How they are sought.
        place_sigma: Deviation of the column and row of a new fiducial [px]: it is where it was
            chosen to be.
        model_sigma: Deviation by which image points are off beside their noise [px]: the model is
            linear, and a product of two errors of 5 mrad or 5 mm is 0.03 px. In scene 3 of
            ``ch3-stereo`` 68 of 71 matches were believed with it, 63 without.
        fewest: Fiducials found without which the arm is believed. Three give nine numbers for the
            six of a pose, so they can contradict each other.
        turned: Greatest turn of the camera since a fiducial was seen first, at which it is still
            sought [rad]: later it looks another way.
        sources: Earlier looks in which fiducials are sought, at most.
    """

    fiducials: FiducialConfig = FiducialConfig(count=14, spacing=60.0)
    tracker: TrackerConfig = TrackerConfig(search=14)
    place_sigma: float = 0.01
    model_sigma: float = 0.05
    fewest: int = 3
    turned: float = 0.6
    sources: int = 4


@dataclasses.dataclass(frozen=True)
class Correction:
    """What the fiducials said of a look.

    Attributes:
        camera: Where it was.
        found: Image points (K, 3) of fiducials that were found again and believed [px].
        added: Image points (L, 3) of new ones.
        corrected: Whether they tell of the pose; else it is the arm's, better by what other looks
            have said of the errors that all looks of this robot share.
    """

    camera: CameraPose
    found: FloatArray
    added: FloatArray
    corrected: bool


@dataclasses.dataclass(frozen=True)
class _Source:
    """A look that put fiducials into the map.

    Attributes:
        pair: (2, H, W) uint8.
        transform_camera_to_world: Where it was taken from.
        numbers: (K,) of its fiducials in the map.
        image_points: (K, 3) where they were [px].
    """

    pair: ImageArray
    transform_camera_to_world: RigidTransform
    numbers: IndexArray
    image_points: FloatArray


class Localiser:
    """Fiducials of one scene, for all cameras."""

    def __init__(self, geometry: StereoGeometry, config: LocaliserConfig | None = None) -> None:
        """Start without any.

        Args:
            geometry: Of all stereo heads.
            config: How fiducials are chosen and found again.
        """
        self._geometry = geometry
        self._config = config or LocaliserConfig()
        self._sources: list[_Source] = []
        self.fiducials = FiducialMap(geometry, self._config.fiducials.sigma)

    def locate(self, pair: ImageArray, seen: StereoPoints, prior: PosePrior) -> Correction:
        """Return where a look was taken from, and take its fiducials in.

        Args:
            pair: (2, H, W) uint8.
            seen: Its points.
            prior: Where arm and inclinometer put the camera. Its offsets are those that
                `fiducials.share` has given.
        """
        expected, _ = self.fiducials.expected(prior)
        numbers, found, sigma = self._sought(pair, expected)
        fresh, fresh_sigma = self._fresh(pair[0], seen, found)
        if len(numbers) < self._config.fewest:
            numbers, found, sigma = numbers[:0], found[:0], sigma[:0]
        told = self.fiducials.observe_from(
            prior,
            numbers,
            found,
            sigma=np.hypot(sigma, self._config.model_sigma),
            new=fresh,
            new_sigma=fresh_sigma,
        )
        pose = told.registration
        camera = CameraPose(pose.transform_camera_to_world, pose.covariance)
        self._sources.append(_Source(pair, camera.transform_camera_to_world, told.added, fresh))
        return Correction(camera, found[pose.inliers], fresh, bool(pose.inliers.any()))

    def _sought(
        self, pair: ImageArray, transform_camera_to_world: RigidTransform
    ) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Return numbers, image points and deviations of fiducials that are found in a pair."""
        numbers, found, sigma = [np.zeros(0, np.intp)], [np.zeros((0, 3))], [np.zeros((0, 3))]
        for source in self._nearest(transform_camera_to_world):
            to_before = source.transform_camera_to_world.inv() * transform_camera_to_world
            visible = self._inside(source.numbers, transform_camera_to_world)
            if not visible.any():
                continue
            points = source.image_points[visible]
            tracks = track(
                source.pair, pair, points, self._geometry, to_before, self._config.tracker
            )
            numbers.append(source.numbers[visible][tracks.found])
            found.append(tracks.after[tracks.found])
            sigma.append(tracks.place_sigma[tracks.found])
        return np.concatenate(numbers), np.concatenate(found), np.concatenate(sigma)

    def _nearest(self, transform_camera_to_world: RigidTransform) -> list[_Source]:
        """Return the looks that were taken most like this one."""
        turns = [
            float(
                (
                    source.transform_camera_to_world.inv() * transform_camera_to_world
                ).rotation.magnitude()
            )
            for source in self._sources
        ]
        order = np.argsort(turns)[: self._config.sources]
        return [self._sources[n] for n in order if turns[n] <= self._config.turned]

    def _inside(
        self, numbers: IndexArray, transform_camera_to_world: RigidTransform
    ) -> NDArray[np.bool_]:
        """Return which fiducials should be in view."""
        points = self.fiducials.positions[numbers]
        if not len(points):
            return np.zeros(0, np.bool_)
        pixels = self._geometry.project(transform_camera_to_world.inv().apply(points))
        size = np.array([self._geometry.width, self._geometry.height])
        return np.all((pixels[:, :2] > 0.0) & (pixels[:, :2] < size), axis=1)

    def _fresh(
        self, image: ImageArray, seen: StereoPoints, found: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return image points (L, 3) of new fiducials away from those found, and deviations."""
        candidates = np.column_stack([seen.pixels, seen.disparities])
        chosen = select_fiducials(
            image, candidates, self._geometry, taken=found, config=self._config.fiducials
        )
        sigma = np.full((len(chosen.indices), 3), self._config.place_sigma)
        sigma[:, 2] = seen.sigmas[chosen.indices]
        return chosen.image_points, sigma
