"""Errors of points and poses, and how they compare with their own covariances."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.registration.cooperative import SharedPoints


@dataclasses.dataclass(frozen=True)
class Followed:
    """A camera followed by one or more solvers.

    Attributes:
        errors: (steps,) error of the camera's position by solver [mm]; infinite where it was lost.
        nees: (steps,) normalised squared error of the single motions (ml) and of the registered
            poses (persistent), per degree of freedom.
    """

    errors: dict[str, FloatArray]
    nees: dict[str, FloatArray]


def rms(errors: FloatArray) -> float:
    """Return the r.m.s. length of errors (N, 3) [m], in mm."""
    return 1000.0 * float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def joint_nees(found: SharedPoints, truth: FloatArray, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Return the squared error of all points together over its expectation.

    Args:
        found: Triangulated points.
        truth: (N, 3) true positions of all points given, first camera frame [m].
        axes: Axes of the first camera; points chosen by their pixel err in depth alone.
    """
    error = (found.points - truth[found.inliers])[:, axes].ravel()
    rows = (3 * np.arange(len(found.points))[:, None] + np.array(axes)).ravel()
    covariance = found.covariance[np.ix_(rows, rows)]
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def single_nees(
    errors: FloatArray, covariances: FloatArray, axes: Sequence[int] = (0, 1, 2)
) -> float:
    """Return the mean squared error of points, each alone, over its expectation.

    Args:
        errors: (N, 3) errors of the points [m].
        covariances: (N, 3, 3) covariances of the points [m^2].
        axes: Axes of the first camera, as in `joint_nees`.
    """
    error = errors[:, axes]
    solved = np.linalg.solve(covariances[:, axes][:, :, axes], error[..., None])[..., 0]
    return float(np.mean(np.sum(error * solved, axis=1))) / len(axes)


def normalised_error(
    estimate: RigidTransform, truth: RigidTransform, covariance: FloatArray
) -> float:
    """Return the squared error over its covariance per degree of freedom; 1 is expected."""
    xi = (truth * estimate.inv()).as_exp_coords()
    return float(xi @ np.linalg.solve(covariance, xi)) / 6.0


def millimetres(estimate: RigidTransform, truth: RigidTransform) -> float:
    """Return the distance between the positions of two poses [mm]."""
    return 1000.0 * float(np.linalg.norm(estimate.translation - truth.translation))
