"""The genetic search of the thesis: words as strings of bits, crossed and mutated.

The thesis names the method only. This one keeps the best word, lets the better of two random ones
breed, crosses at one place and flips each leg with a chance of one in the number of legs.
"""

from __future__ import annotations

import dataclasses

import numba
import numpy as np

from controllers.braid.arm.chain import compose
from controllers.braid.arm.exchange import squared_cost


@dataclasses.dataclass(frozen=True)
class GeneticConfig:
    """Effort of the genetic search.

    Attributes:
        population: Words in a generation.
        generations: How many follow the first, random one.
        crossing: Chance that two parents are crossed rather than one copied.
    """

    population: int = 100
    generations: int = 100
    crossing: float = 0.8

    def __post_init__(self) -> None:
        """Refuse a search that cannot be run.

        Raises:
            ValueError: Naming the number.
        """
        for name in ("population", "generations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} {getattr(self, name)}: expected at least 1")
        if not 0.0 <= self.crossing <= 1.0:
            raise ValueError(f"crossing {self.crossing}: expected a chance of 0 to 1")


@numba.njit(cache=True)
def breed(stages, count, target, turn, population, generations, crossing, rng):
    """Breed words towards a target.

    Args:
        stages: (8, 12) pose of a stage in each state.
        count: Stages n.
        target: (12,) pose that is wanted.
        turn: w^2 / 2 of the cost [m^2].
        population: As in `GeneticConfig`.
        generations: As there.
        crossing: As there.
        rng: Source of randomness.

    Returns:
        Best word (n,) of the last generation and its squared cost.
    """
    legs = 3 * count
    bits = np.empty((population, legs), dtype=np.bool_)
    for i in range(population):
        for k in range(legs):
            bits[i, k] = rng.random() < 0.5
    costs = np.empty(population)
    for i in range(population):
        costs[i] = _cost(stages, bits[i], target, turn)
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
            costs[i] = _cost(stages, bits[i], target, turn)
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
def _cost(stages, bits, target, turn):
    here, after = np.zeros(12), np.empty(12)
    here[3] = here[7] = here[11] = 1.0
    for k in range(bits.shape[0] // 3):
        state = 1 * bits[3 * k] + 2 * bits[3 * k + 1] + 4 * bits[3 * k + 2]
        compose(here, stages[state], after)
        here[:] = after
    return squared_cost(here, target, turn)
