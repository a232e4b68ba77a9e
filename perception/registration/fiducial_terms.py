"""The terms that fiducials are chosen by: eq. 3-21 and 3-22, and whether a match can be trusted."""

from __future__ import annotations

import dataclasses
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

_FALL = 1e-4  # Of a contrast; less is rounding.
_DARK = 4.0  # Mean grey level below which a window has no contrast worth the name.


@dataclasses.dataclass(frozen=True)
class FiducialConfig:
    """What makes a good fiducial.

    Attributes:
        count: How many are wanted.
        certainty_weight: Of f, certainty over the radius to which it falls.
        visual_weight: Of g, visual contrast times window size.
        depth_weight: Of h, depth contrast times window size.
        largest_window: Edge of the largest window, odd [px].
        full_visual: C * w / w_max at which g is 1.
        full_depth: H * w / w_max at which h is 1.
        shell: Thickness of the spheres' shells in which neighbours' certainty is averaged [m].
        shells: How many of them.
        spread: Standard deviation of a point at which its certainty is a half [m].
        patch: Edge of the patch that will be tracked, odd [px].
        noise: Standard deviation of the image noise [grey levels]; 46 dB by default.
        localisation: Largest standard deviation of a match that noise may cause [px].
        surface_window: Edge of the window that must show one surface, odd [px]: wider than the
            patch, for stereo leaves gaps about edges.
        relief: Largest r.m.s. of the disparities there about their plane [px]; more is an edge.
        coverage: Least density of measured points there, over the usual one.
        sigma: Standard deviations of column, row and disparity [px], to judge the set by.
        least_spacing: No two are nearer in the image [px].
        spacing: The penalty falls linearly to zero at this distance [px].
        penalty: At no distance; the sum of the weights is the highest rating.
        cell: Edge of the squares of the image of which only the best by contrast is rated [px].
    """

    count: int = 6
    certainty_weight: float = 1.0
    visual_weight: float = 1.0
    depth_weight: float = 0.5
    largest_window: int = 31
    full_visual: float = 1.0
    full_depth: float = 0.05
    shell: float = 0.01
    shells: int = 5
    spread: float = 0.005
    patch: int = 15
    noise: float = 255.0 * 10.0 ** (-46.0 / 20.0)
    localisation: float = 0.1
    surface_window: int = 27
    relief: float = 0.2
    coverage: float = 0.6
    sigma: tuple[float, float, float] = (0.25, 0.25, 0.25)
    least_spacing: float = 15.0
    spacing: float = 150.0
    penalty: float = 1.5
    cell: int = 12

    def __post_init__(self) -> None:
        """Refuse what nothing can be chosen by.

        Raises:
            ValueError: Naming it.
        """
        for name in ("count", "shells", "cell"):
            if getattr(self, name) < 1:
                raise ValueError(f"fiducials: {name} must be at least 1: {getattr(self, name)}")
        for name in ("largest_window", "patch", "surface_window"):
            if getattr(self, name) < 3 or getattr(self, name) % 2 == 0:
                raise ValueError(f"fiducials: {name} must be odd, 3 or more: {getattr(self, name)}")
        for name in ("full_visual", "full_depth", "shell", "spread", "localisation", "noise"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"fiducials: {name} must be positive: {getattr(self, name)}")


def window_contrast(
    centre: FloatArray, means: FloatArray, windows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return contrast (3-22) and the window size after which it starts to fall.

    Args:
        centre: (N,) values at the candidates.
        means: (W, N) averages in windows about them; NaN for none.
        windows: (W,) their sizes, rising [px].

    Returns:
        (N,) of absolute contrast, and (N,) window sizes.
    """
    contrast = np.abs(centre - means) / np.abs(means)
    contrast = np.where(np.isfinite(contrast), contrast, 0.0)
    falls = np.diff(contrast, axis=0) < -_FALL
    last = np.where(falls.any(axis=0), falls.argmax(axis=0), len(windows) - 1)
    return contrast[last, np.arange(len(centre))], windows[last]


def visual_term(
    image: NDArray[np.uint8], image_points: FloatArray, config: FiducialConfig
) -> FloatArray:
    """Return (N,) g: contrast with the surroundings times the window's size, 0 to 1."""
    columns, rows = pixels(image_points)
    grey = image.astype(np.float32)
    windows = _windows(config)
    means = np.stack([_mean(grey, int(w))[rows, columns] for w in windows]).astype(float)
    means[means < _DARK] = np.nan
    contrast, window = window_contrast(grey[rows, columns].astype(float), means, windows)
    return np.minimum(contrast * window / config.largest_window / config.full_visual, 1.0)


def depth_term(
    image_points: FloatArray,
    depths: FloatArray,
    shape: tuple[int, ...],
    chosen: IndexArray,
    config: FiducialConfig,
) -> FloatArray:
    """Return (N,) h: depth contrast with the surroundings times the window's size, 0 to 1.

    For the maximum of the spatial frequency the thesis allows a heuristic: this is the depth's
    contrast in the sense of 3-22, over the points that were measured in a window.

    Args:
        image_points: (M, 3) of all measured points [px].
        depths: (M,) of them [m]; NaN where there is none.
        shape: Of the image.
        chosen: (N,) which of them to rate.
        config: Windows and scale.
    """
    columns, rows = pixels(image_points)
    measured = np.isfinite(depths)
    measured &= (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    depth, mask = np.zeros(shape[:2], np.float32), np.zeros(shape[:2], np.float32)
    depth[rows[measured], columns[measured]] = depths[measured]
    mask[rows[measured], columns[measured]] = 1.0
    windows = _windows(config)
    at = (rows[chosen], columns[chosen])
    means = np.empty((len(windows), len(chosen)))
    for k, window in enumerate(windows):
        share = np.maximum(_mean(mask, int(window))[at], 1e-6)
        means[k] = _mean(depth, int(window))[at] / share
    contrast, window = window_contrast(depths[chosen], means, windows)
    return np.minimum(contrast * window / config.largest_window / config.full_depth, 1.0)


def match_sigma(
    image: NDArray[np.uint8], image_points: FloatArray, config: FiducialConfig
) -> FloatArray:
    """Return (N,) deviation along the worst axis of a match of the patch with itself [px].

    From the noise of both images and the gradients' sum of squares; infinite where it is flat.
    """
    columns, rows = pixels(image_points)
    grey = image.astype(np.float32)
    along, down = (
        np.asarray(cv2.Sobel(grey, cv2.CV_32F, i, 1 - i, ksize=3, scale=1.0 / 8.0)) for i in (1, 0)
    )
    area = config.patch**2
    xx, xy, yy = (
        _mean(p, config.patch)[rows, columns].astype(float) * area
        for p in (along * along, along * down, down * down)
    )
    # A flat image has gradients by noise alone: 12/64 of its variance, twice, in each pixel.
    floor = area * 12.0 / 64.0 * config.noise**2
    least = 0.5 * (xx + yy) - np.sqrt(0.25 * (xx - yy) ** 2 + xy**2) - floor
    return config.noise * np.sqrt(2.0 / np.maximum(least, 1e-12))


def on_one_surface(
    seen: FloatArray, shape: tuple[int, ...], chosen: IndexArray, config: FiducialConfig
) -> NDArray[np.bool_]:
    """Say about which of the chosen points the image shows one smooth surface.

    A plane is fitted to the disparities measured in a window, by sums over boxes.
    """
    columns, rows = pixels(seen)
    measured = np.isfinite(seen).all(axis=1)
    measured &= (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    mask, disparity = np.zeros(shape[:2]), np.zeros(shape[:2])
    mask[rows[measured], columns[measured]] = 1.0
    disparity[rows[measured], columns[measured]] = seen[measured, 2]
    down, right = np.indices(shape[:2], dtype=float)
    at = (rows[chosen], columns[chosen])
    box, flags = (config.surface_window, config.surface_window), cv2.BORDER_CONSTANT

    def summed(values: FloatArray) -> FloatArray:
        total = cv2.boxFilter(mask * values, cv2.CV_64F, box, normalize=False, borderType=flags)
        return np.asarray(total, dtype=float)[at]

    # Each box's sums are taken about its own centre, or they would cancel badly.
    axes = (np.ones(shape[:2]), right, down, disparity)
    centre = np.stack([np.zeros(len(chosen)), *(seen[chosen, k] for k in range(3))])
    raw = np.array([[summed(a * b) for b in axes] for a in axes])
    shift = centre[:, None, :] * raw[0]
    about = raw - shift - np.swapaxes(shift, 0, 1) + centre[:, None] * centre[None] * raw[0, 0]
    normal = np.moveaxis(about[:3, :3], -1, 0) + 1e-6 * np.eye(3)
    pull = about[:3, 3].T[..., None]
    slopes: FloatArray = np.asarray(np.linalg.solve(normal, pull), dtype=float)
    left = about[3, 3] - np.sum(pull * slopes, axis=(1, 2))
    count = about[0, 0]
    relief = np.sqrt(np.maximum(left, 0.0) / np.maximum(count, 1.0))
    usual = np.median(count) if len(count) else 0.0
    return (relief <= config.relief) & (count >= config.coverage * usual)


def pixels(image_points: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Return columns and rows (N,) as whole numbers; -1 for what is not finite."""
    whole = np.where(np.isfinite(image_points[:, :2]), image_points[:, :2], -1.0)
    whole = np.rint(np.clip(whole, -1e6, 1e6)).astype(np.intp)
    return whole[:, 0], whole[:, 1]


def _windows(config: FiducialConfig) -> FloatArray:
    return np.arange(3, config.largest_window + 1, 2).astype(float)


def _mean(image: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    return np.asarray(
        cv2.blur(image, (window, window), borderType=cv2.BORDER_REFLECT_101), dtype=np.float32
    )


def inverse_radius(
    points: FloatArray,
    certainties: FloatArray,
    centres: FloatArray,
    own: FloatArray,
    shell: float,
    shells: int,
) -> FloatArray:
    """Return 1 / r of the thesis' f: r is where certainty, falling from a centre, stops falling.

    Args:
        points: (M, 3) all that is measured [m].
        certainties: (M,) of them; where a shell holds none it is 0.
        centres: (N, 3) candidates [m].
        own: (N,) their certainties.
        shell: Thickness of a shell [m].
        shells: How many there are.

    Returns:
        (N,) inverse radii in shells, 1 / shells to 1.
    """
    inverse: FloatArray = _radius_kernel(points, certainties, centres, own, shell, shells)
    return inverse


@numba.njit(cache=True)
def _radius_kernel(
    points: Any, certainties: Any, centres: Any, own: Any, shell: float, shells: int
) -> Any:
    """Return (N,) 1 / r in shells: r is where the neighbours' certainty stops falling."""
    result = np.empty(len(centres))
    reach = (shell * shells) ** 2
    for n in range(len(centres)):
        total, count = np.zeros(shells), np.zeros(shells)
        for m in range(len(points)):
            x = points[m, 0] - centres[n, 0]
            y = points[m, 1] - centres[n, 1]
            z = points[m, 2] - centres[n, 2]
            square = x * x + y * y + z * z
            if 0.0 < square < reach:
                k = min(int(np.sqrt(square) / shell), shells - 1)
                total[k] += certainties[m]
                count[k] += 1.0
        radius, last = 1, own[n]
        for k in range(shells):
            mean = total[k] / count[k] if count[k] > 0.0 else 0.0
            if mean > last:
                break
            last, radius = mean, k + 1
        result[n] = 1.0 / radius
    return result
