"""Where a rover of some outline and heading may drive: one flood fill answers for all places.

The outline is made of upright boxes, each within its own heights: a folded arm is slimmer than the
wheels below it. Poses are cells and headings. At a cell and heading the rover may be if everything
is free that its boxes can cover while its middle is anywhere in the cell and its heading within
half a step, so that turning from one heading to the next and standing in between are covered too.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
from collections.abc import Sequence

import numba
import numpy as np
import scipy.ndimage
from numpy.typing import ArrayLike, NDArray

from controllers.placement.reach.ground import Ground
from controllers.placement.task import FREE_BELOW

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

HEADINGS = 32
"""Over a whole turn, the first one the rover's own."""
OCCUPIED = 0.5
"""From this probability on, not even ground that the rover hides from itself is free."""
TURNING = 0.05
"""Of two ways as long the one with less turning is taken: a radian counts as so much [m]."""
_SWEEP = 5  # Headings within a step at which a box is drawn.
_SAME = 1e-9  # [m]
_ROOM = 2  # Cells about the rover that count as free, so that its first step is not lost.


@dataclasses.dataclass(frozen=True)
class Part:
    """A box of the outline, and what is known of what is at its heights.

    Attributes:
        box: Lowest and highest x, lowest and highest y [m], frame of the rover.
        ground: Free where nothing is within the box's heights. All parts' have the same cells.
    """

    box: tuple[float, float, float, float]
    ground: Ground


@dataclasses.dataclass(frozen=True)
class PoseDrives:
    """Where a rover can get to, and in which heading.

    Attributes:
        ground: Its cells.
        start: (3,) x, y [m] and heading [rad] of the rover, world.
        enterable: (headings, rows, columns) where it may be.
        costs: (headings, rows, columns) length of the way there and its turning [m]; infinite
            where none leads.
        previous: (headings, rows, columns) flat index of the pose before, -1 where none.
        farthest: More was not looked for [m].
    """

    ground: Ground
    start: FloatArray
    enterable: BoolArray
    costs: FloatArray
    previous: IntArray
    farthest: float

    def lengths(self, places: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return whether poses (N, 3) x, y, heading are free, and (N,) what they cost [m]."""
        layers, cells, inside = self._poses(places)
        row, column = cells.T
        free = inside & self.enterable[layers, row, column]
        return free, np.where(free, self.costs[layers, row, column], np.inf)

    def gaps(self, points: FloatArray) -> FloatArray:
        """Return (N,) how far points (N, 2) are from where the rover can be, at most less [m]."""
        cells, inside = self.ground.cells(points)
        return np.where(inside, self._gaps[*cells.T], 0.0)

    @functools.cached_property
    def _gaps(self) -> FloatArray:
        return self.ground.gaps(self.costs.min(axis=0))

    def way(self, place: ArrayLike) -> FloatArray:
        """Return (n, 2) points of the way to a pose (3,) [m], both ends included.

        Raises:
            ValueError: If no way leads there.
        """
        poses = self.poses(place)
        moved = np.any(np.abs(np.diff(poses[:, :2], axis=0)) > _SAME, axis=1)
        return poses[np.concatenate([[True], moved]), :2]

    def poses(self, place: ArrayLike) -> FloatArray:
        """Return (n, 3) x, y, heading on the way to a pose (3,), both ends included.

        Raises:
            ValueError: If no way leads there.
        """
        goal = np.asarray(place, dtype=float)
        layers, cells, inside = self._poses(goal[None])
        index = (int(layers[0]), int(cells[0, 0]), int(cells[0, 1]))
        if not (inside[0] and np.isfinite(self.costs[index])):
            raise ValueError(f"pose {goal}: no collision-free way from {self.start}")
        shape = self.costs.shape
        flat = [int(np.ravel_multi_index(index, shape))]
        while (before := int(self.previous.flat[flat[-1]])) >= 0:
            flat.append(before)
        k, rows, columns = np.unravel_index(flat[-2:0:-1], shape)
        between = self.ground.centres(np.column_stack([rows, columns]))
        turns = self.start[2] + np.asarray(k) * 2.0 * np.pi / shape[0]
        return np.vstack([self.start, np.column_stack([between, turns]), goal])

    def _poses(self, places: FloatArray) -> tuple[IntArray, IntArray, BoolArray]:
        count = len(self.enterable)
        turns = (places[:, 2] - self.start[2]) * count / (2.0 * np.pi)
        cells, inside = self.ground.cells(places[:, :2])
        return np.rint(turns).astype(np.int64) % count, cells, inside


def pose_drives(
    parts: Sequence[Part], start: ArrayLike, farthest: float, headings: int = HEADINGS
) -> PoseDrives:
    """Return where a rover can get to by driving straight on or back and turning on the spot.

    What it covers where it stands is free unless it is known to be occupied: from there it could
    not have been seen.

    Args:
        parts: Its outline.
        start: (3,) x, y [m] and heading [rad] of the rover's middle, world.
        farthest: Longest way to look for [m].
        headings: Over a whole turn; a multiple of 8, so that some are along the rows.

    Raises:
        ValueError: If there is no part, the rover is not on the map, or the headings do not do.
    """
    if not parts:
        raise ValueError("an outline needs at least one part")
    if headings < 8 or headings % 8:  # noqa: PLR2004
        raise ValueError(f"headings: got {headings}, needs a multiple of 8")
    pose, ground = np.asarray(start, dtype=float), parts[0].ground
    cells, inside = ground.cells(pose[None, :2])
    if not inside[0]:
        raise ValueError(f"rover at {pose[:2]} m: outside of the map of the ground")
    row, column = int(cells[0, 0]), int(cells[0, 1])
    enterable = np.ones((headings, *ground.probability.shape), dtype=np.bool_)
    turns = pose[2] + 2.0 * np.pi / headings * np.arange(headings)
    for part in parts:
        runs = [_runs(part.box, turn, np.pi / headings, ground.cell) for turn in turns]
        blocked = ~(part.ground.probability < FREE_BELOW)
        own = _covered(runs[0], blocked.shape, row, column)
        blocked &= ~own | (part.ground.probability >= OCCUPIED)
        counts = np.zeros((blocked.shape[0], blocked.shape[1] + 1), dtype=np.int64)
        np.cumsum(blocked, axis=1, out=counts[:, 1:])
        for layer, run in zip(enterable, runs, strict=True):
            _strike(layer, counts, run)
    costs, previous = _flood(
        enterable, row, column, turns[0], farthest / ground.cell, TURNING / ground.cell
    )
    return PoseDrives(ground, pose, enterable, costs * ground.cell, previous, farthest)


def _runs(
    box: tuple[float, float, float, float], turn: float, half_step: float, cell: float
) -> IntArray:
    """Return (rows, 3) offsets of row, first and last column of what a box can cover [cells]."""
    low_x, high_x, low_y, high_y = box
    reach = int(np.ceil(np.hypot(max(-low_x, high_x), max(-low_y, high_y)) / cell)) + 3
    axis = cell * np.arange(-reach, reach + 1)
    x, y = np.meshgrid(axis, axis)
    covered = np.zeros(x.shape, dtype=bool)
    # Between two of the angles a corner's arc bulges out by this.
    corner = np.hypot(max(-low_x, high_x), max(-low_y, high_y))
    bulge = corner * (1.0 - np.cos(half_step / (_SWEEP - 1)))
    for angle in turn + half_step * np.linspace(-1.0, 1.0, _SWEEP):
        c, s = np.cos(angle), np.sin(angle)
        along, up = c * x + s * y, c * y - s * x
        # Half a cell for the cell's own size, and half for where in its cell the middle is.
        grown = cell * (abs(c) + abs(s)) + bulge
        covered |= (
            (along > low_x - grown)
            & (along < high_x + grown)
            & (up > low_y - grown)
            & (up < high_y + grown)
        )
    rows = np.flatnonzero(covered.any(axis=1))
    first = covered[rows].argmax(axis=1)
    last = covered.shape[1] - 1 - covered[rows, ::-1].argmax(axis=1)
    runs = np.column_stack([rows, first, last]) - reach
    # The middle first: most cells are struck out by what is on them.
    return np.ascontiguousarray(runs[np.argsort(np.abs(runs[:, 0]), kind="stable")])


def _covered(run: IntArray, shape: tuple[int, ...], row: int, column: int) -> BoolArray:
    """Return (rows, columns) what is covered from a cell, and a little about it."""
    covered = np.zeros(shape, dtype=np.bool_)
    for dr, first, last in run:
        if 0 <= row + dr < shape[0]:
            covered[row + dr, max(0, column + first) : max(0, column + last + 1)] = True
    square = np.ones((2 * _ROOM + 1, 2 * _ROOM + 1), dtype=bool)
    return np.asarray(scipy.ndimage.binary_dilation(covered, square), dtype=np.bool_)


@numba.njit(cache=True)
def _strike(layer, counts, runs):
    """Strike out the cells from which a run covers something blocked, or leaves the map."""
    rows, columns = layer.shape
    for r in range(rows):
        for c in range(columns):
            if not layer[r, c]:
                continue
            for i in range(runs.shape[0]):
                row, first, last = r + runs[i, 0], c + runs[i, 1], c + runs[i, 2]
                if row < 0 or row >= rows or first < 0 or last >= columns:
                    layer[r, c] = False
                    break
                if counts[row, last + 1] > counts[row, first]:
                    layer[r, c] = False
                    break


@numba.njit(cache=True)
def _flood(enterable, row, column, heading, limit, turning):
    """Settle poses in order of cost: straight steps along the heading, and turns on the spot."""
    layers, rows, columns = enterable.shape
    costs = np.full(enterable.shape, np.inf)
    previous = np.full(enterable.shape, -1, dtype=np.int64)
    flat, before = costs.reshape(-1), previous.reshape(-1)
    step = 2.0 * np.pi / layers
    begin = row * columns + column
    flat[begin] = 0.0
    heap = [(0.0, begin)]
    while len(heap) > 0:
        cost, here = heapq.heappop(heap)
        if cost > flat[here]:
            continue
        k, rest = here // (rows * columns), here % (rows * columns)
        r, c = rest // columns, rest % columns
        for move in range(10):
            nk, nr, nc, new = k, r, c, cost
            if move >= 8:
                nk = (k + 2 * move - 17) % layers
                new += turning * step
            else:
                # The rover's heading is its y axis.
                ahead = heading + k * step + np.pi / 2.0
                off = abs((move * np.pi / 4.0 - ahead + np.pi / 2.0) % np.pi - np.pi / 2.0)
                if off > step / 2.0 + 1e-9:
                    continue
                nc += int(np.rint(np.cos(move * np.pi / 4.0)))
                nr += int(np.rint(np.sin(move * np.pi / 4.0)))
                if nr < 0 or nr >= rows or nc < 0 or nc >= columns:
                    continue
                new += 1.0 if move % 2 == 0 else 2.0**0.5
            there = (nk * rows + nr) * columns + nc
            if new <= limit and new < flat[there] and enterable[nk, nr, nc]:
                flat[there], before[there] = new, here
                heapq.heappush(heap, (new, there))
    return costs, previous
