"""A camera that came loose: an eye of the stereo head that is turned otherwise than before.

What the calibration leaves unknown of the eyes is learned from the first pairs.
"""

import dataclasses

import numpy as np

from controllers.sensing.diagnosis import Finding
from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.checks import check_numbers
from perception.geometry.pinhole import Pinhole
from perception.registration.checks import RegistrationError
from perception.stereo.eye_turn import EyeTurn, find_eye_turn

LOOSE_CAMERA = "loose camera"
"""Name of the change; its size is the angle by which one eye turned against the other [rad]."""


@dataclasses.dataclass(frozen=True)
class LooseCameraConfig:
    """What counts as loose.

    Attributes:
        learning: Pairs of which the head as made is learned.
        lasting: Pairs in a row that are far from what was learned; what is named is their mean.
        off: Standard deviation of a turn by what the fit of a pair does not know, about each axis
            [rad].
        beyond: Deviations from which on an eye has turned.
        smallest: Least turn that is named [rad].
    """

    learning: int = 10
    lasting: int = 2
    off: float = 0.0005
    beyond: float = 8.0
    smallest: float = 0.005

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        check_numbers("camera", self, "learning", "lasting", "off", "beyond", "smallest")


class LooseCamera:
    """Watches the eyes of one stereo head.

    Args:
        eye: Intrinsics of either eye.
        config: What counts as loose; None for the default.
    """

    def __init__(self, eye: Pinhole, config: LooseCameraConfig | None = None) -> None:
        self._eye, self._config = eye, config or LooseCameraConfig()
        self._information, self._score = np.zeros((3, 3)), np.zeros(3)
        self._learned = 0
        #: Turns of the latest pairs that are far from the learned one.
        self._strange: list[EyeTurn] = []

    def step(self, images: ImageArray) -> Finding | None:
        """Take a pair.

        Args:
            images: (2, height, width) uint8, left and right.

        Returns:
            The change, if there is one. What it has become is what is learned from then on.
        """
        try:
            seen = find_eye_turn(images, self._eye)
        except RegistrationError:
            return None
        seen = seen._replace(covariance=seen.covariance + self._config.off**2 * np.eye(3))
        if self._learned < self._config.learning:
            self._learn([seen])
            return None
        mean, covariance = self._known()
        away = seen.turn - mean
        deviations = float(away @ np.linalg.solve(seen.covariance + covariance, away)) ** 0.5
        if deviations < self._config.beyond:
            self._strange = []
            self._learn([seen])
            return None
        self._strange.append(seen)
        if len(self._strange) < self._config.lasting:
            return None
        strange, self._strange = self._strange, []
        self._information, self._score, self._learned = np.zeros((3, 3)), np.zeros(3), 0
        self._learn(strange)
        turned, own = self._known()
        size = float(np.linalg.norm(turned - mean))
        if size < self._config.smallest:
            return None
        along = (turned - mean) / size
        sigma = float(along @ (covariance + own) @ along) ** 0.5
        return Finding(LOOSE_CAMERA, size, sigma, deviations)

    def _learn(self, turns: list[EyeTurn]) -> None:
        for each in turns:
            told = np.linalg.inv(each.covariance)
            self._information += told
            self._score += told @ each.turn
            self._learned += 1

    def _known(self) -> tuple[FloatArray, FloatArray]:
        """Return the turn that was learned, and its covariance."""
        covariance = np.asarray(np.linalg.inv(self._information), dtype=float)
        return covariance @ self._score, covariance
