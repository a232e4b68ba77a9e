"""How the right eye of a stereo head is turned against the left, from one pair, whatever it shows.

In a head as drawn a point appears in the same row of both images. Where it does not, an eye has
turned, and how the rows differ over the image tells about which axis. Features are matched
anywhere in the other image, as a camera that came loose leaves no row in its place.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.pinhole import Pinhole
from perception.registration.checks import RegistrationError

FEWEST = 20
"""Matches below which nothing is told."""
_COUNT = 400  # Features of an image, at half its size.
_RATIO = 0.75  # Greatest distance of the best match over that of the second best (Lowe's test).
_WINDOW = 0.1  # Greatest difference of the directions in which both eyes see a point, across.
_SIGMA = 0.3  # Deviation of the rows of a match that is right [px].
_SCALES = (100.0, 30.0, 10.0, 3.0, 1.0, 1.0, 1.0, 1.0)
"""Deviations beyond which matches count little, step by step: false ones are off by hundreds."""
_LEAST = 100.0  # Information about each axis that is there beforehand: it turned little [rad^-2].
_GOOD = 3.0  # Deviations up to which a match counts as right.


class EyeTurn(NamedTuple):
    """A turn that was seen.

    Attributes:
        turn: (3,) rotation vector of the right eye, in its frame as drawn [rad].
        covariance: (3, 3) of that [rad^2].
    """

    turn: FloatArray
    covariance: FloatArray


def find_eye_turn(images: ImageArray, eye: Pinhole) -> EyeTurn:
    """Return how the right eye is turned.

    Args:
        images: (2, height, width) uint8, left and right.
        eye: Intrinsics of either eye, whose rows are aligned as drawn.

    Raises:
        RegistrationError: If too few points are seen by both.
    """
    left, right = _matched(images, eye)
    turn, information = Rotation.identity(), np.eye(3)
    off = np.zeros(len(left))
    for scale in _SCALES:
        x, y, z = np.asarray(turn.apply(right), dtype=float).T
        off = (left[:, 1] - y / z) * eye.fy / _SIGMA
        slopes = np.column_stack([-z - y * y / z, x * y / z, x]) / z[:, None] * eye.fy / _SIGMA
        weighed = slopes / (1.0 + (off / scale) ** 2)[:, None]  # As of Cauchy's distribution.
        information = weighed.T @ slopes + _LEAST * np.eye(3)
        pull = np.asarray(weighed.T @ off, dtype=float)
        step = np.asarray(np.linalg.solve(information, pull), dtype=float)
        turn = Rotation.from_rotvec(step) * turn
    good = int(np.count_nonzero(np.abs(off) < _GOOD))
    if good < FEWEST:
        raise RegistrationError(f"{good} points lie alike in both images, expected {FEWEST}")
    covariance = np.asarray(np.linalg.inv(information), dtype=float)
    return EyeTurn(np.asarray(turn.as_rotvec(), dtype=float), covariance)


def _matched(images: ImageArray, eye: Pinhole) -> tuple[FloatArray, FloatArray]:
    """Return the directions (N, 3) in which the left and the right eye see the same points."""
    (left_keys, one), (right_keys, other) = (_features(image) for image in images)
    if min(len(left_keys), len(right_keys)) < FEWEST:
        raise RegistrationError(f"an eye sees fewer than {FEWEST} points")
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(one, other, 2)
    kept = [best for best, second in pairs if best.distance < _RATIO * second.distance]
    if len(kept) < FEWEST:
        raise RegistrationError(f"{len(kept)} points are seen by both eyes, expected {FEWEST}")
    left = _directions(left_keys[[each.queryIdx for each in kept]], eye)
    right = _directions(right_keys[[each.trainIdx for each in kept]], eye)
    near = np.abs(left[:, 1] - right[:, 1]) < _WINDOW
    return left[near], right[near]


def _features(image: ImageArray) -> tuple[FloatArray, NDArray[np.float32]]:
    """Return places (n, 2) [px] and descriptors (n, 128) of an image's features."""
    sift: Any = cv2.SIFT.create(_COUNT, enable_precise_upscale=True)
    half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    keys, descriptors = sift.detectAndCompute(half, None)
    places = np.array([key.pt for key in keys], dtype=float).reshape(-1, 2)
    return 2.0 * places + 0.5, descriptors


def _directions(places: FloatArray, eye: Pinhole) -> FloatArray:
    """Return the directions (N, 3) of pixels (N, 2), one long along the optical axis."""
    centre, focal = [eye.cx, eye.cy], [eye.fx, eye.fy]
    return np.column_stack([(places - centre) / focal, np.ones(len(places))])
