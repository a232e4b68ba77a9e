"""Fiducials followed from one stereo view to the next, to a fraction of a pixel.

The rough motion says where a fiducial will appear and how its surroundings will be distorted;
normalised correlation finds it nearby, and a least-squares fit of an affine patch refines it. The
way back must lead to where it came from.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import RegistrationError
from perception.stereo.geometry import StereoGeometry
from perception.stereo.patch_fit import COLUMN_ONLY, EVERYTHING, PatchFit, fit_patch, sample_patch

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.float32]

_PEAK = 3  # Radius of a peak of correlation [px]; whatever is as high beyond it is a rival.


@dataclasses.dataclass(frozen=True)
class TrackerConfig:
    """How fiducials are found again.

    Attributes:
        patch: Edge of the patch, odd [px].
        search: How far from the prediction it is searched for [px].
        disparity_search: How far the disparity may be from the prediction [px].
        least_correlation: Of the matched patches, normalised.
        least_lead: Of the best correlation over any other in the search.
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
        """Refuse what cannot be searched with.

        Raises:
            ValueError: Naming it.
        """
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
        found: (N,) which were.
        correlations: (N,) of the patches before and after; NaN where none was found.
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
        geometry: Of the cameras.
        guess: After to before, as the arm's joints say.
        config: How to search.

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
        geometry: Of the cameras.
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
    first: ImageArray,
    second: ImageArray,
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
    source: ImageArray,
    target: ImageArray,
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
        config: How far, and by how much the best must lead.
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
    pair: ImageArray, start: FloatArray, config: TrackerConfig
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
