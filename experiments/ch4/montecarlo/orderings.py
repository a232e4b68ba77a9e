"""What table 4-1 must show whatever the scenario: which of two cells is the better one.

Tests are paired by their seeds, so two cells are compared by the tests in which they differ.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from experiments.ch4.montecarlo.scenario import DENSITIES, TOLERANCES
from experiments.ch4.montecarlo.trial import PLACEMENTS, TARGETS
from experiments.harness.intervals import CONFIDENCE

Cell = tuple[int, int, int, int]
"""Indices of density, tolerance, placement and target."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Two cells of the table, the first of which should be no worse.

    Attributes:
        kind: placement, tolerance, density or secondary.
        better: Name of the cell that should be no worse.
        worse: Name of the other.
        wins: Tests in which only the first succeeded.
        losses: Tests in which only the second did.
        p_value: Two-sided p of the exact sign test (McNemar's).
    """

    kind: str
    better: str
    worse: str
    wins: int
    losses: int
    p_value: float

    @property
    def significant(self) -> bool:
        """Whether the two cells differ beyond chance."""
        return self.p_value < 1.0 - CONFIDENCE

    @property
    def violated(self) -> bool:
        """Whether the first cell is worse beyond chance."""
        return self.losses > self.wins and self.significant


def compare_all(success: NDArray[np.bool_]) -> list[Comparison]:
    """Compare all neighbours in the table.

    Args:
        success: (n, densities, tolerances, placements, targets) of paired tests.
    """
    return [
        _compare(kind, success, better, worse) for kind, better, worse in _pairs(success.shape[1:])
    ]


def _pairs(shape: tuple[int, ...]) -> Iterator[tuple[str, Cell, Cell]]:
    """Yield what is compared: its kind, the cell that should be no worse, and the other."""
    # Along which axis, and by what step the worse neighbour is reached.
    kinds = (("density", 0, 1), ("tolerance", 1, 1), ("placement", 2, 1), ("secondary", 3, -1))
    for kind, axis, step in kinds:
        for index in np.ndindex(*shape):
            other = list(index)
            other[axis] += step
            if 0 <= other[axis] < shape[axis]:
                d, t, p, s = index
                yield kind, (d, t, p, s), (other[0], other[1], other[2], other[3])


def _compare(kind: str, success: NDArray[np.bool_], better: Cell, worse: Cell) -> Comparison:
    first, second = success[(slice(None), *better)], success[(slice(None), *worse)]
    wins, losses = int(np.sum(first & ~second)), int(np.sum(second & ~first))
    p_value = float(stats.binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0
    return Comparison(kind, cell_name(better), cell_name(worse), wins, losses, p_value)


def cell_name(cell: Cell) -> str:
    """Return a cell's name as in the metrics: placement/density/tolerance/target."""
    density, tolerance, placement, target = cell
    return f"{PLACEMENTS[placement]}/{DENSITIES[density]}/{TOLERANCES[tolerance]}/{TARGETS[target]}"


def second_chance(success: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return by how much the secondary target differs from an independent second chance.

    In the thesis' table p_with = 1 - (1 - p_without)^2 within 1.1 points for optimal placement.

    Args:
        success: (n, densities, tolerances, placements, targets) of tests.

    Returns:
        (densities, tolerances, placements) p_with - (1 - (1 - p_without)^2).
    """
    share = success.mean(axis=0)
    return share[..., 1] - (1.0 - (1.0 - share[..., 0]) ** 2)
