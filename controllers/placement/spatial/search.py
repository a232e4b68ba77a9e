"""Where to put a camera in space: all candidates one by one, or best first with a bound.

Thesis section 4.2.3 searches the known free space point by point. Here the candidates are
directions about the target (the half sphere before it) at rings of distances. The fast search goes
through a tree of triangles, best bound first; it yields the same candidates in the order of their
ratings, so the first one is the optimum of all of them.
"""

from __future__ import annotations

import dataclasses
import heapq
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from controllers.placement.spatial import kernels
from controllers.placement.spatial.directions import DEEPEST, DirectionTree, direction_tree
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.spatial.views import (
    Occupancy,
    probabilities_at,
    rate_positions,
    spherical,
    terms_of,
)
from controllers.placement.task import (
    FREE_BELOW,
    Exponents,
    Lens,
    PlacementError,
    View,
)

__all__ = [
    "DEFAULT",
    "Accept",
    "Occupancy",
    "Rated",
    "SearchConfig",
    "best_view",
    "best_view_of_all",
    "rate_directions",
    "rate_positions",
    "spherical",
    "views_in_order",
]

FloatArray = NDArray[np.float64]

Accept = Callable[[View], bool]

_PATTERN = 48
_SHRINK = 0.8
_FINEST = np.deg2rad(0.01)


@dataclasses.dataclass(frozen=True)
class SearchConfig:
    """What is tried.

    Attributes:
        level: Of the directions' tree; 4^(level + 1) directions.
        rings: How many distances from the lens' near to its far limit, in equal ratios.
        exponents: Of eq. 4-1.
        refine: Whether the best candidate is improved between its neighbours.
    """

    level: int = 5
    rings: int = 20
    exponents: Exponents = Exponents()  # noqa: RUF009
    refine: bool = True

    def __post_init__(self) -> None:
        """Refuse what is no search.

        Raises:
            ValueError: Naming the offender.
        """
        if not 0 <= self.level <= DEEPEST:
            raise ValueError(f"level {self.level}: expected 0 to {DEEPEST}")
        if self.rings < 2:  # noqa: PLR2004
            raise ValueError(f"rings {self.rings}: expected at least 2")

    @property
    def size(self) -> int:
        """Number of candidates for each target."""
        return 4 ** (self.level + 1) * self.rings


DEFAULT = SearchConfig()


@dataclasses.dataclass(frozen=True)
class _Search:
    """One target's candidates, ready to be rated."""

    field: TargetField
    lens: Lens
    occupancy: Occupancy | None
    config: SearchConfig
    tree: DirectionTree
    candidates: kernels.Candidates
    terms: kernels.Terms

    def place(self, leaf: int, ring: int) -> FloatArray:
        """Return (3,) a candidate's position [m], world."""
        radius = self.candidates.rings[ring]
        return self.field.to_world(radius * self.tree.leaves[leaf])

    def view(self, position: FloatArray) -> View:
        """Describe a camera's position."""
        return rate_positions(
            self.field, self.lens, position[None], self.occupancy, self.config.exponents
        )[0]


def best_view(
    fields: Sequence[TargetField],
    lens: Lens,
    occupancy: Occupancy | None = None,
    accept: Accept | None = None,
    config: SearchConfig = DEFAULT,
) -> View:
    """Return the best of all views of any of some targets.

    Args:
        fields: The targets with what may hide them.
        lens: The camera.
        occupancy: Gives P at points; a camera may only be where it is below 0.05. None: all free.
        accept: Says whether a view can be taken, for instance reached by an arm; views are offered
            best first until one is.
        config: What is tried.

    Raises:
        PlacementError: If no pose sees any of the targets; it names the nearest reason.
        ValueError: If there is no target.
    """
    searches = _searches(fields, lens, occupancy, config)
    refused = 0
    for view, search in _merged(searches):
        if accept is not None and not accept(view):
            refused += 1
            continue
        if not config.refine:
            return view
        better = _refined(search, view)
        return better if accept is None or better is view or accept(better) else view
    raise PlacementError(_reason(searches, refused))


def views_in_order(
    fields: Sequence[TargetField],
    lens: Lens,
    occupancy: Occupancy | None = None,
    config: SearchConfig = DEFAULT,
) -> Iterator[View]:
    """Yield all candidates that see a target, best first; none where there is none.

    Args:
        fields: The targets with what may hide them.
        lens: The camera.
        occupancy: As for `best_view`.
        config: What is tried; `refine` has no effect.
    """
    for view, _ in _merged(_searches(fields, lens, occupancy, config)):
        yield view


def best_view_of_all(
    fields: Sequence[TargetField],
    lens: Lens,
    occupancy: Occupancy | None = None,
    config: SearchConfig = DEFAULT,
) -> View:
    """Return the best candidate by rating every one (the thesis' way); the reference.

    Args:
        fields: The targets with what may hide them.
        lens: The camera.
        occupancy: As for `best_view`.
        config: What is tried; `refine` has no effect.

    Raises:
        PlacementError: As `best_view`.
    """
    searches = _searches(fields, lens, occupancy, config)
    best, place = 0.0, None
    for search in searches:
        found = search.candidates
        rating, leaf, ring = kernels.best_of_all(
            search.field.hulls, search.terms, search.tree.leaves, found.rings, found.occupancy
        )
        if rating > best:
            best, place = rating, (search, leaf, ring)
    if place is None:
        raise PlacementError(_reason(searches, 0))
    search, leaf, ring = place
    return search.view(search.place(leaf, ring))


@dataclasses.dataclass(frozen=True)
class Rated:
    """Directions that see a target, each at its best distance, in falling order of rating.

    Attributes:
        ratings: (N,) eq. 4-1 [1/m], all above 0.
        positions: (N, 3) of the camera [m], world.
        fields: (N,) number of the target.
    """

    ratings: FloatArray
    positions: FloatArray
    fields: NDArray[np.int64]


def rate_directions(
    fields: Sequence[TargetField],
    lens: Lens,
    occupancy: Occupancy | None = None,
    config: SearchConfig = DEFAULT,
) -> Rated:
    """Rate every direction about every target at its best distance.

    Args:
        fields: The targets with what may hide them.
        lens: The camera.
        occupancy: As for `best_view`.
        config: What is tried; `refine` has no effect.

    Raises:
        PlacementError: As `best_view`.
    """
    searches = _searches(fields, lens, occupancy, config)
    parts: list[tuple[FloatArray, FloatArray, NDArray[np.int64]]] = []
    for index, search in enumerate(searches):
        leaves = search.tree.leaves
        ratings, rings = np.empty(len(leaves)), np.empty(len(leaves), dtype=np.int64)
        kernels.best_of_each(search.field.hulls, search.terms, search.candidates, ratings, rings)
        seen = np.flatnonzero(ratings > 0.0)
        local = leaves[seen] * search.candidates.rings[rings[seen], None]
        numbers = np.full(len(seen), index)
        parts.append((ratings[seen], search.field.to_world(local), numbers))
    ratings, positions, numbers = (np.concatenate(part) for part in zip(*parts))
    if len(ratings) == 0:
        raise PlacementError(_reason(searches, 0))
    order = np.argsort(-ratings, kind="stable")
    return Rated(ratings[order], np.ascontiguousarray(positions[order]), numbers[order])


def _searches(
    fields: Sequence[TargetField], lens: Lens, occupancy: Occupancy | None, config: SearchConfig
) -> list[_Search]:
    if not fields:
        raise ValueError("no target: give at least one")
    tree = direction_tree(config.level)
    rings = np.geomspace(lens.near, lens.far, config.rings)
    rings[[0, -1]] = lens.near, lens.far  # In spite of rounding they are in focus.
    made: list[_Search] = []
    for field in fields:
        if occupancy is None:
            chances = np.zeros((len(tree.leaves), config.rings))
            first, lowest = np.zeros(len(tree.centres), np.int64), np.zeros(len(tree.centres))
        else:
            places = (tree.leaves[:, None] * rings[:, None]).reshape(-1, 3)
            chances = probabilities_at(occupancy, field.to_world(places)).reshape(-1, config.rings)
            free = chances < FREE_BELOW
            first = np.where(free.any(axis=1), free.argmax(axis=1), config.rings)
            first, lowest = tree.least(first), tree.least(chances.min(axis=1))
        candidates = kernels.Candidates(
            tree.centres, tree.radii, tree.first_leaf, rings, chances, first, lowest
        )
        terms = terms_of(field, lens, config.exponents)
        made.append(_Search(field, lens, occupancy, config, tree, candidates, terms))
    return made


def _in_order(search: _Search, number: int) -> Iterator[tuple[float, int, int, int]]:
    """Yield minus rating, number, leaf and ring of a target's candidates, best first."""
    room = len(search.tree.centres) + len(search.tree.leaves) * (search.config.rings + 1)
    heap = kernels.Heap(np.empty(room), np.empty(room, dtype=np.int64), np.zeros(1, np.int64))
    hulls, terms, candidates = search.field.hulls, search.terms, search.candidates
    kernels.start(hulls, terms, candidates, heap)
    while True:
        rating, leaf, ring = kernels.following(hulls, terms, candidates, heap)
        if leaf < 0:
            return
        yield -rating, number, leaf, ring


def _merged(searches: Sequence[_Search]) -> Iterator[tuple[View, _Search]]:
    streams = [_in_order(search, number) for number, search in enumerate(searches)]
    for _, index, leaf, ring in heapq.merge(*streams):
        search = searches[index]
        yield search.view(search.place(leaf, ring)), search


def _refined(search: _Search, view: View) -> View:
    """Improve a view between its neighbours, in steps down to 0.01 deg and 0.1 mm; never worse.

    The rating has ridges, on which moves along fixed axes would stall: a disc of places spread
    by the golden angle is tried about the best one, and shrunk when none is better. Along a sharp
    ridge it may still stop some tenths of a degree off the top, where the rating differs by parts
    in a million.
    """
    hulls, terms, lens = search.field.hulls, search.terms, search.lens
    index = np.arange(_PATTERN) + 0.5
    turn = np.pi * (1.0 + 5.0**0.5) * index
    disc = np.sqrt(index / _PATTERN)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    local = search.field.to_frame(view.position)
    distance = float(np.clip(view.distance, lens.near, lens.far))
    direction, best = local / np.linalg.norm(local), view.rating
    width = 2.0 * float(search.tree.radii[-1])
    step = 0.5 * (search.candidates.rings[1] / search.candidates.rings[0] - 1.0)
    tried = 0
    while width > _FINEST or step * lens.far > 1e-4:  # noqa: PLR2004
        side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        side /= np.linalg.norm(side)
        c, s = np.cos(tried), np.sin(tried)
        flat = disc @ np.array([[c, s], [-s, c]]) * width
        around = np.vstack([np.zeros(2), flat]) @ np.array([side, np.cross(direction, side)])
        around += direction
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        lengths = np.clip(
            distance * np.array([1.0 - step, 1.0 - step / 4, 1.0]), lens.near, lens.far
        )
        lengths = np.unique(lengths)
        sides = np.repeat(around, len(lengths), axis=0)
        radii = np.tile(lengths, len(around))
        places = search.field.to_world(sides * radii[:, None])
        chances = probabilities_at(search.occupancy, places)
        ratings = kernels.rate_places(hulls, terms, sides, radii, chances)
        top = int(np.argmax(ratings))
        tried += 1
        if ratings[top] > best * (1.0 + 1e-9):
            best, direction, distance = float(ratings[top]), sides[top], float(radii[top])
            if tried % 8:
                continue
        width, step = width * _SHRINK, step * _SHRINK
    found = search.view(search.field.to_world(direction * distance))
    return found if found.rating > view.rating else view


def _reason(searches: Sequence[_Search], refused: int) -> str:
    """Say why no pose sees any target, with the share of each reason."""
    lines: list[str] = []
    for search in searches:
        hiding = np.zeros(max(len(search.field.names), 1), dtype=np.int64)
        found, total = search.candidates, search.config.size
        not_free = kernels.count_reasons(
            search.field.hulls, search.tree.leaves, found.rings, found.occupancy, hiding
        )
        lens, shares = search.lens, list[tuple[int, str]]()
        if hiding.sum():
            worst = search.field.names[int(np.argmax(hiding))]
            shares.append((int(hiding.sum()), f"hidden (most by {worst!r})"))
        shares.append((not_free, "not known to be free"))
        if refused:
            shares.append((total - not_free - int(hiding.sum()), "refused (out of reach)"))
        text = ", ".join(f"{n / total:.0%} are {what}" for n, what in sorted(shares)[::-1] if n)
        lines.append(
            f"no pose sees the target {search.field.target.name!r}: of {total} poses before it, "
            f"{lens.near:g} to {lens.far:g} m away, {text}"
        )
    return "; ".join(lines)
