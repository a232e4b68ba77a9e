"""Inverse kinematics of a binary arm by seven searches behind one signature (Thesis E.3.2).

What is minimised is ``cost^2 = |dp|^2 + w^2 |dR|_F^2 / 2`` of the tip; for small angles a that is
``|dp|^2 + w^2 a^2``. The weight w [m] says what a radian is worth.
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from controllers.braid.arm.chain import MAX_ENUMERATED, all_words, forward, identity, reduced_words
from controllers.braid.arm.heuristics import GeneticConfig, TipGoal, breed, exchange_from_random
from controllers.braid.arm.lattice_walk import TailShape, WalkEffort, describe_tails, walk
from controllers.braid.arm.meeting import (
    WordTable,
    first_clear,
    improve_free_stages,
    meet,
    search_clear,
)
from controllers.braid.arm.obstacles import LinkCheck
from controllers.braid.arm.pose_tree import build_tree, nearest
from controllers.braid.arm.stage import StageGeometry, state_poses
from perception.geometry.arrays import FloatArray, IntArray

TAIL = 6
"""Stages whose words are kept in a tree; the stages before them are enumerated."""
MAX_MET = TAIL + 6
"""Stages that are searched exactly at most: 2 million first halves."""
KEPT_TABLES = 8
"""Tables of words that are kept for other arms of the same stages; one of six stages has 25 MB."""


@dataclasses.dataclass(frozen=True)
class InverseConfig:
    """Effort of the searches.

    Attributes:
        weight: w of the cost [m].
        genetic: Settings of the genetic search.
        restarts: Random words that the exchange heuristic begins from.
        neighbourhoods: (stages set free, how often) in order, for the large-neighbourhood search.
            The last `TAIL` stages are always free, so (3, 80) looks through 80 x 8^9 words.
        looks: Searches of the last stages by the walk.
        steps: Steps of the walk at most; far from all that is in reach it has few looks.
        polish: Neighbourhoods, as `neighbourhoods`, of the word that the walk has found.
    """

    weight: float = 1.0
    genetic: GeneticConfig = dataclasses.field(default_factory=GeneticConfig)
    restarts: int = 10
    neighbourhoods: tuple[tuple[int, int], ...] = ((2, 250), (3, 80))
    looks: int = 4000
    steps: int = 8000
    polish: tuple[tuple[int, int], ...] = ((2, 60),)

    def __post_init__(self) -> None:
        """Refuse what is no search.

        Raises:
            ValueError: Naming the number.
        """
        if not (np.isfinite(self.weight) and self.weight > 0.0):
            raise ValueError(f"weight {self.weight}: expected a positive length")
        if self.restarts < 1:
            raise ValueError(f"restarts {self.restarts}: expected at least 1")
        if min(self.looks, self.steps) < 0:
            raise ValueError(f"looks {self.looks}, steps {self.steps}: expected 0 or more")
        for name, windows in (("neighbourhoods", self.neighbourhoods), ("polish", self.polish)):
            for free, times in windows:
                if not (1 <= free <= TAIL and times >= 0):
                    raise ValueError(f"{name} {(free, times)}: expected (1 to {TAIL}, 0 or more)")


@dataclasses.dataclass(frozen=True)
class WordSolution:
    """A word and how near it comes.

    Attributes:
        word: (n,) states, base first.
        cost: Root of the squared cost [m].
        displacement: Distance of the tip from its target [m].
        angle: Angle between them [rad].
    """

    word: IntArray
    cost: float
    displacement: float
    angle: float


class BinaryArm:
    """A chain of binary stages, with what its searches keep between targets.

    Attributes:
        count: Stages n.
        geometry: Sizes of the stages.
        config: Effort of the searches.
        stages: (8, 12) pose of a stage in each state.
    """

    def __init__(
        self,
        count: int,
        geometry: StageGeometry | None = None,
        config: InverseConfig | None = None,
    ) -> None:
        """Prepare the arm; trees are built when a search first needs them.

        Raises:
            ValueError: If there is no stage.
        """
        if count < 1:
            raise ValueError(f"{count} stages: expected at least 1")
        self.count = count
        self.geometry = geometry or StageGeometry()
        self.config = config or InverseConfig()
        self.stages = state_poses(self.geometry)

    @property
    def turn_weight(self) -> float:
        """Factor of |dR|_F^2 in the squared cost [m^2]."""
        return 0.5 * self.config.weight**2

    def goal(self, target: FloatArray) -> TipGoal:
        """Return what compiled searches minimise for a target pose (12,)."""
        return TipGoal(self.stages, target, self.turn_weight)

    def part(self, count: int, bodies: bool = False) -> WordTable:
        """Return all words of the first (or any other) few stages.

        Args:
            count: Number of stages.
            bodies: Keep also the words that reach the pose of another by another body.
        """
        return _table(self.geometry, self.config.weight, count, bodies)

    @functools.cached_property
    def tail_shape(self) -> TailShape:
        """Distribution of the poses that the last `TAIL` stages reach."""
        return describe_tails(self.part(TAIL).poses, self.stages)

    def score(self, word: IntArray, target: FloatArray) -> WordSolution:
        """Return how near a word (n,) comes to a target pose (12,)."""
        off = forward(self.stages, word) - target
        squared = float(off[:3] @ off[:3] + self.turn_weight * (off[3:] @ off[3:]))
        half = np.linalg.norm(off[3:]) / np.sqrt(8.0)  # |dR|_F = sqrt(8) sin(angle / 2)
        angle = 2.0 * float(np.arcsin(min(half, 1.0)))
        return WordSolution(word, squared**0.5, float(np.linalg.norm(off[:3])), angle)


@functools.lru_cache(maxsize=KEPT_TABLES)
def _table(geometry: StageGeometry, weight: float, count: int, bodies: bool) -> WordTable:
    """Return what `BinaryArm.part` does; arms of equal stages have the same words and poses."""
    words = all_words(count) if bodies else reduced_words(count)
    poses = forward(state_poses(geometry), words)
    return WordTable(words, poses, build_tree(poses, weight))


Check = LinkCheck | None
Method = Callable[[BinaryArm, FloatArray, np.random.Generator, Check], IntArray | None]


def solve(
    arm: BinaryArm,
    target: FloatArray,
    method: str,
    rng: np.random.Generator,
    check: Check = None,
) -> WordSolution | None:
    """Find a word whose tip comes near a target.

    Args:
        arm: The arm.
        target: (12,) pose that is wanted, in the arm's base frame.
        method: One of `METHODS`.
        rng: Source of randomness; exact methods do not use it.
        check: Tells which words keep clear of obstacles; methods of `CLEAR_METHODS` only.

    Returns:
        The word and its errors, or None where no word that was found keeps clear.

    Raises:
        ValueError: If the method is unknown, cannot avoid obstacles, has too many stages to do, or
            the target is no pose.
    """
    if method not in METHODS:
        raise ValueError(f"method {method}: expected one of {', '.join(METHODS)}")
    if check is not None and method not in CLEAR_METHODS:
        raise ValueError(f"method {method} and obstacles: expected {', '.join(CLEAR_METHODS)}")
    most = EXACT_LIMIT.get(method, arm.count)
    if arm.count > most:
        raise ValueError(f"{method} with {arm.count} stages: expected {most} at most")
    target = np.ascontiguousarray(target, dtype=float)
    if target.shape != (12,) or not np.all(np.isfinite(target)):
        raise ValueError(f"target {target.shape}: expected 12 finite numbers")
    word = METHODS[method](arm, target, rng, check)
    return None if word is None else arm.score(word, target)


def _exhaustive(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray | None:
    """Cost every word."""
    words, poses, _ = arm.part(arm.count, bodies=check is not None)
    off = poses - target
    costs = np.sum(off[:, :3] ** 2, axis=1) + arm.turn_weight * np.sum(off[:, 3:] ** 2, axis=1)
    if check is not None:
        costs[~check.free(words)] = np.inf
    best = int(np.argmin(costs))
    return words[best].copy() if np.isfinite(costs[best]) else None


def _tree(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray | None:
    """Find the nearest pose in the tree of all words."""
    if check is not None:
        return first_clear(
            arm.part(arm.count, bodies=True), identity()[None], np.empty((1, 0), int), target, check
        )
    part = arm.part(arm.count)
    return part.words[nearest(part.tree, target, np.inf)[0]].copy()


def _genetic(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray:
    """Breed words."""
    own = arm.config.genetic
    return breed(arm.goal(target), arm.count, own.population, own.generations, own.crossing, rng)[0]


def _exchange(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray:
    """Exchange up to three legs, from several random words."""
    return exchange_from_random(arm.goal(target), arm.count, arm.config.restarts, rng)[0]


def _meet(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray | None:
    """Meet in the middle: exact."""
    if arm.count <= TAIL:
        return _tree(arm, target, rng, check)
    bodies = check is not None
    head, tail = arm.part(arm.count - TAIL, bodies), arm.part(TAIL, bodies)
    if check is not None:
        return first_clear(tail, head.poses, head.words, target, check)
    first, last, _ = meet(tail.tree, head.poses, target, np.inf)
    return np.concatenate([head.words[first], tail.words[last]])


def _neighbourhood(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray | None:
    """Free some stages and the last ones, search them exactly, keep the best, repeat."""
    if arm.count <= TAIL:
        return _tree(arm, target, rng, check)
    ahead = arm.count - TAIL
    choices = _choices(arm.config.neighbourhoods, ahead, rng)
    if check is not None:
        return search_clear(
            arm.stages, arm.part(TAIL, bodies=True), ahead, choices, target, check, rng
        )
    word, cost = exchange_from_random(arm.goal(target), arm.count, 1, rng)
    return _improved(arm, word, cost, target, choices)


def _choices(
    windows: tuple[tuple[int, int], ...], ahead: int, rng: np.random.Generator
) -> list[IntArray]:
    """Draw the stages that each neighbourhood sets free among those before the tail."""
    steps = [free for free, times in windows for _ in range(times)]
    return [rng.choice(ahead, min(free, ahead), replace=False) for free in steps]


def _improved(
    arm: BinaryArm, word: IntArray, cost: float, target: FloatArray, choices: list[IntArray]
) -> IntArray:
    """Search neighbourhoods of a word (n,) of a squared cost, one after the other."""
    part, ahead = arm.part(TAIL), arm.count - TAIL
    searched: set[bytes] = set()  # since the word last changed: again they would find nothing
    for chosen in choices:
        free = np.zeros(ahead, dtype=bool)
        free[chosen] = True
        if free.tobytes() in searched:
            continue
        head = word[:ahead].copy()
        last, cost = improve_free_stages(part.tree, arm.stages, head, free, target, cost)
        if last >= 0:
            word = np.concatenate([head, part.words[last]])
            searched.clear()
        searched.add(free.tobytes())
    return word


def _walk(
    arm: BinaryArm, target: FloatArray, rng: np.random.Generator, check: Check
) -> IntArray | None:
    """Walk towards what the last stages can reach; where that is nothing, as `_neighbourhood`."""
    ahead, own = arm.count - TAIL, arm.config
    if ahead < 2:  # no pair to exchange
        return _meet(arm, target, rng, check)
    part = arm.part(TAIL)
    word, cost = exchange_from_random(arm.goal(target), arm.count, 1, rng)
    head = word[:ahead].copy()
    effort = WalkEffort(own.looks, own.steps)
    last, cost = walk(part.tree, arm.tail_shape, arm.goal(target), head, cost, effort, rng)
    if last >= 0:
        word = np.concatenate([head, part.words[last]])
    windows = own.polish if last >= 0 else own.neighbourhoods
    return _improved(arm, word, cost, target, _choices(windows, ahead, rng))


METHODS: dict[str, Method] = {
    "exhaustive": _exhaustive,
    "kd-tree": _tree,
    "genetic": _genetic,
    "exchange": _exchange,
    "meet": _meet,
    "neighbourhood": _neighbourhood,
    "walk": _walk,
}
CLEAR_METHODS = ("exhaustive", "kd-tree", "meet", "neighbourhood")
"""Methods that can keep clear of obstacles."""
EXACT_LIMIT = {"exhaustive": MAX_ENUMERATED - 1, "kd-tree": TAIL, "meet": MAX_MET}
"""Stages at most that each exact method does."""
