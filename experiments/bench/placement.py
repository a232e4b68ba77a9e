"""Choice of a camera station on a 1 cm map of the scene of chapter 3, and its search."""

import time

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import CameraStation, best_camera_station
from controllers.insertion.drawing import InsertionDrawing
from controllers.placement.mapped_ground import MappedGround
from controllers.placement.spatial.occluders import before_plane, expand, occluders_of_voxels
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    best_view,
    best_view_of_all,
)
from controllers.placement.task import PlacementError, Target, View
from experiments.bench.bench_options import Options
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch4.spatial.placement_scene import add_view, head_lens, map_scene, panel_targets
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.harness.intervals import distribution
from experiments.harness.output import Output
from experiments.harness.timing import compare
from models.datasheets import CARD_AND_SLOT
from perception.voxels.map import VoxelMap
from twin.describe import describe_rover
from twin.description import RobotDescription

VIEWS, QUICK_VIEWS = 40, 16
ROUNDS, QUICK_ROUNDS = 20, 5


def bench_placement(options: Options, output: Output) -> None:
    """Time the choice of a camera station anew after each view, and the search on the map.

    Times are processor time of one core.

    Args:
        options: ``quick`` maps with fewer views.
        output: Receives ``replan/*`` and ``search_speedup/map``.
    """
    seed = options.job_seeds(1, 1)[0]
    rng = np.random.default_rng(seed)
    scene = StereoScene(seed=seed, texture_pixels=64)
    voxels = map_scene(scene, QUICK_VIEWS if options.quick else VIEWS, rng)
    _replans(voxels, scene, rng, QUICK_ROUNDS if options.quick else ROUNDS, output)
    for target in panel_targets(scene):
        if _speedup(voxels, target, output):
            return


def _replans(
    voxels: VoxelMap, scene: StereoScene, rng: np.random.Generator, rounds: int, output: Output
) -> None:
    """Time the mission's choice of a camera station on a map that changes with every view.

    The panel's first marker serves as the slot, which faces as the panel does.
    """
    robot, drawing = describe_rover("rover1"), insertion_drawing(CARD_AND_SLOT.slot_widths[-1])
    to_ground = ground_below(panel_targets(scene)[0]).inv()
    seconds: list[float] = []
    stations, changes, before = 0, 0, None
    choose_station(voxels, to_ground, robot, drawing)  # compiles
    for _ in range(rounds):
        add_view(voxels, scene, rng)
        start = time.process_time()
        found = choose_station(voxels, to_ground, robot, drawing)
        seconds.append(time.process_time() - start)
        if found is not None:
            stations += 1
            changes += before is not None and found.place != before
            before = found.place
    output.measure("replan/stations_found", stations)
    output.measure("replan/rounds", rounds)
    output.measure("replan/changes_of_station", changes)
    output.measure("replan/station_s", distribution(seconds))


def ground_below(target: Target) -> RigidTransform:
    """Return the transform from the level ground frame below a target to the world.

    Its x axis is the horizontal direction of the target's normal.
    """
    turn = Rotation.from_euler("z", np.arctan2(target.normal[1], target.normal[0]))
    return RigidTransform.from_components([*target.position[:2], 0.0], turn)


def choose_station(
    voxels: VoxelMap,
    transform_map_to_ground: RigidTransform,
    robot: RobotDescription,
    drawing: InsertionDrawing,
) -> CameraStation | None:
    """Choose a camera station; None if there is none.

    Args:
        voxels: Present map.
        transform_map_to_ground: Transform from the map to the ground frame below the slot.
        robot: Rover that carries the camera.
        drawing: Drawing of card and slot.
    """
    ground = MappedGround(voxels.surface(), transform_map_to_ground)
    try:
        return best_camera_station(robot, drawing, ground=ground)
    except PlacementError:
        return None


def _speedup(voxels: VoxelMap, target: Target, output: Output) -> bool:
    """Time the fast search on the map beside rating every candidate, if the target is visible."""
    lens = head_lens()
    cells, _ = voxels.occupied_cells()
    centres = before_plane(target, voxels.grid.centres(cells), 0.02)
    near = np.linalg.norm(centres - target.position, axis=1) < lens.far + 0.1
    try:
        field = expand(target, occluders_of_voxels(centres[near], voxels.grid.resolution))
        task = SpatialTask([field], lens, voxels.probabilities, SearchConfig(refine=False))
        best_view(task)  # compiles
    except PlacementError:
        return False
    found: dict[str, View] = {}

    def fast() -> None:
        found["fast"] = best_view(task)

    def all_of_them() -> None:
        found["all"] = best_view_of_all(task)

    times = compare(fast, all_of_them, 2)
    output.measure("search_speedup/map", 1.0 / times["ratio"]["median"])
    output.measure("search_s/map", times["ours_s"])
    output.measure("search_s/map_exhaustive", times["peer_s"])
    same = np.isclose(found["fast"].rating, found["all"].rating, rtol=1e-12)
    output.check("placement, fast search on the map as exhaustive", float(same), "== 1", bool(same))
    return True
