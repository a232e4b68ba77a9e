"""Where to put a camera on the plane (thesis section 4.2.3): the best view of any target.

`best_view` is exact and fast; `exhaustive_view` rates every candidate and is its reference.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from controllers.placement.planar.field import hull_around
from controllers.placement.planar.hulls import Hulls, Occluder, expand
from controllers.placement.planar.kernels import (
    climb,
    rate_places,
    rate_pose,
    search_arcs,
    search_rings,
)
from controllers.placement.planar.reasons import why_unseen
from controllers.placement.task import (
    Exponents,
    FloatArray,
    Lens,
    PlacementError,
    Target,
    View,
    resolution,
)

FEWEST_DIRECTIONS = 4


@dataclasses.dataclass(frozen=True)
class KnownSpace:
    """What is known of where a camera could be.

    Attributes:
        probability: (rows, columns) of being occupied; row r, column c is the square from
            ``origin + cell * (c, r)`` on. Beyond, nothing is known.
        cell: Side of a cell [m].
        origin: x and y of the first cell's corner [m], world.
    """

    probability: FloatArray
    cell: float
    origin: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the map.

        Raises:
            ValueError: Saying what is wrong.
        """
        values = np.ascontiguousarray(self.probability, dtype=float)
        if values.ndim != 2 or values.size == 0:  # noqa: PLR2004
            raise ValueError(f"probability: shape {values.shape}, expected (rows, columns)")
        if not np.all((values >= 0.0) & (values <= 1.0)):
            raise ValueError("probability: expected numbers from 0 to 1")
        if not (math.isfinite(self.cell) and self.cell > 0.0):
            raise ValueError(f"cell {self.cell} m: expected a positive length")
        object.__setattr__(self, "probability", values)


@dataclasses.dataclass(frozen=True)
class PlanarTask:
    """All that a placement on the plane depends on.

    Attributes:
        targets: The primary target and any secondary ones.
        lens: The camera.
        occluders: What may hide the targets.
        space: Where a camera could be.
        exponents: Of the rating.

    It keeps the occluders that it has expanded.
    """

    targets: tuple[Target, ...]
    lens: Lens
    occluders: tuple[Occluder, ...]
    space: KnownSpace
    exponents: Exponents = Exponents()
    _expanded: dict[str, Hulls] = dataclasses.field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        """Refuse tasks without a target, or with two of one name.

        Raises:
            ValueError: Naming the offender.
        """
        names = [target.name for target in self.targets]
        if not names:
            raise ValueError("targets: expected at least one")
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"targets: {names.count(name)} are called {name!r}")

    def target(self, name: str) -> Target:
        """Return a target by its name.

        Raises:
            ValueError: If there is none of that name; it lists those that there are.
        """
        for target in self.targets:
            if target.name == name:
                return target
        raise ValueError(f"target {name!r} is unknown: expected one of {self._names()}")

    def hulls(self, target: Target) -> Hulls:
        """Return the occluders expanded by a target, but those that can hide it from no camera.

        Left out is what lies wholly behind the plane of the target's face or beyond the lens' far
        limit: no line of sight that counts gets there, and the plane is itself an edge.

        Raises:
            ValueError: If an occluder has no area.
        """
        if target.name not in self._expanded:
            reach = float(np.linalg.norm(target.outline, axis=1).max())
            back = float((target.outline @ target.normal).min())
            near = self.lens.far + reach
            kept: list[Occluder] = []
            for occluder in self.occluders:
                offset = occluder.points - target.position
                ahead = float((offset @ target.normal).max()) - back > 0.0
                # The box about its points is no farther than the occluder itself.
                gap = np.maximum(np.maximum(offset.min(axis=0), -offset.max(axis=0)), 0.0)
                if ahead and float(np.hypot(*gap)) <= near:
                    kept.append(occluder)
            self._expanded[target.name] = expand(kept, target)
        return self._expanded[target.name]

    def _names(self) -> str:
        return ", ".join(repr(target.name) for target in self.targets)


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Which camera poses are looked at about each target.

    Attributes:
        rings: Number of distances, evenly from the lens' near to its far limit, both included.
        directions: Number of directions about the target, the first along its normal.
    """

    rings: int = 64
    directions: int = 1024

    def __post_init__(self) -> None:
        """Refuse too few.

        Raises:
            ValueError: Saying what is expected.
        """
        if self.rings < 1 or self.directions < FEWEST_DIRECTIONS:
            raise ValueError(
                f"rings {self.rings}, directions {self.directions}: expected 1 ring and "
                f"{FEWEST_DIRECTIONS} directions or more"
            )

    def distances(self, lens: Lens) -> FloatArray:
        """Return the rings' distances from the target [m], ascending."""
        if self.rings == 1:
            return np.array([lens.near])
        return np.linspace(lens.near, lens.far, self.rings)


USUAL = Candidates()
"""65536 poses about each target."""


def best_view(
    task: PlanarTask,
    candidates: Candidates = USUAL,
    watch: Sequence[str] | None = None,
    refine: bool = True,
) -> View:
    """Find the best view of any target, by arcs on rings and their bounds.

    Args:
        task: Targets, lens, occluders, space.
        candidates: Which poses.
        watch: Names of the targets to consider; all unless given.
        refine: Whether to climb from the best candidate to the peak between candidates.

    Raises:
        ValueError: If a target is unknown or an occluder has no area.
        PlacementError: If no pose sees a target, with the nearest reason.
    """
    return _search(search_arcs, task, candidates, watch, refine)


def exhaustive_view(
    task: PlanarTask,
    candidates: Candidates = USUAL,
    watch: Sequence[str] | None = None,
) -> View:
    """Find the best view of any target by rating every candidate.

    Args:
        task: Targets, lens, occluders, space.
        candidates: Which poses.
        watch: Names of the targets to consider; all unless given.

    Raises:
        ValueError: If a target is unknown or an occluder has no area.
        PlacementError: If no pose sees a target, with the nearest reason.
    """
    return _search(search_rings, task, candidates, watch, False)


def view_from(task: PlanarTask, position: FloatArray, watch: Sequence[str] | None = None) -> View:
    """Rate the best that a camera at a place could watch.

    Args:
        task: Targets, lens, occluders, space.
        position: (2,) of the camera [m], world.
        watch: Names of the targets to consider; all unless given.

    Raises:
        ValueError: If a target is unknown or an occluder has no area.
        PlacementError: If it sees no target.
    """
    best: View | None = None
    for target in chosen_targets(task, watch):
        offset = np.asarray(position, dtype=float) - target.position
        radius = float(np.hypot(*offset))
        place = place_of(target)
        angle = math.atan2(offset[1], offset[0]) - place[2]
        hulls = task.hulls(target)
        rating, cap, p = rate_pose(
            hulls.points, hulls.starts, place, angle, radius, *space_of(task), task.lens.near,
            task.lens.far,
        )  # fmt: skip
        if rating > 0.0 and (best is None or rating > best.rating):
            best = _view(task, target, (rating, angle, radius, cap, p))
    if best is None:
        raise PlacementError(f"no target is seen from {np.round(position, 3).tolist()} m")
    return best


def rating_field(task: PlanarTask, places: FloatArray) -> FloatArray:
    """Rate cameras at many places for every target (figure 4-8b).

    Args:
        task: Targets, lens, occluders, space.
        places: (..., 2) of the cameras [m], world.

    Returns:
        (T, ...) ratings [1/m] in the order of the task's targets; 0 where a target is not seen.

    Raises:
        ValueError: If an occluder has no area.
    """
    flat = np.ascontiguousarray(places, dtype=float).reshape(-1, 2)
    fields: list[FloatArray] = []
    for target in task.targets:
        hulls = task.hulls(target)
        fields.append(rate_places(
            hulls.points, hulls.starts, place_of(target), flat, *space_of(task), task.lens.near,
            task.lens.far,
        ))  # fmt: skip
    return np.array(fields).reshape(len(task.targets), *np.shape(places)[:-1])


def chosen_targets(task: PlanarTask, watch: Sequence[str] | None) -> tuple[Target, ...]:
    """Return the targets of those names, or all.

    Raises:
        ValueError: If one is unknown.
    """
    return task.targets if watch is None else tuple(task.target(name) for name in watch)


def place_of(target: Target) -> FloatArray:
    """Return what the kernels take of a target: x, y, direction of the normal, relation_error."""
    angle = math.atan2(target.normal[1], target.normal[0])
    return np.array([*target.position, angle, target.relation_error])


def space_of(
    task: PlanarTask,
) -> tuple[FloatArray, float, float, float, float, tuple[float, ...]]:
    """Return the kernels' arguments from ``probability`` to ``exponents``."""
    space = task.space
    return (
        space.probability, float(space.cell), float(space.origin[0]), float(space.origin[1]),
        float(task.lens.spread), tuple(map(float, dataclasses.astuple(task.exponents))),
    )  # fmt: skip


def _search(
    kernel: Callable[..., Any],
    task: PlanarTask,
    candidates: Candidates,
    watch: Sequence[str] | None,
    refine: bool,
) -> View:
    """Search about each target, what is found about one being the bound for the next."""
    rings = candidates.distances(task.lens)
    settings = space_of(task)
    found: tuple[Target, Hulls, Any] | None = None
    floor = 0.0
    targets = chosen_targets(task, watch)
    for target in targets:
        hulls = task.hulls(target)
        if hull_around(hulls.points, hulls.starts) >= 0:
            continue
        answer = kernel(
            hulls.points, hulls.starts, place_of(target), rings, candidates.directions, *settings,
            floor,
        )  # fmt: skip
        if answer[0] > floor:
            floor, found = answer[0], (target, hulls, answer)
    if found is None:
        raise PlacementError("; ".join(_reason(task, t, candidates) for t in targets))
    target, hulls, answer = found
    if refine:
        gap = (rings[-1] - rings[0]) / max(candidates.rings - 1, 1)
        answer = climb(
            hulls.points, hulls.starts, place_of(target), answer[1], answer[2],
            0.5 * math.pi / candidates.directions, 0.5 * gap, *settings, rings[0],
            rings[-1],
        )  # fmt: skip
    return _view(task, target, answer)


def _reason(task: PlanarTask, target: Target, candidates: Candidates) -> str:
    hulls, space = task.hulls(target), task.space
    return why_unseen(
        target, hulls, hull_around(hulls.points, hulls.starts), candidates.distances(task.lens),
        candidates.directions, space.probability, space.cell, space.origin,
    )  # fmt: skip


def _view(task: PlanarTask, target: Target, answer: tuple[float, ...]) -> View:
    rating, angle, radius, cap, p = map(float, answer)
    direction = math.atan2(target.normal[1], target.normal[0]) + angle
    return View(
        target=target.name,
        position=target.position + radius * np.array([math.cos(direction), math.sin(direction)]),
        distance=radius,
        rating=rating,
        free_cap=cap,
        cos_angle=math.cos(angle),
        resolution=float(resolution(radius, task.lens, target.relation_error)),
        occupancy=p,
    )
