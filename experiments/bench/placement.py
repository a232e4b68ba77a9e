"""Placing a camera again within a vision period, on a 1 cm map of the scene of chapter 3."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.looking import RobotBrief
from controllers.placement.reach.footprint import Part, PoseDrives, pose_drives
from controllers.placement.reach.ground import ground_of
from controllers.placement.reach.reach import Reach, RoverState
from controllers.placement.reach.replanner import Mover, Replan, Replanner
from controllers.placement.spatial.occluders import before_plane, expand, occluders_of_voxels
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    best_view,
    best_view_of_all,
)
from controllers.placement.task import Occluder, PlacementError, Target, View
from experiments.ch3.stereo.scene import StereoScene, StereoSceneConfig
from experiments.ch4.spatial.placement_scene import (
    BOX,
    add_view,
    head_lens,
    map_scene,
    panel_targets,
)
from experiments.harness.contract import Options
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.timing import compare
from perception.voxels.map import VoxelMap, window
from twin.describe import body_pose, describe

FloatArray = NDArray[np.float64]

PERIOD = 0.25
"""Of the vision system [s]."""
VIEWS, QUICK_VIEWS = 40, 16
MORE_VIEWS = 100
"""Of a map on which rovers are asked again: with few views the ground about them is unknown."""
CLIMB, DECK, TALL = 0.03, 0.11, 0.35
"""Heights above the ground of a rover's motors, below which it passes over what its wheels climb,
of its deck, and of its folded arm [m]."""
BASE, FOLDED = (-0.165, 0.165, -0.221, 0.221), (-0.053, 0.053, -0.10, 0.242)
"""Boxes that hold wheels and deck, and the folded arm with its margin [m], frame of the rover."""
FARTHEST = 1.2
"""Longest drive [m]."""
ROUNDS = 5


def bench_placement(options: Options, output: Output) -> None:
    """Time re-plans from nothing, after another view of the scene, and with something moving.

    Times are processor time of one core.

    Args:
        options: ``quick`` maps with fewer views and takes one target of four.
        output: Receives ``replan_ratio/*``, ``search_speedup/map`` and how rovers reach views.
    """
    seed = options.job_seeds(1, 1)[0]
    rng = np.random.default_rng(seed)
    scene = StereoScene(StereoSceneConfig(seed=seed, texture_pixels=64))
    voxels = map_scene(scene, QUICK_VIEWS if options.quick else VIEWS, rng)
    targets = panel_targets(scene)[: 1 if options.quick else None]
    seen = [target for target in targets if _sees(voxels, target)]
    output.measure("replan/targets_seen", len(seen))
    output.measure("replan/targets", len(targets))
    if not seen:
        return
    _replans(voxels, seen, scene, rng, output)
    _speedup(voxels, seen[0], output)
    _reach(voxels, seen[0], scene, 20 if options.quick else 100, "reach", output)
    if not options.quick:
        for _ in range(MORE_VIEWS - VIEWS - ROUNDS * (1 + len(seen))):
            add_view(voxels, scene, rng)
        _reach(voxels, seen[0], scene, 100, f"reach_{MORE_VIEWS}_views", output)


def _sees(voxels: VoxelMap, target: Target) -> bool:
    """Tell whether any view of a target is known; it also compiles what is timed later."""
    try:
        Replanner([target], head_lens()).replan(voxels)
    except PlacementError:
        return False
    return True


def _timed(function: Callable[[], Replan]) -> tuple[float, Replan]:
    start = time.process_time()
    result = function()
    return time.process_time() - start, result


def _replans(
    voxels: VoxelMap,
    targets: list[Target],
    scene: StereoScene,
    rng: np.random.Generator,
    output: Output,
) -> None:
    """Time the three kinds of re-plans of one target each."""
    times: dict[str, list[float]] = {"scratch": [], "view": [], "mover": []}
    made: list[int] = []
    tiles: list[int] = []
    planners = [Replanner([target], head_lens()) for target in targets]
    for _ in range(ROUNDS):
        add_view(voxels, scene, rng)
        for planner, target in zip(planners, targets, strict=True):
            planner.reset()
            spent, first = _timed(lambda p=planner: p.replan(voxels))
            times["scratch"].append(spent)
            side = _block_beside(target, first.view)
            spent, _ = _timed(
                lambda p=planner, v=first.view, m=side: p.replan(voxels, v.position, movers=[m])
            )
            times["mover"].append(spent)
            planner.replan(voxels)
            add_view(voxels, scene, rng)
            spent, later = _timed(lambda p=planner, v=first.view: p.replan(voxels, v.position))
            times["view"].append(spent)
            made.append(later.made)
            tiles.append(later.tiles)
    output.measure("replan/tiles", distribution(tiles))
    output.measure("replan/tiles_made_after_a_view", distribution(made))
    for name, seconds in times.items():
        ratio = distribution([s / PERIOD for s in seconds])
        output.measure(f"replan_ratio/{name}", ratio)
        text = f"placement, a re-plan over a vision period, {name}"
        output.check(text, ratio["median"], "<= 1", ratio["median"] <= 1.0)
    worst = max(max(seconds) for seconds in times.values()) / PERIOD
    output.measure("replan_ratio", worst)
    output.check("placement, slowest re-plan over a vision period", worst, "<= 1", worst <= 1.0)


def _block_beside(target: Target, view: View) -> Mover:
    """Return a block of 4 cm half way to the camera, 3 cm off the line of sight."""
    ahead = (view.position - target.position) / view.distance
    side = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))])
    middle = (
        target.position + 0.5 * view.distance * ahead + 0.05 * side / float(np.linalg.norm(side))
    )
    corners = 0.02 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    return Mover(Occluder("block", np.asarray(middle + corners, dtype=float)), 0.002)


def _speedup(voxels: VoxelMap, target: Target, output: Output) -> None:
    """Time the fast search on the map beside rating every candidate."""
    lens, config = head_lens(), SearchConfig(refine=False)
    cells, _ = voxels.occupied_cells()
    centres = before_plane(target, voxels.grid.centres(cells), 0.02)
    near = np.linalg.norm(centres - target.position, axis=1) < lens.far + 0.1
    field = expand(target, occluders_of_voxels(centres[near], voxels.grid.resolution))
    found: dict[str, View] = {}

    def fast() -> None:
        found["fast"] = best_view(SpatialTask([field], lens, voxels.probabilities, config))

    def all_of_them() -> None:
        found["all"] = best_view_of_all(SpatialTask([field], lens, voxels.probabilities, config))

    times = compare(fast, all_of_them, 2)
    output.measure("search_speedup/map", 1.0 / times["ratio"]["median"])
    output.measure("search_s/map", times["ours_s"])
    output.measure("search_s/map_exhaustive", times["peer_s"])
    same = np.isclose(found["fast"].rating, found["all"].rating, rtol=1e-12)
    lazy = Replanner([target], lens).replan(voxels).view.rating
    output.check("placement, fast search on the map as exhaustive", float(same), "== 1", bool(same))
    same = bool(np.isclose(lazy, found["all"].rating, rtol=1e-12))
    output.check("placement, re-plan as exhaustive search", float(same), "== 1", same)


@dataclasses.dataclass(frozen=True)
class _Asked:
    """What one rover was told about views that it can take.

    Attributes:
        drive: Its ways over the map.
        reach: What it asked of each view.
        view: The best one; None for none.
        refusal: Why there is none.
        seconds: Processor time of the ways and of the re-plan.
    """

    drive: PoseDrives
    reach: Reach
    view: View | None
    refusal: str
    seconds: tuple[float, float]


def _ask(voxels: VoxelMap, target: Target, scene: StereoScene, name: str, most: int) -> _Asked:
    """Find the best view that a rover can take, among the best so many."""
    drawn = describe(scene.model, name)
    brief = RobotBrief(SerialChain.of_robot(drawn), scene.joints(name), drawn.body_spheres)
    level = leveled(body_pose(scene.data, scene.model.body(f"{name}/chassis").id))
    heading = float(level.rotation.as_euler("ZYX")[0])
    start = time.process_time()
    drive = pose_drives(outline(voxels), np.append(level.translation[:2], heading), FARTHEST)
    ground = time.process_time() - start
    places = {target.name: target.position}
    state = RoverState(level, scene.joints(name))
    reach = Reach(brief, state, drive, not_free(voxels), places, most=most)
    planner, view, refusal = Replanner([target], head_lens()), None, ""
    start = time.process_time()
    try:
        view = planner.replan(voxels, accept=reach, possible=reach.possible).view
    except PlacementError as error:
        refusal = str(error)
    return _Asked(drive, reach, view, refusal, (ground, time.process_time() - start))


def _reach(
    voxels: VoxelMap, target: Target, scene: StereoScene, most: int, key: str, output: Output
) -> None:
    """Find the best view that each rover can take, and how long that costs with all questions."""
    cell = voxels.grid.resolution**2
    _ask(voxels, target, scene, scene.robot_names[0], most)  # compiles
    for name in scene.robot_names:
        told = _ask(voxels, target, scene, name, most)
        ground, replan = (seconds / PERIOD for seconds in told.seconds)
        output.measure(f"{key}/{name}/ground_ratio", ground)
        stands = np.count_nonzero(told.drive.enterable.any(axis=0)) * cell
        output.measure(f"{key}/{name}/standing_places_m2", stands)
        reached = np.count_nonzero(np.isfinite(told.drive.costs).any(axis=0)) * cell
        output.measure(f"{key}/{name}/reachable_m2", reached)
        if told.refusal:
            output.measure(f"{key}/{name}/refusal", told.refusal)
        output.measure(f"{key}/{name}/replan_ratio", replan)
        text = f"placement, {key}, {name}: a re-plan and its ways over a vision period"
        output.check(text, ground + replan, "<= 1", ground + replan <= 1.0)
        output.measure(f"{key}/{name}/refused", len(told.reach.refused))
        if told.view is not None and told.reach.plan is not None:
            output.measure(f"{key}/{name}/drive_m", told.reach.plan.length)
            output.measure(f"{key}/{name}/rating", told.view.rating)


def outline(voxels: VoxelMap) -> tuple[Part, Part]:
    """Return a rover's outline while it drives, over what a map says of its heights."""
    parts: list[Part] = []
    for box, low, high in ((BASE, CLIMB, DECK), (FOLDED, DECK, TALL)):
        cut = window(voxels, [*BOX[0][:2], low], [*BOX[1][:2], high])
        parts.append(Part(box, ground_of(cut)))
    return parts[0], parts[1]


def leveled(pose: RigidTransform) -> RigidTransform:
    """Return a robot's pose without its lean."""
    heading = pose.rotation.as_euler("ZYX")[0]
    return RigidTransform.from_components(pose.translation, Rotation.from_euler("z", heading))


def not_free(voxels: VoxelMap) -> Callable[[FloatArray], NDArray[np.bool_]]:
    """Return which points of the world are not known to be free."""

    def collides(points: FloatArray) -> NDArray[np.bool_]:
        return np.logical_not(voxels.probabilities(points) < 0.05)  # noqa: PLR2004

    return collides
