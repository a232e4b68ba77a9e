"""Camera motion from fiducials (Thesis section 3.2.5), all solvers behind one signature.

Fiducials are columns, rows and disparities of a rectified pair; frames are those of the left
camera. Wrong matches are those that do not agree on one pose with the others (`agreeing`).
Covariances of transforms are as in `perception.geometry.se3`.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import BoolArray, FloatArray
from perception.geometry.se3 import point_jacobian
from perception.registration.checks import (
    FEWEST,
    RegistrationError,
    check_strength,
    checked_map,
)
from perception.registration.closed_form import kabsch, kabsch_pose, linear, pnp, recursive
from perception.registration.likelihood import PoseSolution, solve
from perception.registration.reprojection import (
    KnownPoints,
    Pose,
    Sighting,
    descend,
    squared_distances,
)


@dataclasses.dataclass(frozen=True)
class Motion:
    """Where the camera is after a motion, seen from where it was before.

    Attributes:
        transform_after_to_before: Takes points of the left camera after the motion to that before.
        covariance: (6, 6) covariance of the transform [rad, m], in the frame before.
        inliers: (N,) whether each fiducial agrees with the pose and was used.
        chi_square: Squared normalised residuals per degree of freedom, 1 if the noise is as given;
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
        transform_camera_to_world: Pose of the left camera.
        covariance: (6, 6) covariance of the pose [rad, m], world.
        inliers: (N,) whether each fiducial agrees with the pose and was used.
        chi_square: Squared normalised residuals per degree of freedom.
    """

    transform_camera_to_world: RigidTransform
    covariance: FloatArray
    inliers: BoolArray
    chi_square: float


_CLOSED_FORM: dict[str, Callable[[Sighting, Sighting], tuple[Pose, FloatArray]]] = {
    "linear": linear,
    "recursive": recursive,
    "kabsch": kabsch,
    "pnp": pnp,
}
SOLVERS = (*_CLOSED_FORM, "ml")
"""linear (3-18), recursive (3-19), kabsch, pnp, and maximum likelihood of both views."""


def estimate_motion(
    solver: str,
    before: Sighting,
    after: Sighting,
    *,
    guess: RigidTransform | None = None,
    reject: bool = True,
    rng: np.random.Generator | None = None,
) -> Motion:
    """Estimate how the camera moved from fiducials seen before and after.

    Args:
        solver: One of `SOLVERS`.
        before: N fiducials before the motion.
        after: Sighting of these fiducials after the motion.
        guess: Rough transform from after to before, for instance from the arm's joints.
        reject: True to find and leave out wrong matches, for every solver.
        rng: Random generator of the minimal sets for that; a fixed one by default.

    Raises:
        RegistrationError: If a number is not finite, the fiducials cannot fix a motion, too few
            of them agree, or there is no such solver.
    """
    if solver not in SOLVERS:
        raise RegistrationError(f"solver {solver!r}: expected one of {', '.join(SOLVERS)}")
    first, second = before.checked("fiducials before"), after.checked("fiducials after")
    count = len(first.image_points)
    if count != len(second.image_points):
        raise RegistrationError(f"{count} fiducials before and {len(second.image_points)} after")
    for seen in (first, second):
        check_strength(seen.image_points, seen.sigma)
    inliers = np.ones(count, np.bool_)
    start = Pose.of(guess) if guess is not None else None
    solution = None
    if reject:
        generator = rng or np.random.default_rng(0)
        solution, inliers = agreeing(first.known(), second, start, generator)
        first, second = first.chosen(inliers), second.chosen(inliers)
        check_strength(second.image_points, second.sigma)
    if solver != "ml":
        pose, covariance = _CLOSED_FORM[solver](first, second)
        return Motion(pose.transform(), covariance, inliers, np.nan)
    if solution is None:
        solution = solve(start or kabsch(first, second)[0], first.known(), second)
    chi_square = _per_freedom(solution.cost, len(first.image_points))
    return Motion(solution.pose.transform(), solution.covariance, inliers, chi_square)


def register(
    map_points: ArrayLike,
    map_covariances: ArrayLike,
    sight: Sighting,
    guess: RigidTransform | None = None,
) -> Registration:
    """Localize the camera by fiducials of the map, so that errors do not accumulate.

    Args:
        map_points: (N, 3) [m], world.
        map_covariances: (N, 3, 3) if they are known independently, or (3N, 3N) [m^2].
        sight: Image points of the fiducials.
        guess: Rough transform from camera to world, for instance from the arm's joints.

    Raises:
        RegistrationError: If a number is not finite, the fiducials cannot fix a pose, or too few
            of them agree.
    """
    seen = sight.checked("image points")
    known = KnownPoints(*checked_map(map_points, map_covariances, len(seen.image_points)))
    check_strength(seen.image_points, seen.sigma)
    start = Pose.of(guess) if guess is not None else None
    solution, inliers = agreeing(known, seen, start, np.random.default_rng(0))
    check_strength(seen.image_points[inliers], seen.sigma[inliers])
    chi_square = _per_freedom(solution.cost, int(inliers.sum()))
    return Registration(solution.pose.transform(), solution.covariance, inliers, chi_square)


def _per_freedom(cost: float, count: int) -> float:
    return cost / (3 * count - 6)


GATE = 16.27
"""Of squared normalised residuals; chi-squared with 3 degrees exceeds it once in a thousand."""

LEAST_AGREEING = 0.5
"""Share of the fiducials that must agree; less may be a chance."""

_CLEARLY = 0.8  # Share of the fiducials that agree with a guess that is not doubted.
SAMPLES = 150
"""Minimal sets tried; with half the matches wrong, all have a wrong one with odds of 2e-9."""

FINALISTS = 5
WIDE = 9.0
"""By how much the gate is widened about a pose that three noisy fiducials give."""


def agreeing(
    known: KnownPoints,
    sight: Sighting,
    guess: Pose | None,
    rng: np.random.Generator,
) -> tuple[PoseSolution, BoolArray]:
    """Fit the pose to the fiducials that agree on it.

    If all agree that is the fit to all; else what agrees with a good guess, if that is most of
    them. Otherwise minimal sets propose poses, the best are fitted to all that agree with them, and
    the one that leaves the least unexplained wins.

    Args:
        known: N fiducials as known beforehand.
        sight: Image points of the fiducials.
        guess: The pose, roughly, if anything is known of it.
        rng: Draws the minimal sets.

    Returns:
        The fit and (N,) which fiducials it was made from.

    Raises:
        RegistrationError: If too few agree.
    """
    count = len(sight.image_points)
    everybody = np.ones(count, np.bool_)
    alone = _alone(known)
    start, fitted = guess or _kabsch_start(known, sight), None
    for pose in (start, _kabsch_start(known, sight)) if guess else (start,):
        fitted = _fit(pose, known, sight, everybody)
        if fitted and np.all(squared_distances(fitted.pose, alone, sight) <= GATE):
            return fitted, everybody
    best: tuple[float, PoseSolution, BoolArray] | None = None
    fitted_before: set[bytes] = set()
    if guess is not None:
        # Where few are wrong the fit to all is nearer than a rough guess.
        for pose in (guess, fitted.pose) if fitted else (guess,):
            found = _settle(pose, known, alone, sight, fitted_before)
            if found is not None and found[2].sum() >= _CLEARLY * count:
                return found[1], found[2]
            if found is not None and (best is None or found[0] < best[0]):
                best = found
    for pose in _proposals(alone, sight, guess, rng):
        found = _settle(pose, known, alone, sight, fitted_before)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise RegistrationError(
            f"of {count} fiducials no {FEWEST} agree on one motion within the noise"
        )
    _, solution, chosen = best
    if chosen.sum() < LEAST_AGREEING * count:
        raise RegistrationError(
            f"only {chosen.sum()} of {count} fiducials agree on one motion: expected at least "
            f"{math.ceil(LEAST_AGREEING * count)}"
        )
    return solution, chosen


def _fit(pose: Pose, known: KnownPoints, sight: Sighting, chosen: BoolArray) -> PoseSolution | None:
    if chosen.sum() < FEWEST:
        return None
    try:
        return solve(pose, known.chosen(chosen), sight.chosen(chosen))
    except (RegistrationError, np.linalg.LinAlgError):
        return None


def _kabsch_start(known: KnownPoints, sight: Sighting) -> Pose:
    places = known.places(known.coordinates)
    trace = np.trace(sight.point_covariances(), axis1=-2, axis2=-1)
    return kabsch_pose(places, sight.points(), 1.0 / trace)


def _proposals(
    known: KnownPoints, sight: Sighting, guess: Pose | None, rng: np.random.Generator
) -> list[Pose]:
    """Return the most promising poses of minimal sets of independent points, best first."""
    count = len(sight.image_points)
    sets = _minimal_sets(count, rng)
    places = known.places(known.coordinates)
    start = kabsch_pose(places[sets], sight.points()[sets], np.ones(sets.shape))
    if guess is not None:
        # Half of them trust the guess: three noisy points turn a closed form far.
        trusting = np.arange(len(sets)) % 2 == 0
        start = Pose(
            np.where(trusting[:, None, None], guess.rotation, start.rotation),
            np.where(trusting[:, None], guess.translation, start.translation),
        )
    drawn = KnownPoints(known.coordinates[sets], known.covariance[sets], known.geometry)
    pose = descend(start, drawn, sight.chosen(sets))
    far = np.minimum(squared_distances(pose, known, sight), WIDE * GATE).sum(axis=-1)
    order = np.argsort(far, kind="stable")[:FINALISTS]
    return [Pose(pose.rotation[i], pose.translation[i]) for i in order]


def _minimal_sets(count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return (H, 3) indices: all sets of three if they are few, else a draw."""
    if math.comb(count, 3) <= SAMPLES:
        return np.array(list(itertools.combinations(range(count), 3)))
    return np.argsort(rng.random((SAMPLES, count)), axis=1)[:, :3]


def _settle(
    pose: Pose, known: KnownPoints, alone: KnownPoints, sight: Sighting, fitted_before: set[bytes]
) -> tuple[float, PoseSolution, BoolArray] | None:
    """Fit to those that agree until these stay the same; return what is left unexplained.

    None is returned where a fit fails, and where this has come to fiducials that were fitted from
    another pose, which went on the same way; their masks are added to `fitted_before`.
    """
    chosen = squared_distances(pose, alone, sight) <= WIDE * GATE
    fitted, own = None, set[bytes]()
    for _ in range(10):
        if chosen.tobytes() in fitted_before:
            return None
        fitted = _fit(pose, known, sight, chosen)
        if fitted is None:
            return None
        own.add(chosen.tobytes())
        pose = fitted.pose
        agreed = squared_distances(pose, alone, sight) <= GATE
        if np.array_equal(agreed, chosen):
            break
        chosen = agreed
    else:
        fitted = _fit(pose, known, sight, chosen)
    fitted_before |= own
    if fitted is None:
        return None
    return fitted.cost + GATE * float(np.sum(~chosen)), fitted, chosen


def _alone(known: KnownPoints) -> KnownPoints:
    """Return the points as if each were known independently, for judging one by one.

    What moves them all rigidly is left out of a joint covariance: the pose takes it up.
    """
    if known.covariance.ndim == 3:
        return known
    places = known.places(known.coordinates)
    rigid, _ = np.linalg.qr(point_jacobian(places - places.mean(axis=0)).reshape(-1, 6))
    left = np.eye(len(rigid)) - rigid @ rigid.T
    relative = KnownPoints(known.coordinates, left @ known.covariance @ left, known.geometry)
    return KnownPoints(known.coordinates, relative.blocks(), known.geometry)
