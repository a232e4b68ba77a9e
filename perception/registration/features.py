"""Distinctive points of a stereo pair that are recognised in another view, however it has turned.

Patches (`patch_matching`) are found again where a good guess says; these points find their like in
the whole image, as after a turn that only the wheels have measured. OpenCV's SIFT describes them,
the stereo matcher gives their disparity, and the motion comes of `motion.estimate_motion`.
"""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray, ImageArray, IndexArray
from perception.registration.motion import Motion, estimate_motion
from perception.registration.reprojection import Sighting
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoPoints


@dataclasses.dataclass(frozen=True)
class FeatureConfig:
    """Configuration of the features of a pair and of their matching.

    Attributes:
        count: Largest number of features of a view.
        near: Greatest distance from a feature to the matched point whose disparity it takes [px].
        place_sigma: Standard deviation of a feature's column and row [px].
        disparity_sigma: Standard deviation of a feature's disparity beside the matched point's
            [px], for it lies some pixels off.
        ratio: Greatest distance of the best match over that of the second best (Lowe's test).
        window: Greatest distance of a match from where the guess has it [px].
        together: Greatest difference of two matches' distances from where the guess has them, if
            one error of the guess explains both [px].
        fewest: Least number of matches that belong together.
    """

    count: int = 500
    near: float = 5.0
    place_sigma: float = 0.2
    disparity_sigma: float = 0.1
    ratio: float = 0.75
    window: float = 350.0
    together: float = 60.0
    fewest: int = 10


@dataclasses.dataclass(frozen=True)
class ViewFeatures:
    """Features of one stereo pair.

    Attributes:
        sight: Image points of the N features with their standard deviations.
        descriptors: (N, 128) float32.
    """

    sight: Sighting
    descriptors: NDArray[np.float32]


class FeatureMatcher:
    """Finds features in pairs of one stereo head, and the motion between two views of it.

    Args:
        geometry: Geometry of the stereo head.
        config: Configuration of the features; None for the default.
    """

    def __init__(self, geometry: StereoGeometry, config: FeatureConfig | None = None) -> None:
        self._geometry, self._config = geometry, config or FeatureConfig()
        # Without the precise scaling features lie a quarter of a pixel off, which a turn shows.
        sift: Any = cv2.SIFT.create(self._config.count, enable_precise_upscale=True)
        self._sift = sift

    def find(self, image: ImageArray, points: StereoPoints) -> ViewFeatures:
        """Return the features of a view whose distance is known.

        Args:
            image: (height, width) uint8, the left image.
            points: Matched points of the pair.
        """
        config, points_found = self._config, len(points) > 0
        # SIFT begins at twice the size of its image: at that of the pair, a quarter of the work.
        half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        keys, descriptors = self._sift.detectAndCompute(half, None)
        if not keys or not points_found:
            return self._features(np.zeros((0, 3)), np.zeros(0), np.zeros((0, 128), np.float32))
        places = 2.0 * np.array([key.pt for key in keys]) + 0.5
        apart, nearest = cKDTree(points.pixels).query(places, distance_upper_bound=config.near)
        known = np.isfinite(apart)
        image_points = np.column_stack([places[known], points.disparities[nearest[known]]])
        sigma = np.hypot(points.sigmas[nearest[known]], config.disparity_sigma)
        return self._features(image_points, sigma, descriptors[known])

    def motion(self, before: ViewFeatures, after: ViewFeatures, guess: RigidTransform) -> Motion:
        """Return how the camera moved between two views.

        Args:
            before: Features of the first view.
            after: Features of the second view.
            guess: Rough transform from the left camera after the motion to that before.

        Raises:
            RegistrationError: If too few features agree on one motion.
        """
        first, second = self._matches(before, after, guess)
        sights = before.sight.chosen(first), after.sight.chosen(second)
        return estimate_motion("ml", *sights, guess=guess)

    def _features(
        self, image_points: FloatArray, sigma: FloatArray, descriptors: NDArray[np.float32]
    ) -> ViewFeatures:
        place = np.full((len(image_points), 2), self._config.place_sigma)
        sight = Sighting(image_points, np.column_stack([place, sigma]), self._geometry)
        return ViewFeatures(sight, descriptors)

    def _matches(
        self, before: ViewFeatures, after: ViewFeatures, guess: RigidTransform
    ) -> tuple[IndexArray, IndexArray]:
        """Return the indices of features that match, and that one error of the guess shifts."""
        config = self._config
        if min(len(before.descriptors), len(after.descriptors)) < 2:  # noqa: PLR2004
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(before.descriptors, after.descriptors, 2)
        kept = [best for best, other in pairs if best.distance < config.ratio * other.distance]
        first = np.array([match.queryIdx for match in kept], dtype=np.intp)
        second = np.array([match.trainIdx for match in kept], dtype=np.intp)
        expected = self._geometry.project(guess.inv().apply(before.sight.points()[first]))
        off = expected[:, :2] - after.sight.image_points[second, :2]
        near = np.hypot(*off.T) <= config.window  # NaN behind the camera is not.
        first, second, off = first[near], second[near], off[near]
        if not len(off):
            return first, second
        # A wrong guess shifts all matches alike; false matches scatter over the image.
        apart = np.linalg.norm(off[:, None] - off, axis=2) <= config.together
        agree = apart[int(np.argmax(apart.sum(axis=1)))]
        if agree.sum() < config.fewest:
            return first[:0], second[:0]
        return first[agree], second[agree]
