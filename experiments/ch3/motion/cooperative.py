"""Cooperative stereo (section 6.2 (a)), a part of ``ch3-stereo``: two heads triangulate together.

Geometry alone here: two robots view points and a target about 1.1 m away from either side, and
their image points are drawn with noise. `cooperative_rendered` does the same on rendered images.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.cooperative_rendered import measure_rendered
from experiments.ch3.motion.figures import cooperative_figure
from experiments.ch3.motion.scores import Triangulated, found_or_none, fuse_sightings, rms
from experiments.ch3.stereo.scene import HEAD, look_at
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.clutter import MARKERS
from perception.geometry.arrays import FloatArray
from perception.registration.cooperative import (
    RelativePose,
    SharedPoints,
    relative_pose_by_target,
    triangulate_together,
)
from perception.registration.reprojection import Sighting

DISTANCE = 1.1  # Distance of either left camera from the middle of the points [m]
EXTENT = 0.2  # Greatest distance of a point from that middle along each axis [m]
FEW, MANY = 6, 20
NOISE = {"0.25px": (0.25, 0.25, 0.25), "measured": (0.1, 0.1, 0.03)}
"""Standard deviations of column, row and disparity [px]: those of READINGS' prototypes, and those
of `find_target` and `StereoMatcher` on rendered pairs."""

CASES = ("single", "fused", f"bundle_{FEW}", f"bundle_{MANY}", "target", "perfect")
JOINT = CASES[2:]
"""Cases that give the covariance of all points together."""
CHECKED = (f"bundle_{FEW}", f"bundle_{MANY}", "bundle", "target")
NEES_BOUNDS = (0.5, 2.0)
MARKER_POINTS = np.array([[marker.x, marker.y, 0.0] for marker in MARKERS])
FACING = RigidTransform.from_exp_coords([np.pi / 2.0, 0.0, 0.0, 0.0, 0.0, 0.0])
"""Pose of a panel that faces between the robots (z out of it, y up)."""
COLUMNS = ("data", "case", "median_mm", "low_mm", "high_mm", "nees", "runs")


def measure_cooperation(options: contract.RepeatedOptions, output: Output) -> None:
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
    groups: dict[str, Sequence[Triangulated]] = {
        noise: [r for c, r in zip(configs, results, strict=True) if c.noise == noise]
        for noise in NOISE
    }
    rows = [row for name, runs in groups.items() for row in report_cases(runs, name, output)]
    groups["rendered"] = rendered = measure_rendered(options, output)
    rows += report_cases(rendered, "rendered", output)
    output.table("cooperative_stereo", COLUMNS, rows)
    figure = cooperative_figure(groups, rendered[0].images, rendered[0].matches)
    output.figure("cooperative_stereo", figure)


def report_cases(runs: Sequence[Triangulated], name: str, output: Output) -> list[list[Any]]:
    """Store each case's errors with one kind of data, and return rows of the table.

    Args:
        runs: Triangulated scenes.
        name: Name of the noise.
        output: Receives the metrics.
    """
    rows: list[list[Any]] = []
    alone = np.median([run.errors["single"] for run in runs])
    for case in runs[0].errors:
        values = np.array([run.errors[case] for run in runs])
        nees = np.array([run.nees[case] for run in runs])
        summary = distribution(values)
        output.measure(f"cooperative_error_mm/{case}/{name}", summary)
        failed = int(np.isinf(values).sum())
        output.measure(f"cooperative_failed_fraction/{case}/{name}", fraction(failed, len(values)))
        if case != "single":
            output.measure(f"cooperative_gain/{case}/{name}", float(alone / summary["median"]))
        consistent = float("nan")
        if np.isfinite(nees).any():
            consistent = float(np.nanmean(nees))
            output.measure(f"cooperative_nees/{case}/{name}", consistent)
            if case in CHECKED:
                subject = (
                    f"squared error of points over its expectation, cooperative {case}, {name}"
                )
                output.check_within(subject, consistent, NEES_BOUNDS)
        interval = [summary[key] for key in ("median", "low", "high")]
        rows.append([name, case, *interval, consistent, summary["n"]])
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


def triangulate_drawn(trial: CooperativeTrial) -> Triangulated:
    """Draw two robots, points and noise, and triangulate in every way; a job of the sweep.

    The points are the six or twenty shared ones that fix the pose as well (``bundle_...``), those
    of the twenty that are not among the six that fix it (``fused``), and the twenty otherwise.
    """
    rng = np.random.default_rng(trial.seed)
    sigma = np.array(NOISE[trial.noise])
    first, second = (_camera(side, rng) for side in (-1.0, 1.0))
    truth = first.inv() * second
    turn = RigidTransform.from_exp_coords([*rng.uniform(-0.3, 0.3, 3), 0.0, 0.0, 0.0])
    target = FACING * turn
    points = first.apply(rng.uniform(-EXTENT, EXTENT, (MANY, 3)), inverse=True)
    seen = [_seen(points, camera, sigma, rng) for camera in (RigidTransform.identity(), truth)]
    marked = [_seen(target.apply(MARKER_POINTS), camera, sigma, rng) for camera in (first, second)]
    result = Triangulated(dict.fromkeys(CASES, np.inf), dict.fromkeys(CASES, np.nan))

    def attempt(case: str, count: int, prior: RelativePose | None) -> SharedPoints | None:
        one, other = (sight.chosen(np.arange(MANY) < count) for sight in seen)
        shared = found_or_none(triangulate_together, one, other, prior)
        if shared is not None:
            result.score_shared(case, shared, points[:count])
        return shared

    result.errors["single"] = rms(HEAD.points(seen[0].image_points) - points)
    few = attempt(f"bundle_{FEW}", FEW, None)
    attempt(f"bundle_{MANY}", MANY, None)
    attempt("perfect", MANY, RelativePose(truth, np.zeros((6, 6))))
    if few is not None:
        one, other = (sight.chosen(np.arange(MANY) >= FEW) for sight in seen)
        result.score_fused("fused", fuse_sightings(one, other, few.relative), points[FEW:])
    prior = found_or_none(
        relative_pose_by_target, marked[0], MARKER_POINTS, marked[1], MARKER_POINTS
    )
    if prior is not None:
        attempt("target", MANY, prior)
    return result


def _camera(side: float, rng: np.random.Generator) -> RigidTransform:
    """Draw the left camera on one side (-1 or 1), in a frame about the middle of the points."""
    bearing, height = side * rng.uniform(0.40, 0.70), rng.uniform(0.2, 0.5)
    away = [np.sin(bearing) * np.cos(height), -np.cos(bearing) * np.cos(height), np.sin(height)]
    return look_at(DISTANCE * np.array(away), np.zeros(3))


def _seen(
    points: FloatArray, camera: RigidTransform, sigma: FloatArray, rng: np.random.Generator
) -> Sighting:
    exact = HEAD.project(camera.apply(points, inverse=True))
    noisy = exact + sigma * rng.standard_normal(exact.shape)
    return Sighting(noisy, np.broadcast_to(sigma, exact.shape).copy(), HEAD)
