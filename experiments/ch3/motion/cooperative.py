"""Cooperative stereo (section 6.2 (a)), a part of ``ch3-stereo``: two heads triangulate together.

Geometry alone here: two robots look from either side at points and a target about 1.1 m away, and
their image points are drawn with noise. `cooperative_rendered` does the same on pictures.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.cooperative_rendered import measure_rendered
from experiments.ch3.motion.figures import cooperative_figure
from experiments.ch3.motion.motion import HEAD
from experiments.ch3.motion.scores import joint_nees, rms, single_nees
from experiments.ch3.stereo.scene import look_at
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.clutter import MARKERS
from perception.geometry.arrays import FloatArray
from perception.registration.cooperative import (
    RelativePose,
    SharedPoints,
    fuse_views,
    relative_pose_by_target,
    triangulate_together,
)
from perception.registration.motion import RegistrationError
from perception.registration.reprojection import Sighting

DISTANCE = 1.1  # From either left camera to the middle of what both look at [m]
SPREAD = 0.2  # Points are as far from that along each axis at most [m].
FEW, MANY = 6, 20
NOISE = {"0.25px": (0.25, 0.25, 0.25), "measured": (0.1, 0.1, 0.03)}
"""Deviations of column, row and disparity [px]: of READINGS' prototypes, and what `find_target` and
`StereoMatcher` reach on rendered pairs."""

CASES = ("single", "fused", f"bundle_{FEW}", f"bundle_{MANY}", "target", "perfect")
JOINT = CASES[2:]
"""Cases that give the covariance of all points together."""
CHECKED = (f"bundle_{FEW}", f"bundle_{MANY}", "bundle", "target")
NEES_BOUNDS = (0.5, 2.0)
MARKER_POINTS = np.array([[marker.x, marker.y, 0.0] for marker in MARKERS])
COLUMNS = ("data", "case", "median_mm", "low_mm", "high_mm", "nees", "runs")


def measure_cooperation(options: contract.Options, output: Output) -> None:
    """Compare ways to triangulate from two robots; measure, tabulate and draw.

    Args:
        options: ``quick`` draws 10 runs instead of 100 and renders 1 scene instead of 8.
        output: Receives ``cooperative_error_mm/<case>/<noise>``, ``cooperative_nees/...``,
            ``cooperative_gain/...``, the table ``cooperative_stereo`` and the figure of that name;
            noise is a key of `NOISE` or ``rendered``.
    """
    configs = [
        CooperativeTrial(seed, noise) for noise in NOISE for seed in options.job_seeds(100, 10)
    ]
    results = sweep(triangulate_drawn, configs, options, output, label="cooperative stereo")
    groups: dict[str, dict[str, FloatArray]] = {}
    rows: list[list[Any]] = []
    for noise in NOISE:
        chosen = [r for c, r in zip(configs, results, strict=True) if c.noise == noise]
        groups[noise] = {case: np.array([r.errors[case] for r in chosen]) for case in CASES}
        nees = {case: np.array([r.nees[case] for r in chosen]) for case in CASES[1:]}
        rows += report_cases(groups[noise], nees, noise, output)
    rendered = measure_rendered(options, output)
    rows += report_cases(rendered.errors, rendered.nees, "rendered", output)
    output.table("cooperative_stereo", COLUMNS, rows)
    groups["rendered"] = rendered.errors
    figure = cooperative_figure(groups, rendered.images, rendered.matches)
    output.figure("cooperative_stereo", figure)


def report_cases(
    errors: Mapping[str, FloatArray], nees: Mapping[str, FloatArray], name: str, output: Output
) -> list[list[Any]]:
    """Store each case's errors with one kind of data, and return rows of the table.

    Args:
        errors: (runs,) r.m.s. errors of points [mm] by case; infinite where it failed.
        nees: (runs,) squared errors of points over their covariance, per degree of freedom.
        name: Name of the noise.
        output: Receives the metrics.
    """
    rows: list[list[Any]] = []
    for case, values in errors.items():
        summary = distribution(values)
        output.measure(f"cooperative_error_mm/{case}/{name}", summary)
        failed = int(np.isinf(values).sum())
        output.measure(f"cooperative_failed_fraction/{case}/{name}", fraction(failed, len(values)))
        gain = np.median(errors["single"]) / summary["median"]
        if case != "single":
            output.measure(f"cooperative_gain/{case}/{name}", float(gain))
        row = [name, case, summary["median"], summary["low"], summary["high"]]
        consistent = float("nan")
        if case in nees and np.isfinite(nees[case]).any():
            consistent = float(np.nanmean(nees[case]))
            output.measure(f"cooperative_nees/{case}/{name}", consistent)
            if case in CHECKED:
                low, high = NEES_BOUNDS
                output.check(
                    f"squared error of points over its expectation, cooperative {case}, {name}",
                    consistent,
                    f"{low:g} to {high:g}",
                    low <= consistent <= high,
                )
        rows.append([*row, consistent, summary["n"]])
    return rows


@dataclasses.dataclass(frozen=True)
class CooperativeTrial:
    """One drawn scene.

    Attributes:
        seed: Random seed of robots, points and noise.
        noise: Noise of the image points, a key of `NOISE`.
    """

    seed: int
    noise: str


@dataclasses.dataclass
class CooperativeRun:
    """One drawn scene, triangulated in every way.

    The points are the six or twenty shared ones that fix the pose as well (``bundle_...``), those
    of the twenty that are not among the six that fix it (``fused``), and the twenty otherwise.

    Attributes:
        errors: R.m.s. error of the points by case [mm]; infinite where it failed.
        nees: Squared error over its covariance per degree of freedom by case; NaN where it failed.
    """

    errors: dict[str, float]
    nees: dict[str, float]


def triangulate_drawn(trial: CooperativeTrial) -> CooperativeRun:
    """Draw two robots, points and noise, and triangulate in every way; a job of the sweep."""
    rng = np.random.default_rng(trial.seed)
    sigma = np.array(NOISE[trial.noise])
    first, second = _robots(rng)
    truth = first.inv() * second
    target = RigidTransform.from_exp_coords([*rng.uniform(-0.3, 0.3, 3), 0.0, 0.0, 0.0])
    target = _facing() * target
    points = first.apply(rng.uniform(-SPREAD, SPREAD, (MANY, 3)), inverse=True)
    seen = [_seen(points, camera, sigma, rng) for camera in (RigidTransform.identity(), truth)]
    marked = [_seen(target.apply(MARKER_POINTS), camera, sigma, rng) for camera in (first, second)]
    result = CooperativeRun(dict.fromkeys(CASES, np.inf), dict.fromkeys(CASES, np.nan))

    def score(case: str, found: FloatArray, true: FloatArray, nees: float) -> None:
        result.errors[case], result.nees[case] = rms(found - true), nees

    def attempt(case: str, count: int, prior: RelativePose | None) -> SharedPoints | None:
        chosen = np.arange(MANY) < count
        try:
            shared = triangulate_together(seen[0].chosen(chosen), seen[1].chosen(chosen), prior)
        except RegistrationError:
            return None
        score(
            case, shared.points, points[:count][shared.inliers], joint_nees(shared, points[:count])
        )
        return shared

    score("single", HEAD.points(seen[0].image_points), points, np.nan)
    few = attempt(f"bundle_{FEW}", FEW, None)
    attempt(f"bundle_{MANY}", MANY, None)
    attempt("perfect", MANY, RelativePose(truth, np.zeros((6, 6))))
    if few is not None:
        fused, covariances = _fused(seen, np.arange(MANY) >= FEW, few.relative)
        score("fused", fused, points[FEW:], single_nees(fused - points[FEW:], covariances))
    try:
        prior = relative_pose_by_target(marked[0], MARKER_POINTS, marked[1], MARKER_POINTS)
    except RegistrationError:
        return result
    attempt("target", MANY, prior)
    return result


def _robots(rng: np.random.Generator) -> tuple[RigidTransform, RigidTransform]:
    """Return two left cameras on either side, in a frame about what they look at."""
    cameras: list[RigidTransform] = []
    for side in (-1.0, 1.0):
        bearing, height = side * rng.uniform(0.40, 0.70), rng.uniform(0.2, 0.5)
        away = [np.sin(bearing) * np.cos(height), -np.cos(bearing) * np.cos(height), np.sin(height)]
        cameras.append(look_at(DISTANCE * np.array(away), np.zeros(3)))
    return cameras[0], cameras[1]


def _facing() -> RigidTransform:
    """Return the pose of a panel that faces between the robots (z out of it, y up)."""
    return RigidTransform.from_exp_coords([np.pi / 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def _seen(
    points: FloatArray, camera: RigidTransform, sigma: FloatArray, rng: np.random.Generator
) -> Sighting:
    exact = HEAD.project(camera.apply(points, inverse=True))
    noisy = exact + sigma * rng.standard_normal(exact.shape)
    return Sighting(noisy, np.broadcast_to(sigma, exact.shape).copy(), HEAD)


def _fused(
    seen: Sequence[Sighting], chosen: NDArray[np.bool_], relative: RelativePose
) -> tuple[FloatArray, FloatArray]:
    """Return points and covariances of those that had no part in the relative pose."""
    points = [HEAD.points(sight.image_points[chosen]) for sight in seen]
    covariances = [
        HEAD.covariance(local, sight.sigma[chosen])
        for local, sight in zip(points, seen, strict=True)
    ]
    fused = fuse_views(points[0], covariances[0], points[1], covariances[1], relative)
    return fused.points, fused.covariances
