"""Maximum likelihood of a camera's pose and of the fiducials that it sees, together.

Gauss-Newton in the form of the Kalman filter, which needs no inverse of the covariance with which
the fiducials are known: they may be known exactly, and may be correlated.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from perception.registration.checks import RegistrationError
from perception.registration.reprojection import (
    KnownPoints,
    Linearised,
    Pose,
    Sighting,
    linearise,
)

FloatArray = NDArray[np.float64]

ITERATIONS = 50
HALVINGS = 12
LEAST_GAIN = 1e-6
"""Relative gain of the squared residuals by a step after which none is needed."""


@dataclasses.dataclass(frozen=True)
class Solution:
    """A fit of the pose and the fiducials.

    Attributes:
        pose: The most likely pose.
        coordinates: (N, 3) the most likely coordinates of the fiducials.
        weights: (N, 3), by which the known points' covariance took them there from their means.
        covariance: (6, 6) of the pose.
        cost: Squared normalised residuals, 3N - 6 if the model holds.
    """

    pose: Pose
    coordinates: FloatArray
    weights: FloatArray
    covariance: FloatArray
    cost: float


def solve(start: Pose, known: KnownPoints, sight: Sighting) -> Solution:
    """Fit the pose and the fiducials by Gauss-Newton with a line search.

    Args:
        start: Where to begin; all fiducials ahead.
        known: N of them.
        sight: How they appear.

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
    coordinates = known.coordinates + known.spread(weights)
    return Solution(pose, coordinates, weights, covariance, cost)


def _cost(pose: Pose, weights: FloatArray, known: KnownPoints, sight: Sighting) -> float:
    """Return the squared residuals at coordinates = mean + covariance times weights."""
    shift = known.spread(weights)
    places = known.places(known.coordinates + shift)
    seen = (places - pose.translation) @ pose.rotation
    residual = (sight.image_points - sight.geometry.project(seen)) / sight.sigma
    cost = float(np.sum(residual**2) + np.sum(weights * shift))
    return cost if np.isfinite(cost) else np.inf


def _newton(
    pose: Pose, weights: FloatArray, known: KnownPoints, sight: Sighting
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the step of the pose, the weights aimed at, and the pose's information."""
    shift = known.spread(weights)
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
    spread = innovation(look, known, sight)
    flat = right if spread.ndim == 3 else right.reshape(-1, right.shape[-1])
    return np.asarray(np.linalg.solve(spread, flat), dtype=float).reshape(right.shape)


def _solve_information(information: FloatArray, right: FloatArray) -> FloatArray:
    # Rotation and translation differ in unit: scale before judging the condition.
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    if not np.all(np.isfinite(scaled)) or np.linalg.cond(scaled) > 1e12:
        raise RegistrationError("the fiducials leave the motion undetermined")
    solved = np.asarray(np.linalg.solve(scaled, scale[:, None] * right), dtype=float)
    return scale[:, None] * solved
