"""What a view of a sparse map would show: how much that was never measured, and where it ends."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false

from __future__ import annotations

import dataclasses
import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.pinhole import Frustum
from perception.voxels.bricks import SIDE
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State
from perception.voxels.raycast import KERNEL, whole
from perception.voxels.scan import Camera, camera_of

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
    _look(kinds, states.ravel(), camera, settings, depths, sums)
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
    """Follow a ray for each pixel.

    Args:
        kinds: Of `VoxelMap.outline`.
        states: Likewise, flat.
        camera: Where the rays start, and one pixel for each.
        settings: Side of a voxel [m], attenuation [1/m].
        depths: (rows, columns) written where a ray is stopped.
        sums: (3,) added to: z1^3 - z0^3 of unmeasured, of free, and of what is seen of unmeasured.
    """
    side = settings[0] * SIDE
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
            per_depth = settings[1] * math.sqrt(dx * dx + dy * dy + dz * dz)
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
            ticks = settings[0] * TICKS
            depths[row, column] = _follow(
                kinds, states, (x, y, z),
                (int(((x + hx) * side - ox) * ix * TICKS),
                 int(((y + hy) * side - oy) * iy * TICKS),
                 int(((z + hz) * side - oz) * iz * TICKS)),
                (int(ticks * abs(ix)), int(ticks * abs(iy)), int(ticks * abs(iz))),
                (hx, hy, hz),
                (enter, leave), per_depth, sums,
            )  # fmt: skip


@numba.njit(**KERNEL)
def _follow(
    kinds: NDArray[np.int32],
    states: NDArray[np.uint16],
    brick: tuple[int, int, int],
    faces: tuple[int, int, int],
    widths: tuple[int, int, int],
    ahead: tuple[bool, bool, bool],
    ends: tuple[float, float],
    per_depth: float,
    sums: FloatArray,
) -> float:
    """Follow a ray brick by brick, and through those that are not alike voxel by voxel.

    Depth is kept as whole ticks, so that the nearest face is stepped over without a branch: which
    of three it is cannot be foretold, and a wrong guess costs more than all the arithmetic.

    Args:
        kinds: Of `VoxelMap.outline`.
        states: Likewise, flat.
        brick: In which it starts.
        faces: Depth of the next brick on each axis [ticks].
        widths: Depth from voxel to voxel on each axis [ticks].
        ahead: Whether the ray goes up on each axis.
        ends: Depth where it starts and ends [m].
        per_depth: Attenuation by unmeasured space [1/m].
        sums: As for `_look`.

    Returns:
        Depth at which it meets an occupied voxel [m], or infinity.
    """
    (x, y, z), (tx, ty, tz), (vx, vy, vz) = brick, faces, widths
    bx, by, bz = kinds.shape
    hx, hy, hz = ahead
    sx, sy, sz = 1 if hx else -1, 1 if hy else -1, 1 if hz else -1
    cx, cy, cz = sx << 3, sy, sz << 1
    wx, wy, wz = vx * SIDE, vy * SIDE, vz * SIDE
    fx, fy, fz = 1.0 / vx, 1.0 / vy, 1.0 / vz
    # Numbers of voxels turned round, where the ray goes down.
    flip_x, flip_y, flip_z = 0 if hx else SIDE - 1, 0 if hy else SIDE - 1, 0 if hz else SIDE - 1
    now, last = int(ends[0] * TICKS), int(ends[1] * TICKS)
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
