"""Free space of a sparse map: each voxel is compared with the depth image; no rays are followed."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from perception.voxels.bricks import (
    CELLS,
    DROPPED,
    FREE_BRICKS,
    KERNEL,
    NEVER,
    SCAN,
    SIDE,
    Bricks,
    dense_brick,
    has_capacity,
    release_record,
    whole,
)
from perception.voxels.fusion import BARELY_MEASURED
from perception.voxels.scan import TILE, Camera, Scan, ScanSettings

NOTHING, MIXED, FREE = range(3)
HALF = SIDE // 2
BRICKS_PER_BLOCK = 4
"""Bricks along a block that is judged first."""


class Samples(NamedTuple):
    """Samples of the image for a part of 4 x 4 x 4 voxels of a brick.

    Attributes:
        x: (n,) position from the part's corner along the camera's x axis [m].
        y: (n,) position from the part's corner along the camera's y axis [m].
        z: (n,) position from the part's corner along the camera's z axis [m].
        cell: (n,) number of the voxel, from the part's first.
        pixel: (n,) pixel of the image, row by row; for the part at hand.
        depth: (n,) depth [m]; infinite outside of the image; for the part at hand.
        verdict: (n,) FREE, just before a surface (MIXED) or NOTHING; for the part at hand.
        kept: (n,) whether the voxel was hit in this scan; for the part at hand.
    """

    x: NDArray[np.float32]
    y: NDArray[np.float32]
    z: NDArray[np.float32]
    cell: NDArray[np.int32]
    pixel: NDArray[np.int32]
    depth: NDArray[np.float32]
    verdict: NDArray[np.int32]
    kept: NDArray[np.bool_]


def samples_of(camera: Camera, resolution: float, coarse: bool) -> Samples:
    """Return the middles of a part's voxels, level by level, or of its cubes of 2 x 2 x 2."""
    middles, cell = COARSE_PART if coarse else PART
    x, y, z = (camera.turn @ middles * resolution).astype(np.float32)
    return Samples(
        x=x,
        y=y,
        z=z,
        cell=cell,
        pixel=np.empty_like(cell),
        depth=np.empty_like(x),
        verdict=np.empty_like(cell),
        kept=np.empty(cell.shape, dtype=np.bool_),
    )


def _part(step: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return the middles (3, n) of a part's cubes of some voxels, in voxels, and their numbers."""
    k, i, j = (grid.ravel() for grid in np.meshgrid(*3 * [range(0, HALF, step)], indexing="ij"))
    return np.stack([i, j, k]) + 0.5 * step, ((i << 6) | (j << 3) | k).astype(np.int32)


PART, COARSE_PART = _part(1), _part(2)


@numba.njit(**KERNEL)
def bricks_in(window: NDArray[np.int64]) -> int:
    """Return how many bricks `carve_scan` numbers for a window, those beside it included."""
    count = BRICKS_PER_BLOCK**3
    for axis in range(3):
        count *= max(window[3 + axis] // BRICKS_PER_BLOCK - window[axis] // BRICKS_PER_BLOCK + 1, 0)
    return count


@numba.njit(**KERNEL)
def carve_scan(
    store: Bricks,
    scan: Scan,
    camera: Camera,
    samples: Samples,
    window: NDArray[np.int64],
    settings: ScanSettings,
    first: int,
) -> int:
    """Lower the voxels that lie before what the scan saw.

    Args:
        store: Storage of the map, changed.
        scan: The images of the scan.
        camera: Camera that took the scan.
        samples: Samples of a part, from `samples_of`.
        window: (6,) first and last brick on each axis that may be in view, inside of the map.
        settings: Settings of the scan's update.
        first: Brick to begin with; they are numbered cube by cube.

    Returns:
        The brick before which capacity is needed, or `bricks_in` of the window.
    """
    miss, lowest, coarse = settings.miss, settings.lowest, settings.coarse
    edge = BRICKS_PER_BLOCK
    x0, y0, z0 = (
        window[0] // edge,
        window[1] // edge,
        window[2] // edge,
    )
    ly, lz = window[4] // edge - y0 + 1, window[5] // edge - z0 + 1
    count = bricks_in(window)
    verdict_of_block, judged = MIXED, -1
    x1, y1, z1 = x0, y0, z0
    number = first - 1
    while number + 1 < count:
        number += 1
        block_number, inner = number // edge**3, number % edge**3
        if block_number != judged:
            # Most of a fine map's bricks are decided by a look at a few dozen of them at once.
            judged = block_number
            x1, y1 = (
                (x0 + block_number // (ly * lz)) * edge,
                (y0 + block_number // lz % ly) * edge,
            )
            z1 = (z0 + block_number % lz) * edge
            verdict_of_block, _, _ = _judge(
                scan,
                camera,
                settings.resolution,
                x1 * SIDE,
                y1 * SIDE,
                z1 * SIDE,
                edge * SIDE,
            )
        if verdict_of_block == NOTHING:
            number += edge**3 - 1 - inner
            continue
        x, y, z = (
            x1 + inner // edge**2,
            y1 + inner // edge % edge,
            z1 + inner % edge,
        )
        if not (x <= window[3] and y <= window[4] and z <= window[5]):
            continue
        index = store.index[x, y, z]
        if index == -129 - lowest:
            continue
        verdict, complete = FREE, True
        if verdict_of_block != FREE:
            verdict, complete, _ = _judge(
                scan, camera, settings.resolution, x * SIDE, y * SIDE, z * SIDE, SIDE
            )
        if verdict == NOTHING or (verdict == MIXED and coarse and index < 0 and not complete):
            continue
        if verdict == FREE and index < 0:
            value = -129 - index
            value = max((0 if value == NEVER else value) + miss, lowest)
            store.index[x, y, z] = -129 - value
        elif verdict == FREE and store.block[index] < 0:
            _lower_all(store, x, y, z, miss, lowest)
        else:
            if index < 0 and not has_capacity(store, 1, 0, 0):
                if not settings.drop_when_full:
                    return number
                store.used[DROPPED] += 1
                continue
            _carve_brick(store, scan, camera, samples, settings, (x, y, z))
    return count


@numba.njit(**KERNEL, inline="always")
def _judge(scan: Scan, camera: Camera, resolution: float, x: int, y: int, z: int, side: int):
    """Judge a cube of voxels by the tiles of the image.

    Args:
        scan: The images.
        camera: Camera that took the scan.
        resolution: Side of a voxel [m].
        x: First voxel of the cube on the x axis.
        y: First voxel of the cube on the y axis.
        z: First voxel of the cube on the z axis.
        side: Voxels along the cube.

    Returns:
        The verdict; whether there are points in all pixels of the cube; and how deep they reach.
    """
    turn, origin = camera.turn, camera.origin
    length = resolution * (side - 1)
    px = (x + 0.5) * resolution - origin[0]
    py = (y + 0.5) * resolution - origin[1]
    pz = (z + 0.5) * resolution - origin[2]
    first = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz
    ax, ay, az = length * turn[2, 0], length * turn[2, 1], length * turn[2, 2]
    least = first + min(ax, 0.0) + min(ay, 0.0) + min(az, 0.0)
    most = first + max(ax, 0.0) + max(ay, 0.0) + max(az, 0.0)
    if most < camera.near or least > camera.far:
        return NOTHING, False, 0.0
    if least < camera.near:
        return MIXED, False, math.inf
    across = (turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz) * camera.fx
    down = (turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz) * camera.fy
    bx, by, bz = (
        camera.fx * length * turn[0, 0],
        camera.fx * length * turn[0, 1],
        camera.fx * length * turn[0, 2],
    )
    cx, cy, cz = (
        camera.fy * length * turn[1, 0],
        camera.fy * length * turn[1, 1],
        camera.fy * length * turn[1, 2],
    )
    left, right, top, bottom = math.inf, -math.inf, math.inf, -math.inf
    for corner in range(8):
        i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
        inverse = 1.0 / (first + ax * i + ay * j + az * k)
        u = (across + bx * i + by * j + bz * k) * inverse
        v = (down + cx * i + cy * j + cz * k) * inverse
        left, right = min(left, u), max(right, u)
        top, bottom = min(top, v), max(bottom, v)
    u0, u1 = whole(left + camera.cx + 0.5), whole(right + camera.cx + 0.5)
    v0, v1 = whole(top + camera.cy + 0.5), whole(bottom + camera.cy + 0.5)
    if u1 < 0 or v1 < 0 or u0 >= camera.width or v0 >= camera.height:
        return NOTHING, False, 0.0
    inside = u0 >= 0 and v0 >= 0 and u1 < camera.width and v1 < camera.height
    deepest, lowest = np.float32(0.0), np.float32(np.inf)
    for v in range(max(v0, 0) // TILE, min(v1, camera.height - 1) // TILE + 1):
        for u in range(max(u0, 0) // TILE, min(u1, camera.width - 1) // TILE + 1):
            deepest = max(deepest, scan.high[v, u])
            lowest = min(lowest, scan.low[v, u])
    if deepest <= least:
        return NOTHING, False, 0.0
    complete = inside and lowest > 0.0
    return (FREE if complete and most < lowest else MIXED), complete, float(deepest)


@numba.njit(**KERNEL)
def _lower_all(store: Bricks, x: int, y: int, z: int, miss: int, lowest: int) -> None:
    """Lower all voxels of a brick, which becomes a number if they are then alike."""
    number = store.index[x, y, z]
    values = store.values
    least, most = 127, -128
    for cell in range(CELLS):
        value = int(values[number, cell])
        value = max((0 if value == NEVER else value) + miss, lowest)
        values[number, cell] = value
        least, most = min(least, value), max(most, value)
    if least == most:
        store.free_bricks[store.used[FREE_BRICKS]] = number
        store.used[FREE_BRICKS] += 1
        store.index[x, y, z] = -129 - least


@numba.njit(**KERNEL, inline="always")
def _carve_brick(
    store: Bricks,
    scan: Scan,
    camera: Camera,
    samples: Samples,
    settings: ScanSettings,
    brick: tuple[int, int, int],
) -> None:
    """Go through a brick in eight parts, each judged by itself first."""
    x, y, z = brick
    for part in range(8):
        i, j, k = HALF * (part >> 2), HALF * ((part >> 1) & 1), HALF * (part & 1)
        corner = (x * SIDE + i, y * SIDE + j, z * SIDE + k)
        verdict, _, _ = _judge(
            scan, camera, settings.resolution, corner[0], corner[1], corner[2], HALF
        )
        if verdict == NOTHING:
            continue
        some = True
        if verdict == FREE:
            samples.verdict[:] = FREE
        else:
            _project(camera, samples, settings.resolution, corner)
            some = _ask(scan, samples)
        if some:
            _settle(store, samples, settings, brick, (i << 6) | (j << 3) | k)


@numba.njit(**KERNEL, inline="always")
def _project(
    camera: Camera, samples: Samples, resolution: float, corner: tuple[int, int, int]
) -> None:
    """Fill where in the image the samples of a part lie; simple enough for vector instructions."""
    turn, origin = camera.turn, camera.origin
    px, py = corner[0] * resolution - origin[0], corner[1] * resolution - origin[1]
    pz = corner[2] * resolution - origin[2]
    qx = np.float32(turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz)
    qy = np.float32(turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz)
    qz = np.float32(turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz)
    fx, fy, near = np.float32(camera.fx), np.float32(camera.fy), np.float32(camera.near)
    # One more than the pixel's number, so that cutting off decimals rounds all alike.
    cx, cy = np.float32(camera.cx + 1.5), np.float32(camera.cy + 1.5)
    right, bottom = np.float32(camera.width + 1), np.float32(camera.height + 1)
    one, width = np.float32(1.0), np.int32(camera.width)
    before = width + np.int32(1)
    for n in range(samples.cell.size):
        depth = qz + samples.z[n]
        inverse = one / depth
        u = (qx + samples.x[n]) * inverse * fx + cx
        v = (qy + samples.y[n]) * inverse * fy + cy
        inside = (depth >= near) & (u >= one) & (v >= one) & (u < right) & (v < bottom)
        u, v = u if inside else one, v if inside else one
        samples.depth[n] = depth if inside else np.float32(np.inf)
        samples.pixel[n] = np.int32(v) * width + np.int32(u) - before


@numba.njit(**KERNEL, inline="always")
def _ask(scan: Scan, samples: Samples) -> bool:
    """Compare projected samples with the image; return whether any is judged."""
    limits, depths = scan.limit.reshape(-1), scan.depth.reshape(-1)
    some = np.int32(0)
    for n in range(samples.cell.size):
        pixel, depth = np.uint32(samples.pixel[n]), samples.depth[n]
        # A limit is no deeper than its surface: NOTHING, MIXED or FREE.
        verdict = np.int32(depth < depths[pixel]) + np.int32(depth < limits[pixel])
        samples.verdict[n] = verdict
        some |= verdict
    return some != 0


@numba.njit(**KERNEL, inline="always")
def _settle(
    store: Bricks,
    samples: Samples,
    settings: ScanSettings,
    brick: tuple[int, int, int],
    first: int,
) -> None:
    """Lower free voxels, and mark those just before a surface as measured."""
    miss, lowest, now, coarse = settings.miss, settings.lowest, settings.scan, settings.coarse
    number = dense_brick(store, brick[0], brick[1], brick[2])
    block = store.block[number]
    for inner in range(8 if coarse else 1):
        beside = first + (((inner >> 2) << 6) | (((inner >> 1) & 1) << 3) | (inner & 1))
        samples.kept[:] = False
        if block >= 0:
            for n in range(samples.cell.size):
                cell = samples.cell[n] + beside
                record = store.slots[block, cell]
                if record >= 0 and samples.verdict[n] == FREE:
                    # What a scan hits it does not lower.
                    samples.kept[n] = store.records[record, SCAN] == now
                    if not samples.kept[n] and store.values[number, cell] + miss < 0:
                        release_record(store, block, cell)
        for n in range(samples.cell.size):
            cell = samples.cell[n] + beside
            value = int(store.values[number, cell])
            lowered = max((0 if value == NEVER else value) + miss, lowest)
            weak = BARELY_MEASURED if value == NEVER else value
            verdict = samples.verdict[n]
            new = lowered if verdict == FREE else (weak if verdict == MIXED else value)
            store.values[number, cell] = value if samples.kept[n] else new
