"""Errors of points and poses, and how they compare with their own covariances."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import ParamSpec, TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.registration.checks import RegistrationError
from perception.registration.cooperative import (
    FusedPoints,
    RelativePose,
    SharedPoints,
    fuse_views,
)
from perception.registration.reprojection import Sighting

Arguments = ParamSpec("Arguments")
Found = TypeVar("Found")


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


@dataclasses.dataclass
class Triangulated:
    """Points of one scene, triangulated in several ways.

    Attributes:
        errors: R.m.s. error of the points in the first camera by case [mm]; infinite where it
            failed.
        nees: Squared error over its covariance per degree of freedom by case; NaN where it failed.
    """

    errors: dict[str, float]
    nees: dict[str, float]

    def score_shared(
        self, case: str, found: SharedPoints, truth: FloatArray, axes: Sequence[int] = (0, 1, 2)
    ) -> None:
        """Score points triangulated together; `truth` and `axes` are as in `joint_nees`."""
        self.errors[case] = rms(found.points - truth[found.inliers])
        self.nees[case] = joint_nees(found, truth, axes)

    def score_fused(
        self, case: str, found: FusedPoints, truth: FloatArray, axes: Sequence[int] = (0, 1, 2)
    ) -> None:
        """Score points fused one by one; `truth` is (N, 3) [m], `axes` is as in `joint_nees`."""
        errors = found.points - truth
        self.errors[case] = rms(errors)
        self.nees[case] = single_nees(errors, found.covariances, axes)


def found_or_none(
    solve: Callable[Arguments, Found], *args: Arguments.args, **options: Arguments.kwargs
) -> Found | None:
    """Return what a solver finds; None if it raises a `RegistrationError`."""
    try:
        return solve(*args, **options)
    except RegistrationError:
        return None


def fuse_sightings(first: Sighting, second: Sighting, relative: RelativePose) -> FusedPoints:
    """Fuse what each robot triangulates on its own.

    Args:
        first: N points as the first robot sees them.
        second: Sighting of the same points by the second robot.
        relative: Relative pose, which these points had no part in.
    """
    points, other = (s.geometry.points(s.image_points) for s in (first, second))
    covariances = first.geometry.covariance(points, first.sigma)
    others = second.geometry.covariance(other, second.sigma)
    return fuse_views(points, covariances, other, others, relative)


def rms(errors: FloatArray) -> float:
    """Return the r.m.s. length of errors (N, 3) [m], in mm."""
    return 1000.0 * float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def joint_nees(found: SharedPoints, truth: FloatArray, axes: Sequence[int] = (0, 1, 2)) -> float:
    """Return the squared error of all points together over its expectation.

    Args:
        found: Triangulated points.
        truth: (N, 3) true positions of all points given, first camera frame [m].
        axes: Axes of the first camera that are scored; points chosen by their pixel err in depth
            alone.
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
        axes: Axes of the first camera that are scored, as in `joint_nees`.
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
