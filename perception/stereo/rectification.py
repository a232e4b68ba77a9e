"""Lenses and crooked mounts taken out of a stereo pair, so that its rows are aligned."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoError, check_pair

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]


@dataclasses.dataclass(frozen=True)
class Lens:
    """One camera as calibration finds it.

    Attributes:
        matrix: (3, 3) intrinsic matrix [px].
        distortion: (5,) Brown's k1, k2, p1, p2, k3.
    """

    matrix: FloatArray
    distortion: FloatArray


class Rectification:
    """Turns images of two cameras into a pair whose rows are aligned.

    Attributes:
        geometry: Of the rectified pair; focal lengths and centre are those of the left camera.
        rotation_to_rectified: (3, 3), from the left camera's frame to the rectified one's.
        valid: (H, W), where both rectified images show something.
    """

    def __init__(
        self,
        left: Lens,
        right: Lens,
        transform_left_to_right: RigidTransform,
        size: tuple[int, int],
    ) -> None:
        """Compute the maps.

        Args:
            left: Left camera.
            right: Right camera.
            transform_left_to_right: Takes points of the left camera's frame to the right's.
            size: Width and height of both images [px].

        Raises:
            StereoError: If the right camera does not stand to the right of the left one.
        """
        rotation = transform_left_to_right.rotation.as_matrix()
        offset = np.asarray(transform_left_to_right.translation, dtype=float)
        if not -offset[0] > np.abs(offset[1:]).max():
            raise StereoError(
                f"rectification: the left camera is at {offset} m in the right camera's frame; "
                "needs to be mainly along its negative x"
            )
        turns = cv2.stereoRectify(
            left.matrix,
            left.distortion,
            right.matrix,
            right.distortion,
            size,
            rotation,
            offset.reshape(3, 1),
        )[:2]
        # OpenCV's own new matrix would make pixels square and change the field of view.
        matrix = np.asarray(left.matrix, dtype=float)
        self._maps = [
            cv2.initUndistortRectifyMap(
                lens.matrix, lens.distortion, turn, matrix, size, cv2.CV_32FC1
            )
            for lens, turn in zip((left, right), turns, strict=True)
        ]
        self.rotation_to_rectified = np.asarray(turns[0], dtype=float)
        self.geometry = StereoGeometry(
            size[0],
            size[1],
            float(matrix[0, 0]),
            float(matrix[1, 1]),
            float(matrix[0, 2]),
            float(matrix[1, 2]),
            float(np.linalg.norm(offset)),
        )
        inside = [
            (columns >= 0) & (columns <= size[0] - 1) & (rows >= 0) & (rows <= size[1] - 1)
            for columns, rows in self._maps
        ]
        self.valid = np.asarray(inside[0] & inside[1], dtype=bool)

    def apply(self, pair: NDArray[Any]) -> ImageArray:
        """Return the rectified pair, black where the cameras saw nothing.

        Args:
            pair: (2, H, W) uint8 as the cameras gave it.

        Raises:
            StereoError: If it is no such pair.
        """
        images = check_pair(pair, self.geometry)
        return np.stack(
            [
                np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_CUBIC), dtype=np.uint8)
                for image, maps in zip(images, self._maps, strict=True)
            ]
        )
