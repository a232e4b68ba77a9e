"""Probability of occupancy: log-odds with clamping, and the states of a cell.

A cell that was never measured is kept apart from one that was measured and is undecided: both may
have a probability of 0.5, but only the first is worth a view.
"""

import dataclasses
import enum

import numpy as np
from numpy.typing import ArrayLike

from perception.geometry.arrays import FloatArray


class State(enum.IntEnum):
    """What is known of a cell; the numbers serve in arrays of int8."""

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2


@dataclasses.dataclass(frozen=True)
class UpdateModel:
    """Update of a cell by one measurement.

    The defaults are those of OctoMap, so that maps can be compared.

    Attributes:
        hit: Probability of occupancy after a return from the cell, above 0.5.
        miss: Probability of occupancy after a ray through the cell, below 0.5.
        lowest: Lower clamp of a cell's probability.
        highest: Upper clamp of a cell's probability.
        occupied_above: A measured cell is occupied from this probability on, else free.
    """

    hit: float = 0.7
    miss: float = 0.4
    lowest: float = 0.1192
    highest: float = 0.971
    occupied_above: float = 0.5

    def __post_init__(self) -> None:
        """Check the values; an error names the wrong one."""
        inner = self.miss < 0.5 < self.hit and self.lowest < self.occupied_above < self.highest
        if not (inner and 0.0 < self.lowest < 0.5 < self.highest < 1.0 and 0.0 < self.miss):
            raise ValueError(f"{self}: expected 0 < lowest, miss < 0.5 < hit, highest < 1")

    @property
    def steps(self) -> tuple[float, float]:
        """Log-odds that a hit and a miss add."""
        return float(log_odds(self.hit)), float(log_odds(self.miss))

    @property
    def clamps(self) -> tuple[float, float]:
        """Lowest and highest log-odds of a cell."""
        return float(log_odds(self.lowest)), float(log_odds(self.highest))


def log_odds(probability: ArrayLike) -> FloatArray:
    """Return ln(p / (1 - p))."""
    p = np.asarray(probability, dtype=float)
    return np.log(p) - np.log1p(-p)


def probability(log_odds: ArrayLike) -> FloatArray:
    """Return 1 / (1 + exp(-l)), the inverse of `log_odds`."""
    return 1.0 / (1.0 + np.exp(-np.asarray(log_odds, dtype=float)))


def binary_entropy(probability: ArrayLike) -> FloatArray:
    """Return -p log2 p - (1 - p) log2(1 - p) [bit]; 0 at 0 and 1."""
    p = np.asarray(probability, dtype=float)
    safe = np.clip(p, 1e-300, 1.0 - 1e-16)
    bits = -safe * np.log2(safe) - (1.0 - safe) * np.log2(1.0 - safe)
    return np.where((p <= 0.0) | (p >= 1.0), 0.0, bits)
