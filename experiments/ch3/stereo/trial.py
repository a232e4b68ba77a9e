"""One scene of ``ch3-stereo``, mapped by two rovers; the truth only scores."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.localization import level_target
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mapping.stereo_view import MapperConfig, StereoView
from experiments.ch3.stereo.figures import panorama
from experiments.ch3.stereo.scene import StereoScene
from experiments.ch3.stereo.truth import mapped_share, pose_errors, surface_errors, true_surface
from experiments.harness.recording import NO_FILES, RunFiles
from perception.geometry.arrays import FloatArray
from perception.geometry.pinhole import StereoCalibration
from perception.registration.target import TargetCad
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from twin.camera import StereoConfig
from twin.connect import Connection, connect
from twin.describe import camera_in_world, describe_rover
from twin.description import RobotDescription
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop

VOXEL = 0.005
"""Side of a voxel [m]."""
BOX = ((-1.8, -2.4, -0.2), (1.8, 1.4, 0.68))
"""Corners of the map [m], about the target."""
MOUNT_ERROR = (0.004, 0.001)
"""Standard deviations of the rotation [rad] and position [m] of a head's mounting against its
drawing; assumed, and stated by its calibration."""
IMAGE_RATE = 0.5  # Rate of the pairs [Hz]; in software one takes some 0.3 s to render.
LONGEST = 300.0  # Greatest duration of a run [s]


@dataclasses.dataclass(frozen=True)
class MappingTrial:
    """One run.

    Attributes:
        seed: Seed of the scene and of all noise.
        method: Method that chooses the views, one of `METHODS` of the mapper.
        scans: Number of views of each robot.
        shown: Whether the result has what its figures need.
        robot: Kind of the robots: sim, quantised or emulated.
    """

    seed: int
    method: str
    scans: int
    shown: bool = False
    robot: str = "sim"


@dataclasses.dataclass
class Scored:
    """A mapped scene with its truth.

    Attributes:
        mapper: Mapper with its map and views.
        scene: Simulated scene, for its true surface.
        curve: Share of the true surface mapped, and number of occupied voxels, after each view.
        transform_scene_to_map: True transform to the frame that the robots map in, see
            `named_frame`.
        cameras: True transforms from camera to map of the pairs taken, by robot and time stamp.
        frame_turn: Angle between the map's frame and a truly level one [rad].
    """

    mapper: StereoMapper
    scene: StereoScene
    curve: list[tuple[float, int]]
    transform_scene_to_map: RigidTransform
    cameras: dict[tuple[str, float], RigidTransform]
    frame_turn: float


@dataclasses.dataclass(frozen=True)
class Shown:
    """Views and map of one run, for the figures; whole images would be too large to store.

    Attributes:
        panoramas: (robots, rows, columns) float32 grey levels by direction, NaN outside all views.
        images: Number of images in each panorama.
        surface: (N, 3) mapped surface points [m].
    """

    panoramas: NDArray[np.float32]
    images: tuple[int, ...]
    surface: FloatArray


@dataclasses.dataclass(frozen=True)
class MappingRun:
    """One scene mapped and scored.

    Attributes:
        curve: (n, 2) share of the true surface mapped, and number of occupied voxels, after each
            view.
        camera_errors: (2, n) error of each camera's position by the arm alone, and after
            correction [m].
        corrected_share: Share of the views whose camera was corrected.
        nees: (k,) squared normalised error of each fused point.
        lost_share: Share of the mapped points that are near no true surface.
        located: Number of robots that found the target.
        frame_turn: Angle between the map's frame and a truly level one [rad].
        shown: Views and map, if the trial is shown.
    """

    curve: FloatArray
    camera_errors: FloatArray
    corrected_share: float
    nees: FloatArray
    lost_share: float
    located: int
    frame_turn: float
    shown: Shown | None


def run_trial(trial: MappingTrial) -> MappingRun:
    """Map a scene and score it; a job of the sweep."""
    scored = map_scene(trial)
    mapper = scored.mapper
    surface = mapper.shared.voxels.surface()
    rng = np.random.default_rng((trial.seed, 6))
    nees, lost = surface_errors(surface, scored.scene, scored.transform_scene_to_map, rng)
    corrections = [view.correction for view in mapper.views if view.correction]
    return MappingRun(
        curve=np.array(scored.curve, dtype=float),
        camera_errors=pose_errors(mapper.views, scored.cameras),
        corrected_share=sum(c.corrected for c in corrections) / max(len(corrections), 1),
        nees=nees,
        lost_share=lost,
        located=len(mapper.localizations),
        frame_turn=scored.frame_turn,
        shown=_shown(mapper, scored.scene.robot_names) if trial.shown else None,
    )


def _shown(mapper: StereoMapper, robots: Sequence[str]) -> Shown:
    """Return the views and the map of a run."""
    corrected = [view for view in mapper.views if view.correction is not None]
    placed = [[view for view in corrected if view.robot == name] for name in robots]
    return Shown(
        np.array([panorama(views, mapper.shared.geometry) for views in placed], np.float32),
        tuple(len(views) for views in placed),
        mapper.shared.voxels.surface().means,
    )


def map_scene(
    trial: MappingTrial,
    on_view: Callable[[StereoMapper, StereoView, float], None] | None = None,
    files: RunFiles = NO_FILES,
) -> Scored:
    """Let two rovers map a scene.

    Args:
        trial: Scene and method.
        on_view: Called after each view with the mapper, the view and the share of the true surface
            that is mapped by now, for recording.
        files: Of these the log is written.
    """
    scene = StereoScene(trial.seed)
    how = MapperConfig(method=trial.method, scans=trial.scans)
    truth = true_surface(scene, how.reach, np.random.default_rng((trial.seed, 3)))
    mount, plan = (np.random.default_rng((trial.seed, k)) for k in (4, 5))
    curve: list[tuple[float, int]] = []

    def score(view: StereoView) -> None:
        pieces = named_frame(mapper.shared, scene).apply(truth)
        curve.append(mapped_share(mapper.shared.voxels, pieces))
        if on_view is not None:
            on_view(mapper, view, curve[-1][0])

    with connect(
        trial.robot,
        robots=scene.robots,
        field=scene.field,
        stereo=StereoConfig(rate=IMAGE_RATE),
        seed=trial.seed,
    ) as connection:
        voxels = VoxelMap(
            VoxelGrid(VOXEL, *BOX), VoxelMapConfig(correlated_points=shared_errors(how))
        )
        shared = SharedMap(voxels, scene.geometry, target_cad(scene), how.stereo.stride, how.reach)
        robots = {name: _drawn(scene, name, mount) for name in scene.robot_names}
        mapper = StereoMapper(robots, shared, how, plan, score)
        witness = Witness(connection)
        with files.logged(connection.settings) as recorders:
            run_loop(
                connection.robots,
                [mapper],
                connection.clock,
                [witness, *recorders],
                duration=LONGEST,
                until=lambda: mapper.done,
            )
    to_map = named_frame(mapper.shared, scene)
    cameras = {key: to_map * pose for key, pose in witness.cameras.items()}
    level = level_target(scene.transform_panel_to_world) * scene.transform_panel_to_world.inv()
    turn = float((to_map * level.inv()).rotation.magnitude())
    return Scored(mapper, scene, curve, to_map, cameras, turn)


def named_frame(shared: SharedMap, scene: StereoScene) -> RigidTransform:
    """Return the true transform from the scene to the frame in which the robots map.

    The robot that finds the target first defines the frame by its measured tilt. Its head's error
    turns the frame by some milliradians from the level; that is no error of the map.

    Args:
        shared: The robots' map; before the target was seen, its frame is taken for level.
        scene: Scene with the true pose of the panel.
    """
    panel = scene.transform_panel_to_world
    named = shared.transform_target_to_world
    return (level_target(panel) if named is None else named) * panel.inv()


class Witness(LoopRecorder):
    """Records the true poses of the cameras when pairs are taken; a recorder of the loop.

    Args:
        connection: Robots in a simulation, or in another process behind emulated boards.
    """

    def __init__(self, connection: Connection) -> None:
        self.cameras: dict[tuple[str, float], RigidTransform] = {}
        self._connection = connection

    def record(self, tick: Tick) -> None:
        """Store the poses of the cameras that took a pair at this tick."""
        for name, seen in tick.observations.items():
            if seen.stereo.stamp == tick.time:
                self.cameras[name, tick.time] = self._camera(name)

    def _camera(self, name: str) -> RigidTransform:
        simulation, emulator = self._connection.simulation, self._connection.emulator
        if simulation is not None:
            return camera_in_world(simulation.model, simulation.data, f"{name}/stereo_left")
        assert emulator is not None
        pose = emulator.state()[name]["camera"]
        assert pose is not None
        turn = Rotation.from_matrix(pose["rotation"])
        return RigidTransform.from_components(pose["translation"], turn)


def shared_errors(config: MapperConfig) -> float:
    """Return how many points of a pair share one error: those whose matching windows overlap.

    The errors of points a stride apart are correlated by 0.7, and by 0.04 when their windows touch:
    over all neighbours the correlations add up to 14 (9 views), the ratio of areas is 13.4.
    """
    return (config.stereo.window / config.stereo.stride) ** 2


def target_cad(scene: StereoScene) -> TargetCad:
    """Return the CAD of the panel's markers."""
    marker = scene.panel.markers[0]
    return TargetCad(scene.panel.marker_points, marker.radius, marker.dark)


def _drawn(scene: StereoScene, name: str, rng: np.random.Generator) -> RobotDescription:
    """Return a robot as drawn, but for a random error of its head's mounting."""
    drawn = describe_rover(name)
    assert drawn.head is not None
    off = RigidTransform.from_exp_coords(np.repeat(MOUNT_ERROR, 3) * rng.standard_normal(6))
    mounted = drawn.head.transform_camera_to_wrist * off
    head = dataclasses.replace(
        drawn.head,
        transform_camera_to_wrist=mounted,
        calibration=StereoCalibration(head_turn=MOUNT_ERROR[0], head_shift=MOUNT_ERROR[1]),
    )
    return dataclasses.replace(drawn, head=head)
