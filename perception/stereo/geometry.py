"""Geometry of a rectified stereo pair: pixels and disparity to points, and their covariance.

Errors of the calibration are common to all that a head sees: `CALIBRATION_ERRORS` numbers, each
with a deviation of one, move points in both images by `StereoGeometry.calibration_jacobian`. The
frame is that of the left camera, as in `perception.geometry.pinhole`.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import EXACT_CALIBRATION, Pinhole, StereoCalibration
from perception.geometry.se3 import point_jacobian

CALIBRATION_ERRORS = 9
"""Focal length, principal point (2), and of the right eye to the left its turn (3), shift (3)."""


@dataclasses.dataclass(frozen=True)
class StereoGeometry(Pinhole):
    """Two equal pinhole cameras whose rows are aligned.

    Attributes:
        baseline: Distance from the left to the right camera, along x [m].
        calibration: What calibration leaves unknown of the two cameras.

    Raises:
        ValueError: If the intrinsics are none, or the baseline is not positive.
    """

    baseline: float
    calibration: StereoCalibration = EXACT_CALIBRATION

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        if not self.baseline > 0.0:
            raise ValueError(f"{self}: expected a positive baseline")

    def points(self, image_points: ArrayLike) -> FloatArray:
        """Triangulate image points (Thesis eq. 3-1 to 3-3).

        Args:
            image_points: (..., 3) columns, rows and disparities [px],
                the left column minus the right.

        Returns:
            (..., 3) points [m], left camera frame; NaN where the disparity is not positive.
        """
        u = np.asarray(image_points, dtype=float)
        disparity = np.where(u[..., 2] > 0.0, u[..., 2], np.nan)
        z = self.fx * self.baseline / disparity
        x = (u[..., 0] - self.cx) * z / self.fx
        y = (u[..., 1] - self.cy) * z / self.fy
        return np.stack([x, y, z], axis=-1)

    def project(self, points: ArrayLike) -> FloatArray:
        """Return where points appear in both images.

        Args:
            points: (..., 3) points [m], left camera frame.

        Returns:
            (..., 3) column, row, disparity [px]; NaN for points that are not ahead.
        """
        p = np.asarray(points, dtype=float)
        disparity = self.fx * self.baseline / np.where(p[..., 2] > 0.0, p[..., 2], np.nan)
        return np.concatenate([self.pixels(p), disparity[..., None]], axis=-1)

    def projection_jacobian(self, points: ArrayLike) -> FloatArray:
        """Return the derivatives (..., 3, 3) of `project` by the point [px/m]."""
        p = np.asarray(points, dtype=float)
        x, y, z = p[..., 0], p[..., 1], p[..., 2]
        nothing = np.zeros_like(z)
        rows = (
            (self.fx / z, nothing, -self.fx * x / z**2),
            (nothing, self.fy / z, -self.fy * y / z**2),
            (nothing, nothing, -self.fx * self.baseline / z**2),
        )
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def covariance(self, points: ArrayLike, sigma: ArrayLike) -> FloatArray:
        """Return the covariances of triangulated points (eq. 3-4 to 3-6).

        The standard deviation of a depth grows as the depth squared.

        Args:
            points: (..., 3) points [m], left camera frame.
            sigma: (3,) or (..., 3) standard deviations of column, row and disparity [px].

        Returns:
            (..., 3, 3) covariances [m^2], left camera frame.
        """
        x, y, z = np.moveaxis(np.asarray(points, dtype=float), -1, 0)
        nothing, by_disparity = np.zeros_like(z), -z / (self.fx * self.baseline)
        rows = (
            (z / self.fx, nothing, x * by_disparity),
            (nothing, z / self.fy, y * by_disparity),
            (nothing, nothing, z * by_disparity),
        )
        back = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
        weighted = back * np.asarray(sigma, dtype=float)[..., None, :]
        return weighted @ np.swapaxes(weighted, -1, -2)

    def calibration_jacobian(self, points: ArrayLike) -> FloatArray:
        """Return how errors of the calibration move points in both images.

        Args:
            points: (..., 3) points [m], left camera frame.

        Returns:
            (..., 2, 2, 9) shift in the left and the right image of column and row [px] by each of
            the `CALIBRATION_ERRORS`, whose standard deviations are one.
        """
        p, how = np.asarray(points, dtype=float), self.calibration
        moved = np.zeros((*p.shape[:-1], 2, 2, CALIBRATION_ERRORS))
        right = p - [self.baseline, 0.0, 0.0]
        focal = np.array([self.fx, self.fy])
        for eye, seen in enumerate((p, right)):
            moved[..., eye, :, 0] = how.focal * focal * seen[..., :2] / seen[..., 2:]
        moved[..., 0, 1] = moved[..., 1, 2] = how.principal
        # Seen from an eye that is off by xi, a point moves by minus xi.
        deviations = math.sqrt(2.0) * np.repeat([how.eye_turn, how.eye_shift], 3)
        by_eye = self.projection_jacobian(right)[..., :2, :] @ point_jacobian(right)
        moved[..., 1, :, 3:] = -by_eye * deviations
        return moved

    def calibration_shifts(self, points: ArrayLike) -> FloatArray:
        """Return how errors of the calibration move triangulated points.

        Args:
            points: (..., 3) points [m], left camera frame.

        Returns:
            (..., 3, 9) shift of a point, triangulated by its column and row in the left image and
            its disparity, by each of the `CALIBRATION_ERRORS` [m].
        """
        left, right = np.moveaxis(self.calibration_jacobian(points), -3, 0)
        disparity = left[..., :1, :] - right[..., :1, :]
        image = np.concatenate([left, disparity], axis=-2)
        return np.asarray(np.linalg.solve(self.projection_jacobian(points), image), dtype=float)
