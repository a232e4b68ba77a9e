"""Depth noise of the stereo heads, a part of ``ch3-stereo``: how well eq. 3-6 holds.

A free rig takes pairs of the cluttered scenes from 0.35 to 2 m, and the rovers' arms from their
home posture. Every matched point is held against the exact depth of its pixel.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import stats

from experiments.ch3.stereo.scene import RIG, StereoScene, look_at
from experiments.harness.contract import RepeatedOptions
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import BoolArray, FloatArray
from perception.stereo.geometry import StereoGeometry
from perception.stereo.matching import StereoMatcher, StereoMatcherConfig

RANGES = (0.35, 0.5, 0.7, 1.0, 1.4, 2.0)  # Distances of the rig from the point that it faces [m]
EDGES = np.geomspace(0.35, 2.0, 9)  # Edges of the bins of depth [m]
ELEVATIONS = (np.deg2rad(35.0), np.deg2rad(60.0))  # Elevations of the rig above that point [rad]
POINTS = 1500  # Number of points scored in each view
GROSS = 1.0  # Errors beyond this are outliers [px].
LEAST_IN_BIN = 30
SLOPE_BOUNDS = (1.8, 2.2)
NEES_BOUNDS = (0.5, 2.0)
METHODS = ("refined", "bm", "sgbm")
LABELS = {"refined": "ours", "bm": "StereoBM", "sgbm": "StereoSGBM"}


def measure_noise(options: RepeatedOptions, output: Output) -> None:
    """Measure disparity and depth noise and hold them against eq. 3-6.

    Args:
        options: ``job_seeds`` gives 8 scenes, 2 when quick.
        output: Receives ``depth_sigma_slope``, ``depth_nees``, ``disparity_sigma_px/...``,
            ``disparity_outlier_fraction/...`` and the figure ``depth_sigma``.
    """
    ranges = RANGES[::2] if options.quick else 2 * RANGES
    configs = [StereoNoiseTrial(seed, ranges) for seed in options.job_seeds(8, 2)]
    scenes = sweep(measure_scene, configs, options, output, label="stereo scenes")
    report(scenes, output)


@dataclasses.dataclass(frozen=True)
class StereoNoiseTrial:
    """One scene to measure.

    Attributes:
        seed: Random seed of the scene and of the views.
        ranges: Distances of the rig from the points that it faces [m].
    """

    seed: int
    ranges: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class StereoNoise:
    """Errors of the stereo over the scored points of one view, or pooled over several.

    Attributes:
        focal_baseline: Focal length times baseline of the heads [px m].
        depth: (n,) true depth [m].
        predicted: (n,) predicted standard deviation of the depth [m].
        arm: (n,) whether the point is of a view by an arm; others are by the rig.
        errors: (n,) error of the disparity by each matcher [px]; NaN where it has none.
        matched: Share of the pixels that each matcher matches.
        bare: Number of points that show no surface.
    """

    focal_baseline: float
    depth: FloatArray
    predicted: FloatArray
    arm: BoolArray
    errors: dict[str, FloatArray]
    matched: dict[str, float]
    bare: int

    def depth_errors(self, method: str) -> tuple[FloatArray, FloatArray]:
        """Return (m,) depths and (m,) their errors [m] where a matcher has a disparity (3-3)."""
        known = np.isfinite(self.errors[method])
        depth, error = self.depth[known], self.errors[method][known]
        return depth, self.focal_baseline / (self.focal_baseline / depth + error) - depth


def measure_scene(trial: StereoNoiseTrial) -> StereoNoise:
    """Score the stereo of one scene; a job of the sweep."""
    scene = StereoScene(trial.seed)
    matcher = StereoMatcher(scene.geometry)
    rng = np.random.default_rng(np.random.SeedSequence((trial.seed, 3)))
    views: list[StereoNoise] = []
    for distance in trial.ranges:
        place_rig(scene, distance, rng)
        views.append(score_view(scene, RIG, matcher, rng))
    return pooled_noise([*views, *(score_view(scene, n, matcher, rng) for n in scene.robot_names)])


def pooled_noise(parts: Sequence[StereoNoise]) -> StereoNoise:
    """Return the points of several views or scenes as one."""
    return StereoNoise(
        focal_baseline=parts[0].focal_baseline,
        depth=np.concatenate([part.depth for part in parts]),
        predicted=np.concatenate([part.predicted for part in parts]),
        arm=np.concatenate([part.arm for part in parts]),
        errors={m: np.concatenate([part.errors[m] for part in parts]) for m in METHODS},
        matched={m: float(np.mean([part.matched[m] for part in parts])) for m in METHODS},
        bare=sum(part.bare for part in parts),
    )


def place_rig(scene: StereoScene, distance: float, rng: np.random.Generator) -> None:
    """Draw a pose of the free rig with an open view of the ground.

    Args:
        scene: Scene whose rig is moved.
        distance: Distance from the point that the rig faces [m].
        rng: Random generator for that point and the direction from it.

    Raises:
        RuntimeError: If no open view is found, which a sparse field excludes.
    """
    grid = np.stack(np.meshgrid(np.linspace(5, 505, 8), np.linspace(5, 487, 8)), -1).reshape(-1, 2)
    for _ in range(200):
        target = np.array([*rng.uniform(-0.8, 0.8, 2), 0.02])
        elevation, azimuth = rng.uniform(*ELEVATIONS), rng.uniform(-np.pi, np.pi)
        level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) * np.cos(elevation)
        eye = target + distance * (level + [0.0, 0.0, np.sin(elevation)])
        scene.set_rig(look_at(eye, target))
        depths = scene.true_depths(RIG, grid)
        if np.nanmin(depths) > 0.6 * distance:
            return
    raise RuntimeError(f"no open view from {distance} m in scene {scene.seed}")


def score_view(
    scene: StereoScene, name: str, matcher: StereoMatcher, rng: np.random.Generator
) -> StereoNoise:
    """Capture a pair, match it in three ways and compare with the truth.

    Args:
        scene: Scene with the robots or the rig where they shall be.
        name: Name of the robot or of the rig.
        matcher: Our matcher.
        rng: Random generator that chooses the points to score.
    """
    pair = scene.capture(name).pair
    seen = matcher.match(pair)
    maps = {
        "bm": matcher.disparities(pair),
        "sgbm": semi_global_disparities(pair, scene.geometry, matcher.config),
    }
    chosen = rng.permutation(len(seen))[:POINTS]
    pixels = seen.pixels[chosen]
    depths = scene.true_depths(name, pixels)
    visible = np.isfinite(depths)
    pixels, depths, chosen = pixels[visible], depths[visible], chosen[visible]
    scale = scene.geometry.fx * scene.geometry.baseline
    truth = scale / depths
    columns, rows = pixels.astype(int).T
    errors = {method: disparity[rows, columns] - truth for method, disparity in maps.items()}
    errors["refined"] = seen.disparities[chosen] - truth
    matched = {m: float(np.isfinite(disparity).mean()) for m, disparity in maps.items()}
    matched["refined"] = len(seen) * matcher.config.stride**2 / pair[0].size
    predicted = np.sqrt(seen.covariances[chosen, 2, 2])
    arm = np.full(len(depths), name != RIG)
    return StereoNoise(scale, depths, predicted, arm, errors, matched, int(np.sum(~visible)))


def semi_global_disparities(
    pair: NDArray[np.uint8], geometry: StereoGeometry, config: StereoMatcherConfig
) -> FloatArray:
    """Return (H, W) disparities of OpenCV's semi-global matching [px], for comparison."""
    search = 16 * int(np.ceil((geometry.fx * geometry.baseline / config.nearest + 1.0) / 16))
    block = 5
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=search,
        blockSize=block,
        P1=8 * block**2,
        P2=32 * block**2,
        disp12MaxDiff=1,
        uniquenessRatio=config.uniqueness,
        speckleWindowSize=config.speckle,
        speckleRange=2,
    )
    padded = [cv2.copyMakeBorder(i, 0, 0, search, 0, cv2.BORDER_CONSTANT) for i in pair]
    found = np.asarray(matcher.compute(padded[0], padded[1]), dtype=float)[:, search:] / 16.0
    least = geometry.fx * geometry.baseline / config.farthest
    return np.where(found > least, found, np.nan)


def robust_sigma(errors: FloatArray) -> float:
    """Return 1.4826 times the median absolute deviation; that of a Gaussian is its sigma."""
    return float(1.4826 * np.median(np.abs(errors - np.median(errors))))


def binned_sigma(depths: FloatArray, errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return robust standard deviations by range.

    Args:
        depths: (n,) depth of each point [m].
        errors: (n,) error of each point, any unit.

    Returns:
        (bins,) median depth [m] and (bins,) deviation; NaN where there are too few points.
    """
    few = np.histogram(depths, EDGES)[0] < LEAST_IN_BIN
    middle = stats.binned_statistic(depths, depths, "median", EDGES).statistic
    sigma = stats.binned_statistic(depths, errors, robust_sigma, EDGES).statistic
    return np.where(few, np.nan, middle), np.where(few, np.nan, sigma)


def log_slope(x: FloatArray, y: FloatArray) -> float:
    """Return the least-squares slope of log y over log x, where both are known."""
    known = np.isfinite(x) & np.isfinite(y)
    return float(np.polyfit(np.log(x[known]), np.log(y[known]), 1)[0])


def report(scenes: Sequence[StereoNoise], output: Output) -> None:
    """Store metrics, checks, table and figure of `measure_scene`'s results.

    Args:
        scenes: Noise of each scene.
        output: Receives the metrics.
    """
    pooled = pooled_noise(scenes)
    _report_disparities(pooled, output)
    bare = pooled.bare / (pooled.bare + len(pooled.depth))
    output.measure("points_without_surface_fraction", bare)
    slopes = [log_slope(*binned_sigma(*scene.depth_errors("refined"))) for scene in scenes]
    summary = distribution(slopes)
    output.measure("depth_sigma_slope", summary, thesis=2.0)
    subject = "slope of log depth sigma over log range"
    output.check_within(subject, summary["median"], SLOPE_BOUNDS)
    squares = (pooled.depth_errors("refined")[1] / pooled.predicted) ** 2
    output.measure("depth_nees", float(squares.mean()))
    output.measure("depth_nees/arm", float(squares[pooled.arm].mean()))
    # The median of chi^2 with one degree of freedom is 0.4549.
    output.measure("depth_nees_by_median", float(np.median(squares) / 0.4549))
    output.measure("depth_beyond_4_sigma_fraction", float(np.mean(squares > 16.0)))
    output.check_within("squared depth error over its prediction", squares.mean(), NEES_BOUNDS)
    _report_bins(pooled, output)


def _report_disparities(pooled: StereoNoise, output: Output) -> None:
    """Store the three matchers beside each other, all at the pixels that ours keeps."""
    for method in METHODS:
        errors = pooled.errors[method][np.isfinite(pooled.errors[method])]
        small = errors[np.abs(errors) <= GROSS]
        output.measure(f"disparity_sigma_px/robust/{method}", robust_sigma(errors))
        output.measure(f"disparity_sigma_px/rms/{method}", float(np.sqrt(np.mean(small**2))))
        output.measure(f"disparity_bias_px/{method}", float(np.median(errors)))
        output.measure(f"disparity_outlier_fraction/{method}", 1.0 - len(small) / len(errors))
        output.measure(f"disparity_matched_fraction/{method}", pooled.matched[method])


def _report_bins(pooled: StereoNoise, output: Output) -> None:
    """Store, tabulate and draw the standard deviation of the depth over the range."""
    scale = pooled.focal_baseline
    sigma_px = robust_sigma(pooled.errors["refined"])
    curves = {method: binned_sigma(*pooled.depth_errors(method)) for method in METHODS}
    middle, measured = curves["refined"]
    constant = middle**2 / scale * sigma_px  # eq. 3-6 with one sigma for all ranges
    ratio = measured / constant
    output.measure("eq_3-6_ratio/worst", float(np.nanmax(np.maximum(ratio, 1.0 / ratio))))
    output.measure("eq_3-6_ratio/one_pixel", float(1.0 / sigma_px))
    columns = ("range [m]", "points", "depth sigma [mm]", "predicted [mm]", "eq. 3-6 [mm]")
    columns = (*columns, "StereoBM [mm]", "StereoSGBM [mm]")
    counts = np.histogram(pooled.depth, EDGES)[0].tolist()
    predicted = stats.binned_statistic(pooled.depth, pooled.predicted, "median", EDGES).statistic
    values = [measured, predicted, constant, curves["bm"][1], curves["sgbm"][1]]
    rows = [
        [round(float(middle[n]), 3), count, *(round(1e3 * float(v[n]), 3) for v in values)]
        for n, count in enumerate(counts)
        if count >= LEAST_IN_BIN
    ]
    output.table("depth_sigma", columns, rows)
    output.figure("depth_sigma", depth_figure(curves, scale, sigma_px))


def depth_figure(
    curves: Mapping[str, tuple[FloatArray, FloatArray]], scale: float, sigma_px: float
) -> Figure:
    """Draw the standard deviation of the depth over the range.

    Args:
        curves: Range [m] and deviation [m] by method.
        scale: Focal length times baseline [px m].
        sigma_px: Measured standard deviation of our disparities [px].
    """
    figure = Figure(figsize=(7, 5))
    axes = figure.add_subplot()
    for method, style in zip(METHODS, ("o", "s", "^"), strict=True):
        middle, sigma = curves[method]
        axes.loglog(middle, 1e3 * sigma, style, label=f"measured, {LABELS[method]}")
    line = np.geomspace(EDGES[0], EDGES[-1], 50)
    for sigma, style in ((sigma_px, "k-"), (1.0, "k--")):
        axes.loglog(line, 1e3 * line**2 / scale * sigma, style, label=f"eq. 3-6, {sigma:.3g} px")
    axes.set(xlabel="range [m]", ylabel="standard deviation of the depth [mm]")
    axes.legend()
    axes.grid(which="both", alpha=0.3)
    return figure
