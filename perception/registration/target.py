"""Find a target by the markers on it: discs with a dark centre, placed as in its CAD.

Thesis section 3.2.2: the target gives the robots a common frame. Rings are found in both images,
triangulated, and matched with the CAD by the distances between them.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import FloatArray, ImageArray, IndexArray
from perception.stereo.geometry import StereoGeometry

_opencv: Any = cv2  # Its stub leaves contours untyped.
_FEWEST = 3  # Markers that fix a pose.
_POINTS = 24  # On an ellipse whose grey levels are taken.
LEVELS = (70, 100, 130, 160)
"""Grey levels at which dark spots are searched."""
DIAMETER = (4.0, 80.0)
"""Smallest and largest diameter of a spot [px]."""
ROUNDNESS = 0.85
"""Least area of a spot over that of its ellipse, and its inverse."""
FLATNESS = 0.4
"""Least minor over major axis of a spot."""
CONTRAST = 50.0
"""Least grey levels from a spot to the darkest place of the disc about it."""
FAR_SCALE, FAR_CONTRAST = 3, 30.0
"""How many times an image is enlarged to find the spots of a target far away, and their contrast:
small ones are blurred."""
ROW = 1.5
"""Greatest difference of the rows of a marker in a pair [px]."""
SIZE = 1.5
"""Factor within which a spot's size must agree with its distance."""
DISTANCE = 0.004
"""Greatest error of a distance between two markers [m], beside thrice its deviation."""


@dataclasses.dataclass(frozen=True)
class TargetCad:
    """Markers of a target.

    Attributes:
        points: (N, 3) centres [m], target frame; no two of their distances alike.
        radius: Radius of the bright disc [m].
        dark: Radius of the dark centre over that of the disc.
    """

    points: FloatArray
    radius: float
    dark: float

    @property
    def extent(self) -> float:
        """Greatest distance between two markers [m]."""
        return float(np.linalg.norm(self.points[:, None] - self.points, axis=2).max())


@dataclasses.dataclass(frozen=True)
class SeenTarget:
    """Markers of a target in a view.

    Attributes:
        indices: (M,) indices of the markers in the CAD.
        image_points: (M, 3) column, row, disparity [px].
    """

    indices: NDArray[np.int64]
    image_points: FloatArray


@dataclasses.dataclass(frozen=True)
class PossibleMarkers:
    """Places where markers may be, though they do not make a target.

    Attributes:
        paired: (P, 3) that both images show [m], left camera frame.
        alone: (A, 3) that one image shows, at distances by their size [m], left camera frame.
    """

    paired: FloatArray
    alone: FloatArray


def find_spots(image: ImageArray, cad: TargetCad, far: bool = False) -> FloatArray:
    """Return (N, 3) column, row and diameter of the dark centres of markers [px].

    Args:
        image: (height, width) uint8.
        cad: Proportions of a marker.
        far: Whether spots down to a third of the smallest diameter are found too, which takes three
            times as long.

    Raises:
        ValueError: If the image is empty or not grey of 8 bits.
    """
    if image.ndim != 2 or image.dtype != np.uint8 or not image.size:
        raise ValueError(f"image of shape {image.shape}, {image.dtype}: expected grey of 8 bits")
    scale, contrast = (FAR_SCALE, FAR_CONTRAST) if far else (1, CONTRAST)
    whole = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    drawn = np.asarray(whole, dtype=np.uint8)
    found: list[tuple[float, float, float]] = []
    for level in LEVELS:
        for contour in _round_contours(drawn <= level):
            spot = _spot(drawn, contour, cad, contrast)
            if spot is not None and all(np.hypot(*np.subtract(spot, o)[:2]) > 2.0 for o in found):
                found.append(spot)
    spots = np.array(found).reshape(-1, 3)
    # Pixel centres lie at whole numbers, in the enlarged image too.
    return np.column_stack([(spots[:, :2] + 0.5) / scale - 0.5, spots[:, 2] / scale])


def find_target(
    pair: ImageArray,
    geometry: StereoGeometry,
    cad: TargetCad,
    sigma: ArrayLike,
    far: bool = False,
    window: tuple[slice, slice] | None = None,
) -> SeenTarget | None:
    """Return the markers of a target in a rectified pair; None if fewer than three are seen.

    Args:
        pair: (2, height, width) uint8, left and right.
        geometry: Geometry of the stereo pair.
        cad: Markers of the target.
        sigma: (3,) standard deviations of column, row and disparity [px].
        far: Whether small markers are looked for too, as in `find_spots`.
        window: Rows and columns of both images that are searched, which takes less time; None for
            all.

    Raises:
        ValueError: If an image is empty or not grey of 8 bits.
    """
    _, _, seen = _spots_of_pair(pair, geometry, cad, far, window)
    return _matched(seen, geometry.points(seen), geometry, cad, np.asarray(sigma, dtype=float))


def possible_markers(
    pair: ImageArray,
    geometry: StereoGeometry,
    cad: TargetCad,
) -> PossibleMarkers:
    """Return where markers may be: hints of a target of which too little is in view.

    Args:
        pair: (2, height, width) uint8, left and right.
        geometry: Geometry of the stereo pair.
        cad: Markers of the target.

    Raises:
        ValueError: If an image is empty or not grey of 8 bits.
    """
    (left, right), (one, two), seen = _spots_of_pair(pair, geometry, cad)
    alone: list[FloatArray] = []
    for spots, taken, eye in ((left, one, 0.0), (right, two, geometry.baseline)):
        single = np.delete(spots, taken, axis=0)
        depths = 2.0 * cad.radius * cad.dark * geometry.fx / single[:, 2]
        disparities = geometry.fx * geometry.baseline / depths
        points = geometry.points(np.column_stack([single[:, :2], disparities]))
        alone.append(points + [eye, 0.0, 0.0])
    return PossibleMarkers(geometry.points(seen), np.concatenate(alone))


def _spots_of_pair(
    pair: ImageArray,
    geometry: StereoGeometry,
    cad: TargetCad,
    far: bool = False,
    window: tuple[slice, slice] | None = None,
) -> tuple[tuple[FloatArray, FloatArray], tuple[IndexArray, IndexArray], FloatArray]:
    """Return the spots of both images, which may be paired, and the image points of these."""
    rows, columns = window or (slice(0, None), slice(0, None))
    begin = columns.start, rows.start, 0.0
    left, right = (find_spots(image[rows, columns], cad, far) + begin for image in pair)
    one, two = (grid.ravel() for grid in np.indices((len(left), len(right))))
    seen = np.column_stack([left[one, :2], left[one, 0] - right[two, 0]])
    # A spot's size is a measure of its distance as well, which settles most wrong pairings.
    expected = 2.0 * cad.radius * cad.dark * geometry.fx / geometry.points(seen)[:, 2]
    fits = np.abs(left[one, 1] - right[two, 1]) < ROW
    for sizes in (left[one, 2], right[two, 2]):
        fits &= (sizes < SIZE * expected) & (expected < SIZE * sizes)
    return (left, right), (one[fits], two[fits]), seen[fits]


def _round_contours(dark: NDArray[np.bool_]) -> Iterator[NDArray[Any]]:
    """Yield the contours (n, 1, 2) of dark areas that may be ellipses; textures have thousands."""
    outlines, order = _opencv.findContours(
        dark.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    holes = order[0, :, 3] >= 0 if outlines else ()
    smallest, largest = DIAMETER
    for contour, hole in zip(outlines, holes, strict=True):
        # An ellipse is as long as 2 to 4 times its axis.
        if hole or not smallest <= len(contour) <= 4.0 * largest:
            continue
        _, _, width, height = cv2.boundingRect(contour)
        if not smallest - 1.0 <= max(width, height) <= largest:
            continue
        # It fills pi / 4 of its box when upright, and less when it is tilted.
        if 0.4 < _area(contour) / (width * height) < 0.95:
            yield contour


def _area(contour: NDArray[Any]) -> float:
    """Return the area within a contour (n, 1, 2), which runs through its border pixels [px^2]."""
    return cv2.contourArea(contour) + len(contour) / 2.0 + 1.0


def _spot(
    image: ImageArray, contour: NDArray[Any], cad: TargetCad, contrast: float
) -> tuple[float, float, float] | None:
    """Return centre and diameter of a dark ellipse within a bright one, None for anything else."""
    smallest, largest = DIAMETER
    if len(contour) < 2.0 * smallest:
        return None
    (column, row), axes, angle = cv2.fitEllipse(contour)
    minor, major = sorted(axes)
    # A contour runs through the middle of the border pixels.
    minor, major = minor + 1.0, major + 1.0
    if not (smallest <= major <= largest and minor >= FLATNESS * major):
        return None
    filled = _area(contour) / (np.pi / 4.0 * minor * major)
    if not ROUNDNESS <= filled <= 1.0 / ROUNDNESS:
        return None
    wide = (axes[0] + 1.0) / 2.0, (axes[1] + 1.0) / 2.0
    place, turn = (column, row), math.radians(angle)
    darkest, _, bright = _around(image, place, wide, turn, (1.35, 0.8 / cad.dark, 3))
    _, brightest, _ = _around(image, place, wide, turn, (0.0, 0.4, 2))
    if not darkest - brightest >= contrast:
        return None
    window = 1.4 * wide[0], 1.4 * wide[1]
    return (*_centroid(image, place, window, angle, bright), float(major))


@numba.njit(cache=True)
def _around(
    image: Any,
    centre: tuple[float, float],
    half_axes: tuple[float, float],
    turn: float,
    scales: tuple[float, float, int],
) -> tuple[float, float, float]:
    """Return the darkest, brightest and mean grey level on ellipses of several scales.

    NaN if one of them leaves the image. Compiled: an image has hundreds of dark spots.

    Args:
        image: (height, width) uint8.
        centre: Column and row of the ellipses' centre [px].
        half_axes: Half axes of the ellipse of scale 1 [px].
        turn: Angle of the first axis from the columns' direction [rad].
        scales: First and last scale, and how many there are.
    """
    first, last, count = scales
    cosine, sine = math.cos(turn), math.sin(turn)
    darkest, brightest, total = 255.0, 0.0, 0.0
    for k in range(count):
        scale = first + (last - first) * k / (count - 1)
        for point in range(_POINTS):
            around = 2.0 * math.pi * point / _POINTS
            along = scale * half_axes[0] * math.cos(around)
            across = scale * half_axes[1] * math.sin(around)
            column = int(np.rint(centre[0] + along * cosine - across * sine))
            row = int(np.rint(centre[1] + along * sine + across * cosine))
            if not (0 <= column < image.shape[1] and 0 <= row < image.shape[0]):
                return math.nan, math.nan, math.nan
            level = float(image[row, column])
            darkest, brightest = min(darkest, level), max(brightest, level)
            total += level
    return darkest, brightest, total / (count * _POINTS)


def _centroid(
    image: ImageArray,
    centre: tuple[float, float],
    half_axes: tuple[float, float],
    angle_deg: float,
    bright: float,
) -> tuple[float, float]:
    """Return the centre of darkness within an ellipse, to a few hundredths of a pixel."""
    height, width = image.shape
    reach = max(half_axes)
    low_row, low_column = (max(0, int(c - reach)) for c in (centre[1], centre[0]))
    high_row = min(height, int(centre[1] + reach) + 2)
    high_column = min(width, int(centre[0] + reach) + 2)
    rows, columns = np.mgrid[low_row:high_row, low_column:high_column]
    x, y, turn = columns - centre[0], rows - centre[1], np.deg2rad(angle_deg)
    along = (x * np.cos(turn) + y * np.sin(turn)) / half_axes[0]
    across = (y * np.cos(turn) - x * np.sin(turn)) / half_axes[1]
    darkness = np.maximum(bright - image[low_row:high_row, low_column:high_column], 0.0)
    # The disc's own noise would pull the centre towards the middle of the window.
    darkness[(np.hypot(along, across) > 1.0) | (darkness < 0.1 * bright)] = 0.0
    total = darkness.sum()
    return float((columns * darkness).sum() / total), float((rows * darkness).sum() / total)


def _matched(
    seen: FloatArray,
    points: FloatArray,
    geometry: StereoGeometry,
    cad: TargetCad,
    sigma: FloatArray,
) -> SeenTarget | None:
    """Return the largest set of points whose mutual distances are those of the CAD."""
    between = np.linalg.norm(cad.points[:, None] - cad.points, axis=2)
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    variances = np.trace(geometry.covariance(points, sigma), axis1=1, axis2=2)
    # Points move together by the calibration's errors; their distances feel the difference.
    moved = geometry.calibration_shifts(points)
    shared = np.square(moved[:, None] - moved).sum(axis=(-2, -1))
    allowed = DISTANCE + 3.0 * np.sqrt(variances[:, None] + variances + shared)
    nothing: list[tuple[int, int]] = []
    best = max(
        _assignments(between, apart, allowed, nothing),
        key=lambda matches: (len(matches), -_misfit(between, apart, matches)),
        default=nothing,
    )
    if len(best) < _FEWEST:
        return None
    markers, chosen = np.array(best).T
    return SeenTarget(markers, seen[chosen])


def _assignments(
    between: FloatArray, apart: FloatArray, allowed: FloatArray, matches: list[tuple[int, int]]
) -> Iterator[list[tuple[int, int]]]:
    """Yield all ways to match markers in order with points whose distances agree."""
    first = matches[-1][0] + 1 if matches else 0
    for marker in range(first, len(between)):
        for point in range(len(apart)):
            if all(
                point != other
                and abs(apart[point, other] - between[marker, earlier]) <= allowed[point, other]
                for earlier, other in matches
            ):
                longer = [*matches, (marker, point)]
                yield longer
                yield from _assignments(between, apart, allowed, longer)


def _misfit(between: FloatArray, apart: FloatArray, matches: list[tuple[int, int]]) -> float:
    markers, points = np.array(matches).T
    return float(np.abs(apart[np.ix_(points, points)] - between[np.ix_(markers, markers)]).sum())
