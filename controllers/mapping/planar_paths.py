"""Shortest collision-free paths on the known-free cells of a planar map."""

import dataclasses

import numba
import numpy as np

from perception.geometry.arrays import BoolArray, FloatArray, IntArray

ROOT = 2.0**0.5


@dataclasses.dataclass(frozen=True)
class Paths:
    """Shortest paths from one cell to all others.

    Attributes:
        start: Row and column of the first cell.
        lengths: (rows, columns) length of the path [m], times what its cells cost; infinite where
            there is none.
        previous: (rows, columns) flat index of the cell before, -1 where none.
    """

    start: tuple[int, int]
    lengths: FloatArray
    previous: IntArray

    def to(self, cell: tuple[int, int]) -> IntArray:
        """Return the cells (n, 2) of the path to a cell, its start first.

        Raises:
            ValueError: If no path leads there.
        """
        if not np.isfinite(self.lengths[cell]):
            raise ValueError(f"cell {cell}: no collision-free path from {self.start}")
        columns = self.lengths.shape[1]
        flat = [cell[0] * columns + cell[1]]
        while (before := int(self.previous.flat[flat[-1]])) >= 0:
            flat.append(before)
        return np.array([divmod(index, columns) for index in reversed(flat)], dtype=np.int64)


def shortest_paths(
    enterable: BoolArray | FloatArray,
    start: tuple[int, int],
    cell: float,
    limit: float = np.inf,
    goals: IntArray | None = None,
) -> Paths:
    """Find shortest paths by Dijkstra's method to eight neighbours, without cutting corners.

    A diagonal step needs both cells beside it.

    Args:
        enterable: (rows, columns) cells that may be entered; or how many times its length a step
            into each costs, infinite for a cell that may not be entered.
        start: Row and column of the first cell; it need not be enterable.
        cell: Side of a cell [m].
        limit: Length beyond which paths are not searched for [m].
        goals: (N, 2) cells, row and column, beyond the last of which paths are not searched for;
            those found to other cells need not be the shortest. None for all cells.
    """
    wanted = np.zeros(enterable.shape, dtype=bool)
    if goals is not None:
        wanted[*goals.T] = True
    left = np.count_nonzero(wanted) if goals is not None else enterable.size + 1
    costs = np.where(enterable, 1.0, np.inf) if enterable.dtype == np.bool_ else enterable
    lengths, previous = _dijkstra(costs, start[0], start[1], limit / cell, wanted, left)
    return Paths(start, lengths * cell, previous)


@numba.njit(cache=True)
def _dijkstra(costs, row, column, limit, wanted, left):
    """Settle cells in order of distance with a binary heap; entries out of date are skipped."""
    rows, columns = costs.shape
    distance = np.full(rows * columns, np.inf)
    previous = np.full(rows * columns, -1, dtype=np.int64)
    settled = np.zeros(rows * columns, dtype=np.bool_)
    keys = np.empty(8 * rows * columns + 1)
    items = np.empty(8 * rows * columns + 1, dtype=np.int64)
    keys[0], items[0], size = 0.0, row * columns + column, 1
    distance[items[0]] = 0.0
    while size > 0 and left > 0:
        here, at = items[0], keys[0]
        size -= 1
        _sift_down(keys, items, size)
        if settled[here]:
            continue
        settled[here] = True
        r, c = here // columns, here % columns
        left -= wanted[r, c]
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                nr, nc = r + dr, c + dc
                if nr < 0 or nr >= rows or nc < 0 or nc >= columns or costs[nr, nc] == np.inf:
                    continue
                diagonal = dr != 0 and dc != 0
                if diagonal and (costs[r, nc] == np.inf or costs[nr, c] == np.inf):
                    continue
                there = nr * columns + nc
                new = at + (ROOT if diagonal else 1.0) * costs[nr, nc]
                if new < distance[there] and new <= limit:
                    distance[there], previous[there] = new, here
                    _sift_up(keys, items, size, new, there)
                    size += 1
    return distance.reshape(rows, columns), previous.reshape(rows, columns)


@numba.njit(cache=True)
def _sift_up(keys, items, place, key, item):
    """Add an entry at the end of the heap and raise it."""
    while place > 0:
        above = (place - 1) // 2
        if keys[above] <= key:
            break
        keys[place], items[place] = keys[above], items[above]
        place = above
    keys[place], items[place] = key, item


@numba.njit(cache=True)
def _sift_down(keys, items, size):
    """Replace the first entry by the one at ``size``, the last, and lower it."""
    key, item, place = keys[size], items[size], 0
    while True:
        below = 2 * place + 1
        if below >= size:
            break
        if below + 1 < size and keys[below + 1] < keys[below]:
            below += 1
        if keys[below] >= key:
            break
        keys[place], items[place] = keys[below], items[below]
        place = below
    keys[place], items[place] = key, item
