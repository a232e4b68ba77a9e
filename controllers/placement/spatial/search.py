"""Camera placement in space: the best view of any target (Thesis section 4.2.3).

The thesis searches the known free space point by point. Here the candidates are directions about
the target (the half sphere before it) at rings of distances. The fast search goes through a tree
of triangles, best bound first; it yields the candidates in the order of their ratings, so the
first one is the optimum of all of them. Cameras anywhere are rated one by one (eq. 4-1).
"""

import dataclasses
import heapq
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from controllers.placement.spatial import best_first
from controllers.placement.spatial.best_first import MAX_LEVEL, direction_tree
from controllers.placement.spatial.field import free_caps
from controllers.placement.spatial.occluders import TargetField
from controllers.placement.task import (
    FREE_BELOW,
    Exponents,
    Lens,
    PlacementError,
    RatingTerms,
    View,
    rating_terms,
)
from perception.geometry.arrays import FloatArray, IntArray

Accept = Callable[[View], bool]
"""Returns whether a view is feasible, for instance within reach of an arm."""
Occupancy = Callable[[FloatArray], FloatArray]
"""Probability (N,) that points (N, 3) [m], world, are occupied; NaN where unknown."""

UNKNOWN = 0.5
"""Probability of occupancy where nothing is known."""
_FOCUS_TOLERANCE = 1e-9
"""Difference to a limit of the lens up to which a distance is at it [m]."""
_PATTERN = 48
"""Directions tried at once to improve a view."""
_TRIES = 16
"""Number of the better ones whose feasibility is checked, from the best to the least: where the
best is not feasible, its neighbours mostly are not, either."""
_SHRINK = 0.8
"""Factor of the pattern's size where none is better."""
_MIN_TURN = np.deg2rad(0.01)
_MIN_STRIDE = 1e-4
"""Size of the pattern [rad] and [m] at which the improvement ends."""


@dataclasses.dataclass(frozen=True)
class SearchConfig:
    """Candidates of a search and how they are rated.

    Attributes:
        level: Level of the tree of directions, 0 to `MAX_LEVEL`; it has 4^(level + 1) directions.
        rings: Number of distances from the lens' near to its far limit, in equal ratios.
        exponents: Exponents of eq. 4-1.
        refine: Whether the best candidate is improved between its neighbours.

    Raises:
        ValueError: If a number is out of range; the message names it.
    """

    level: int = 5
    rings: int = 20
    exponents: Exponents = Exponents()  # noqa: RUF009
    refine: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.level <= MAX_LEVEL:
            raise ValueError(f"level {self.level}: expected 0 to {MAX_LEVEL}")
        if self.rings < 2:  # noqa: PLR2004
            raise ValueError(f"rings {self.rings}: expected at least 2")

    @property
    def size(self) -> int:
        """Number of candidates for each target."""
        return 4 ** (self.level + 1) * self.rings


DEFAULT = SearchConfig()


@dataclasses.dataclass(frozen=True)
class SpatialTask:
    """All that a placement in space depends on.

    Attributes:
        fields: Targets with their occluders; any of them may be watched.
        lens: Lens of the camera.
        occupancy: Probability of occupancy at points; a camera position is free where it is below
            `task.FREE_BELOW`. None if all is free.
        config: Candidates and exponents.

    Raises:
        ValueError: If there is no target.
    """

    fields: Sequence[TargetField]
    lens: Lens
    occupancy: Occupancy | None = None
    config: SearchConfig = DEFAULT

    def __post_init__(self) -> None:
        if not self.fields:
            raise ValueError("no target: give at least one")

    def prepared(self) -> "list[_PreparedTarget]":
        """Return each target's candidates, ready to be rated."""
        tree, config, lens = direction_tree(self.config.level), self.config, self.lens
        rings = np.geomspace(lens.near, lens.far, config.rings)
        rings[[0, -1]] = lens.near, lens.far  # In spite of rounding they are in focus.
        made: list[_PreparedTarget] = []
        for field in self.fields:
            chances = np.zeros((len(tree.leaves), config.rings))
            if self.occupancy is not None:
                places = field.to_world((tree.leaves[:, None] * rings[:, None]).reshape(-1, 3))
                chances = probabilities_at(self.occupancy, places).reshape(chances.shape)
            free = chances < FREE_BELOW
            first = tree.least(np.where(free.any(axis=1), free.argmax(axis=1), config.rings))
            lowest = tree.least(chances.min(axis=1))
            candidates = best_first.TreeCandidates(tree, rings, chances, first, lowest)
            terms = rating_terms(lens, field.target, config.exponents)
            made.append(_PreparedTarget(field, self, candidates, terms))
        return made


@dataclasses.dataclass(frozen=True)
class _PreparedTarget:
    """One target's candidates, ready to be rated."""

    field: TargetField
    task: SpatialTask
    candidates: best_first.TreeCandidates
    terms: RatingTerms

    def rate_all(self) -> tuple[float, int, int, int, IntArray]:
        """Return what `best_first.rate_all` does, and how many candidates each hull hides (H,)."""
        hiding = np.zeros(len(self.field.names), dtype=np.int64)
        rated = best_first.rate_all(self.field.hulls, self.terms, self.candidates, hiding)
        return *rated, hiding

    def in_order(self, index: int) -> Iterator[tuple[float, int, int, int]]:
        """Yield negative rating, the index given, leaf and ring of the candidates, best first."""
        ordered = best_first.in_order(self.field.hulls, self.terms, self.candidates)
        return ((negative, index, leaf, ring) for negative, leaf, ring in ordered)

    def place(self, leaf: int, ring: int) -> FloatArray:
        """Return the position (3,) of a candidate [m], world."""
        radius = self.candidates.rings[ring]
        return self.field.to_world(radius * self.candidates.tree.leaves[leaf])

    def view(self, position: FloatArray) -> View:
        """Return the view from a position (3,) [m], world."""
        return self.views(position[None])[0]

    def views(self, positions: FloatArray) -> list[View]:
        """Return the views from positions (N, 3) [m], world."""
        task = self.task
        return rate_positions(
            self.field, task.lens, positions, task.occupancy, task.config.exponents
        )


def best_view(task: SpatialTask, accept: Accept | None = None) -> View:
    """Return the best of all views of any target.

    Args:
        task: Targets, lens, occupancy and candidates.
        accept: Returns whether a view is feasible; called with candidates best first until one is,
            and then with what would improve that one if it is to be refined.

    Raises:
        PlacementError: If no pose sees any of the targets; the message gives the reasons.
    """
    searches = task.prepared()
    refused = 0
    for _, index, leaf, ring in _in_order(searches):
        search = searches[index]
        view = search.view(search.place(leaf, ring))
        if accept is not None and not accept(view):
            refused += 1
            continue
        if not task.config.refine:
            return view
        return _refined(search, view, accept)
    raise PlacementError(_reason(searches, refused))


def views_in_order(task: SpatialTask) -> Iterator[View]:
    """Yield all candidates that see a target, best first; `SearchConfig.refine` has no effect."""
    searches = task.prepared()
    for _, index, leaf, ring in _in_order(searches):
        yield searches[index].view(searches[index].place(leaf, ring))


def best_view_of_all(task: SpatialTask) -> View:
    """Return the best candidate by rating every one as the thesis does; the reference.

    Raises:
        PlacementError: If no pose sees any of the targets; the message gives the reasons.
    """
    searches = task.prepared()
    found = [(*search.rate_all()[:3], search) for search in searches]
    rating, leaf, ring, search = max(found, key=lambda best: best[0])
    if rating <= 0.0:
        raise PlacementError(_reason(searches, 0))
    return search.view(search.place(leaf, ring))


class RatedDirections(NamedTuple):
    """Directions that see a target, each at its best distance, in falling order of rating.

    Attributes:
        ratings: (N,) ratings by eq. 4-1 [1/m], all above 0.
        positions: (N, 3) camera positions [m], world.
        fields: (N,) index of the target.
    """

    ratings: FloatArray
    positions: FloatArray
    fields: IntArray


def rate_directions(task: SpatialTask) -> RatedDirections:
    """Rate every direction about every target at its best distance.

    Raises:
        PlacementError: If no pose sees any of the targets; the message gives the reasons.
    """
    searches = task.prepared()
    best: dict[tuple[int, int], tuple[float, int]] = {}
    for negative, index, leaf, ring in _in_order(searches):
        best.setdefault((index, leaf), (-negative, ring))
    if not best:
        raise PlacementError(_reason(searches, 0))
    places = [searches[i].place(leaf, ring) for (i, leaf), (_, ring) in best.items()]
    ratings = [rating for rating, _ in best.values()]
    return RatedDirections(np.array(ratings), np.array(places), np.array([i for i, _ in best]))


def rate_positions(
    field: TargetField,
    lens: Lens,
    positions: ArrayLike,
    occupancy: Occupancy | None = None,
    exponents: Exponents | None = None,
) -> list[View]:
    """Rate any camera positions; 0 where the target is hidden or the position is not free.

    Args:
        field: Target with its occluders.
        lens: Lens of the camera.
        positions: (N, 3) camera positions [m], world, none at the target.
        occupancy: Probability of occupancy at points; None if all is free.
        exponents: Exponents of eq. 4-1; 1 by default.
    """
    places = np.atleast_2d(np.asarray(positions, dtype=float))
    local = field.to_frame(places)
    distances = np.linalg.norm(local, axis=1)
    directions = local / distances[:, None]
    for limit in (lens.near, lens.far):  # A camera put at the limit is in focus despite rounding.
        distances[np.abs(distances - limit) < _FOCUS_TOLERANCE] = limit
    chances = probabilities_at(occupancy, places)
    terms = rating_terms(lens, field.target, exponents or Exponents())
    ratings = best_first.rate_places(field.hulls, terms, directions, distances, chances)
    caps = free_caps(field, places)
    return [
        View(field.target.name, places[i], float(distances[i]), float(ratings[i]), float(caps[i]),
             float(chances[i]))
        for i in range(len(places))
    ]  # fmt: skip


def spherical(field: TargetField, position: ArrayLike) -> tuple[float, float, float]:
    """Return a camera's distance [m], azimuth and elevation above the target's plane [rad]."""
    x, y, z = field.to_frame(np.asarray(position, dtype=float))
    return (
        float(np.sqrt(x * x + y * y + z * z)),
        float(np.arctan2(y, x)),
        float(np.arctan2(z, np.hypot(x, y))),
    )


def probabilities_at(occupancy: Occupancy | None, points: FloatArray) -> FloatArray:
    """Return the probability of occupancy (N,) at points (N, 3); `UNKNOWN` where unknown."""
    if occupancy is None:
        return np.zeros(len(points))
    return np.nan_to_num(np.asarray(occupancy(points), dtype=float), nan=UNKNOWN)


def _in_order(searches: Sequence[_PreparedTarget]) -> Iterator[tuple[float, int, int, int]]:
    """Yield negative rating, target, leaf and ring of all targets' candidates, best first."""
    return heapq.merge(*(search.in_order(index) for index, search in enumerate(searches)))


def _refined(search: _PreparedTarget, view: View, accept: Accept | None) -> View:
    """Improve a view between its neighbours, in steps down to 0.01 deg and 0.1 mm; never worse.

    The rating has ridges, on which moves along fixed axes would stall: a disc of places laid out
    by the golden angle is tried about the best one, and shrunk when none is better. Along a sharp
    ridge it may still stop some tenths of a degree off the top, where the rating differs by parts
    in a million. Every step is feasible: the best views often lie at the edge of those that are.
    """
    hulls, terms, lens = search.field.hulls, search.terms, search.task.lens
    index = np.arange(_PATTERN) + 0.5
    turn = np.pi * (1.0 + 5.0**0.5) * index
    disc = np.sqrt(index / _PATTERN)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    local = search.field.to_frame(view.position)
    distance = float(np.clip(view.distance, lens.near, lens.far))
    direction, best, place = local / np.linalg.norm(local), view.rating, view.position
    width = 2.0 * float(search.candidates.tree.radii[-1])
    step = 0.5 * (search.candidates.rings[1] / search.candidates.rings[0] - 1.0)
    tried = 0
    while width > _MIN_TURN or step * lens.far > _MIN_STRIDE:
        side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
        side /= np.linalg.norm(side)
        c, s = np.cos(tried), np.sin(tried)
        flat = disc @ np.array([[c, s], [-s, c]]) * width
        around = np.vstack([np.zeros(2), flat]) @ np.array([side, np.cross(direction, side)])
        around += direction
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        lengths = distance * np.array([1.0 - step, 1.0 - step / 4, 1.0])
        lengths = np.unique(np.clip(lengths, lens.near, lens.far))
        sides = np.repeat(around, len(lengths), axis=0)
        radii = np.tile(lengths, len(around))
        places = search.field.to_world(sides * radii[:, None])
        chances = probabilities_at(search.task.occupancy, places)
        ratings = best_first.rate_places(hulls, terms, sides, radii, chances)
        better = np.argsort(-ratings, kind="stable")[: int(np.sum(ratings > best * (1.0 + 1e-9)))]
        top = _first_accepted(search, places, better, accept)
        tried += 1
        if top is not None:
            best, direction, distance = float(ratings[top]), sides[top], float(radii[top])
            place = places[top]
            if tried % 8:
                continue
        width, step = width * _SHRINK, step * _SHRINK
    found = search.view(place)
    return max(view, found, key=lambda each: each.rating)


def _first_accepted(
    search: _PreparedTarget, places: FloatArray, order: IntArray, accept: Accept | None
) -> int | None:
    """Return the first place (N, 3) in an order (n,) whose view is feasible; None without one."""
    if accept is None or not len(order):
        return int(order[0]) if len(order) else None
    tried = order[:: 1 + (len(order) - 1) // _TRIES]
    views = search.views(places[tried])
    return next((int(i) for i, view in zip(tried, views) if accept(view)), None)


def _reason(searches: Sequence[_PreparedTarget], refused: int) -> str:
    """Return why no pose sees any target, with the share of each reason."""
    lines: list[str] = []
    for search in searches:
        *_, not_free, hiding = search.rate_all()
        lens, total, hidden = search.task.lens, search.task.config.size, int(hiding.sum())
        worst = search.field.names[int(np.argmax(hiding))] if hidden else ""
        shares = [(hidden, f"hidden (most by {worst!r})"), (not_free, "not known to be free")]
        if refused:
            shares.append((total - not_free - hidden, "refused (out of reach)"))
        text = ", ".join(f"{n / total:.0%} are {what}" for n, what in sorted(shares)[::-1] if n)
        lines.append(
            f"no pose sees the target {search.field.target.name!r}: of {total} poses before it, "
            f"{lens.near:g} to {lens.far:g} m away, {text}"
        )
    return "; ".join(lines)
