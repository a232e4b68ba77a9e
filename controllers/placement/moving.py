"""Moving objects of known shape, and a camera that follows without chatter (Thesis section 4.3.1).

When an object of known CAD moves, the plane is not mapped anew: the object's cells are removed from
the map, its pose is estimated by fitting the CAD to measured points, and the CAD at that pose,
blurred by the covariance of the pose, is inserted again. Then the camera is placed again.
"""

import contextlib
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.placement.planar.search import (
    DEFAULT_CANDIDATES,
    PlanarTask,
    RingCandidates,
    best_view,
    view_from,
)
from controllers.placement.planar.sight import OCCUPIED_ABOVE, KnownSpace
from controllers.placement.task import Occluder, PlacementError, View
from perception.geometry.arrays import FloatArray

EMPTY = 0.04
"""Probability of occupancy of a cell measured empty once, as in the map's own updates."""
ROUND_CORNERS = 8
"""Number of corners of the polygon about a circle of uncertainty."""
SAME = 1e-9
"""Relative difference up to which two ratings are equal."""


@dataclasses.dataclass(frozen=True)
class PlanarPose:
    """Estimated pose of an object on the plane.

    Attributes:
        x: x of the object's origin [m], world.
        y: y of the object's origin [m], world.
        heading: Heading from the world's x axis [rad].
        covariance: (3, 3) covariance of the errors of x, y [m] and heading [rad].

    Raises:
        ValueError: If the covariance is malformed or has a negative variance.
    """

    x: float
    y: float
    heading: float
    covariance: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, dtype=float)
        if covariance.shape != (3, 3) or not np.all(np.isfinite(covariance)):
            raise ValueError(f"covariance: shape {covariance.shape}, expected finite (3, 3)")
        if np.min(np.linalg.eigvalsh(covariance)) < -1e-12:  # noqa: PLR2004
            raise ValueError("covariance: has a negative variance")
        object.__setattr__(self, "covariance", covariance)

    def to_world(self, points: FloatArray) -> FloatArray:
        """Return points (..., 2) of the object's frame in the world [m]."""
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        return points @ np.array([[cos, sin], [-sin, cos]]) + [self.x, self.y]


@dataclasses.dataclass(frozen=True)
class MovingObject:
    """An object of known shape.

    Attributes:
        name: Name used in results and errors.
        outline: (K, 2) corners of the convex outline [m], object frame; sorted anticlockwise.

    Raises:
        ValueError: If the outline has no area.
    """

    name: str
    outline: FloatArray

    def __post_init__(self) -> None:
        outline = np.array(self.outline, dtype=float)
        if outline.ndim != 2 or outline.shape[1] != 2 or np.linalg.matrix_rank(outline[1:] - outline[0]) < 2:  # fmt: skip  # noqa: E501, PLR2004
            raise ValueError(f"object {self.name!r}: its outline {outline.shape} has no area")
        object.__setattr__(self, "outline", outline[ConvexHull(outline).vertices])


def fit_outline(
    shape: MovingObject, points: FloatArray, deviation: float, prior: PlanarPose, rounds: int = 20
) -> PlanarPose:
    """Estimate an object's pose by fitting its outline to measured points (steps 2 and 3).

    Gauss-Newton on the distances of points to the outline; directions that the
    points do not observe, for instance along the only visible side, keep the prior's covariance.

    Args:
        shape: Object with its outline.
        points: (N, 2) points measured on its outline [m], world.
        deviation: Standard deviation of a point, normal to the outline [m].
        prior: Expected pose with a covariance of full rank.
        rounds: Greatest number of steps.

    Raises:
        ValueError: If the deviation is not positive or the prior is certain.
    """
    if not deviation > 0.0:
        raise ValueError(f"deviation {deviation} m: expected a positive length")
    if np.linalg.matrix_rank(prior.covariance) < 3:  # noqa: PLR2004
        raise ValueError("prior: its covariance must be of full rank")
    weight = np.linalg.inv(prior.covariance)
    start = np.array([prior.x, prior.y, prior.heading])
    pose = start.copy()
    information = weight
    for _ in range(rounds):
        distances, slopes = _distances(shape.outline, points, pose)
        information = weight + slopes.T @ slopes / deviation**2
        gradient = weight @ (start - pose) - slopes.T @ distances / deviation**2
        step = np.linalg.solve(information, gradient)
        pose += step
        if np.abs(step).max() < 1e-10:  # noqa: PLR2004
            break
    x, y, heading = map(float, pose)
    return PlanarPose(x, y, heading, np.asarray(np.linalg.inv(information), dtype=np.float64))


def _distances(
    outline: FloatArray, points: FloatArray, pose: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return points' signed distances (N,) to their nearest sides' lines, and slopes (N, 3)."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turn = np.array([[cos, -sin], [sin, cos]])
    local = (points - pose[:2]) @ turn
    edges = np.roll(outline, -1, axis=0) - outline
    lengths = np.linalg.norm(edges, axis=1)
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / lengths[:, None]
    offset = local[:, None] - outline
    along = np.clip(np.sum(offset * edges, axis=2) / lengths**2, 0.0, 1.0)
    nearest = np.argmin(np.linalg.norm(offset - along[..., None] * edges, axis=2), axis=1)
    normal = normals[nearest]
    distances = np.sum((local - outline[nearest]) * normal, axis=1)
    turned = np.stack([local[:, 1], -local[:, 0]], axis=1)
    return distances, np.column_stack([-normal @ turn.T, np.sum(normal * turned, axis=1)])


def take_out(
    space: KnownSpace, shape: MovingObject, pose: PlanarPose, sigmas: float = 3.0
) -> KnownSpace:
    """Remove an object's cells from a map (step 1): they count as measured empty.

    All cells under the object are empty once it has gone. About it, as far as its pose is
    uncertain and a cell is wide, only occupied cells are its.

    Args:
        space: Map that contains the object.
        shape: Object with its outline.
        pose: Pose of the object when it was mapped.
        sigmas: Greatest error of its cells, in standard deviations of the pose.
    """
    centres = cell_centres(space)
    wide = swollen(shape, pose, sigmas, space.cell * math.sqrt(0.5)).points
    near = covers(wide[ConvexHull(wide).vertices], centres)
    cells = near & (space.probability > OCCUPIED_ABOVE)
    cells |= covers(pose.to_world(shape.outline), centres)
    return dataclasses.replace(space, probability=np.where(cells, EMPTY, space.probability))


def put_back(
    space: KnownSpace,
    shape: MovingObject,
    pose: PlanarPose,
    generator: np.random.Generator,
    draws: int = 400,
) -> KnownSpace:
    """Put an object into a map at its measured pose, blurred by the pose's uncertainty (step 4).

    A cell is free if neither what was mapped nor the object is there:
    1 - P = (1 - P_map) (1 - P_object), with P_object the share of drawn poses that cover it.

    Args:
        space: Map without the object.
        shape: Object with its outline.
        pose: Measured pose with its covariance.
        generator: Random generator for the drawn poses.
        draws: Number of drawn poses.
    """
    mean = np.array([pose.x, pose.y, pose.heading])
    poses = generator.multivariate_normal(mean, pose.covariance, draws, method="eigh")
    reach = np.abs(poses[:, :2] - mean[:2]).max() + np.linalg.norm(shape.outline, axis=1).max()
    centres = cell_centres(space)
    near = np.all(np.abs(centres - mean[:2]) <= reach, axis=-1)
    dx, dy = (centres[near] - poses[:, None, :2]).transpose(2, 0, 1)
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    local = np.stack([cos * dx + sin * dy, cos * dy - sin * dx], axis=-1)
    share = covers(shape.outline, local).mean(axis=0)
    probability = space.probability.copy()
    probability[near] = 1.0 - (1.0 - probability[near]) * (1.0 - share)
    return dataclasses.replace(space, probability=probability)


def swollen(
    shape: MovingObject, pose: PlanarPose, sigmas: float = 3.0, margin: float = 0.0
) -> Occluder:
    """Return an object as an occluder, expanded by the covariance of its pose.

    Each corner is replaced by a circle of its greatest standard deviation, to first order.

    Args:
        shape: Object with its outline.
        pose: Measured pose with its covariance.
        sigmas: Radius of the circle, in standard deviations.
        margin: Additional radius [m].

    Raises:
        ValueError: If ``sigmas`` or ``margin`` is negative.
    """
    if not (sigmas >= 0.0 and margin >= 0.0):
        raise ValueError(f"sigmas {sigmas}, margin {margin} m: expected 0 or more")
    corners = pose.to_world(shape.outline)
    angles = 2.0 * np.pi * np.arange(ROUND_CORNERS) / ROUND_CORNERS
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) / math.cos(np.pi / ROUND_CORNERS)
    points: list[FloatArray] = []
    for corner in corners:
        lever = corner - [pose.x, pose.y]
        slope = np.array([[1.0, 0.0, -lever[1]], [0.0, 1.0, lever[0]]])
        variance = np.linalg.eigvalsh(slope @ pose.covariance @ slope.T)[-1]
        points.append(corner + (sigmas * math.sqrt(max(variance, 0.0)) + margin) * ring)
    return Occluder(shape.name, np.concatenate(points))


def replace_camera(
    task: PlanarTask,
    present: FloatArray | None,
    factor: float,
    candidates: RingCandidates = DEFAULT_CANDIDATES,
) -> tuple[View, bool]:
    """Place a camera again, with hysteresis.

    The camera moves only if the best view rates more than ``factor`` times the best view from its
    present position, or if it sees no target from there. So the rating is never below the best one
    over the factor. A turn to another target without translation is no move.

    Args:
        task: Targets, lens, occluders and occupancy map as now estimated.
        present: (2,) present camera position [m], world; None at first.
        factor: Least ratio of ratings for which the camera moves, at least 1.
        candidates: Camera poses that are tried.

    Returns:
        The view, and whether the camera has to move for it.

    Raises:
        ValueError: If the factor is below 1.
        PlacementError: If no pose sees a target; the message gives the reasons.
    """
    if not factor >= 1.0:
        raise ValueError(f"factor {factor}: expected 1 or more")
    now: View | None = None
    if present is not None:
        with contextlib.suppress(PlacementError):
            now = view_from(task, present)
    try:
        best = best_view(task, candidates)
    except PlacementError:
        if now is None:
            raise
        return now, False
    if now is not None and best.rating <= factor * now.rating * (1.0 + SAME):
        return now, False
    return best, True


def cell_centres(space: KnownSpace) -> FloatArray:
    """Return the centres (rows, columns, 2) of a map's cells [m], world."""
    y, x = np.mgrid[tuple(map(slice, space.probability.shape))]
    return (np.stack([x, y], axis=-1) + 0.5) * space.cell + np.asarray(space.origin)


def covers(corners: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Return which points (..., 2) lie in a convex polygon (K, 2) given anticlockwise."""
    inside = np.ones(points.shape[:-1], dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        edge = b - a
        inside &= edge[0] * (points[..., 1] - a[1]) >= edge[1] * (points[..., 0] - a[0])
    return inside
