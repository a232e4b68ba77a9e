"""The beginning of a crossing, and what the experiment measures of many."""

import json
import math

import numpy as np
import pytest

import experiments.crossing.trial as trial_room
from experiments.crossing import crossing
from experiments.crossing.crossing import Options, run
from experiments.crossing.scene import MASTER, SLAVE
from experiments.crossing.trial import BeliefResult, CrossingTrial, perform, prepared
from experiments.harness.contract import OptionError
from experiments.harness.output import Output
from models.compose import make_terrain
from tests.experiments.crossing.test_crossing_trial import result
from tests.twin.test_truth_barrier import leaks
from twin.loop import LoopRecorder

SECONDS = 18.0
"""Robot time of the crossing that is begun: the first drives."""


class Begun(LoopRecorder):
    """Keeps the rovers' true poses where their frames began, by name."""

    def __init__(self, played):
        self.begin = {}
        self._played = played

    def record(self, tick):
        if tick.step == 10:
            for name, knowledge in knowledges(self._played).items():
                true = self._played.pose(f"{name}/chassis")
                self.begin[name] = true * knowledge.navigator.odometry.pose().inv()


def knowledges(played):
    return {MASTER: played.team.master, SLAVE: played.team.slave}


@pytest.fixture(scope="module")
def begun():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial_room, "LIMIT", SECONDS)
        with prepared(CrossingTrial(5)) as played:
            recorder = Begun(played)
            outcome = perform(played, [recorder])
            yield played, outcome, recorder.begin


@pytest.mark.slow
def test_a_crossing_that_is_cut_short_says_where(begun):
    _, outcome, _ = begun
    assert outcome.failed_stage == "search" and outcome.reason == "out of time"
    assert not outcome.arrived
    assert all(len(track) == round(SECONDS) for track in outcome.tracks.values())
    assert outcome.fallen == ()


@pytest.mark.slow
def test_no_truth_is_reachable_from_the_team(begun):
    played, _, _ = begun
    assert leaks(played.team) == []


@pytest.mark.slow
def test_odometry_holds_the_true_poses_within_its_gate(begun):
    played, outcome, begin = begun
    assert max(outcome.driven) > 0.05
    for name, knowledge in knowledges(played).items():
        odometry = knowledge.navigator.odometry
        true = begin[name].inv() * played.pose(f"{name}/chassis")
        estimate, covariance = odometry.estimate()
        away = np.asarray(true.translation - estimate.translation)
        # The covariance is of a twist about the frame's origin.
        lever = np.hstack([-_cross(estimate.translation), np.eye(3)])
        place = lever @ covariance @ lever.T + 1e-6 * np.eye(3)
        assert away @ np.linalg.solve(place, away) < 16.27  # 99.9 % of three degrees


def _cross(vector):
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@pytest.mark.slow
def test_the_mapped_ground_is_the_true_one(begun):
    played, _, begin = begun
    ground = played.team.master.navigator.ground
    rows, columns = np.nonzero(ground.known)
    assert len(rows) > 300
    points = np.column_stack([ground.grid.centres[rows, columns], ground.heights[rows, columns]])
    world = begin[MASTER].apply(points)
    terrain = make_terrain(played.scene.field, played.scene.robots)
    off = world[:, 2] - terrain.height_at(world[:, :2])
    assert abs(np.median(off)) < 0.03
    assert np.median(np.abs(off - np.median(off))) < 0.015


def test_run_measures_arrivals_failures_and_stations(tmp_path, monkeypatch):
    station = BeliefResult("place", MASTER, 200.0, 0.02, math.radians(1.0), 6.0)
    other = BeliefResult("place", SLAVE, 200.0, 0.01, math.radians(1.0), 60.0)
    tracks = {MASTER: np.zeros((2, 2)), SLAVE: np.ones((2, 2))}
    made = [
        result(beliefs=(station,), tracks=tracks),
        result(beliefs=(station, other), tracks=tracks),
        result(failed_stage="search", reason="not found", beliefs=(), place_error=math.nan),
    ]
    monkeypatch.setattr(crossing, "sweep", lambda *args, **named: made)
    output = Output("crossing", Options(out=tmp_path, seeds=3))
    run(Options(out=tmp_path, seeds=3), output)
    output.finish()
    measured = json.loads((tmp_path / "crossing" / "metrics.json").read_text())["measured"]
    assert measured["arrived_fraction"]["mean"] == pytest.approx(1 / 3)
    assert measured["failures/search"] == 1 and measured["inconsistent/place"] == 1
    assert measured["station_error_mm"]["median"] == pytest.approx(20.0)
    assert measured["station_nees"]["median"] == pytest.approx(1.0)
    assert measured["collisions"] == 0 and measured["tip_overs"] == 0
    assert (tmp_path / "crossing" / "figures" / "crossing.png").is_file()


def test_unknown_parts_are_refused_with_the_known_ones():
    with pytest.raises(OptionError, match="--without map: expected some of paths, occluders"):
        Options(without=("map",))
