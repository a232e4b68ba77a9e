"""Occupied voxels as obstacles of the arm: every leg and disc against every voxel nearby.

Points sampled on the arm slip between voxels that are smaller than their spacing. Here the legs are
line segments and the platforms discs, and a voxel is the ball around it: nothing that touches is
missed, and what is called touching is nearer than a ball's radius, 0.87 of a side, and the margin.
"""

from __future__ import annotations

import dataclasses

import numba
import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.braid.arm.chain import compose
from controllers.braid.arm.stage import FloatArray
from perception.voxels.map import VoxelMap


@dataclasses.dataclass(frozen=True)
class VoxelObstacles:
    """Cubes that are occupied, of any orientation.

    Attributes:
        centres: (k, 3) middles of the cubes [m] in the arm's base frame; kept in order of z.
        side: Of a cube [m].
        margin: That the arm's legs and discs keep besides, for instance half their thickness [m].
    """

    centres: FloatArray
    side: float
    margin: float = 0.0

    def __post_init__(self) -> None:
        """Sort the cubes.

        Raises:
            ValueError: Naming what is no cube or margin.
        """
        centres = np.asarray(self.centres, dtype=np.float64)
        centres = centres.reshape(-1, 3) if centres.size == 0 else centres
        if centres.ndim != 2 or centres.shape[1] != 3 or not np.all(np.isfinite(centres)):
            raise ValueError(f"centres {centres.shape}: expected (k, 3) finite numbers")
        if not (np.isfinite(self.side) and self.side > 0.0):
            raise ValueError(f"side {self.side}: expected a positive length")
        if not (np.isfinite(self.margin) and self.margin >= 0.0):
            raise ValueError(f"margin {self.margin}: expected a length of 0 or more")
        order = np.argsort(centres[:, 2], kind="stable")
        object.__setattr__(self, "centres", np.ascontiguousarray(centres[order]))

    @property
    def reach(self) -> float:
        """Distance from a centre within which the arm may touch [m]."""
        return 0.5 * float(np.sqrt(3.0)) * self.side + self.margin


def occupied_voxels(
    voxels: VoxelMap, transform_base_to_world: RigidTransform, margin: float = 0.0
) -> VoxelObstacles:
    """Return a map's occupied voxels as obstacles; unknown ones are none.

    To keep out of unknown space too, give `LinkCheck` a function of `VoxelMap.probabilities`, which
    are NaN there.

    Args:
        voxels: As the mapping keeps it.
        transform_base_to_world: Where the arm stands in the map.
        margin: As in `VoxelObstacles`.
    """
    cells, _ = voxels.occupied_cells()
    middles = voxels.grid.centres(cells).reshape(-1, 3)
    centres = transform_base_to_world.inv().apply(middles) if len(middles) else middles
    return VoxelObstacles(centres, voxels.grid.resolution, margin)


@numba.njit(cache=True)
def stages_clear(bases, states, stages, joints, centres, reach):
    """Return which stages (m,) are farther than a reach from all centres.

    Args:
        bases: (m, 12) pose of the disc that each stage stands on.
        states: (m,) of each stage.
        stages: (8, 12) pose of a stage in each state.
        joints: (3, 3) joints on the rim of a disc, in its frame; the first at the disc's radius.
        centres: (k, 3) in order of z.
        reach: [m].
    """
    clear = np.ones(bases.shape[0], dtype=np.bool_)
    radius = np.sqrt((joints[0] ** 2).sum())
    top, legs, middle = np.empty(12), np.empty((2, 3, 3)), np.empty(3)
    for i in range(bases.shape[0]):
        compose(bases[i], stages[states[i]], top)
        middle[:] = 0.5 * (bases[i, :3] + top[:3])
        bound = np.sqrt(_squared(top, middle)) + radius + reach  # of the whole stage
        first = np.searchsorted(centres[:, 2], middle[2] - bound)
        end = np.searchsorted(centres[:, 2], middle[2] + bound)
        for k in range(3):
            _place(bases[i], joints[k], legs[0, k])
            _place(top, joints[k], legs[1, k])
        for v in range(first, end):
            if _squared(centres[v], middle) > bound * bound:
                continue
            near = _from_disc(top, radius, centres[v])
            for k in range(3):
                near = min(near, _from_segment(legs[0, k], legs[1, k], centres[v]))
            if near <= reach * reach:
                clear[i] = False
                break
    return clear


@numba.njit(cache=True)
def _squared(a, b):
    """Return the squared distance of two places; numbers only, for arrays would be allocated."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@numba.njit(cache=True)
def _place(pose, point, out):
    for d in range(3):
        row = 3 + 3 * d
        out[d] = pose[d] + pose[row] * point[0] + pose[row + 1] * point[1]
        out[d] += pose[row + 2] * point[2]


@numba.njit(cache=True)
def _from_segment(start, end, point):
    """Return the squared distance of a point from a segment."""
    length, along = 0.0, 0.0
    for d in range(3):
        length += (end[d] - start[d]) ** 2
        along += (end[d] - start[d]) * (point[d] - start[d])
    share = min(max(along / length, 0.0), 1.0)
    total = 0.0
    for d in range(3):
        total += (start[d] + share * (end[d] - start[d]) - point[d]) ** 2
    return total


@numba.njit(cache=True)
def _from_disc(pose, radius, point):
    """Return the squared distance of a point from a flat disc about the z axis of a pose."""
    height, whole = 0.0, 0.0
    for d in range(3):
        height += pose[5 + 3 * d] * (point[d] - pose[d])
        whole += (point[d] - pose[d]) ** 2
    out = np.sqrt(max(whole - height * height, 0.0)) - radius
    return height * height + max(out, 0.0) ** 2
