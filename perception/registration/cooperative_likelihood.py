"""Maximum likelihood of a relative pose and shared points, when the pose may be known beforehand.

Gauss-Newton in the form of the Kalman filter, from a start that is near, with the covariance of
all points and the pose together.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import RegistrationError
from perception.registration.likelihood import innovation
from perception.registration.reprojection import KnownPoints, Pose, Sighting, linearise

FloatArray = NDArray[np.float64]

ITERATIONS = 30
LEAST_STEP = 1e-8
"""Of the pose [rad, m], and of coordinates [px], after which none is needed."""
LEAST_CHANGE = 1e-4
"""Of coordinates in standard deviations."""


@dataclasses.dataclass(frozen=True)
class RelativePose:
    """Where the second robot's left camera is, seen from the first one's.

    Attributes:
        transform_second_to_first: Takes points of the second to the first.
        covariance: (6, 6) of xi, in the first; zeros if it is known exactly.
    """

    transform_second_to_first: RigidTransform
    covariance: FloatArray

    def away(self, pose: Pose) -> FloatArray:
        """Return xi (6,) that takes another pose to this one."""
        return (self.transform_second_to_first * pose.transform().inv()).as_exp_coords()


@dataclasses.dataclass(frozen=True)
class Fit:
    """The most likely pose and points.

    Attributes:
        relative: The pose with its covariance.
        points: (N, 3) [m], first left camera.
        covariance: (3N, 3N) of all together [m^2], with the pose's error.
        cost: Squared normalised residuals.
    """

    relative: RelativePose
    points: FloatArray
    covariance: FloatArray
    cost: float


@dataclasses.dataclass(frozen=True)
class _Step:
    """What Gauss-Newton makes of one linearisation, and how certain that is.

    Attributes:
        xi: (6,) of the pose.
        coordinates: (N, 3) aimed at.
        pose_covariance: (6, 6).
        own_covariance: (N, 3, 3) of each point's coordinates if the pose were known.
        by_pose: (N, 3, 6) derivatives of the coordinates aimed at by the pose.
    """

    xi: FloatArray
    coordinates: FloatArray
    pose_covariance: FloatArray
    own_covariance: FloatArray
    by_pose: FloatArray


def descend(
    start: Pose, known: KnownPoints, sight: Sighting, prior: RelativePose | None = None
) -> Fit:
    """Fit the pose and the points.

    Args:
        start: Pose of the second camera in the first, near the best.
        known: N points as the first camera sees them, each independently.
        sight: How the second sees them.
        prior: What is known of the pose from elsewhere.

    Raises:
        RegistrationError: If the points leave the pose undetermined, or no fit is found.
    """
    pose, coordinates = start, known.coordinates
    scale = np.sqrt(np.diagonal(known.covariance, axis1=-2, axis2=-1))
    for _ in range(ITERATIONS):
        step = _newton(pose, coordinates, known, sight, prior)
        change = np.abs(step.coordinates - coordinates)
        if not (np.isfinite(change).all() and np.isfinite(step.xi).all()):
            raise RegistrationError("no fit: a point came to lie behind a camera")
        pose, coordinates = pose.moved(step.xi), step.coordinates
        settled = np.all(change <= LEAST_STEP + LEAST_CHANGE * scale)
        if settled and np.abs(step.xi).max() <= LEAST_STEP:
            break
    else:
        raise RegistrationError(f"no fit: not converged in {ITERATIONS} iterations")
    return Fit(
        RelativePose(pose.transform(), step.pose_covariance),
        known.places(coordinates),
        _joint_covariance(step, known),
        _cost(pose, coordinates, known, sight, prior),
    )


def _newton(
    pose: Pose,
    coordinates: FloatArray,
    known: KnownPoints,
    sight: Sighting,
    prior: RelativePose | None,
) -> _Step:
    look = linearise(pose, coordinates, known, sight.geometry)
    spread = innovation(look, known, sight)
    crossed = look.by_coordinates @ known.covariance
    shift = coordinates - known.coordinates
    residual = sight.image_points - look.predicted
    residual = residual + (look.by_coordinates @ shift[..., None])[..., 0]
    right = np.concatenate([look.by_pose, residual[..., None], crossed], axis=-1)
    solved = np.asarray(np.linalg.solve(spread, right), dtype=float)
    information = np.einsum("nij,nik->jk", look.by_pose, solved[..., :6])
    pull = np.einsum("nij,ni->j", look.by_pose, solved[..., 6])
    xi, covariance = _pose_step(information, pull, pose, prior)
    gain = np.swapaxes(solved[..., 7:], -1, -2)
    rest = residual - look.by_pose @ xi
    return _Step(
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
        # Rotation and translation differ in unit: scale before judging the condition.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        if not np.all(np.isfinite(scaled)) or np.linalg.cond(scaled) > 1e12:
            raise RegistrationError("the points leave the relative pose undetermined")
        covariance = np.linalg.inv(scaled) * np.outer(scale, scale)
        return covariance @ pull, np.asarray(covariance, dtype=float)
    # (I + P0 L)^-1 P0 is (P0^-1 + L)^-1, and holds for an exact pose and for a single point too.
    away = prior.away(pose)
    covariance = np.linalg.solve(np.eye(6) + prior.covariance @ information, prior.covariance)
    covariance = 0.5 * (covariance + covariance.T)
    return away + covariance @ (pull - information @ away), covariance


def _joint_covariance(step: _Step, known: KnownPoints) -> FloatArray:
    """Return (3N, 3N) of the points: what each has of its own, and the pose's error in common."""
    count = len(step.coordinates)
    lift = known.place_jacobian(known.places(step.coordinates))
    by_pose = (lift @ step.by_pose).reshape(-1, 6)
    joint = (by_pose @ step.pose_covariance @ by_pose.T).reshape(count, 3, count, 3)
    index = np.arange(count)
    joint[index, :, index, :] += lift @ step.own_covariance @ np.swapaxes(lift, -1, -2)
    joint = joint.reshape(3 * count, 3 * count)
    return 0.5 * (joint + joint.T)


def _cost(
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
