"""Occluders in space: solids, clusters of voxels, and their expansion by the target.

Thesis section 4.2.3.3 (i) and (ii). An occluder is added to the *mirrored* target (Minkowski
sum) and replaced by its convex hull; then a camera sees the whole target if the segment from it to
the target's reference point misses every hull.
"""

# trimesh types its shapes in part only.
# pyright: reportUnknownMemberType=false

import dataclasses
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from controllers.placement.task import Occluder, PlacementError, Target
from perception.geometry.arrays import FloatArray, IntArray

_FLAT = 1e-9
"""Thickness of a hull over its size below which the hull is flat."""
_NOT_FLAT = 1e-10
"""Square of the same above which it is not flat by far."""
_COPLANAR = 1e-9
"""Difference of two planes' coefficients up to which they are one plane."""


class HullParts(NamedTuple):
    """Faces and edges of the expanded hulls of one target, for compiled code.

    All are in the target's frame: origin at its position, z along its normal. Kept are the parts
    that can bound what a hull hides from the origin: the edges of its silhouette, and, where the
    ball within which the camera is cuts the hull, its front faces and the edges between them.

    Attributes:
        planes: (M, 4) outward unit normals n and b, inside is n x + b <= 0; each hull's front ones
            (b > 0: the origin is before them) come first.
        plane_start: (H + 1,) index of the first plane of each hull.
        front: (H,) number of front planes of each hull.
        rims: (E, 2, 3) end points of the silhouette's edges [m].
        rim_start: (H + 1,) index of the first silhouette edge of each hull.
        ridges: (R, 2, 3) end points of the edges between two front faces [m].
        ridge_start: (H + 1,) index of the first such edge of each hull.
        axes: (H, 3) axis of a cone from the origin about each hull.
        cones: (H,) half angle of that cone [rad].
        nearest: (H,) lower bound of the distance from the origin to the hull [m].
    """

    planes: FloatArray
    plane_start: IntArray
    front: IntArray
    rims: FloatArray
    rim_start: IntArray
    ridges: FloatArray
    ridge_start: IntArray
    axes: FloatArray
    cones: FloatArray
    nearest: FloatArray


@dataclasses.dataclass(frozen=True)
class TargetField:
    """A target with its expanded occluders.

    Attributes:
        target: Target in three dimensions.
        rotation: (3, 3) rotation from the target's frame to the world; azimuth counts from the
            first axis, elevation from the plane of the first two.
        names: Name of the occluder of each hull that reaches in front of the target's plane.
        hulls: Faces and edges of the expanded occluders.
        shapes: (N, 3) vertices of each hull [m], world, for pictures.
    """

    target: Target
    rotation: FloatArray
    names: tuple[str, ...]
    hulls: HullParts
    shapes: tuple[FloatArray, ...]

    def to_frame(self, points: ArrayLike) -> FloatArray:
        """Return points (N, 3) of the world in the target's frame [m]."""
        return (np.asarray(points, dtype=float) - self.target.position) @ self.rotation

    def to_world(self, points: ArrayLike) -> FloatArray:
        """Return points (N, 3) of the target's frame in the world [m]."""
        return np.asarray(points, dtype=float) @ self.rotation.T + self.target.position


def frame_of(normal: FloatArray) -> FloatArray:
    """Return (3, 3) axes of a target's frame as columns: z is `normal`, x as near the world's x.

    Where the normal is nearly along x, the world's y is used.
    """
    towards = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]  # noqa: PLR2004
    x = towards - float(towards @ normal) * normal
    x /= float(np.linalg.norm(x))
    return np.array([x, np.cross(normal, x), normal]).T.astype(np.float64)


def occluders_of_voxels(
    centres: ArrayLike, cell: float, tile: int = 8, name: str = "voxels"
) -> list[Occluder]:
    """Return occluders of the occupied voxels of a map.

    The hull of a cluster that is not convex would hold free space, even the target. So clusters are
    cut along a regular grid: each part is connected (over faces, edges or corners) within one tile
    of the grid.

    Args:
        centres: (N, 3) centres of the occupied voxels [m], world.
        cell: Edge of a voxel [m].
        tile: Edge of a tile [voxels].
        name: Name of the occluders; the number of the part is appended.

    Raises:
        ValueError: If the centres are not (N, 3) finite numbers, or cell or tile is not positive.
    """
    points = np.asarray(centres, dtype=float)
    if points.size == 0:
        return []
    if points.ndim != 2 or points.shape[1] != 3 or not np.all(np.isfinite(points)):  # noqa: PLR2004
        raise ValueError(f"{name}: centres {points.shape}, expected (N, 3) finite numbers")
    if not (cell > 0.0 and tile >= 1):
        raise ValueError(f"{name}: cell {cell} m, tile {tile}: expected both above zero")
    # The grid is the map's own, so a part keeps its shape when the map grows elsewhere.
    keys = np.floor(points / cell + 1e-6).astype(np.int64)
    tiles = keys // tile
    first, second = cKDTree(keys).query_pairs(1.0, p=np.inf, output_type="ndarray").T
    joined = np.all(tiles[first] == tiles[second], axis=1)
    links = coo_array((joined[joined], (first[joined], second[joined])), shape=2 * [len(keys)])
    count, part = connected_components(links, directed=False)
    corners = cell * np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    found: list[Occluder] = []
    for index in range(count):
        around = (points[part == index, None] + corners).reshape(-1, 3)
        found.append(Occluder(f"{name} {index}", around[ConvexHull(around).vertices]))
    return found


def occluders_of_points(points: FloatArray, cell: float) -> list[Occluder]:
    """Return occluders named ``mapped`` of the voxels that hold points (N, 3) [m], world.

    Args:
        points: Points of obstacles.
        cell: Edge of a voxel [m].
    """
    cells = np.unique(np.floor(points / cell), axis=0)
    return occluders_of_voxels((cells + 0.5) * cell, cell, name="mapped")


def before_plane(target: Target, points: ArrayLike, height: float) -> FloatArray:
    """Return those of points (N, 3) [m], world, that are in front of a target's plane.

    In a map the target's own face is occupied as well; it is the plane of the target, not an
    occluder, and its voxels are left out by this.

    Args:
        target: Target in three dimensions.
        points: (N, 3) points [m], world, for instance the centres of occupied voxels.
        height: Least height of these points over the plane [m]; about a voxel's diagonal.
    """
    places = np.asarray(points, dtype=float).reshape(-1, 3)
    return places[(places - target.position) @ target.normal > height]


def expand(
    target: Target, occluders: Sequence[Occluder], margin: float | Sequence[float] = 0.0
) -> TargetField:
    """Expand occluders by a target (thesis figure 4-3).

    An occluder that lies wholly behind the target's plane hides nothing and is left out.

    Args:
        target: Target in three dimensions.
        occluders: Bodies that may hide the target.
        margin: Uncertainty of the occluders' surfaces [m], one or one for each: hulls grow by at
            least this.

    Raises:
        PlacementError: If a hull contains the target's position: it is hidden from everywhere.
        ValueError: If the target or an occluder is planar, the margins are not as many as the
            occluders, one is negative or a hull is flat.
    """
    if len(target.position) != 3:  # noqa: PLR2004
        raise ValueError(f"target {target.name!r}: lies on the plane, expected three dimensions")
    rotation = frame_of(target.normal)
    outline = target.outline @ rotation
    given = np.asarray(margin, dtype=float)
    if given.shape not in ((), (1,), (len(occluders),)):
        raise ValueError(f"margin of shape {given.shape}: expected one, or {len(occluders)}")
    margins = np.broadcast_to(given, len(occluders))
    names: list[str] = []
    hulls: list[ConvexHull] = []
    for occluder, width in zip(occluders, margins):
        if not (np.isfinite(width) and width >= 0.0):
            raise ValueError(f"occluder {occluder.name!r}: margin {width} m, expected 0 or more")
        if occluder.points.shape[1] != 3:  # noqa: PLR2004
            raise ValueError(f"occluder {occluder.name!r}: has two coordinates, expected three")
        vertices = (occluder.points - target.position) @ rotation
        hull = _sum_hull(occluder.name, vertices, -outline, width)
        size = float(np.ptp(hull.points, axis=0).max())
        if hull.points[:, 2].max() <= _FLAT * size:
            continue
        if np.all(hull.equations[:, 3] <= _FLAT * size):
            raise PlacementError(
                f"no pose sees the target {target.name!r}: it lies in or too near to occluder "
                f"{occluder.name!r}, which hides it from everywhere"
            )
        names.append(occluder.name)
        hulls.append(hull)
    shapes = tuple(h.points[h.vertices] @ rotation.T + target.position for h in hulls)
    return TargetField(target, rotation, tuple(names), _compile(hulls), shapes)


def _ball_about(radius: float) -> FloatArray:
    """Return (12, 3) corners of an icosahedron that holds a ball of this radius."""
    golden = (1.0 + 5.0**0.5) / 2.0
    first = np.array([[0.0, a, b * golden] for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(first, shift, axis=1) for shift in range(3)])
    inner = golden**2 / 3.0**0.5  # Radius of the ball within this one, of edge 2.
    return np.asarray(corners * (radius / inner), dtype=np.float64)


def _sum_hull(name: str, vertices: FloatArray, outline: FloatArray, margin: float) -> ConvexHull:
    """Return the hull of the Minkowski sum of points and an outline, and of a ball about them."""
    if margin > 0.0:
        outline = (outline[:, None] + _ball_about(margin)).reshape(-1, 3)
    points = (vertices[:, None] + outline).reshape(-1, 3)
    extents = _extents(points)
    if len(points) < 4 or extents[2] <= _FLAT * extents[0]:  # noqa: PLR2004
        shape = "a plane" if len(extents) > 1 and extents[1] > _FLAT * extents[0] else "a line"
        raise ValueError(
            f"occluder {name!r}: it and the target lie in {shape}, so their sum is flat; give it "
            "a thickness, or a margin above 0"
        )
    try:
        return ConvexHull(points)
    except QhullError as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"occluder {name!r}: no hull can be made of it ({reason})") from error


def _extents(points: FloatArray) -> FloatArray:
    """Return the singular values of points (N, 3) about their mean, the largest first [m]."""
    away = points - points.mean(axis=0)
    squares = np.linalg.eigvalsh(away.T @ away)[::-1]  # Quick, but with half the digits.
    if squares[-1] > _NOT_FLAT * squares[0]:
        return np.sqrt(squares)
    return np.asarray(np.linalg.svd(away, compute_uv=False), dtype=np.float64)


def _compile(hulls: Sequence[ConvexHull]) -> HullParts:
    """Gather the parts of hulls, in the target's frame."""
    planes, edges = [_planes(hull) for hull in hulls], [_edges(hull) for hull in hulls]
    rims, ridges = [rim for rim, _ in edges], [ridge for _, ridge in edges]
    front = np.array([np.count_nonzero(plane[:, 3] > 0.0) for plane in planes], dtype=np.int64)
    nearest = np.array([plane[:, 3].max() for plane in planes])
    cones = np.array([_cone(hull) for hull in hulls]).reshape(-1, 4)
    return HullParts(
        _joined(planes, (4,)), _starts(planes), front,
        _joined(rims, (2, 3)), _starts(rims), _joined(ridges, (2, 3)), _starts(ridges),
        np.ascontiguousarray(cones[:, :3]), np.ascontiguousarray(cones[:, 3]), nearest,
    )  # fmt: skip


def _planes(hull: ConvexHull) -> FloatArray:
    """Return the planes (M, 4) of a hull's faces, each once, the front ones first."""
    unique = np.unique(np.round(hull.equations / _COPLANAR) * _COPLANAR, axis=0)
    return unique[np.argsort(unique[:, 3] <= 0.0, kind="stable")]


def _cone(hull: ConvexHull) -> FloatArray:
    """Return the axis and the half angle [rad] (4,) of a cone from the origin about a hull."""
    corners = hull.points[hull.vertices]
    directions = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    axis = directions.mean(axis=0)
    axis /= np.linalg.norm(axis)
    cosine = float(np.min(directions @ axis))
    # A cone wider than the half space is not convex: it may hold the corners and not the rest.
    return np.append(axis, np.arccos(min(cosine, 1.0)) + _COPLANAR if cosine > 0.0 else np.pi)


def _edges(hull: ConvexHull) -> tuple[FloatArray, FloatArray]:
    """Return (E, 2, 3) edges between front and back faces, and between two front faces."""
    offsets = np.round(hull.equations / _COPLANAR) * _COPLANAR
    ahead = offsets[:, 3] > 0.0
    face, corner = np.nonzero(hull.neighbors > np.arange(len(hull.neighbors))[:, None])
    other = hull.neighbors[face, corner]
    ends = np.stack(
        [hull.simplices[face, (corner + 1) % 3], hull.simplices[face, (corner + 2) % 3]], axis=1
    )
    edges = hull.points[ends]
    bent = np.any(np.abs(offsets[face] - offsets[other]) > 2.0 * _COPLANAR, axis=1)
    rim = ahead[face] != ahead[other]
    return edges[rim], edges[ahead[face] & ahead[other] & bent]


def _joined(parts: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    return np.ascontiguousarray(np.concatenate([*parts, np.empty((0, *shape))]))


def _starts(parts: Sequence[FloatArray]) -> IntArray:
    return np.concatenate([[0], np.cumsum([len(part) for part in parts])]).astype(np.int64)
