"""The part of ``ch3-stereo`` on camera motion: how its error accumulates (figure 3-24).

Geometry only: fiducials are random points in view at a mean distance, their image points are
drawn with noise, and the camera moves and turns as an arm would move it. Chained motions use fresh
fiducials at every step, as the thesis did; the map of persistent fiducials registers every view to
what stays in view, so that its error should stop growing.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.figures import error_figure
from experiments.ch3.motion.scores import Followed, millimetres, normalised_error
from experiments.ch3.stereo.scene import HEAD
from experiments.harness import contract
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray
from perception.registration.fiducial_map import FiducialMap
from perception.registration.motion import SOLVERS, RegistrationError, estimate_motion
from perception.registration.reprojection import Sighting
from perception.stereo.geometry import StereoGeometry

STEPS = 30
REPORTED = (1, 5, 15, 30)
RANGES = {"1100mm": 1.1, "350mm": 0.35}  # Mean distance of the fiducials [m]
DEPTH_SHARE = 0.2  # Depths are within this share of the mean distance.
FEW, MANY = 6, 30
PERSISTENT = "persistent"
FOLLOWED = (*SOLVERS, PERSISTENT)
SPARE = 6  # Fiducials of the map in view beyond those measured, so that a next view has enough.
COARSE = 0.25
"""Image noise [px] at which the thesis' solvers are compared; its cameras may have had as much."""
FINE = 0.05
"""Image noise [px] of the tracker here on rendered pairs, see `rendered`."""

COLUMNS = (
    "range",
    "fiducials",
    "image_noise_px",
    "solver",
    "steps",
    "median_mm",
    "low_mm",
    "high_mm",
    "rms_mm",
    "runs",
)
RATIO_BOUND = 0.1
GROWTH_BOUND = 1.5
BORDER = 10.0  # Width that tracking needs around a fiducial [px]
SHIFT, TURN = 0.055, np.radians(8.0)
"""Standard deviations, in the long run, of the camera's position along each axis over the mean
distance of the fiducials (6 cm at 1.1 m), and of its rotation about each axis [rad]."""
MEMORY = 0.9
"""Correlation of one step with the last; 0.9 makes steps 0.45 of the deviations."""


@dataclasses.dataclass(frozen=True)
class CameraTrial:
    """One random motion of a camera.

    Attributes:
        seed: Random seed of motion, points and noise.
        range: Mean distance of the fiducials, a key of `RANGES`.
        fiducials: Number of fiducials in a view.
        sigma: Image noise [px].
        steps: Number of motions.
    """

    seed: int
    range: str
    fiducials: int
    sigma: float
    steps: int = STEPS


def measure_motion(options: contract.RepeatedOptions, output: Output) -> None:
    """Sweep over ranges, numbers of fiducials, noise and seeds; measure and draw.

    Args:
        options: ``quick`` takes 6 seeds instead of 100, and the coarse noise alone.
        output: Receives ``motion_error_mm/<solver>/<range>/<steps>`` and the quantities derived
            from them, the table ``motion_error`` and the figure ``figure_3-24``.
    """
    noises = (COARSE,) if options.quick else (COARSE, FINE)
    cases = [(name, count, sigma) for sigma in noises for count in (FEW, MANY) for name in RANGES]
    configs = [CameraTrial(seed, *case) for case in cases for seed in options.job_seeds(100, 6)]
    results = sweep(accumulate, configs, options, output, label="motions")
    each = len(results) // len(cases)
    groups = {case: results[i * each : (i + 1) * each] for i, case in enumerate(cases)}
    rows = [row for case, group in groups.items() for row in _measure_errors(group, *case, output)]
    output.table("motion_error", COLUMNS, rows)
    _check({name: groups[name, FEW, COARSE] for name in RANGES}, output)
    drawn = {(name, count): groups[name, count, COARSE] for name in RANGES for count in (FEW, MANY)}
    output.figure("figure_3-24", error_figure(drawn, FOLLOWED, COARSE))


def draw_motion(rng: np.random.Generator, steps: int, distance: float) -> list[RigidTransform]:
    """Draw a random motion about the first pose; each step forgets a little of the last.

    Shifts scale with the distance, so that successive views overlap as much far away as near.

    Args:
        rng: Random generator for the motion.
        steps: Number of motions.
        distance: Mean distance of the fiducials [m].

    Returns:
        steps + 1 poses of the camera in the first one's frame.
    """
    scale = np.repeat([TURN, SHIFT * distance], 3)
    away, poses = np.zeros(6), [RigidTransform.identity()]
    for _ in range(steps):
        away = MEMORY * away + np.sqrt(1.0 - MEMORY**2) * rng.standard_normal(6)
        poses.append(RigidTransform.from_exp_coords(scale * away))
    return poses


def accumulate(trial: CameraTrial) -> Followed:
    """Move a camera and follow it by every solver and by the map; a job of the sweep."""
    streams = np.random.SeedSequence(trial.seed).spawn(3)
    path, chain, world = (np.random.default_rng(stream) for stream in streams)
    distance = RANGES[trial.range]
    poses = draw_motion(path, trial.steps, distance)
    chained = follow_by_motions(poses, distance, trial.fiducials, trial.sigma, chain)
    mapped = follow_by_map(poses, distance, trial.fiducials, trial.sigma, world)
    return Followed(chained.errors | mapped.errors, chained.nees | mapped.nees)


def follow_by_motions(
    poses: Sequence[RigidTransform],
    distance: float,
    count: int,
    sigma: float,
    rng: np.random.Generator,
) -> Followed:
    """Chain the motions that each solver estimates, all from the same image points.

    Args:
        poses: Transforms from camera to world, the first the identity.
        distance: Mean distance of the fiducials [m].
        count: Number of fresh fiducials a step.
        sigma: Image noise [px].
        rng: Random generator for fiducials and noise.
    """
    chained = {solver: RigidTransform.identity() for solver in SOLVERS}
    errors = {solver: np.full(len(poses) - 1, np.inf) for solver in SOLVERS}
    nees = np.full(len(poses) - 1, np.nan)
    lost: set[str] = set()
    for step, (last, pose) in enumerate(zip(poses[:-1], poses[1:], strict=True)):
        motion = last.inv() * pose
        points = points_in_both_views(rng, motion, distance, count)
        deviations = np.full(points.shape, sigma)
        views = HEAD.project(points), HEAD.project(motion.apply(points, inverse=True))
        before, after = (
            Sighting(view + sigma * rng.standard_normal(view.shape), deviations, HEAD)
            for view in views
        )
        for solver in SOLVERS:
            if solver in lost:
                continue
            try:
                found = estimate_motion(solver, before, after, reject=solver == "ml", rng=rng)
            except RegistrationError:
                lost.add(solver)
                continue
            chained[solver] = chained[solver] * found.transform_after_to_before
            errors[solver][step] = millimetres(chained[solver], pose)
            if solver == "ml":
                nees[step] = normalised_error(
                    found.transform_after_to_before, motion, found.covariance
                )
    return Followed(errors, {"ml": nees})


def follow_by_map(
    poses: Sequence[RigidTransform],
    distance: float,
    count: int,
    sigma: float,
    rng: np.random.Generator,
) -> Followed:
    """Register each view to a growing map of fiducials that stay.

    A view measures at most `count` fiducials of the map, those known best, to be registered; new
    ones are added until some are to spare for the next view.

    Args:
        poses: Transforms from camera to world, the first the identity.
        distance: Mean distance of the fiducials from the first pose [m].
        count: Number of fiducials measured in a view.
        sigma: Image noise [px].
        rng: Random generator for fiducials and noise.
    """
    truth = _surroundings(rng, distance, 15.0 if count <= FEW else 2.5 * count)
    fiducials = FiducialMap(HEAD, np.full(3, sigma))
    numbers = np.full(len(truth), -1)  # Index of each true point in the map.
    errors, nees = np.full(len(poses) - 1, np.inf), np.full(len(poses) - 1, np.nan)
    for step, pose in enumerate(poses):
        image = HEAD.project(pose.apply(truth, inverse=True))
        image = image + sigma * rng.standard_normal(image.shape)
        visible = np.flatnonzero(in_both_images(HEAD, image, BORDER))
        known, new = visible[numbers[visible] >= 0], visible[numbers[visible] < 0]
        new = new[: max(count + SPARE - len(known), 0)]
        if step == 0:
            numbers[new] = fiducials.add(image[new], pose)
            continue
        variance = np.trace(fiducials.covariances(), axis1=1, axis2=2)
        known = known[np.argsort(variance[numbers[known]], kind="stable")][:count]
        try:
            seen = fiducials.observe(numbers[known], image[known], new=image[new], rng=rng)
        except RegistrationError:
            continue  # Too few are in view; a later view may be registered again.
        numbers[new] = seen.added
        registration = seen.registration
        errors[step - 1] = millimetres(registration.transform_camera_to_world, pose)
        nees[step - 1] = normalised_error(
            registration.transform_camera_to_world, pose, registration.covariance
        )
    return Followed({PERSISTENT: errors}, {PERSISTENT: nees})


def points_in_both_views(
    rng: np.random.Generator, motion: RigidTransform, distance: float, count: int
) -> FloatArray:
    """Return (count, 3) random points [m] in view before and after, in the frame before.

    Args:
        rng: Random generator for the points.
        motion: Transform from the camera after the motion to the camera before it.
        distance: Mean depth [m].
        count: Number of points.

    Raises:
        ValueError: If the two views hardly overlap.
    """
    found = np.zeros((0, 3))
    for _ in range(100):
        depths = distance * rng.uniform(1.0 - DEPTH_SHARE, 1.0 + DEPTH_SHARE, 4 * count)
        image = np.column_stack(
            [
                rng.uniform(0.0, HEAD.width, 4 * count),
                rng.uniform(0.0, HEAD.height, 4 * count),
                HEAD.fx * HEAD.baseline / depths,
            ]
        )
        points = HEAD.points(image[in_both_images(HEAD, image, BORDER)])
        again = HEAD.project(motion.apply(points, inverse=True))
        found = np.concatenate([found, points[in_both_images(HEAD, again, BORDER)]])
        if len(found) >= count:
            return found[:count]
    raise ValueError(f"two views overlap too little for {count} fiducials at {distance} m")


def in_both_images(
    geometry: StereoGeometry, image_points: FloatArray, border: float
) -> NDArray[np.bool_]:
    """Return (N,) which points both cameras see, away from the border.

    Args:
        geometry: Geometry of the stereo pair.
        image_points: (N, 3) columns, rows and disparities [px].
        border: Least distance from the border of either image [px].
    """
    columns, rows, disparities = image_points.T
    inside = (columns - disparities > border) & (columns < geometry.width - border)
    return inside & (rows > border) & (rows < geometry.height - border)


def _surroundings(rng: np.random.Generator, distance: float, in_view: float) -> FloatArray:
    """Draw (N, 3) points around a view, so that about so many are in one view."""
    depth = np.array([1.0 - DEPTH_SHARE, 1.0 + DEPTH_SHARE]) * distance
    half = np.tan(np.radians([40.0, 35.0])) * distance + 0.1
    view = np.array([HEAD.width / HEAD.fx, HEAD.height / HEAD.fy]) / 2.0 * distance
    count = int(in_view * np.prod(half / view))
    low, high = [-half[0], -half[1], depth[0]], [half[0], half[1], depth[1]]
    return rng.uniform(low, high, (count, 3))


def _measure_errors(
    group: Sequence[Followed], name: str, count: int, sigma: float, output: Output
) -> list[list[Any]]:
    """Store the errors of one case, with its number of fiducials and noise if not the usual.

    Returns:
        A row of the table for each solver and reported step.
    """
    rows: list[list[Any]] = []
    suffix = "" if count == FEW else f"_{count}"
    prefix = "motion_error_mm" if sigma == COARSE else f"motion_error_mm_at_{sigma:g}px"
    for solver in FOLLOWED:
        errors = np.array([result.errors[solver] for result in group])
        for steps in REPORTED:
            reached = errors[:, steps - 1]
            summary = distribution(reached)
            output.measure(f"{prefix}/{solver}{suffix}/{name}/{steps}", summary)
            interval = [summary[key] for key in ("median", "low", "high")]
            square = float(np.sqrt(np.mean(reached**2)))
            rows.append([name, count, sigma, solver, steps, *interval, square, summary["n"]])
        lost = fraction(int(np.isinf(errors).sum()), errors.size)
        output.measure(f"{prefix}/views_lost/{solver}{suffix}/{name}", lost)
    for solver in ("ml", PERSISTENT):
        values = np.array([result.nees[solver] for result in group])
        kind = prefix.replace("error_mm", "nees")
        output.measure(f"{kind}/{solver}{suffix}/{name}", float(np.nanmean(values)))
    return rows


def _check(groups: Mapping[str, Sequence[Followed]], output: Output) -> None:
    """Hold likelihood against the linear solution, and the map against its own start, by range."""

    def median(solver: str, steps: int, name: str) -> float:
        return float(np.median([result.errors[solver][steps - 1] for result in groups[name]]))

    ratio = median("ml", 15, "1100mm") / median("linear", 15, "1100mm")
    output.measure("motion_error_ratio/ml_over_linear", ratio)
    subject, bound = "error of ml over linear at 1100 mm after 15 steps", f"<= {RATIO_BOUND:g}"
    output.check(subject, ratio, bound, ratio <= RATIO_BOUND)
    for name in groups:
        growth = median(PERSISTENT, 30, name) / median(PERSISTENT, 5, name)
        output.measure(f"motion_error_ratio/persistent_30_over_5/{name}", growth)
        subject = f"error with persistent fiducials at {name}, step 30 over step 5"
        output.check(subject, growth, f"<= {GROWTH_BOUND:g}", growth <= GROWTH_BOUND)
