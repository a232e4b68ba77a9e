"""A mission's progress bars, pictures, and recording for the rerun viewer."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rerun.blueprint as rrb
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from controllers.mission.navigator import Navigator
from controllers.mission.stage import MissionStage
from controllers.mission.stages.map_site import MapSite
from experiments.ch5.task_film import InsertionLog, insertion_views, scene_picture
from experiments.harness.recording import RunFiles
from experiments.mission.moving_picture import MovingPicture
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.trial import Mission, MissionResult, MissionTrial, perform, prepared
from models.card_and_slot.stand import SITE_VIEW
from perception.geometry.arrays import FloatArray, ImageArray
from twin.loop import LoopRecorder, Tick
from twin.recording.layout import scene_view, side_by_side
from twin.recording.record import Recorder

_LASTS = {
    "identify": 14.0, "search": 250.0, "map": 5.0, "place": 60.0, "approach": 60.0, "insert": 25.0,
}  # fmt: skip
"""Typical durations of stages for the progress bars [s]."""
_POINTS = 30_000  # Most points of the voxel map in a recording.
_CELLS = 8_000  # Most cells of an elevation map in a recording.
_EVERY, _WRITTEN = 10, 4.0
"""Ticks between two that are recorded, and robot time between writes [s]: with half of the first
and an eighth of the second, 145 s took 42 MB."""
_MAPPED, _PLANNED = 1000, 100  # Ticks between two elevation maps, and between two paths.
_NAMES = {MASTER: "master", SLAVE: "slave"}
Steps = list[tuple[str, float, ImageArray]]


class _Bars(LoopRecorder):
    """Shows a progress bar for each stage."""

    def __init__(self, mission: Mission, progress: Progress) -> None:
        self._mission, self._progress = mission, progress
        self._stage, self._since = "", 0.0
        self._bar: TaskID | None = None

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        name = self._mission.team.stage
        if name != self._stage:
            self.flush()
            self._stage, self._since = name, tick.time
            self._bar = self._progress.add_task(name, total=1.0, robot_time="")
        if tick.step % 20 == 0 and self._bar is not None:
            part = min((tick.time - self._since) / _LASTS[name], 0.99)
            self._progress.update(self._bar, completed=part, robot_time=f"{tick.time:6.1f} s")

    def flush(self) -> None:
        """End the last bar."""
        if self._bar is not None:
            self._progress.update(self._bar, completed=1.0)


class _StepPictures(LoopRecorder):
    """Renders the site at the end of each stage, if it is simulated in this process."""

    def __init__(self, mission: Mission) -> None:
        self.steps: Steps = []
        self._mission = mission

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        simulation = self._mission.connection.simulation
        if simulation is not None:
            for name in self._mission.team.ended[len(self.steps) :]:
                self.steps.append((name, tick.time, scene_picture(simulation, SITE_VIEW)))


class _Notes(LoopRecorder):
    """Records some ticks of a mission, with stages, maps, planned paths and contact."""

    def __init__(self, recorder: Recorder, mission: Mission) -> None:
        self._recorder, self._mission = recorder, mission
        self._log = InsertionLog(recorder, "mission")
        self._views = 0
        self._stage: MissionStage | None = None

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        if tick.step % _EVERY:
            return
        self._recorder.record(tick)
        stage, insertion = self._mission.team.master.stage, self._mission.insertion
        self._log.add(insertion.inserter if insertion is not None else None, stage.name)
        if stage is not self._stage:
            self._stage, self._views = stage, 0
        if isinstance(stage, MapSite) and len(stage.mapper.views) > self._views:
            self._views = len(stage.mapper.views)
            self._map(stage)
        for part in self._mission.team.parts:
            path, navigator = f"mission/{part.name}", part.belief.navigator
            if tick.step % _PLANNED == 0:
                self._recorder.log_line(f"{path}/path", _on_ground(navigator, navigator.course))
            if tick.step % _MAPPED == 0:
                self._ground(f"{path}/ground", navigator)

    def _ground(self, path: str, navigator: Navigator) -> None:
        """Log a rover's elevation map, higher cells brighter."""
        ground = navigator.ground
        rows, columns = np.nonzero(ground.known)
        every = slice(None, None, 1 + len(rows) // _CELLS)
        rows, columns = rows[every], columns[every]
        heights = ground.heights[rows, columns]
        if len(heights):
            shades = (heights - heights.min()) / max(float(np.ptp(heights)), 0.1)
            points = np.column_stack([ground.grid.centres[rows, columns], heights])
            self._recorder.log_points(path, points, shades)

    def _map(self, stage: MapSite) -> None:
        """Log the present map, once the panel has been found."""
        shared = stage.mapper.shared
        if shared.transform_target_to_world is not None:
            surface = shared.voxels.surface()
            every = slice(None, None, max(1, len(surface.means) // _POINTS))
            self._recorder.log_points(
                "mission/map", surface.means[every], surface.probabilities[every]
            )


def _on_ground(navigator: Navigator, path: FloatArray) -> FloatArray:
    """Return points (N, 3) of a path (N, 2), 5 cm above the mapped ground, in its frame [m]."""
    ground = navigator.ground
    low, high = np.zeros(2, dtype=int), np.array(ground.grid.shape) - 1
    rows, columns = np.clip(ground.grid.cells_of(path), low, high).T
    heights = np.nan_to_num(ground.heights[rows, columns])
    return np.column_stack([path, heights + 0.05])


def _layout() -> rrb.Blueprint:
    """Return the viewer's layout: the field and what both see; maps, paths and contact beside."""
    scene = scene_view("world", "Field", (5.0, -6.0, 5.0), (0.0, -0.5, 0.0))
    views = [
        rrb.Spatial2DView(origin=f"{robot}/stereo/left", name=f"The {name}'s left camera")
        for robot, name in _NAMES.items()
    ]
    maps = [
        rrb.Spatial3DView(origin=f"mission/{robot}", name=f"The {name}'s map and path")
        for robot, name in _NAMES.items()
    ]
    mapped = rrb.Spatial3DView(origin="mission/map", name="Map, about the panel")
    return side_by_side(
        rrb.Vertical(scene, rrb.Horizontal(*views), row_shares=[3, 2]),
        rrb.Vertical(rrb.Tabs(*maps, mapped), *insertion_views("mission"), row_shares=[3, 1, 1, 1]),
    )


@contextlib.contextmanager
def recorded(mission: Mission, path: Path) -> Iterator[LoopRecorder]:
    """Yield what writes a recording of a mission for the rerun viewer.

    Args:
        mission: Mission, ready to run.
        path: File to write.
    """
    robots, simulation = mission.connection.robots, mission.connection.simulation
    with Recorder(path, robots, simulation, _layout(), False, _WRITTEN) as recorder:
        yield _Notes(recorder, mission)


class Filmed(NamedTuple):
    """A mission and its pictures.

    Attributes:
        result: Result of the mission.
        steps: Name of each stage, its end time [s] and picture of the site; none without a
            simulation in this process.
        film: Moving picture; None likewise.
    """

    result: MissionResult
    steps: Steps
    film: MovingPicture | None


def film_mission(trial: MissionTrial, files: RunFiles) -> Filmed:
    """Run a mission, show its progress, and film it.

    Args:
        trial: Settings of the mission.
        files: Files of the run.
    """
    columns = (
        TextColumn("{task.description:9}"), BarColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[robot_time]}"),
    )  # fmt: skip
    with prepared(trial) as mission, Progress(*columns) as bars, contextlib.ExitStack() as stack:
        pictures = _StepPictures(mission)
        recorders: list[LoopRecorder] = [_Bars(mission, bars), pictures]
        film = None if mission.connection.simulation is None else MovingPicture(mission)
        if film is not None:
            recorders.append(film)
        if files.recording:
            recorders.append(stack.enter_context(recorded(mission, Path(files.recording))))
        recorders += stack.enter_context(files.logged(mission.connection.settings))
        return Filmed(perform(mission, recorders), pictures.steps, film)
