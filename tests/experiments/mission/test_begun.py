"""The beginning of a mission: it drives, maps and localizes, and no truth is in reach."""

import numpy as np
import pytest

import experiments.mission.trial as trial_room
from controllers.mission.radio import FRAME_BYTES, Status
from experiments.mission.film import recorded
from experiments.mission.scene import MASTER, SLAVE
from experiments.mission.trial import MissionTrial, perform, prepared
from models.compose import make_terrain
from tests.twin.recording.test_record import columns
from tests.twin.test_truth_barrier import leaks
from twin.loop import LoopRecorder

SECONDS = 40.0
"""Robot time of the mission that is begun: the identification and the first drives."""


class Begun(LoopRecorder):
    """Keeps the rovers' true poses where their frames began, by name."""

    def __init__(self, mission):
        self.begin = {}
        self._mission = mission

    def record(self, tick):
        if tick.step == 10:
            for part in self._mission.team.parts:
                true = self._mission.poses(part.name)["chassis"]
                self.begin[part.name] = true * part.belief.navigator.odometry.pose().inv()


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    path = tmp_path_factory.mktemp("begun") / "run.rrd"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trial_room, "LIMIT", SECONDS)
        with prepared(MissionTrial(5)) as mission:
            recorder = Begun(mission)
            with recorded(mission, path) as film:
                outcome = perform(mission, [recorder, film])
            yield mission, outcome, recorder.begin, path


@pytest.mark.slow
def test_a_mission_that_is_cut_short_says_where(begun):
    _, outcome, _, _ = begun
    assert outcome.failed_stage == "search" and outcome.reason == "out of time"
    assert list(outcome.stages) == ["identify"] and len(outcome.identifications) == 2
    assert not outcome.arrived and not outcome.success
    assert all(len(track) == round(SECONDS) for track in outcome.tracks.values())
    assert outcome.fallen == () and outcome.notices == ()


@pytest.mark.slow
def test_both_rovers_state_where_they_are_in_the_mission_once_a_second(begun):
    _, outcome, _, _ = begun
    status = len(Status(0).pack()) + FRAME_BYTES
    # The sender's clock may be off by some seconds in all, and each end of a stage is said at once.
    assert sum(outcome.radio_bytes.values()) == pytest.approx(2 * SECONDS * status, rel=0.15)
    assert outcome.map_bytes == 0


@pytest.mark.slow
def test_no_truth_is_reachable_from_the_team(begun):
    mission, _, _, _ = begun
    assert leaks(mission.team) == []


@pytest.mark.slow
def test_odometry_holds_the_true_poses_within_its_gate(begun):
    mission, outcome, begin, _ = begun
    assert max(outcome.driven) > 0.05
    for part in mission.team.parts:
        odometry = part.belief.navigator.odometry
        true = begin[part.name].inv() * mission.poses(part.name)["chassis"]
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
    mission, _, begin, _ = begun
    ground = mission.team.master.belief.navigator.ground
    rows, columns = np.nonzero(ground.known)
    assert len(rows) > 300
    points = np.column_stack([ground.grid.centres[rows, columns], ground.heights[rows, columns]])
    world = begin[MASTER].apply(points)
    terrain = make_terrain(mission.scene.field, mission.scene.robots)
    off = world[:, 2] - terrain.height_at(world[:, :2])
    assert abs(np.median(off)) < 0.03
    assert np.median(np.abs(off - np.median(off))) < 0.015


@pytest.mark.slow
def test_the_recording_shows_rovers_maps_paths_and_what_the_cameras_saw(begun):
    mission, _, _, path = begun
    rows = columns(path)
    assert path.stat().st_size < 10e6 + 90e6 * SECONDS / 600.0  # The field's meshes are there once.
    for robot in (MASTER, SLAVE):
        part = next(part for part in mission.team.parts if part.name == robot)
        assert len(rows[f"/world/{robot}/chassis"]["Transform3D:translation"]) >= 10 * SECONDS
        assert (
            len([blob for blob in rows[f"/{robot}/stereo/left"]["EncodedImage:blob"] if blob]) > 3
        )
        cells = rows[f"/mission/{robot}/ground"]["Points3D:positions"][-1]
        assert 300 < len(cells) <= np.count_nonzero(part.belief.navigator.ground.known)
        strips = rows[f"/mission/{robot}/path"]["LineStrips3D:strips"]
        lines = [np.array(each[0]) for each in strips if each]
        assert lines and all(np.isfinite(line).all() for line in lines)
