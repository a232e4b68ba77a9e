"""Targets of a binary arm, each solved by every method; scenes with obstacles."""

import dataclasses
import time

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from controllers.braid.arm.chain import chain_pose, forward
from controllers.braid.arm.heuristics import exchange_from_random
from controllers.braid.arm.inverse import EXACT_LIMIT, METHODS, BinaryArm, WordSolution, solve
from controllers.braid.arm.obstacles import LinkCheck, VoxelObstacles, body_points
from controllers.braid.arm.stage import StageGeometry, stage_pose
from perception.geometry.arrays import FloatArray, IntArray

KINDS = ("reachable", "random", "planted")
"""Targets: of random leg lengths, these places with uniform orientations, of random words."""
EQUAL_TIME, TIMED = "exchange_equal_time", "walk"
"""The exchange heuristic again, begun anew for as long as this method takes."""
BALLS, BALL_RADIUS, CLEARANCE = 3, 0.6, 2.0
"""Obstacles of a scene [r]; none is within the clearance of the base's centre."""
CLEAR_STAGES = 5
VOXEL = 0.1
"""Side of the voxels of a scene [r]."""


@dataclasses.dataclass(frozen=True)
class TargetTrial:
    """Targets of one kind for one arm.

    Attributes:
        stages: Number of the arm's stages.
        kind: One of `KINDS`.
        seed: Seed of the targets and searches.
        count: Targets.
    """

    stages: int
    kind: str
    seed: int
    count: int


@dataclasses.dataclass(frozen=True)
class ClearTrial:
    """Scenes with obstacles in the way of five stages.

    Attributes:
        seed: Seed of the scenes.
        count: Scenes.
        voxels: Whether the obstacles are given as a map's occupied voxels.
    """

    seed: int
    count: int
    voxels: bool


def methods_for(stages: int) -> list[str]:
    """Return the methods that can do so many stages, and the heuristic given equal time."""
    able = [name for name in METHODS if stages <= EXACT_LIMIT.get(name, stages)]
    return [*able, EQUAL_TIME]


def draw_targets(
    kind: str, stages: int, count: int, geometry: StageGeometry, rng: np.random.Generator
) -> FloatArray:
    """Return targets (count, 12) in the arm's base frame."""
    if kind == "planted":
        return forward(BinaryArm(1, geometry).stages, rng.integers(0, 8, (count, stages)))
    lengths = rng.uniform(geometry.short, geometry.long, (count, stages, 3))
    targets = chain_pose(stage_pose(lengths, geometry.radius))
    if kind == "random":
        targets[:, 3:] = Rotation.random(count, rng=rng).as_matrix().reshape(count, 9)
    return targets


@dataclasses.dataclass(frozen=True)
class Solved:
    """Words that one method found for many targets.

    Attributes:
        cost: (count,) cost [r].
        displacement: (count,) distance from the target [r].
        angle: (count,) angle to the target [rad].
        ms: (count,) computing time [ms].
    """

    cost: FloatArray
    displacement: FloatArray
    angle: FloatArray
    ms: FloatArray


@dataclasses.dataclass(frozen=True)
class ClearWords:
    """Searches for words that keep clear of obstacles.

    Attributes:
        exhaustive: (count,) cost of the best clear word [r], NaN where none was found.
        kd_tree: (count,) cost of the word by the tree [r], NaN where none was found.
        neighbourhood: (count,) cost of the word by neighbourhoods [r], NaN where none was found.
        ignoring: (count,) cost of the best word that disregards obstacles [r].
        touches: (count,) whether the word that disregards obstacles collides.
        collisions: (count,) number of words found that have a sampled point within an obstacle.
    """

    exhaustive: FloatArray
    kd_tree: FloatArray
    neighbourhood: FloatArray
    ignoring: FloatArray
    touches: NDArray[np.bool_]
    collisions: IntArray


def solve_targets(trial: TargetTrial) -> dict[str, Solved]:
    """Solve every target by every method, and return what each found."""
    rng = np.random.default_rng(trial.seed)
    arm = BinaryArm(trial.stages)
    targets = draw_targets(trial.kind, trial.stages, trial.count, arm.geometry, rng)
    names = methods_for(trial.stages)
    for name in names[:-1]:  # compile, and build the trees
        solve(arm, targets[0], name, rng)
    found: dict[str, list[list[float]]] = {name: [] for name in names}
    for target in targets:
        for name in names[:-1]:
            start = time.process_time()
            solution = solve(arm, target, name, rng)
            milliseconds = 1e3 * (time.process_time() - start)
            if solution is not None:
                found[name].append(_row(solution, milliseconds))
        found[EQUAL_TIME].append(_exchange_for(arm, target, found[TIMED][-1][3], rng))
    return {name: Solved(*np.array(rows).T.copy()) for name, rows in found.items()}


def _row(solution: WordSolution, milliseconds: float) -> list[float]:
    return [solution.cost, solution.displacement, solution.angle, milliseconds]


def _exchange_for(
    arm: BinaryArm, target: FloatArray, milliseconds: float, rng: np.random.Generator
) -> list[float]:
    """Restart the exchange heuristic until it has had as much time; the last start may run over."""
    start, best, bound = time.process_time(), np.zeros(arm.count, dtype=np.int64), np.inf
    spent = 0.0
    while not np.isfinite(bound) or spent < milliseconds:
        word, cost = exchange_from_random(arm.goal(target), arm.count, 1, rng)
        if cost < bound:
            best, bound = word, cost
        spent = 1e3 * (time.process_time() - start)
    return _row(arm.score(best, target), spent)


def solve_scenes(trial: ClearTrial) -> ClearWords:
    """Put balls onto the arm's best word and search one that keeps clear."""
    rng = np.random.default_rng(trial.seed)
    arm = BinaryArm(CLEAR_STAGES)
    rows = []
    for target in draw_targets("reachable", arm.count, trial.count, arm.geometry, rng):
        straight = solve(arm, target, "kd-tree", rng)
        assert straight is not None
        centres = _balls(arm, straight, rng)
        check = sampled = LinkCheck(arm.geometry, lambda points, at=centres: occupied(points, at))
        if trial.voxels:
            voxels = voxels_of(centres)
            check = LinkCheck(arm.geometry, voxels)
            tree = KDTree(voxels.centres)
            sampled = LinkCheck(arm.geometry, lambda points, at=tree: _in_voxels(points, at))
        methods = ("exhaustive", "kd-tree", "neighbourhood")
        found = [solve(arm, target, name, rng, check) for name in methods]
        costs = [np.nan if solution is None else solution.cost for solution in found]
        words = [solution.word for solution in found if solution is not None]
        collisions = sum(not sampled.free(word[None])[0] for word in words)
        touches = not check.free(straight.word[None])[0]
        rows.append((*costs, straight.cost, touches, collisions))
    return ClearWords(*map(np.array, zip(*rows)))


def occupied(points: FloatArray, centres: FloatArray) -> FloatArray:
    """Return 1.0 for places (n, 3) within a ball around a centre (k, 3), else 0.0."""
    inside = np.zeros(len(points), dtype=bool)
    for centre in centres:
        inside |= np.sum((points - centre) ** 2, axis=1) < BALL_RADIUS**2
    return inside.astype(float)


def voxels_of(centres: FloatArray) -> VoxelObstacles:
    """Return the voxels whose middles are within a ball around a centre (k, 3)."""
    low = np.floor((centres.min(axis=0) - BALL_RADIUS) / VOXEL)
    high = np.ceil((centres.max(axis=0) + BALL_RADIUS) / VOXEL)
    axes = [np.arange(first, end) + 0.5 for first, end in zip(low, high)]
    middles = VOXEL * np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return VoxelObstacles(middles[occupied(middles, centres) > 0.5], VOXEL)


def _in_voxels(points: FloatArray, centres: KDTree) -> FloatArray:
    """Return 1.0 for places (n, 3) in a voxel around one of the centres, else 0.0."""
    return (centres.query(points, p=np.inf)[0] < 0.5 * VOXEL).astype(float)


def _balls(arm: BinaryArm, solution: WordSolution, rng: np.random.Generator) -> FloatArray:
    """Return centres (k, 3) around points of the solution's body, away from the base."""
    body = body_points(arm.geometry)
    centres: list[FloatArray] = []
    while len(centres) < BALLS:
        stage = int(rng.integers(1, arm.count))
        base = forward(arm.stages, solution.word[:stage])
        points = body[solution.word[stage]]
        point = points[int(rng.integers(len(points)))]
        centre = base[3:].reshape(3, 3) @ point + base[:3] + rng.normal(0.0, BALL_RADIUS, 3)
        if np.linalg.norm(centre) >= CLEARANCE:
            centres.append(centre)
    return np.array(centres)
