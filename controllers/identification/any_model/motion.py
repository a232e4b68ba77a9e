"""Motions that tell most of a model's parameters, within limits (Thesis section 2.6.1).

A motion is a Fourier series of each command about the one at rest, blended in and out. Its shape
is sought by covariance matrix adaptation; its size is the largest that keeps to all limits.
"""

import dataclasses
from collections.abc import Callable

import cma
import numpy as np

from perception.geometry.arrays import FloatArray

BLEND = 1.0
"""Time in which a motion is blended in, and out [s]."""
TRIALS = 10
"""Most sizes of a motion that are tried."""
CLOSE = 0.96
"""Share of the limits at which a motion is large enough."""
SPREAD = 0.7
"""Spread of the search about the best of some random shapes, over the spread of its numbers."""


@dataclasses.dataclass(frozen=True)
class Series:
    """Which motions are looked at.

    Attributes:
        home: (k,) commands at rest.
        duration: Duration [s].
        highest: Highest frequency [Hz]; all multiples of 1 / duration up to there would be too
            many to seek among, so that there are `harmonics` of them, evenly apart.
        harmonics: Number of frequencies.
    """

    home: FloatArray
    duration: float
    highest: float
    harmonics: int = 6

    @property
    def size(self) -> int:
        """Count of a shape's numbers."""
        return len(self.home) * (1 + 2 * self.harmonics)

    def commands(self, shape: FloatArray, stamps: FloatArray) -> FloatArray:
        """Return a motion (n, k) at some times (n,).

        Args:
            shape: (size,) offset, sines and cosines of each command.
            stamps: Times [s].
        """
        offset, *waves = shape.reshape(1 + 2 * self.harmonics, len(self.home))
        sines, cosines = np.array(waves).reshape(2, self.harmonics, -1)
        turns = 2.0 * np.pi * np.outer(stamps, self.frequencies)
        series = offset + np.sin(turns) @ sines + np.cos(turns) @ cosines
        way = np.clip(np.minimum(stamps, self.duration - stamps) / BLEND, 0.0, 1.0)
        return self.home + (way**2 * (3.0 - 2.0 * way))[:, None] * series

    @property
    def frequencies(self) -> FloatArray:
        """Frequencies (harmonics,), multiples of 1 / duration [Hz]."""
        steps = np.linspace(0.1 * self.highest, self.highest, self.harmonics) * self.duration
        return np.maximum(np.round(steps), 1.0) / self.duration

    def random(self, generator: np.random.Generator) -> FloatArray:
        """Return a random shape (size,), of which higher frequencies are smaller."""
        return self.falling * generator.standard_normal(self.size)

    @property
    def falling(self) -> FloatArray:
        """Size (size,) of each number of a random shape."""
        sizes = np.sqrt(self.frequencies[0] / self.frequencies)
        return np.repeat(np.concatenate([[1.0], sizes, sizes]), len(self.home))


def largest(shape: FloatArray, excess: Callable[[FloatArray], float], begin: float) -> FloatArray:
    """Return a shape about as large as limits allow.

    Args:
        shape: (size,) shape.
        excess: How far a shape is off, over the limits; at most 1 keeps to them.
        begin: Factor at which to begin.
    """
    low, high, factor = 0.0, np.inf, begin
    for _ in range(TRIALS):
        off = excess(factor * shape)
        if off <= 1.0:
            low = factor
            if off >= CLOSE:
                break
        else:
            high = factor
        # It grows about in proportion; where it does not, halves are safe.
        factor *= np.clip(0.5 * (1.0 + CLOSE) / max(off, 1e-9), 0.3, 4.0) if off < np.inf else 0.5
        if not low < factor < high:
            factor = 0.5 * (low + high)
    return low * shape


def design(
    series: Series,
    worth: Callable[[FloatArray], float],
    excess: Callable[[FloatArray], float],
    generator: np.random.Generator,
    generations: int = 16,
    population: int = 12,
    watch: Callable[[int, float], None] = lambda generation, best: None,
) -> FloatArray:
    """Return the shape (size,) of the motion that is worth most.

    Args:
        series: Which motions are looked at.
        worth: What a shape within the limits is worth.
        excess: How far a shape is off, over the limits.
        generator: Random generator of the shapes.
        generations: Number of generations.
        population: Shapes of each.
        watch: Called after each generation with its number and the best worth so far.
    """
    drawn = [largest(series.random(generator), excess, 0.1) for _ in range(population)]
    worths = [worth(shape) for shape in drawn]
    best, found = max(worths), drawn[int(np.argmax(worths))]
    watch(0, best)
    spread = SPREAD * float(np.std(found))
    settings = {
        "popsize": population,
        "seed": int(generator.integers(1, 2**31)),
        "CMA_stds": series.falling / series.falling.max(),
        "verbose": -9,
    }
    search = cma.CMAEvolutionStrategy(found, spread, settings)
    for generation in range(1, generations):
        asked = search.ask()
        # A shape counts by its direction alone: it is as large as it may be.
        drawn = [largest(shape, excess, 0.5) for shape in asked]
        worths = [worth(shape) for shape in drawn]
        search.tell(asked, [-each for each in worths])
        if max(worths) > best:
            best, found = max(worths), drawn[int(np.argmax(worths))]
        watch(generation, best)
    return found
