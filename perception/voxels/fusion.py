"""Surface estimates of a sparse map: measured points are fused along the ray, not voxel by voxel.

A voxel may be far smaller than the noise. Merging only what falls into one takes the truncated
part of the noise for all of it, and is over-confident. Here a group of points searches along its
ray, as far as its own uncertainty reaches, for estimates of the same surface; what agrees is merged
into one, which is stored in the voxel where it then lies. Covariances are packed as xx, xy, xz, yy,
yz, zz.
"""

# pyright: reportUnknownMemberType=false, reportUntypedFunctionDecorator=false
# pyright: reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownParameterType=false, reportArgumentType=false

import math
from typing import NamedTuple

import numba
import numpy as np

from perception.geometry.arrays import FloatArray
from perception.voxels.bricks import (
    DROPPED,
    KERNEL,
    NEVER,
    NOWHERE,
    POINTS,
    SCAN,
    Bricks,
    dense_brick,
    has_capacity,
    new_record,
    record_at,
    release_record,
    slot_block,
    whole,
)
from perception.voxels.scan import FLAT, NO_POINT, TILE, Camera, Scan, ScanSettings

BARELY_MEASURED = -1
"""Log-odds of a voxel just before a surface: measured, hardly decided."""
GATE = 9.0
"""Squared deviations within which two estimates are of one surface."""
REACH_SIGMAS, MAX_STEPS = 3.0, 24
"""Deviations that a group searches along its ray, and voxels at most to each side."""
MAX_HIT_SIGMA_VOXELS = 0.25
"""Deviation, in voxels, up to which a voxel is taken as occupied for the points that it holds."""
MIN_SIGMA_VOXELS = 0.02
"""Deviation that a voxel's surface keeps, in voxels: it is no point."""


class Estimates(NamedTuple):
    """Buffers for the estimates that `fuse_scan` works on.

    Attributes:
        mean: (3,) of the group of points at hand [m].
        covariance: (6,) of the group of points at hand [m^2].
        fused_mean: (3,) of the estimates merged so far [m].
        fused: (6,) covariance of the estimates merged so far [m^2].
        other_mean: (3,) of the estimate to be merged [m].
        other: (6,) covariance of the estimate to be merged [m^2].
        normal: (3,) normal of the surface at the group, zeros if unknown.
    """

    mean: FloatArray
    covariance: FloatArray
    fused_mean: FloatArray
    fused: FloatArray
    other_mean: FloatArray
    other: FloatArray
    normal: FloatArray


def allocate_estimates() -> Estimates:
    """Return buffers for `fuse_scan`."""
    return Estimates(*(np.empty(size) for size in (3, 6, 3, 6, 3, 6, 3)))


@numba.njit(**KERNEL, inline="always")
def _effective(points: float, correlated: float) -> float:
    """Return how many independent points so many are worth."""
    return 0.0 if points <= 0.0 else max(1.0, points / correlated)


@numba.njit(**KERNEL)
def fuse_scan(
    store: Bricks,
    scan: Scan,
    camera: Camera,
    settings: ScanSettings,
    work: Estimates,
    first: int,
) -> int:
    """Add the points of a scan tile by tile.

    Args:
        store: Storage of the map, changed.
        scan: The images of the scan; points taken are crossed out.
        camera: Camera that took the scan.
        settings: Settings of the scan's update.
        work: Buffers.
        first: Tile to begin with.

    Returns:
        The tile before which capacity is needed, or the number of tiles.
    """
    resolution = settings.resolution
    downs, acrosses = scan.high.shape
    focal = math.sqrt(camera.fx * camera.fy)
    most = TILE * TILE
    for tile in range(first, downs * acrosses):
        down, across = tile // acrosses, tile % acrosses
        high = scan.high[down, across]
        if high == 0.0:
            continue
        if not has_capacity(store, most, most, most) and not settings.drop_when_full:
            return tile
        # Groups of about half a voxel's width (0.35 to 0.7), so that a slanted surface has no gaps.
        side = 1
        while side < TILE and 2.0 * side * high <= 1.4 * focal * resolution:
            side *= 2
        for v0 in range(down * TILE, min(down * TILE + TILE, camera.height), side):
            for u0 in range(across * TILE, min(across * TILE + TILE, camera.width), side):
                v1, u1 = min(v0 + side, camera.height), min(u0 + side, camera.width)
                corner = (v0, v1, u0, u1)
                for turn in range(1 + side * side):
                    # First what lies on the tile's plane, then the rest, the nearest first.
                    flat = turn == 0
                    count = _gather(scan, corner, flat, resolution, work.mean, work.covariance)
                    if count > 0:
                        for axis in range(3):
                            work.normal[axis] = scan.normal[down, across, axis] if flat else 0.0
                        _fuse_group(store, camera.origin, count, settings, work)
                    elif not flat:
                        break
    return downs * acrosses


@numba.njit(**KERNEL, inline="always")
def _gather(
    scan: Scan,
    corner: tuple[int, int, int, int],
    flat: bool,
    thickness: float,
    mean: FloatArray,
    covariance: FloatArray,
) -> int:
    """Take some pixels' points out of a scan: their number, mean and mean covariance.

    Args:
        scan: The images; points taken are crossed out.
        corner: First and end row, first and end column.
        flat: True to take those on the tile's plane, else the nearest of the others.
        thickness: Range of depths that counts as nearest [m].
        mean: (3,) written.
        covariance: (6,) written.
    """
    kind, depth, place, covariances = scan.kind, scan.depth, scan.place, scan.covariance
    nearest = np.float32(np.inf)
    if not flat:
        for v in range(corner[0], corner[1]):
            for u in range(corner[2], corner[3]):
                if kind[v, u] != NO_POINT:
                    nearest = min(nearest, depth[v, u])
        nearest += np.float32(thickness)
    mean[:] = 0.0
    covariance[:] = 0.0
    count = 0
    for v in range(corner[0], corner[1]):
        for u in range(corner[2], corner[3]):
            if kind[v, u] == FLAT if flat else kind[v, u] != NO_POINT and depth[v, u] <= nearest:
                kind[v, u] = NO_POINT
                count += scan.count[v, u]
                for axis in range(3):
                    mean[axis] += place[v, u, axis]
                for k in range(6):
                    covariance[k] += covariances[v, u, k]
    scale = 1.0 / max(count, 1)
    for axis in range(3):
        mean[axis] *= scale
    for k in range(6):
        covariance[k] *= scale
    return count


@numba.njit(**KERNEL, inline="always")
def _fuse_group(
    store: Bricks,
    origin: FloatArray,
    count: int,
    settings: ScanSettings,
    work: Estimates,
) -> None:
    """Merge a group with the estimates along its ray, and put the result where it lies."""
    resolution, correlated, now = settings.resolution, settings.correlated_points, settings.scan
    nx, ny, nz = settings.shape
    mean, covariance, normal = work.mean, work.covariance, work.normal
    rx, ry, rz = mean[0] - origin[0], mean[1] - origin[1], mean[2] - origin[2]
    length = math.sqrt(rx * rx + ry * ry + rz * rz)
    rx, ry, rz = rx / length, ry / length, rz / length
    sigma = math.sqrt(_variance_along(covariance, rx, ry, rz) / _effective(count, correlated))
    sure = normal[0] != 0.0 or normal[1] != 0.0 or normal[2] != 0.0
    ax, ay, az = (normal[0], normal[1], normal[2]) if sure else (rx, ry, rz)
    reach = REACH_SIGMAS * sigma
    steps = min(int(reach / resolution) + 1, MAX_STEPS)
    stride = reach / steps
    own, own_covariance = mean, covariance
    carried, before, merged = NEVER, 0, False
    fused_mean, fused = work.fused_mean, work.fused
    other_mean, other = work.other_mean, work.other
    floor = (MIN_SIGMA_VOXELS * resolution) ** 2
    voxel_variance = resolution * resolution / 12.0
    gate_group = _variance_along(covariance, ax, ay, az) / _effective(count, correlated)
    gate_group += floor + (0.0 if sure else voxel_variance)
    lx, ly, lz = -1, -1, -1
    scale = 1.0 / resolution
    for j in range(2 * steps + 1):
        # Nearest first: 0, -1, 1, -2, 2 ...
        t = stride * ((j + 1) // 2) * (-1.0 if j % 2 == 1 else 1.0)
        x = whole((own[0] + t * rx) * scale)
        y = whole((own[1] + t * ry) * scale)
        z = whole((own[2] + t * rz) * scale)
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz) or (x == lx and y == ly and z == lz):
            continue
        lx, ly, lz = x, y, z
        record = record_at(store, x, y, z)
        if record < 0:
            continue
        _copy(other_mean, other, store.records[record, :3], store.records[record, 3:9])
        dx, dy, dz = other_mean[0] - own[0], other_mean[1] - own[1], other_mean[2] - own[2]
        off = ax * dx + ay * dy + az * dz
        beside = dx * dx + dy * dy + dz * dz - off * off
        # Another voxel's estimate is of the same patch only if it lies before or behind it.
        if j > 0 and beside > 0.25 * resolution * resolution:
            continue
        if off * off > GATE * (gate_group + _variance_along(other, ax, ay, az)):
            continue
        if store.records[record, SCAN] == now:
            before = max(before, int(store.records[record, POINTS]))
        brick = store.index[x >> 3, y >> 3, z >> 3]
        cell = ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
        carried = max(carried, int(store.values[brick, cell]))
        store.values[brick, cell] = BARELY_MEASURED
        release_record(store, store.block[brick], cell)
        if merged:
            merge_gaussians(fused_mean, fused, other_mean, other)
        else:
            _copy(fused_mean, fused, other_mean, other)
            merged = True
    # What points of one scan have in common is counted once.
    worth = _effective(before + count, correlated) - _effective(before, correlated)
    if worth > 0.0 or not merged:
        worth = max(worth, 1e-3)
        for k in range(6):
            own_covariance[k] /= worth
        # Which point of the voxel's patch was measured is not known; it lies in the surface.
        own_covariance[0] += voxel_variance * (1.0 - (ax * ax if sure else 0.0))
        own_covariance[1] -= voxel_variance * (ax * ay if sure else 0.0)
        own_covariance[2] -= voxel_variance * (ax * az if sure else 0.0)
        own_covariance[3] += voxel_variance * (1.0 - (ay * ay if sure else 0.0))
        own_covariance[4] -= voxel_variance * (ay * az if sure else 0.0)
        own_covariance[5] += voxel_variance * (1.0 - (az * az if sure else 0.0))
        if merged:
            merge_gaussians(fused_mean, fused, own, own_covariance)
        else:
            _copy(fused_mean, fused, own, own_covariance)
    _put_down(store, fused_mean, fused, carried, before, count, settings)


@numba.njit(**KERNEL)
def touch_scan(store: Bricks, scan: Scan, settings: ScanSettings, first: int) -> int:
    """Take voxels as occupied where points are in them, unless they are known to be free.

    Estimates are stored where a patch has its middle. Voxels of which a slanted surface cuts only a
    corner would stay open, and views would leak through. Points that are less certain than a voxel
    is large are left out. To be called after `fuse_scan`, with the same arguments.

    Returns:
        The row of the image before which capacity is needed, or the number of rows.
    """
    resolution, hit = settings.resolution, settings.hit
    nx, ny, nz = settings.shape
    height, width = scan.depth.shape
    lx, ly, lz = -1, -1, -1
    for v in range(first, height):
        if not settings.drop_when_full and not has_capacity(store, width, 0, 0):
            return v
        for u in range(width):
            if scan.count[v, u] == 0 or scan.sigma[v, u] > MAX_HIT_SIGMA_VOXELS * resolution:
                continue
            scale = 1.0 / (resolution * scan.count[v, u])
            x, y = whole(scan.place[v, u, 0] * scale), whole(scan.place[v, u, 1] * scale)
            z = whole(scan.place[v, u, 2] * scale)
            if x == lx and y == ly and z == lz:
                continue
            lx, ly, lz = x, y, z
            if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
                continue
            brick = store.index[x >> 3, y >> 3, z >> 3]
            if brick < NOWHERE:
                continue
            if brick < 0 and not has_capacity(store, 1, 0, 0):
                store.used[DROPPED] += 1
                continue
            brick = dense_brick(store, x >> 3, y >> 3, z >> 3)
            cell = ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
            value = store.values[brick, cell]
            if value == NEVER or BARELY_MEASURED <= value < hit:
                store.values[brick, cell] = hit
    return height


@numba.njit(**KERNEL, inline="always")
def _put_down(
    store: Bricks,
    mean: FloatArray,
    covariance: FloatArray,
    carried: int,
    before: int,
    count: int,
    settings: ScanSettings,
) -> None:
    """Store an estimate in the voxel where it lies, and let the voxel be hit once a scan."""
    now, (nx, ny, nz) = settings.scan, settings.shape
    scale = 1.0 / settings.resolution
    x, y, z = whole(mean[0] * scale), whole(mean[1] * scale), whole(mean[2] * scale)
    if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
        return
    if not has_capacity(store, 1, 1, 1):
        store.used[DROPPED] += 1
        return
    brick = dense_brick(store, x >> 3, y >> 3, z >> 3)
    block = slot_block(store, brick)
    cell = ((x & 7) << 6) | ((y & 7) << 3) | (z & 7)
    record = store.slots[block, cell]
    seen = before > 0
    if record >= 0:
        # Two surfaces in a voxel that do not agree: one estimate that is as unsure as both.
        seen = seen or store.records[record, SCAN] == now
        k = 0
        for i in range(3):
            for j in range(i, 3):
                apart = (store.records[record, i] - mean[i]) * (store.records[record, j] - mean[j])
                covariance[k] = (covariance[k] + store.records[record, 3 + k]) / 2.0 + apart / 4.0
                k += 1
        for i in range(3):
            mean[i] = (mean[i] + store.records[record, i]) / 2.0
    else:
        record = new_record(store)
        store.slots[block, cell] = record
    _copy(store.records[record, :3], store.records[record, 3:9], mean, covariance)
    store.records[record, SCAN] = now
    store.records[record, POINTS] = before + count
    value = max(int(store.values[brick, cell]), carried)
    if not seen:
        value = (0 if value == NEVER else value) + settings.hit
    store.values[brick, cell] = min(max(value, settings.lowest), settings.highest)


@numba.njit(**KERNEL)
def merge_gaussians(
    mean: FloatArray, covariance: FloatArray, other_mean: FloatArray, other_covariance: FloatArray
) -> None:
    """Merge two Gaussians in place: C1 - C1 (C1 + C2)^-1 C1 (Thesis eq. 3-8 and 3-10, mended).

    Args:
        mean: (3,) changed.
        covariance: (6,) xx, xy, xz, yy, yz, zz; changed.
        other_mean: (3,).
        other_covariance: (6,).
    """
    a, b, c = covariance[0], covariance[1], covariance[2]
    d, e, f = covariance[3], covariance[4], covariance[5]
    sa, sb, sc = a + other_covariance[0], b + other_covariance[1], c + other_covariance[2]
    sd, se, sf = d + other_covariance[3], e + other_covariance[4], f + other_covariance[5]
    ia, ib, ic = sd * sf - se * se, sc * se - sb * sf, sb * se - sc * sd
    scale = 1.0 / (sa * ia + sb * ib + sc * ic)
    ia, ib, ic = ia * scale, ib * scale, ic * scale
    id_, ie = (sa * sf - sc * sc) * scale, (sb * sc - sa * se) * scale
    if_ = (sa * sd - sb * sb) * scale
    k00, k01, k02 = a * ia + b * ib + c * ic, a * ib + b * id_ + c * ie, a * ic + b * ie + c * if_
    k10, k11, k12 = b * ia + d * ib + e * ic, b * ib + d * id_ + e * ie, b * ic + d * ie + e * if_
    k20, k21, k22 = c * ia + e * ib + f * ic, c * ib + e * id_ + f * ie, c * ic + e * ie + f * if_
    x, y, z = other_mean[0] - mean[0], other_mean[1] - mean[1], other_mean[2] - mean[2]
    mean[0] += k00 * x + k01 * y + k02 * z
    mean[1] += k10 * x + k11 * y + k12 * z
    mean[2] += k20 * x + k21 * y + k22 * z
    covariance[0] = a - (k00 * a + k01 * b + k02 * c)
    covariance[1] = b - (k00 * b + k01 * d + k02 * e)
    covariance[2] = c - (k00 * c + k01 * e + k02 * f)
    covariance[3] = d - (k10 * b + k11 * d + k12 * e)
    covariance[4] = e - (k10 * c + k11 * e + k12 * f)
    covariance[5] = f - (k20 * c + k21 * e + k22 * f)


@numba.njit(**KERNEL)
def _copy(
    mean: FloatArray, covariance: FloatArray, from_mean: FloatArray, from_covariance: FloatArray
) -> None:
    """Overwrite a Gaussian by another."""
    for axis in range(3):
        mean[axis] = from_mean[axis]
    for k in range(6):
        covariance[k] = from_covariance[k]


@numba.njit(**KERNEL)
def _variance_along(covariance: FloatArray, x: float, y: float, z: float) -> float:
    """Return the variance in a direction."""
    diagonal = x * x * covariance[0] + y * y * covariance[3] + z * z * covariance[5]
    return diagonal + 2.0 * (x * y * covariance[1] + x * z * covariance[2] + y * z * covariance[4])
