"""Camera motion on rendered pairs: fiducials chosen, tracked and registered, as on the robots.

A stereo head views a cluttered scene from a mean distance and moves as an arm would move it.
The motion by the arm's joints is wrong by some millimetres and tenths of a degree; it only starts
the search. The true poses serve to score.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from experiments.ch3.motion.figures import tracking_figure
from experiments.ch3.motion.motion import FOLLOWED, PERSISTENT, RANGES, draw_motion
from experiments.ch3.motion.scores import Followed, found_or_none, millimetres, normalised_error
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
CHOSEN = 10  # A few more are chosen, since some are lost in tracking.
MAPPED = 14  # Fiducials of the map that are wanted in view.
SHOWN = 3  # Views of figure 3-23.
SIGMA = (0.03, 0.03, 0.05)
"""Standard deviations of a column, row and disparity [px] by which sets of fiducials are judged;
each match brings its own."""

NEAREST, RANGE_TOLERANCE = 0.6, 0.15
"""Least nearest depth in the first view, and greatest error of its mean depth, over the range."""

PLACE_SIGMA = 0.01
"""Standard deviation of the column and row of a new fiducial [px]: it is where it was chosen to
be."""

ARM_DEGREES, ARM_METRES = 0.3, 0.003
"""Standard deviations of a step by the joints, about and along each axis."""


@dataclasses.dataclass
class _View:
    """One view of the head.

    Attributes:
        pair: (2, H, W) uint8 left and right image.
        pose: True transform from the left camera to the world.
        reported: Transform from this view's camera to the last one's, by the arm's joints.
        measured: (N, 3) columns, rows and disparities of the stereo match [px].
        sigma: (N, 3) standard deviations of `measured` [px].
    """

    pair: NDArray[np.uint8]
    pose: RigidTransform
    reported: RigidTransform
    measured: FloatArray
    sigma: FloatArray


@dataclasses.dataclass(frozen=True)
class RenderedTrial:
    """One random motion of a rendered camera.

    Attributes:
        seed: Random seed of scene and motion.
        range: Mean distance of the surface in view, a key of `RANGES`.
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
        sought: Number of fiducials searched for.
        images: (SHOWN, H, W) uint8 first left images.
        with_previous: (N, 3) fiducials of each image that were tracked from the one before [px].
        with_next: (N, 3) fiducials of each image that were tracked to the one after [px].
    """

    tracking: FloatArray
    sought: int
    images: NDArray[np.uint8]
    with_previous: tuple[FloatArray, ...]
    with_next: tuple[FloatArray, ...]


def measure_rendered_motion(options: contract.RepeatedOptions, output: Output) -> None:
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
        for solver in FOLLOWED:
            errors = np.array([result.errors[solver] for result in group])
            for steps in REPORTED:
                key = f"motion_rendered_mm/{solver}/{name}/{steps}"
                output.measure(key, distribution(errors[:, steps - 1]))
        for solver in ("ml", PERSISTENT):
            values = np.concatenate([result.nees[solver] for result in group])
            output.measure(f"motion_rendered_nees/{solver}/{name}", float(np.nanmedian(values)))
        errors = np.concatenate([result.tracking for result in group])
        for axis, column in zip(("column", "row", "disparity"), errors.T, strict=True):
            sigma = 1.4826 * float(np.median(np.abs(column)))
            output.measure(f"tracking_error_px/{axis}/{name}", sigma)
        outliers = int(np.sum(np.abs(errors).max(axis=1) > 1.0))
        output.measure(f"tracking_outlier_fraction/{name}", fraction(outliers, len(errors)))
        sought = sum(result.sought for result in group)
        output.measure(f"tracked_fraction/{name}", fraction(len(errors), sought))
    shown = results[0]
    figure = tracking_figure(list(shown.images), shown.with_previous, shown.with_next)
    output.figure("figure_3-23", figure)


def follow_rendered(trial: RenderedTrial) -> RenderedRun:
    """Move a rendered camera and follow it by every solver and by the map; a job of the sweep."""
    views, scene = _views(trial)
    chained = {solver: RigidTransform.identity() for solver in SOLVERS}
    errors = {solver: np.full(trial.steps, np.inf) for solver in SOLVERS}
    nees = np.full(trial.steps, np.nan)
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
        used = _best(found)
        before, after = (
            Sighting(seen[used], found.sigma[used], scene.geometry)
            for seen in (found.before, found.after)
        )
        for solver in SOLVERS:
            likelihood = solver == "ml"
            guess = view.reported if likelihood else None
            estimate = found_or_none(
                estimate_motion, solver, before, after, guess=guess, reject=likelihood
            )
            # Where a solver fails, the joints' report is the best estimate.
            moved = view.reported if estimate is None else estimate.transform_after_to_before
            if likelihood and estimate is not None:
                motion = last.pose.inv() * view.pose
                nees[step] = normalised_error(moved, motion, estimate.covariance)
            chained[solver] = chained[solver] * moved
            errors[solver][step] = millimetres(views[0].pose * chained[solver], view.pose)
    steps = zip(views[:-1], views[1:], tracks, strict=True)
    mapped = _follow_by_map(views, scene)
    nothing = np.zeros((0, 3))
    previous = (nothing, *(found.after[_best(found)] for found in tracks))
    following = (*(found.before[_best(found)] for found in tracks), nothing)
    return RenderedRun(
        errors=errors | mapped.errors,
        nees={"ml": nees} | mapped.nees,
        tracking=np.concatenate([_tracking_error(*each, scene) for each in steps]),
        sought=sum(len(found.found) for found in tracks),
        images=np.array([view.pair[0] for view in views[:SHOWN]]),
        with_previous=previous[:SHOWN],
        with_next=following[:SHOWN],
    )


def _views(trial: RenderedTrial) -> tuple[list[_View], StereoScene]:
    """Move the free head about a random pose before the panel."""
    scene = StereoScene(trial.seed)
    rng = np.random.default_rng(np.random.SeedSequence((trial.seed, 324)))
    distance = RANGES[trial.range]
    first = _first_pose(scene, distance, rng)
    matcher = StereoMatcher(scene.geometry)
    views: list[_View] = []
    for offset in draw_motion(rng, trial.steps, distance):
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
    """Draw a first pose of the free head: before the panel, with the surface in view at the range.

    Raises:
        ExperimentError: If the scene has no such pose.
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
        # NaN, where there is only sky, fails both.
        far = depths.min() >= NEAREST * distance
        if far and abs(float(np.mean(depths)) / distance - 1.0) < RANGE_TOLERANCE:
            return pose
    raise ExperimentError(f"scene {scene.seed}: no view of it is {distance} m away")


def _follow_by_map(views: Sequence[_View], scene: StereoScene) -> Followed:
    """Register each view to fiducials that stay.

    Each is tracked from the view that it was chosen in: from view to view it would drift.
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


def _tracking_error(last: _View, view: _View, found: Tracks, scene: StereoScene) -> FloatArray:
    """Return errors (N, 3) of the tracked fiducials against the true surface [px]."""
    if not found.found.any():
        return np.zeros((0, 3))
    scene.set_rig(last.pose)
    points = scene.true_points(RIG, found.before[found.found, :2])
    motion = last.pose.inv() * view.pose
    error = found.after[found.found] - scene.geometry.project(motion.apply(points, inverse=True))
    return error[np.isfinite(error).all(axis=1)]


def _best(found: Tracks) -> NDArray[np.intp]:
    """Return the fiducials of a motion: those that were tracked best."""
    there = np.flatnonzero(found.found)
    order = np.argsort(found.sigma[there].max(axis=1), kind="stable")
    return there[order[:USED]]
