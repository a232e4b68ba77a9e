"""A map of fiducials that stay, and a camera's pose fitted to it (Thesis section 3.2.5).

`PosePrior` is what is known of a camera's pose beforehand, `fit` improves it by fiducials of a map,
and `FiducialMap` keeps the covariance of all fiducials jointly: an update by a view takes the
pose's error for what it is, fixed by the very fiducials that it moves, and fiducials first seen
there are correlated with the rest through it. Positions are fused as in eq. 3-10 and 3-20, for all
fiducials at once.

An arm puts its camera somewhere with an error of its own in each view, and with errors that all its
views share: of the robot's place, of how the head is mounted. The shared ones are parameters of the
state, as the fiducials are: taken as new in each view they would average away, though they stay.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform
from scipy.special import chdtri  # pyright: ignore[reportMissingTypeStubs]

from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.geometry.se3 import point_jacobian
from perception.registration.checks import (
    RegistrationError,
    check_strength,
    checked_pose_covariance,
    checked_sigma,
)
from perception.registration.likelihood import PoseSolution, innovation
from perception.registration.motion import GATE, Registration, agreeing
from perception.registration.reprojection import KnownPoints, Pose, Sighting, linearise
from perception.stereo.geometry import StereoGeometry


@dataclasses.dataclass(frozen=True)
class MapObservation:
    """What a view of the map gave.

    Attributes:
        registration: Pose of the camera.
        added: (K,) numbers of the fiducials that are new.
    """

    registration: Registration
    added: IndexArray


class FiducialMap:
    """Fiducials that stay, by number.

    Args:
        geometry: Geometry of the stereo pair.
        sigma: (3,) standard deviations of column, row and disparity [px], where a view does not
            give others.

    Attributes:
        positions: (M, 3) positions of the fiducials [m], world.
        offsets: (K,) most likely values of the offsets that views share.

    Raises:
        RegistrationError: If a deviation is not positive.
    """

    def __init__(self, geometry: StereoGeometry, sigma: ArrayLike) -> None:
        self._geometry = geometry
        self._sigma = checked_sigma(sigma, 1)[0]
        self.positions: FloatArray = np.zeros((0, 3))
        self.offsets: FloatArray = np.zeros(0)
        self._placed: FloatArray = np.zeros((0, 3))  # Positions when they were added.
        self._joint: FloatArray = np.zeros((0, 0))  # Offsets first, then fiducials.

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def covariance(self) -> FloatArray:
        """(3M, 3M) of all fiducials [m^2]."""
        return self._joint[len(self.offsets) :, len(self.offsets) :]

    @property
    def offset_covariance(self) -> FloatArray:
        """(K, K) of the shared offsets."""
        return self._joint[: len(self.offsets), : len(self.offsets)]

    def covariances(self) -> FloatArray:
        """Return (M, 3, 3) [m^2], the covariance of each fiducial alone."""
        return KnownPoints(self.positions, self.covariance).blocks()

    def share(self, covariance: ArrayLike) -> IndexArray:
        """Add offsets that views will share, whose mean is zero.

        Args:
            covariance: (K, K) covariance of the offsets.

        Returns:
            (K,) their numbers, for `PosePrior`.

        Raises:
            RegistrationError: If it is not a covariance.
        """
        matrix = np.asarray(covariance, dtype=float)
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise RegistrationError(f"offsets' covariance of shape {matrix.shape}: expected (K, K)")
        if not np.isfinite(matrix).all() or np.any(np.diag(matrix) < 0.0):
            raise RegistrationError("offsets' covariance: a value is not finite, or negative")
        first, count = len(self.offsets), len(matrix)
        grown = np.zeros((len(self._joint) + count,) * 2)
        old = np.delete(np.arange(len(grown)), np.arange(first, first + count))
        grown[np.ix_(old, old)] = self._joint
        grown[first : first + count, first : first + count] = matrix
        self.offsets, self._joint = np.append(self.offsets, np.zeros(count)), grown
        return np.arange(first, first + count)

    def expected(self, prior: "PosePrior") -> tuple[RigidTransform, FloatArray]:
        """Return the expected pose of a camera, given the offsets, and its (6, 6) covariance.

        Args:
            prior: Prior of the camera's pose.

        Raises:
            RegistrationError: If it names an unknown offset, or its covariance is none.
        """
        self._check_offsets(prior)
        own = checked_pose_covariance(prior.covariance)
        offsets_covariance = self._joint[np.ix_(prior.offsets, prior.offsets)]
        shared = prior.by_offsets @ offsets_covariance @ prior.by_offsets.T
        return prior.at(self.offsets[prior.offsets]), shared + own

    def observe_from(
        self,
        prior: "PosePrior",
        numbers: Sequence[int] | IndexArray,
        image_points: ArrayLike,
        *,
        sigma: ArrayLike | None = None,
        new: ArrayLike | None = None,
        new_sigma: ArrayLike | None = None,
    ) -> MapObservation:
        """Improve a pose of which something is known, the map and the offsets, all together.

        Any number of fiducials will do, none also. Wrong matches are left out; if none is believed
        the pose is the expected one, whose error its new fiducials share.

        Args:
            prior: Prior of the camera's pose.
            numbers: (N,) numbers of the fiducials seen, each once.
            image_points: (N, 3) where they appear: columns, rows, disparities [px].
            sigma: (3,) or (N, 3) deviations of the image points [px].
            new: (K, 3) image points of new fiducials in the same view.
            new_sigma: (3,) or (K, 3) of them.

        Raises:
            RegistrationError: If a number is unknown or given twice, or a value not finite.
        """
        start, pose = self.expected(prior)
        index, sight = self._checked(numbers, image_points, sigma)
        fresh = self._sighting("new image points", new, new_sigma)
        count = len(self.offsets)
        moved = prior.by_offsets @ self._joint[prior.offsets]
        state = np.block([[pose, moved], [moved.T, self._joint]])
        fitted = fit(
            start,
            state,
            6 + count + _rows(index),
            self.positions[index],
            self._placed[index],
            sight,
        )
        self.offsets = self.offsets + fitted.shift[6 : 6 + count]
        self.positions = self.positions + fitted.shift[6 + count :].reshape(-1, 3)
        self._joint = fitted.covariance[6:, 6:]
        transform, pose = fitted.transform_camera_to_world, fitted.covariance[:6, :6]
        added = self._append(fresh, transform, pose, fitted.covariance[:6, 6:])
        return MapObservation(
            Registration(transform, pose, fitted.believed, fitted.chi_square), added
        )

    def add(
        self,
        image_points: ArrayLike,
        transform_camera_to_world: RigidTransform,
        covariance: ArrayLike | None = None,
        *,
        sigma: ArrayLike | None = None,
    ) -> IndexArray:
        """Add fiducials from a view that was not localized by this map, such as the first.

        Args:
            image_points: (N, 3) columns, rows, disparities [px].
            transform_camera_to_world: Pose of the left camera.
            covariance: (6, 6) covariance of the pose [rad, m]; zero by default: it fixes the world.
            sigma: (3,) or (N, 3) deviations of the image points [px].

        Returns:
            (N,) their numbers.

        Raises:
            RegistrationError: If a number is not finite, a disparity not positive or the pose's
                covariance none.
        """
        pose = checked_pose_covariance(np.zeros((6, 6)) if covariance is None else covariance)
        crossed = np.zeros((6, len(self._joint)))
        seen = self._sighting("image points", image_points, sigma)
        return self._append(seen, transform_camera_to_world, pose, crossed)

    def observe(
        self,
        numbers: Sequence[int] | IndexArray,
        image_points: ArrayLike,
        *,
        sigma: ArrayLike | None = None,
        new: ArrayLike | None = None,
        new_sigma: ArrayLike | None = None,
        guess: RigidTransform | None = None,
        rng: np.random.Generator | None = None,
    ) -> MapObservation:
        """Register a view to the map, improve the map by it, and add what is new.

        Wrong matches are left out of all three. If the view cannot be registered the map stays as
        it was.

        Args:
            numbers: (N,) numbers of the fiducials seen, each once.
            image_points: (N, 3) where they appear: columns, rows, disparities [px].
            sigma: (3,) or (N, 3) deviations of the image points [px].
            new: (K, 3) image points of new fiducials in the same view.
            new_sigma: (3,) or (K, 3) of them.
            guess: Rough transform from camera to world, for instance from the arm's joints.
            rng: Draws minimal sets when matches are wrong; the same ones each time by default.

        Raises:
            RegistrationError: If a number is unknown or given twice, or as `register`.
        """
        index, sight = self._checked(numbers, image_points, sigma)
        fresh = self._sighting("new image points", new, new_sigma)
        check_strength(sight.image_points, sight.sigma)
        rows = len(self.offsets) + _rows(index)
        known = KnownPoints(self.positions[index], self._joint[np.ix_(rows, rows)])
        start = Pose.of(guess) if guess is not None else None
        solution, agreed = agreeing(known, sight, start, rng or np.random.default_rng(0))
        sight = sight.chosen(agreed)
        check_strength(sight.image_points, sight.sigma)
        crossed = self._update(index[agreed], solution, known.chosen(agreed), sight)
        transform = solution.pose.transform()
        added = self._append(fresh, transform, solution.covariance, crossed)
        chi_square = solution.cost / (3 * int(agreed.sum()) - 6)
        registration = Registration(transform, solution.covariance, agreed, chi_square)
        return MapObservation(registration, added)

    def _update(
        self, index: IndexArray, solution: PoseSolution, known: KnownPoints, sight: Sighting
    ) -> FloatArray:
        """Fuse a view in; return (6, K + 3M), its pose's covariance with offsets and map."""
        count = len(self.offsets)
        rows = count + _rows(index)
        look = linearise(solution.pose, solution.coordinates, known, sight.geometry)
        by_pose = look.by_pose.reshape(-1, 6)
        inverse = np.linalg.inv(innovation(look, known, sight))
        gain = solution.covariance @ by_pose.T @ inverse
        weight = inverse - inverse @ by_pose @ gain
        # How the view's image points move with every fiducial of the map.
        blocks = self._joint[rows].reshape(-1, 3, len(self._joint))
        carried = (look.by_coordinates @ blocks).reshape(len(rows), -1)
        shift = self._joint[:, rows] @ solution.weights.ravel()
        self.offsets = self.offsets + shift[:count]
        self.positions = self.positions + shift[count:].reshape(-1, 3)
        updated = self._joint - carried.T @ weight @ carried
        self._joint = 0.5 * (updated + updated.T)
        return -gain @ carried

    def _append(
        self,
        sight: Sighting,
        transform: RigidTransform,
        pose: FloatArray,
        crossed: FloatArray,
    ) -> IndexArray:
        first, count = len(self), len(sight.image_points)
        local = sight.points()
        places = transform.apply(local) if count else local
        by_pose = point_jacobian(places).reshape(-1, 6)
        old = len(self._joint)
        grown = np.zeros((old + 3 * count, old + 3 * count))
        grown[:old, :old] = self._joint
        grown[old:, :old] = by_pose @ crossed
        grown[:old, old:] = grown[old:, :old].T
        grown[old:, old:] = by_pose @ pose @ by_pose.T
        rotation = transform.rotation.as_matrix()
        own = rotation @ sight.point_covariances() @ rotation.T
        for k in range(count):
            here = slice(old + 3 * k, old + 3 * k + 3)
            grown[here, here] += own[k]
        self.positions = np.concatenate([self.positions, places])
        self._placed = np.concatenate([self._placed, places])
        self._joint = 0.5 * (grown + grown.T)
        return np.arange(first, first + count)

    def _sighting(
        self, name: str, image_points: ArrayLike | None, sigma: ArrayLike | None
    ) -> Sighting:
        """Return checked image points with their deviations, or the map's; none for None."""
        points = np.zeros((0, 3)) if image_points is None else np.asarray(image_points, dtype=float)
        deviations = self._sigma if sigma is None else np.asarray(sigma, dtype=float)
        return Sighting(points, deviations, self._geometry).checked(name)

    def _checked(
        self, numbers: Sequence[int] | IndexArray, image_points: ArrayLike, sigma: ArrayLike | None
    ) -> tuple[IndexArray, Sighting]:
        """Return numbers of fiducials and their image points, as many of both."""
        index, sight = (
            self._checked_numbers(numbers),
            self._sighting("image points", image_points, sigma),
        )
        if len(index) != len(sight.image_points):
            raise RegistrationError(
                f"{len(index)} numbers for {len(sight.image_points)} image points"
            )
        return index, sight

    def _check_offsets(self, prior: "PosePrior") -> None:
        if prior.by_offsets.shape != (6, len(prior.offsets)):
            raise RegistrationError(
                f"by_offsets of shape {prior.by_offsets.shape}: expected (6, {len(prior.offsets)})"
            )
        unknown = [int(n) for n in prior.offsets if not 0 <= n < len(self.offsets)]
        if unknown:
            raise RegistrationError(f"offsets {unknown}: the map has {len(self.offsets)}")

    def _checked_numbers(self, numbers: Sequence[int] | IndexArray) -> IndexArray:
        index = np.asarray(numbers, dtype=np.intp)
        unknown = [int(n) for n in index if not 0 <= n < len(self)]
        if unknown:
            raise RegistrationError(f"fiducials {unknown}: the map has 0 to {len(self) - 1}")
        if len(np.unique(index)) != len(index):
            raise RegistrationError(f"fiducials {index.tolist()}: one was given twice")
        return index


def _rows(index: IndexArray) -> IndexArray:
    """Return the rows of the covariance that belong to fiducials."""
    return (3 * index[:, None] + np.arange(3)).ravel()


CHANCE = 1e-3
"""With which right matches are refused together, as `GATE` refuses each."""
BEHIND = 1e6
"""Error of what ought to be behind the camera [px]."""


@dataclasses.dataclass(frozen=True)
class PosePrior:
    """Prior of a camera's pose, before its image is used.

    ``true = from_exp_coords(by_offsets @ o + e) * transform_camera_to_world`` with the shared
    offsets o, and e new in each view.

    Attributes:
        transform_camera_to_world: Pose of the left camera, if all offsets were zero.
        covariance: (6, 6) covariance of e [rad, m], world.
        offsets: (K,) numbers of the shared offsets that move the pose, as the map gave them.
        by_offsets: (6, K) derivatives of the pose by the offsets.
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
class PriorFit:
    """A pose, improved by fiducials that it improves.

    Attributes:
        transform_camera_to_world: Most likely pose of the left camera.
        shift: (D,) change of the state, pose first, from its mean.
        covariance: (D, D) covariance of the state, the pose's about the new transform.
        believed: (N,) whether each fiducial was accepted.
        chi_square: Squared normalised innovation per degree of freedom, 1 if all is as given; NaN
            if none was accepted.
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
) -> PriorFit:
    """Fit a pose, fiducials and all that is correlated with them to a view, in one Kalman update.

    A match is wrong if the prior excludes it, or if the others do, given all that is correlated.
    Unless more than half agree, and these together agree with the prior, nothing is believed.

    It is linear about the means, and turns move fiducials as they did when these were placed: then
    a turn of everything together changes no image, as is true, and no view can observe it. With
    derivatives taken anew at each estimate it would seem to be seen.

    Args:
        start: The pose's mean, camera to world.
        state: (D, D) covariance; the first six are xi of the pose.
        rows: (3N,) rows of the fiducials in the state.
        places: (N, 3) means of the fiducials [m].
        placed: (N, 3) means of the fiducials when they were added [m].
        sight: Image points of the fiducials.
    """
    count = len(places)
    nothing = PriorFit(start, np.zeros(len(state)), state, np.zeros(count, np.bool_), np.nan)
    if not count:
        return nothing
    by_place, error = _linear(start, places, sight)
    # Of the state with the image points.
    crossed = _by_all(state[rows], state[:6], by_place, placed).T
    total = _by_all(crossed[rows], crossed[:6], by_place, placed)
    total = 0.5 * (total + total.T) + np.diag(sight.sigma.ravel() ** 2)
    believed = _agreeing(error, total)
    if 2 * int(believed.sum()) <= count:
        return nothing
    kept, degrees = np.repeat(believed, 3), 3 * int(believed.sum())
    crossed, error, total = crossed[:, kept], error[kept], total[np.ix_(kept, kept)]
    weights = np.asarray(np.linalg.solve(total, error), dtype=float)
    square = float(error @ weights)
    if square > float(chdtri(degrees, CHANCE)):
        return nothing
    shift = crossed @ weights
    covariance = state - crossed @ np.linalg.solve(total, crossed.T)
    covariance = 0.5 * (covariance + covariance.T)
    transform = RigidTransform.from_exp_coords(shift[:6]) * start
    return PriorFit(transform, shift, covariance, believed, square / degrees)


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


def _agreeing(error: FloatArray, total: FloatArray) -> BoolArray:
    """Return (N,) which matches agree: with the prior, and each with all the others.

    Each match that the prior allows is tried as the one that is right; the one with which most
    others then agree wins. Of these the worst is left out as long as the rest exclude it.

    Args:
        error: (3N,) innovation [px].
        total: (3N, 3N) covariance of the innovation [px^2].
    """
    count = len(error) // 3
    chosen = np.zeros(count, np.bool_)
    own, joint = error.reshape(count, 3), total.reshape(count, 3, count, 3).swapaxes(1, 2)
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
        precision = np.asarray(np.linalg.inv(total[np.ix_(kept, kept)]), dtype=float)
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
