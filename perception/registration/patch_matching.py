"""Points of a stereo view found again by their surroundings, to a fraction of a pixel.

The motion, known roughly, says where a point will appear and how its surroundings will be
distorted; normalised correlation finds it nearby, and a least-squares fit of an affine patch
refines it. `track` follows fiducials from one view to the next; `match_across` finds points in
another robot's view, from far aside, where the slant of the surface matters as well.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray
from perception.registration.checks import RegistrationError
from perception.stereo.geometry import StereoGeometry
from perception.stereo.patch_fit import COLUMN_ONLY, EVERYTHING, PatchFit, fit_patch, sample_patch

FloatImage = NDArray[np.float32]

_PEAK = 3  # Radius of a peak of correlation [px]; whatever is as high beyond it is a rival.


@dataclasses.dataclass(frozen=True)
class TrackerConfig:
    """How fiducials are found again.

    Attributes:
        patch: Edge of the patch, odd [px].
        search: Largest distance from the prediction that is searched [px].
        disparity_search: Largest difference of the disparity from the prediction [px].
        least_correlation: Least normalised correlation of the matched patches.
        least_lead: Least lead of the best correlation over any other in the search.
        back: Farthest from its origin that the way back may end [px].
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
        for name in ("search", "disparity_search"):
            if getattr(self, name) < 1:
                raise ValueError(f"tracker: {name} must be at least 1: {getattr(self, name)}")


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Fiducials that were found again, or not.

    Attributes:
        before: (N, 3) columns, rows, disparities [px], the disparities as refined.
        after: (N, 3) in the next view; NaN where it was not found.
        found: (N,) whether each was found.
        correlations: (N,) correlation of the patches before and after; NaN where none was found.
        sigma: (N, 3) standard deviations of columns, rows and disparities in either view [px]
            as `estimate_motion` takes them; NaN where none was found.
    """

    before: FloatArray
    after: FloatArray
    found: NDArray[np.bool_]
    correlations: FloatArray
    sigma: FloatArray

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
        guess: After to before, as the arm's joints say.
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
    measured, later = seen.copy(), np.full(seen.shape, np.nan)
    correlations, sigma = np.full(len(seen), np.nan), np.full(seen.shape, np.nan)
    expected, warps = predict(seen, geometry, guess)
    for n, start in enumerate(seen):
        if not np.all(np.isfinite(expected[n])) or not np.all(np.isfinite(start)):
            continue
        disparity = _disparity(first, start, c)
        place = _place(first[0], second[0], start[:2], expected[n, :2], warps[n], c)
        if place is None or disparity is None:
            continue
        other = _disparity(second, np.array([*place.place, expected[n, 2]]), c)
        if other is None:
            continue
        spread = np.array([*place.sigma, np.hypot(disparity[1], other[1]) / np.sqrt(2.0)])
        spread = np.hypot(c.noise_factor * spread, c.floor)
        if spread.max() > c.most_sigma:
            continue
        measured[n, 2] = disparity[0]
        later[n] = *place.place, other[0]
        correlations[n] = place.correlation
        # A place is measured against the other view's only: each view bears half the variance.
        sigma[n] = spread / [np.sqrt(2.0), np.sqrt(2.0), 1.0]
    return Tracks(measured, later, np.isfinite(correlations), correlations, sigma)


def predict(
    image_points: FloatArray, geometry: StereoGeometry, guess: RigidTransform
) -> tuple[FloatArray, FloatArray]:
    """Return where fiducials will appear, and how their surroundings are distorted.

    Args:
        image_points: (N, 3) columns, rows, disparities before [px].
        geometry: Geometry of the stereo pair.
        guess: After to before.

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


def _place(
    first: FloatImage,
    second: FloatImage,
    start: FloatArray,
    expected: FloatArray,
    warp: FloatArray,
    config: TrackerConfig,
) -> PatchFit | None:
    """Return where it is in the next left image; None if it is not there."""
    back: FloatArray = np.asarray(np.linalg.inv(warp), dtype=float)
    coarse = _search(first, second, start, expected, back, config)
    if coarse is None:
        return None
    half = config.patch // 2
    fit = fit_patch(first, second, start, coarse, warp, half, EVERYTHING)
    if fit is None or fit.correlation < config.least_correlation:
        return None
    if np.hypot(*(fit.place - coarse)) > _PEAK:
        return None
    returned = _search(second, first, fit.place, start, fit.warp, config)
    if returned is None or np.hypot(*(returned - start)) > config.back:
        return None
    return fit


def _search(
    source: FloatImage,
    target: FloatImage,
    start: FloatArray,
    expected: FloatArray,
    warp_back: FloatArray,
    config: TrackerConfig,
) -> FloatArray | None:
    """Return the pixel of the highest correlation about a prediction; None if it has a rival.

    Args:
        source: Image of the patch.
        target: Image to search.
        start: (2,) the patch's centre [px].
        expected: (2,) where it should be [px].
        warp_back: (2, 2) from offsets in the target to offsets in the source.
        config: Reach of the search, and the lead of the best that it takes.
    """
    half, reach = config.patch // 2, config.search
    template = sample_patch(source, start, warp_back, half)
    if template is None:
        return None
    centre = np.rint(expected).astype(int)
    low = np.maximum(centre - reach - half, 0)
    high = np.minimum(centre + reach + half + 1, (target.shape[1], target.shape[0]))
    if np.any(high - low < config.patch):
        return None
    window = np.ascontiguousarray(target[low[1] : high[1], low[0] : high[0]])
    likeness: Any = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    _, best, _, (column, row) = cv2.minMaxLoc(likeness)
    if not np.isfinite(best) or best < config.least_correlation - 0.2:
        return None
    rows, columns = (
        slice(max(row - _PEAK, 0), row + _PEAK + 1),
        slice(max(column - _PEAK, 0), column + _PEAK + 1),
    )
    likeness[rows, columns] = -1.0
    if float(likeness.max()) > best - config.least_lead:
        return None
    return np.array([column, row], dtype=float) + low + half


def _disparity(
    pair: FloatImage, start: FloatArray, config: TrackerConfig
) -> tuple[float, float] | None:
    """Return disparity and its deviation at (column, row), near an expected one; None if none."""
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
    if row < half or strip.shape[0] < config.patch or strip.shape[1] < config.patch:
        return None
    likeness: Any = cv2.matchTemplate(strip, template, cv2.TM_CCOEFF_NORMED)
    _, _, _, (best, _) = cv2.minMaxLoc(likeness)
    coarse = np.array([low + half + best, start[1]], dtype=float)
    fit = fit_patch(pair[0], pair[1], start[:2], coarse, same, half, COLUMN_ONLY)
    if fit is None or fit.correlation < config.least_correlation:
        return None
    disparity = float(start[0] - fit.place[0])
    if abs(fit.place[0] - coarse[0]) > _PEAK or disparity <= 0.0:
        return None
    return disparity, float(fit.sigma[0])


@dataclasses.dataclass(frozen=True)
class AcrossConfig:
    """How points are found in the other robot's view.

    Attributes:
        patch: Edge of the patch, odd [px].
        smoothing: Deviation of the Gaussian that goes over all images first [px]. Without it,
            detail near the limit of the pixels locks the fit to whole ones.
        search: Largest distance from the prediction that is searched [px].
        least_correlation: Least normalised correlation of the matched patches.
        least_size: Smallest and, inverted, largest area of a patch in the other view over that in
            the first: beyond it one view hardly sees what the other does.
        noise_factor: Deviation of a match over that which the fit's residuals explain.
        floor: Deviation that is always there [px].
        most_sigma: Largest deviation of a match that is kept [px].
    """

    patch: int = 15
    smoothing: float = 0.6
    search: int = 5
    least_correlation: float = 0.85
    least_size: float = 0.35
    noise_factor: float = 1.4
    floor: float = 0.02
    most_sigma: float = 0.15

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        if self.patch < 5 or self.patch % 2 == 0:
            raise ValueError(f"matching across: patch must be odd, 5 or more: {self.patch}")
        if not 0.0 < self.smoothing <= 5.0:
            raise ValueError(f"matching across: smoothing must be 0 to 5 px: {self.smoothing}")
        if self.search < 1:
            raise ValueError(f"matching across: search must be at least 1: {self.search}")
        if not 0.0 < self.least_size < 1.0:
            raise ValueError(f"matching across: least_size must be in 0 to 1: {self.least_size}")


@dataclasses.dataclass(frozen=True)
class Across:
    """Where points appear to the other robot; NaN where they were not found.

    Attributes:
        image_points: (N, 3) columns, rows, disparities [px].
        sigma: (N, 3) standard deviations, as of a place that is exact in the first view [px].
        correlations: (N,) correlation of the patches in the two left images.
    """

    image_points: FloatArray
    sigma: FloatArray
    correlations: FloatArray

    @property
    def found(self) -> NDArray[np.bool_]:
        """(N,) which were found."""
        return np.isfinite(self.correlations)


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
    config: AcrossConfig | None = None,
) -> Across:
    """Find points of the first robot's view in the second robot's.

    Args:
        first: (2, H, W) left and right image of the first robot.
        second: (2, H, W) pair of the second robot.
        image_points: (N, 3) columns, rows, disparities in the first view [px].
        normals: (N, 3) of the surface there, towards the first left camera; NaN where there is
            none.
        geometry: Geometry of the stereo pair, the same for both robots.
        transform_second_to_first: Roughly: where points appear must be right to `search`.
        config: Limits of the search.

    Raises:
        RegistrationError: If a pair or the points have another shape.
    """
    c, second_pose = config or AcrossConfig(), transform_second_to_first
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
    here, there = ([_smooth(image, c.smoothing) for image in pair] for pair in (first, second))
    found, sigma = np.full(seen.shape, np.nan), np.full(seen.shape, np.nan)
    correlations = np.full(len(seen), np.nan)
    usable = np.isfinite(seen).all(axis=1) & np.isfinite(facing).all(axis=1) & (seen[:, 2] > 0.0)
    usable &= np.einsum("ni,ni->n", facing, geometry.points(seen)) < 0.0
    index = np.flatnonzero(usable)
    places, warps, slopes = _predict(seen[index], facing[index], geometry, second_pose)
    bends = _bends(seen[index], facing[index], geometry, second_pose, c.patch // 2)
    for n, expected, warp, slope, bend in zip(index, places, warps, slopes, bends, strict=True):
        if not (np.isfinite(expected).all() and np.isfinite(warp).all()):
            continue
        if not c.least_size < np.linalg.det(warp) < 1.0 / c.least_size:
            continue
        place = _place_across(here[0], there[0], seen[n, :2], expected[:2], warp, c)
        if place is None:
            continue
        right = _right_place(there, place.place, expected[2], slope, c)
        if right is None:
            continue
        spread = np.hypot(c.noise_factor * np.array([*place.sigma, right.sigma[0]]), c.floor)
        disparity = place.place[0] - right.place[0]
        if spread.max() > c.most_sigma or disparity <= 0.0:
            continue
        found[n], sigma[n] = [*(place.place - bend), disparity], spread
        correlations[n] = place.correlation
    return Across(found, sigma, correlations)


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


def _place_across(
    first: FloatImage,
    second: FloatImage,
    start: FloatArray,
    expected: FloatArray,
    warp: FloatArray,
    config: AcrossConfig,
) -> PatchFit | None:
    """Return where a patch is in the second left image; None if it is not there."""
    half, reach = config.patch // 2, config.search
    template = sample_patch(first, start, np.asarray(np.linalg.inv(warp), dtype=float), half)
    if template is None:
        return None
    centre = np.rint(expected).astype(int)
    low, high = centre - reach - half, centre + reach + half + 1
    if np.any(low < 0) or np.any(high > (second.shape[1], second.shape[0])):
        return None
    window = np.ascontiguousarray(second[low[1] : high[1], low[0] : high[0]])
    likeness: Any = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    _, best, _, peak = cv2.minMaxLoc(likeness)
    if not np.isfinite(best) or best < config.least_correlation - 0.2:
        return None
    coarse = np.array(peak, dtype=float) + low + half
    fit = fit_patch(first, second, start, coarse, warp, half, EVERYTHING)
    return _trusted(fit, coarse, config)


def _right_place(
    pair: Sequence[FloatImage],
    place: FloatArray,
    disparity: float,
    slopes: FloatArray,
    config: AcrossConfig,
) -> PatchFit | None:
    """Return where a place of a left image is in the right one; None if it is not there."""
    warp = np.array([[1.0 - slopes[0], -slopes[1]], [0.0, 1.0]])
    start = place - [disparity, 0.0]
    half = config.patch // 2
    return _trusted(
        fit_patch(pair[0], pair[1], place, start, warp, half, COLUMN_ONLY), start, config
    )


def _trusted(fit: PatchFit | None, start: FloatArray, config: AcrossConfig) -> PatchFit | None:
    if fit is None or fit.correlation < config.least_correlation:
        return None
    return fit if np.hypot(*(fit.place - start)) <= 3.0 else None
