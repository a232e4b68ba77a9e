"""One test of ``ch4-montecarlo``: an object guided to its goal by a camera, compiled.

`montecarlo` describes the scenario. All random numbers are drawn first, from the test's own seed:
a test does not depend on the process that runs it or on other tests.
"""

import dataclasses
import math
import time
from collections.abc import Mapping
from typing import NamedTuple

import numba
import numpy as np

from controllers.placement.planar.arc_search import (
    ArcTask,
    OccupancyCells,
    probability_at,
    search_arcs,
)
from controllers.placement.planar.field import HullCorners, hull_around
from controllers.placement.planar.occluders import convex_sum
from controllers.placement.task import FREE_BELOW, RatingTerms
from experiments.ch4.montecarlo.scenario import (
    CANDIDATES,
    DENSITIES,
    SCENARIO,
    SIDES,
    ObstacleWorld,
    Scenario,
    draw_worlds,
)
from experiments.ch4.montecarlo.sight import (
    focus,
    marker_side,
    object_corners,
    sighting_variance,
)
from experiments.harness.sweep import concatenated
from perception.geometry.arrays import FloatArray

PLACEMENTS = ("optimal", "random", "fixed")
OPTIMAL, RANDOM, FIXED = range(3)
TARGETS = ("primary", "secondary")
PERIODS = 48  # More than the longest approach has.
DRAWS = 256
"""Positions drawn until one is free, in focus and on the visible side."""
RINGS, DIRECTIONS = 32, 720


class Chance(NamedTuple):
    """All random numbers of one test.

    Attributes:
        candidates: (`CANDIDATES`, 4 + `SIDES`) uniform in [0, 1): obstacles for `draw_worlds`.
        places: (`PERIODS`, `DRAWS`, 2) uniform in [0, 1): positions for random cameras.
        slopes: (`PERIODS` + 1,) standard normal: drift after each sighting.
        noise: (`PERIODS`,) standard normal: errors of sightings.
        constants: (2,) standard normal: initial error, error of the secondary's relation.
    """

    candidates: FloatArray
    places: FloatArray
    slopes: FloatArray
    noise: FloatArray
    constants: FloatArray


def draw_chance(seed: int) -> Chance:
    """Draw a test's random numbers, each kind from a stream of its own."""
    streams = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)]
    return Chance(
        streams[0].random((CANDIDATES, 4 + SIDES)),
        streams[1].random((PERIODS, DRAWS, 2)),
        streams[2].standard_normal(PERIODS + 1),
        streams[3].standard_normal(PERIODS),
        streams[4].standard_normal(2),
    )


@dataclasses.dataclass(frozen=True)
class GuidanceJob:
    """Some tests of one case.

    Attributes:
        seeds: Random seed of each test.
        changes: Numbers that differ from `SCENARIO`'s, by name.
    """

    seeds: tuple[int, ...]
    changes: Mapping[str, float]


@dataclasses.dataclass(frozen=True)
class GuidedTests:
    """Tests by all placements at all densities, with and without secondary target.

    The first four are (n, densities, placements, targets), the others (n, densities).

    Attributes:
        error: Error at arrival [m].
        sightings: Number of sightings.
        last_gap: Distance of the object from the goal when it was last seen [m]; infinite if never.
        last_view: Distance of the camera from the goal at that time [m]; infinite if never.
        covered: Share of the work space that obstacles cover.
        free: Share of the work space that cameras can reach.
    """

    error: FloatArray
    sightings: FloatArray
    last_gap: FloatArray
    last_view: FloatArray
    covered: FloatArray
    free: FloatArray


def run_tests(job: GuidanceJob) -> tuple[GuidedTests, float]:
    """Run tests; a job of the sweep.

    Returns:
        The tests, and the processor time that they took without compiling [s].
    """
    scenario = SCENARIO._replace(**job.changes)
    run_test(job.seeds[0], scenario)  # compiles
    begin = time.process_time()
    results = [run_test(seed, scenario) for seed in job.seeds]
    seconds = time.process_time() - begin
    return concatenated(results), seconds


def run_test(seed: int, scenario: Scenario = SCENARIO) -> GuidedTests:
    """Run one test of `run_tests`."""
    chance = draw_chance(seed)
    worlds = draw_worlds(chance.candidates, scenario)
    shape = (len(DENSITIES), len(PLACEMENTS), len(TARGETS))
    error, sightings, last_gap, last_view = np.full((4, *shape), np.inf)
    for index in np.ndindex(*shape):
        density, placement, target = index
        error[index], track = guide(scenario, worlds[density], chance, placement, target == 1)
        seen = track[track[:, 3] > 0.0]
        sightings[index] = len(seen)
        if len(seen):
            last_gap[index], last_view[index] = seen[-1, 0], math.hypot(*seen[-1, 1:3])
    covered = np.array([world.covered for world in worlds])
    free = np.array([1.0 - float(world.occupied.mean()) for world in worlds])
    arrays = (error, sightings, last_gap, last_view, covered, free)
    return GuidedTests(*(array[None] for array in arrays))


@numba.njit(cache=True)
def guide(
    scenario: Scenario,
    world: ObstacleWorld,
    chance: Chance,
    placement: int,
    secondary: bool,
) -> tuple[float, FloatArray]:
    """Guide the object to the goal.

    Args:
        scenario: Parameters of the scenario.
        world: Obstacles and their map.
        chance: All random numbers.
        placement: `OPTIMAL`, `RANDOM` or `FIXED`.
        secondary: Whether the left-hand pair of markers may be watched, too.

    Returns:
        Error across the slot at arrival [m], and the track (periods, 6): gap [m]; x and y of the
        camera [m], NaN if there is none; 0, or 1 or 2 for the target that was seen; error across
        the slot before the sighting [m], and its predicted standard deviation [m].
    """
    track = np.empty((PERIODS, 6))
    gap, steps, since = scenario.start, 0, 0.0
    error_then, variance_then = scenario.prior * chance.constants[0], scenario.prior**2
    slope = scenario.drift * chance.slopes[0]
    camera, placed, lost = np.full(2, np.nan), False, True
    while gap > 2.0 * scenario.marker:
        error = error_then + slope * since
        variance = variance_then + (scenario.drift * since) ** 2
        near, far = focus(scenario, gap, math.sqrt(variance))
        first = 0
        if placement == OPTIMAL:
            found, best = _place(scenario, world, gap, near, far, secondary, camera)
            if found:
                placed, first = True, best
        elif steps == 0 or (placement == RANDOM and (lost or scenario.stays == 0.0)):
            placed = _draw(scenario, world, chance.places[steps], gap, near, far, camera) or placed
        seen, sighting = 0, 0.0
        if placed:
            for turn in range(2 if secondary else 1):
                target = (first + turn) % 2
                sighting = sighting_variance(scenario, world.corners, camera, target, gap, error)
                if sighting > 0.0:
                    seen = 1 + target
                    break
        sigma = math.sqrt(variance)
        track[steps] = np.array([gap, camera[0], camera[1], float(seen), error, sigma])
        lost = seen == 0
        if not lost:
            wrong = math.sqrt(sighting) * chance.noise[steps]
            if seen == 2:
                sighting += scenario.relation**2
                wrong += scenario.relation * chance.constants[1]
            weight = variance / (variance + sighting)
            error_then = error - weight * (error + wrong)
            variance_then, since = variance * (1.0 - weight), 0.0
            slope = scenario.drift * chance.slopes[steps + 1]
        step = scenario.period * min(scenario.speed, scenario.gain * gap)
        gap, since, steps = gap - step, since + step, steps + 1
    return error_then + slope * (since + gap), track[:steps]


@numba.njit(cache=True)
def expanded(scenario: Scenario, corners: FloatArray, target: int, gap: float) -> HullCorners:
    """Return all occluders expanded by the gap, from its middle.

    Args:
        scenario: Parameters of the scenario.
        corners: (N, `SIDES`, 2) corners of the obstacles [m].
        target: Target to watch: 0 primary, 1 secondary.
        gap: Gap between the markers [m].

    Returns:
        Corners of N + 1 hulls [m]; the object is the last.
    """
    x, y = scenario.marker, 0.5 * gap + scenario.marker
    outline = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])  # its own mirror image
    place = np.array([marker_side(scenario, target), 0.5 * gap])
    points = np.empty((len(corners) * (SIDES + 4) + 8, 2))
    starts = np.zeros(len(corners) + 2, dtype=np.int64)
    for i in range(len(corners) + 1):
        occluder = object_corners(scenario, gap, 0.0) if i == len(corners) else corners[i]
        starts[i + 1] = starts[i] + convex_sum(occluder - place, outline, points[starts[i] :])
    return HullCorners(points[: starts[-1]], starts)


@numba.njit(cache=True)
def _place(
    scenario: Scenario,
    world: ObstacleWorld,
    gap: float,
    near: float,
    far: float,
    secondary: bool,
    camera: FloatArray,
) -> tuple[bool, int]:
    """Place the camera where the rating is best.

    Returns:
        Whether any pose sees a target, and the index of the target; ``camera`` takes the pose.
    """
    if near > far:
        return False, 0
    rings = np.linspace(near, far, RINGS)
    floor, watch, half = 0.0, -1, 0.5 * scenario.side
    for target in range(2 if secondary else 1):
        hulls = expanded(scenario, world.corners, target, gap)
        if hull_around(hulls) >= 0:
            continue
        error = scenario.relation if target == 1 else 0.0
        terms = RatingTerms(scenario.pixel_per_metre, near, far, error, 1.0, 1.0, 1.0, 1.0)
        cells = OccupancyCells(world.occupied, scenario.cell, -half, -half)
        x, y, axis = marker_side(scenario, target), 0.5 * gap, 0.5 * math.pi
        task = ArcTask(hulls, x, y, axis, cells, terms)
        rating, angle, radius, _, _ = search_arcs(task, rings, DIRECTIONS, floor)
        if rating > floor:
            floor, watch = rating, target
            camera[0] = x + radius * math.cos(axis + angle)
            camera[1] = y + radius * math.sin(axis + angle)
    return watch >= 0, max(watch, 0)


@numba.njit(cache=True)
def _draw(
    scenario: Scenario,
    world: ObstacleWorld,
    places: FloatArray,
    gap: float,
    near: float,
    far: float,
    camera: FloatArray,
) -> bool:
    """Draw a pose that is free, in focus and on the visible side of the primary target.

    Returns:
        Whether there was one among the draws; ``camera`` takes it.
    """
    half = 0.5 * scenario.side
    for draw in places:
        dx, dy = far * (2.0 * draw[0] - 1.0), far * draw[1]
        if not near <= math.hypot(dx, dy) <= far:
            continue
        x, y = marker_side(scenario, 0) + dx, 0.5 * gap + dy
        p = probability_at(OccupancyCells(world.occupied, scenario.cell, -half, -half), x, y)
        if p < FREE_BELOW:
            camera[0], camera[1] = x, y
            return True
    return False
