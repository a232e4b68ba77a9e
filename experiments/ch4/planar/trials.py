"""Trials of ``ch4-planar`` over random scenes: the searches, and the views lost by hulls."""

import dataclasses
import functools
import math
import time
from typing import Any

import numpy as np

from controllers.placement.moving import cell_centres
from controllers.placement.planar.arc_search import ArcTask, search_arcs, search_rings
from controllers.placement.planar.field import blocked_interval, free_cap, hull_around
from controllers.placement.planar.occluders import expand, occluders_of_map
from controllers.placement.planar.search import (
    RingCandidates,
    best_view,
    rating_field,
)
from controllers.placement.planar.sight import KnownSpace, sees_on_map, separated
from controllers.placement.task import Occluder, PlacementError, Target
from experiments.ch4.planar.scenes import BOX, convex_obstacle, face, random_task
from experiments.harness import timing
from perception.geometry.arrays import FloatArray, IntArray

REPEATS = 20
"""Runs of the fast search for each timing; a single run is too short for the clock."""
ROUNDS = 2
MAP_SHARE = 0.2
"""Share of the hulls' cases that are on maps, with occluders of any shape."""


@dataclasses.dataclass(frozen=True)
class PlanarSearchTrial:
    """Scenes of one density to search; a job of the sweep.

    Attributes:
        density: Share of the area that is covered.
        seed: Seed of the scenes.
        scenes: Number of scenes.
        rings: Number of distances of candidates.
        directions: Number of directions of candidates.
    """

    density: float
    seed: int
    scenes: int
    rings: int
    directions: int


@dataclasses.dataclass(frozen=True)
class HullTrial:
    """Cases of camera, occluders and target; a job of the sweep.

    Attributes:
        seed: Random seed of the cases.
        cases: Number of cases.
    """

    seed: int
    cases: int


@dataclasses.dataclass(frozen=True)
class PlanarSearches:
    """Searches of random scenes, each both ways.

    Attributes:
        matches: (scenes,) whether the fast search is as good, 0 or 1.
        exhaustive_s: (scenes,) processor time of the exhaustive search [s].
        fast_s: (scenes,) processor time of the fast search [s].
        placement_s: (scenes,) processor time of a whole placement with its hulls [s].
        gain: (scenes,) gain of the climb between candidates; NaN where no target is visible.
        cells: (scenes,) rating of the best cell centre over the optimum; NaN where no target is
            visible.
        hulls: (scenes,) number of occluders.
        distance: (scenes,) distance of the optimum [m].
    """

    matches: FloatArray
    exhaustive_s: FloatArray
    fast_s: FloatArray
    placement_s: FloatArray
    gain: FloatArray
    cells: FloatArray
    hulls: FloatArray
    distance: FloatArray


@dataclasses.dataclass(frozen=True)
class HullCounts:
    """How hulls compare with exact sight, for convex occluders and for maps.

    Attributes:
        false_visible: (2,) number of hidden targets that are visible by the hulls.
        visible: (2,) number of visible targets.
        given_up: (2,) number of visible targets that are hidden by the hulls.
    """

    false_visible: IntArray
    visible: IntArray
    given_up: IntArray


def compare_searches(trial: PlanarSearchTrial) -> PlanarSearches:
    """Search scenes both ways, over all targets; a job of the sweep.

    Both take the same hulls, and each target's best bounds the next target's search.
    """
    candidates = RingCandidates(trial.rings, trial.directions)
    rows: list[list[float]] = []
    for index in range(trial.scenes):
        root = [trial.seed, index, round(1e3 * trial.density)]
        task = random_task(trial.density, np.random.default_rng(root))
        compiled = [task.compiled(target) for target in task.targets]
        rings = candidates.distances(task.lens)
        every = _search(search_rings, compiled, rings, candidates)
        fast = _search(search_arcs, compiled, rings, candidates)
        times = timing.compare(
            functools.partial(_repeat, search_arcs, compiled, rings, candidates),
            functools.partial(_search, search_rings, compiled, rings, candidates),
            ROUNDS,
        )
        fresh = dataclasses.replace(task)
        begin = time.process_time()
        try:
            view = best_view(fresh, candidates)
            rating, distance = view.rating, view.distance
        except PlacementError:
            rating, distance = 0.0, np.nan
        whole = time.process_time() - begin
        of_cells = float(rating_field(task, cell_centres(task.space)).max())
        seen = rating > 0.0
        rows.append([
            fast >= every * (1.0 - 1e-12), times["peer_s"]["median"],
            times["ours_s"]["median"] / REPEATS, whole, rating / every if seen else np.nan,
            of_cells / rating if seen else np.nan, len(task.occluders), distance,
        ])  # fmt: skip
    return PlanarSearches(*np.array(rows, dtype=float).T.copy())


def _search(
    kernel: Any, compiled: list[ArcTask], rings: FloatArray, candidates: RingCandidates
) -> float:
    """Return the best rating by one of the searches [1/m]."""
    best = 0.0
    for task in compiled:
        if hull_around(task.hulls) < 0:
            best = kernel(task, rings, candidates.directions, best)[0]
    return best


def _repeat(
    kernel: Any, compiled: list[ArcTask], rings: FloatArray, candidates: RingCandidates
) -> None:
    """Search `REPEATS` times."""
    for _ in range(REPEATS):
        _search(kernel, compiled, rings, candidates)


def compare_sights(trial: HullTrial) -> HullCounts:
    """Compare hulls with exact sight of targets from cameras; a job of the sweep.

    Convex occluders are judged by separating axes. On maps the occluders are clusters of any shape
    and sight is by lines from cell to cell.
    """
    generator = np.random.default_rng(trial.seed)
    counts = np.zeros((2, 3), dtype=int)
    for _ in range(trial.cases):
        kind = int(generator.random() < MAP_SHARE)
        hulls_see, truly = (_case_on_map if kind else _case_of_polygons)(generator)
        counts[kind] += [hulls_see and not truly, truly, truly and not hulls_see]
    return HullCounts(*counts.T.copy())


def _case_of_polygons(generator: np.random.Generator) -> tuple[bool, bool]:
    """Draw up to six convex occluders and a target with any convex outline."""
    target = _random_target(generator)
    occluders = [
        Occluder(f"obstacle {i}", convex_obstacle(
            generator.uniform(0.0, 20.0, 2), generator.uniform(0.5, 3.0), generator))
        for i in range(int(generator.integers(1, 7)))
    ]  # fmt: skip
    camera = generator.uniform(0.0, 20.0, 2)
    (x, y), outline = camera, target.position + target.outline
    truly = all(separated(x, y, outline, occluder.points) for occluder in occluders)
    return hulls_see(occluders, target, camera), truly


def _case_on_map(generator: np.random.Generator) -> tuple[bool, bool]:
    """Scatter occupied cells in lumps of any shape."""
    target = face("target", (10.0, 10.0), generator.uniform(-np.pi, np.pi))
    values = np.full((40, 40), 0.02)
    for _ in range(int(generator.integers(1, 9))):
        row, column = generator.integers(0, 40, 2)
        for _ in range(int(generator.integers(1, 25))):
            values[row, column] = 0.9
            row, column = np.clip([row, column] + generator.integers(-1, 2, 2), 0, 39)
    values[17:23, 17:23] = 0.02
    space = KnownSpace(values, 0.5)
    camera = generator.uniform(0.0, 20.0, 2)
    return hulls_see(occluders_of_map(space), target, camera), sees_on_map(space, camera, target)


def _random_target(generator: np.random.Generator) -> Target:
    direction = generator.uniform(-np.pi, np.pi)
    if generator.random() < 0.5:  # noqa: PLR2004
        return face("target", (10.0, 10.0), direction)
    outline = convex_obstacle(np.zeros(2), generator.uniform(0.1, 1.5), generator)
    normal = np.array([math.cos(direction), math.sin(direction)])
    return Target("target", np.array([10.0, 10.0]), normal, outline)


def hulls_see(occluders: Any, target: Target, camera: FloatArray) -> bool:
    """Return whether the line to the reduced target misses all expanded occluders."""
    hulls = expand(occluders, target).hulls
    offset = camera - target.position
    angle = math.atan2(offset[1], offset[0])
    cap = free_cap(hulls, angle, 0.0, float(np.hypot(*offset)))
    return bool(cap > 0.0)


def occluded_angles(distances: FloatArray, radius: float) -> FloatArray:
    """Return figure 4-6's angles for a box at distances before the target.

    The true one is found by bisection on the exact sight, the other is the hull's interval.

    Args:
        distances: (N,) distances from the target to the box's near side [m].
        radius: Distance of the cameras from the target [m].

    Returns:
        (N, 2) true and hull's occluded angle [rad].
    """
    target = face("target", (0.0, 0.0), 0.0)
    outline = target.position + target.outline
    angles = np.empty((len(distances), 2))
    for i, distance in enumerate(distances):
        corners = BOX + [distance - BOX[:, 0].min(), 0.0]
        low, high = 0.0, 0.5 * math.pi
        for _ in range(40):
            middle = 0.5 * (low + high)
            x, y = radius * math.cos(middle), radius * math.sin(middle)
            hidden = not separated(x, y, outline, corners)
            low, high = (middle, high) if hidden else (low, middle)
        hull = expand([Occluder("box", corners)], target).hull(0)
        _, begin, end = blocked_interval(hull, 0, len(hull), radius)
        angles[i] = 2.0 * low, end - begin
    return angles
