"""The best view of any target on the plane (Thesis section 4.2.3).

The search is exact and fast. Where no pose sees a target, the error gives the reasons.
"""

import collections
import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controllers.placement.planar.arc_search import (
    ArcTask,
    OccupancyCells,
    climb,
    occupancies,
    rate_places,
    rate_pose,
    search_arcs,
)
from controllers.placement.planar.field import NOTHING, HullCorners, blocked_interval, hull_around
from controllers.placement.planar.occluders import ExpandedOccluders, expand
from controllers.placement.planar.sight import KnownSpace
from controllers.placement.task import (
    FREE_BELOW,
    Exponents,
    Lens,
    Occluder,
    PlacementError,
    Target,
    View,
    rating_terms,
)
from perception.geometry.arrays import FloatArray

FEWEST_DIRECTIONS = 4
EDGE_ON = 1e-12
"""Cosine to the target's normal up to which a camera sees the target edge on."""


@dataclasses.dataclass(frozen=True)
class PlanarTask:
    """All that a placement on the plane depends on; expanded occluders are cached.

    Attributes:
        targets: Primary target and any secondary ones, each with a name of its own.
        lens: Lens of the camera.
        occluders: Bodies that may hide the targets.
        space: Occupancy map: where a camera could be.
        exponents: Exponents of the rating.

    Raises:
        ValueError: If there is no target, or two of one name.
    """

    targets: tuple[Target, ...]
    lens: Lens
    occluders: tuple[Occluder, ...]
    space: KnownSpace
    exponents: Exponents = Exponents()
    _expanded: dict[str, ExpandedOccluders] = dataclasses.field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self.targets:
            raise ValueError("targets: expected at least one")
        for name, count in collections.Counter(target.name for target in self.targets).items():
            if count > 1:
                raise ValueError(f"targets: {count} are called {name!r}")

    def target(self, name: str) -> Target:
        """Return a target by its name.

        Raises:
            ValueError: If there is none of that name; the message lists those that there are.
        """
        targets = {target.name: target for target in self.targets}
        if name not in targets:
            names = ", ".join(map(repr, targets))
            raise ValueError(f"target {name!r} is unknown: expected one of {names}")
        return targets[name]

    def expanded(self, target: Target) -> ExpandedOccluders:
        """Return the occluders that can hide a target, expanded by it.

        Occluders wholly behind the plane of the target's face or beyond the lens' far limit are
        left out: they block no line of sight, and the plane itself bounds the field visibility.

        Raises:
            ValueError: If an occluder has no area.
        """
        if target.name not in self._expanded:
            back = float((target.outline @ target.normal).min())
            near = self.lens.far + float(np.linalg.norm(target.outline, axis=1).max())
            relevant: list[Occluder] = []
            for occluder in self.occluders:
                offset = occluder.points - target.position
                ahead = float((offset @ target.normal).max()) - back > 0.0
                # The box about its points is no farther than the occluder itself.
                gap = np.maximum(np.maximum(offset.min(axis=0), -offset.max(axis=0)), 0.0)
                if ahead and float(np.hypot(*gap)) <= near:
                    relevant.append(occluder)
            self._expanded[target.name] = expand(relevant, target)
        return self._expanded[target.name]

    def compiled(self, target: Target) -> ArcTask:
        """Return the task for one target as the compiled searches need it.

        Raises:
            ValueError: If an occluder has no area.
        """
        x, y = map(float, target.position)
        space = self.space
        cells = OccupancyCells(space.probability, float(space.cell), *map(float, space.origin))
        terms = rating_terms(self.lens, target, self.exponents)
        return ArcTask(self.expanded(target).hulls, x, y, axis_of(target), cells, terms)


@dataclasses.dataclass(frozen=True)
class RingCandidates:
    """Camera poses that are tried about each target.

    Attributes:
        rings: Number of distances, evenly from the lens' near to its far limit, both included.
        directions: Number of directions about the target, the first along its normal.

    Raises:
        ValueError: If there are too few; the message says what is expected.
    """

    rings: int = 64
    directions: int = 1024

    def __post_init__(self) -> None:
        if self.rings < 1 or self.directions < FEWEST_DIRECTIONS:
            raise ValueError(
                f"rings {self.rings}, directions {self.directions}: expected 1 ring and "
                f"{FEWEST_DIRECTIONS} directions or more"
            )

    def distances(self, lens: Lens) -> FloatArray:
        """Return the rings' distances from the target [m], ascending."""
        return np.linspace(lens.near, lens.far, self.rings)


DEFAULT_CANDIDATES = RingCandidates()
"""65,536 poses about each target."""


def best_view(
    task: PlanarTask,
    candidates: RingCandidates = DEFAULT_CANDIDATES,
    search: Callable[..., Any] = search_arcs,
    refine: bool = True,
) -> View:
    """Find the best view of any target; the best of one target is the bound for the next.

    Args:
        task: Targets, lens, occluders and occupancy map.
        candidates: Camera poses that are tried.
        search: `search_arcs`, or `search_rings` that rates every candidate as the reference.
        refine: Whether to climb from the best candidate to the peak between candidates.

    Raises:
        ValueError: If an occluder has no area.
        PlacementError: If no pose sees a target; the message gives the reasons.
    """
    rings = candidates.distances(task.lens)
    found: tuple[Target, ArcTask, Any] | None = None
    floor = 0.0
    for target in task.targets:
        compiled = task.compiled(target)
        if hull_around(compiled.hulls) >= 0:
            continue
        answer = search(compiled, rings, candidates.directions, floor)
        if answer[0] > floor:
            floor, found = answer[0], (target, compiled, answer)
    if found is None:
        raise PlacementError("; ".join(_why_unseen(task, t, candidates) for t in task.targets))
    target, compiled, answer = found
    if refine:
        answer = climb(compiled, rings, candidates.directions, answer[1], answer[2])
    return _view(target, answer)


def view_from(task: PlanarTask, position: FloatArray) -> View:
    """Return the best view from a camera position.

    Args:
        task: Targets, lens, occluders and occupancy map.
        position: (2,) camera position [m], world.

    Raises:
        ValueError: If an occluder has no area.
        PlacementError: If the camera sees no target.
    """
    views: list[View] = []
    for target in task.targets:
        offset = np.asarray(position, dtype=float) - target.position
        radius = float(np.hypot(*offset))
        angle = math.atan2(offset[1], offset[0]) - axis_of(target)
        rating, cap, p = rate_pose(task.compiled(target), angle, radius)
        views.append(_view(target, (rating, angle, radius, cap, p)))
    best = max(views, key=lambda view: view.rating)
    if best.rating <= 0.0:
        raise PlacementError(f"no target is seen from {np.round(position, 3).tolist()} m")
    return best


def rating_field(task: PlanarTask, places: FloatArray) -> FloatArray:
    """Rate many camera positions for every target (figure 4-8b).

    Args:
        task: Targets, lens, occluders and occupancy map.
        places: (..., 2) camera positions [m], world.

    Returns:
        (T, ...) ratings [1/m] in the order of the task's targets; 0 where a target is not seen.

    Raises:
        ValueError: If an occluder has no area.
    """
    flat = np.ascontiguousarray(places, dtype=float).reshape(-1, 2)
    fields = [rate_places(task.compiled(target), flat) for target in task.targets]
    return np.array(fields).reshape(len(task.targets), *np.shape(places)[:-1])


def axis_of(target: Target) -> float:
    """Return the direction of a planar target's normal from the world's x axis [rad]."""
    return math.atan2(target.normal[1], target.normal[0])


def _view(target: Target, answer: tuple[float, ...]) -> View:
    rating, angle, radius, cap, p = map(float, answer)
    direction = axis_of(target) + angle
    position = target.position + radius * np.array([math.cos(direction), math.sin(direction)])
    return View(target.name, position, radius, rating, cap, p)


def _why_unseen(task: PlanarTask, target: Target, candidates: RingCandidates) -> str:
    """Return why no candidate sees a target, each candidate under its first reason."""
    start = f"no pose sees the target {target.name!r}: "
    expanded = task.expanded(target)
    around = hull_around(expanded.hulls)
    if around >= 0:
        return start + f"occluder {expanded.names[around]!r}, expanded by the target, covers it"
    rings, directions = candidates.distances(task.lens), candidates.directions
    turn = 2.0 * np.pi * np.arange(directions) / directions
    averted = np.cos(turn) <= EDGE_ON
    compiled = task.compiled(target)
    counts, by = np.zeros(3, dtype=int), np.zeros(len(expanded.names), dtype=int)
    for radius in rings:
        blocked = _blocked(expanded.hulls, radius, turn + compiled.axis) & ~averted
        taken = occupancies(compiled, turn, radius) >= FREE_BELOW
        hidden = blocked.any(axis=0)
        counts += [averted.sum(), hidden.sum(), np.sum(taken & ~hidden & ~averted)]
        by += blocked.sum(axis=1)
    behind, hid, unfree = (f"{100.0 * n / (len(rings) * directions):.3g} %" for n in counts)
    most = f" (most by occluder {expanded.names[int(np.argmax(by))]!r})" if by.any() else ""
    return start + (
        f"of {len(rings) * directions} poses {behind} are behind it, {hid} hidden{most}, "
        f"{unfree} not known to be free"
    )


def _blocked(hulls: HullCorners, radius: float, angles: FloatArray) -> NDArray[np.bool_]:
    """Return which hulls hide the target in which directions (H, N)."""
    ends = itertools.pairwise(hulls.starts)
    intervals = [blocked_interval(hulls.points, *pair, radius) for pair in ends]
    what, low, high = np.reshape(intervals, (-1, 3)).T[..., None]
    return (what != NOTHING) & ((angles - low) % (2.0 * np.pi) <= high - low)
