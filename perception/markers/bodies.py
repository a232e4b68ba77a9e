"""Markers of card and slot: found in a stereo pair, matched with the CAD, made into poses.

Two detectors share one signature (`DETECTORS`): the thesis' tracking Hough transform and blobs with
a fitted ellipse. What they find is matched between the images and with the distances of the CAD,
which rejects what is no marker of card or slot (thesis sections 5.1 to 5.3).
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from perception.markers.blobs import detect_blobs
from perception.markers.detector_names import DETECTOR_NAMES
from perception.markers.ellipses import MarkerExpectation, Markers
from perception.markers.hough import detect_hough
from perception.markers.poses import BodyCad, BodyFit, BodyPrior, SeenDiscs, fit_body
from perception.stereo.geometry import StereoGeometry

Detector = Callable[[NDArray[Any], StereoGeometry, MarkerExpectation], Markers]

DETECTORS: Final[Mapping[str, Detector]] = MappingProxyType(
    dict(zip(DETECTOR_NAMES, (detect_hough, detect_blobs), strict=True))
)
"""The thesis' detector and one of today, by the names of the metrics."""
_MOST_TRIED = 12  # Sets of markers that are fitted, those with the best distances first.


ROW = 1.0
"""Largest difference of the rows of a marker in a pair [px]."""
SIZE = 1.35
"""Factor within which an ellipse's size must agree with its distance."""
DISTANCE = 5e-4
"""Error of a distance between two markers [m], beside thrice its deviation."""
CONTRAST = 1.6
"""Largest factor between the contrasts of a body's markers: one paint, one light."""
MISFIT = 6.0
"""Largest squared error of a pose's fit over its degrees of freedom."""


@dataclasses.dataclass(frozen=True)
class MarkerPairs:
    """Markers that both images show; P may be 0, and one marker may be in several pairs.

    Attributes:
        left: Markers of the left image, (P,).
        right: Markers of the right image, (P,).
        indices: (P, 2) indices of the markers in the left and the right image.
        points: (P, 3) triangulated centres [m], left camera.
        covariances: (P, 3, 3) [m^2], without the calibration's errors.
        by_calibration: (P, 3, 9) shift of each point by each of the errors that all points share,
            `stereo.geometry.CALIBRATION_ERRORS` [m].
    """

    left: Markers
    right: Markers
    indices: NDArray[np.intp]
    points: FloatArray
    covariances: FloatArray
    by_calibration: FloatArray


def triangulate(
    left: Markers,
    right: Markers,
    geometry: StereoGeometry,
    expected: MarkerExpectation,
) -> MarkerPairs:
    """Pair the markers of two images by row, range and size, and triangulate them.

    Args:
        left: Markers of the left image.
        right: Markers of the right image.
        geometry: Geometry of the stereo pair.
        expected: Ranges and size.
    """
    one, two = (grid.ravel() for grid in np.indices((len(left), len(right))))
    seen = np.column_stack(
        [left.centres[one], left.centres[one, 0] - right.centres[two, 0]]
    ).reshape(-1, 3)
    # Both rows measure one height, weighted by their variances.
    rows = left.centres[one, 1], right.centres[two, 1]
    variances = left.covariances[one, 1, 1], right.covariances[two, 1, 1]
    seen[:, 1] = (rows[0] * variances[1] + rows[1] * variances[0]) / (variances[0] + variances[1])
    points = geometry.points(seen)
    depths = np.nan_to_num(points[:, 2])
    shared = geometry.calibration_jacobian(np.where(depths[:, None] > 0.0, points, [0.0, 0.0, 1.0]))
    apart = variances[0] + variances[1]
    apart += np.square(shared[:, 0, 1] - shared[:, 1, 1]).sum(axis=-1)
    fits = np.abs(rows[0] - rows[1]) < ROW + 3.0 * np.sqrt(apart)
    fits &= (depths > 0.9 * expected.nearest) & (depths < 1.1 * expected.farthest)
    with np.errstate(divide="ignore"):
        across = 0.5 * expected.diameter * geometry.fy / depths
    narrow = geometry.fy / geometry.fx
    for markers, chosen in ((left, one), (right, two)):
        # The longer axis of a slanted disc is as long as that of one seen head on.
        size = np.maximum(narrow * np.sqrt(markers.ellipses[chosen, 2]), markers.axes[chosen, 0])
        slack = 1.0 + 0.5 / np.maximum(across, 1e-9)
        fits &= (size < SIZE * slack * narrow * across) & (across < SIZE * slack * size)
    one, two, points = one[fits], two[fits], points[fits]
    noise = np.zeros((len(one), 3, 3))
    noise[:, :2, :2] = left.centre_covariances[one]
    noise[:, 2, :2] = noise[:, :2, 2] = left.centre_covariances[one][:, 0]
    noise[:, 2, 2] = left.covariances[one, 0, 0] + right.covariances[two, 0, 0]
    back = np.linalg.inv(geometry.projection_jacobian(points))
    return MarkerPairs(
        _chosen(left, one),
        _chosen(right, two),
        np.column_stack([one, two]),
        points,
        back @ noise @ np.swapaxes(back, 1, 2),
        geometry.calibration_shifts(points),
    )


def find_bodies(
    pair: ImageArray,
    geometry: StereoGeometry,
    cads: Sequence[BodyCad],
    expected: MarkerExpectation,
    detector: str = "blob",
    priors: Sequence[BodyPrior | None] | None = None,
) -> tuple[BodyFit | None, ...]:
    """Return the poses of bodies whose markers a rectified pair shows.

    Args:
        pair: (2, H, W) uint8, left and right.
        geometry: Geometry of the stereo pair.
        cads: Markers of each body; distances between them distinguish the bodies.
        expected: Size, ranges and number of markers, and the images' noise.
        detector: Name in `DETECTORS`.
        priors: Priors of the bodies' poses; two markers alone leave the turn about their
            line to the shapes of the ellipses, which is rough.

    Returns:
        A fit for each body, None where it is not seen.

    Raises:
        ValueError: If there is no such detector, the pair is not two grey images of the geometry's
            size, or there are not as many priors as bodies.
    """
    if detector not in DETECTORS:
        raise ValueError(f"marker detector {detector!r}: unknown; there are {', '.join(DETECTORS)}")
    if len(pair) != 2:
        raise ValueError(f"marker images: got {len(pair)}, needs a left and a right one")
    left, right = (DETECTORS[detector](image, geometry, expected) for image in pair)
    pairs = triangulate(left, right, geometry, expected)
    return match_bodies(pairs, geometry, cads, expected, priors)


def match_bodies(
    pairs: MarkerPairs,
    geometry: StereoGeometry,
    cads: Sequence[BodyCad],
    expected: MarkerExpectation,
    priors: Sequence[BodyPrior | None] | None = None,
) -> tuple[BodyFit | None, ...]:
    """Return the poses of bodies among triangulated markers; arguments as of `find_bodies`.

    Raises:
        ValueError: If there are not as many priors as bodies.
    """
    known = [None] * len(cads) if priors is None else list(priors)
    if len(known) != len(cads):
        raise ValueError(f"priors: got {len(known)} for {len(cads)} bodies")
    fits: list[tuple[float, int, BodyFit, frozenset[tuple[int, int]]]] = []
    for body, (cad, prior) in enumerate(zip(cads, known, strict=True)):
        for chosen in _candidates(pairs, cad)[:_MOST_TRIED]:
            shades = pairs.left.contrasts[chosen], pairs.right.contrasts[chosen]
            if np.max(shades) > CONTRAST * np.min(shades):
                continue
            discs = SeenDiscs(
                np.stack([pairs.left.ellipses[chosen], pairs.right.ellipses[chosen]]),
                np.stack([pairs.left.covariances[chosen], pairs.right.covariances[chosen]]),
                pairs.points[chosen],
            )
            fit = fit_body(discs, geometry, cad, expected.diameter / 2.0, prior)
            if fit is not None and fit.misfit <= MISFIT:
                used = frozenset(
                    (side, int(index)) for side in (0, 1) for index in pairs.indices[chosen, side]
                )
                fits.append((fit.misfit, body, fit, used))
    return _together(fits, len(cads))


def _together(
    fits: list[tuple[float, int, BodyFit, frozenset[tuple[int, int]]]], count: int
) -> tuple[BodyFit | None, ...]:
    """Return the fits that place most bodies without sharing markers, the least misfit of those.

    One by one would not do: a wrong pairing may fit well by chance, and takes others' markers.
    """
    nothing = (0.0, None, frozenset[tuple[int, int]]())
    choices = [
        [nothing, *((misfit, fit, used) for misfit, body, fit, used in fits if body == which)]
        for which in range(count)
    ]
    best, score = (None,) * count, (0, 0.0)
    for chosen in itertools.product(*choices):
        used = [marker for entry in chosen for marker in entry[2]]
        if len(set(used)) < len(used):
            continue
        found = sum(entry[1] is not None for entry in chosen)
        this = (-found, sum(entry[0] for entry in chosen))
        if this < score:
            best, score = tuple(entry[1] for entry in chosen), this
    return best


def _chosen(markers: Markers, which: NDArray[np.intp]) -> Markers:
    return Markers(markers.ellipses[which], markers.covariances[which], markers.contrasts[which])


def _candidates(pairs: MarkerPairs, cad: BodyCad) -> list[list[int]]:
    """Return sets of pairs whose distances are those of the CAD, in its order, the best first."""
    between = np.linalg.norm(cad.points[:, None] - cad.points, axis=2)
    apart = np.linalg.norm(pairs.points[:, None] - pairs.points, axis=2)
    along = (pairs.points[:, None] - pairs.points) / np.maximum(apart, 1e-9)[..., None]
    variance = np.einsum("abi,aij,abj->ab", along, pairs.covariances, along)
    # Points move together by the calibration's errors; their distances feel the difference.
    moved = pairs.by_calibration[:, None] - pairs.by_calibration
    shared = np.square(np.einsum("abi,abik->abk", along, moved)).sum(axis=-1)
    allowed = DISTANCE + 3.0 * np.sqrt(variance + variance.T + shared)
    found: list[tuple[float, list[int]]] = []
    for chosen in _assignments(between, apart, allowed, []):
        grid = np.ix_(chosen, chosen)
        error = np.abs(apart[grid] - between) / allowed[grid]
        found.append((float(error.sum()), chosen))
    return [chosen for _, chosen in sorted(found, key=lambda entry: entry[0])]


def _assignments(
    between: FloatArray, apart: FloatArray, allowed: FloatArray, chosen: list[int]
) -> Iterator[list[int]]:
    marker = len(chosen)
    if marker == len(between):
        yield chosen
        return
    for point in range(len(apart)):
        gaps = (
            abs(apart[point, other] - between[marker, earlier]) <= allowed[point, other]
            for earlier, other in enumerate(chosen)
        )
        if point not in chosen and all(gaps):
            yield from _assignments(between, apart, allowed, [*chosen, point])
