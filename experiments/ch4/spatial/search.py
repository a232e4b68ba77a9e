"""Random scenes in space: fast and exhaustive search, and expanded hulls and exact sight compared.

Solids of all kinds lie about a round target. In every second scene camera positions are partly
unknown or uncertain, as in a map.
"""

import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from controllers.placement.spatial.field import free_caps
from controllers.placement.spatial.occluders import TargetField, expand
from controllers.placement.spatial.search import (
    Occupancy,
    SearchConfig,
    SpatialTask,
    best_view,
    best_view_of_all,
)
from controllers.placement.spatial.sight import sees_all
from controllers.placement.task import Lens, Occluder, PlacementError, Target, View
from models.datasheets import CAMERA, INCH
from perception.geometry.arrays import FloatArray

LENS = Lens(CAMERA.field_of_view[0], CAMERA.width, 5.0 * INCH, 24.0 * INCH)
"""The nearest distance in focus is the thesis' answer of 5 inches; the farthest is a choice."""
PLAIN = SearchConfig(refine=False)
SIDES = 12
SIGHT_CASES = 50
"""Number of cameras in each scene for which hulls and exact sight are compared."""


@dataclasses.dataclass(frozen=True)
class SpatialSearchTrial:
    """One random scene.

    Attributes:
        seed: Random seed of the scene.
        occluders: Number of solids, 3 to 20.
        patchy: Whether camera positions are partly unknown.
    """

    seed: int
    occluders: int
    patchy: bool


def disc(name: str, radius: float, position: FloatArray, normal: FloatArray) -> Target:
    """Return a round flat target as a regular polygon about it, which touches it on all axes."""
    unit = normal / np.linalg.norm(normal)
    side = np.cross(unit, np.eye(3)[int(np.argmin(np.abs(unit)))])
    side /= np.linalg.norm(side)
    turn = 2.0 * np.pi * (np.arange(SIDES) + 0.5) / SIDES
    wide = radius / np.cos(np.pi / SIDES)
    outline = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(unit, side)
    return Target(name, position, unit, wide * outline)


def draw_solids(rng: np.random.Generator, count: int, target: Target) -> list[Occluder]:
    """Draw solids before a target: turned boxes and hulls of points, half of each kind.

    They are 2 cm to 24 cm in size and up to 35 cm off, so most of them matter for a camera
    that works from 5 inches on.
    """
    made: list[Occluder] = []
    for index in range(count):
        size = rng.uniform(0.02, 0.12)
        place = rng.normal(size=3)
        place *= rng.uniform(0.05, 0.35) / np.linalg.norm(place)
        place += max(0.0, -2.0 * float(place @ target.normal)) * target.normal
        if rng.random() < 0.5:  # noqa: PLR2004
            corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T
            corners = Rotation.random(rng=rng).apply(corners * size * rng.uniform(0.2, 1.0, 3))
        else:
            corners = size * rng.uniform(-1.0, 1.0, (8, 3))
        made.append(Occluder(f"solid {index}", target.position + place + corners))
    return made


def make_scene(
    trial: SpatialSearchTrial, rng: np.random.Generator
) -> tuple[TargetField, list[Occluder], Occupancy | None]:
    """Draw a target that is not hidden from everywhere, its solids, and the map."""
    while True:
        target = disc("hole", 0.008, rng.normal(size=3), rng.normal(size=3))
        solids = draw_solids(rng, trial.occluders, target)
        try:
            field = expand(target, solids)
        except PlacementError:
            continue  # A solid lies over the target: drawn again.
        waves = rng.normal(scale=25.0, size=(3, 3))
        return field, solids, _patches(target.position, waves) if trial.patchy else None


def _patches(middle: FloatArray, waves: FloatArray) -> Occupancy:
    """Return a map of free, uncertain and unknown positions in turn."""

    def occupancy(points: FloatArray) -> FloatArray:
        level = np.sin((points - middle) @ waves).sum(axis=1)
        return np.where(level > 0.8, np.nan, 0.012 * (level + 3.0))  # noqa: PLR2004

    return occupancy


@dataclasses.dataclass(frozen=True)
class SpatialSearch:
    """One scene searched both ways, and hulls compared with exact sight.

    Attributes:
        match: Whether the fast search is as good or better, or both found nothing.
        gain: Refined over exhaustive rating.
        seen: Whether the exhaustive search finds a view.
        slow_s: Processor time of the exhaustive search [s].
        fast_s: Processor time of the fast search [s].
        hull: (n,) whether the hulls let each camera see the target, 0 or 1.
        exact: (n,) whether it truly sees the target, 0 or 1.
        distance: (n,) distance of each camera [m].
    """

    match: bool
    gain: float
    seen: bool
    slow_s: float
    fast_s: float
    hull: NDArray[np.int8]
    exact: NDArray[np.int8]
    distance: FloatArray


def run_search(trial: SpatialSearchTrial) -> SpatialSearch:
    """Search one scene both ways, and compare hulls with exact sight."""
    rng = np.random.default_rng(trial.seed)
    field, solids, occupancy = make_scene(trial, rng)
    slow, slow_s = _timed(best_view_of_all, field, occupancy)
    fast, fast_s = _timed(best_view, field, occupancy)
    if slow is None or fast is None:
        match, gain = slow is None and fast is None, 1.0
    else:
        refined = best_view(SpatialTask([field], LENS, occupancy))
        match = fast.rating >= slow.rating * (1.0 - 1e-12) and refined.rating >= fast.rating
        gain = refined.rating / slow.rating
    rays = rng.normal(size=(SIGHT_CASES, 3))
    rays *= np.sign(rays @ field.target.normal)[:, None]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    distance = rng.uniform(LENS.near, LENS.far, SIGHT_CASES)
    places = field.target.position + distance[:, None] * rays
    hull = (free_caps(field, places) > 0.0).astype(np.int8)
    exact = sees_all(field.target, solids, places).astype(np.int8)
    return SpatialSearch(bool(match), gain, slow is not None, slow_s, fast_s, hull, exact, distance)


def _timed(
    search: Any, field: TargetField, occupancy: Occupancy | None
) -> tuple[View | None, float]:
    start = time.process_time()
    try:
        view = search(SpatialTask([field], LENS, occupancy, PLAIN))
    except PlacementError:
        view = None
    return view, time.process_time() - start
