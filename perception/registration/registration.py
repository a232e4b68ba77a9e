"""Camera motion from fiducials (Thesis section 3.2.5), all solvers behind one signature.

Fiducials are columns, rows and disparities of a rectified pair; frames are those of the left
camera. The covariance of a transform is that of xi = (rotation vector, translation) [rad, m] in
``true = RigidTransform.from_exp_coords(xi) * estimate``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import (
    RegistrationError,
    check_strength,
    checked_image_points,
    checked_map,
    checked_sigma,
)
from perception.registration.closed_form import kabsch, linear, pnp, recursive
from perception.registration.consensus import agreeing
from perception.registration.likelihood import solve
from perception.registration.reprojection import KnownPoints, Pose, Sighting
from perception.stereo.geometry import StereoGeometry

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class Motion:
    """Where the camera is after a motion, seen from where it was before.

    Attributes:
        transform_after_to_before: Takes points of the left camera after the motion to that before.
        covariance: (6, 6) of xi, in the frame before.
        inliers: (N,) which fiducials it rests on.
        chi_square: Squared normalised residuals per degree of freedom, 1 if the noise is as said;
            NaN for solvers that minimise something else.
    """

    transform_after_to_before: RigidTransform
    covariance: FloatArray
    inliers: BoolArray
    chi_square: float


@dataclasses.dataclass(frozen=True)
class Registration:
    """Where a camera is in the map.

    Attributes:
        transform_camera_to_world: Of the left camera.
        covariance: (6, 6) of xi, in the world.
        inliers: (N,) which fiducials it rests on.
        chi_square: Squared normalised residuals per degree of freedom.
    """

    transform_camera_to_world: RigidTransform
    covariance: FloatArray
    inliers: BoolArray
    chi_square: float


@dataclasses.dataclass(frozen=True)
class _Pair:
    """Two views of the same fiducials, with their triangulated points."""

    before: FloatArray
    after: FloatArray
    sigma: FloatArray
    geometry: StereoGeometry

    @property
    def points(self) -> tuple[FloatArray, FloatArray]:
        return self.geometry.points(self.before), self.geometry.points(self.after)

    @property
    def noise(self) -> tuple[FloatArray, FloatArray]:
        first, second = (self.geometry.covariance(p, self.sigma) for p in self.points)
        return first, second

    def chosen(self, chosen: BoolArray) -> _Pair:
        return _Pair(self.before[chosen], self.after[chosen], self.sigma[chosen], self.geometry)

    def known(self) -> KnownPoints:
        variances = np.eye(3) * (self.sigma**2)[..., None, :]
        return KnownPoints(self.before, variances, self.geometry)

    def sight(self) -> Sighting:
        return Sighting(self.after, self.sigma, self.geometry)


def _linear(pair: _Pair) -> tuple[Pose, FloatArray]:
    return linear(*pair.points, pair.noise)


def _recursive(pair: _Pair) -> tuple[Pose, FloatArray]:
    return recursive(*pair.points)


def _kabsch(pair: _Pair) -> tuple[Pose, FloatArray]:
    return kabsch(*pair.points, pair.noise)


def _pnp(pair: _Pair) -> tuple[Pose, FloatArray]:
    return pnp(pair.points[0], pair.after[:, :2], pair.geometry, (pair.noise[0], pair.sigma[:, :2]))


_CLOSED_FORM: dict[str, Callable[[_Pair], tuple[Pose, FloatArray]]] = {
    "linear": _linear,
    "recursive": _recursive,
    "kabsch": _kabsch,
    "pnp": _pnp,
}
SOLVERS = (*_CLOSED_FORM, "ml")
"""linear (3-18), recursive (3-19), kabsch, pnp, and maximum likelihood of both views."""


def estimate_motion(
    solver: str,
    before: ArrayLike,
    after: ArrayLike,
    geometry: StereoGeometry,
    sigma: ArrayLike,
    *,
    guess: RigidTransform | None = None,
    reject: bool = True,
    rng: np.random.Generator | None = None,
) -> Motion:
    """Tell how the camera moved from fiducials seen before and after.

    Args:
        solver: One of `SOLVERS`.
        before: (N, 3) columns, rows, disparities [px] of N fiducials before the motion.
        after: (N, 3) of the same ones after it.
        geometry: Of the cameras.
        sigma: Standard deviations of column, row and disparity [px], (3,) or (N, 3).
        guess: After to before, as the arm's joints say, if they do.
        reject: Whether wrong matches are sought and left out, for every solver.
        rng: Draws the minimal sets for that; the same ones each time by default.

    Raises:
        RegistrationError: If a number is not finite, the fiducials cannot fix a motion, too few
            of them agree, or there is no such solver.
    """
    if solver not in SOLVERS:
        raise RegistrationError(f"solver {solver!r}: expected one of {', '.join(SOLVERS)}")
    first = checked_image_points("fiducials before", before)
    second = checked_image_points("fiducials after", after)
    if first.shape != second.shape:
        raise RegistrationError(f"{len(first)} fiducials before and {len(second)} after")
    deviations = checked_sigma(sigma, len(first))
    for seen in (first, second):
        check_strength(seen, deviations)
    pair = _Pair(first, second, deviations, geometry)
    inliers = np.ones(len(first), np.bool_)
    start = Pose.of(guess) if guess is not None else None
    solution = None
    if reject:
        generator = rng or np.random.default_rng(0)
        solution, inliers = agreeing(pair.known(), pair.sight(), start, generator)
        pair = pair.chosen(inliers)
        check_strength(pair.after, pair.sigma)
    if solver != "ml":
        pose, covariance = _CLOSED_FORM[solver](pair)
        return Motion(pose.transform(), covariance, inliers, np.nan)
    if solution is None:
        begin = start or kabsch(*pair.points, pair.noise)[0]
        solution = solve(begin, pair.known(), pair.sight())
    chi_square = _per_freedom(solution.cost, len(pair.before))
    return Motion(solution.pose.transform(), solution.covariance, inliers, chi_square)


def register(
    map_points: ArrayLike,
    map_covariances: ArrayLike,
    image_points: ArrayLike,
    geometry: StereoGeometry,
    sigma: ArrayLike,
    guess: RigidTransform | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> Registration:
    """Tell where the camera is from fiducials of the map, so that errors do not accumulate.

    Args:
        map_points: (N, 3) [m], world.
        map_covariances: (N, 3, 3) if they are known independently, or (3N, 3N) [m^2].
        image_points: (N, 3) columns, rows, disparities [px] where they are seen.
        geometry: Of the cameras.
        sigma: Standard deviations of column, row and disparity [px], (3,) or (N, 3).
        guess: Camera to world, as the arm's joints say, if they do.
        rng: Draws minimal sets when matches are wrong; the same ones each time by default.

    Raises:
        RegistrationError: If a number is not finite, the fiducials cannot fix a pose, or too few
            of them agree.
    """
    seen = checked_image_points("image points", image_points)
    places, spread = checked_map(map_points, map_covariances, len(seen))
    deviations = checked_sigma(sigma, len(seen))
    check_strength(seen, deviations)
    solution, inliers = agreeing(
        KnownPoints(places, spread),
        Sighting(seen, deviations, geometry),
        Pose.of(guess) if guess is not None else None,
        rng or np.random.default_rng(0),
    )
    check_strength(seen[inliers], deviations[inliers])
    chi_square = _per_freedom(solution.cost, int(inliers.sum()))
    return Registration(solution.pose.transform(), solution.covariance, inliers, chi_square)


def _per_freedom(cost: float, count: int) -> float:
    return cost / (3 * count - 6)
