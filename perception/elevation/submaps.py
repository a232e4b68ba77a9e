"""Elevation maps of the same ground one after the other, as heights drift on a long way.

What was mapped long ago then lies higher or lower than what is mapped now, and would stand as
cliffs about it. So a map is closed where views contradict it, and another one begun: heights of two
maps are compared nowhere.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap
from perception.geometry.arrays import BoolArray, FloatArray


class Submaps:
    """Elevation maps of the same cells, the newest of which grows.

    Args:
        grid: Cells of the maps.

    Attributes:
        grid: Cells of the maps.
        maps: The maps, the newest first.
    """

    def __init__(self, grid: ElevationGrid) -> None:
        self.grid, self.maps = grid, [ElevationMap(grid)]

    @property
    def newest(self) -> ElevationMap:
        """The map that grows."""
        return self.maps[0]

    @property
    def known(self) -> BoolArray:
        """Cells (rows, columns) of which a height is known."""
        return np.isfinite(self.heights)

    @property
    def heights(self) -> FloatArray:
        """(rows, columns) heights in the newest map that knows them [m]; NaN where unknown."""
        return _first_known([each.heights for each in self.maps])

    @property
    def variances(self) -> FloatArray:
        """(rows, columns) variances of the heights [m^2]; NaN where unknown."""
        return _first_known([each.variances for each in self.maps])

    def begin(self) -> None:
        """Begin another map; those before grow no more."""
        self.maps.insert(0, ElevationMap(self.grid))

    def moved(self, transform_map_to_other: RigidTransform, covariance: ArrayLike) -> "Submaps":
        """Return the same maps in another level frame, as `ElevationMap.moved`.

        Args:
            transform_map_to_other: Transform from the maps' frame to the other, a turn about z and
                a translation.
            covariance: (6, 6) covariance of that transform [rad, m], other frame.

        Raises:
            MapError: If the transform tilts.
        """
        moved = Submaps(self.grid)
        moved.maps = [each.moved(transform_map_to_other, covariance) for each in self.maps]
        return moved


def rises_by_map(maps: Sequence[ElevationMap]) -> FloatArray:
    """Return the height of each cell above the ground about it, each map by itself.

    Args:
        maps: Maps of the same cells; of several that know a cell, or all about it, the first one
            counts.

    Returns:
        (rows, columns) [m]; NaN where no map tells.
    """
    above, told = rises(maps[0]), filled(maps[0].known)
    for each in maps[1:]:
        above, told = np.where(told, above, rises(each)), told | filled(each.known)
    return above


def filled(cells: BoolArray, grown: int = 0) -> BoolArray:
    """Return cells (rows, columns) without holes of up to four between them.

    Far away the points of a view are that far apart; what stands there shows itself.

    Args:
        cells: (rows, columns) cells.
        grown: Number of cells by which they are grown, too, up to 2.
    """
    square = np.ones((3, 3), np.uint8)
    wide = cv2.dilate(cells.astype(np.uint8), square, iterations=2)
    return np.asarray(cv2.erode(wide, square, iterations=2 - grown)).astype(bool)


def _first_known(layers: Sequence[FloatArray]) -> FloatArray:
    """Return the first finite number of each cell of some layers (rows, columns); NaN for none."""
    first = layers[0]
    for layer in layers[1:]:
        first = np.where(np.isfinite(first), first, layer)
    return first
