"""The pose of a body with disc markers, fitted to the ellipses that both cameras of a pair saw.

Centres of two markers leave the turn about the line through them open. The ellipses' shapes close
it: a disc foreshortens, and a slanted one is not as wide in the left image as in the right, which
fixes the side to which it is tilted. Both are weak for a small marker seen head on; the covariance
grows accordingly.
"""

import dataclasses
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import exp_twist, log_twist
from perception.stereo.geometry import CALIBRATION_ERRORS, StereoGeometry

_TURNS = 61  # Of the grid about the line through two markers.
_SCAN = np.linspace(-1.6, 1.6, 2 * _TURNS + 1)  # Turns about it, from a fit [rad].
_STEPS = np.repeat([1e-5, 1e-6], 3)  # Of finite differences [rad, m].
_NUDGES = RigidTransform.from_exp_coords(
    np.concatenate([np.zeros((1, 6)), np.diag(_STEPS), -np.diag(_STEPS)])
).as_matrix()


@dataclasses.dataclass(frozen=True)
class BodyCad:
    """Markers of a body, all on faces of one direction.

    Attributes:
        points: (N, 3) centres, two or more [m], body frame.
        normal: (3,) unit, out of their faces.
        up: (3,) direction that points upward in the image, as long as there is no prior;
            two equal markers look the same upside down.
    """

    points: FloatArray
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        points = np.asarray(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise ValueError(f"body markers: got shape {points.shape}, needs (N, 3), N >= 2")
        apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
        if not np.all(np.isfinite(points)) or apart.min() < 1e-4:
            raise ValueError(f"body markers: got {points.tolist()}, needs distinct finite points")
        if not abs(np.linalg.norm(self.normal) - 1.0) < 1e-6:
            raise ValueError(f"body markers: got normal {self.normal}, needs a unit vector")


@dataclasses.dataclass(frozen=True)
class BodyPrior:
    """What is known of a pose before it is measured.

    Attributes:
        transform_body_to_camera: The pose.
        information: (6, 6) inverse covariance of xi, rotation then translation, in
            ``true = from_exp_coords(xi) * transform_body_to_camera``; zeros for what is unknown.
        by_calibration: (6, 9) xi by each of `stereo.geometry.CALIBRATION_ERRORS`, for a pose that
            the same cameras measured before.
    """

    transform_body_to_camera: RigidTransform
    information: FloatArray
    by_calibration: FloatArray = dataclasses.field(
        default_factory=lambda: np.zeros((6, CALIBRATION_ERRORS))
    )


@dataclasses.dataclass(frozen=True)
class SeenDiscs:
    """Markers of a body as the two cameras saw them, in the order of its CAD.

    Attributes:
        ellipses: (2, N, 5) left and right.
        covariances: (2, N, 5, 5) covariances of the ellipses.
        points: (N, 3) triangulated centres [m], left camera.
    """

    ellipses: FloatArray
    covariances: FloatArray
    points: FloatArray


@dataclasses.dataclass(frozen=True)
class BodyFit:
    """A body's pose.

    Attributes:
        transform_body_to_camera: Pose of the body in the left camera's frame.
        covariance: (6, 6) covariance of xi, rotation [rad] then translation [m], in
            ``true = from_exp_coords(xi) * transform_body_to_camera``.
        by_calibration: (6, 9) xi by each of `stereo.geometry.CALIBRATION_ERRORS`; their part of the
            covariance, which all bodies in view share.
        misfit: Squared error of the fit over its degrees of freedom; about 1.
        turn_sigma: Standard deviation of the turn about the line through the two markers that are
            farthest apart [rad].
        ellipses: (2, N, 5) what was fitted, left and right.
    """

    transform_body_to_camera: RigidTransform
    covariance: FloatArray
    by_calibration: FloatArray
    misfit: float
    turn_sigma: float
    ellipses: FloatArray


def fit_body(
    discs: SeenDiscs,
    geometry: StereoGeometry,
    cad: BodyCad,
    radius: float,
    prior: BodyPrior | None = None,
) -> BodyFit | None:
    """Fit a body's pose by maximum likelihood.

    Where the likelihood over the turn about the markers' line is wider than by its curvature, or
    has two peaks, the covariance grows by what it lacks.

    Args:
        discs: Discs as both cameras saw them.
        geometry: Geometry of the stereo pair.
        cad: Markers of the body.
        radius: Radius of the markers [m].
        prior: Prior of the pose.

    Returns:
        The fit; None if no pose faces the cameras the right way up.
    """
    problem = _Problem(discs, geometry, cad, radius, prior)
    starts, axis = _starts(discs.points, cad)
    facing = problem.allowed(starts)
    if not facing.any():
        return None
    starts = starts[facing]
    costs = np.sum(problem.residuals(starts) ** 2, axis=1)
    # The grid's points are not at the optimum of the other five; the fit of the best two is.
    order = np.argsort(costs)
    peaks = [i for i in order if costs[i] <= costs[max(i - 1, 0) : i + 2].min()][:2]
    solved = [problem.solve(starts[i]) for i in peaks]
    pose, cost, normal = min(solved, key=lambda entry: entry[1])
    # A turn from where the fit ended may lead to a better valley than the grid's.
    middle = pose[:3, :3] @ cad.points.mean(axis=0) + pose[:3, 3]
    twist = np.concatenate([axis, np.cross(middle, axis)])
    turned, costs = _turned(problem, pose, twist)
    if costs.min() < cost:
        pose, cost, normal = min(
            (pose, cost, normal), problem.solve(turned[int(np.argmin(costs))]), key=lambda e: e[1]
        )
        costs = _turned(problem, pose, twist)[1]
    if not bool(problem.allowed(pose[None])[0]):
        return None
    freedom = discs.ellipses.size - 6 + (0 if prior is None else 6)
    covariance, by_calibration = problem.uncertainty(pose, normal)
    curvature = 1.0 / float(twist @ normal @ twist)
    weights = np.exp(-0.5 * (costs - min(float(costs.min()), cost)))
    variance = float(np.sum(weights * _SCAN**2) / weights.sum())
    covariance = covariance + max(variance - curvature, 0.0) * np.outer(twist, twist)
    # A disc tilted to one side appears almost as if to the other: both count by likelihood.
    weights = [float(np.exp(-0.5 * max(entry[1] - cost, 0.0))) for entry in solved]
    for weight, (other, _, _) in zip(weights, solved, strict=True):
        if bool(problem.allowed(other[None])[0]):
            away = np.asarray(
                RigidTransform.from_matrix(other @ np.linalg.inv(pose)).as_exp_coords()
            )
            covariance = covariance + weight / (1.0 + weight) * np.outer(away, away)
    turn = float(np.sqrt(axis @ covariance[:3, :3] @ axis))
    estimate = RigidTransform.from_matrix(pose)
    return BodyFit(estimate, covariance, by_calibration, cost / freedom, turn, discs.ellipses)


class _Problem:
    """Whitened differences between what poses would show and what was seen."""

    def __init__(self, discs: SeenDiscs, geometry: StereoGeometry, cad: BodyCad, radius: float,
                 prior: BodyPrior | None) -> None:  # fmt: skip
        self._cad, self._prior = cad, prior
        root, back = np.zeros((6, 6)), np.eye(4)
        if prior is not None:
            values, vectors = np.linalg.eigh(prior.information)
            root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
            back = prior.transform_body_to_camera.inv().as_matrix()
        size = discs.ellipses.size
        self._count = size + (0 if prior is None else 6)
        # All discs share the calibration's errors, which move their centres.
        shared = np.zeros((*discs.ellipses.shape, CALIBRATION_ERRORS))
        shared[..., :2, :] = np.swapaxes(geometry.calibration_jacobian(discs.points), 0, 1)
        shared = shared.reshape(size, -1)
        total = shared @ shared.T
        for disc, own in enumerate(discs.covariances.reshape(-1, 5, 5)):
            total[5 * disc : 5 * disc + 5, 5 * disc : 5 * disc + 5] += own
        whiten = np.asarray(np.linalg.inv(np.linalg.cholesky(total)), dtype=float)
        self._shared: FloatArray = whiten @ shared
        self._terms = DiscTerms(
            np.array(cad.points, dtype=float),
            np.array(cad.normal, dtype=float),
            radius,
            tuple(map(float, (*geometry.intrinsics[2:], geometry.baseline))),
            np.ascontiguousarray(discs.ellipses),
            whiten,
            np.ascontiguousarray(back),
            np.ascontiguousarray(root),
        )

    def residuals(self, poses: FloatArray) -> FloatArray:
        """Return (P, R) of poses (P, 4, 4)."""
        rows = np.empty((len(poses), self._count))
        _write_residuals(np.ascontiguousarray(poses), self._terms, rows)
        return rows

    def uncertainty(self, pose: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the covariance (6, 6) of a solution, and its xi by the calibration's errors.

        The prior is weighted as if independent of the images; what both share of the calibration
        is counted here.

        Args:
            pose: (4, 4) solution.
            normal: (6, 6) normal equations there.
        """
        rows = self.residuals(_NUDGES @ pose)[:, : len(self._shared)]
        slopes = (rows[1:7] - rows[7:]) / (2.0 * _STEPS[:, None])
        covariance = np.asarray(np.linalg.inv(normal), dtype=float)
        by_images = -covariance @ slopes @ self._shared
        if self._prior is None:
            return covariance, by_images
        by_prior = covariance @ self._prior.information @ self._prior.by_calibration
        both = by_images @ by_prior.T
        return covariance + both + both.T, by_images + by_prior

    def allowed(self, poses: FloatArray) -> NDArray[np.bool_]:
        """Return (P,) which poses show the markers' faces, the right way up."""
        normals = poses[:, :3, :3] @ np.asarray(self._cad.normal)
        centres = poses[:, :3, :3] @ self._cad.points.mean(axis=0) + poses[:, :3, 3]
        facing = np.einsum("pi,pi->p", normals, centres) < 0.0
        if self._prior is None:
            # Rows grow downward.
            facing &= (poses[:, :3, :3] @ np.asarray(self._cad.up))[:, 1] < 0.0
        return facing

    def solve(self, start: FloatArray) -> tuple[FloatArray, float, FloatArray]:
        """Return pose (4, 4), cost and normal equations (6, 6) after damped Gauss-Newton steps."""
        pose, normal = np.array(start), np.eye(6)
        cost = _solve_pose(pose, normal, _NUDGES, _STEPS, self._terms, self._count)
        return pose, cost, normal + 1e-9 * np.eye(6)


def _starts(points: FloatArray, cad: BodyCad) -> tuple[FloatArray, FloatArray]:
    """Return poses (P, 4, 4) that lay the two farthest markers on their points, and their axis."""
    between = np.linalg.norm(cad.points[:, None] - cad.points, axis=2)
    first, second = np.unravel_index(int(np.argmax(between)), between.shape)
    axis = points[second] - points[first]
    axis /= np.linalg.norm(axis)
    along = cad.points[second] - cad.points[first]
    along = along / np.linalg.norm(along)
    normal = np.asarray(cad.normal, dtype=float)
    normal = normal - (normal @ along) * along
    across = np.cross(along, normal / np.linalg.norm(normal))
    side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    lay = (
        np.column_stack([axis, side, np.cross(axis, side)])
        @ np.column_stack([along, np.cross(across, along), across]).T
    )
    angles = np.linspace(-np.pi, np.pi, 2 * _TURNS, endpoint=False)
    turns = Rotation.from_rotvec(angles[:, None] * axis).as_matrix() @ lay
    poses = np.tile(np.eye(4), (len(angles), 1, 1))
    poses[:, :3, :3] = turns
    middle = (points[first] + points[second]) / 2.0
    poses[:, :3, 3] = middle - turns @ ((cad.points[first] + cad.points[second]) / 2.0)
    return poses, axis


def _turned(
    problem: _Problem, pose: FloatArray, twist: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return poses turned about the markers' line and their costs, infinite where not allowed."""
    poses = RigidTransform.from_exp_coords(_SCAN[:, None] * twist).as_matrix() @ pose
    costs = np.sum(problem.residuals(poses) ** 2, axis=1)
    return poses, np.where(problem.allowed(poses), costs, np.inf)


_ITERATIONS = 12
_UNSEEN = 1e6  # [px, px^2]


class DiscTerms(NamedTuple):
    """What the residuals of a body's pose are made of.

    Attributes:
        points: (N, 3) centres of the discs [m], body frame.
        face: (3,) unit normal of the discs, body frame.
        radius: Radius of the discs [m].
        eyes: fx, fy, cx, cy [px] and the baseline [m].
        ellipses: (2, N, 5) ellipses that were seen, left and right.
        whiten: (10 N, 10 N) root of the inverse of their covariance.
        back: (4, 4) from the camera to the body, by the prior.
        root: (6, 6) root of the prior's information.
    """

    points: FloatArray
    face: FloatArray
    radius: float
    eyes: tuple[float, ...]
    ellipses: FloatArray
    whiten: FloatArray
    back: FloatArray
    root: FloatArray


@numba.njit(cache=True)
def _solve_pose(
    pose: Any, normal: Any, nudges: Any, steps: Any, terms: DiscTerms, count: int
) -> float:
    """Bring a pose (4, 4) to the least squares by damped Gauss-Newton steps; return its cost.

    Pose and normal equations (6, 6) are overwritten. Cost and equations are those before the last
    step, which gains less than a millionth of the cost unless the steps have run out.
    """
    rows, ahead = np.empty((13, count)), np.empty((1, count))
    poses, trial = np.empty((13, 4, 4)), np.empty((1, 4, 4))
    step = np.empty(6)
    damping, cost = 1e-4, np.inf
    for _ in range(_ITERATIONS):
        for k in range(13):
            poses[k] = nudges[k] @ pose
        _write_residuals(poses, terms, rows)
        slopes = np.empty((6, count))
        for k in range(6):
            slopes[k] = (rows[k + 1] - rows[k + 7]) / (2.0 * steps[k])
        cost = rows[0] @ rows[0]
        normal[:] = slopes @ slopes.T
        damped = normal.copy()
        for k in range(6):
            damped[k, k] += damping * normal[k, k] + 1e-9
        step[:] = np.linalg.solve(damped, slopes @ rows[0])
        longest = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        step *= -min(1.0, 0.5 / max(longest, 1e-12))
        trial[0] = exp_twist(step) @ pose
        _write_residuals(trial, terms, ahead)
        there = ahead[0] @ ahead[0]
        if there <= cost:
            pose[:] = trial[0]
            damping *= 0.1
            if cost - there < 1e-6 * (1.0 + cost):
                break
        else:
            damping = max(damping, 1e-6) * 20.0
    return cost


@numba.njit(cache=True)
def _write_residuals(poses: Any, terms: DiscTerms, rows: Any) -> None:
    """Write whitened residuals (P, R) of poses (P, 4, 4), and those of the prior if there is room.

    The ellipses are those of `ellipses.project_discs`; a disc that is not wholly ahead
    is `_UNSEEN` off in each number.
    """
    points, normal, radius, eyes, ellipses, whiten, back, root = terms
    fx, fy, cx, cy, baseline = eyes
    count = len(points)
    apart, seen = np.empty(10 * count), np.empty(5)
    for p in range(len(poses)):
        turn, place = np.ascontiguousarray(poses[p, :3, :3]), poses[p, :3, 3]
        n = turn @ normal
        for k in range(count):
            centre = turn @ points[k] + place
            for eye in range(2):
                x, y, z = centre[0] - eye * baseline, centre[1], centre[2]
                square = radius * radius
                d00 = x * x - square * (1.0 - n[0] * n[0])
                d01 = x * y + square * n[0] * n[1]
                d02 = x * z + square * n[0] * n[2]
                d11 = y * y - square * (1.0 - n[1] * n[1])
                d12 = y * z + square * n[1] * n[2]
                d22 = z * z - square * (1.0 - n[2] * n[2])
                first = 5 * (eye * count + k)
                if not (d22 > 0.0 and z > 0.0):
                    apart[first : first + 5] = _UNSEEN
                    continue
                u, v = d02 / d22, d12 / d22
                seen[0], seen[1] = fx * u + cx, fy * v + cy
                seen[2] = fx * fx * (u * u - d00 / d22)
                seen[3] = fx * fy * (u * v - d01 / d22)
                seen[4] = fy * fy * (v * v - d11 / d22)
                apart[first : first + 5] = seen - ellipses[eye, k]
        rows[p, : 10 * count] = whiten @ apart
        if rows.shape[1] > 10 * count:
            rows[p, 10 * count :] = root @ log_twist(np.ascontiguousarray(poses[p]) @ back)
