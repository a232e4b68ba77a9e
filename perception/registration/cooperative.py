"""Points that two robots' stereo heads see, measured by both together (Thesis section 6.2 (a)).

The baseline is then what lies between the robots, a metre instead of the 38 mm of a head, and as
good as it is known: the uncertain relative pose enters every point. The first robot's left camera
is the frame. Covariances of transforms are those of xi in
``true = RigidTransform.from_exp_coords(xi) * estimate``.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import BoolArray, FloatArray
from perception.geometry.se3 import transform_points_with_covariance, transport_covariance
from perception.registration.checks import (
    RegistrationError,
    check_strength,
    checked_pose_covariance,
)
from perception.registration.likelihood import RelativeFit, RelativePose, innovation, solve_relative
from perception.registration.motion import GATE, agreeing, register
from perception.registration.reprojection import (
    KnownPoints,
    Pose,
    Sighting,
    linearise,
    squared_distances,
)


@dataclasses.dataclass(frozen=True)
class FusedPoints:
    """N points, each measured by two robots.

    Attributes:
        points: (N, 3) [m], first left camera.
        covariances: (N, 3, 3) of each alone [m^2]. The pose's error is common to all, so that they
            are correlated: see `triangulate_together`.
    """

    points: FloatArray
    covariances: FloatArray


@dataclasses.dataclass(frozen=True)
class SharedPoints(RelativeFit):
    """M points and the relative pose, as the image points of both robots make them most likely.

    Attributes:
        inliers: (N,) whether each given point is among these.
        chi_square: Squared normalised residuals per degree of freedom, 1 if the noise is as given.
    """

    inliers: BoolArray
    chi_square: float

    @property
    def covariances(self) -> FloatArray:
        """(M, 3, 3) of each point alone [m^2]."""
        return KnownPoints(self.points, self.covariance).blocks()


def relative_pose_by_target(
    first: Sighting, first_markers: ArrayLike, second: Sighting, second_markers: ArrayLike
) -> RelativePose:
    """Return the relative pose of two robots that see a target whose CAD is known.

    Unlike points of which nothing is known, its markers also fix the scale.

    Args:
        first: N markers in the first robot's view.
        first_markers: (N, 3) their places in the target [m], from its CAD.
        second: M markers in the second robot's view; they may be others.
        second_markers: (M, 3) their places in the target [m], from its CAD.

    Raises:
        RegistrationError: If either robot's markers cannot fix its pose.
    """
    one, two = (
        register(markers, np.zeros((len(sight.image_points), 3, 3)), sight)
        for sight, markers in ((first, first_markers), (second, second_markers))
    )
    back = one.transform_camera_to_world.inv()
    covariance = transport_covariance(back, one.covariance + two.covariance)
    return RelativePose(back * two.transform_camera_to_world, covariance)


def fuse_views(
    first_points: ArrayLike,
    first_covariances: ArrayLike,
    second_points: ArrayLike,
    second_covariances: ArrayLike,
    relative: RelativePose,
) -> FusedPoints:
    """Fuse what each robot triangulated on its own (eq. 3-10 as mended, with the pose by 3-20).

    The points must not have served to find the relative pose: their errors would count twice.

    Args:
        first_points: (N, 3) of the first robot [m], in its left camera.
        first_covariances: (N, 3, 3) [m^2].
        second_points: (N, 3) the same points of the second robot [m], in its left camera.
        second_covariances: (N, 3, 3) [m^2].
        relative: Pose of the second in the first.

    Raises:
        RegistrationError: If shapes differ, a number is not finite, a covariance is none, or two
            measurements are both exact.
    """
    one, own_covariance = _checked_points("first", first_points, first_covariances)
    other, other_spread = _checked_points("second", second_points, second_covariances)
    if len(one) != len(other):
        raise RegistrationError(f"{len(one)} points of the first robot, {len(other)} of the second")
    moved, carried = transform_points_with_covariance(
        relative.transform_second_to_first,
        checked_pose_covariance(relative.covariance),
        other,
        other_spread,
    )
    total, apart = own_covariance + carried, moved - one
    exact = np.flatnonzero(np.linalg.eigvalsh(total)[:, 0] <= 0.0)
    if exact.size:
        raise RegistrationError(f"point {exact[0]}: both robots say that a direction is exact")
    gain = np.swapaxes(np.linalg.solve(total, own_covariance), 1, 2)
    fused = own_covariance - gain @ own_covariance
    points = one + (gain @ apart[..., None])[..., 0]
    return FusedPoints(points, 0.5 * (fused + np.swapaxes(fused, 1, 2)))


def triangulate_together(
    first: Sighting,
    second: Sighting,
    prior: RelativePose | None = None,
    *,
    rng: np.random.Generator | None = None,
) -> SharedPoints:
    """Find the most likely points and relative pose from what both robots see of shared points.

    All points, fiducials or other, constrain the pose as well as themselves. Without a prior four
    or more are needed, wrong matches are those that do not agree with the most, and the scale comes
    from the two short baselines alone. With a prior one is enough, and wrong are those that do not
    fit it or, in the end, the others.

    Args:
        first: N points in the first robot's view.
        second: N points in the second robot's view; its cameras may be others.
        prior: The relative pose as known from elsewhere, not from these points: a target's CAD,
            other fiducials, or the robots' own motion.
        rng: Draws minimal sets when matches are wrong; the same ones each time by default.

    Raises:
        RegistrationError: If numbers are unequal or not finite, the points cannot fix the pose
            and there is no prior, or too few agree.
    """
    one, other = (
        sight.checked(f"points of the {name} robot")
        for name, sight in (("first", first), ("second", second))
    )
    count = len(one.image_points)
    if not count:
        raise RegistrationError("points of the first robot: none; at least 1 is needed")
    if count != len(other.image_points):
        raise RegistrationError(
            f"{count} points seen by the first robot, {len(other.image_points)} by the second"
        )
    known = one.known()
    if prior is None:
        for seen in (one, other):
            check_strength(seen.image_points, seen.sigma)
        solution, inliers = agreeing(known, other, None, rng or np.random.default_rng(0))
        for seen in (one.chosen(inliers), other.chosen(inliers)):
            check_strength(seen.image_points, seen.sigma)
        start = solution.pose
    else:
        prior = dataclasses.replace(prior, covariance=checked_pose_covariance(prior.covariance))
        inliers = _fits(prior, known, other)
        start = Pose.of(prior.transform_second_to_first)
    fit = solve_relative(start, known.chosen(inliers), other.chosen(inliers), prior)
    while (wrong := _worst(fit, known, other, inliers)) is not None:
        inliers[wrong] = False
        fit = solve_relative(start, known.chosen(inliers), other.chosen(inliers), prior)
    freedom = 3 * len(fit.points) - (6 if prior is None else 0)
    return SharedPoints(**vars(fit), inliers=inliers, chi_square=fit.cost / freedom)


def _fits(prior: RelativePose, known: KnownPoints, sight: Sighting) -> BoolArray:
    """Return (N,) which points, each alone, may be the same for both robots."""
    pose = Pose.of(prior.transform_second_to_first)
    look = linearise(pose, known.coordinates, known, sight.geometry)
    total = innovation(look, known, sight)
    total = total + look.by_pose @ prior.covariance @ np.swapaxes(look.by_pose, -1, -2)
    apart = sight.image_points - look.predicted
    seen = np.isfinite(total).all(axis=(-2, -1)) & np.isfinite(apart).all(axis=-1)
    fits = np.zeros(len(apart), np.bool_)
    solved = np.linalg.solve(total[seen], apart[seen][..., None])[..., 0]
    fits[seen] = np.einsum("ni,ni->n", apart[seen], solved) <= GATE
    if not fits.any():
        raise RegistrationError(
            f"none of {len(fits)} points fits the relative pose that is given: expected at least 1"
        )
    return fits


def _worst(fit: RelativeFit, known: KnownPoints, sight: Sighting, inliers: BoolArray) -> int | None:
    """Return the point that least agrees with the common pose; None if all do."""
    pose = Pose.of(fit.relative.transform_second_to_first)
    far = np.where(inliers, squared_distances(pose, known, sight), 0.0)
    worst = int(np.argmax(far))
    return worst if far[worst] > GATE and inliers.sum() > 1 else None


def _checked_points(
    name: str, points: ArrayLike, covariances: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3) points and (N, 3, 3) covariances, all finite, no variance negative."""
    places, matrices = np.asarray(points, dtype=float), np.asarray(covariances, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or matrices.shape != (len(places), 3, 3):
        raise RegistrationError(
            f"points of the {name} robot of shape {places.shape} with covariances of shape "
            f"{matrices.shape}: expected (N, 3) and (N, 3, 3)"
        )
    fine = np.isfinite(places).all(axis=1) & np.isfinite(matrices).all(axis=(1, 2))
    if not fine.all():
        wrong = np.flatnonzero(~fine)[0]
        raise RegistrationError(f"points of the {name} robot: point {wrong} is not finite")
    negative = np.flatnonzero(np.linalg.eigvalsh(matrices)[:, 0] < -1e-12 * np.trace(matrices.T))
    if negative.size:
        raise RegistrationError(
            f"points of the {name} robot: the covariance of point {negative[0]} is negative"
        )
    return places, matrices
