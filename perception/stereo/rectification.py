"""Lenses and crooked mounts taken out of a stereo pair, so that its rows are aligned."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.pinhole import DistortedPinhole
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoError, check_pair

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.uint8]


class Rectification:
    """Turns images of two cameras into a pair whose rows are aligned.

    Args:
        left: Left camera, as calibrated.
        right: Right camera, as calibrated, with images of the same size.
        transform_left_to_right: Transform from the left camera's frame to the right camera's.

    Attributes:
        geometry: Geometry of the rectified pair; intrinsics are those of the left camera.
        rotation_to_rectified: (3, 3) rotation from the left camera's frame to the rectified frame.
        valid: (H, W) where both rectified images show something.

    Raises:
        StereoError: If the right camera does not stand to the right of the left one.
    """

    def __init__(
        self,
        left: DistortedPinhole,
        right: DistortedPinhole,
        transform_left_to_right: RigidTransform,
    ) -> None:
        size = left.width, left.height
        lenses = [(camera.matrix, np.array(camera.distortion)) for camera in (left, right)]
        rotation = transform_left_to_right.rotation.as_matrix()
        offset = np.asarray(transform_left_to_right.translation, dtype=float)
        if not -offset[0] > np.abs(offset[1:]).max():
            raise StereoError(
                f"rectification: the left camera is at {offset} m in the right camera's frame; "
                "needs to be mainly along its negative x"
            )
        turns = cv2.stereoRectify(
            *lenses[0],
            *lenses[1],
            size,
            rotation,
            offset.reshape(3, 1),
        )[:2]
        # OpenCV's own new matrix would make pixels square and change the field of view.
        self._maps = [
            cv2.initUndistortRectifyMap(*lens, turn, left.matrix, size, cv2.CV_32FC1)
            for lens, turn in zip(lenses, turns, strict=True)
        ]
        self.rotation_to_rectified = np.asarray(turns[0], dtype=float)
        self.geometry = StereoGeometry(*left.intrinsics, float(np.linalg.norm(offset)))
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
