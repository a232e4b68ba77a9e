"""Which fiducials agree on one pose: the wrong matches are those that do not."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from perception.geometry.se3 import point_jacobian
from perception.registration.checks import FEWEST, RegistrationError
from perception.registration.closed_form import kabsch_pose
from perception.registration.likelihood import Solution, solve
from perception.registration.reprojection import (
    KnownPoints,
    Pose,
    Sighting,
    descend,
    squared_distances,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

GATE = 16.27
"""Of squared normalised residuals; chi-squared with 3 degrees exceeds it once in a thousand."""

LEAST_AGREEING = 0.5
"""Share of the fiducials that must agree; less may be a chance."""

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
) -> tuple[Solution, BoolArray]:
    """Fit the pose to the fiducials that agree on it.

    If all agree that is the fit to all. Otherwise minimal sets propose poses, the best are fitted
    to all that agree with them, and the one that leaves the least unexplained wins.

    Args:
        known: N fiducials as known beforehand.
        sight: How they appear.
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
    start = guess or _closed_form(known, sight)
    for pose in (start, _closed_form(known, sight)) if guess else (start,):
        fitted = _fit(pose, known, sight, everybody)
        if fitted is not None and _all_agree(fitted, alone, sight):
            return fitted, everybody
    best: tuple[float, Solution, BoolArray] | None = None
    for pose in _proposals(alone, sight, guess, rng):
        found = _settle(pose, known, alone, sight)
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


def _all_agree(fitted: Solution, alone: KnownPoints, sight: Sighting) -> bool:
    return bool(np.all(squared_distances(fitted.pose, alone, sight) <= GATE))


def _fit(pose: Pose, known: KnownPoints, sight: Sighting, chosen: BoolArray) -> Solution | None:
    if chosen.sum() < FEWEST:
        return None
    try:
        return solve(pose, known.chosen(chosen), sight.chosen(chosen))
    except (RegistrationError, np.linalg.LinAlgError):
        return None


def _closed_form(known: KnownPoints, sight: Sighting) -> Pose:
    places = known.places(known.coordinates)
    seen = sight.geometry.points(sight.image_points)
    spread = sight.geometry.covariance(seen, sight.sigma)
    return kabsch_pose(places, seen, 1.0 / np.trace(spread, axis1=-2, axis2=-1))


def _proposals(
    known: KnownPoints, sight: Sighting, guess: Pose | None, rng: np.random.Generator
) -> list[Pose]:
    """Return the most promising poses of minimal sets of independent points, best first."""
    count = len(sight.image_points)
    sets = _minimal_sets(count, rng)
    places = known.places(known.coordinates)
    seen = sight.geometry.points(sight.image_points)
    start = kabsch_pose(places[sets], seen[sets], np.ones(sets.shape))
    if guess is not None:
        # Half of them trust the guess: three noisy points turn a closed form far.
        trusting = np.arange(len(sets)) % 2 == 0
        start = Pose(
            np.where(trusting[:, None, None], guess.rotation, start.rotation),
            np.where(trusting[:, None], guess.translation, start.translation),
        )
    drawn = KnownPoints(known.coordinates[sets], known.covariance[sets], known.geometry)
    pose = descend(
        start, drawn, Sighting(sight.image_points[sets], sight.sigma[sets], sight.geometry)
    )
    far = np.minimum(squared_distances(pose, known, sight), WIDE * GATE).sum(axis=-1)
    order = np.argsort(far, kind="stable")[:FINALISTS]
    return [Pose(pose.rotation[i], pose.translation[i]) for i in order]


def _minimal_sets(count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return (H, 3) indices: all sets of three if they are few, else a draw."""
    if math.comb(count, 3) <= SAMPLES:
        return np.array(list(itertools.combinations(range(count), 3)))
    return np.argsort(rng.random((SAMPLES, count)), axis=1)[:, :3]


def _settle(
    pose: Pose, known: KnownPoints, alone: KnownPoints, sight: Sighting
) -> tuple[float, Solution, BoolArray] | None:
    """Fit to those that agree until these stay the same; return what is left unexplained."""
    chosen = squared_distances(pose, alone, sight) <= WIDE * GATE
    fitted = None
    for _ in range(10):
        fitted = _fit(pose, known, sight, chosen)
        if fitted is None:
            return None
        pose = fitted.pose
        agreed = squared_distances(pose, alone, sight) <= GATE
        if np.array_equal(agreed, chosen):
            break
        chosen = agreed
    else:
        fitted = _fit(pose, known, sight, chosen)
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
