"""Circular markers as cameras see them: ellipses, measured to hundredths of a pixel.

An ellipse is (column, row, Suu, Suv, Svv): its centre [px] and the symmetric matrix S [px^2] with
``(x - centre)^T S^-1 (x - centre) = 1`` on its rim, so that the roots of the eigenvalues of S are
its semi-axes. A disc's grey levels have the second moments S/4, plus 1/12 for the pixels' squares.
"""

import dataclasses
import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from perception.geometry.checks import check_numbers
from perception.stereo.geometry import StereoGeometry

QUARTER_INCH = 0.25 * 0.0254
"""Diameter of the thesis' markers [m] (figure 5-10)."""


@dataclasses.dataclass(frozen=True)
class MarkerExpectation:
    """What is known of bright markers before looking, and how good the images are.

    Attributes:
        nearest: Least range [m].
        farthest: Largest range [m].
        diameter: Diameter of a marker [m].
        count: Most markers in view.
        slant: Largest angle between a marker's normal and the line of sight [rad].
        contrast: Least grey levels between a marker and what is around it.
        noise: Standard deviation of a pixel [grey levels]; 46 dB under full scale.
        sampling: Standard deviation of the part of a pixel on the rim that a marker seems to
            cover; what four samples a pixel leave, more than sensor noise does.
        misfit: Largest r.m.s. difference from an ellipse, over the contrast.
    """

    nearest: float
    farthest: float
    diameter: float = QUARTER_INCH
    count: int = 4
    slant: float = math.radians(66.0)
    contrast: float = 30.0
    noise: float = 255.0 * 10.0 ** (-46.0 / 20.0)
    sampling: float = 0.15
    misfit: float = 0.15

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        if not 0.0 < self.nearest <= self.farthest < math.inf:
            reach = (self.nearest, self.farthest)
            raise ValueError(f"marker range: got {reach}, needs 0 < nearest <= farthest")
        check_numbers("marker", self, "diameter", "count", "contrast", "noise", "misfit")
        if not 0.0 <= self.slant < math.pi / 2.0:
            raise ValueError(f"marker slant: got {self.slant}, needs 0 to below pi/2 rad")
        if not 0.0 <= self.sampling < 1.0:
            raise ValueError(f"marker sampling: got {self.sampling}, needs 0 to below 1")

    @property
    def pixels(self) -> "PixelNoise":
        """Noise of the pixels."""
        return PixelNoise(self.noise, self.sampling)

    def radii(self, geometry: StereoGeometry) -> tuple[float, float]:
        """Return the least and the largest radius of a marker seen head on [px of the rows]."""
        size = 0.5 * self.diameter * geometry.fy
        return size / self.farthest, size / self.nearest


@dataclasses.dataclass(frozen=True)
class Markers:
    """Bright ellipses in an image; N may be 0.

    Attributes:
        ellipses: (N, 5) column, row [px], Suu, Suv, Svv [px^2].
        covariances: (N, 5, 5) covariances of the ellipses.
        contrasts: (N,) grey levels of the ellipse over what is around it.
    """

    ellipses: FloatArray
    covariances: FloatArray
    contrasts: FloatArray

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.ellipses)

    @property
    def centres(self) -> FloatArray:
        """(N, 2) column and row of the ellipses' centres [px]."""
        return self.ellipses[:, :2]

    @property
    def centre_covariances(self) -> FloatArray:
        """(N, 2, 2) of the centres [px^2]."""
        return self.covariances[:, :2, :2]

    @property
    def axes(self) -> FloatArray:
        """(N, 2) semi-axes, the longer first [px]."""
        values = np.linalg.eigvalsh(shape_matrices(self.ellipses))
        return np.sqrt(np.maximum(values[:, ::-1], 0.0))

    @property
    def angles(self) -> FloatArray:
        """(N,) from the columns' direction to the longer axis, towards growing rows [rad]."""
        suu, suv, svv = self.ellipses[:, 2:].T
        return 0.5 * np.arctan2(2.0 * suv, suu - svv)


def shape_matrices(ellipses: ArrayLike) -> FloatArray:
    """Return (..., 2, 2) matrices S of ellipses (..., 5) [px^2]."""
    values = np.asarray(ellipses, dtype=float)
    return values[..., [2, 3, 3, 4]].reshape(*values.shape[:-1], 2, 2)


def project_discs(
    centres: ArrayLike, normals: ArrayLike, radius: float, geometry: StereoGeometry
) -> FloatArray:
    """Return the ellipses that discs make in the left image: their dual conics, in closed form.

    An ellipse's centre is not the image of the disc's: it lies towards the disc's near side, by
    0.03 px for a quarter of an inch at 0.35 m.

    Args:
        centres: (..., 3) [m], camera.
        normals: (..., 3) unit vectors, camera.
        radius: Radius of the discs [m].
        geometry: Geometry of the camera.

    Returns:
        (..., 5) ellipses; NaN where a disc is not wholly ahead.
    """
    c, n = np.asarray(centres, dtype=float), np.asarray(normals, dtype=float)
    # A line l is tangent to the rim if l^T D l = 0.
    flat = np.eye(3) - n[..., :, None] * n[..., None, :]
    dual = c[..., :, None] * c[..., None, :] - radius**2 * flat
    scale = np.where((dual[..., 2, 2] > 0.0) & (c[..., 2] > 0.0), dual[..., 2, 2], np.nan)
    x, y = dual[..., 0, 2] / scale, dual[..., 1, 2] / scale
    sxx = x * x - dual[..., 0, 0] / scale
    sxy = x * y - dual[..., 0, 1] / scale
    syy = y * y - dual[..., 1, 1] / scale
    fx, fy = geometry.fx, geometry.fy
    column, row = fx * x + geometry.cx, fy * y + geometry.cy
    return np.stack([column, row, fx * fx * sxx, fx * fy * sxy, fy * fy * syy], axis=-1)


def check_image(image: NDArray[Any], geometry: StereoGeometry) -> ImageArray:
    """Return an image, contiguous and not to be written to.

    Raises:
        ValueError: If it is not grey of 8 bits or not of the geometry's size.
    """
    expected = (geometry.height, geometry.width)
    if image.dtype != np.uint8 or image.shape != expected:
        raise ValueError(
            f"marker image: got shape {image.shape}, {image.dtype}; needs {expected}, uint8"
        )
    # Compiled code is compiled anew for arrays that may be written to.
    grey = np.ascontiguousarray(image).view()
    grey.flags.writeable = False
    return grey


class PixelNoise(NamedTuple):
    """Noise of the pixels that a marker is measured from.

    Attributes:
        grey: Standard deviation of a pixel [grey levels].
        sampling: Standard deviation of the part of a rim pixel that a marker seems to cover.
    """

    grey: float
    sampling: float


class RegionLimits(NamedTuple):
    """Sizes of a bright region that may be a marker.

    Attributes:
        half: Half the edge of the window about its seed [px].
        fewest: Least number of its pixels.
        most: Largest number of its pixels.
    """

    half: int
    fewest: int
    most: int


class MeasuredEllipses(NamedTuple):
    """Buffers for N ellipses as they are measured.

    Attributes:
        ellipses: (N, 5) column, row [px], Suu, Suv, Svv [px^2].
        covariances: (N, 5, 5) covariances of the ellipses.
        contrasts: (N,) contrast with the background [grey levels].
        misfits: (N,) how unlike an ellipse each is: r.m.s. difference over the contrast, or
            logarithm of the area over that of the ellipse.
    """

    ellipses: FloatArray
    covariances: FloatArray
    contrasts: FloatArray
    misfits: FloatArray

    def first(self, count: int) -> "MeasuredEllipses":
        """Return the first of them."""
        return MeasuredEllipses(*(values[:count] for values in self))


def allocate_ellipses(count: int) -> MeasuredEllipses:
    """Return buffers for a number of ellipses."""
    return MeasuredEllipses(
        np.empty((count, 5)), np.empty((count, 5, 5)), np.empty(count), np.empty(count)
    )


def keep_plausible(
    measured: MeasuredEllipses, geometry: StereoGeometry, expected: MarkerExpectation
) -> Markers:
    """Return those measured ellipses that a marker in range may give, each place once.

    Args:
        measured: Ellipses as measured.
        geometry: Geometry of the camera.
        expected: Sizes, slants and contrasts.
    """
    smallest, largest = expected.radii(geometry)
    kept: list[int] = []
    for number in np.argsort(measured.misfits, kind="stable"):
        ellipse = measured.ellipses[number]
        square = ellipse[2:] * np.array([1.0, geometry.fx / geometry.fy, 1.0])
        square[:2] *= (geometry.fy / geometry.fx) ** 2
        middle, half = (square[0] + square[2]) / 2.0, (square[0] - square[2]) / 2.0
        span = math.hypot(half, square[1])
        if not middle > span:
            continue
        major, minor = math.sqrt(middle + span), math.sqrt(middle - span)
        if not (0.85 * smallest - 0.2 <= major <= 1.15 * largest + 0.2):
            continue
        if minor < math.cos(expected.slant) * major - 0.3:
            continue
        if measured.contrasts[number] < expected.contrast:
            continue
        others = measured.ellipses[kept, :2]
        if all(math.hypot(*(ellipse[:2] - other)) > 0.5 * major for other in others):
            kept.append(int(number))
    return Markers(measured.ellipses[kept], measured.covariances[kept], measured.contrasts[kept])


@numba.njit(cache=True)
def grow_region(image: Any, column: int, row: int, limits: RegionLimits, stamp: Any) -> float:
    """Grow a bright region on the grey image from a seed (the last step of section 5.3).

    Neighbours join if they are brighter than midway between the seed and what is around. The
    pixels that a rim may cross follow as two layers, those of the background as a third.

    Args:
        image: (H, W) uint8.
        column: Column of the seed [px].
        row: Row of the seed [px].
        limits: Sizes of the region and of the window about the seed.
        stamp: (2 half + 1, 2 half + 1) uint8, is filled: 1 region, 2 and 3 layers, 4 background.

    Returns:
        Grey level of the background; NaN if too little or too much grows, or out of the window.
    """
    height, width = image.shape
    half, fewest, most = limits
    size = 2 * half + 1
    if column < half or row < half or column + half >= width or row + half >= height:
        return np.nan
    window = image[row - half : row + half + 1, column - half : column + half + 1]
    brightest = np.argmax(window[half - 1 : half + 2, half - 1 : half + 2])
    seed_x, seed_y = half - 1 + brightest % 3, half - 1 + brightest // 3
    peak = int(window[seed_y, seed_x])
    border = np.concatenate((window[0], window[-1], window[:, 0], window[:, -1]))
    background = np.median(border.astype(np.float64))
    stack = np.empty((size * size, 2), np.int32)
    around = np.empty(size * size)
    # Twice: the region's own surroundings show the background better than the window's border.
    for _ in range(2):
        level = 0.5 * (peak + background)
        if peak - background < 4.0:
            return np.nan
        stamp[:] = 0
        stamp[seed_y, seed_x] = 1
        stack[0, 0], stack[0, 1] = seed_x, seed_y
        used, grown = 1, 1
        x0, x1, y0, y1 = seed_x, seed_x, seed_y, seed_y
        while used > 0:
            used -= 1
            x, y = stack[used, 0], stack[used, 1]
            if x < 4 or y < 4 or x >= size - 4 or y >= size - 4 or grown > most:
                return np.nan
            x0, x1, y0, y1 = min(x0, x), max(x1, x), min(y0, y), max(y1, y)
            for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                if stamp[y + dy, x + dx] == 0 and window[y + dy, x + dx] > level:
                    stamp[y + dy, x + dx] = 1
                    stack[used, 0], stack[used, 1] = x + dx, y + dy
                    used += 1
                    grown += 1
        if grown < fewest:
            return np.nan
        count = 0
        for layer in (1, 2, 3):
            for y in range(y0 - layer + 1, y1 + layer):
                for x in range(x0 - layer + 1, x1 + layer):
                    if stamp[y, x] == layer:
                        for dy in range(-1, 2):
                            for dx in range(-1, 2):
                                if stamp[y + dy, x + dx] == 0:
                                    stamp[y + dy, x + dx] = layer + 1
                                    if layer == 3:
                                        around[count] = window[y + dy, x + dx]
                                        count += 1
        background = np.median(around[:count])
    return background


@numba.njit(cache=True)
def measure_region(
    image: Any,
    column: int,
    row: int,
    limits: RegionLimits,
    pixels: PixelNoise,
    found: MeasuredEllipses,
    number: int,
) -> bool:
    """Measure a grown region by the moments of its grey levels over the background.

    Args:
        image: (H, W) uint8.
        column: Column of the seed [px].
        row: Row of the seed [px].
        limits: Sizes of the region and of the window about the seed.
        pixels: Noise of the pixels.
        found: Ellipses, of which one is written; its misfit is the logarithm of the region's area
            over that of the ellipse.
        number: Index of the ellipse that is written.

    Returns:
        Whether there is such a region.
    """
    half, (noise, sampling) = limits.half, pixels
    stamp = np.zeros((2 * half + 1, 2 * half + 1), np.uint8)
    background = grow_region(image, column, row, limits, stamp)
    if np.isnan(background):
        return False
    window = image[row - half : row + half + 1, column - half : column + half + 1]
    rows, columns = np.nonzero((stamp > 0) & (stamp < 4))
    levels, core, cores = np.empty(len(rows)), 0.0, 0
    for k in range(len(rows)):
        x, y = columns[k], rows[k]
        levels[k] = window[y, x] - background
        # Whole neighbourhoods inside: no rim crosses these, they measure the contrast.
        if stamp[y, x] == 1 and (
            stamp[y - 1, x] + stamp[y + 1, x] + stamp[y, x - 1] + stamp[y, x + 1] == 4
        ):
            core += levels[k]
            cores += 1
    total = np.sum(levels)
    u, v = np.sum(levels * columns) / total, np.sum(levels * rows) / total
    across, down = columns - u, rows - v
    muu = np.sum(levels * across * across) / total
    muv = np.sum(levels * across * down) / total
    mvv = np.sum(levels * down * down) / total
    contrast = core / cores if cores > 0 else max(np.max(levels), 0.0)
    suu, suv, svv = 4.0 * (muu - 1.0 / 12.0), 4.0 * muv, 4.0 * (mvv - 1.0 / 12.0)
    if suu <= 0.0 or svv <= 0.0 or suu * svv <= suv * suv:
        return False
    share = levels / contrast
    rim = np.minimum(np.maximum(4.0 * share * (1.0 - share), 0.0), 1.0)
    variances = noise * noise + (sampling * contrast) ** 2 * rim
    gains = np.empty((5, len(rows)))
    gains[0], gains[1] = across / total, down / total
    gains[2] = 4.0 * (across * across - muu) / total
    gains[3] = 4.0 * (across * down - muv) / total
    gains[4] = 4.0 * (down * down - mvv) / total
    # The background comes from a ring of about as many pixels as the region's own root.
    unsure = noise * noise / max(4.0 * math.sqrt(len(rows)), 1.0)
    for i in range(5):
        for j in range(5):
            by_background = unsure * np.sum(gains[i]) * np.sum(gains[j])
            own = np.sum(variances * gains[i] * gains[j])
            found.covariances[number, i, j] = own + by_background
    ellipse = found.ellipses[number]
    ellipse[0], ellipse[1] = column - half + u, row - half + v
    ellipse[2], ellipse[3], ellipse[4] = suu, suv, svv
    found.contrasts[number] = contrast
    area = math.pi * math.sqrt(suu * svv - suv * suv)
    found.misfits[number] = abs(math.log(total / contrast / area))
    return True
