"""Camera motion on rendered pairs: fiducials chosen, tracked and registered, as on the robots.

A stereo head looks at a cluttered scene from a mean distance and moves as an arm would move it.
What the arm's joints say of a motion is wrong by some millimetres and tenths of a degree; it only
starts the search. The true poses serve to score.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.figures import tracking_figure
from experiments.ch3.motion.motion import PERSISTENT, RANGES, ArmMotion
from experiments.ch3.motion.scores import Followed, millimetres, normalised_error
from experiments.ch3.stereo.scene import RIG, StereoScene, look_at
from experiments.harness import contract
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from perception.geometry.arrays import FloatArray
from perception.registration.fiducial_map import FiducialMap
from perception.registration.fiducials import FiducialConfig, select_fiducials
from perception.registration.motion import SOLVERS, RegistrationError, estimate_motion
from perception.registration.patch_matching import Tracks, track
from perception.registration.reprojection import Sighting
from perception.stereo.matching import StereoMatcher

STEPS = 15
REPORTED = (1, 5, 15)
USED = 6  # Fiducials of a motion, as in the thesis' figure 3-23.
CHOSEN = 10  # A few more are chosen, since some are lost on the way.
MAPPED = 14  # Fiducials of the map that are wanted in view.
SHOWN = 3  # Views of figure 3-23.
SIGMA = (0.03, 0.03, 0.05)
"""Deviations of a column, row and disparity [px] by which sets of fiducials are judged; each match
brings its own."""

NEAREST, RANGE_TOLERANCE = 0.6, 0.15
"""Nearest and mean depth in the first view over the range that is asked for."""

PLACE_SIGMA = 0.01
"""Deviation of the column and row of a new fiducial [px]: it is where it was chosen to be."""

ARM_DEGREES, ARM_METRES = 0.3, 0.003
"""Standard deviation of what the joints say of a step, about and along each axis."""


@dataclasses.dataclass
class _View:
    """One pose of the head: what it saw, where it was, and what the joints said of the step."""

    pair: NDArray[np.uint8]
    pose: RigidTransform
    reported: RigidTransform  # To the last view, by the arm's joints.
    measured: FloatArray  # (N, 3) columns, rows, disparities of the stereo match [px].
    sigma: FloatArray  # (N, 3) of them.


@dataclasses.dataclass(frozen=True)
class RenderedTrial:
    """One random motion of a rendered camera.

    Attributes:
        seed: Random seed of scene and motion.
        range: Mean distance of what is seen, a key of `RANGES`.
        steps: Number of motions.
    """

    seed: int
    range: str
    steps: int = STEPS


@dataclasses.dataclass(frozen=True)
class RenderedRun(Followed):
    """A rendered camera followed by every solver and by the map.

    Attributes:
        tracking: (N, 3) errors of the tracked columns, rows and disparities [px].
        sought: Number of fiducials sought.
        found: Number of fiducials tracked.
        images: (SHOWN, H, W) uint8 first left images.
        with_previous: For each image (N, 3) the fiducials tracked from the one before.
        with_next: For each image (N, 3) the fiducials tracked to the one after.
    """

    tracking: FloatArray
    sought: int
    found: int
    images: NDArray[np.uint8]
    with_previous: tuple[FloatArray, ...]
    with_next: tuple[FloatArray, ...]


def measure_rendered_motion(options: contract.Options, output: Output) -> None:
    """Follow a rendered camera over seeds and ranges; measure, and draw figure 3-23.

    Args:
        options: ``quick`` takes 1 scene instead of 8.
        output: Receives ``motion_rendered_mm/<solver>/<range>/<steps>``, ``tracking_error_px``
            and the figure ``figure_3-23``.
    """
    configs = [RenderedTrial(seed, name) for name in RANGES for seed in options.job_seeds(8, 1)]
    results = sweep(follow_rendered, configs, options, output, label="rendered motions")
    for name in RANGES:
        group = [r for c, r in zip(configs, results, strict=True) if c.range == name]
        for solver in (*SOLVERS, PERSISTENT):
            errors = np.array([result.errors[solver] for result in group])
            for steps in REPORTED:
                key = f"motion_rendered_mm/{solver}/{name}/{steps}"
                output.measure(key, distribution(errors[:, steps - 1]))
        for solver in ("ml", PERSISTENT):
            values = np.concatenate([result.nees[solver] for result in group])
            output.measure(f"motion_rendered_nees/{solver}/{name}", _median(values))
        errors = np.concatenate([result.tracking for result in group])
        for axis, column in zip(("column", "row", "disparity"), errors.T, strict=True):
            output.measure(f"tracking_error_px/{axis}/{name}", _robust_sigma(column))
        outliers = int(np.sum(np.abs(errors).max(axis=1) > 1.0))
        output.measure(f"tracking_outlier_fraction/{name}", fraction(outliers, len(errors)))
        found = sum(result.found for result in group)
        sought = sum(result.sought for result in group)
        output.measure(f"tracked_fraction/{name}", fraction(found, sought))
    shown = results[0]
    figure = tracking_figure(list(shown.images), shown.with_previous, shown.with_next)
    output.figure("figure_3-23", figure)


def follow_rendered(trial: RenderedTrial) -> RenderedRun:
    """Move a rendered camera and follow it by every solver and by the map; a job of the sweep."""
    steps = trial.steps
    views, scene = _views(trial)
    chained = {solver: RigidTransform.identity() for solver in SOLVERS}
    errors = {solver: np.full(steps, np.inf) for solver in SOLVERS}
    nees = np.full(steps, np.nan)
    tracks: list[Tracks] = []
    for step, (last, view) in enumerate(zip(views[:-1], views[1:], strict=True)):
        chosen = select_fiducials(
            last.pair[0],
            last.measured,
            scene.geometry,
            next_view=view.reported,
            config=FiducialConfig(count=CHOSEN, sigma=SIGMA),
        )
        found = track(last.pair, view.pair, chosen.image_points, scene.geometry, view.reported)
        tracks.append(found)
        motion = last.pose.inv() * view.pose
        used = _best(found)
        before, after = (
            Sighting(seen[used], found.sigma[used], scene.geometry)
            for seen in (found.before, found.after)
        )
        for solver in SOLVERS:
            try:
                estimate = estimate_motion(
                    solver,
                    before,
                    after,
                    guess=view.reported if solver == "ml" else None,
                    reject=solver == "ml",
                )
                moved = estimate.transform_after_to_before
            except RegistrationError:
                # Nothing better is known than what the joints say.
                moved = view.reported
            else:
                if solver == "ml":
                    nees[step] = normalised_error(moved, motion, estimate.covariance)
            chained[solver] = chained[solver] * moved
            errors[solver][step] = millimetres(views[0].pose * chained[solver], view.pose)
    tracking, sought = _tracking_errors(views, tracks, scene)
    mapped = _follow_by_map(views, scene)
    previous = tuple(_points(tracks, k - 1, after=True) for k in range(SHOWN))
    following = tuple(_points(tracks, k, after=False) for k in range(SHOWN))
    return RenderedRun(
        errors=errors | mapped.errors,
        nees={"ml": nees} | mapped.nees,
        tracking=tracking,
        sought=sought,
        found=len(tracking),
        images=np.array([view.pair[0] for view in views[:SHOWN]]),
        with_previous=previous,
        with_next=following,
    )


def _views(trial: RenderedTrial) -> tuple[list[_View], StereoScene]:
    """Move the free head about a random place before the panel."""
    scene = StereoScene(trial.seed)
    rng = np.random.default_rng(np.random.SeedSequence((trial.seed, 324)))
    distance = RANGES[trial.range]
    first = _first_pose(scene, distance, rng)
    matcher = StereoMatcher(scene.geometry)
    views: list[_View] = []
    for offset in ArmMotion().draw(rng, trial.steps, distance):
        scene.set_rig(first * offset)
        seen = scene.capture(RIG)
        points = matcher.match(seen.pair)
        measured = np.column_stack([points.pixels, points.disparities])
        reported = RigidTransform.identity()
        if views:
            scale = np.repeat([np.radians(ARM_DEGREES), ARM_METRES], 3)
            slip = RigidTransform.from_exp_coords(scale * rng.standard_normal(6))
            reported = slip * views[-1].pose.inv() * seen.transform_camera_to_world
        sigma = np.column_stack([np.full((len(points), 2), PLACE_SIGMA), points.sigmas])
        views.append(_View(seen.pair, seen.transform_camera_to_world, reported, measured, sigma))
    return views, scene


def _first_pose(scene: StereoScene, distance: float, rng: np.random.Generator) -> RigidTransform:
    """Draw where the free head begins: before the panel, with what it sees at the range.

    Raises:
        ExperimentError: If the scene has no such place.
    """
    size = (scene.geometry.width, scene.geometry.height)
    columns, rows = np.meshgrid(*(np.linspace(20.0, n - 20.0, 7) for n in size))
    pixels = np.column_stack([columns.ravel(), rows.ravel()])
    panel = scene.transform_panel_to_world.translation
    for _ in range(200):
        aside, ahead = rng.uniform(-0.3, 0.3), rng.uniform(0.0, 0.4)
        target = np.array([panel[0] + aside, panel[1] - ahead, 0.05])
        bearing, height = rng.uniform(-0.5, 0.5), rng.uniform(0.5, 0.8)  # [rad]
        flat = np.cos(height)
        away = np.array([np.sin(bearing) * flat, -np.cos(bearing) * flat, np.sin(height)])
        pose = look_at(target + distance * away, target)
        scene.set_rig(pose)
        depths = scene.true_depths(RIG, pixels)
        if np.isnan(depths).any() or depths.min() < NEAREST * distance:
            continue
        if abs(float(np.mean(depths)) / distance - 1.0) < RANGE_TOLERANCE:
            return pose
    raise ExperimentError(f"scene {scene.seed}: no view of it is {distance} m away")


def _follow_by_map(views: Sequence[_View], scene: StereoScene) -> Followed:
    """Register each view to fiducials that stay.

    Each is tracked from the view that it was chosen in: from view to view its place would drift.
    """
    errors, nees = np.full(len(views) - 1, np.inf), np.full(len(views) - 1, np.nan)
    fiducials = FiducialMap(scene.geometry, SIGMA)
    start = select_fiducials(
        views[0].pair[0],
        views[0].measured,
        scene.geometry,
        config=FiducialConfig(count=MAPPED, sigma=SIGMA),
    )
    fiducials.add(start.image_points, views[0].pose, sigma=views[0].sigma[start.indices])
    first_view = np.zeros(len(fiducials), np.intp)
    first_seen = start.image_points
    poses = [views[0].pose]
    for step, view in enumerate(views[1:], start=1):
        guess = poses[-1] * view.reported
        seen, sigma = np.full((2, len(fiducials), 3), np.nan)
        for earlier in np.unique(first_view):
            mine = np.flatnonzero(first_view == earlier)
            back = poses[earlier].inv() * guess
            found = track(views[earlier].pair, view.pair, first_seen[mine], scene.geometry, back)
            seen[mine], sigma[mine] = found.after, found.place_sigma
        known = np.flatnonzero(np.isfinite(seen[:, 0]))
        new = select_fiducials(
            view.pair[0],
            view.measured,
            scene.geometry,
            taken=seen[known],
            config=FiducialConfig(count=max(MAPPED - len(known), 1), sigma=SIGMA),
        )
        try:
            observed = fiducials.observe(
                known,
                seen[known],
                sigma=sigma[known],
                new=new.image_points,
                new_sigma=view.sigma[new.indices],
                guess=guess,
            )
        except RegistrationError:
            poses.append(guess)
            continue
        registration = observed.registration
        poses.append(registration.transform_camera_to_world)
        first_view = np.append(first_view, np.full(len(new.indices), step))
        first_seen = np.concatenate([first_seen, new.image_points])
        errors[step - 1] = millimetres(poses[-1], view.pose)
        nees[step - 1] = normalised_error(poses[-1], view.pose, registration.covariance)
    return Followed({PERSISTENT: errors}, {PERSISTENT: nees})


def _tracking_errors(
    views: Sequence[_View], tracks: Sequence[Tracks], scene: StereoScene
) -> tuple[FloatArray, int]:
    """Return errors (N, 3) of tracked fiducials against the true surface [px], and those sought."""
    errors, sought = [np.zeros((0, 3))], 0
    for last, view, found in zip(views[:-1], views[1:], tracks, strict=True):
        sought += len(found.found)
        scene.set_rig(last.pose)
        before, after = found.before[found.found], found.after[found.found]
        depths = scene.true_depths(RIG, before[:, :2])
        disparities = scene.geometry.fx * scene.geometry.baseline / depths
        points = scene.geometry.points(np.column_stack([before[:, :2], disparities]))
        motion = last.pose.inv() * view.pose
        if len(points):
            expected = scene.geometry.project(motion.apply(points, inverse=True))
            error = after - expected
            errors.append(error[np.isfinite(error).all(axis=1)])
    return np.concatenate(errors), sought


def _best(found: Tracks) -> NDArray[np.intp]:
    """Return the fiducials of a motion: those that were tracked best."""
    there = np.flatnonzero(found.found)
    order = np.argsort(found.sigma[there].max(axis=1), kind="stable")
    return there[order[:USED]]


def _points(tracks: Sequence[Tracks], index: int, after: bool) -> FloatArray:
    """Return (N, 3) where the fiducials of one step of the first views are, after or before it."""
    if not 0 <= index < len(tracks):
        return np.zeros((0, 3))
    found = tracks[index]
    return (found.after if after else found.before)[_best(found)]


def _robust_sigma(values: FloatArray) -> float:
    """Return 1.4826 times the median absolute value; NaN without any."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else float("nan")


def _median(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")
