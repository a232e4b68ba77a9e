"""A planner's estimate of the map, paths on it, and candidate cells for the next view."""

import dataclasses

import numpy as np
from scipy import ndimage

from controllers.mapping.planar_paths import Paths, shortest_paths
from perception.geometry.arrays import BoolArray, FloatArray, IntArray
from perception.planar.map import PlanarMap
from perception.planar.raycast import Fan, RangeSensor, fan

_SIDES = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)


@dataclasses.dataclass(frozen=True)
class Situation:
    """Estimate of the map with claimed cells, and the paths on it.

    Attributes:
        probability: (rows, columns) probability of occupancy; claimed cells count as free.
        known: (rows, columns) measured or claimed cells.
        opaque: (rows, columns) cells measured as occupied.
        paths: Shortest paths from the present cell.
        cell: Side of a cell [m].
        table: Fan of the sensor's rays.
    """

    probability: FloatArray
    known: BoolArray
    opaque: BoolArray
    paths: Paths
    cell: float
    table: Fan

    def distance(self, cells: IntArray) -> FloatArray:
        """Return the path lengths (n,) to cells (n, 2) [m]."""
        return self.paths.lengths[cells[:, 0], cells[:, 1]]


def believe(
    world: PlanarMap, cell: tuple[int, int], sensor: RangeSensor, rays: int,
    claimed: BoolArray | None = None,
) -> Situation:  # fmt: skip
    """Return the map and the paths on it, with claimed cells as known and free.

    Args:
        world: Map of the plane.
        cell: Present row and column.
        sensor: Field of view and depth of field of the vision system.
        rays: Number of rays of a full fan.
        claimed: (rows, columns) cells of other robots' next views.
    """
    probability = world.probability()
    opaque = world.measured & (probability >= world.model.occupied_above)
    known = world.measured
    if claimed is not None:
        known = known | claimed
        probability = np.where(claimed & ~world.measured, 0.0, probability)
    size = world.grid.cell
    paths = shortest_paths(world.enterable(), cell, size)
    return Situation(probability, known, opaque, paths, size, fan(sensor.depth, size, rays))


def draw_candidates(
    situation: Situation, count: int, near: float, generator: np.random.Generator
) -> IntArray:
    """Draw reachable free cells (n, 2): the present one, half nearby and half anywhere.

    With few uniformly drawn positions, none would be near the present one.

    Args:
        situation: Estimate of the map.
        count: Greatest number of cells.
        near: Path length within which half of them lie [m].
        generator: Random generator for the draw.
    """
    lengths = situation.paths.lengths
    anywhere = np.flatnonzero(np.isfinite(lengths))
    around = np.flatnonzero(lengths <= near)
    row, column = situation.paths.start
    drawn = [np.array([row * lengths.shape[1] + column])]
    rest = count - 1
    for pool, share in ((around, rest // 2), (anywhere, rest - rest // 2)):
        drawn.append(generator.choice(pool, min(share, pool.size), replace=False))
    flat = np.unique(np.concatenate(drawn))
    return np.stack(np.unravel_index(flat, lengths.shape), axis=1).astype(np.int64)


def frontier_cells(situation: Situation) -> IntArray:
    """Return the reachable cells (n, 2) that share a side with an unknown one."""
    beside = ndimage.binary_dilation(~situation.known, structure=_SIDES)
    return np.argwhere(beside & np.isfinite(situation.paths.lengths)).astype(np.int64)
