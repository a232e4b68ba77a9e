"""Placing a camera again and again on a voxel map that changes, within a vision period.

What may hide a target are the occupied voxels within the lens' reach of it, cut into tiles; a
tile's hull is made again only when one of its voxels has changed, or when something that moves and
whose shape is known stands in it: its voxels leave the map, and its shape where it was measured
takes their place (thesis section 4.3.1).

What is farther from the target than the camera hides nothing. So hulls are made only for tiles
within some radius; the search rates farther views too high, and as long as it offers nearer ones
first, those are the best of all. When it offers a farther one the radius grows.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.placement.spatial.occluders import (
    HullParts,
    TargetField,
    expand,
    occluders_of_voxels,
)
from controllers.placement.spatial.search import (
    Occupancy,
    SearchConfig,
    SpatialTask,
    best_view,
    rate_positions,
)
from controllers.placement.task import FREE_BELOW, Lens, Occluder, PlacementError, Target, View
from perception.voxels.bricks import NEVER
from perception.voxels.map import MapWindow, VoxelMap, window

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Key = tuple[int, int, int]

START = 1.3
"""HullParts are made at first within this times the nearest distance in focus,"""
GROWTH = 1.5
"""then within this times the distance of a view that is farther."""


@dataclasses.dataclass(frozen=True)
class ReplanConfig:
    """How a camera is placed again.

    Attributes:
        search: Candidates. Not refined: that takes as long as all else, for less than half a
            percent of the rating on the map of chapter 3.
        tile: Side of the tiles that voxels are gathered in [voxels].
        margin: Uncertainty of the map's surfaces [m]: hulls grow by it.
        face: Occupied voxels whose middle is no higher over a target's plane than this are its own
            face [m].
        factor: The camera moves only to a view that rates better than its present one by this, or
            when it does not see a target any more.
    """

    search: SearchConfig = SearchConfig(refine=False)  # noqa: RUF009
    tile: int = 8
    margin: float = 0.0
    face: float = 0.02
    factor: float = 1.1

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            ValueError: Naming it.
        """
        if not self.factor >= 1.0:
            raise ValueError(f"factor {self.factor}: expected 1 or more")
        if not (self.tile >= 1 and self.margin >= 0.0 and self.face >= 0.0):
            raise ValueError(f"{self}: expected tile >= 1, margin and face >= 0")


@dataclasses.dataclass(frozen=True)
class Mover:
    """Something that moves and whose shape is known.

    Attributes:
        shape: Its convex solid where it was measured to be.
        margin: How far its surface may be from there [m].
    """

    shape: Occluder
    margin: float = 0.0


@dataclasses.dataclass(frozen=True)
class Replan:
    """What is to be done.

    Attributes:
        view: Where the camera should be.
        moves: Whether that is not where it is.
        present: Its present view of the best target from there; None if it sees none.
        made: Tiles whose hulls had to be made.
        tiles: Tiles with something in them that may hide a target.
    """

    view: View
    moves: bool
    present: View | None
    made: int
    tiles: int


@dataclasses.dataclass
class _Kept:
    """What is remembered of one target: its tiles' voxels, and the hulls of some of them.

    Attributes:
        target: It.
        states: Which voxels of each tile may hide it.
        fields: The hulls of tiles.
        cell: Side of a voxel [m].
        open: Whether anything right before it is known to be free.
    """

    target: Target
    states: dict[Key, bytes] = dataclasses.field(default_factory=dict)
    fields: dict[Key, TargetField] = dataclasses.field(default_factory=dict)
    cell: float = 0.01
    open: bool = False


class Replanner:
    """Places one camera for some targets.

    Attributes:
        targets: By name.
        lens: The camera.
        config: How.
    """

    def __init__(
        self, targets: Sequence[Target], lens: Lens, config: ReplanConfig | None = None
    ) -> None:
        """Remember nothing yet.

        Raises:
            ValueError: If there is no target, or two have one name.
        """
        self.targets = {target.name: target for target in targets}
        if not targets or len(self.targets) != len(targets):
            raise ValueError("expected at least one target, each of another name")
        self.lens = lens
        self.config = config or ReplanConfig()
        self._kept: dict[str, _Kept] = {}
        self.reset()

    def reset(self) -> None:
        """Forget all hulls."""
        self._kept = {name: _Kept(target) for name, target in self.targets.items()}

    def replan(
        self,
        voxels: VoxelMap,
        present: FloatArray | None = None,
        *,
        movers: Sequence[Mover] = (),
        watch: Sequence[str] | None = None,
        accept: Callable[[View], bool] | None = None,
        possible: Callable[[FloatArray], BoolArray] | None = None,
    ) -> Replan:
        """Choose where the camera should be.

        Args:
            voxels: The map as it is now.
            present: (3,) where the camera is [m], world; None if it is nowhere yet.
            movers: Moving objects where they are now.
            watch: Names of the targets that will do; None for all.
            accept: Says whether a view can be taken, for instance by `reach.Reach`.
            possible: Says of places (N, 3) at once where the camera cannot be brought, for instance
                `reach.Reach.possible`; `accept` is not asked about views from there.

        Raises:
            PlacementError: If a target is unknown, or no view can be had; it names the reason.
        """
        kept = self._watched(watch)
        for one in kept:
            self._look(one, voxels, movers)
        occupancy = _occupancy(voxels, movers)

        def candidates(points: FloatArray) -> FloatArray:
            chance = occupancy(points)
            if possible is not None:
                chance[~possible(points)] = 1.0
            return chance

        radius, made = START * self.lens.near, 0
        if present is not None:
            away = [np.linalg.norm(present - one.target.position) for one in kept]
            radius = max(radius, min(self.lens.far, float(max(away))))
        while True:
            fields, new = self._fields(kept, radius, movers)
            made += new
            taken = _within(radius, accept)
            try:
                best = best_view(
                    SpatialTask(fields, self.lens, candidates, self.config.search), taken
                )
            except _Beyond as beyond:
                radius = min(self.lens.far, GROWTH * beyond.distance)
                continue
            except PlacementError as error:
                if possible is None:
                    raise
                raise PlacementError(
                    f"{error}; where the camera cannot be brought does not count as free"
                ) from None
            break
        now = None if present is None else self._view_from(present, fields, occupancy)
        tiles = sum(len(one.states) for one in kept)
        if now is not None and best.rating < self.config.factor * now.rating:
            return Replan(now, False, now, made, tiles)
        return Replan(best, True, now, made, tiles)

    def _watched(self, watch: Sequence[str] | None) -> list[_Kept]:
        """Return what is remembered of some targets, or of all."""
        names = tuple(self.targets) if watch is None else tuple(watch)
        for name in names:
            if name not in self.targets:
                known = ", ".join(self.targets)
                raise PlacementError(f"target {name!r} is unknown; there are: {known}")
        return [self._kept[name] for name in names]

    def _view_from(
        self, place: FloatArray, fields: Sequence[TargetField], occupancy: Occupancy
    ) -> View | None:
        """Return the best view from a place (3,) [m], world; None if no target is seen there."""
        exponents = self.config.search.exponents
        seen = (rate_positions(f, self.lens, place[None], occupancy, exponents)[0] for f in fields)
        best = max(seen, key=lambda view: view.rating)
        return best if best.rating > 0.0 else None

    def _look(self, kept: _Kept, voxels: VoxelMap, movers: Sequence[Mover]) -> None:
        """Note what of the map may hide a target now; forget hulls of tiles that changed."""
        target, reach = kept.target, self.lens.far
        cut = window(voxels, target.position - reach, target.position + reach)
        before_it = np.arange(self.config.face, self.lens.near, cut.grid.resolution / 2.0)
        cells, _ = cut.grid.cells(target.position + before_it[:, None] * target.normal)
        values = cut.values[tuple(cells.T)]
        kept.open = bool(np.any((values != NEVER) & (values <= cut.known_below(FREE_BELOW))))
        first, size = cut.grid.first, self.config.tile
        # Whole tiles of a grid that does not depend on the window.
        before = first - size * (first // size)
        shape = -(-(before + np.array(cut.values.shape)) // size)
        padded = np.zeros(shape * size, dtype=bool)
        inner = tuple(
            slice(b, b + n) for b, n in zip(before.tolist(), cut.values.shape, strict=True)
        )
        padded[inner] = self._hiding(cut, target, movers)
        a, b, c = shape.tolist()
        blocks = padded.reshape(a, size, b, size, c, size).transpose(0, 2, 4, 1, 3, 5)
        found: dict[Key, bytes] = {}
        for index in np.argwhere(blocks.any(axis=(3, 4, 5))):
            i, j, k = (first // size + index).tolist()
            found[i, j, k] = blocks[tuple(index)].tobytes()
        for key in list(kept.fields):
            if found.get(key) != kept.states[key]:
                del kept.fields[key]
        kept.states, kept.cell = found, cut.grid.resolution

    def _fields(
        self, kept: Sequence[_Kept], radius: float, movers: Sequence[Mover]
    ) -> tuple[list[TargetField], int]:
        """Return each target with all that can hide it from within a radius, and how much is new.

        Raises:
            PlacementError: If all targets are within something.
        """
        fields: list[TargetField] = []
        refusals: list[str] = []
        made = 0
        for one in kept:
            width = float(np.linalg.norm(one.target.outline, axis=1).max()) + self.config.margin
            corners = one.cell * self.config.tile * (np.array(list(one.states)).reshape(-1, 3))
            off = corners - one.target.position
            side = one.cell * self.config.tile
            gap = np.linalg.norm(np.maximum(0.0, np.maximum(off, -off - side)), axis=1)
            near = [key for key, d in zip(one.states, gap, strict=True) if d <= radius + width]
            try:
                if not one.open:
                    # Of a solid only the surface is occupied, so that its hulls would not tell.
                    raise PlacementError(
                        f"no pose sees the target {one.target.name!r}: nothing right before it is "
                        "known to be free; it lies in an obstacle, or was never seen"
                    )
                for key in near:
                    if key not in one.fields:
                        one.fields[key] = self._tile(one, key)
                        made += 1
                parts = [one.fields[key] for key in near]
                parts += [expand(one.target, [m.shape], m.margin) for m in movers]
            except PlacementError as error:
                refusals.append(str(error))
                continue
            fields.append(_joined(one.target, parts))
        if not fields:
            raise PlacementError("; ".join(refusals))
        return fields, made

    def _hiding(self, cut: MapWindow, target: Target, movers: Sequence[Mover]) -> BoolArray:
        """Return which voxels may hide a target: before its face, and not of what moves."""
        occupied = cut.occupied()
        cells = np.argwhere(occupied)
        centres = cut.grid.centres(cells)
        keep = (centres - target.position) @ target.normal > self.config.face
        for mover in movers:
            planes = ConvexHull(mover.shape.points).equations
            # Half a voxel's diagonal more, for those that its surface only touches.
            keep &= ~_inside(planes, centres, mover.margin + 0.87 * cut.grid.resolution)
        hiding = np.zeros_like(occupied)
        hiding[tuple(cells[keep].T)] = True
        return hiding

    def _tile(self, kept: _Kept, key: Key) -> TargetField:
        """Return what a tile's voxels hide."""
        size = self.config.tile
        inside = np.frombuffer(kept.states[key], dtype=bool).reshape(size, size, size)
        centres = (np.array(key) * size + np.argwhere(inside) + 0.5) * kept.cell
        place = ", ".join(f"{x:.2f}" for x in centres.mean(axis=0))
        parts = occluders_of_voxels(centres, kept.cell, size, f"voxels about ({place}) m, part")
        return expand(kept.target, parts, self.config.margin)


class _Beyond(Exception):  # noqa: N818
    """A view is farther away than hulls are known."""

    def __init__(self, distance: float) -> None:
        super().__init__(f"a view {distance} m away")
        self.distance = distance


def _occupancy(voxels: VoxelMap, movers: Sequence[Mover]) -> Occupancy:
    """Return P by the map, and 1 within what moves."""
    solid = [(ConvexHull(m.shape.points).equations, m.margin) for m in movers]

    def occupancy(points: FloatArray) -> FloatArray:
        chance = voxels.probabilities(points)
        for planes, margin in solid:
            chance[_inside(planes, points, margin)] = 1.0
        return chance

    return occupancy


def _within(radius: float, accept: Callable[[View], bool] | None) -> Callable[[View], bool]:
    """Return whether views can be taken; farther ones are not yet rated with all that hides."""

    def accepts(view: View) -> bool:
        if view.distance > radius:
            raise _Beyond(view.distance)
        return accept is None or accept(view)

    return accepts


def _inside(planes: FloatArray, points: FloatArray, margin: float) -> BoolArray:
    """Return which points (N, 3) lie within a hull's planes (M, 4), moved out by a margin."""
    inside = np.ones(len(points), dtype=bool)
    for *normal, offset in planes:
        inside &= points @ np.array(normal) + offset <= margin
    return inside


def _joined(target: Target, parts: Sequence[TargetField]) -> TargetField:
    """Return one field with the hulls of many."""
    empty = expand(target, [])
    if not parts:
        return empty
    columns = list(zip(*(part.hulls for part in parts), strict=True))
    arrays: list[Any] = [
        _starts(column) if name.endswith("_start") else np.concatenate(column)
        for name, column in zip(HullParts._fields, columns, strict=True)
    ]
    names = tuple(itertools.chain.from_iterable(part.names for part in parts))
    shapes = tuple(itertools.chain.from_iterable(part.shapes for part in parts))
    return TargetField(target, empty.rotation, names, HullParts(*arrays), shapes)


def _starts(column: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return where the parts of all hulls begin, of arrays that say it of some each."""
    counts = np.concatenate([np.diff(starts) for starts in column])
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
