"""Visible volume and expected information of views of a map (Thesis section 3.2.4, in 3-D).

`view_counts` follows rays through the voxels of a sparse map: how much of what they meet was never
measured, and where they end. `view_information` rates many views on a coarse grid by the
information expected of each. What is unknown is not equally worth a view: most of it is air. So an
unknown cell's probability of occupancy is taken from its neighbours, the Markov chain that the
thesis calls the better choice, and, far from all that is known, from how often a cell at its height
was found occupied. And its entropy is multiplied by -p log2 p, as the thesis does to raise what is
truly uncertain: else the sum over so much air, of which each cell is almost certainly empty,
outweighs every surface.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false

import dataclasses
import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import Frustum
from perception.voxels.bricks import KERNEL, SIDE, whole
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State
from perception.voxels.scan import Camera, camera_of

UNKNOWN, OCCUPIED = int(State.UNKNOWN), int(State.OCCUPIED)
TICKS = 2.0**40
"""Of depth, in a metre."""
RAYS = (64, 48)
"""Columns and rows of rays that sample a view."""


@dataclasses.dataclass(frozen=True)
class ViewCounts:
    """What a view would show of a map.

    Attributes:
        unmeasured: Volume never measured that no occupied voxel hides [m^3].
        free: Volume known to be free that none hides [m^3].
        information: Expected number of unmeasured voxels that the view would settle, a bit each:
            those farther along a ray count less, as something may hide them. Known voxels
            count nothing, as their clamped probability is no ignorance.
        depths: (rows, columns) depth at which each ray meets an occupied voxel [m], else infinite.
    """

    unmeasured: float
    free: float
    information: float
    depths: FloatArray

    @property
    def blocked(self) -> float:
        """Fraction of the rays that meet an occupied voxel."""
        return float(np.isfinite(self.depths).mean())


def view_counts(
    voxels: VoxelMap,
    transform_camera_to_world: RigidTransform,
    frustum: Frustum,
    mean_free_path: float = 0.5,
    rays: tuple[int, int] = RAYS,
) -> ViewCounts:
    """Return what a view from a pose would show; outside of the map's box there is nothing.

    Args:
        voxels: The map.
        transform_camera_to_world: The pose.
        frustum: The camera; only its field of view counts.
        mean_free_path: Mean range of sight in unknown space [m]. It is a length, so that
            what a view is worth does not depend on the size of voxels.
        rays: Columns and rows of rays that are cast.

    Raises:
        ValueError: If the mean free path is not positive.
    """
    if not mean_free_path > 0.0:
        raise ValueError(f"mean_free_path: {mean_free_path}, expected a positive length [m]")
    coarse = frustum.resized(*rays)
    camera = camera_of(transform_camera_to_world, coarse, voxels.grid.corner)
    depths = np.full((coarse.height, coarse.width), np.inf)
    sums = np.zeros(3)
    kinds, states = voxels.outline()
    lengths = (voxels.grid.resolution, mean_free_path)
    _count_rays(kinds, states.ravel(), camera, lengths, depths, sums)
    # A ray samples a pixel, which is z^2 / (fx fy) large at depth z.
    unmeasured, free, seen = (sums / (3.0 * coarse.fx * coarse.fy)).tolist()
    return ViewCounts(unmeasured, free, seen / voxels.grid.resolution**3, depths)


class Ray(NamedTuple):
    """A ray through a map, from where it enters it.

    Attributes:
        brick: Brick in which it starts.
        faces: Depth of the next brick on each axis [ticks].
        widths: Depth from voxel to voxel on each axis [ticks].
        ahead: True for each axis along which the ray rises.
        ends: Depth where it starts and ends [m].
        attenuation: Attenuation by unmeasured space, along the depth [1/m].
    """

    brick: tuple[int, int, int]
    faces: tuple[int, int, int]
    widths: tuple[int, int, int]
    ahead: tuple[bool, bool, bool]
    ends: tuple[float, float]
    attenuation: float


@numba.njit(**KERNEL)
def _count_rays(
    kinds: NDArray[np.int32],
    states: NDArray[np.uint16],
    camera: Camera,
    lengths: tuple[float, float],
    depths: FloatArray,
    sums: FloatArray,
) -> None:
    """Follow a ray for each pixel.

    Args:
        kinds: (bx, by, bz) kinds of the bricks, from `VoxelMap.outline`.
        states: Packed states of the mixed bricks, from `VoxelMap.outline`, flat.
        camera: Origin of the rays, and one pixel for each.
        lengths: Side of a voxel, and mean free path in unmeasured space [m].
        depths: (rows, columns) written where a ray is stopped.
        sums: (3,) added to: z1^3 - z0^3 of unmeasured, of free, and of what is seen of unmeasured.
    """
    resolution, free_path = lengths
    side = resolution * SIDE
    bx, by, bz = kinds.shape
    ox, oy, oz = camera.origin[0], camera.origin[1], camera.origin[2]
    turn = camera.turn
    for row in range(camera.height):
        v = (row - camera.cy) / camera.fy
        for column in range(camera.width):
            u = (column - camera.cx) / camera.fx
            dx = turn[0, 0] * u + turn[1, 0] * v + turn[2, 0]
            dy = turn[0, 1] * u + turn[1, 1] * v + turn[2, 1]
            dz = turn[0, 2] * u + turn[1, 2] * v + turn[2, 2]
            per_depth = 1.0 / free_path * math.sqrt(dx * dx + dy * dy + dz * dz)
            # No component: as good as never across such faces, and no 0 times inf.
            dx, dy, dz = _not_zero(dx), _not_zero(dy), _not_zero(dz)
            ix, iy, iz = 1.0 / dx, 1.0 / dy, 1.0 / dz
            hx, hy, hz = dx > 0.0, dy > 0.0, dz > 0.0
            enter, leave = camera.near, camera.far
            enter = max(enter, ((bx * side if not hx else 0.0) - ox) * ix)
            enter = max(enter, ((by * side if not hy else 0.0) - oy) * iy)
            enter = max(enter, ((bz * side if not hz else 0.0) - oz) * iz)
            leave = min(leave, ((bx * side if hx else 0.0) - ox) * ix)
            leave = min(leave, ((by * side if hy else 0.0) - oy) * iy)
            leave = min(leave, ((bz * side if hz else 0.0) - oz) * iz)
            if enter >= leave:
                continue
            x = min(max(whole((ox + enter * dx) / side), 0), bx - 1)
            y = min(max(whole((oy + enter * dy) / side), 0), by - 1)
            z = min(max(whole((oz + enter * dz) / side), 0), bz - 1)
            ticks = resolution * TICKS
            faces = (
                int(((x + hx) * side - ox) * ix * TICKS),
                int(((y + hy) * side - oy) * iy * TICKS),
                int(((z + hz) * side - oz) * iz * TICKS),
            )
            widths = (int(ticks * abs(ix)), int(ticks * abs(iy)), int(ticks * abs(iz)))
            ray = Ray((x, y, z), faces, widths, (hx, hy, hz), (enter, leave), per_depth)
            depths[row, column] = _follow(kinds, states, ray, sums)


@numba.njit(**KERNEL)
def _follow(
    kinds: NDArray[np.int32],
    states: NDArray[np.uint16],
    ray: Ray,
    sums: FloatArray,
) -> float:
    """Follow a ray brick by brick, and through those that are not alike voxel by voxel.

    Depth is kept as whole ticks, so that the nearest face is stepped over without a branch: which
    of three it is cannot be foretold, and a wrong guess costs more than all the arithmetic.

    Args:
        kinds: (bx, by, bz) kinds of the bricks, from `VoxelMap.outline`.
        states: Packed states of the mixed bricks, from `VoxelMap.outline`, flat.
        ray: The ray.
        sums: (3,) added to, as in `_count_rays`.

    Returns:
        Depth at which it meets an occupied voxel [m], or infinity.
    """
    (x, y, z), (tx, ty, tz), (vx, vy, vz) = ray.brick, ray.faces, ray.widths
    bx, by, bz = kinds.shape
    hx, hy, hz = ray.ahead
    per_depth = ray.attenuation
    sx, sy, sz = 1 if hx else -1, 1 if hy else -1, 1 if hz else -1
    cx, cy, cz = sx << 3, sy, sz << 1
    wx, wy, wz = vx * SIDE, vy * SIDE, vz * SIDE
    fx, fy, fz = 1.0 / vx, 1.0 / vy, 1.0 / vz
    # Numbers of voxels turned round, where the ray goes down.
    flip_x, flip_y, flip_z = 0 if hx else SIDE - 1, 0 if hy else SIDE - 1, 0 if hz else SIDE - 1
    now, last = int(ray.ends[0] * TICKS), int(ray.ends[1] * TICKS)
    begin, clear, run = now, 1.0, UNKNOWN
    while True:
        kind = kinds[np.uint64(x), np.uint64(y), np.uint64(z)]
        nearest = min(tx, ty, tz)
        until = min(nearest, last)
        if kind < 0:
            state = -1 - kind
            if state != run:
                clear = _count(run, begin, now, clear, per_depth, sums)
                begin, run = now, state
                if state == OCCUPIED:
                    return begin / TICKS
        else:
            # Voxels of the brick that come after the one at hand, on each axis.
            nx = min(int((tx - now) * fx), SIDE - 1)
            ny = min(int((ty - now) * fy), SIDE - 1)
            nz = min(int((tz - now) * fz), SIDE - 1)
            ux, uy, uz = tx - nx * vx, ty - ny * vy, tz - nz * vz
            i, j, k = (SIDE - 1 - nx) ^ flip_x, (SIDE - 1 - ny) ^ flip_y, (SIDE - 1 - nz) ^ flip_z
            cell, shift = (kind << 6) | (i << 3) | j, 2 * k
            while True:
                state = (np.int64(states[np.uint64(cell)]) >> shift) & 3
                if state != run:
                    clear = _count(run, begin, now, clear, per_depth, sums)
                    begin, run = now, state
                    if state == OCCUPIED:
                        return begin / TICKS
                now = min(ux, uy, uz)
                if now >= until:
                    break
                x_step, y_step = -np.int64(ux == now), -np.int64(uy == now)
                z_step = -np.int64(uz == now)
                cell += (cx & x_step) + (cy & y_step)
                shift += cz & z_step
                ux, uy, uz = ux + (vx & x_step), uy + (vy & y_step), uz + (vz & z_step)
        now = until
        x_step, y_step = -np.int64(tx == nearest), -np.int64(ty == nearest)
        z_step = -np.int64(tz == nearest)
        x, y, z = x + (sx & x_step), y + (sy & y_step), z + (sz & z_step)
        tx, ty, tz = tx + (wx & x_step), ty + (wy & y_step), tz + (wz & z_step)
        if now >= last or not (0 <= x < bx and 0 <= y < by and 0 <= z < bz):
            _count(run, begin, now, clear, per_depth, sums)
            return math.inf


@numba.njit(**KERNEL)
def _count(
    kind: int, start: int, end: int, clear: float, per_depth: float, sums: FloatArray
) -> float:
    """Count a stretch of a ray [ticks] that is all unmeasured, or all free.

    Returns:
        What is still seen of what lies behind.
    """
    z0, z1 = start / TICKS, end / TICKS
    volume = z1 * z1 * z1 - z0 * z0 * z0
    if kind != UNKNOWN:
        sums[1] += volume
        return clear
    # Integral of z^2 exp(-per_depth (z - start)).
    behind = clear * math.exp(-per_depth * (z1 - z0))
    path = 1.0 / per_depth
    first = path * (z0 * z0 + 2.0 * path * (z0 + path))
    last = path * (z1 * z1 + 2.0 * path * (z1 + path))
    sums[0] += volume
    sums[2] += 3.0 * (clear * first - behind * last)
    return behind


@numba.njit(**KERNEL)
def _not_zero(component: float) -> float:
    return component if abs(component) > 1e-6 else 1e-6


StateArray = NDArray[np.int8]

_BESIDE = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))
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


class GuessedCells(NamedTuple):
    """A planning grid with the guessed occupancy of its cells.

    Attributes:
        states: (nx, ny, nz) int8 of `occupancy.State`.
        occupancy: (nx, ny, nz) probabilities.
        low: (3,) lowest corner [m], world.
        edge: Edge of a cell [m].
    """

    states: StateArray
    occupancy: FloatArray
    low: FloatArray
    edge: float


def planning_grid(voxels: VoxelMap) -> PlanningGrid:
    """Return the picture of a map that its bricks make; see `VoxelMap.brick_states`."""
    return PlanningGrid(voxels.grid.corner, SIDE * voxels.grid.resolution, voxels.brick_states())


@dataclasses.dataclass(frozen=True)
class ExpectedOccupancy:
    """How an unknown cell's occupancy is guessed.

    Attributes:
        neighbours: Weight of the six neighbours' mean against the rate of the layer; 0.9 lets
            what is known reach about three cells far.
        sweeps: Number of sweeps of the relaxation.
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
        config: Model of the occupancy of unknown cells.
    """
    how = config or ExpectedOccupancy()
    occupied = (states == OCCUPIED).sum(axis=(0, 1))
    measured = (states != UNKNOWN).sum(axis=(0, 1))
    rates = (occupied + how.rate * how.count) / (measured + how.count)
    return _relaxed(states, rates, how.neighbours, how.sweeps)


def view_information(
    grid: PlanningGrid,
    occupancy: FloatArray,
    cameras: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
    claims: NDArray[np.bool_] | None = None,
) -> FloatArray:
    """Return (N,) weighted bits of information expected of each view.

    The entropy of each unknown cell that a ray meets, times -p log2 p and the chance that the ray
    gets there, is counted once a view.

    Args:
        grid: Coarse picture of the map.
        occupancy: (nx, ny, nz) probabilities from `expected_occupancy`.
        cameras: N transforms from camera to world.
        rays: (R, 3) unit vectors, camera frame.
        reach: Nearest and farthest measurable distance along a ray [m].
        claims: (nx, ny, nz) where cells that a view is expected to show are marked, if given.

    Raises:
        ValueError: If the probabilities are not of the grid's cells.
    """
    if occupancy.shape != grid.states.shape:
        raise ValueError(f"occupancy: expected shape {grid.states.shape}, got {occupancy.shape}")
    low = np.asarray(grid.low, dtype=float)
    return _views(
        GuessedCells(grid.states, np.asarray(occupancy), low, float(grid.resolution)),
        np.ascontiguousarray(cameras.translation.reshape(-1, 3)),
        np.ascontiguousarray(cameras.rotation.as_matrix().reshape(-1, 3, 3)),
        np.ascontiguousarray(rays, dtype=float),
        (float(reach[0]), float(reach[1])),
        np.zeros((0, 0, 0), np.bool_) if claims is None else claims,
    )


def claimed_by_view(
    grid: PlanningGrid,
    occupancy: FloatArray,
    camera: RigidTransform,
    rays: FloatArray,
    reach: tuple[float, float],
) -> NDArray[np.bool_]:
    """Return (nx, ny, nz) unknown cells that a view is expected to show; others may skip them.

    Args:
        grid: Coarse picture of the map.
        occupancy: (nx, ny, nz) probabilities from `expected_occupancy`.
        camera: One transform from camera to world.
        rays: (R, 3) unit vectors, camera frame.
        reach: Nearest and farthest measurable distance along a ray [m].

    Raises:
        ValueError: If the probabilities are not of the grid's cells.
    """
    claims = np.zeros(grid.states.shape, np.bool_)
    view_information(grid, occupancy, camera, rays, reach, claims)
    return claims


@numba.njit(cache=True)
def _relaxed(states: Any, rates: Any, neighbours: float, sweeps: int) -> Any:
    nx, ny, nz = states.shape
    p = np.empty((nx, ny, nz))
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                state = states[i, j, k]
                known = 1.0 if state == OCCUPIED else 0.0
                p[i, j, k] = rates[k] if state == UNKNOWN else known
    for sweep in range(sweeps):
        # There and back, so that news does not travel one way only.
        forth = sweep % 2 == 0
        for a in range(nx):
            i = a if forth else nx - 1 - a
            for b in range(ny):
                j = b if forth else ny - 1 - b
                for c in range(nz):
                    k = c if forth else nz - 1 - c
                    if states[i, j, k] != UNKNOWN:
                        continue
                    total, count = 0.0, 0
                    for x, y, z in _BESIDE:
                        if 0 <= i + x < nx and 0 <= j + y < ny and 0 <= k + z < nz:
                            total, count = total + p[i + x, j + y, k + z], count + 1
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
    cells: GuessedCells,
    places: Any,
    turns: Any,
    rays: Any,
    reach: tuple[float, float],
    claims: Any,
) -> Any:
    """Walk all rays of all views; a stamp marks the cells that a view has counted."""
    states, occupancy, low, edge = cells
    near, far = reach
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
                if state == OCCUPIED:
                    break
                axis = np.argmin(next_at)
                leave = min(next_at[axis], end)
                if state == UNKNOWN:
                    p = occupancy[i, j, k]
                    if stamps[i, j, k] != view + 1:
                        stamps[i, j, k] = view + 1
                        value[view] += passes * _weighted_entropy(p)
                        if claims.size > 0:
                            claims[i, j, k] = True
                    passes *= (1.0 - p) ** ((leave - at) / edge)
                at = leave
                next_at[axis] += stride[axis]
                cell[axis] += step[axis]
                if cell[axis] < 0 or cell[axis] >= size[axis]:
                    break
    return value
