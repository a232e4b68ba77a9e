"""A box cut out of a sparse map as a dense array: for planners that ask for voxels many times."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.voxels.bricks import NEVER, Bricks
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.map import LARGEST_STEP, VoxelMap
from perception.voxels.occupancy import probability
from perception.voxels.raycast import KERNEL

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Window:
    """Voxels of a box.

    Attributes:
        grid: Where they are; its box is the window.
        values: (nx, ny, nz) int8 log-odds in the map's steps, `NEVER` where not measured.
        table: (256,) probability of each value from -128 on; NaN for `NEVER`.
        threshold: Voxels from this value on are occupied.
    """

    grid: VoxelGrid
    values: NDArray[np.int8]
    table: FloatArray
    threshold: int

    def probabilities(self) -> FloatArray:
        """Return (nx, ny, nz) probabilities of occupancy; NaN where never measured."""
        return self.table[self.values.astype(np.int64) + 128]

    def occupied(self) -> NDArray[np.bool_]:
        """Return (nx, ny, nz) which voxels are occupied."""
        return self.values >= self.threshold

    def known_below(self, limit: float) -> int:
        """Return the largest value of measured voxels whose probability is below a limit.

        A voxel v is free if ``NEVER < v <= known_below(0.05)``.
        """
        below = np.flatnonzero(self.table[1:] < limit)
        return int(below[-1]) - 127 if len(below) else NEVER


def window(voxels: VoxelMap, lower: ArrayLike, upper: ArrayLike) -> Window:
    """Return the voxels of a box; the box may reach out of the map, where nothing is known.

    Args:
        voxels: The map.
        lower: (3,) corner [m], rounded down to whole voxels.
        upper: (3,) opposite corner [m], rounded up.

    Raises:
        MapError: If that is no box.
    """
    corners = np.array([lower, upper], dtype=float)
    if corners.shape != (2, 3):
        raise MapError(f"window: expected two corners of three numbers, got {lower} and {upper}")
    (a, b, c), (d, e, f) = corners.tolist()
    grid = VoxelGrid(voxels.grid.resolution, (a, b, c), (d, e, f))
    values = np.full(grid.shape, NEVER, dtype=np.int8)
    offset = grid.first - voxels.grid.first
    low = np.maximum(0, -offset)
    high = np.minimum(np.array(grid.shape), np.array(voxels.grid.shape) - offset)
    if np.all(low < high):
        _cut(voxels.bricks, offset, low, high, values)
    steps = np.arange(-128, 128)
    lowest, highest = voxels.config.model.clamps
    scale = LARGEST_STEP / max(-lowest, highest)
    table = np.where(steps == NEVER, np.nan, probability(steps / scale))
    return Window(grid, values, table, voxels.threshold())


@numba.njit(**KERNEL)
def _cut(
    store: Bricks,
    offset: NDArray[np.int64],
    low: NDArray[np.int64],
    high: NDArray[np.int64],
    out: NDArray[np.int8],
) -> None:
    """Copy voxels, brick by brick along z."""
    for i in range(low[0], high[0]):
        x = i + offset[0]
        for j in range(low[1], high[1]):
            y = j + offset[1]
            row = ((x & 7) << 6) | ((y & 7) << 3)
            k = low[2]
            while k < high[2]:
                z = k + offset[2]
                end = min(high[2], k + 8 - (z & 7))
                brick = store.index[x >> 3, y >> 3, z >> 3]
                if brick < 0:
                    for at in range(k, end):
                        out[i, j, at] = -129 - brick
                else:
                    for at in range(k, end):
                        out[i, j, at] = store.values[brick, row | ((at + offset[2]) & 7)]
                k = end
