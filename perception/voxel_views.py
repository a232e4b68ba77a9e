"""What a view of a sparse map would show: how much that was never measured, and where it ends."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.occupancy import State
from perception.pinhole import Frustum
from perception.raycast import KERNEL, whole
from perception.voxel_bricks import SIDE
from perception.voxel_map import VoxelMap
from perception.voxel_scan import Camera, camera_of

FloatArray = NDArray[np.float64]

UNKNOWN, OCCUPIED = int(State.UNKNOWN), int(State.OCCUPIED)
TICKS = 2.0**40
"""Of depth, in a metre."""
RAYS = (64, 48)
"""Columns and rows of rays that stand for a view."""


@dataclasses.dataclass(frozen=True)
class ViewCounts:
    """What a view would show of a map.

    Attributes:
        unmeasured: Volume never measured that no occupied voxel hides [m^3].
        free: Volume known to be free that none hides [m^3].
        information: Expected number of unmeasured voxels that the view would settle, a bit each:
            those farther along a ray count less, as something may stand before them. Known voxels
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
        mean_free_path: How far one sees into unknown space on average [m]. It is a length, so that
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
    settings = (voxels.grid.resolution, 1.0 / mean_free_path)
    kinds, states = voxels.outline()
    _look(kinds, states, camera, settings, depths, sums)
    # A ray stands for a pixel, which is z^2 / (fx fy) large at depth z.
    unmeasured, free, seen = (sums / (3.0 * coarse.fx * coarse.fy)).tolist()
    return ViewCounts(unmeasured, free, seen / voxels.grid.resolution**3, depths)


@numba.njit(**KERNEL)
def _look(
    kinds: NDArray[np.int32],
    states: NDArray[np.uint16],
    camera: Camera,
    settings: tuple[float, float],
    depths: FloatArray,
    sums: FloatArray,
) -> None:
    """Follow each ray brick by brick, and through those that are not alike voxel by voxel.

    Args:
        kinds: Of `VoxelMap.outline`.
        states: Likewise.
        camera: Where the rays start, and one pixel for each.
        settings: Side of a voxel [m], attenuation [1/m].
        depths: (rows, columns) written where a ray is stopped.
        sums: (3,) added to: z1^3 - z0^3 of unmeasured, of free, and of what is seen of unmeasured.
    """
    resolution, attenuation = settings
    side = resolution * SIDE
    bx, by, bz = kinds.shape
    ox, oy, oz = camera.origin[0], camera.origin[1], camera.origin[2]
    turn = camera.turn
    for ray in range(depths.size):
        u = (ray % camera.width - camera.cx) / camera.fx
        v = (ray // camera.width - camera.cy) / camera.fy
        dx = turn[0, 0] * u + turn[1, 0] * v + turn[2, 0]
        dy = turn[0, 1] * u + turn[1, 1] * v + turn[2, 1]
        dz = turn[0, 2] * u + turn[1, 2] * v + turn[2, 2]
        per_depth = attenuation * math.sqrt(dx * dx + dy * dy + dz * dz)
        # A direction without a component: as good as never across such faces, and no 0 times inf.
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
        # Ticks, and steps without a branch: see `_cross`.
        tx = int(((x + hx) * side - ox) * ix * TICKS)
        ty = int(((y + hy) * side - oy) * iy * TICKS)
        tz = int(((z + hz) * side - oz) * iz * TICKS)
        ticks = side * TICKS
        wx, wy, wz = int(ticks * abs(ix)), int(ticks * abs(iy)), int(ticks * abs(iz))
        sx, sy, sz = 1 if hx else -1, 1 if hy else -1, 1 if hz else -1
        now, last = int(enter * TICKS), int(leave * TICKS)
        begin, clear, run, stopped = enter, 1.0, 0, False
        while True:
            brick = kinds[x, y, z]
            if brick != run:
                here = now / TICKS
                if run < 0:
                    clear = _through_run(run, begin, here, clear, per_depth, sums)
                begin, run = here, brick
                if brick == -1 - OCCUPIED:
                    stopped = True
                    break
            nearest = min(tx, ty, tz)
            ahead = min(nearest, last)
            if brick >= 0:
                start = (ox - x * side, oy - y * side, oz - z * side)
                begin, clear, stopped = _cross(
                    states, brick, start, (dx, dy, dz), (ix, iy, iz), now / TICKS, ahead / TICKS,
                    clear, per_depth, resolution, sums,
                )  # fmt: skip
                if stopped:
                    break
            now = ahead
            x_step, y_step = -np.int64(tx == nearest), -np.int64(ty == nearest)
            z_step = -np.int64(tz == nearest)
            x, y, z = x + (sx & x_step), y + (sy & y_step), z + (sz & z_step)
            tx, ty, tz = tx + (wx & x_step), ty + (wy & y_step), tz + (wz & z_step)
            if now >= last or not (0 <= x < bx and 0 <= y < by and 0 <= z < bz):
                if run < 0:
                    _through_run(run, begin, now / TICKS, clear, per_depth, sums)
                break
        if stopped:
            depths[ray // camera.width, ray % camera.width] = begin


@numba.njit(**KERNEL)
def _through_run(
    kind: int, start: float, end: float, clear: float, per_depth: float, sums: FloatArray
) -> float:
    """Count a stretch of bricks that are all unmeasured, or all free."""
    if kind != -1 - UNKNOWN:
        sums[1] += end * end * end - start * start * start
        return clear
    ahead = math.exp(-per_depth * (end - start))
    return _count_unmeasured(start, end, ahead, clear, per_depth, sums)


@numba.njit(**KERNEL)
def _not_zero(component: float) -> float:
    return component if abs(component) > 1e-6 else 1e-6


@numba.njit(**KERNEL)
def _through_unmeasured(
    start: float, end: float, clear: float, per_depth: float, sums: FloatArray
) -> float:
    """Count a stretch of unmeasured space; return what then is still seen of what lies behind."""
    depth = per_depth * (end - start)
    # exp(-depth) by a series of exp(depth / 4); stretches are short.
    fourth = 1.0 + 0.25 * depth * (1.0 + 0.125 * depth * (1.0 + depth / 12.0))
    ahead = 1.0 / (fourth * fourth * fourth * fourth)
    return _count_unmeasured(start, end, ahead, clear, per_depth, sums)


@numba.njit(**KERNEL)
def _count_unmeasured(
    start: float, end: float, ahead: float, clear: float, per_depth: float, sums: FloatArray
) -> float:
    # Integral of z^2 exp(-per_depth (z - start)).
    path = 1.0 / per_depth
    first = path * (start * start + 2.0 * path * (start + path))
    last = path * (end * end + 2.0 * path * (end + path))
    sums[0] += end * end * end - start * start * start
    sums[2] += 3.0 * clear * (first - last * ahead)
    return clear * ahead


@numba.njit(**KERNEL, inline="always")
def _cross(
    states: NDArray[np.uint16],
    brick: int,
    origin: tuple[float, float, float],
    direction: tuple[float, float, float],
    inverse: tuple[float, float, float],
    t: float,
    end: float,
    clear: float,
    per_depth: float,
    resolution: float,
    sums: FloatArray,
) -> tuple[float, float, bool]:
    """Follow a ray through one brick, from depth t to the end, voxel by voxel.

    Returns:
        Where it stopped, what is still seen there, and whether something occupied stopped it.
    """
    (ox, oy, oz), (dx, dy, dz), (ix, iy, iz) = origin, direction, inverse
    x = min(max(whole((ox + t * dx) / resolution), 0), SIDE - 1)
    y = min(max(whole((oy + t * dy) / resolution), 0), SIDE - 1)
    z = min(max(whole((oz + t * dz) / resolution), 0), SIDE - 1)
    # Depth as whole ticks, so that the nearest face is stepped over without a branch: which of
    # three it is cannot be foretold, and a wrong guess costs more than all the arithmetic.
    tx = int(((x + (dx > 0.0)) * resolution - ox) * ix * TICKS)
    ty = int(((y + (dy > 0.0)) * resolution - oy) * iy * TICKS)
    tz = int(((z + (dz > 0.0)) * resolution - oz) * iz * TICKS)
    side = resolution * TICKS
    wx, wy, wz = int(side * abs(ix)), int(side * abs(iy)), int(side * abs(iz))
    sx, sy, sz = 8 if dx > 0.0 else -8, 1 if dy > 0.0 else -1, 2 if dz > 0.0 else -2
    # Steps until the ray leaves the brick, on each axis.
    nx, ny, nz = SIDE - x if dx > 0.0 else x + 1, SIDE - y if dy > 0.0 else y + 1, 0
    nz = SIDE - z if dz > 0.0 else z + 1
    column, shift = (x << 3) | y, 2 * z
    state = (int(states[brick, column]) >> shift) & 3
    now, last = int(t * TICKS), int(end * TICKS)
    begin, kind = t, state
    while True:
        if state != kind or state == OCCUPIED or now >= last:
            # Stretches of one kind are counted as a whole.
            here = min(max(now / TICKS, begin), end)
            if kind == UNKNOWN:
                clear = _through_unmeasured(begin, here, clear, per_depth, sums)
            else:
                sums[1] += here * here * here - begin * begin * begin
            if state == OCCUPIED or now >= last:
                return float(here), clear, bool(now < last)
            begin, kind = here, state
        nearest = min(tx, ty, tz)
        x_step, y_step = -np.int64(tx == nearest), -np.int64(ty == nearest)
        z_step = -np.int64(tz == nearest)
        now = min(nearest, last)
        column += (sx & x_step) + (sy & y_step)
        shift += sz & z_step
        tx, ty, tz = tx + (wx & x_step), ty + (wy & y_step), tz + (wz & z_step)
        nx, ny, nz = nx + x_step, ny + y_step, nz + z_step
        if nx == 0 or ny == 0 or nz == 0:
            now = last
        else:
            state = (int(states[brick, column]) >> shift) & 3
