"""What a registration can be made from: finite, seen by both eyes, and enough of it."""

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray

FEWEST = 4
"""Fiducials: three fix six degrees of freedom, the fourth shows whether they agree."""

LEAST_SPREAD = 5.0
"""R.m.s. distance from their best line, in standard deviations, below which points are in line."""


class RegistrationError(ValueError):
    """These fiducials cannot fix a motion."""


def checked_image_points(name: str, image_points: ArrayLike) -> FloatArray:
    """Return (N, 3) columns, rows and disparities [px] as floats.

    Args:
        name: Name of the points in errors.
        image_points: (N, 3) image points to check.

    Raises:
        RegistrationError: If the shape is another, a number is not finite, or a disparity is not
            positive.
    """
    points = np.asarray(image_points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise RegistrationError(
            f"{name} of shape {points.shape}: expected (N, 3) columns, rows and disparities"
        )
    _check_finite(name, points)
    behind = np.flatnonzero(points[:, 2] <= 0.0)
    if behind.size:
        raise RegistrationError(
            f"{name}: fiducial {behind[0]} has disparity {points[behind[0], 2]:g} px: "
            "expected more than 0"
        )
    return points


def checked_sigma(sigma: ArrayLike, count: int) -> FloatArray:
    """Return (count, 3) standard deviations of column, row and disparity [px].

    Args:
        sigma: One for all, (3,) or (count, 3).
        count: Number of fiducials.

    Raises:
        RegistrationError: If the shape is another or one is not positive.
    """
    given = np.asarray(sigma, dtype=float)
    if given.shape not in ((), (3,), (count, 3)):
        raise RegistrationError(f"sigma of shape {given.shape}: expected (3,) or ({count}, 3)")
    if not np.all((given > 0.0) & np.isfinite(given)):
        raise RegistrationError(f"sigma {given}: every deviation must be positive and finite")
    return np.broadcast_to(given, (count, 3)).copy()


def checked_map(
    points: ArrayLike, covariances: ArrayLike, count: int
) -> tuple[FloatArray, FloatArray]:
    """Return map points (count, 3) and their covariance as it was given, or (3N, 3N) if joint.

    Args:
        points: (N, 3) [m].
        covariances: (N, 3, 3) of independent points, or (3N, 3N) of all together [m^2].
        count: Number of fiducials seen.

    Raises:
        RegistrationError: If a shape is another, or a number is not finite, or a variance is
            negative.
    """
    places = np.asarray(points, dtype=float)
    matrices = np.asarray(covariances, dtype=float)
    if places.shape != (count, 3):
        raise RegistrationError(f"map points of shape {places.shape}: expected ({count}, 3)")
    if matrices.shape not in ((count, 3, 3), (3 * count, 3 * count)):
        raise RegistrationError(
            f"map covariances of shape {matrices.shape}: expected ({count}, 3, 3) or "
            f"({3 * count}, {3 * count})"
        )
    _check_finite("map points", places)
    _check_finite("map covariances", matrices)
    variances = np.diagonal(matrices, axis1=-2, axis2=-1)
    if np.any(variances < 0.0):
        raise RegistrationError("map covariances: a variance is negative")
    return places, matrices


def checked_pose_covariance(covariance: ArrayLike) -> FloatArray:
    """Return the (6, 6) covariance of a pose's xi [rad, m].

    Raises:
        RegistrationError: If the shape is another, a number is not finite, or the variance of some
            direction is negative by more than rounding.
    """
    matrix = np.asarray(covariance, dtype=float)
    if matrix.shape != (6, 6):
        raise RegistrationError(f"pose covariance of shape {matrix.shape}: expected (6, 6)")
    _check_finite("pose covariance", matrix)
    if np.linalg.eigvalsh(matrix)[0] < -1e-9 * np.trace(matrix):
        raise RegistrationError("pose covariance: it is negative in some direction")
    return matrix


def check_strength(image_points: FloatArray, sigma: FloatArray) -> None:
    """Refuse fiducials that cannot fix a motion.

    A projection keeps lines straight, so points in line in space are so in column, row and
    disparity, where the noise is known.

    Args:
        image_points: (N, 3) columns, rows, disparities [px].
        sigma: (N, 3) standard deviations [px].

    Raises:
        RegistrationError: If they are too few, coincide or are in line.
    """
    count = len(image_points)
    if count < FEWEST:
        raise RegistrationError(f"{count} fiducials: at least {FEWEST} are needed")
    white = (image_points - image_points.mean(axis=0)) / sigma.mean(axis=0)
    scatter = np.linalg.svd(white, compute_uv=False) / np.sqrt(count)
    for trouble, deviations in zip(("coincide", "are in line"), scatter):
        if deviations < LEAST_SPREAD:
            raise RegistrationError(
                f"the fiducials {trouble} to within {deviations:.1f} standard deviations, "
                f"at least {LEAST_SPREAD:g} are needed"
            )


def _check_finite(name: str, values: FloatArray) -> None:
    wrong = np.argwhere(~np.isfinite(values))
    if wrong.size:
        raise RegistrationError(f"{name}: the value at {wrong[0].tolist()} is not finite")
