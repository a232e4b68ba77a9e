"""How far triangulated points are off, and how that compares with what they say of themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from perception.registration.cooperative import SharedPoints

FloatArray = NDArray[np.float64]


def rms(errors: FloatArray) -> float:
    """Return the r.m.s. length of errors (N, 3) [m], in mm."""
    return 1000.0 * float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def joint_nees(told: SharedPoints, truth: FloatArray, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Return the squared error of all points together over its expectation.

    Args:
        told: What was triangulated.
        truth: (N, 3) of all points that were given [m].
        axes: Of the first camera; points that are chosen by their pixel err in depth alone.
    """
    error = (told.points - truth[told.inliers])[:, axes].ravel()
    rows = (3 * np.arange(len(told.points))[:, None] + np.array(axes)).ravel()
    covariance = told.covariance[np.ix_(rows, rows)]
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def single_nees(
    errors: FloatArray, covariances: FloatArray, axes: Sequence[int] = (0, 1, 2)
) -> float:
    """Return the mean squared error of points, each alone, over its expectation.

    Args:
        errors: (N, 3) [m].
        covariances: (N, 3, 3) [m^2].
        axes: As `joint_nees`.
    """
    error = errors[:, axes]
    solved = np.linalg.solve(covariances[:, axes][:, :, axes], error[..., None])[..., 0]
    return float(np.mean(np.sum(error * solved, axis=1))) / len(axes)
