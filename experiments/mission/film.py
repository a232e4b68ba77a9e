"""A mission on film: stages told as they pass, pictures, and a recording for the rerun viewer."""

import dataclasses
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from controllers.mission.robot_mission import MissionStage
from controllers.mission.stages.find import FindPanel
from controllers.mission.stages.map import MapTogether
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.trial import Mission, MissionResult, MissionTrial, perform, prepared
from models.card_and_slot.stand import SITE_VIEW
from perception.geometry.arrays import ImageArray
from twin.camera import renderer
from twin.layout import task_blueprint
from twin.loop import LoopRecorder, Tick
from twin.record import Recorder

SIZE = (640, 480)
_LASTS = {"identify": 13.5, "find": 12.0, "meet": 13.0, "map": 9.0, "place": 22.0, "insert": 20.0}
_ANY_LASTS = 15.0
"""About how long stages take [s], for the bars; a stage that is not named, as the last says."""
_POINTS = 30_000


@dataclasses.dataclass
class Film:
    """What was filmed.

    Attributes:
        result: Result of the mission.
        steps: Names of the stages, when they ended [s] and pictures of the site; none without a
            simulation in this process.
    """

    result: MissionResult
    steps: list[tuple[str, float, ImageArray]]


class _Bars(LoopRecorder):
    """A progress bar for each stage."""

    def __init__(self, mission: Mission, progress: Progress) -> None:
        self._mission, self._progress = mission, progress
        self._stage, self._since = "", 0.0
        self._bar: TaskID | None = None

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        name = self._mission.team.slave.stage.name
        if name != self._stage:
            if self._bar is not None:
                self._progress.update(self._bar, completed=1.0, total=1.0)
            self._stage, self._since = name, tick.time
            self._bar = self._progress.add_task(name, total=1.0, robot_time="")
        if tick.step % 20 == 0 and self._bar is not None:
            part = (tick.time - self._since) / _LASTS.get(name, _ANY_LASTS)
            self._progress.update(
                self._bar, completed=min(part, 0.99), robot_time=f"{tick.time:6.1f} s"
            )

    def flush(self) -> None:
        """End the last bar."""
        if self._bar is not None:
            self._progress.update(self._bar, completed=1.0)


class _Steps(LoopRecorder):
    """Takes a picture at the end of each stage."""

    def __init__(self, mission: Mission) -> None:
        self.steps: list[tuple[str, float, ImageArray]] = []
        self._mission = mission

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        simulation = self._mission.connection.simulation
        if simulation is None:
            return
        for name, ended in self._mission.team.ended[len(self.steps) :]:
            picture = renderer().render(simulation.model, simulation.data, SITE_VIEW, *SIZE)
            self.steps.append((name, ended, picture.copy()))


class _Notes(LoopRecorder):
    """Adds stages, the map, what is seen and what is felt to a recording."""

    def __init__(self, recorder: Recorder, mission: Mission) -> None:
        self._recorder, self._mission = recorder, mission
        self._text, self._views = "", 0
        self._stage: MissionStage | None = None

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        stage, insertion = self._mission.team.master.stage, self._mission.insertion
        text = stage.name
        if insertion is not None:
            inserter = insertion.inserter
            text = f"{text}: {inserter.stage.value} {inserter.reason}".strip()
            names = ("across [N]", "ahead [N]", "moment [N m]")
            self._recorder.log_scalars("mission/contact", inserter.contact[[0, 1, 5]], names)
        if text != self._text:
            self._text = text
            self._recorder.log_text("mission/stage", text)
        if stage is not self._stage:
            self._stage, self._views = stage, 0
        if isinstance(stage, FindPanel | MapTogether) and len(stage.mapper.views) > self._views:
            self._views = len(stage.mapper.views)
            self._map(stage)

    def _map(self, stage: FindPanel | MapTogether) -> None:
        """Show the map where it is by the panel's true place."""
        shared = stage.mapper.shared
        if shared.transform_target_to_world is None:
            return
        surface = shared.voxels.surface()
        chosen = np.arange(0, len(surface.means), max(1, len(surface.means) // _POINTS))
        self._recorder.log_points(
            "mission/map", surface.means[chosen], surface.probabilities[chosen]
        )


def film_mission(trial: MissionTrial, recording: Path | None) -> Film:
    """Run a mission, tell of its stages, and film it.

    Args:
        trial: What is tried.
        recording: File of a recording for the rerun viewer; None for none.
    """
    columns = (
        TextColumn("{task.description:9}"), BarColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[robot_time]}"),
    )  # fmt: skip
    with prepared(trial) as mission, Progress(*columns) as progress:
        steps = _Steps(mission)
        recorders: list[LoopRecorder] = [_Bars(mission, progress), steps]
        recorder = None
        if recording is not None:
            recorder = Recorder(
                recording, mission.connection.robots, mission.connection.simulation, _blueprint()
            )
            recorders += [recorder, _Notes(recorder, mission)]
        try:
            result = perform(mission, recorders)
        finally:
            if recorder is not None:
                recorder.close()
        return Film(result, steps.steps)


def _blueprint() -> rrb.Blueprint:
    views = [
        rrb.Spatial3DView(origin="mission/map", name="Map, about the panel"),
        rrb.TimeSeriesView(origin="mission/contact", name="Contact as felt"),
        rrb.TimeSeriesView(origin=f"{SLAVE}/sensors/arm_base_wrench", name="Wrench"),
        rrb.TextLogView(origin="mission/stage", name="Stage"),
    ]
    return task_blueprint(MASTER, (1.5, -2.0, 1.3), (0.1, -0.3, 0.15), views)
