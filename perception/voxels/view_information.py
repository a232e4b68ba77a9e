"""Expected information of a view into a partly known space (Thesis section 3.2.4, in 3-D).

What is unknown is not equally worth a look: most of it is air. So an unknown cell's probability of
occupancy is taken from its neighbours, the Markov chain that the thesis calls the better choice,
and, far from all that is known, from how often a cell at its height was found occupied. And its
entropy is multiplied by -p log2 p, as the thesis does to raise what is truly uncertain: else the
sum over so much air, of which each cell is almost certainly empty, outweighs every surface.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.voxels.bricks import SIDE
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State

FloatArray = NDArray[np.float64]
StateArray = NDArray[np.int8]

_UNKNOWN, _OCCUPIED = int(State.UNKNOWN), int(State.OCCUPIED)
_OPAQUE = 0.05
"""Chance that a ray still goes on, below which it is not followed."""


@dataclasses.dataclass(frozen=True)
class PlanningGrid:
    """A coarse picture of a map, for rating many views.

    Attributes:
        low: (3,) lowest corner [m], world.
        resolution: Edge of a cell [m].
        states: (nx, ny, nz) int8 of `occupancy.State`.
    """

    low: FloatArray
    resolution: float
    states: StateArray

    def __post_init__(self) -> None:
        """Refuse what is no grid.

        Raises:
            ValueError: If the states are not three-dimensional or the resolution not positive.
        """
        if self.states.ndim != 3 or not self.states.size or not self.resolution > 0.0:
            raise ValueError(
                f"planning grid of shape {self.states.shape} with cells of {self.resolution} m: "
                "expected three dimensions and a positive edge"
            )


def planning_grid(voxels: VoxelMap) -> PlanningGrid:
    """Return the picture of a map that its bricks make; see `VoxelMap.brick_states`."""
    return PlanningGrid(voxels.grid.corner, SIDE * voxels.grid.resolution, voxels.brick_states())


@dataclasses.dataclass(frozen=True)
class ExpectedOccupancy:
    """How an unknown cell's occupancy is guessed.

    Attributes:
        neighbours: Weight of the six neighbours' mean against the rate of the layer; 0.9 lets
            what is known reach about three cells far.
        sweeps: Of the relaxation.
        count: Cells of each layer that count as measured beforehand, so that an unseen layer has a
            rate as well.
        rate: Share of them that is occupied.
    """

    neighbours: float = 0.9
    sweeps: int = 12
    count: float = 50.0
    rate: float = 0.02


def expected_occupancy(states: StateArray, config: ExpectedOccupancy | None = None) -> FloatArray:
    """Return (nx, ny, nz) probabilities: 0 where free, 1 where occupied, a guess elsewhere.

    Args:
        states: (nx, ny, nz) of `occupancy.State`.
        config: How unknown cells are guessed.
    """
    how = config or ExpectedOccupancy()
    occupied = (states == _OCCUPIED).sum(axis=(0, 1))
    measured = (states != _UNKNOWN).sum(axis=(0, 1))
    rates = (occupied + how.rate * how.count) / (measured + how.count)
    return _relaxed(states, rates, how.neighbours, how.sweeps)


def view_information(
    grid: PlanningGrid,
    occupancy: FloatArray,
    cameras: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
) -> FloatArray:
    """Return (N,) weighted bits that each view is expected to tell.

    The entropy of each unknown cell that a ray meets, times -p log2 p and the chance that the ray
    gets there, is counted once a view.

    Args:
        grid: What is known.
        occupancy: (nx, ny, nz) from `expected_occupancy`.
        cameras: N transforms from camera to world.
        rays: (R, 3) unit vectors, camera frame.
        reach: Nearest and farthest measurable distance along a ray [m].

    Raises:
        ValueError: If the probabilities are not of the grid's cells.
    """
    value, _ = _look(grid, occupancy, cameras, rays, reach, None)
    return value


def claimed_by_view(
    grid: PlanningGrid,
    occupancy: FloatArray,
    camera: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
) -> NDArray[np.bool_]:
    """Return (nx, ny, nz), which unknown cells a view is expected to see: others need not look.

    Args:
        grid: As for `view_information`.
        occupancy: As for `view_information`.
        camera: One transform from camera to world.
        rays: As for `view_information`.
        reach: As for `view_information`.

    Raises:
        ValueError: As `view_information`.
    """
    claims = np.zeros(grid.states.shape, np.bool_)
    _look(grid, occupancy, camera, rays, reach, claims)
    return claims


def _look(
    grid: PlanningGrid,
    occupancy: FloatArray,
    cameras: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
    claims: NDArray[np.bool_] | None,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    if occupancy.shape != grid.states.shape:
        raise ValueError(f"occupancy: expected shape {grid.states.shape}, got {occupancy.shape}")
    places = np.ascontiguousarray(cameras.translation.reshape(-1, 3))
    turns = np.ascontiguousarray(cameras.rotation.as_matrix().reshape(-1, 3, 3))
    near, far = reach
    writes = claims is not None
    seen = claims if claims is not None else np.zeros((1, 1, 1), np.bool_)
    value: FloatArray = _views(
        grid.states,
        np.asarray(occupancy),
        np.asarray(grid.low, dtype=float),
        float(grid.resolution),
        places,
        turns,
        np.ascontiguousarray(rays, dtype=float),
        float(near),
        float(far),
        seen,
        writes,
    )
    return value, seen


@numba.njit(cache=True)
def _relaxed(states: Any, rates: Any, neighbours: float, sweeps: int) -> Any:
    nx, ny, nz = states.shape
    p = np.empty((nx, ny, nz))
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                state = states[i, j, k]
                known = 1.0 if state == _OCCUPIED else 0.0
                p[i, j, k] = rates[k] if state == _UNKNOWN else known
    for sweep in range(sweeps):
        # There and back, so that news does not travel one way only.
        forth = sweep % 2 == 0
        for a in range(nx):
            i = a if forth else nx - 1 - a
            for b in range(ny):
                j = b if forth else ny - 1 - b
                for c in range(nz):
                    k = c if forth else nz - 1 - c
                    if states[i, j, k] != _UNKNOWN:
                        continue
                    total, count = 0.0, 0
                    if i > 0:
                        total, count = total + p[i - 1, j, k], count + 1
                    if i < nx - 1:
                        total, count = total + p[i + 1, j, k], count + 1
                    if j > 0:
                        total, count = total + p[i, j - 1, k], count + 1
                    if j < ny - 1:
                        total, count = total + p[i, j + 1, k], count + 1
                    if k > 0:
                        total, count = total + p[i, j, k - 1], count + 1
                    if k < nz - 1:
                        total, count = total + p[i, j, k + 1], count + 1
                    around = total / count if count else rates[k]
                    p[i, j, k] = neighbours * around + (1.0 - neighbours) * rates[k]
    return p


@numba.njit(cache=True)
def _weighted_entropy(p: float) -> float:
    if p <= 0.0 or p >= 1.0:
        return 0.0
    weight = -p * math.log2(p)
    return weight * (weight - (1.0 - p) * math.log2(1.0 - p))


@numba.njit(cache=True)
def _views(
    states: Any,
    occupancy: Any,
    low: Any,
    edge: float,
    places: Any,
    turns: Any,
    rays: Any,
    near: float,
    far: float,
    claims: Any,
    writes: bool,
) -> Any:
    """Walk all rays of all views; a stamp tells which cells a view has counted."""
    value = np.zeros(len(places))
    stamps = np.zeros(states.shape, np.int32)
    origin, direction = np.empty(3), np.empty(3)
    cell, step, size = np.empty(3, np.int64), np.empty(3, np.int64), np.array(states.shape)
    next_at, stride = np.empty(3), np.empty(3)
    for view in range(len(places)):
        for ray in range(len(rays)):
            begin, end = near, far
            for axis in range(3):
                origin[axis] = (places[view, axis] - low[axis]) / edge
                direction[axis] = 0.0
                for other in range(3):
                    direction[axis] += turns[view, axis, other] * rays[ray, other]
                direction[axis] /= edge
                # The part of the ray within the grid.
                if direction[axis] == 0.0:
                    if origin[axis] < 0.0 or origin[axis] >= size[axis]:
                        end = -1.0
                else:
                    one = -origin[axis] / direction[axis]
                    two = (size[axis] - origin[axis]) / direction[axis]
                    begin, end = max(begin, min(one, two)), min(end, max(one, two))
            if begin >= end:
                continue
            for axis in range(3):
                here = origin[axis] + begin * direction[axis]
                cell[axis] = min(max(math.floor(here), 0), size[axis] - 1)
                step[axis] = 1 if direction[axis] > 0.0 else -1
                if direction[axis] == 0.0:
                    next_at[axis], stride[axis] = np.inf, np.inf
                else:
                    border = cell[axis] + (1 if direction[axis] > 0.0 else 0)
                    next_at[axis] = (border - origin[axis]) / direction[axis]
                    stride[axis] = 1.0 / abs(direction[axis])
            at, passes = begin, 1.0
            while at < end and passes > _OPAQUE:
                i, j, k = cell[0], cell[1], cell[2]
                state = states[i, j, k]
                if state == _OCCUPIED:
                    break
                axis = 0
                if next_at[1] < next_at[axis]:
                    axis = 1
                if next_at[2] < next_at[axis]:
                    axis = 2
                leave = min(next_at[axis], end)
                if state == _UNKNOWN:
                    p = occupancy[i, j, k]
                    if stamps[i, j, k] != view + 1:
                        stamps[i, j, k] = view + 1
                        value[view] += passes * _weighted_entropy(p)
                        if writes:
                            claims[i, j, k] = True
                    passes *= (1.0 - p) ** ((leave - at) / edge)
                at = leave
                next_at[axis] += stride[axis]
                cell[axis] += step[axis]
                if cell[axis] < 0 or cell[axis] >= size[axis]:
                    break
    return value
