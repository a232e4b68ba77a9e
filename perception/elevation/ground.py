"""Heights of cells above the ground about them: slopes and gentle relief are no obstacles.

The ground about a cell is a surface by weighted least squares over a window of about a metre:
first a plane, then, without the cells that stand out, three times a paraboloid whose curvature is
drawn to zero. A plane alone does not do: of ground without rocks whose height deviates by 20 mm, at
wavelengths of 0.4 m and more, 4.5 % stands out by 25 mm from planes over a metre, and 0.2 % from
these.
"""

# numba's decorator has no types.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUntypedFunctionDecorator=false

from typing import Any

import numba
import numpy as np

from perception.elevation.map import ElevationMap, FoundRises
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

    Of a map whose heights are the same as in the last call, nothing is computed anew.

    Args:
        elevation: Map of the ground and what stands on it.
        window: Side of the square about a cell whose ground it is compared with [m].

    Returns:
        (rows, columns) [m], negative in hollows; NaN where nothing is known, or too little about;
        read-only.

    Raises:
        ValueError: If the window is narrower than three cells.
    """
    reach = round(0.5 * window / elevation.grid.cell)
    if reach < 1:
        raise ValueError(f"window {window} m: expected three cells of {elevation.grid.cell} m")
    found = elevation.found_rises
    if (
        found is not None
        and found.window == window
        and np.array_equal(found.heights.view(np.int64), elevation.heights.view(np.int64))
    ):
        return found.rises
    above = _rises(elevation.heights, reach)
    above.flags.writeable = False
    elevation.found_rises = FoundRises(elevation.heights.copy(), window, above)
    return above


def _rises(heights: FloatArray, reach: int) -> FloatArray:
    """Return the height (rows, columns) of each cell above the ground about it [m]."""
    known = np.isfinite(heights)
    above = np.full(known.shape, np.nan)
    if not known.any():
        return above
    box = tuple(
        slice(int(index.min()), int(index.max()) + 1) for index in np.nonzero(known)
    )  # What is known is often a small part of the grid.
    known, heights = known[box], heights[box]
    rise, fit = np.full(known.shape, np.nan), None
    for degree in DEGREES:
        ground = known & ~(rise > STANDS_OUT)
        if fit is None or fit.degree != degree:
            fit = _Fit(heights, ground, known, degree, reach)
        else:
            fit.change(ground)
        rise = heights - fit.surface()
    above[box] = rise
    return above


class _Fit:
    """Surfaces of one degree through the ground about each of some cells.

    Args:
        heights: (rows, columns) heights of the cells [m].
        ground: (rows, columns) cells that the surfaces are fitted to, all of them wanted.
        wanted: (rows, columns) cells below which the surface is wanted.
        degree: 1 for a plane, each cell of the window with the same weight; 2 for a paraboloid,
            with weights that fall to zero at the window's edge.
        reach: Cells from the middle of the window to its edge.
    """

    def __init__(
        self,
        heights: FloatArray,
        ground: BoolArray,
        wanted: BoolArray,
        degree: int,
        reach: int,
    ) -> None:
        self.degree, self._ground, self._wanted = degree, ground, wanted
        offsets = np.arange(-reach, reach + 1) / reach
        weights = np.ones(len(offsets))
        if degree > 1:
            weights = 0.5 + 0.5 * np.cos(np.pi * reach / (reach + 1) * offsets)
        self._kernels = np.array([weights * offsets**power for power in range(2 * degree + 1)])
        # Heights from their mean, so that the sums lose no digits.
        self._middle = float(heights[wanted].mean())
        self._heights = np.where(wanted, heights - self._middle, 0.0)
        count = np.count_nonzero(wanted)
        self._places = np.full(wanted.shape, -1)
        self._places[wanted] = np.arange(count)
        self._counts = np.empty((count, len(_powers(2 * degree))))
        self._sums = np.empty((count, len(_powers(degree))))
        shown = ground.astype(float)
        _sum_about(shown, self._kernels, 2 * degree, self._places, self._counts)
        _sum_about(shown * self._heights, self._kernels, degree, self._places, self._sums)

    def change(self, ground: BoolArray) -> None:
        """Fit to other cells; quick where few of them are others."""
        rows, columns = np.nonzero(ground != self._ground)
        signs = np.where(ground[rows, columns], 1.0, -1.0)
        cells = np.column_stack([rows, columns])
        raised = signs * self._heights[rows, columns]
        _add_about(cells, signs, self._kernels, 2 * self.degree, self._places, self._counts)
        _add_about(cells, raised, self._kernels, self.degree, self._places, self._sums)
        self._ground = ground

    def surface(self) -> FloatArray:
        """Return the height (rows, columns) of the ground below the cells [m].

        It is NaN where it is not wanted, or too little is known.
        """
        kernels, terms = self._kernels, _TERMS[: _COUNT[self.degree]]
        powers = _powers(2 * self.degree)
        pairs = np.array([[powers.index((a + c, b + d)) for c, d in terms] for a, b in terms])
        whole = np.array([kernels[2 * a].sum() * kernels[2 * b].sum() for a, b in terms])
        prior = whole * [_DEFINITE if a + b < 2 else CURVATURE_PRIOR for a, b in terms]
        sums = self._sums[:, [_powers(self.degree).index(term) for term in terms]]
        solved, leverages = np.empty((2, len(sums)))
        _solve(self._counts, sums, pairs, prior, solved, leverages)
        surface = np.full(self._wanted.shape, np.nan)
        surface[self._wanted] = np.where(leverages <= MOST_LEVERAGE, solved + self._middle, np.nan)
        return surface


@numba.njit(cache=True)
def _solve(counts: Any, sums: Any, pairs: Any, prior: Any, solved: Any, leverages: Any) -> None:
    """Solve the normal equations of each cell for its surface below the cell itself.

    Args:
        counts: (N, M) moments of the cells about each of N cells.
        sums: (N, terms) moments of their heights.
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
            for j in range(i, n):
                rows[i, j] = counts[cell, pairs[n - 1 - i, n - 1 - j]]
            rows[i, i] += prior[n - 1 - i]
            rows[i, n] = sums[cell, n - 1 - i]
        for i in range(n - 1):
            for k in range(i + 1, n):
                factor = rows[i, k] / rows[i, i]  # The equations are symmetric.
                for j in range(k, n + 1):
                    rows[k, j] -= factor * rows[i, j]
        solved[cell] = rows[n - 1, n] / rows[n - 1, n - 1]
        leverages[cell] = 1.0 / rows[n - 1, n - 1]


def _powers(degree: int) -> list[tuple[int, int]]:
    """Return the powers of row and column, in the order of moments, up to a degree in all."""
    return [(row, column) for row in range(degree + 1) for column in range(degree + 1 - row)]


@numba.njit(cache=True, fastmath={"contract"})
def _sum_about(values: Any, kernels: Any, degree: int, places: Any, moments: Any) -> None:
    """Sum weighted values times powers of row and column about each wanted cell.

    Args:
        values: (rows, columns) values of the cells.
        kernels: (powers, size) weights times a power of the offset, about the middle.
        degree: Highest power of row and column together.
        places: (rows, columns) number of each wanted cell, -1 for others.
        moments: (N, M) sums by the cell's number, in the order of `_powers`; overwritten.
    """
    rows, columns = values.shape
    size = kernels.shape[1]
    reach = size // 2
    # Whole rows at a time, which the processor takes several cells of at once.
    along, total = np.zeros((degree + 1, columns + 2 * reach)), np.empty(columns)
    for r in range(rows):
        along[:] = 0.0
        for t in range(max(0, reach - r), min(size, rows + reach - r)):
            row = values[r + t - reach]
            for power in range(degree + 1):
                weight, sums = kernels[power, t], along[power, reach : reach + columns]
                for c in range(columns):
                    sums[c] += weight * row[c]
        moment = 0
        for power in range(degree + 1):
            for other in range(degree + 1 - power):
                total[:] = 0.0
                for t in range(size):
                    weight, row = kernels[other, t], along[power, t : t + columns]
                    for c in range(columns):
                        total[c] += weight * row[c]
                for c in range(columns):
                    if places[r, c] >= 0:
                        moments[places[r, c], moment] = total[c]
                moment += 1


@numba.njit(cache=True)
def _add_about(
    cells: Any, values: Any, kernels: Any, degree: int, places: Any, moments: Any
) -> None:
    """Add the values (K,) of some cells (K, 2), row and column, to what `_sum_about` sums."""
    rows, columns = places.shape
    reach = kernels.shape[1] // 2
    for cell in range(len(values)):
        row, column = cells[cell]
        for r in range(max(0, row - reach), min(rows, row + reach + 1)):
            for c in range(max(0, column - reach), min(columns, column + reach + 1)):
                if places[r, c] < 0:
                    continue
                sums, moment = moments[places[r, c]], 0
                for power in range(degree + 1):
                    weight = values[cell] * kernels[power, row - r + reach]
                    for other in range(degree + 1 - power):
                        sums[moment] += weight * kernels[other, column - c + reach]
                        moment += 1
