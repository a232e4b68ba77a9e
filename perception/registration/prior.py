"""A camera's pose of which something is known beforehand, and its fit to fiducials of a map.

An arm puts its camera somewhere with an error of its own in each look, and with errors that all
its looks share: of the robot's place, of how the head sits. The shared ones are parameters of the
state, as the fiducials are: taking them for new each time, one would average away what stays.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs]

from perception.geometry.se3 import point_jacobian
from perception.registration.consensus import GATE
from perception.registration.reprojection import KnownPoints, Pose, Sighting, linearise

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]

CHANCE = 1e-3
"""With which right matches are refused together, as `GATE` refuses each."""
BEHIND = 1e6
"""Error of what ought to be behind the camera [px]."""


@dataclasses.dataclass(frozen=True)
class PosePrior:
    """Where a camera is, before its image says anything.

    ``true = from_exp_coords(by_offsets @ o + e) * transform_camera_to_world`` with the shared
    offsets o, and e new in each look.

    Attributes:
        transform_camera_to_world: Of the left camera, were all offsets zero.
        covariance: (6, 6) of e, in the world.
        offsets: (K,) numbers of the shared offsets that move it, as the map gave them.
        by_offsets: (6, K) how they do.
    """

    transform_camera_to_world: RigidTransform
    covariance: FloatArray
    offsets: IndexArray = dataclasses.field(default_factory=lambda: np.zeros(0, np.intp))
    by_offsets: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((6, 0)))

    def at(self, offsets: FloatArray) -> RigidTransform:
        """Return the pose where the offsets are (K,)."""
        moved = RigidTransform.from_exp_coords(self.by_offsets @ offsets)
        return moved * self.transform_camera_to_world


@dataclasses.dataclass(frozen=True)
class Fit:
    """A pose, improved by fiducials that it improves.

    Attributes:
        transform_camera_to_world: Most likely.
        shift: (D,) of the state, pose first, from its mean.
        covariance: (D, D) of the state, the pose's about the new transform.
        believed: (N,) which fiducials were believed.
        chi_square: Squared normalised innovation per degree of freedom, 1 if all is as said; NaN
            if none was believed.
    """

    transform_camera_to_world: RigidTransform
    shift: FloatArray
    covariance: FloatArray
    believed: BoolArray
    chi_square: float


def fit(
    start: RigidTransform,
    state: FloatArray,
    rows: IndexArray,
    places: FloatArray,
    placed: FloatArray,
    sight: Sighting,
) -> Fit:
    """Fit a pose, fiducials and all that is correlated with them to a view, in one Kalman update.

    A match is wrong if the prior excludes it, or if the others do, given all that is correlated.
    Unless more than half agree, and these are as the prior says together, nothing is believed.

    It is linear about the means, and turns move fiducials as they did when these were placed: then
    a turn of everything together changes no image, as is true, and no look can tell of it. With
    derivatives taken anew at each estimate it would seem to be seen.

    Args:
        start: The pose's mean, camera to world.
        state: (D, D) covariance; the first six are xi of the pose.
        rows: (3N,) of the fiducials in it.
        places: (N, 3) their means [m].
        placed: (N, 3) what these were at first [m].
        sight: How they appear.
    """
    count = len(places)
    nothing = Fit(start, np.zeros(len(state)), state, np.zeros(count, np.bool_), np.nan)
    if not count:
        return nothing
    by_place, error = _linear(start, places, sight)
    # Of the state with the image points.
    crossed = _by_all(state[rows], state[:6], by_place, placed).T
    spread = _by_all(crossed[rows], crossed[:6], by_place, placed)
    spread = 0.5 * (spread + spread.T) + np.diag(sight.sigma.ravel() ** 2)
    believed = _agreeing(error, spread)
    if 2 * int(believed.sum()) <= count:
        return nothing
    kept, degrees = np.repeat(believed, 3), 3 * int(believed.sum())
    crossed, error, spread = crossed[:, kept], error[kept], spread[np.ix_(kept, kept)]
    weights = np.asarray(np.linalg.solve(spread, error), dtype=float)
    square = float(error @ weights)
    if square > float(chdtri(degrees, CHANCE)):
        return nothing
    shift = crossed @ weights
    covariance = state - crossed @ np.linalg.solve(spread, crossed.T)
    covariance = 0.5 * (covariance + covariance.T)
    transform = RigidTransform.from_exp_coords(shift[:6]) * start
    return Fit(transform, shift, covariance, believed, square / degrees)


def _linear(
    start: RigidTransform, places: FloatArray, sight: Sighting
) -> tuple[FloatArray, FloatArray]:
    """Return (N, 3, 3) how image points move with fiducials, and (3N,) how far they are off [px].

    What ought to be behind the camera is far off.
    """
    known = KnownPoints(places, np.zeros((len(places), 3, 3)))
    look = linearise(Pose.of(start), places, known, sight.geometry)
    behind = np.isnan(look.predicted[:, 2])
    by_place = np.where(behind[:, None, None], 0.0, look.by_coordinates)
    error = np.where(behind[:, None], BEHIND, sight.image_points - look.predicted)
    return by_place, error.ravel()


def _by_all(
    by_places: FloatArray, by_pose: FloatArray, by_place: FloatArray, placed: FloatArray
) -> FloatArray:
    """Return (3N, K) of image points, from (3N, K) of the fiducials and (6, K) of the pose."""
    moved = by_places.reshape(*placed.shape, -1) - point_jacobian(placed) @ by_pose
    return (by_place @ moved).reshape(3 * len(placed), -1)


def _agreeing(error: FloatArray, spread: FloatArray) -> BoolArray:
    """Return (N,) which matches agree: with the prior, and each with all the others.

    Each match that the prior allows is tried as the one that is right; the one with which most
    others then agree wins. Of these the worst is left out as long as the rest exclude it.

    Args:
        error: (3N,) innovation [px].
        spread: (3N, 3N) of it.
    """
    count = len(error) // 3
    chosen = np.zeros(count, np.bool_)
    own, joint = error.reshape(count, 3), spread.reshape(count, 3, count, 3).swapaxes(1, 2)
    alone: FloatArray = joint[np.arange(count), np.arange(count)]
    by_prior = _squares(alone, own) <= GATE
    for seed in np.flatnonzero(by_prior):
        gain = joint[:, seed] @ np.asarray(np.linalg.inv(alone[seed]), dtype=float)
        spared = alone - gain @ np.swapaxes(joint[:, seed], -1, -2)
        spared[seed] = alone[seed]
        agree = by_prior & (_squares(spared, own - gain @ own[seed]) <= GATE)
        if agree.sum() > chosen.sum():
            chosen = agree
    while chosen.sum() > 1:
        kept = np.repeat(chosen, 3)
        precision = np.asarray(np.linalg.inv(spread[np.ix_(kept, kept)]), dtype=float)
        pull = (precision @ error[kept]).reshape(-1, 3)
        number = np.arange(len(pull))
        blocks = precision.reshape(len(pull), 3, len(pull), 3)[number, :, number]
        far = _squares(blocks, pull)  # Of each, given all the others.
        if far.max() <= GATE:
            break
        chosen[np.flatnonzero(chosen)[far.argmax()]] = False
    return chosen


def _squares(covariances: FloatArray, errors: FloatArray) -> FloatArray:
    """Return (N,) squared normalised errors (N, 3)."""
    weighted = np.asarray(np.linalg.solve(covariances, errors[..., None]), dtype=float)[..., 0]
    return np.asarray(np.sum(errors * weighted, axis=-1), dtype=float)
