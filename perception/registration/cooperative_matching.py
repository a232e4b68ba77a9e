"""Points of one robot's stereo view found in another robot's view, from far aside.

The relative pose, known roughly, says where a point must appear, and the surface about it how its
surroundings are distorted: across a metre of baseline no patch looks the same otherwise. What is
found is refined by least squares; whether it is the same point, `triangulate_together` says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import RigidTransform

from perception.registration.checks import RegistrationError
from perception.stereo.geometry import StereoGeometry
from perception.stereo.patch_fit import COLUMN_ONLY, EVERYTHING, PatchFit, fit_patch, sample_patch

FloatArray = NDArray[np.float64]
ImageArray = NDArray[np.float32]


@dataclasses.dataclass(frozen=True)
class AcrossConfig:
    """How points are found in the other robot's view.

    Attributes:
        patch: Edge of the patch, odd [px].
        smoothing: Deviation of the Gaussian that goes over all images first [px]. Without it,
            detail near the limit of the pixels locks the fit to whole ones.
        search: How far from the prediction it is searched for [px].
        least_correlation: Of the matched patches, normalised.
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
        """Refuse what cannot be searched with.

        Raises:
            ValueError: Naming it.
        """
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
        correlations: (N,) of the patches in the two left images.
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
        radius: Of what counts as about a point [m].
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
        second: (2, H, W) of the second.
        image_points: (N, 3) columns, rows, disparities in the first view [px].
        normals: (N, 3) of the surface there, towards the first left camera; NaN where there is
            none.
        geometry: Of both robots' cameras.
        transform_second_to_first: Roughly: where points appear must be right to `search`.
        config: How to search.

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
        place = _place(here[0], there[0], seen[n, :2], expected[:2], warp, c)
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


def _smooth(image: NDArray[np.uint8], sigma: float) -> ImageArray:
    blurred = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma)
    return np.asarray(blurred, dtype=np.float32)


def _predict(
    seen: FloatArray, normals: FloatArray, geometry: StereoGeometry, second: RigidTransform
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return image points (N, 3), warps (N, 2, 2) and slopes of disparity (N, 2) in the second.

    The slopes are those by column and by row of the plane through the point.
    """
    points = geometry.points(seen)
    back = _inverse(geometry.projection_jacobian(points))
    by_pixel = back[..., :2] + back[..., 2:] * _slopes(back, normals)[:, None, :]
    there = second.apply(points, inverse=True) if len(points) else points
    there = np.where(there[:, 2:] > 0.0, there, np.nan)
    rotation = second.rotation.as_matrix()
    ahead = geometry.projection_jacobian(there)
    usable = np.isfinite(ahead).all(axis=(1, 2))
    slopes = np.full((len(points), 2), np.nan)
    slopes[usable] = _slopes(_inverse(ahead[usable]), (normals @ rotation)[usable])
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


def _inverse(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrices), dtype=float)


def _slopes(by_image: FloatArray, normals: FloatArray) -> FloatArray:
    """Return (N, 2), how the disparity changes with column and row within planes.

    Args:
        by_image: (N, 3, 3) derivatives of points by column, row and disparity.
        normals: (N, 3).
    """
    rates = (normals[:, None, :] @ by_image)[:, 0]
    return -rates[:, :2] / rates[:, 2:]


def _place(
    first: ImageArray,
    second: ImageArray,
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
    pair: Sequence[ImageArray],
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
