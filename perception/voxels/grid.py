"""A box of voxels, and what points and settings must be before they touch a map."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import FloatArray

LARGEST_KEY = 2**15
"""Cells from the world's origin on, per axis; OctoMap's limit too."""


class MapError(ValueError):
    """What a map cannot take; it is unchanged."""


@dataclasses.dataclass(frozen=True)
class VoxelGrid:
    """A box cut into cubes whose corners are at whole multiples of their side.

    Attributes:
        resolution: Side of a voxel [m].
        lower: Corner of the box [m], rounded down to a multiple of the side.
        upper: Opposite corner [m], rounded up.
    """

    resolution: float
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        numbers = np.array([self.resolution, *self.lower, *self.upper])
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or self.resolution <= 0.0:
            raise MapError(f"{self}: expected a positive resolution and finite corners")
        if np.any(self.first < -LARGEST_KEY) or np.any(self.first + self.shape > LARGEST_KEY):
            raise MapError(f"{self}: expected at most {LARGEST_KEY} voxels from the origin")
        if min(self.shape) < 1:
            raise MapError(f"{self}: expected lower < upper on each axis")

    @property
    def first(self) -> NDArray[np.int64]:
        """Key of the voxel [0, 0, 0]: its lower corner over the resolution."""
        return np.floor(np.array(self.lower) / self.resolution + 1e-6).astype(np.int64)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels on each axis."""
        last = np.ceil(np.array(self.upper) / self.resolution - 1e-6).astype(np.int64)
        x, y, z = (last - self.first).tolist()
        return x, y, z

    @property
    def corner(self) -> FloatArray:
        """Lower corner of the voxel [0, 0, 0] [m]."""
        return np.asarray(self.first * self.resolution, dtype=np.float64)

    def cells(self, points: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return in which voxels points lie.

        Args:
            points: (..., 3) [m], world.

        Returns:
            (..., 3) indices, zero for points outside; and (...), whether they are inside.
        """
        scaled = np.asarray(points, dtype=float) * (1.0 / self.resolution)
        with np.errstate(invalid="ignore"):
            index = np.floor(scaled) - self.first
            inside = np.all((index >= 0) & (index < np.array(self.shape)), axis=-1)
        return np.where(inside[..., None], index, 0.0).astype(np.int64), inside

    def centres(self, cells: ArrayLike) -> FloatArray:
        """Return the middles of voxels [m]; cells (..., 3)."""
        middle = (np.asarray(cells, dtype=np.float64) + self.first + 0.5) * self.resolution
        return np.asarray(middle, dtype=np.float64)


def checked_points(points: ArrayLike, name: str = "points") -> FloatArray:
    """Return points as (N, 3) finite numbers.

    Raises:
        MapError: If they are not.
    """
    array = np.asarray(points, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, 3))
    if array.ndim != 2 or array.shape[1] != 3:
        raise MapError(f"{name}: expected (N, 3), got {array.shape}")
    if not np.isfinite(array).all():
        bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
        raise MapError(f"{name}: {bad.size} of {len(array)} not finite, the first at {bad[0]}")
    return np.ascontiguousarray(array)


def checked_cloud(points: ArrayLike, covariances: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) and their covariances (N, 3, 3) as arrays of doubles.

    Args:
        points: (N, 3), or nothing at all for none.
        covariances: (N, 3, 3).

    Raises:
        MapError: If a shape is another.
    """
    where = np.ascontiguousarray(points, dtype=float)
    if where.size == 0:
        where = np.empty((0, 3))
    if where.ndim != 2 or where.shape[1] != 3:
        raise MapError(f"points: expected (N, 3), got {where.shape}")
    checked = np.ascontiguousarray(covariances, dtype=float)
    if checked.shape != (len(where), 3, 3) and not len(where) == checked.size == 0:
        raise MapError(f"covariances: expected ({len(where)}, 3, 3), got {checked.shape}")
    return where, checked
