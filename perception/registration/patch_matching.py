"""Points of a stereo view found again by their surroundings, to a fraction of a pixel.

The motion, known roughly, predicts where a point will appear and how its surroundings will be
distorted; normalised correlation finds it nearby, and a least-squares fit of an affine patch
refines it. `track` follows fiducials from one view to the next; `match_across` finds points in
another robot's view, from far aside, where the slant of the surface matters as well.
"""

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import BoolArray, FloatArray
from perception.geometry.checks import check_numbers
from perception.registration.checks import RegistrationError
from perception.stereo.geometry import StereoGeometry
from perception.stereo.patch_fit import COLUMN_ONLY, EVERYTHING, PatchFit, fit_patch, sample_patch

FloatImage = NDArray[np.float32]

_PEAK = 3  # Radius of a peak of correlation [px]; whatever is as high beyond it is a rival.


@dataclasses.dataclass(frozen=True)
class TrackerConfig:
    """How patches are found again.

    Attributes:
        patch: Edge of the patch, odd [px].
        search: Largest distance from the prediction that is searched [px].
        disparity_search: Largest difference of the disparity from the prediction [px].
        least_correlation: Least normalised correlation of the matched patches.
        least_lead: Least lead of the best correlation over any other in the search.
        back: Farthest from its origin that the search back may end [px].
        noise_factor: Deviation of a match over that which the fit's residuals explain.
        floor: Deviation that is always there [px].
        most_sigma: Largest deviation of a match that is kept [px].
    """

    patch: int = 15
    search: int = 24
    disparity_search: int = 6
    least_correlation: float = 0.8
    least_lead: float = 0.05
    back: float = 1.5
    noise_factor: float = 1.2
    floor: float = 0.02
    most_sigma: float = 0.15

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        if self.patch < 5 or self.patch % 2 == 0:
            raise ValueError(f"tracker: patch must be odd, 5 or more: {self.patch}")
        check_numbers("tracker", self, "search", "disparity_search")

    def deviations(self, explained: FloatArray) -> FloatArray | None:
        """Return the deviations of a match [px]; None if one is too large.

        Args:
            explained: Deviations that the residuals of its fits explain [px].
        """
        sigma = np.hypot(self.noise_factor * explained, self.floor)
        return sigma if sigma.max() <= self.most_sigma else None


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Fiducials that were found again, or not.

    Attributes:
        before: (N, 3) columns, rows, disparities [px], the disparities as refined.
        after: (N, 3) in the next view; NaN where it was not found.
        sigma: (N, 3) standard deviations of columns, rows and disparities in either view [px];
            NaN where none was found.
    """

    before: FloatArray
    after: FloatArray
    sigma: FloatArray

    @property
    def found(self) -> BoolArray:
        """(N,) which were found."""
        return np.isfinite(self.after[:, 0])

    @property
    def place_sigma(self) -> FloatArray:
        """(N, 3) deviations in the next view alone, of a place that is exact in the first."""
        return self.sigma * [np.sqrt(2.0), np.sqrt(2.0), 1.0]


def track(
    before: NDArray[np.uint8],
    after: NDArray[np.uint8],
    image_points: ArrayLike,
    geometry: StereoGeometry,
    guess: RigidTransform,
    config: TrackerConfig | None = None,
) -> Tracks:
    """Find fiducials of one stereo view in the next one.

    Args:
        before: (2, H, W) left and right image.
        after: (2, H, W) the next pair.
        image_points: (N, 3) columns, rows, disparities before [px].
        geometry: Geometry of the stereo pair.
        guess: Rough transform from after to before, for instance from the arm's joints.
        config: Limits of the search.

    Raises:
        RegistrationError: If a pair has the wrong shape, or the points have.
    """
    c = config or TrackerConfig()
    shape = (2, geometry.height, geometry.width)
    seen = np.asarray(image_points, dtype=float)
    if before.shape != shape or after.shape != shape or seen.ndim != 2 or seen.shape[1] != 3:
        raise RegistrationError(
            f"tracking {seen.shape} points from {before.shape} to {after.shape}: expected (N, 3) "
            f"and pairs {shape}"
        )
    first, second = before.astype(np.float32), after.astype(np.float32)
    measured, later, sigma = seen.copy(), np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
    expected, warps = predict(seen, geometry, guess)
    for n, start in enumerate(seen):
        if not np.all(np.isfinite(expected[n])) or not np.all(np.isfinite(start)):
            continue
        right = _right_fit(first, start, c)
        left = _left_fit(first[0], second[0], start[:2], expected[n, :2], warps[n], c, c.patch)
        if left is None or right is None or not _returns(first[0], second[0], start[:2], left, c):
            continue
        other = _right_fit(second, np.array([*left.place, expected[n, 2]]), c)
        if other is None:
            continue
        own = np.hypot(right.sigma[0], other.sigma[0]) / np.sqrt(2.0)
        fitted_sigma = c.deviations(np.array([*left.sigma, own]))
        if fitted_sigma is None:
            continue
        measured[n, 2] = start[0] - right.place[0]
        later[n] = *left.place, left.place[0] - other.place[0]
        # A place is measured against the other view's only: each view bears half the variance.
        sigma[n] = fitted_sigma / [np.sqrt(2.0), np.sqrt(2.0), 1.0]
    return Tracks(measured, later, sigma)


def predict(
    image_points: FloatArray, geometry: StereoGeometry, guess: RigidTransform
) -> tuple[FloatArray, FloatArray]:
    """Return where fiducials will appear, and how their surroundings are distorted.

    Args:
        image_points: (N, 3) columns, rows, disparities before [px].
        geometry: Geometry of the stereo pair.
        guess: Rough transform from after to before.

    Returns:
        (N, 3) columns, rows, disparities [px], and (N, 2, 2) from offsets before to offsets after,
        of a surface that faces the camera before. NaN behind the camera.
    """
    points = geometry.points(image_points)
    moved = guess.apply(points, inverse=True) if len(points) else points
    ahead = np.where(moved[:, 2:] > 0.0, moved, np.nan)
    rotation = guess.rotation.as_matrix()
    by_point = geometry.projection_jacobian(ahead)[:, :2] @ rotation.T
    by_pixel = np.linalg.inv(geometry.projection_jacobian(points))[:, :, :2]
    return geometry.project(ahead), by_point @ by_pixel


def _left_fit(
    first: FloatImage,
    second: FloatImage,
    start: FloatArray,
    expected: FloatArray,
    warp: FloatArray,
    config: TrackerConfig,
    least: int,
) -> PatchFit | None:
    """Return where a patch is in another left image; None if it is not there.

    Args:
        first: Image of the patch.
        second: Image to search.
        start: (2,) the patch's centre [px].
        expected: (2,) predicted place [px].
        warp: (2, 2) predicted, from offsets in the first to offsets in the second.
        config: Reach of the search, and the correlation of a match.
        least: Least edge of what the second image shows of the search [px].
    """
    back: FloatArray = np.asarray(np.linalg.inv(warp), dtype=float)
    coarse = _search(first, second, start, expected, back, config, least)
    return None if coarse is None else _fit(first, second, start, coarse, warp, EVERYTHING, config)


def _returns(
    first: FloatImage, second: FloatImage, start: FloatArray, fit: PatchFit, config: TrackerConfig
) -> bool:
    """Return whether a search back from where a patch was found ends where it came from."""
    returned = _search(second, first, fit.place, start, fit.warp, config, config.patch)
    return returned is not None and bool(np.hypot(*(returned - start)) <= config.back)


def _fit(
    first: FloatImage,
    second: FloatImage,
    start: FloatArray,
    coarse: FloatArray,
    warp: FloatArray,
    free: BoolArray,
    config: TrackerConfig,
) -> PatchFit | None:
    """Return a fit near its start that correlates; see `fit_patch`."""
    fit = fit_patch(first, second, start, coarse, warp, config.patch // 2, free)
    if fit is None or fit.correlation < config.least_correlation:
        return None
    return fit if np.hypot(*(fit.place - coarse)) <= _PEAK else None


def _search(
    source: FloatImage,
    target: FloatImage,
    start: FloatArray,
    expected: FloatArray,
    warp_back: FloatArray,
    config: TrackerConfig,
    least: int,
) -> FloatArray | None:
    """Return the pixel of the highest correlation about a prediction; None if it has a rival.

    Args:
        source: Image of the patch.
        target: Image to search.
        start: (2,) the patch's centre [px].
        expected: (2,) predicted place [px].
        warp_back: (2, 2) from offsets in the target to offsets in the source.
        config: Reach of the search, and the lead of the best that it takes.
        least: Least edge of what the target shows of the search [px].
    """
    half, reach = config.patch // 2, config.search
    template = sample_patch(source, start, warp_back, half)
    if template is None:
        return None
    centre = np.rint(expected).astype(int)
    low = np.maximum(centre - reach - half, 0)
    high = np.minimum(centre + reach + half + 1, (target.shape[1], target.shape[0]))
    if np.any(high - low < least):
        return None
    window = np.ascontiguousarray(target[low[1] : high[1], low[0] : high[0]])
    likeness: Any = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(likeness)
    if not np.isfinite(best) or best < config.least_correlation - 0.2:
        return None
    rows, columns = (slice(max(k - _PEAK, 0), k + _PEAK + 1) for k in (row, column))
    likeness[rows, columns] = -1.0
    if float(likeness.max()) > best - config.least_lead:
        return None
    return np.array([column, row], dtype=float) + low + half


def _right_fit(pair: FloatImage, start: FloatArray, config: TrackerConfig) -> PatchFit | None:
    """Return where (column, row) of a left image is in the right one, near an expected disparity.

    Args:
        pair: (2, H, W) left and right image.
        start: (3,) column, row and expected disparity [px].
        config: Reach of the search, and the correlation of a match.
    """
    half, reach = config.patch // 2, config.disparity_search
    same = np.eye(2)
    template = sample_patch(pair[0], start[:2], same, half)
    if template is None:
        return None
    row = round(float(start[1]))
    column = round(float(start[0] - start[2]))
    # Expected beyond the picture's left edge, nothing is left to search.
    low, high = max(column - reach - half, 0), max(column + reach + half + 1, 0)
    strip = np.ascontiguousarray(pair[1][row - half : row + half + 1, low:high])
    if row < half or min(strip.shape) < config.patch:
        return None
    likeness: Any = cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)
    _, _, _, (best, _) = cv2.minMaxLoc(likeness)
    coarse = np.array([low + half + best, start[1]], dtype=float)
    fit = _fit(pair[0], pair[1], start[:2], coarse, same, COLUMN_ONLY, config)
    return fit if fit is not None and start[0] > fit.place[0] else None


_ACROSS = TrackerConfig(search=5, least_correlation=0.85, least_lead=-np.inf, noise_factor=1.4)
"""How points are found in the other robot's view: a rival far from the prediction is no matter."""
_SMOOTHING = 0.6
"""Deviation of the Gaussian that goes over images of two robots first [px]. Without it, detail near
the limit of the pixels locks the fit to whole ones."""
_LEAST_SIZE = 0.35
"""Smallest and, inverted, largest area of a patch in the other robot's view over that in the first:
beyond it one view hardly shows what the other does."""


@dataclasses.dataclass(frozen=True)
class Across:
    """Where points appear to the other robot; NaN where they were not found.

    Attributes:
        image_points: (N, 3) columns, rows, disparities [px].
        sigma: (N, 3) standard deviations if the place is exact in the first view [px].
    """

    image_points: FloatArray
    sigma: FloatArray

    @property
    def found(self) -> BoolArray:
        """(N,) which were found."""
        return np.isfinite(self.image_points[:, 0])


def surface_normals(
    points: ArrayLike,
    cloud: ArrayLike,
    radius: float = 0.025,
    fewest: int = 12,
    flatness: float = 0.03,
) -> FloatArray:
    """Return the normals of planes fitted to a cloud about points.

    Args:
        points: (N, 3) [m].
        cloud: (M, 3) [m], same frame.
        radius: Radius of a point's surroundings [m].
        fewest: Points of a plane.
        flatness: Largest variance across the plane over the least within it; an edge has more.

    Returns:
        (N, 3) towards the origin of the frame; NaN where the cloud is thin or no surface.
    """
    places, around = np.asarray(points, dtype=float), np.asarray(cloud, dtype=float)
    normals = np.full(places.shape, np.nan)
    if not len(places) or not len(around):
        return normals
    near: Any = KDTree(around).query_ball_point(places, radius)
    for n, chosen in enumerate(near):
        if len(chosen) < fewest:
            continue
        values, vectors = np.linalg.eigh(np.cov(around[chosen].T))
        if values[0] > flatness * values[1]:
            continue
        normals[n] = vectors[:, 0] * -np.sign(vectors[:, 0] @ places[n])
    return normals


def match_across(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    image_points: ArrayLike,
    normals: ArrayLike,
    geometry: StereoGeometry,
    transform_second_to_first: RigidTransform,
) -> Across:
    """Find points of the first robot's view in the second robot's.

    Args:
        first: (2, H, W) left and right image of the first robot.
        second: (2, H, W) pair of the second robot.
        image_points: (N, 3) columns, rows, disparities in the first view [px].
        normals: (N, 3) of the surface there, towards the first left camera; NaN where there is
            none.
        geometry: Geometry of the stereo pair, the same for both robots.
        transform_second_to_first: Rough relative pose, which must predict where points appear to a
            few pixels.

    Raises:
        RegistrationError: If a pair or the points have another shape.
    """
    c, second_pose = _ACROSS, transform_second_to_first
    shape = (2, geometry.height, geometry.width)
    seen, facing = np.asarray(image_points, dtype=float), np.asarray(normals, dtype=float)
    if first.shape != shape or second.shape != shape:
        raise RegistrationError(
            f"matching pairs of shapes {first.shape} and {second.shape}: expected {shape}"
        )
    if seen.ndim != 2 or seen.shape[1] != 3 or facing.shape != seen.shape:
        raise RegistrationError(
            f"matching points of shape {seen.shape} with normals {facing.shape}: expected (N, 3)"
        )
    here, there = ([_smooth(image, _SMOOTHING) for image in pair] for pair in (first, second))
    found, sigma = np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
    usable = np.isfinite(seen).all(axis=1) & np.isfinite(facing).all(axis=1) & (seen[:, 2] > 0.0)
    usable &= np.einsum("ni,ni->n", facing, geometry.points(seen)) < 0.0
    index = np.flatnonzero(usable)
    places, warps, slopes = _predict(seen[index], facing[index], geometry, second_pose)
    bends = _bends(seen[index], facing[index], geometry, second_pose, c.patch // 2)
    for n, expected, warp, slope, bend in zip(index, places, warps, slopes, bends, strict=True):
        if not (np.isfinite(expected).all() and np.isfinite(warp).all()):
            continue
        if not _LEAST_SIZE < np.linalg.det(warp) < 1.0 / _LEAST_SIZE:
            continue
        whole = c.patch + 2 * c.search
        left = _left_fit(here[0], there[0], seen[n, :2], expected[:2], warp, c, whole)
        if left is None:
            continue
        shear = np.array([[1.0 - slope[0], -slope[1]], [0.0, 1.0]])
        start = left.place - [expected[2], 0.0]
        right = _fit(there[0], there[1], left.place, start, shear, COLUMN_ONLY, c)
        if right is None:
            continue
        fitted_sigma = c.deviations(np.array([*left.sigma, right.sigma[0]]))
        disparity = left.place[0] - right.place[0]
        if fitted_sigma is None or disparity <= 0.0:
            continue
        found[n], sigma[n] = [*(left.place - bend), disparity], fitted_sigma
    return Across(found, sigma)


def _smooth(image: NDArray[np.uint8], sigma: float) -> FloatImage:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    return np.asarray(blurred, dtype=np.float32)


def _predict(
    seen: FloatArray, normals: FloatArray, geometry: StereoGeometry, second: RigidTransform
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return image points (N, 3), warps (N, 2, 2) and slopes of disparity (N, 2) in the second.

    The slopes are those by column and by row of the plane through the point.
    """
    points = geometry.points(seen)
    back = _inverted(geometry.projection_jacobian(points))
    by_pixel = back[..., :2] + back[..., 2:] * _slopes(back, normals)[:, None, :]
    there = second.apply(points, inverse=True) if len(points) else points
    there = np.where(there[:, 2:] > 0.0, there, np.nan)
    rotation = second.rotation.as_matrix()
    ahead = geometry.projection_jacobian(there)
    usable = np.isfinite(ahead).all(axis=(1, 2))
    slopes = np.full((len(points), 2), np.nan)
    slopes[usable] = _slopes(_inverted(ahead[usable]), (normals @ rotation)[usable])
    return geometry.project(there), (ahead @ rotation.T @ by_pixel)[:, :2], slopes


def _bends(
    seen: FloatArray,
    normals: FloatArray,
    geometry: StereoGeometry,
    second: RigidTransform,
    half: int,
) -> FloatArray:
    """Return (N, 2), by how much perspective shifts the mean of a patch in the second view [px].

    A fitted patch is distorted evenly; on a slanted surface the nearer half grows more, which
    would put every match some hundredths of a pixel to the same side.
    """
    steps = np.arange(-half, half + 1, dtype=float)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    middle = geometry.points(seen)
    distance = np.einsum("ni,ni->n", normals, middle)
    pixels = seen[:, None, :2] + offsets
    rays = geometry.rays(pixels)
    depths = distance[:, None] / np.einsum("nki,ni->nk", rays, normals)
    surface = rays * depths[..., None] - second.translation
    there = geometry.project(surface @ second.rotation.as_matrix())[..., :2]
    centre = geometry.project((middle - second.translation) @ second.rotation.as_matrix())
    # Offsets come in opposite pairs: what is linear in them vanishes from the mean.
    return there.mean(axis=1) - centre[:, :2]


def _inverted(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrices), dtype=float)


def _slopes(by_image: FloatArray, normals: FloatArray) -> FloatArray:
    """Return (N, 2), how the disparity changes with column and row within planes.

    Args:
        by_image: (N, 3, 3) derivatives of points by column, row and disparity.
        normals: (N, 3).
    """
    rates = (normals[:, None, :] @ by_image)[:, 0]
    return -rates[:, :2] / rates[:, 2:]
