"""A panel of known CAD is carried to the primary target while a camera watches (figure 4-11).

The site is mapped first, by chapter 3's planner with few scans. The panel's cells leave that map.
Then at every step the carrier moves by its command and an error, the camera measures the panel's
pose where it sees any of it, the panel is put back into the map, and the camera is placed again.
"""

import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from controllers.placement.moving import (
    MovingObject,
    PlanarPose,
    fit_outline,
    put_back,
    replace_camera,
    swollen,
    take_out,
)
from controllers.placement.planar.occluders import occluders_of_map
from controllers.placement.planar.search import PlanarTask
from controllers.placement.planar.sight import KnownSpace, clear_line, sees_on_map, separated
from controllers.placement.task import PlacementError, View
from experiments.ch3.planar.trial import PlanarTrial, Round, run_trial
from experiments.ch3.planar.worlds import World
from experiments.ch4.planar.scenes import make_lens, work_site, work_targets
from perception.geometry.arrays import FloatArray, IntArray
from perception.planar.raycast import scan

PANEL = MovingObject("panel", np.array([[-1.5, -5.0], [1.5, -5.0], [1.5, 5.0], [-1.5, 5.0]]))
START, END, STEP = 88.0, 52.0, 1.5
"""Initial x, final x and step of the panel's middle [m], at y = 50; at x = 52 the panel is half a
metre before the target."""
STEPS = round((START - END) / STEP) + 1
SLIP = 0.05
"""Standard deviation of a step's length and drift over its length: wheels on loose ground."""
TURN_SLIP = math.radians(1.0)
"""Standard deviation of the heading after a step [rad]."""
START_COVARIANCE = np.diag([0.3, 0.3, math.radians(3.0)]) ** 2
"""Covariance of the panel's pose when the map is made: about the width of the map's cells."""
DEPTH_NOISE = 1.5e-3
"""Standard deviation of a measured point over its squared distance [1/m]; measured with the stereo
pair: 1.8 mm at 1.1 m."""
SPACING = 0.25
"""Distance between measured points on the panel [m]."""
SIGMAS = 3.0
SCAN_ROUNDS, SCANNERS = 20, 2
VIEWPOINTS = ((59.0, 50.0), (59.0, 75.0))
"""Positions from which the targets are scanned [m]."""
LENS = make_lens(near=15.0)
"""Focused so that the panel of 10 m fits into the field of view: 5 m / tan(20.6 deg) = 13.3 m."""


@dataclasses.dataclass(frozen=True)
class MotionTrial:
    """One approach of the panel; a job of the sweep.

    Attributes:
        seed: Seed of the site, the scans and all errors.
        factor: Hysteresis factor.
    """

    seed: int
    factor: float


@dataclasses.dataclass(frozen=True)
class Moment:
    """State of an approach after a step.

    Attributes:
        step: Number of the approach's step.
        task: Targets, occluders and map as estimated.
        view: View of the camera; None where nothing is seen.
        panel: (4, 2) corners where the panel truly is [m].
    """

    step: int
    task: PlanarTask
    view: View | None
    panel: FloatArray


@dataclasses.dataclass(frozen=True)
class MappedSite:
    """A mapped site.

    Attributes:
        world: True world with the panel at its initial pose.
        solid: (rows, columns) true occupancy without the panel.
        mapped: Map from the scans.
    """

    world: World
    solid: NDArray[np.bool_]
    mapped: KnownSpace


def map_site(seed: int) -> MappedSite:
    """Draw a site and map it by few scans of two robots, so that much stays uncertain.

    Each robot also scans a target once, as the algorithm begins by identifying them (4.2.2).
    """
    world, solid = work_site(PlanarPose(START, 50.0, 0.0).to_world(PANEL.outline), seed)
    trial = PlanarTrial(
        "unstructured", seed, "information", limit=SCAN_ROUNDS, robots=SCANNERS
    )  # fmt: skip
    seen: list[Round] = []
    run_trial(trial, world, seen.append)
    mapped = seen[-1].map
    for place in VIEWPOINTS:
        row, column = map(int, world.grid.cell_at(place))
        view = scan(world.occupied, world.grid, (row, column), math.pi, trial.sensor)
        mapped.insert(view.passed, view.hit)
    return MappedSite(world, solid, KnownSpace(mapped.probability(), world.grid.cell))


@dataclasses.dataclass(frozen=True)
class Approach:
    """One approach of the panel, watched.

    Attributes:
        moves: Number of moves of the camera after its first placement.
        placed: Number of steps that had a view.
        watched: Number of these at which the whole target was truly seen.
        target: (steps,) target watched: 0 primary, 1 secondary, -1 none.
        replan_ms: (steps,) processor time of planning [ms].
        metres: Distance that the camera moved [m].
    """

    moves: int
    placed: int
    watched: int
    target: IntArray
    replan_ms: FloatArray
    metres: float


def approach(
    trial: MotionTrial,
    site: MappedSite,
    observe: Callable[[Moment], None] | None = None,
    steps: int = STEPS,
) -> Approach:
    """Carry the panel to the target while the camera watches.

    Args:
        trial: Seed and hysteresis.
        site: Mapped site of the approach.
        observe: Callback after each step.
        steps: Number of steps.
    """
    generator = np.random.default_rng([trial.seed, 5])
    true = PlanarPose(START, 50.0, 0.0)
    error = generator.multivariate_normal(np.zeros(3), START_COVARIANCE)
    estimate = PlanarPose(START + error[0], 50.0 + error[1], error[2], START_COVARIANCE)
    static = take_out(site.mapped, PANEL, estimate, SIGMAS)
    present: FloatArray | None = None
    targets: list[int] = []
    replans: list[float] = []
    moves, metres, watched = -1, 0.0, 0
    for step in range(steps):
        if step > 0:
            true, estimate = _carry(true, estimate, generator)
        if present is not None:
            estimate = _measure(true, estimate, present, site, generator)
        begin = time.process_time()
        space = put_back(static, PANEL, estimate, generator)
        occluders = (*occluders_of_map(static, work_targets()), swollen(PANEL, estimate, SIGMAS))
        task = PlanarTask(work_targets(), LENS, occluders, space)
        try:
            view, moved = replace_camera(task, present, trial.factor)
        except PlacementError:
            view, moved = None, False
        replans.append(1e3 * (time.process_time() - begin))
        panel = true.to_world(PANEL.outline)
        targets.append(-1 if view is None else int(view.target == "secondary"))
        if view is not None:
            moves += moved
            metres += 0.0 if present is None else float(np.hypot(*(view.position - present)))
            present = view.position
            watched += _truly_seen(view, panel, site)
        if observe is not None:
            observe(Moment(step, task, view, panel))
    target = np.array(targets)
    placed = int(np.sum(target >= 0))
    return Approach(max(moves, 0), placed, watched, target, np.array(replans), metres)


def watch_approach(trial: MotionTrial) -> tuple[Approach, Approach]:
    """Map a site, then watch the panel with hysteresis and without; a job of the sweep."""
    site = map_site(trial.seed)
    approach(trial, site, steps=2)  # Loads the compiled code, so that no plan is timed with it.
    plain = approach(dataclasses.replace(trial, factor=1.0), site)
    return approach(trial, site), plain


def _carry(
    true: PlanarPose, estimate: PlanarPose, generator: np.random.Generator
) -> tuple[PlanarPose, PlanarPose]:
    """Move the panel by a step towards the goal, by the carrier's estimate of its pose."""
    covariance = np.diag([SLIP * STEP, SLIP * STEP, TURN_SLIP]) ** 2
    slip = generator.multivariate_normal(np.zeros(3), covariance)
    # The carrier corrects its estimated lateral and heading error.
    command = np.array([-STEP, 50.0 - estimate.y, -estimate.heading])
    real = command + slip
    return (
        PlanarPose(true.x + real[0], true.y + real[1], true.heading + real[2]),
        PlanarPose(
            estimate.x + command[0], estimate.y + command[1], estimate.heading + command[2],
            estimate.covariance + covariance,
        ),
    )  # fmt: skip


def _measure(
    true: PlanarPose,
    prior: PlanarPose,
    camera: FloatArray,
    site: MappedSite,
    generator: np.random.Generator,
) -> PlanarPose:
    """Fit the CAD to the camera's points on the panel; without any, the prior is returned."""
    points = _seen_points(true.to_world(PANEL.outline), prior, camera, site)
    if len(points) == 0:
        return prior
    squared = np.sum((points - camera) ** 2, axis=1)
    noise = DEPTH_NOISE * squared[:, None] * generator.standard_normal(points.shape)
    deviation = DEPTH_NOISE * math.sqrt(float(np.mean(squared**2)))
    return fit_outline(PANEL, points + noise, deviation, prior)


def _seen_points(
    corners: FloatArray, prior: PlanarPose, camera: FloatArray, site: MappedSite
) -> FloatArray:
    """Return points on the panel's sides that face the camera, in its field of view and in sight.

    For this the camera turns for a moment from the target to the estimated panel.
    """
    ahead = np.array([prior.x, prior.y]) - camera
    ahead = ahead / np.linalg.norm(ahead)
    cell = site.world.grid.cell
    points: list[FloatArray] = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0)):
        edge = b - a
        if edge[1] * (camera[0] - a[0]) - edge[0] * (camera[1] - a[1]) <= 0.0:
            continue
        along = np.arange(0.5 * SPACING, float(np.hypot(*edge)), SPACING) / np.hypot(*edge)
        for point in a + along[:, None] * edge:
            ray = point - camera
            distance = float(np.hypot(*ray))
            in_view = ray @ ahead >= distance * math.cos(0.5 * LENS.field_of_view)
            if in_view and distance <= LENS.far and clear_line(
                site.solid, *(camera / cell), *(point / cell)
            ):  # fmt: skip
                points.append(point)
    return np.array(points).reshape(-1, 2)


def _truly_seen(view: View, panel: FloatArray, site: MappedSite) -> bool:
    """Return whether all of the watched target is visible past the true panel and obstacles."""
    goal = next(target for target in work_targets() if target.name == view.target)
    truth = KnownSpace(site.solid.astype(float), site.world.grid.cell)
    past_panel = separated(view.position[0], view.position[1], goal.position + goal.outline, panel)
    return bool(past_panel) and sees_on_map(truth, view.position, goal)
