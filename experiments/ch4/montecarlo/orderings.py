"""Orderings of table 4-1 that hold in any scenario: which of two cells is the better one.

Tests are paired by their seeds, so two cells are compared by the tests in which they differ.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from experiments.ch4.montecarlo.scenario import DENSITIES, TOLERANCES
from experiments.ch4.montecarlo.trial import PLACEMENTS, TARGETS
from experiments.harness.intervals import CONFIDENCE


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
    # Kind of the comparison, its axis of the table, and the step to the worse neighbour.
    kinds = (("density", 0, 1), ("tolerance", 1, 1), ("placement", 2, 1), ("secondary", 3, -1))
    shape, found = success.shape[1:], list[Comparison]()
    for (kind, axis, step), better in itertools.product(kinds, np.ndindex(*shape)):
        worse = (*better[:axis], better[axis] + step, *better[axis + 1 :])
        if not 0 <= worse[axis] < shape[axis]:
            continue
        first, second = success[:, *better], success[:, *worse]
        wins, losses = int(np.sum(first & ~second)), int(np.sum(second & ~first))
        p_value = float(stats.binomtest(wins, wins + losses).pvalue) if wins + losses else 1.0
        found.append(Comparison(kind, cell_name(better), cell_name(worse), wins, losses, p_value))
    return found


def cell_name(cell: Sequence[int]) -> str:
    """Return a cell's name as in the metrics: placement/density/tolerance/target.

    Args:
        cell: Indices of density, tolerance, placement and target.
    """
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
