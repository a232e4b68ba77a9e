"""A rectified stereo pair to points with covariance (Thesis section 3.2.3).

OpenCV's block matching finds disparities to a few hundredths of a pixel, with a bias towards whole
pixels on slanted ground; a least-squares fit of the two images removes it and estimates how certain
each disparity is. Points next to a jump of disparity are rejected or given a large deviation.
"""

import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from perception.geometry.arrays import FloatArray, ImageArray
from perception.stereo.geometry import StereoGeometry
from perception.stereo.refinement import refine

_STEP = 16  # StereoBM searches multiples of this [px].
_NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))


class StereoError(ValueError):
    """The images or the configuration cannot be matched; names the fault and what is valid."""


@dataclasses.dataclass(frozen=True)
class StereoMatcherConfig:
    """How a pair is matched.

    What the disparity's deviation is made of (`noise_factor`, `edge_factor`, `floor`) was measured
    on rendered pairs with 46 dB of image noise, at depths of 0.3 to 3 m, other scenes than those
    of ``experiments/ch3/stereo/noise.py``: there the squared error of 440,000 points was 1.1 times
    its prediction.

    Attributes:
        nearest: Depth from which disparities are searched [m].
        farthest: Depth beyond which matches are dropped [m].
        stride: Every so many columns and rows a point is made [px]. Windows of neighbouring
            points overlap, so their errors are correlated unless this is `window` or more.
        block: Edge of StereoBM's block, odd [px].
        window: Edge of the least-squares window, odd [px].
        smoothing: Deviation of the Gaussian that goes over both images before the fit [px]. Without
            it, detail near the limit of the pixels locks the fit to whole pixels on surfaces that
            face the cameras.
        texture: Least sum of horizontal gradients in a block (StereoBM).
        uniqueness: Least margin of the best match over all others [%].
        speckle: Fewest connected pixels of like disparity.
        least_contrast: Least r.m.s. of the middle of a window about its mean [grey levels]; bare
            sky beside something textured stays below it.
        most_residual: Most r.m.s. difference of the matched windows over that contrast.
        neighbours: Least number of matched points among the eight about half a window away.
        noise_factor: Deviation of the disparity over that which the fit's residual explains as if
            the pixels' noise were independent, which the smoothing undoes.
        edge_factor: Deviation over the amount by which the plane misses a neighbour.
        floor: Deviation of the disparity that is always there [px].
        most_sigma: Largest deviation of a disparity that is kept [px].
        pixel_sigma: Deviation of columns and rows [px]: how well the pinhole is known.
    """

    nearest: float = 0.25
    farthest: float = 4.0
    stride: int = 3
    block: int = 15
    window: int = 11
    smoothing: float = 0.6
    texture: int = 10
    uniqueness: int = 10
    speckle: int = 100
    least_contrast: float = 3.0
    most_residual: float = 0.3
    neighbours: int = 6
    noise_factor: float = 1.4
    edge_factor: float = 0.5
    floor: float = 0.005
    most_sigma: float = 0.3
    pixel_sigma: float = 0.03

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        if not 0.0 < self.nearest < self.farthest < math.inf:
            depths = (self.nearest, self.farthest)
            raise StereoError(f"stereo nearest and farthest: got {depths}, needs 0 < near < far")
        for name in ("block", "window"):
            edge = getattr(self, name)
            if edge < 5 or edge > 51 or edge % 2 == 0:
                raise StereoError(f"stereo {name}: got {edge}, needs an odd number from 5 to 51")
        if self.stride < 1:
            raise StereoError(f"stereo stride: got {self.stride}, needs 1 or more")
        if not 0 <= self.neighbours <= len(_NEIGHBOURS):
            raise StereoError(f"stereo neighbours: got {self.neighbours}, needs 0 to 8")
        if not 0.0 <= self.smoothing <= 5.0:
            raise StereoError(f"stereo smoothing: got {self.smoothing}, needs 0 to 5 px")
        for name in ("noise_factor", "most_sigma", "pixel_sigma"):
            if not getattr(self, name) > 0.0:
                raise StereoError(f"stereo {name}: got {getattr(self, name)}, needs above 0")


@dataclasses.dataclass(frozen=True)
class StereoPoints:
    """What a stereo pair saw; N may be 0.

    Attributes:
        points: (N, 3) [m], left camera (x right, y down, z forward).
        covariances: (N, 3, 3) [m^2], left camera (eq. 3-4 to 3-6).
        pixels: (N, 2) column, row in the left image [px].
        disparities: (N,) left column minus right [px].
        sigmas: (N,) standard deviation of the disparities [px].
    """

    points: FloatArray
    covariances: FloatArray
    pixels: FloatArray
    disparities: FloatArray
    sigmas: FloatArray

    def __len__(self) -> int:
        return len(self.points)


class StereoMatcher:
    """Matches pairs of one stereo head.

    Args:
        geometry: Geometry of the rectified pair.
        config: Configuration of the matching; the default if not given.

    Raises:
        StereoError: If the images are smaller than a window, or nothing that the cameras see twice
            can be as near as `StereoMatcherConfig.nearest`.
    """

    def __init__(self, geometry: StereoGeometry, config: StereoMatcherConfig | None = None) -> None:
        self.geometry = geometry
        self.config = config or StereoMatcherConfig()
        c = self.config
        least = max(c.block, c.window) + 2
        if min(geometry.width, geometry.height) < least:
            size = f"{geometry.width} x {geometry.height}"
            raise StereoError(f"stereo images of {size} px: needs {least} px a side for its blocks")
        widest = geometry.fx * geometry.baseline / c.nearest
        if widest >= geometry.width:
            raise StereoError(
                f"stereo nearest: got {c.nearest} m, where the disparity is {widest:.0f} px in "
                f"images {geometry.width} px wide; needs more than "
                f"{geometry.fx * geometry.baseline / geometry.width:.3f} m"
            )
        self._search = _STEP * math.ceil((widest + 1.0) / _STEP)
        self._matcher = _block_matcher(c, self._search)

    def disparities(self, pair: NDArray[Any]) -> FloatArray:
        """Return what block matching finds, without the refinement and its rejection.

        Args:
            pair: (2, H, W) uint8, left and right, rectified.

        Returns:
            (H, W) [px], to a sixteenth; NaN where there is no match.

        Raises:
            StereoError: If it is no such pair.
        """
        left, right = check_pair(pair, self.geometry)
        # StereoBM leaves out the columns whose widest search would leave the image; a margin gives
        # them a search, and what really leaves is rejected by the least squares.
        padded = [
            cv2.copyMakeBorder(image, 0, 0, self._search, 0, cv2.BORDER_CONSTANT)
            for image in (left, right)
        ]
        fixed = np.asarray(self._matcher.compute(padded[0], padded[1]), dtype=float)
        found = fixed[:, self._search :] / 16.0
        least = self.geometry.fx * self.geometry.baseline / self.config.farthest
        return np.where(found > least, found, np.nan)

    def match(self, pair: NDArray[Any]) -> StereoPoints:
        """Return the points that a pair shows; none where there is nothing to be matched.

        Args:
            pair: (2, H, W) uint8, left and right, rectified.

        Raises:
            StereoError: If it is no such pair.
        """
        c = self.config
        coarse = self.disparities(pair)[:: c.stride, :: c.stride]
        rows, columns = np.nonzero(np.isfinite(coarse))
        pixels = c.stride * np.column_stack([columns, rows]).astype(np.int64)
        starts = np.zeros((len(pixels), 3))
        starts[:, 0] = coarse[rows, columns]
        left, right = (_smooth(image, c.smoothing) for image in np.asarray(pair))
        fit = refine(left, right, pixels, starts, c.window // 2)
        trusted = np.isfinite(fit.disparities) & (fit.inner_contrasts >= c.least_contrast)
        trusted &= fit.residuals <= c.most_residual * fit.contrasts
        planes = np.full((*coarse.shape, 3), np.nan)
        planes[rows[trusted], columns[trusted], 0] = fit.disparities[trusted]
        planes[rows[trusted], columns[trusted], 1:] = fit.slopes[trusted]
        misses, matched = _neighbour_misses(planes, c)
        excess = np.maximum(misses[rows, columns] - 4.0 * c.noise_factor * fit.sigmas, 0.0)
        sigma = np.sqrt(
            (c.noise_factor * fit.sigmas) ** 2 + (c.edge_factor * excess) ** 2 + c.floor**2
        )
        least = self.geometry.fx * self.geometry.baseline / c.farthest
        keep = trusted & (matched[rows, columns] >= c.neighbours) & (sigma <= c.most_sigma)
        keep &= fit.disparities > least
        pixels, disparities, sigma = pixels[keep], fit.disparities[keep], sigma[keep]
        points = self.geometry.points(np.column_stack([pixels, disparities]))
        deviation = np.column_stack([np.full(pixels.shape, c.pixel_sigma), sigma])
        covariances = self.geometry.covariance(points, deviation)
        return StereoPoints(points, covariances, pixels.astype(float), disparities, sigma)


def check_pair(pair: NDArray[Any], geometry: StereoGeometry) -> tuple[ImageArray, ImageArray]:
    """Return left and right image of a pair that a geometry fits.

    Args:
        pair: (2, H, W) uint8.
        geometry: Geometry of the stereo pair.

    Raises:
        StereoError: If it has another shape or type, or is not a pair of arrays of one size.
    """
    needs = f"needs (2, {geometry.height}, {geometry.width}) uint8"
    try:
        images = np.asarray(pair)
    except ValueError as error:
        sizes = [np.shape(image) for image in pair]
        raise StereoError(f"stereo pair: images of shapes {sizes}, {needs}") from error
    if images.shape != (2, geometry.height, geometry.width) or images.dtype != np.uint8:
        raise StereoError(f"stereo pair: got {images.shape} {images.dtype}, {needs}")
    return images[0], images[1]


def _smooth(image: ImageArray, sigma: float) -> NDArray[np.float32]:
    fine = np.asarray(image, dtype=np.float32)
    if sigma == 0.0:
        return fine
    return np.asarray(cv2.GaussianBlur(fine, (0, 0), sigma), dtype=np.float32)


def _block_matcher(config: StereoMatcherConfig, search: int) -> cv2.StereoBM:
    matcher = cv2.StereoBM.create(search, config.block)
    matcher.setTextureThreshold(config.texture)
    matcher.setUniquenessRatio(config.uniqueness)
    matcher.setSpeckleWindowSize(config.speckle)
    matcher.setSpeckleRange(2)
    matcher.setDisp12MaxDiff(1)  # Left to right and back must agree within a pixel.
    return matcher


def _neighbour_misses(
    planes: FloatArray, config: StereoMatcherConfig
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Compare each point's plane of disparity with its neighbours half a window away.

    Args:
        planes: (R, C, 3) disparity [px] and its slopes by column and row; NaN where there is none.
        config: Window and stride.

    Returns:
        (R, C) largest miss [px], and (R, C) number of neighbours that there are.
    """
    shape = planes.shape[:2]
    cells = max(1, math.ceil((config.window // 2) / config.stride))
    reach = cells * config.stride
    framed = np.full((shape[0] + 2 * cells, shape[1] + 2 * cells), np.nan)
    framed[cells : cells + shape[0], cells : cells + shape[1]] = planes[..., 0]
    largest, count = np.zeros(shape), np.zeros(shape, dtype=np.int64)
    for down, right in _NEIGHBOURS:
        top, left = cells * (1 + down), cells * (1 + right)
        other = framed[top : top + shape[0], left : left + shape[1]]
        expected = planes[..., 0] + reach * (right * planes[..., 1] + down * planes[..., 2])
        miss = np.abs(other - expected)
        count += np.isfinite(miss)
        largest = np.fmax(largest, miss)
    return largest, count
