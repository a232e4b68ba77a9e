"""Heights of cells above the ground about them: slopes and gentle relief are no obstacles.

The ground about a cell is a surface by weighted least squares over a window of about a metre:
first a plane, then, without the cells that stand out, three times a paraboloid whose curvature is
drawn to zero. A plane alone does not do: of ground without rocks whose height deviates by 20 mm, at
wavelengths of 0.4 m and more, 4.5 % stands out by 25 mm from planes over a metre, and 0.2 % from
these.
"""

# SciPy's image functions and numba's decorator have no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUntypedFunctionDecorator=false

from typing import Any

import numba
import numpy as np
from scipy.ndimage import correlate1d  # pyright: ignore[reportMissingTypeStubs]

from perception.elevation.map import ElevationMap
from perception.geometry.arrays import BoolArray, FloatArray

DEGREES = (1, 2, 2, 2)
"""Degree of each fit: 1 for a plane, 2 for a paraboloid."""
STANDS_OUT = 0.02
"""Height above a fit from which on a cell is left out of the next [m]."""
CURVATURE_PRIOR = 0.05
"""How strongly a paraboloid's curvature is drawn to zero, over how strongly a whole window of cells
draws it to theirs."""
MOST_LEVERAGE = 0.25
"""Largest variance of the ground below a cell, over the variance of a cell's height."""
_TERMS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Exponents of row and column of a surface's terms, by degree."""
_COUNT = {1: 3, 2: 6}
_DEFINITE = 1e-11
"""Share of a whole window's moments that keeps equations of too few cells from being singular."""


def rises(elevation: ElevationMap, window: float = 0.9) -> FloatArray:
    """Return the height of each cell above the ground about it.

    Args:
        elevation: Map of the ground and what stands on it.
        window: Side of the square about a cell whose ground it is compared with [m].

    Returns:
        (rows, columns) [m], negative in hollows; NaN where nothing is known, or too little about.

    Raises:
        ValueError: If the window is narrower than three cells.
    """
    reach = round(0.5 * window / elevation.grid.cell)
    if reach < 1:
        raise ValueError(f"window {window} m: expected three cells of {elevation.grid.cell} m")
    known = elevation.known
    above = np.full(known.shape, np.nan)
    if not known.any():
        return above
    box = tuple(
        slice(int(index.min()), int(index.max()) + 1) for index in np.nonzero(known)
    )  # What is known is often a small part of the grid.
    known, heights = known[box], elevation.heights[box]
    rise = np.full(known.shape, np.nan)
    for degree in DEGREES:
        ground = known & ~(rise > STANDS_OUT)
        rise = heights - _surface(heights, ground, known, degree, reach)
    above[box] = rise
    return above


def _surface(
    heights: FloatArray, ground: BoolArray, wanted: BoolArray, degree: int, reach: int
) -> FloatArray:
    """Return the height of the ground below cells.

    Args:
        heights: (rows, columns) heights of the cells [m].
        ground: (rows, columns) cells that the surface is fitted to.
        wanted: (rows, columns) cells below which it is wanted.
        degree: 1 for a plane, each cell of the window with the same weight; 2 for a paraboloid,
            with weights that fall to zero at the window's edge.
        reach: Cells from the middle of the window to its edge.

    Returns:
        (rows, columns) [m]; NaN where it is not wanted, or too little is known.
    """
    terms = _TERMS[: _COUNT[degree]]
    offsets = np.arange(-reach, reach + 1) / reach
    weights = np.ones(len(offsets))
    if degree > 1:
        weights = 0.5 + 0.5 * np.cos(np.pi * reach / (reach + 1) * offsets)
    kernels = [weights * offsets**power for power in range(2 * degree + 1)]
    # Heights from their mean, so that the sums lose no digits.
    middle = float(heights[ground].mean()) if ground.any() else 0.0
    counts = _moments(ground.astype(float), kernels, 2 * degree, wanted)
    sums = _moments(np.where(ground, heights - middle, 0.0), kernels, degree, wanted)
    powers = list(counts)
    pairs = np.array([[powers.index((a + c, b + d)) for c, d in terms] for a, b in terms])
    whole = np.array([kernels[2 * row].sum() * kernels[2 * column].sum() for row, column in terms])
    prior = whole * [_DEFINITE if row + column < 2 else CURVATURE_PRIOR for row, column in terms]
    solved, leverages = np.empty((2, np.count_nonzero(wanted)))
    stacked = np.stack(list(counts.values())), np.stack([sums[term] for term in terms])
    _solve(*stacked, pairs, prior, solved, leverages)
    surface = np.full(heights.shape, np.nan)
    surface[wanted] = np.where(leverages <= MOST_LEVERAGE, solved + middle, np.nan)
    return surface


@numba.njit(cache=True)
def _solve(counts: Any, sums: Any, pairs: Any, prior: Any, solved: Any, leverages: Any) -> None:
    """Solve the normal equations of each cell for its surface below the cell itself.

    Args:
        counts: (M, N) moments of the cells about each of N cells.
        sums: (terms, N) moments of their heights.
        pairs: (terms, terms) which of the M moments stands where in the equations.
        prior: (terms,) what is added to the equations' diagonal.
        solved: (N,) height of the surface [m], overwritten.
        leverages: (N,) its variance over that of a cell's height, overwritten.
    """
    n = len(prior)
    rows = np.empty((n, n + 1))
    for cell in range(len(solved)):
        # The constant term comes last, so that elimination leaves its equation alone.
        for i in range(n):
            for j in range(n):
                rows[i, j] = counts[pairs[n - 1 - i, n - 1 - j], cell]
            rows[i, i] += prior[n - 1 - i]
            rows[i, n] = sums[n - 1 - i, cell]
        for i in range(n - 1):
            for k in range(i + 1, n):
                factor = rows[k, i] / rows[i, i]
                for j in range(i, n + 1):
                    rows[k, j] -= factor * rows[i, j]
        solved[cell] = rows[n - 1, n] / rows[n - 1, n - 1]
        leverages[cell] = 1.0 / rows[n - 1, n - 1]


def _moments(
    values: FloatArray, kernels: list[FloatArray], degree: int, wanted: BoolArray
) -> dict[tuple[int, int], FloatArray]:
    """Return the weighted sums of values times powers of row and column about each wanted cell."""
    moments: dict[tuple[int, int], FloatArray] = {}
    for row in range(degree + 1):
        along = correlate1d(values, kernels[row], axis=0, mode="constant")
        for column in range(degree + 1 - row):
            both = correlate1d(along, kernels[column], axis=1, mode="constant")
            moments[row, column] = both[wanted]
    return moments
