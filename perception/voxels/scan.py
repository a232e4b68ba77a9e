"""A scan as a map wants it: an image of its points, their surface normals, and what is free."""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportIncompatibleMethodOverride=false, reportReturnType=false

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import Frustum
from perception.voxels.bricks import KERNEL, whole

TILE = 8
"""Pixels along a tile; each has one surface normal."""
LEAST_COSINE = 0.15
"""Least cosine of the angle between view and normal; smaller ones are taken as this."""
UNSURE_COSINE = 0.4
"""Cosine taken where there is no normal."""


class Camera(NamedTuple):
    """A `Frustum` with its pose, for kernels.

    Attributes:
        turn: (3, 3) rotation from the world to the camera frame.
        origin: (3,) position from the grid's corner [m], world axes.
        corner: (3,) corner of the grid [m], world.
        width: Columns [px].
        height: Rows [px].
        fx: Focal length in columns [px].
        fy: Focal length in rows [px].
        cx: Column of the optical axis [px].
        cy: Row of the optical axis [px].
        near: Least depth [m].
        far: Largest depth [m].
    """

    turn: FloatArray
    origin: FloatArray
    corner: FloatArray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    near: float
    far: float


class ScanSettings(NamedTuple):
    """How a scan enters a map.

    Attributes:
        resolution: Side of a voxel [m].
        shape: Voxels on each axis.
        hit: Log-odds that a hit adds, in the map's steps.
        miss: Log-odds that a miss adds, in the map's steps.
        lowest: Least log-odds of a voxel, in the map's steps.
        highest: Largest log-odds of a voxel, in the map's steps.
        correlated_points: Number of neighbouring points that count as one.
        coarse: True to judge cubes of 2 x 2 x 2 voxels together: see `VoxelMapConfig`.
        scan: Number of this scan.
        drop_when_full: True to drop changes without memory, instead of requesting more.
    """

    resolution: float
    shape: tuple[int, int, int]
    hit: int
    miss: int
    lowest: int
    highest: int
    correlated_points: float
    coarse: bool
    scan: int
    drop_when_full: bool


class Scan(NamedTuple):
    """The images of a scan.

    Attributes:
        depth: (height, width) of the nearest points in each pixel [m], zero where there is none.
        count: (height, width) how many those are.
        limit: (height, width) depth up to which space is free [m], zero where there is no point.
        sigma: (height, width) deviation of one point's depth [m].
        kind: (height, width) NO_POINT; FLAT if the points lie on their tile's plane, else ROUGH.
        place: (height, width, 3) sum of the points [m], from the grid's corner.
        covariance: (height, width, 6) sum of their covariances [m^2]: xx, xy, xz, yy, yz, zz.
        normal: (tiles down, tiles across, 3) world, towards the camera.
        low: (tiles down, tiles across) least limit of a tile [m], zero if a pixel has no point.
        high: (tiles down, tiles across) largest depth [m].
        inverse: (tiles down, tiles across) mean inverse depth [1/m].
    """

    depth: NDArray[np.float32]
    count: NDArray[np.int32]
    limit: NDArray[np.float32]
    sigma: NDArray[np.float32]
    kind: NDArray[np.int8]
    place: NDArray[np.float32]
    covariance: NDArray[np.float32]
    normal: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    inverse: NDArray[np.float32]


NO_POINT, ROUGH, FLAT = range(3)


def allocate_scan(frustum: Frustum) -> Scan:
    """Allocate the images of a scan."""
    size = (frustum.height, frustum.width)
    tiles = (-(-frustum.height // TILE), -(-frustum.width // TILE))
    return Scan(
        depth=np.zeros(size, dtype=np.float32),
        count=np.zeros(size, dtype=np.int32),
        limit=np.zeros(size, dtype=np.float32),
        sigma=np.zeros(size, dtype=np.float32),
        kind=np.zeros(size, dtype=np.int8),
        place=np.zeros((*size, 3), dtype=np.float32),
        covariance=np.zeros((*size, 6), dtype=np.float32),
        normal=np.zeros((*tiles, 3), dtype=np.float32),
        low=np.zeros(tiles, dtype=np.float32),
        high=np.zeros(tiles, dtype=np.float32),
        inverse=np.zeros(tiles, dtype=np.float32),
    )


def camera_of(
    transform_camera_to_world: RigidTransform, frustum: Frustum, corner: FloatArray
) -> Camera:
    """Return a camera in the coordinates of a grid whose corner is given [m], world."""
    pose = np.asarray(transform_camera_to_world.as_matrix(), dtype=np.float64)
    turn = np.ascontiguousarray(pose[:3, :3].T)
    origin = pose[:3, 3] - corner
    numbers = map(float, (*frustum.intrinsics[2:], frustum.near, frustum.far))
    return Camera(turn, origin, corner, frustum.width, frustum.height, *numbers)


def binned(frustum: Frustum, resolution: float) -> Frustum:
    """Return the view with pixels of at most a voxel at the far end, by halves of what they are."""
    size = 1
    while 2 * size * frustum.far <= min(frustum.fx, frustum.fy) * resolution:
        size *= 2
    if size == 1:
        return frustum
    return frustum.resized(-(-frustum.width // size), -(-frustum.height // size))


def window_of(camera: Camera, far: float, side: float, shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the first and last brick on each axis (6,) that a view can reach up to a depth."""
    u = (-0.5 - camera.cx) / camera.fx, (camera.width - 0.5 - camera.cx) / camera.fx
    v = (-0.5 - camera.cy) / camera.fy, (camera.height - 0.5 - camera.cy) / camera.fy
    corners = np.array([[x * far, y * far, far] for x in u for y in v] + [[0.0, 0.0, 0.0]])
    ends = corners @ camera.turn + camera.origin
    low, high = np.floor(ends.min(axis=0) / side), np.floor(ends.max(axis=0) / side)
    window = np.empty(6, dtype=np.int64)
    window[:3], window[3:] = np.maximum(low, 0), np.minimum(high, np.array(shape) - 1)
    return window


def fill_scan(
    scan: Scan,
    camera: Camera,
    points: FloatArray,
    covariances: FloatArray,
    resolution: float,
    margins: tuple[float, float],
) -> int:
    """Arrange a cloud in the camera's pixels.

    Args:
        scan: Images of the scan, overwritten.
        camera: Camera that took the scan.
        points: (N, 3) [m], world. Those outside of the view are left out.
        covariances: (N, 3, 3) [m^2], world.
        resolution: Side of a voxel [m].
        margins: Distance from free space to a surface: in deviations, and in voxels.

    Returns:
        -1, or the first point that is not finite or whose covariance is not positive definite.
    """
    scan.depth.fill(0.0)
    scan.count.fill(0)
    bad = int(_organise(scan, camera, points, covariances, 2.0 * resolution))
    if bad < 0:
        _tile_means(scan)
        _describe(scan, camera, resolution, margins[0], margins[1])
    return bad


@numba.njit(**KERNEL)
def _organise(
    scan: Scan, camera: Camera, points: FloatArray, covariances: FloatArray, thickness: float
) -> int:
    """Sum up the nearest points of each pixel; return the first bad point or -1.

    Until `_tile_means` depth is a sum too, and sigma the sum of variances.
    """
    # Taken out of their arrays once: the compiler must think that what is stored changes them.
    (ax, ay, az), (bx, by, bz), (dx, dy, dz) = _row(camera, 0), _row(camera, 1), _row(camera, 2)
    left, top, low = camera.corner[0], camera.corner[1], camera.corner[2]
    ox, oy, oz = camera.origin[0], camera.origin[1], camera.origin[2]
    height, width = scan.depth.shape
    depths, counts, sigmas = scan.depth.reshape(-1), scan.count.reshape(-1), scan.sigma.reshape(-1)
    places, sums = scan.place.reshape(-1, 3), scan.covariance.reshape(-1, 6)
    for i in range(np.uint64(points.shape[0])):
        xx, xy, xz = covariances[i, 0, 0], covariances[i, 0, 1], covariances[i, 0, 2]
        yy, yz, zz = covariances[i, 1, 1], covariances[i, 1, 2], covariances[i, 2, 2]
        x, y, z = points[i, 0] - left, points[i, 1] - top, points[i, 2] - low
        minor = xx * yy - xy * xy
        whole_ = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
        # Sylvester's criterion; a comparison with NaN is false.
        good = xx > 0.0 and minor > 0.0 and whole_ > 0.0 and xx + yy + zz < np.inf
        if not (good and abs(x + y + z) < np.inf):
            return np.int64(i)
        px, py, pz = x - ox, y - oy, z - oz
        depth = dx * px + dy * py + dz * pz
        if depth < camera.near or depth > camera.far:
            continue
        inverse = 1.0 / depth
        across = (ax * px + ay * py + az * pz) * inverse
        down = (bx * px + by * py + bz * pz) * inverse
        u = whole(camera.fx * across + camera.cx + 0.5)
        v = whole(camera.fy * down + camera.cy + 0.5)
        if not (0 <= u < width and 0 <= v < height):
            continue
        pixel = np.uint64(v * width + u)
        count = counts[pixel]
        if count > 0:
            beyond = depth - depths[pixel] / count
            if beyond > thickness:
                continue
            if beyond < -thickness:
                count = 0
        variance = px * px * xx + py * py * yy + pz * pz * zz
        variance += 2.0 * (px * py * xy + px * pz * xz + py * pz * yz)
        part = depth / (px * px + py * py + pz * pz)
        variance *= part * part
        counts[pixel] = count + 1
        if count == 0:
            depths[pixel], sigmas[pixel] = depth, variance
        else:
            depths[pixel] += depth
            sigmas[pixel] += variance
            # All are read before any is written: so they are added up together.
            x, y, z = x + places[pixel, 0], y + places[pixel, 1], z + places[pixel, 2]
            xx, xy, xz = xx + sums[pixel, 0], xy + sums[pixel, 1], xz + sums[pixel, 2]
            yy, yz, zz = yy + sums[pixel, 3], yz + sums[pixel, 4], zz + sums[pixel, 5]
        places[pixel, 0], places[pixel, 1], places[pixel, 2] = x, y, z
        sums[pixel, 0], sums[pixel, 1], sums[pixel, 2] = xx, xy, xz
        sums[pixel, 3], sums[pixel, 4], sums[pixel, 5] = yy, yz, zz
    return -1


@numba.njit(**KERNEL, inline="always")
def _row(camera: Camera, number: int) -> tuple[float, float, float]:
    """Return one axis of the camera in the world."""
    return camera.turn[number, 0], camera.turn[number, 1], camera.turn[number, 2]


@numba.njit(**KERNEL)
def _tile_means(scan: Scan) -> None:
    """Take means, and fill each tile's mean inverse depth (zero: no point) and largest depth."""
    height, width = scan.depth.shape
    for down in range(scan.high.shape[0]):
        for across in range(scan.high.shape[1]):
            total, count, deepest = 0.0, 0, np.float32(0.0)
            for v in range(down * TILE, min(down * TILE + TILE, height)):
                for u in range(across * TILE, min(across * TILE + TILE, width)):
                    here = scan.count[v, u]
                    if here > 0:
                        z = scan.depth[v, u] / np.float32(here)
                        scan.depth[v, u] = z
                        scan.sigma[v, u] = math.sqrt(scan.sigma[v, u] / here)
                        total += 1.0 / z
                        count += 1
                        deepest = max(deepest, z)
            scan.inverse[down, across] = total / count if count > 0 else 0.0
            scan.high[down, across] = deepest


@numba.njit(**KERNEL)
def _slope(before: float, here: float, after: float, tolerance: float) -> float:
    """Return how inverse depth changes over a tile; across an edge, on the smoother side."""
    if before > 0.0 and after > 0.0:
        if abs(before + after - 2.0 * here) < tolerance:
            return (after - before) / 2.0
        return after - here if abs(after - here) < abs(here - before) else here - before
    if after > 0.0:
        return after - here
    return here - before if before > 0.0 else 0.0


@numba.njit(**KERNEL)
def _clear_tile(scan: Scan, down: int, across: int) -> None:
    """Mark a tile without a point: nothing in it is free."""
    for v in range(down * TILE, min(down * TILE + TILE, scan.limit.shape[0])):
        for u in range(across * TILE, min(across * TILE + TILE, scan.limit.shape[1])):
            scan.limit[v, u] = 0.0
            scan.kind[v, u] = NO_POINT


@numba.njit(**KERNEL)
def _describe(
    scan: Scan, camera: Camera, resolution: float, deviations: float, voxels: float
) -> None:
    """Fill normals, limits and kinds; on a plane inverse depth is linear in the image."""
    height, width = scan.depth.shape
    downs, acrosses = scan.inverse.shape
    turn, inverse = camera.turn, scan.inverse
    for down in range(downs):
        for across in range(acrosses):
            here = float(inverse[down, across])
            scan.low[down, across] = 0.0
            if here == 0.0:
                _clear_tile(scan, down, across)
                continue
            left = float(inverse[down, across - 1]) if across > 0 else 0.0
            right = float(inverse[down, across + 1]) if across + 1 < acrosses else 0.0
            above = float(inverse[down - 1, across]) if down > 0 else 0.0
            below = float(inverse[down + 1, across]) if down + 1 < downs else 0.0
            tolerance = 2.0 * resolution * here * here
            a = _slope(left, here, right, tolerance) / TILE
            b = _slope(above, here, below, tolerance) / TILE
            u0, v0 = across * TILE + (TILE - 1) / 2, down * TILE + (TILE - 1) / 2
            nx, ny = a * camera.fx, b * camera.fy
            nz = here - a * (u0 - camera.cx) - b * (v0 - camera.cy)
            norm = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
            for axis in range(3):
                along = turn[0, axis] * nx + turn[1, axis] * ny + turn[2, axis] * nz
                scan.normal[down, across, axis] = -norm * along
            lowest = np.float32(np.inf)
            for v in range(down * TILE, min(down * TILE + TILE, height)):
                for u in range(across * TILE, min(across * TILE + TILE, width)):
                    z = float(scan.depth[v, u])
                    if z == 0.0:
                        scan.kind[v, u] = NO_POINT
                        scan.limit[v, u] = 0.0
                        lowest = np.float32(0.0)
                        continue
                    sigma = scan.sigma[v, u]
                    plane = here + a * (u - u0) + b * (v - v0)
                    flat = abs(1.0 - plane * z) * z < 4.0 * sigma + 0.5 * resolution
                    # What a step across the surface is along the view's axis.
                    cosine = max(norm * plane, LEAST_COSINE) if flat else UNSURE_COSINE
                    limit = max(z - deviations * sigma - resolution * voxels / cosine, 0.0)
                    scan.kind[v, u] = FLAT if flat else ROUGH
                    scan.limit[v, u] = limit
                    lowest = min(lowest, scan.limit[v, u])
            scan.low[down, across] = lowest
