"""What is measured of missions, and missions in which the rovers begin near the slot."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import experiments.mission.trial as trial_room
from controllers.mission.config import STAGES
from experiments.__main__ import main
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from experiments.mission import mission
from experiments.mission.collisions import Collision
from experiments.mission.mission import run
from experiments.mission.mission_options import DEMONSTRATION, Options
from experiments.mission.scene import MASTER, SLAVE, MissionScene, draw_scene
from experiments.mission.trial import (
    BeliefResult,
    MissionResult,
    MissionTrial,
    PathResult,
    generators,
    perform,
    prepared,
)
from tests.experiments.mission.test_trial import result

STATION = BeliefResult("place", MASTER, 200.0, 0.02, math.radians(1.0), 6.0)
OTHER = BeliefResult("place", SLAVE, 200.0, 0.01, math.radians(1.0), 60.0)
TRACKS = {MASTER: np.zeros((2, 2)), SLAVE: np.ones((2, 2))}
HIT = Collision(SLAVE, "rover2/chassis", "block3", 4.0, 5.0)


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"robot": "lego"}, "'lego'; available"),
        (
            {"without": ("map",)},
            "--without map: expected some of paths, occluders, panel, guard, coop",
        ),
        ({"loss": 1.0}, "--loss 1.0: expected a share"),
        ({"robot": "serial:/dev/a,robot=rover1", "loss": 0.2, "quick": True}, "one mission at a"),
    ],
)
def test_wrong_options_are_named_with_the_right_ones(bad: dict[str, Any], words: str) -> None:
    with pytest.raises(OptionError, match=words):
        Options(**bad)


def test_the_quick_mission_is_the_first_whose_rovers_both_begin_within_four_metres() -> None:
    def far(seed: int) -> float:
        robots = draw_scene(MissionTrial(seed).width, generators(seed)[0]).robots
        return max(math.hypot(*robot.position) for robot in robots)

    assert all(far(seed) > 4.0 for seed in range(1, DEMONSTRATION)) and far(DEMONSTRATION) <= 4.0
    assert Options(quick=True).mission_seeds == [DEMONSTRATION]
    others = Options(quick=True, seed=3).mission_seeds, Options(quick=True, seeds=2).mission_seeds
    assert [len(seeds) for seeds in others] == [1, 2] and DEMONSTRATION not in sum(others, [])


def measured(
    options: Options, results: list[MissionResult], monkeypatch: pytest.MonkeyPatch
) -> tuple[dict[str, Any], list[MissionTrial], str]:
    """Return metrics, trials and failure of a run whose missions end as given."""
    asked: list[MissionTrial] = []

    def pretend(_: object, jobs: list[MissionTrial], *more: object, label: str) -> Any:
        asked.extend(jobs)
        return results

    monkeypatch.setattr(mission, "sweep", pretend)
    output = Output("mission", options)
    run(options, output)
    failure = output.failure
    output.finish()
    assert options.out is not None
    folder = Path(options.out) / "mission"
    assert (folder / "figures" / "mission_tracks.png").is_file()
    return json.loads((folder / "metrics.json").read_text())["measured"], asked, failure


def test_missions_are_counted_by_what_ended_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = (PathResult(SLAVE, 3.0, 2.0), PathResult(MASTER, 2.0, 2.0))
    none = (PathResult(SLAVE, 3.0, math.inf), PathResult(MASTER, 2.0, math.nan))
    said = ("31.0 s: rover1 hears rover2 again",)
    made = [
        result(beliefs=(STATION,), tracks=TRACKS, paths=paths, radio_bytes={"search": 900},
               map_bytes=5000),
        result(beliefs=(STATION, OTHER), tracks=TRACKS, collisions=(HIT, HIT), paths=none,
               notices=said),
        result(beliefs=(), tracks=TRACKS, failed_stage="search", reason="not found",
               stages={"identify": 14.0}, place_error=math.nan, seated=False),
    ]  # fmt: skip
    found, _, failure = measured(Options(out=tmp_path, seeds=3), made, monkeypatch)
    assert found["success_fraction"]["mean"] == pytest.approx(1 / 3)
    assert found["arrived_fraction"]["mean"] == pytest.approx(1 / 3)
    assert found["failures/search"] == 1 and found["inconsistent/place"] == 1
    assert sum(found[f"failures/{stage}"] for stage in STAGES) == 1
    assert found["station_error_mm"]["median"] == pytest.approx(20.0)
    assert found["station_error_deg"]["median"] == pytest.approx(1.0)
    assert found["station_nees"]["median"] == pytest.approx(1.0)
    assert found["path_ratio"]["median"] == pytest.approx(1.25)
    assert found["collisions"] == 2 and found["tip_overs"] == 0
    assert found["map_bytes"]["p95"] == 5000 and found["radio_bytes/search"]["median"] == 900
    assert found["stage_seconds/identify"]["n"] == 3 and found["stage_seconds/search"]["n"] == 2
    assert found["first_stop_miss_mm"]["median"] == pytest.approx(50.0)
    assert not failure
    assert said[0] in capsys.readouterr().out
    table = (tmp_path / "mission" / "tables" / "notices.csv").read_text()
    assert said[0] in table


def test_what_nobody_sees_of_robots_on_boards_is_not_counted_as_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    unseen = result(tracks=TRACKS, peak=math.nan, touch=math.nan)
    options = Options(out=tmp_path, seeds=2, without=("paths",))
    found, _, _ = measured(options, [unseen] * 4, monkeypatch)
    assert not [key for key in found if key.startswith(("collisions", "collided", "tip_overs"))]
    assert found["success_p/without_paths"] == 1.0
    assert found["success_fraction"]["mean"] == 1.0


def test_a_run_in_which_no_mission_succeeds_says_where_the_first_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost = result(tracks=TRACKS, failed_stage="insert", reason="force", seated=False)
    _, _, failure = measured(Options(out=tmp_path, seeds=2), [lost, lost], monkeypatch)
    assert failure == "no mission succeeded; the first ended in insert: force"


def test_further_missions_are_compared_with_the_whole_ones_of_the_same_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of eight whole missions all succeed; without paths two do, each touching a block twice."""
    whole = [result(tracks=TRACKS)] * 8
    lost = result(tracks=TRACKS, seated=False, failed_stage="insert", collisions=(HIT, HIT))
    blind = [lost] * 6 + [dataclasses.replace(lost, seated=True, failed_stage="")] * 2
    options = Options(out=tmp_path, seeds=8, without=("paths",), loss=0.2)
    found, asked, _ = measured(options, [*whole, *blind, *whole], monkeypatch)
    assert [(job.without, job.loss) for job in asked] == (
        [("", 0.0)] * 8 + [("paths", 0.0)] * 8 + [("", 0.2)] * 8
    )
    assert [job.seed for job in asked[:8]] == [job.seed for job in asked[8:16]]
    assert found["success_fraction/without_paths"]["mean"] == pytest.approx(0.25)
    assert found["success_fraction/with_loss"]["mean"] == 1.0
    assert found["lost_and_won/without_paths"] == [6, 0]
    assert found["collisions/without_paths"] == 16
    # Four tests: McNemar's 2 / 2^6 is the second smallest, the sign test's 2 / 2^8 the smallest.
    assert found["collisions_p/without_paths"] == pytest.approx(4 * 2 / 2**8)
    assert found["success_p/without_paths"] == pytest.approx(3 * 2 / 2**6)
    assert found["success_p/with_loss"] == 1.0 == found["collisions_p/with_loss"]


def near_scene(seed: int) -> MissionScene:
    """Return a scene in which both rovers begin within 2 m of the slot, and nothing hides."""
    scene = draw_scene(MissionTrial(seed).width, generators(seed)[0])
    poses = {MASTER: (1.5, -0.6, 1.4), SLAVE: (0.5, -1.6, 0.6)}
    robots = [
        dataclasses.replace(robot, position=poses[robot.name][:2], yaw=poses[robot.name][2])
        for robot in scene.robots
    ]
    field = dataclasses.replace(scene.field, screens=scene.field.screens[:1])
    return dataclasses.replace(scene, field=field, robots=tuple(robots), known=poses)


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_a_mission_that_begins_near_the_slot_finds_the_panel_and_ends_or_says_why() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial_room, "LIMIT", 65.0)
        with prepared(MissionTrial(1, only="approach"), near_scene(1)) as played:
            ended = perform(played)
    assert list(ended.stages) == list(STAGES[: len(ended.stages)]) and "search" in ended.stages
    assert bool(ended.failed_stage) == ("approach" not in ended.stages) == bool(ended.reason)
    assert np.all(np.diff(list(ended.stages.values())) > 0.0)
    assert 0 <= ended.map_bytes <= 20_000
    assert set(ended.radio_bytes) <= set(STAGES)
    # Who is localized believes where the slot is after each stage.
    assert {each.robot for each in ended.beliefs if each.stage == "search"} == {MASTER, SLAVE}
    assert not any("waits" in words for words in ended.notices)


@pytest.mark.slow
def test_robots_as_made_identify_themselves_alone(tmp_path: Path) -> None:
    options = ["--seeds", "1", "--only", "identify", "--realism", "default", "--seed", "5"]
    assert main(["mission", *options, "--out", str(tmp_path)]) == 0
    measured = json.loads((tmp_path / "mission" / "metrics.json").read_text())["measured"]
    for robot in (MASTER, SLAVE):
        assert measured[f"identification_error_percent/{robot}"]["n"] == 1
    assert measured["identification_chi_square"]["n"] == measured["identified_fraction"]["n"] == 2
    # Two robots that are not alike, each beside its own laboratory.
    table = (tmp_path / "mission" / "tables" / "identification.csv").read_text().splitlines()
    assert len(table) == 3 and table[1].split(",")[1:] != table[2].split(",")[1:]
    assert "success_fraction" not in measured
