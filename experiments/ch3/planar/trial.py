"""One simulated mapping run: a world, one or more robots, and a method."""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from controllers.mapping import Method
from controllers.mapping.planar_planner import (
    PlanarTeam,
    PlannedView,
    PlannerConfig,
    Utility,
)
from experiments.ch3.planar.worlds import World, image_world, indoor_world, unstructured_world
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray, IntArray
from perception.planar.information import Reading
from perception.planar.map import PlanarMap
from perception.planar.raycast import RangeSensor, scan
from perception.voxels.occupancy import State

TARGET = 0.9
"""Fraction mapped at which a run is scored."""


@dataclasses.dataclass(frozen=True)
class PlanarTrial:
    """One run; a job of the sweep.

    Attributes:
        world: "unstructured", "indoor", or the file of a picture.
        seed: Random seed of world, start and candidates.
        method: Method that chooses the poses.
        fov_deg: Field of view [deg].
        depth: Depth of field [m].
        limit: Rounds after which a run ends.
        robots: Number of robots.
        cooperative: Whether robots claim what they will see.
        reading: Reading of new information.
        utility: Utility of method information.
        noise: Standard deviation of a range over its square [1/m].
        target: Fraction mapped at which a run ends.
        pixel: Side of a picture's pixel [m].
    """

    world: str
    seed: int
    method: Method
    fov_deg: float = 90.0
    depth: float = 15.0
    limit: int = 140
    robots: int = 1
    cooperative: bool = True
    reading: Reading = "entropy"
    utility: Utility = "going_rate"
    noise: float = 0.0
    target: float = 1.0
    pixel: float = 0.5

    @property
    def sensor(self) -> RangeSensor:
        """The vision system of every robot."""
        return RangeSensor(float(np.radians(self.fov_deg)), self.depth, self.noise)


@dataclasses.dataclass(frozen=True)
class Round:
    """State of a run after a round.

    Attributes:
        index: Number of the round; the first scan's is 0.
        map: The common map; a live object.
        cells: Row and column of each robot.
        headings: Heading of each robot [rad].
        views: View that each robot moved to; None at the start, or where nothing was left for it.
        fraction: Share of the world mapped so far.
        metres: Distance moved so far by all robots [m].
    """

    index: int
    map: PlanarMap
    cells: list[tuple[int, int]]
    headings: list[float]
    views: list[PlannedView | None]
    fraction: float
    metres: float


def build_world(trial: PlanarTrial) -> World:
    """Return the trial's world.

    Raises:
        OptionError: If its picture is bad.
    """
    drawn = {"unstructured": unstructured_world, "indoor": indoor_world}
    if trial.world in drawn:
        return drawn[trial.world](trial.seed)
    return image_world(Path(trial.world), trial.seed, trial.pixel)


@dataclasses.dataclass(frozen=True)
class PlanarRun:
    """One world mapped.

    Attributes:
        fraction: (rounds,) share of the world mapped after each round.
        metres: (rounds,) distance moved so far by all robots [m].
        states: (rows, columns) final map, `State`.
        paths: (n, 3) robot, row and column of every cell passed.
        stops: (n, 3) robot, row and column of every cell where a scan was taken.
        plan_ms: (rounds - 1,) computing time of one robot's choice in each round [ms].
        called_wrong: Share of the measured cells whose state is not the truth.
        bumps: Number of paths blocked by an obstacle that the map called free.
    """

    fraction: FloatArray
    metres: FloatArray
    states: NDArray[np.int8]
    paths: NDArray[np.int16]
    stops: NDArray[np.int16]
    plan_ms: FloatArray
    called_wrong: float
    bumps: int


def run_trial(
    trial: PlanarTrial, world: World, observe: Callable[[Round], None] | None = None
) -> PlanarRun:
    """Map a world until it is done or the rounds are used up.

    Args:
        trial: Trial to run.
        world: True world, for scans and for the score.
        observe: Called after each round.
    """
    generator = np.random.default_rng([trial.seed, 3])
    config = PlannerConfig(trial.sensor, trial.method, trial.reading, trial.utility)
    team = PlanarTeam(trial.robots, config, generator, trial.cooperative)
    model = PlanarMap(world.grid)
    cells = world.starts(trial.robots)
    turns = generator.integers(config.headings, size=trial.robots)
    headings = [2.0 * np.pi * int(turn) / config.headings for turn in turns]
    views: list[PlannedView | None] = [None] * trial.robots
    fractions, metres, plan_ms, bumps = [], [0.0], [], 0
    paths: list[IntArray] = [_numbered(r, np.array([cell])) for r, cell in enumerate(cells)]
    stops = list(paths)
    total = int(world.visible.sum())
    for index in range(trial.limit):
        moving = [index == 0 or view is not None for view in views]
        scans = [
            scan(world.occupied, world.grid, cell, heading, config.sensor, generator)
            for cell, heading, active in zip(cells, headings, moving)
            if active
        ]
        for seen in scans:
            model.insert(seen.passed, seen.hit)
        fractions.append(float((model.measured & world.visible).sum() / total))
        if observe is not None:
            observe(Round(index, model, cells, headings, views, fractions[-1], metres[-1]))
        if fractions[-1] >= trial.target or index == trial.limit - 1:
            break
        begin = time.perf_counter()
        views = team.choose(model, cells)
        plan_ms.append(1e3 * (time.perf_counter() - begin) / trial.robots)
        chosen = {robot: view for robot, view in enumerate(views) if view is not None}
        if not chosen:
            break
        walked = {robot: _walk(view.path, world, model) for robot, view in chosen.items()}
        for robot, path in walked.items():
            bumps += len(path) < len(chosen[robot].path)
            cells[robot] = (int(path[-1, 0]), int(path[-1, 1]))
            headings[robot] = chosen[robot].heading
            paths.append(_numbered(robot, path))
            stops.append(_numbered(robot, path[-1:]))
        metres.append(metres[-1] + sum(_length(path, world) for path in walked.values()))
    return PlanarRun(
        fraction=np.array(fractions),
        metres=np.array(metres[: len(fractions)]),
        states=model.states(),
        paths=np.concatenate(paths).astype(np.int16),
        stops=np.concatenate(stops).astype(np.int16),
        plan_ms=np.array(plan_ms),
        called_wrong=_called_wrong(model, world),
        bumps=bumps,
    )


def _walk(path: IntArray, world: World, model: PlanarMap) -> IntArray:
    """Return the part of a path up to the first obstacle, whose contact enters the map.

    Only noisy ranges let a map call an obstacle free.
    """
    blocked = world.occupied[path[:, 0], path[:, 1]]
    if not blocked.any():
        return path
    first = int(np.argmax(blocked))
    felt = np.zeros(model.grid.shape, dtype=bool)
    felt[tuple(path[first])] = True
    model.insert(np.zeros_like(felt), felt)
    return path[:first]


def _length(path: IntArray, world: World) -> float:
    steps = np.diff(path, axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum() * world.grid.cell)


def _numbered(robot: int, cells: IntArray) -> IntArray:
    return np.column_stack([np.full(len(cells), robot), cells])


def _called_wrong(model: PlanarMap, world: World) -> float:
    """Return the fraction of measured cells whose state is not the truth."""
    states = model.states()
    wrong = (states == State.FREE) & world.occupied | (states == State.OCCUPIED) & ~world.occupied
    return float(wrong.sum() / max(int(model.measured.sum()), 1))


@functools.lru_cache(maxsize=1)
def warm_up() -> None:
    """Load the compiled code, so that no choice is timed with it."""
    for method in ("information", "max_new"):
        trial = PlanarTrial("unstructured", 0, method, limit=3)
        run_trial(trial, build_world(trial))


def map_world(trial: PlanarTrial) -> PlanarRun:
    """Run one trial; a job of the sweep.

    Raises:
        OptionError: If its picture is bad.
    """
    warm_up()
    return run_trial(trial, build_world(trial))


def first_at(result: PlanarRun, fraction: float = TARGET) -> tuple[float, float]:
    """Return rounds and metres when a fraction was mapped; infinite if it never was."""
    reached = np.flatnonzero(result.fraction >= fraction)
    if reached.size == 0:
        return float("inf"), float("inf")
    return float(reached[0] + 1), float(result.metres[reached[0]])


def measure_arrival(runs: Sequence[PlanarRun], unit: str, case: str, output: Output) -> FloatArray:
    """Store when runs had mapped 90 %; an infinity (null) where one never had.

    Args:
        runs: Runs of one method or team.
        unit: Name of a round in the metrics: "scans" or "rounds".
        case: End of the metrics' names.
        output: Receives ``<unit>_to_90<case>``, ``metres_to_90<case>`` and
            ``reached_90_fraction<case>``.

    Returns:
        (runs, 2) rounds and metres to 90 % of each run.
    """
    when = np.array([first_at(run) for run in runs])
    output.measure(f"{unit}_to_90{case}", distribution(when[:, 0]))
    output.measure(f"metres_to_90{case}", distribution(when[:, 1]))
    reached = int(np.isfinite(when[:, 0]).sum())
    output.measure(f"reached_90_fraction{case}", fraction(reached, len(runs)))
    return when
