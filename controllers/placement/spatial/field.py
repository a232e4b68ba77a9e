"""Target field visibility in space: the angle a camera can move until the target is hidden.

Thesis section 4.2.3.3 (iii), exact. From the target's position, a hull cut off by the ball of
the camera's distance r covers a part of the sphere; hull parts beyond the camera hide nothing. That
part is bounded by the silhouette's edges within the ball (arcs of great circles) and by the circles
in which the ball cuts the front faces. The nearest point of each has a closed form.
"""

import numba
import numpy as np
from numpy.typing import ArrayLike

from controllers.placement.spatial.occluders import TargetField
from perception.geometry.arrays import FloatArray

_INSIDE = 1e-8
"""Distance outside of a plane up to which a point counts as on it [m]."""
PLANE = -1
"""The target's own plane, in place of the index of a hull."""


def free_caps(field: TargetField, positions: ArrayLike) -> FloatArray:
    """Return the target field visibility (N,) [rad] of cameras.

    It is the smallest angle, over all moves around the target at the same distance, until the
    target is hidden or viewed edge-on; 0 where it is.

    Args:
        field: Target and its occluders.
        positions: (N, 3) camera positions [m], world, none at the target.
    """
    return np.maximum(signed_caps(field, positions), 0.0)


def signed_caps(field: TargetField, positions: ArrayLike) -> FloatArray:
    """Return `free_caps`, but negative where the target is hidden.

    There it is minus the angle out of the hull (or plane) in which the camera is deepest: no
    smaller move brings the target into view.
    """
    points = np.atleast_2d(field.to_frame(positions))
    distances = np.linalg.norm(points, axis=1)
    directions = points / distances[:, None]
    return _caps(field.hulls, directions, distances)


@numba.njit(cache=True)
def _caps(hulls, directions, distances):
    result = np.empty(len(directions))
    for index in range(len(directions)):
        result[index] = signed_cap(
            hulls, directions[index, 0], directions[index, 1], directions[index, 2],
            distances[index],
        )[0]  # fmt: skip
    return result


@numba.njit(cache=True)
def signed_cap(hulls, x, y, z, radius):
    """Return the signed free cap of a direction, and the hull that bounds it.

    It changes by no more than the angle between two directions, and never grows with the radius.

    Args:
        hulls: `HullParts` of the expanded occluders.
        x: x of the unit vector towards the camera, target's frame.
        y: y of the unit vector towards the camera.
        z: z of the unit vector towards the camera, along the target's normal.
        radius: Distance of the camera [m].

    Returns:
        The angle [rad], negative where hidden, and the index of the hull, or `PLANE`.
    """
    least = np.arcsin(min(max(z, -1.0), 1.0))
    which = PLANE
    for hull in range(len(hulls.nearest)):
        if hulls.nearest[hull] > radius:
            continue
        axis = hulls.axes[hull]
        cosine = x * axis[0] + y * axis[1] + z * axis[2]
        apart = np.arccos(min(max(cosine, -1.0), 1.0)) - hulls.cones[hull]
        if apart >= least:
            continue
        hidden = _hit(hulls, hull, x, y, z) <= radius
        if not hidden and least <= 0.0:
            continue
        best = _rim_cosine(hulls, hull, x, y, z, radius)
        best = max(best, _cut_cosine(hulls, hull, x, y, z, radius))
        angle = np.arccos(min(max(best, -1.0), 1.0)) if best > -2.0 else np.inf  # noqa: PLR2004
        if hidden:
            angle = -angle
        if angle < least:
            least = angle
            which = hull
    return least, which


@numba.njit(cache=True)
def _hit(hulls, hull, x, y, z):
    """Return the distance [m] at which a ray from the origin enters the hull, or infinity."""
    enter, leave = 0.0, np.inf
    for index in range(hulls.plane_start[hull], hulls.plane_start[hull + 1]):
        plane = hulls.planes[index]
        slope = plane[0] * x + plane[1] * y + plane[2] * z
        if slope < 0.0:
            enter = max(enter, -plane[3] / slope)
        elif slope > 0.0:
            leave = min(leave, -plane[3] / slope)
        elif plane[3] > 0.0:
            return np.inf
        if enter > leave:
            return np.inf
    return enter


@numba.njit(cache=True)
def _rim_cosine(hulls, hull, x, y, z, radius):
    """Return the cosine to the nearest point of the silhouette within the ball, -3 if none."""
    best = -3.0
    for index in range(hulls.rim_start[hull], hulls.rim_start[hull + 1]):
        a, b = hulls.rims[index, 0], hulls.rims[index, 1]
        first, last = _within(a, b, radius)
        if first > last:
            continue
        dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        ax, ay, az = a[0] + first * dx, a[1] + first * dy, a[2] + first * dz
        bx, by, bz = a[0] + last * dx, a[1] + last * dy, a[2] + last * dz
        along_a = (x * ax + y * ay + z * az) / np.sqrt(ax * ax + ay * ay + az * az)
        along_b = (x * bx + y * by + z * bz) / np.sqrt(bx * bx + by * by + bz * bz)
        best = max(best, along_a, along_b)
        # The foot of u on the great circle's plane; it counts if it lies between the ends.
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        square = nx * nx + ny * ny + nz * nz
        if square < 1e-30:  # noqa: PLR2004
            continue
        height = (x * nx + y * ny + z * nz) / square
        wx, wy, wz = x - height * nx, y - height * ny, z - height * nz
        after = (ay * wz - az * wy) * nx + (az * wx - ax * wz) * ny + (ax * wy - ay * wx) * nz
        before = (wy * bz - wz * by) * nx + (wz * bx - wx * bz) * ny + (wx * by - wy * bx) * nz
        if after >= 0.0 and before >= 0.0:
            best = max(best, np.sqrt(wx * wx + wy * wy + wz * wz))
    return best


@numba.njit(cache=True)
def _cut_cosine(hulls, hull, x, y, z, radius):
    """Return the cosine to the nearest point at which the sphere cuts a front face, -3 if none."""
    best = -3.0
    first, end = hulls.plane_start[hull], hulls.plane_start[hull + 1]
    for index in range(first, first + hulls.front[hull]):
        plane = hulls.planes[index]
        if plane[3] >= radius:
            continue
        across = np.sqrt(radius * radius - plane[3] * plane[3])
        slope = plane[0] * x + plane[1] * y + plane[2] * z
        ex, ey, ez = x - slope * plane[0], y - slope * plane[1], z - slope * plane[2]
        length = np.sqrt(ex * ex + ey * ey + ez * ez)
        cosine = (across * length - plane[3] * slope) / radius
        if cosine <= best or length < 1e-12:  # noqa: PLR2004
            continue
        scale = across / length
        px, py, pz = (
            scale * ex - plane[3] * plane[0],
            scale * ey - plane[3] * plane[1],
            scale * ez - plane[3] * plane[2],
        )
        inside = True
        for other in range(first, end):
            wall = hulls.planes[other]
            if wall[0] * px + wall[1] * py + wall[2] * pz + wall[3] > _INSIDE:
                inside = False
                break
        if inside:
            best = cosine
    for index in range(hulls.ridge_start[hull], hulls.ridge_start[hull + 1]):
        a, b = hulls.ridges[index, 0], hulls.ridges[index, 1]
        one, two = _within(a, b, radius)
        if one > two:
            continue
        for part in (one, two):
            if 0.0 < part < 1.0:
                px = a[0] + part * (b[0] - a[0])
                py = a[1] + part * (b[1] - a[1])
                pz = a[2] + part * (b[2] - a[2])
                best = max(best, (x * px + y * py + z * pz) / radius)
    return best


@numba.njit(cache=True)
def _within(a, b, radius):
    """Return the interval of a segment, of 0 to 1, that is in the ball; 1, 0 if there is none."""
    limit = radius * radius
    near = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
    far = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    if near <= limit and far <= limit:
        return 0.0, 1.0
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    square = dx * dx + dy * dy + dz * dz
    if square == 0.0:
        return 1.0, 0.0
    middle = -(a[0] * dx + a[1] * dy + a[2] * dz) / square
    root = middle * middle - (near - limit) / square
    if root < 0.0:
        return 1.0, 0.0
    half = np.sqrt(root)
    return max(0.0, middle - half), min(1.0, middle + half)
