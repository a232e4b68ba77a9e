"""Maximum likelihood of a camera's pose and of the points in its view, together.

Gauss-Newton in the form of the Kalman filter, which needs no inverse of the covariance with which
the points are known. `solve` fits a pose to points that may be known exactly, and may be
correlated. `solve_relative` fits the pose of a second camera relative to a first, which may be
known beforehand, and gives the covariance of all points together.
"""

import dataclasses

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.registration.checks import RegistrationError
from perception.registration.reprojection import (
    KnownPoints,
    Linearised,
    Pose,
    Sighting,
    linearise,
)

ITERATIONS = 50
HALVINGS = 12
LEAST_GAIN = 1e-6
"""Relative gain of the squared residuals by a step after which none is needed."""


@dataclasses.dataclass(frozen=True)
class PoseSolution:
    """A fit of the pose and the fiducials.

    Attributes:
        pose: The most likely pose.
        coordinates: (N, 3) the most likely coordinates of the fiducials.
        weights: (N, 3), by which the known points' covariance took them there from their means.
        covariance: (6, 6) covariance of the pose [rad, m].
        cost: Squared normalised residuals, 3N - 6 if the model holds.
    """

    pose: Pose
    coordinates: FloatArray
    weights: FloatArray
    covariance: FloatArray
    cost: float


def solve(start: Pose, known: KnownPoints, sight: Sighting) -> PoseSolution:
    """Fit the pose and the fiducials by Gauss-Newton with a line search.

    Args:
        start: Pose to start from, with all points ahead of the camera.
        known: N points, as known beforehand.
        sight: Image points of the same points.

    Raises:
        RegistrationError: If the fiducials leave the pose undetermined, or no fit is found.
    """
    pose, weights = start, np.zeros_like(known.coordinates)
    cost = _cost(pose, weights, known, sight)
    if not np.isfinite(cost):
        raise RegistrationError("no fit: a fiducial lies behind the camera at the start")
    for _ in range(ITERATIONS):
        step, target, _ = _newton(pose, weights, known, sight)
        change, size = target - weights, 1.0
        for _ in range(HALVINGS):
            moved = pose.moved(size * step)
            other = _cost(moved, weights + size * change, known, sight)
            if other < cost:
                break
            size *= 0.5
        else:
            break  # No descent is left in floating point.
        pose, weights, gain = moved, weights + size * change, cost - other
        cost = other
        if gain <= LEAST_GAIN * (1.0 + cost):
            break
    else:
        raise RegistrationError(f"no fit: not converged in {ITERATIONS} iterations")
    _, _, information = _newton(pose, weights, known, sight)
    covariance = _solve_information(information, np.eye(6))
    coordinates = known.coordinates + known.covariance_times(weights)
    return PoseSolution(pose, coordinates, weights, covariance, cost)


def _cost(pose: Pose, weights: FloatArray, known: KnownPoints, sight: Sighting) -> float:
    """Return the squared residuals at coordinates = mean + covariance times weights."""
    shift = known.covariance_times(weights)
    places = known.places(known.coordinates + shift)
    seen = (places - pose.translation) @ pose.rotation
    residual = (sight.image_points - sight.geometry.project(seen)) / sight.sigma
    cost = float(np.sum(residual**2) + np.sum(weights * shift))
    return cost if np.isfinite(cost) else np.inf


def _newton(
    pose: Pose, weights: FloatArray, known: KnownPoints, sight: Sighting
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step of the pose, the weights aimed at, and the pose's information."""
    shift = known.covariance_times(weights)
    look = linearise(pose, known.coordinates + shift, known, sight.geometry)
    back = (look.by_coordinates @ shift[..., None])[..., 0]
    residual = sight.image_points - look.predicted + back
    right = np.concatenate([look.by_pose, residual[..., None]], axis=-1)
    solved = _solve_innovation(look, known, sight, right)
    information = np.einsum("nij,nik->jk", look.by_pose, solved[..., :6])
    pull = np.einsum("nij,ni->j", look.by_pose, solved[..., 6])
    step = _solve_information(information, pull[:, None])[:, 0]
    rest = solved[..., 6] - solved[..., :6] @ step
    target = (np.swapaxes(look.by_coordinates, -1, -2) @ rest[..., None])[..., 0]
    return step, target, information


def innovation(look: Linearised, known: KnownPoints, sight: Sighting) -> FloatArray:
    """Return S, the covariance of the residuals before the pose is fitted.

    Returns:
        (N, 3, 3) if the points are known independently, else (3N, 3N) [px^2].
    """
    by = look.by_coordinates
    if known.covariance.ndim == 3:
        return by @ known.covariance @ np.swapaxes(by, -1, -2) + sight.noise()
    count = len(by)
    split = known.covariance.reshape(count, 3, count, 3)
    dense = np.einsum("nij,njmk,mlk->niml", by, split, by, optimize=True)
    return dense.reshape(3 * count, 3 * count) + np.diag(sight.sigma.ravel() ** 2)


def _solve_innovation(
    look: Linearised, known: KnownPoints, sight: Sighting, right: FloatArray
) -> FloatArray:
    """Return S^-1 times (N, 3, k)."""
    innovation_covariance = innovation(look, known, sight)
    flat = right if innovation_covariance.ndim == 3 else right.reshape(-1, right.shape[-1])
    return np.asarray(np.linalg.solve(innovation_covariance, flat), dtype=float).reshape(
        right.shape
    )


def _solve_information(information: FloatArray, right: FloatArray) -> FloatArray:
    scale, scaled = _scaled(information)
    solved = np.asarray(np.linalg.solve(scaled, scale[:, None] * right), dtype=float)
    return scale[:, None] * solved


def _scaled(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return scales (6,) of rotation and translation, which differ in unit, and what they leave."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    if not np.all(np.isfinite(scaled)) or np.linalg.cond(scaled) > 1e12:
        raise RegistrationError("the fiducials leave the motion undetermined")
    return scale, scaled


RELATIVE_ITERATIONS = 30
LEAST_STEP = 1e-8
"""Of the pose [rad, m], and of coordinates [px], after which none is needed."""
LEAST_CHANGE = 1e-4
"""Of coordinates in standard deviations."""


@dataclasses.dataclass(frozen=True)
class RelativePose:
    """Where the second robot's left camera is, seen from the first one's.

    Attributes:
        transform_second_to_first: Takes points of the second to the first.
        covariance: (6, 6) covariance of the transform [rad, m], first camera; zeros if exact.
    """

    transform_second_to_first: RigidTransform
    covariance: FloatArray

    def away(self, pose: Pose) -> FloatArray:
        """Return xi (6,) that takes another pose to this one."""
        return (self.transform_second_to_first * pose.transform().inv()).as_exp_coords()


@dataclasses.dataclass(frozen=True)
class RelativeFit:
    """The most likely pose and points.

    Attributes:
        relative: The pose with its covariance.
        points: (N, 3) [m], first left camera.
        covariance: (3N, 3N) joint covariance of the points [m^2], with the pose's error.
        cost: Squared normalised residuals.
    """

    relative: RelativePose
    points: FloatArray
    covariance: FloatArray
    cost: float


@dataclasses.dataclass(frozen=True)
class _RelativeStep:
    """What Gauss-Newton makes of one linearisation, and how certain that is.

    Attributes:
        xi: (6,) step of the pose [rad, m].
        coordinates: (N, 3) aimed at.
        pose_covariance: (6, 6) covariance of the pose [rad, m].
        own_covariance: (N, 3, 3) of each point's coordinates if the pose were known.
        by_pose: (N, 3, 6) derivatives of the coordinates aimed at by the pose.
    """

    xi: FloatArray
    coordinates: FloatArray
    pose_covariance: FloatArray
    own_covariance: FloatArray
    by_pose: FloatArray


def solve_relative(
    start: Pose, known: KnownPoints, sight: Sighting, prior: RelativePose | None = None
) -> RelativeFit:
    """Fit the relative pose and the points.

    Args:
        start: Pose of the second camera in the first, near the best.
        known: N independent points in the first camera's view.
        sight: Image points of the same points in the second camera.
        prior: Prior of the relative pose, from other sources.

    Raises:
        RegistrationError: If the points leave the pose undetermined, or no fit is found.
    """
    pose, coordinates = start, known.coordinates
    scale = np.sqrt(np.diagonal(known.covariance, axis1=-2, axis2=-1))
    for _ in range(RELATIVE_ITERATIONS):
        step = _relative_step(pose, coordinates, known, sight, prior)
        change = np.abs(step.coordinates - coordinates)
        if not (np.isfinite(change).all() and np.isfinite(step.xi).all()):
            raise RegistrationError("no fit: a point came to lie behind a camera")
        pose, coordinates = pose.moved(step.xi), step.coordinates
        settled = np.all(change <= LEAST_STEP + LEAST_CHANGE * scale)
        if settled and np.abs(step.xi).max() <= LEAST_STEP:
            break
    else:
        raise RegistrationError(f"no fit: not converged in {RELATIVE_ITERATIONS} iterations")
    return RelativeFit(
        RelativePose(pose.transform(), step.pose_covariance),
        known.places(coordinates),
        _joint_covariance(step, known),
        _relative_cost(pose, coordinates, known, sight, prior),
    )


def _relative_step(
    pose: Pose,
    coordinates: FloatArray,
    known: KnownPoints,
    sight: Sighting,
    prior: RelativePose | None,
) -> _RelativeStep:
    look = linearise(pose, coordinates, known, sight.geometry)
    innovation_covariance = innovation(look, known, sight)
    crossed = look.by_coordinates @ known.covariance
    shift = coordinates - known.coordinates
    residual = sight.image_points - look.predicted
    residual = residual + (look.by_coordinates @ shift[..., None])[..., 0]
    right = np.concatenate([look.by_pose, residual[..., None], crossed], axis=-1)
    solved = np.asarray(np.linalg.solve(innovation_covariance, right), dtype=float)
    information = np.einsum("nij,nik->jk", look.by_pose, solved[..., :6])
    pull = np.einsum("nij,ni->j", look.by_pose, solved[..., 6])
    xi, covariance = _pose_step(information, pull, pose, prior)
    gain = np.swapaxes(solved[..., 7:], -1, -2)
    rest = residual - look.by_pose @ xi
    return _RelativeStep(
        xi,
        known.coordinates + (gain @ rest[..., None])[..., 0],
        covariance,
        known.covariance - gain @ crossed,
        -gain @ look.by_pose,
    )


def _pose_step(
    information: FloatArray, pull: FloatArray, pose: Pose, prior: RelativePose | None
) -> tuple[FloatArray, FloatArray]:
    """Return the step (6,) of the pose and its covariance (6, 6)."""
    if prior is None:
        scale, scaled = _scaled(information)
        covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
        return covariance @ pull, np.asarray(covariance, dtype=float)
    # (I + P0 L)^-1 P0 is (P0^-1 + L)^-1, and holds for an exact pose and for a single point too.
    away = prior.away(pose)
    covariance = np.linalg.solve(np.eye(6) + prior.covariance @ information, prior.covariance)
    covariance = 0.5 * (covariance + covariance.T)
    return away + covariance @ (pull - information @ away), covariance


def _joint_covariance(step: _RelativeStep, known: KnownPoints) -> FloatArray:
    """Return (3N, 3N) of the points: what each has of its own, and the pose's error in common."""
    count = len(step.coordinates)
    lift = known.place_jacobian(known.places(step.coordinates))
    by_pose = (lift @ step.by_pose).reshape(-1, 6)
    joint = (by_pose @ step.pose_covariance @ by_pose.T).reshape(count, 3, count, 3)
    index = np.arange(count)
    joint[index, :, index, :] += lift @ step.own_covariance @ np.swapaxes(lift, -1, -2)
    joint = joint.reshape(3 * count, 3 * count)
    return 0.5 * (joint + joint.T)


def _relative_cost(
    pose: Pose,
    coordinates: FloatArray,
    known: KnownPoints,
    sight: Sighting,
    prior: RelativePose | None,
) -> float:
    look = linearise(pose, coordinates, known, sight.geometry)
    residual = (sight.image_points - look.predicted) / sight.sigma
    shift = coordinates - known.coordinates
    pulled = np.linalg.solve(known.covariance, shift[..., None])[..., 0]
    cost = float(np.sum(residual**2) + np.sum(shift * pulled))
    if prior is not None:
        away = prior.away(pose)
        cost += float(away @ np.linalg.pinv(prior.covariance, hermitian=True) @ away)
    return cost
