"""The thesis' two heuristic searches for a word: exchange of legs, and a genetic search.

The exchange takes the best change of up to three legs, again and again from a random word; it ends
where no such change is better, and begins again from another random word. Of the genetic search
the thesis gives only the name. This one keeps the best word, lets the better of two random ones
breed, crosses at one place and flips each leg with a chance of one in the number of legs.
"""

import dataclasses
from typing import NamedTuple

import numba
import numpy as np

from controllers.braid.arm.chain import compose, identity, relative
from perception.geometry.arrays import FloatArray

_CHANGED = 3
"""Greatest number of legs that are exchanged at once."""


class TipGoal(NamedTuple):
    """Cost that a search for a word minimises, for compiled code.

    Attributes:
        stages: (8, 12) pose of a stage in each state.
        target: (12,) wanted pose of the tip, arm's base frame.
        turn_weight: Factor w^2 / 2 of |dR|_F^2 in the squared cost [m^2].
    """

    stages: FloatArray
    target: FloatArray
    turn_weight: float


@numba.njit(cache=True)
def squared_cost(a, b, turn_weight):
    """Return |dp|^2 + turn_weight |dR|_F^2 of two poses (12,) [m^2]."""
    total = 0.0
    for d in range(3):
        total += (a[d] - b[d]) ** 2
    turned = 0.0
    for d in range(3, 12):
        turned += (a[d] - b[d]) ** 2
    return total + turn_weight * turned


@numba.njit(cache=True)
def exchange(goal, word):
    """Descend from a word and return the squared cost where it ends.

    Args:
        goal: `TipGoal`.
        word: (n,) states, base first; changed.
    """
    stages, target, turn_weight = goal.stages, goal.target, goal.turn_weight
    tips = np.empty((word.shape[0], 8, 12))
    move = np.empty((_CHANGED, 2), dtype=np.int64)
    bound = np.inf
    while True:
        _tips(stages, word, tips)
        bound = min(bound, squared_cost(tips[0, word[0]], target, turn_weight))
        found = _best_move(goal, word, tips, bound, move)
        if found >= bound:
            return bound
        bound = found
        for k in range(_CHANGED):
            if move[k, 0] >= 0:
                word[move[k, 0]] = move[k, 1]


@numba.njit(cache=True)
def _tips(stages, word, tips):
    """Write the tip in the frame before stage k, if k is in state s and the rest as in the word."""
    rest = identity()
    for k in range(word.shape[0] - 1, -1, -1):
        for state in range(8):
            compose(stages[state], rest, tips[k, state])
        rest[:] = tips[k, word[k]]


@numba.njit(cache=True)
def _best_move(goal, word, tips, bound, move):
    """Write the best change into ``move`` (3, 2): stage and state, or -1; return its cost.

    Stages are changed from the base on, each level of the search one. The target is carried along
    in the frame before the stage at hand, so that a change costs one distance.
    """
    stages, count = goal.stages, word.shape[0]
    stage, state = np.zeros(_CHANGED, dtype=np.int64), np.full(_CHANGED, -1, dtype=np.int64)
    legs, here = np.full(_CHANGED, _CHANGED), np.empty((_CHANGED, 12))
    here[0], level = goal.target, 0
    move[:] = -1
    while level >= 0:
        state[level] += 1
        k, tried = stage[level], state[level]
        if tried == 8:
            relative(stages[word[k]], here[level], here[level])
            stage[level], state[level] = k + 1, -1
            if k + 1 == count:
                level -= 1
            continue
        flips = word[k] ^ tried
        changed = (flips & 1) + (flips >> 1 & 1) + (flips >> 2)
        if changed == 0 or changed > legs[level]:
            continue
        cost = squared_cost(tips[k, tried], here[level], goal.turn_weight)
        if cost < bound:
            bound = cost
            move[:] = -1
            for done in range(level + 1):
                move[done, 0], move[done, 1] = stage[done], state[done]
        if changed < legs[level] and k + 1 < count:
            relative(stages[tried], here[level], here[level + 1])
            stage[level + 1], state[level + 1] = k + 1, -1
            legs[level + 1] = legs[level] - changed
            level += 1
    return bound


@numba.njit(cache=True)
def exchange_from_random(goal, count, restarts, rng):
    """Descend from several random words.

    Args:
        goal: `TipGoal`.
        count: Number of stages n.
        restarts: Number of random words.
        rng: Random generator for the words.

    Returns:
        Best word (n,) and its squared cost [m^2].
    """
    best, bound = np.zeros(count, dtype=np.int64), np.inf
    word = np.empty(count, dtype=np.int64)
    for _ in range(restarts):
        for k in range(count):
            word[k] = rng.integers(0, 8)
        cost = exchange(goal, word)
        if cost < bound:
            bound = cost
            best[:] = word
    return best, bound


@dataclasses.dataclass(frozen=True)
class GeneticConfig:
    """Effort of the genetic search.

    Attributes:
        population: Number of words in a generation.
        generations: Number of generations that follow the first, random one.
        crossing: Chance that two parents are crossed rather than one copied.

    Raises:
        ValueError: If a number is out of range; the message names it.
    """

    population: int = 100
    generations: int = 100
    crossing: float = 0.8

    def __post_init__(self) -> None:
        for name in ("population", "generations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)}: expected at least 1")
        if not 0.0 <= self.crossing <= 1.0:
            raise ValueError(f"crossing {self.crossing}: expected a chance of 0 to 1")


@numba.njit(cache=True)
def breed(goal, count, population, generations, crossing, rng):
    """Breed words towards a target.

    Args:
        goal: `TipGoal`.
        count: Number of stages n.
        population: `GeneticConfig.population`.
        generations: `GeneticConfig.generations`.
        crossing: `GeneticConfig.crossing`.
        rng: Random generator for all choices.

    Returns:
        Best word (n,) of the last generation and its squared cost [m^2].
    """
    legs = 3 * count
    bits = np.empty((population, legs), dtype=np.bool_)
    for i in range(population):
        for k in range(legs):
            bits[i, k] = rng.random() < 0.5
    costs = np.empty(population)
    for i in range(population):
        costs[i] = _cost(goal, bits[i])
    for _ in range(generations):
        children = np.empty_like(bits)
        children[0] = bits[np.argmin(costs)]
        for i in range(1, population):
            mother, father = _better(costs, rng), _better(costs, rng)
            cut = rng.integers(1, legs) if rng.random() < crossing else legs
            for k in range(legs):
                inherited = bits[mother, k] if k < cut else bits[father, k]
                children[i, k] = inherited ^ (rng.random() * legs < 1.0)
        bits = children
        for i in range(population):
            costs[i] = _cost(goal, bits[i])
    best = np.argmin(costs)
    word = np.empty(count, dtype=np.int64)
    for k in range(count):
        word[k] = bits[best, 3 * k] + 2 * bits[best, 3 * k + 1] + 4 * bits[best, 3 * k + 2]
    return word, costs[best]


@numba.njit(cache=True)
def _better(costs, rng):
    one, other = rng.integers(0, costs.shape[0]), rng.integers(0, costs.shape[0])
    return one if costs[one] <= costs[other] else other


@numba.njit(cache=True)
def _cost(goal, bits):
    here = identity()
    for k in range(bits.shape[0] // 3):
        state = 1 * bits[3 * k] + 2 * bits[3 * k + 1] + 4 * bits[3 * k + 2]
        compose(here, goal.stages[state], here)
    return squared_cost(here, goal.target, goal.turn_weight)
