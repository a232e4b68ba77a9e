"""Missions in whose midst something happens to a rover, with and without a twin beside it."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from controllers.mission.stages.insert import InsertCard
from controllers.mission.stages.map_site import MapSite
from experiments.harness.intervals import mcnemar, success_fraction
from experiments.harness.output import Output
from experiments.live.twin_beside import TwinBeside
from experiments.living.happenings import happen
from experiments.mission.scene import SLAVE
from experiments.mission.trial import Mission, MissionTrial, perform, prepared
from models.compose import RobotPlacement
from twin.logs.ticks import RoverTick
from twin.loop import LoopRecorder, Tick
from twin.shadow.deviations import shadow_scene

NOTHING = "nothing"
CHANGES: Mapping[str, tuple[str, float]] = {
    NOTHING: ("", 0.0),
    "load": ("load base", 2.0),
    "spring": ("spring rear_left", 0.7),
    "grip": ("grip rear_left", 0.5),
}
"""What happens, by its name in the measures: name and size as of `happenings.happen`."""
MIDWAY = MapSite.name
"""Stage after which it happens, to the slave."""
LEARNING = 60.0
"""Time for which the twin only learns [s]."""
LOSS = 0.1
"""Bar: success of missions with a change is not below that of those without by more."""
SIGNIFICANT = 0.01
"""Bar of McNemar's p."""


@dataclasses.dataclass(frozen=True)
class LivingMission:
    """A mission, and what happens to its slave.

    Attributes:
        seed: Seed of the mission, as of `experiments.mission.trial.MissionTrial`.
        change: What happens, of `CHANGES`.
        watched: Whether a twin runs beside the slave, and tells it what it names.
    """

    seed: int
    change: str
    watched: bool

    @property
    def key(self) -> str:
        """Name of its cell in the measures."""
        return f"{self.change}/{'with' if self.watched else 'without'}"


@dataclasses.dataclass(frozen=True)
class LivingOutcome:
    """What became of a mission.

    Attributes:
        success: Whether it succeeded, as of `experiments.mission.trial.MissionResult`.
        reason: Why it ended early; empty if it did not.
        seconds: Duration in robot time [s].
        happened: When something happened [s]; NaN for never.
        named: When the twin named something [s], and what.
    """

    success: bool
    reason: str
    seconds: float
    happened: float
    named: tuple[tuple[float, str], ...]


class Happening(LoopRecorder):
    """Lets something happen to the slave, once the stage in the midst has ended.

    Attributes:
        time: When it did [s]; NaN before.
    """

    def __init__(self, mission: Mission, change: str) -> None:
        self.time = float("nan")
        self._mission = mission
        self._name, self._size = CHANGES[change]

    def record(self, tick: Tick) -> None:
        """Take a tick."""
        simulation = self._mission.connection.simulation
        if np.isfinite(self.time) or MIDWAY not in self._mission.team.ended:
            return
        self.time = tick.time
        if self._name and simulation is not None:
            drawn = shadow_scene(RobotPlacement(SLAVE, card=True))
            happen(simulation, drawn, SLAVE, self._name, self._size)


class TwinTells(LoopRecorder):
    """Runs a twin beside the slave, and tells it what is named until it inserts the card.

    In the slot a card is held by what no twin has.
    """

    def __init__(self, mission: Mission) -> None:
        placed = next(each for each in mission.scene.robots if each.name == SLAVE)
        known = RobotPlacement(SLAVE, card=placed.card, mast=placed.mast, stereo=placed.stereo)
        self._twin = TwinBeside(known, LEARNING, threads=1, rough=True)
        self._part = mission.team.slave

    @property
    def named(self) -> tuple[tuple[float, str], ...]:
        """When something was named [s], and what."""
        return tuple((each.time, each.finding.name) for each in self._twin.named)

    def record(self, tick: Tick) -> None:
        """Take a tick.

        Raises:
            StageError: If the slave cannot go on with what changed.
        """
        if self._part.stage.name == InsertCard.name:
            return
        before = len(self._twin.named)
        self._twin.step(RoverTick(SLAVE, tick.observations[SLAVE], tick.applied[SLAVE]))
        for named in self._twin.named[before:]:
            self._part.told(named.finding)

    def close(self) -> None:
        """End the twin."""
        self._twin.close()


def run_living_mission(trial: LivingMission) -> LivingOutcome:
    """Run one mission; a job of the sweep.

    Args:
        trial: Its settings.
    """
    with prepared(MissionTrial(trial.seed)) as mission:
        happening = Happening(mission, trial.change)
        tells = [TwinTells(mission)] if trial.watched else []
        result = perform(mission, [happening, *tells])
        named = tuple(each for one in tells for each in one.named)
        for one in tells:
            one.close()
    return LivingOutcome(result.success, result.reason, result.seconds, happening.time, named)


def measure_missions(
    trials: Sequence[LivingMission], results: Sequence[LivingOutcome], output: Output
) -> None:
    """Measure missions.

    Args:
        trials: Missions of the same seeds in each cell.
        results: What became of each.
        output: Receives ``mission_success/<change>/<with or without>``, ``mission_p/<change>`` of
            twins against none, and a table.
    """
    cells: dict[str, list[bool]] = {}
    for trial, result in zip(trials, results, strict=True):
        cells.setdefault(trial.key, []).append(result.success)
    for key, flags in cells.items():
        output.measure(f"mission_success/{key}", success_fraction(flags))
    usual = float(np.mean(cells[f"{NOTHING}/with"]))
    better: list[bool] = []
    for change in dict.fromkeys(trial.change for trial in trials):
        flags = cells[f"{change}/with"], cells[f"{change}/without"]
        p = mcnemar(*flags)
        output.measure(f"mission_p/{change}", p)
        if change != NOTHING:
            share = float(np.mean(flags[0]))
            bar = usual - LOSS - 1e-9
            output.check(f"missions, {change}", share, f">= {usual - LOSS:g}", share >= bar)
            better.append(p < SIGNIFICANT and sum(flags[0]) > sum(flags[1]))
    if better:
        output.check("changes in which a twin helps", sum(better), ">= 1", any(better))
    output.table("missions", *_table(trials, results))


def _table(
    trials: Sequence[LivingMission], results: Sequence[LivingOutcome]
) -> tuple[list[str], list[Sequence[object]]]:
    columns = ["change", "twin", "seed", "success", "reason", "time [s]", "happened [s]", "named"]
    rows: list[Sequence[object]] = [
        (
            trial.change, trial.watched, trial.seed, result.success, result.reason, result.seconds,
            result.happened, ", ".join(f"{name} at {time:.0f} s" for time, name in result.named),
        )
        for trial, result in zip(trials, results, strict=True)
    ]  # fmt: skip
    return columns, rows
