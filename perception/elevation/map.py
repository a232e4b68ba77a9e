"""Height of the ground, and its variance, for each cell of a level grid.

As in robot-centric elevation mapping (Fankhauser et al., CLAWAR 2014), a cell's height is a Kalman
filter of one number behind a gate; poses are known here, with their covariance.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from perception.elevation.fusion import FusionSettings, Layers, reduce_points, update_cells
from perception.elevation.grid import ElevationGrid
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.geometry.checks import check_numbers
from perception.geometry.se3 import point_jacobian
from perception.voxels.grid import MapError, checked_cloud

_LEVEL = 1e-6
"""Largest tilt of a transform between level frames [rad]."""


@dataclasses.dataclass(frozen=True)
class ElevationMapConfig:
    """How views enter a map.

    Attributes:
        min_points: Fewest points of a view that tell a cell's height, within its noise.
        support: Fewest points that tell an upper surface where a cell holds an edge.
        support_share: Share of a cell's points that an upper surface needs, too.
        roughness: Deviation of heights within a cell, by slope and texture [m]; 15 degrees make
            4 mm of 50 mm.
        gate: Deviations within which two heights are of one surface.
        least_step: Height by which two surfaces differ at least [m], however sure both are; poses
            err alike for all points of a view.
        lower_views: Successive views that it takes to believe a surface below the known one.
        correlated_points: Number of neighbouring points that share one error and count as one. The
            default is that of matching windows of 11 pixels, a point every third pixel.
        least_sigma: Deviation that a cell's height keeps [m].
    """

    min_points: int = 2
    support: int = 3
    support_share: float = 0.1
    roughness: float = 0.003
    gate: float = 3.0
    least_step: float = 0.01
    lower_views: int = 3
    correlated_points: float = 13.0
    least_sigma: float = 0.002

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ValueError: Naming the wrong one.
        """
        check_numbers("elevation map", self)
        if self.correlated_points < 1.0:
            count = self.correlated_points
            raise ValueError(f"elevation map correlated_points = {count}: expected 1 or more")


class FoundRises(NamedTuple):
    """What `perception.elevation.ground.rises` found last; read-only.

    Attributes:
        heights: (rows, columns) heights of the map at that time [m].
        window: Side of the square about a cell whose ground it was compared with [m].
        rises: (rows, columns) heights above the ground [m].
    """

    heights: FloatArray
    window: float
    rises: FloatArray


class ElevationMap:
    """Height of the surface in each cell of a grid, and its variance.

    Args:
        grid: Cells of the map.
        config: Fusion of views; the default if not given.

    Attributes:
        grid: Cells of the map.
        config: Fusion of views.
        heights: (rows, columns) height of the surface [m]; NaN where unknown.
        variances: (rows, columns) variance of the height [m^2]; NaN where unknown.
        found_rises: Heights above the ground as found last, for `perception.elevation.ground`.
    """

    def __init__(self, grid: ElevationGrid, config: ElevationMapConfig | None = None) -> None:
        self.grid, self.config = grid, config or ElevationMapConfig()
        self.heights: FloatArray = np.full(grid.shape, np.nan)
        self.variances: FloatArray = np.full(grid.shape, np.nan)
        self._lower = np.full(grid.size, np.nan), np.full(grid.size, np.nan)
        self._lower_views = np.zeros(grid.size, np.int64)
        self.found_rises: FoundRises | None = None

    @property
    def known(self) -> BoolArray:
        """Cells (rows, columns) of which a height is known."""
        return np.isfinite(self.heights)

    def insert(
        self,
        points: ArrayLike,
        covariances: ArrayLike,
        pose_covariance: ArrayLike | None = None,
    ) -> IndexArray:
        """Add the points of one view.

        A surface clearly above the known one replaces it. One clearly below is believed only after
        several views in a row, so that a block keeps its top where its side is seen, and what was
        never there goes.

        Args:
            points: (N, 3) points [m], world; those beyond the grid are left out.
            covariances: (N, 3, 3) covariances of the points [m^2], world. What they have in common
                is averaged as if they had not, unless it is left out here and given below.
            pose_covariance: (6, 6) covariance of the camera's pose [rad, m], world; None if
                `covariances` have it, or if it is known.

        Returns:
            (K,) flat indices of the cells whose height changed, ascending.

        Raises:
            MapError: If a number is not finite or a variance negative; the map is unchanged.
        """
        where, checked = checked_cloud(points, covariances)
        heights, variances = where[:, 2], np.ascontiguousarray(checked[:, 2, 2])
        good = np.isfinite(where).all(axis=1) & (variances >= 0.0) & (variances < np.inf)
        if not good.all():
            bad = int(np.argmin(good))
            raise MapError(
                f"point {bad}: {where[bad]} with variance of height {variances[bad]}: expected "
                "finite numbers, and a variance of at least 0"
            )
        cells = self.grid.cells_of(where[:, :2])
        inside = self.grid.inside(cells)
        flat = np.asarray(cells[inside] @ [self.grid.shape[1], 1], np.intp)
        settings = self._settings()
        told, means, sure = reduce_points(
            flat, heights[inside], variances[inside], self.grid.size, settings
        )
        if pose_covariance is not None:
            centres = self.grid.centres.reshape(-1, 2)[told]
            sure = sure + _height_variances(np.column_stack([centres, means]), pose_covariance)
        return told[update_cells(told, means, sure, self._layers(), settings)]

    def forget(self, place: FloatArray, radius: float) -> None:
        """Forget the cells of a disc, about (2,) x and y [m], as something moves there.

        Args:
            place: (2,) middle of the disc [m].
            radius: Radius of the disc [m].
        """
        box, apart = self.grid.box_about(place, radius)
        within = apart < radius
        self.heights[box][within] = self.variances[box][within] = np.nan

    def moved(
        self,
        transform_map_to_other: RigidTransform,
        covariance: ArrayLike | None = None,
        grid: ElevationGrid | None = None,
    ) -> "ElevationMap":
        """Return the same map in another level frame.

        A cell gets the height of the cell in which its centre lies, and stays unknown where there
        is none. A shift of up to half a cell's diagonal is not in its variance.

        Args:
            transform_map_to_other: Transform from the map's frame to the other, a turn about z and
                a translation.
            covariance: (6, 6) covariance of that transform [rad, m], other frame; None if known.
            grid: Cells in the other frame; those of this map if not given.

        Raises:
            MapError: If the transform tilts.
        """
        rotation = transform_map_to_other.rotation.as_matrix()
        if abs(rotation[2, 2] - 1.0) > _LEVEL**2 or np.abs(rotation[2, :2]).max() > _LEVEL:
            raise MapError(f"transform_map_to_other: expected a turn about z, got {rotation}")
        moved = ElevationMap(grid or self.grid, self.config)
        centres = moved.grid.centres.reshape(-1, 2)
        places = np.column_stack([centres, np.zeros(len(centres))])
        cells = self.grid.cells_of(transform_map_to_other.inv().apply(places)[:, :2])
        inside = np.flatnonzero(self.grid.inside(cells))
        source = tuple(cells[inside].T)
        heights = self.heights[source] + float(transform_map_to_other.translation[2])
        variances = self.variances[source]
        if covariance is not None:
            variances = variances + _height_variances(
                np.column_stack([centres[inside], heights]), covariance
            )
        moved.heights.flat[inside] = heights
        moved.variances.flat[inside] = variances
        return moved

    def copy(self) -> "ElevationMap":
        """Return a map of the same heights, in which nothing below them is half believed."""
        copied = ElevationMap(self.grid, self.config)
        copied.heights[...], copied.variances[...] = self.heights, self.variances
        return copied

    def _layers(self) -> Layers:
        flat = self.heights.reshape(-1), self.variances.reshape(-1)
        return Layers(*flat, *self._lower, self._lower_views)

    def _settings(self) -> FusionSettings:
        numbers = dataclasses.asdict(self.config)
        return FusionSettings(**numbers)


def _height_variances(points: FloatArray, covariance: ArrayLike) -> FloatArray:
    """Return (N,) variances of the heights of points (N, 3) [m] by those of their pose."""
    by_pose = point_jacobian(points)[:, 2]
    return np.einsum("ni,ij,nj->n", by_pose, np.asarray(covariance, dtype=float), by_pose)
