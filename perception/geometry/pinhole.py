"""Pinhole cameras: intrinsics, lens distortion, and field of view.

A camera frame has x to the right, y down and z forward along the view; pixel centres are at whole
numbers, and pixels need not be square.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers

NO_DISTORTION = (0.0, 0.0, 0.0, 0.0, 0.0)


@dataclasses.dataclass(frozen=True)
class StereoCalibration:
    """What the calibration of a stereo head leaves unknown: standard deviations; 0 if exact.

    Attributes:
        focal: Relative error of the focal lengths, common to both eyes.
        principal: Error of the optical axes' column and row, common to both eyes [px].
        eye_turn: Error of each eye's orientation in the head, about each axis [rad].
        eye_shift: Error of each eye's position in the head, along each axis [m].
        head_turn: Error of the head's orientation on its mount, about each axis [rad].
        head_shift: Error of the head's position on its mount, along each axis [m].
    """

    focal: float = 0.0
    principal: float = 0.0
    eye_turn: float = 0.0
    eye_shift: float = 0.0
    head_turn: float = 0.0
    head_shift: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation.

        Raises:
            ValueError: Naming it.
        """
        check_numbers("calibration", self, zero=True)

    def mount_covariance(self) -> FloatArray:
        """Return the covariance (6, 6) of xi [rad, m] of the left eye on the mount, its frame."""
        turn = self.head_turn**2 + self.eye_turn**2
        shift = self.head_shift**2 + self.eye_shift**2
        return np.diag([turn] * 3 + [shift] * 3)


EXACT_CALIBRATION = StereoCalibration()
"""A head that is its drawing."""


@dataclasses.dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera without distortion.

    Attributes:
        width: Columns [px].
        height: Rows [px].
        fx: Focal length in columns [px].
        fy: Focal length in rows [px].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].

    Raises:
        ValueError: If a size or focal length is not positive, or a number is not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        positive = min(self.width, self.height, self.fx, self.fy) > 0
        if not (positive and all(map(math.isfinite, self.intrinsics))):
            raise ValueError(f"{self}: expected finite numbers, positive sizes and focal lengths")

    @property
    def intrinsics(self) -> tuple[int, int, float, float, float, float]:
        """Width, height, fx, fy, cx and cy, to make another kind of camera from."""
        return self.width, self.height, self.fx, self.fy, self.cx, self.cy

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix (3, 3) [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels(self, points: ArrayLike) -> FloatArray:
        """Return where points appear in the image.

        Args:
            points: (..., 3) points [m], camera frame.

        Returns:
            (..., 2) columns and rows [px]; NaN for points that are not ahead.
        """
        p = np.asarray(points, dtype=float)
        z = np.where(p[..., 2] > 0.0, p[..., 2], np.nan)
        column = self.fx * p[..., 0] / z + self.cx
        return np.stack([column, self.fy * p[..., 1] / z + self.cy], axis=-1)

    def rays(self, pixels: ArrayLike) -> FloatArray:
        """Return the directions (..., 3) with z = 1 through pixels (..., 2) [px], camera frame."""
        p = np.asarray(pixels, dtype=float)
        x, y = (p[..., 0] - self.cx) / self.fx, (p[..., 1] - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def directions(self, columns: int | None = None, rows: int | None = None) -> FloatArray:
        """Return unit vectors (rows * columns, 3) through `pixel_grid`, camera frame."""
        rays = self.rays(self.pixel_grid(columns, rows)).reshape(-1, 3)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def pixel_grid(self, columns: int | None = None, rows: int | None = None) -> FloatArray:
        """Return evenly spaced pixels (rows, columns, 2) over the image; by default all [px]."""
        u, v = _centres(self.width, columns), _centres(self.height, rows)
        return np.stack(np.meshgrid(u, v), axis=-1)


@dataclasses.dataclass(frozen=True)
class DistortedPinhole(Pinhole):
    """A pinhole camera with Brown's lens distortion.

    Attributes:
        distortion: k1, k2, p1, p2, k3.
    """

    distortion: tuple[float, float, float, float, float] = NO_DISTORTION

    def pixels(self, points: ArrayLike) -> FloatArray:
        """Return where points appear in the image; see `Pinhole.pixels`."""
        p = np.asarray(points, dtype=float)
        x, y = p[..., 0] / p[..., 2], p[..., 1] / p[..., 2]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        v = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return super().pixels(np.stack([u, v, np.sign(p[..., 2])], axis=-1))


@dataclasses.dataclass(frozen=True)
class Frustum(Pinhole):
    """A camera's field of view between two depths.

    Attributes:
        near: Least depth, along z [m].
        far: Largest depth [m].

    Raises:
        ValueError: If the intrinsics are none, or the depths not positive and ascending.
    """

    near: float
    far: float

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        if not 0.0 < self.near < self.far < math.inf:
            raise ValueError(f"{self}: expected 0 < near < far, both finite")

    def resized(self, width: int, height: int) -> "Frustum":
        """Return the same field of view with another number of pixels."""
        across, down = width / self.width, height / self.height
        return dataclasses.replace(
            self,
            width=width,
            height=height,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
        )


def _centres(size: int, count: int | None) -> FloatArray:
    """Return the centres (count,) of equal parts of a row of pixels [px]."""
    if count is None:
        return np.arange(size, dtype=float)
    return (np.arange(count) + 0.5) / count * size - 0.5
