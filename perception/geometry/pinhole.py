"""What a pinhole camera can see: pixels, and from where to where."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Pinhole:
    """Intrinsics of a camera without distortion; pixel centres stand at whole numbers.

    Attributes:
        width: Columns [px].
        height: Rows [px].
        fx: Focal length in columns [px].
        fy: Focal length in rows [px].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclasses.dataclass(frozen=True)
class Frustum(Pinhole):
    """A camera's field of view; z is along the view.

    Attributes:
        near: Least depth, along z [m].
        far: Largest depth [m].
    """

    near: float
    far: float

    def __post_init__(self) -> None:
        """Refuse what is no field of view.

        Raises:
            ValueError: Naming it.
        """
        numbers = (self.fx, self.fy, self.cx, self.cy, self.near, self.far)
        positive = min(self.width, self.height, self.fx, self.fy, self.near) > 0
        if not (positive and all(map(math.isfinite, numbers)) and self.near < self.far):
            raise ValueError(
                f"{self}: expected positive sizes and focal lengths, 0 < near < far, all finite"
            )

    def resized(self, width: int, height: int) -> Frustum:
        """Return the same field of view with other pixels."""
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

    def rays(self) -> FloatArray:
        """Return directions through the pixels' centres with z = 1, (height, width, 3)."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float64)
