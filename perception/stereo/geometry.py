"""Geometry of a rectified stereo pair: pixels and disparity to points, and how certain they are.

The frame is that of the left camera: x to the right, y down, z forward along the view; pixel
centres stand at whole numbers. Pixels need not be square.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class StereoGeometry:
    """Two equal cameras whose rows are aligned.

    Attributes:
        width: Columns [px].
        height: Rows [px].
        fx: Focal length in columns [px].
        fy: Focal length in rows [px].
        cx: Column of the optical axes [px].
        cy: Row of the optical axes [px].
        baseline: From the left to the right camera, along x [m].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float

    def __post_init__(self) -> None:
        """Refuse what is no camera pair.

        Raises:
            ValueError: Naming it.
        """
        for name in ("width", "height", "fx", "fy", "baseline"):
            if not getattr(self, name) > 0:
                raise ValueError(f"stereo geometry: {name} must be positive: {self}")

    def points(self, image_points: ArrayLike) -> FloatArray:
        """Triangulate (Thesis eq. 3-1 to 3-3).

        Args:
            image_points: (..., 3) column, row, disparity [px]; left column minus right.

        Returns:
            (..., 3) [m], left camera; NaN where the disparity is not positive.
        """
        u = np.asarray(image_points, dtype=float)
        disparity = np.where(u[..., 2] > 0.0, u[..., 2], np.nan)
        z = self.fx * self.baseline / disparity
        x = (u[..., 0] - self.cx) * z / self.fx
        y = (u[..., 1] - self.cy) * z / self.fy
        return np.stack([x, y, z], axis=-1)

    def project(self, points: ArrayLike) -> FloatArray:
        """Return where points appear.

        Args:
            points: (..., 3) [m], left camera.

        Returns:
            (..., 3) column, row, disparity [px]; NaN for points that are not ahead.
        """
        p = np.asarray(points, dtype=float)
        z = np.where(p[..., 2] > 0.0, p[..., 2], np.nan)
        column = self.fx * p[..., 0] / z + self.cx
        row = self.fy * p[..., 1] / z + self.cy
        return np.stack([column, row, self.fx * self.baseline / z], axis=-1)

    def projection_jacobian(self, points: ArrayLike) -> FloatArray:
        """Return (..., 3, 3), the derivatives of `project` by the point [px/m]."""
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
        """Return how certain triangulated points are: depth goes as its square (eq. 3-4 to 3-6).

        Args:
            points: (..., 3) [m], left camera.
            sigma: (3,) or (..., 3) standard deviations of column, row and disparity [px].

        Returns:
            (..., 3, 3) [m^2], left camera.
        """
        back = np.linalg.inv(self.projection_jacobian(points))
        weighted = back * np.asarray(sigma, dtype=float)[..., None, :]
        return weighted @ np.swapaxes(weighted, -1, -2)
