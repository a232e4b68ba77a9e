"""Correct a camera's pose by natural fiducials of the scene, stored in a map (section 3.2.5).

Arm and inclinometer predict the camera's pose. Fiducials that earlier views added to the map are
searched for in the image; if enough are found, the pose is estimated from them and the prediction,
and the map of fiducials is updated. Each view adds new ones. The map also estimates the errors that
are common to all views of a robot, which averaging over views does not reduce.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.mapping.localization import CameraPose
from perception.geometry.arrays import FloatArray, ImageArray, IndexArray
from perception.registration.fiducial_map import FiducialMap, PosePrior
from perception.registration.fiducials import FiducialConfig, select_fiducials
from perception.registration.patch_matching import TrackerConfig, track
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints


@dataclasses.dataclass(frozen=True)
class FiducialLocalizerConfig:
    """Configuration of the choice of fiducials and of the search for them.

    Attributes:
        fiducials: Configuration of the selection, and of the number that a view adds.
        tracker: Configuration of the search for fiducials in a new view.
        place_sigma: Standard deviation of the column and row of a new fiducial [px]; small, for the
            selected pixel defines it.
        model_sigma: Standard deviation of image points in addition to noise [px]: the model is
            linear, and a product of two errors of 5 mrad or 5 mm is 0.03 px. In scene 3 of
            ``ch3-stereo`` 68 of 71 matches were accepted with it, 63 without.
        fewest: Least number of fiducials for a correction. Three give nine measurements of the six
            parameters of a pose, so outliers can be detected.
        turned: Largest turn of the camera since a fiducial's first view at which it is still
            searched for [rad]: its patch changes with the view.
        sources: Largest number of earlier views whose fiducials are searched for.
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
    """A camera pose corrected by fiducials.

    Attributes:
        camera: Pose of the left camera.
        found: (K, 3) image points of fiducials that were found again and accepted [px].
        added: (L, 3) image points of new fiducials [px].
        corrected: Whether fiducials of this view contributed; if not, the pose is the prediction
            with the common errors estimated from other views.
    """

    camera: CameraPose
    found: FloatArray
    added: FloatArray
    corrected: bool


@dataclasses.dataclass(frozen=True)
class _SourceView:
    """A view that put fiducials into the map.

    Attributes:
        pair: (2, H, W) uint8 left and right image.
        transform_camera_to_world: Transform from the left camera to the world.
        numbers: (K,) indices of its fiducials in the map.
        image_points: (K, 3) columns, rows and disparities of the fiducials [px].
    """

    pair: ImageArray
    transform_camera_to_world: RigidTransform
    numbers: IndexArray
    image_points: FloatArray


class FiducialLocalizer:
    """Localizes the cameras of all robots by the fiducials of one scene.

    Args:
        geometry: Geometry of all stereo heads.
        config: Configuration of the choice and the search; None for the default.

    Attributes:
        fiducials: Map of the fiducials.
    """

    def __init__(
        self, geometry: StereoGeometry, config: FiducialLocalizerConfig | None = None
    ) -> None:
        self._geometry = geometry
        self._config = config or FiducialLocalizerConfig()
        self._sources: list[_SourceView] = []
        self.fiducials = FiducialMap(geometry, self._config.fiducials.sigma)

    def locate(self, pair: ImageArray, points: StereoPoints, prior: PosePrior) -> Correction:
        """Estimate the camera pose of a view, and add the view's fiducials to the map.

        Args:
            pair: (2, H, W) uint8 left and right image.
            points: Matched points of the pair.
            prior: Predicted camera pose; its offsets are indices that `fiducials.share` returned.
        """
        expected, _ = self.fiducials.expected(prior)
        numbers, found, sigma = self._find_again(pair, expected)
        added, added_sigma = self._select_new(pair[0], points, found)
        if len(numbers) < self._config.fewest:
            numbers, found, sigma = numbers[:0], found[:0], sigma[:0]
        observed = self.fiducials.observe_from(
            prior,
            numbers,
            found,
            sigma=np.hypot(sigma, self._config.model_sigma),
            new=added,
            new_sigma=added_sigma,
        )
        pose = observed.registration
        to_world = pose.transform_camera_to_world
        self._sources.append(_SourceView(pair, to_world, observed.added, added))
        camera = CameraPose(to_world, pose.covariance)
        return Correction(camera, found[pose.inliers], added, bool(pose.inliers.any()))

    def _find_again(
        self, pair: ImageArray, transform_camera_to_world: RigidTransform
    ) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Return numbers, image points and standard deviations of fiducials found in a pair."""
        numbers, found, sigma = [np.zeros(0, np.intp)], [np.zeros((0, 3))], [np.zeros((0, 3))]
        for source in self._nearest(transform_camera_to_world):
            to_before = source.transform_camera_to_world.inv() * transform_camera_to_world
            visible = self._inside(source.numbers, transform_camera_to_world)
            if not visible.any():
                continue
            before = source.image_points[visible]
            tracks = track(
                source.pair, pair, before, self._geometry, to_before, self._config.tracker
            )
            numbers.append(source.numbers[visible][tracks.found])
            found.append(tracks.after[tracks.found])
            sigma.append(tracks.place_sigma[tracks.found])
        return np.concatenate(numbers), np.concatenate(found), np.concatenate(sigma)

    def _nearest(self, transform_camera_to_world: RigidTransform) -> list[_SourceView]:
        """Return the earlier views nearest in rotation to a pose."""
        motions = [
            s.transform_camera_to_world.inv() * transform_camera_to_world for s in self._sources
        ]
        turns = [float(motion.rotation.magnitude()) for motion in motions]
        order = np.argsort(turns)[: self._config.sources]
        return [self._sources[n] for n in order if turns[n] <= self._config.turned]

    def _inside(
        self, numbers: IndexArray, transform_camera_to_world: RigidTransform
    ) -> NDArray[np.bool_]:
        """Return (K,) which fiducials project into the image."""
        points = self.fiducials.positions[numbers]
        if not len(points):
            return np.zeros(0, np.bool_)
        pixels = self._geometry.project(transform_camera_to_world.inv().apply(points))
        size = np.array([self._geometry.width, self._geometry.height])
        return np.all((pixels[:, :2] > 0.0) & (pixels[:, :2] < size), axis=1)

    def _select_new(
        self, image: ImageArray, points: StereoPoints, found: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return image points (L, 3) of new fiducials away from those found, and sigmas."""
        candidates = np.column_stack([points.pixels, points.disparities])
        chosen = select_fiducials(
            image, candidates, self._geometry, taken=found, config=self._config.fiducials
        )
        sigma = np.full((len(chosen.indices), 3), self._config.place_sigma)
        sigma[:, 2] = points.sigmas[chosen.indices]
        return chosen.image_points, sigma
