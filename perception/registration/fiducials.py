"""Which points of a view serve as fiducials: the evaluation function of eq. 3-21 to 3-23.

``F.E.F. = f(P(x)) + g(C(u, v)) + h(H(x))``, less a penalty near other fiducials. Each term is
brought to [0, 1], so that the weights say what matters. The thesis' contrast is large on a
straight edge as well, along which a match slides: so a fiducial must also be distinct along both
axes, to a given accuracy for the image noise. And its depth contrast draws to where one surface
hides another, whose images move apart: so the patch that is tracked must lie on one surface.
"""

import dataclasses
from typing import Any

import cv2
import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform

from perception.geometry.arrays import FloatArray, IndexArray
from perception.geometry.checks import check_numbers
from perception.registration.checks import RegistrationError
from perception.stereo.geometry import StereoGeometry


@dataclasses.dataclass(frozen=True)
class Selection:
    """The chosen fiducials, best first; there may be fewer than requested, or none.

    Attributes:
        indices: (K,) indices of the chosen points.
        image_points: (K, 3) columns, rows, disparities [px].
    """

    indices: IndexArray
    image_points: FloatArray


def select_fiducials(
    image: NDArray[np.uint8],
    image_points: ArrayLike,
    geometry: StereoGeometry,
    *,
    certainties: ArrayLike | None = None,
    taken: ArrayLike | None = None,
    next_view: RigidTransform | None = None,
    config: "FiducialConfig | None" = None,
) -> Selection:
    """Choose fiducials among measured points by eq. 3-21.

    Args:
        image: (H, W) left image.
        image_points: (N, 3) columns, rows, disparities [px] of points that a stereo match or a
            map puts there; those with a value that is not finite are passed over.
        geometry: Geometry of the stereo pair.
        certainties: (N,) P(x), 0 to 1, for instance of the map's occupancy; from the points'
            covariance by default.
        taken: (K, 2 or more) columns and rows of fiducials that there are already [px].
        next_view: The next camera to this one, roughly; what will leave the view is passed over.
        config: Criteria for a good fiducial.

    Raises:
        RegistrationError: If an array has the wrong shape.
    """
    c = config or FiducialConfig()
    seen = np.asarray(image_points, dtype=float)
    if image.shape != (geometry.height, geometry.width) or seen.ndim != 2 or seen.shape[1] != 3:
        raise RegistrationError(
            f"fiducials of an image {image.shape} with points {seen.shape}: expected "
            f"({geometry.height}, {geometry.width}) and (N, 3)"
        )
    points = geometry.points(seen)
    certain = _certainties(points, certainties, geometry, c)
    usable = np.isfinite(points).all(axis=1) & np.isfinite(certain) & _inside(seen, geometry, c)
    if next_view is not None and len(points):
        usable &= _inside(geometry.project(next_view.apply(points, inverse=True)), geometry, c)
    usable[usable] &= match_sigma(image, seen[usable], c) <= c.localisation
    chosen = np.flatnonzero(usable)
    chosen = chosen[on_one_surface(seen, image.shape, chosen, c)]
    visual = visual_term(image, seen[chosen], c)
    depth = depth_term(seen, points[:, 2], image.shape, chosen, c)
    score = c.visual_weight * visual + c.depth_weight * depth + c.certainty_weight * certain[chosen]
    order = _best_of_cells(seen[chosen], score, c)
    chosen, visual, depth = chosen[order], visual[order], depth[order]
    good = np.isfinite(points).all(axis=1) & np.isfinite(certain)
    certainty = certain[chosen] * inverse_radius(
        points[good], certain[good], points[chosen], certain[chosen], c.shell, c.shells
    )
    ratings = c.certainty_weight * certainty + c.visual_weight * visual + c.depth_weight * depth
    others = np.zeros((0, 2)) if taken is None else np.asarray(taken, dtype=float)[:, :2]
    best = _spaced(seen[chosen, :2], ratings, others, c)
    return Selection(chosen[best], seen[chosen[best]])


def _certainties(
    points: FloatArray, given: ArrayLike | None, geometry: StereoGeometry, config: "FiducialConfig"
) -> FloatArray:
    if given is not None:
        certain = np.asarray(given, dtype=float)
        if certain.shape != (len(points),):
            raise RegistrationError(f"certainties {certain.shape}: expected ({len(points)},)")
        return certain
    if not len(points):
        return np.zeros(0)
    safe = np.where(np.isfinite(points), points, 1.0)
    variance = np.trace(geometry.covariance(safe, config.sigma), axis1=1, axis2=2) / 3.0
    return 1.0 / (1.0 + variance / config.half_sigma**2)


def _inside(
    seen: FloatArray, geometry: StereoGeometry, config: "FiducialConfig"
) -> NDArray[np.bool_]:
    """Return (N,) which points have their whole patch in both images."""
    margin = config.patch // 2 + 1
    column, row, disparity = seen[:, 0], seen[:, 1], seen[:, 2]
    inside = (column - disparity >= margin) & (column < geometry.width - margin)
    return inside & (row >= margin) & (row < geometry.height - margin)


def _best_of_cells(seen: FloatArray, score: FloatArray, config: "FiducialConfig") -> IndexArray:
    """Return which points score best in their square of the image."""
    order = np.argsort(-score, kind="stable")
    squares = np.floor(seen[order, :2] / config.cell).astype(np.intp)
    _, first = np.unique(squares, axis=0, return_index=True)
    return order[np.sort(first)]


def _spaced(
    pixels: FloatArray, ratings: FloatArray, taken: FloatArray, config: "FiducialConfig"
) -> IndexArray:
    """Pick the best one by one; each pick lowers the ratings about it."""
    left = ratings.copy()
    picked: list[int] = []
    near = list(taken)
    while True:
        for place in near:
            distance = np.linalg.norm(pixels - place, axis=1)
            left -= config.penalty * np.maximum(1.0 - distance / config.spacing, 0.0)
            left[distance < config.least_spacing] = -np.inf
        if len(picked) == config.count or not len(left) or not np.isfinite(left.max()):
            return np.array(picked, dtype=np.intp)
        best = int(left.argmax())
        picked.append(best)
        near = [pixels[best]]


_FALL = 1e-4  # Of a contrast; less is rounding.
_DARK = 4.0  # Mean grey level below which a window has no contrast worth the name.


@dataclasses.dataclass(frozen=True)
class FiducialConfig:
    """What makes a good fiducial.

    Attributes:
        count: Number of fiducials wanted.
        certainty_weight: Weight of f, certainty over the radius to which it falls.
        visual_weight: Weight of g, visual contrast times window size.
        depth_weight: Weight of h, depth contrast times window size.
        largest_window: Edge of the largest window, odd [px].
        full_visual: C * w / w_max at which g is 1.
        full_depth: H * w / w_max at which h is 1.
        shell: Thickness of the spheres' shells in which neighbours' certainty is averaged [m].
        shells: Number of shells.
        half_sigma: Standard deviation of a point at which its certainty is a half [m].
        patch: Edge of the patch that will be tracked, odd [px].
        noise: Standard deviation of the image noise [grey levels]; 46 dB by default.
        localisation: Largest standard deviation of a match that noise may cause [px].
        surface_window: Edge of the window that must show one surface, odd [px]: wider than the
            patch, for stereo leaves gaps about edges.
        relief: Largest r.m.s. of the disparities there about their plane [px]; more is an edge.
        coverage: Least density of measured points there, over the usual one.
        sigma: Standard deviations of column, row and disparity [px].
        least_spacing: No two are nearer in the image [px].
        spacing: The penalty falls linearly to zero at this distance [px].
        penalty: Penalty at no distance; the sum of the weights is the highest rating.
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
    half_sigma: float = 0.005
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

    @property
    def windows(self) -> range:
        """Edges of the windows about a point, rising [px]."""
        return range(3, self.largest_window + 1, 2)

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        positive = (
            "count",
            "shells",
            "cell",
            "full_visual",
            "full_depth",
            "shell",
            "half_sigma",
        )
        check_numbers("fiducials", self, *positive, "localisation", "noise")
        for name in ("largest_window", "patch", "surface_window"):
            if getattr(self, name) < 3 or getattr(self, name) % 2 == 0:
                raise ValueError(f"fiducials: {name} must be odd, 3 or more: {getattr(self, name)}")


def window_contrast(
    centre: FloatArray, means: FloatArray, windows: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return contrast (3-22) and the window size after which it starts to fall.

    Args:
        centre: (N,) values at the candidates.
        means: (W, N) averages in windows about them; NaN for none.
        windows: (W,) sizes of the windows, rising [px].

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
    means = np.stack([_mean(grey, w)[rows, columns] for w in config.windows]).astype(float)
    means[means < _DARK] = np.nan
    contrast = _sized_contrast(grey[rows, columns].astype(float), means, config)
    return np.minimum(contrast / config.full_visual, 1.0)


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
        image_points: (M, 3) columns, rows, disparities of all measured points [px].
        depths: (M,) depths of all measured points [m]; NaN where there is none.
        shape: Shape of the image.
        chosen: (N,) indices of the points to rate.
        config: Windows and scale.
    """
    columns, rows = pixels(image_points[chosen])
    mask, depth = (i.astype(np.float32) for i in _drawn(image_points, depths, shape))
    means = [
        _mean(depth, w)[rows, columns] / np.maximum(_mean(mask, w)[rows, columns], 1e-6)
        for w in config.windows
    ]
    contrast = _sized_contrast(depths[chosen], np.stack(means).astype(float), config)
    return np.minimum(contrast / config.full_depth, 1.0)


def _sized_contrast(centre: FloatArray, means: FloatArray, config: FiducialConfig) -> FloatArray:
    """Return (N,) contrasts times the window's size over the largest; see `window_contrast`."""
    contrast, window = window_contrast(centre, means, np.array(config.windows, dtype=float))
    return contrast * window / config.largest_window


def _drawn(
    image_points: FloatArray, values: FloatArray, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return images of where a value was measured, 1 or 0, and of the values, else 0.

    Args:
        image_points: (M, 2 or more) columns and rows [px].
        values: (M,) values; NaN where there is none.
        shape: Shape of the images.
    """
    columns, rows = pixels(image_points)
    measured = np.isfinite(values)
    measured &= (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
    mask, image = np.zeros(shape[:2]), np.zeros(shape[:2])
    mask[rows[measured], columns[measured]] = 1.0
    image[rows[measured], columns[measured]] = values[measured]
    return mask, image


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
    """Return (N,) around which of the chosen points the image shows one smooth surface.

    A plane is fitted to the disparities measured in a window, by sums over boxes.
    """
    columns, rows = pixels(seen[chosen])
    mask, disparity = _drawn(seen, seen[:, 2], shape)
    down, right = np.indices(shape[:2], dtype=float)
    box, flags = (config.surface_window, config.surface_window), cv2.BORDER_CONSTANT

    def summed(values: FloatArray) -> FloatArray:
        total = cv2.boxFilter(mask * values, cv2.CV_64F, box, normalize=False, borderType=flags)
        return np.asarray(total, dtype=float)[rows, columns]

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


def _mean(image: NDArray[np.float32], window: int) -> NDArray[np.float32]:
    return np.asarray(
        cv2.blur(image, (window, window), borderType=cv2.BORDER_REFLECT_101), dtype=np.float32
    )


@numba.njit(cache=True)
def inverse_radius(
    points: Any, certainties: Any, centres: Any, own: Any, shell: float, shells: int
) -> Any:
    """Return 1 / r of the thesis' f: r is where certainty, falling from a centre, stops falling.

    Args:
        points: (M, 3) all that is measured [m].
        certainties: (M,) certainties of all measured points; an empty shell has 0.
        centres: (N, 3) candidates [m].
        own: (N,) certainties of the candidates.
        shell: Thickness of a shell [m].
        shells: Number of shells.

    Returns:
        (N,) inverse radii in shells, 1 / shells to 1.
    """
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
