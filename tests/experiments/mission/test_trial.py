"""Scoring of a mission against the truth."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import experiments.mission.trial as trial_room
from controllers.mission.config import STAGES
from experiments.harness.sweep import _read, _write
from experiments.mission.scene import draw_scene, survey
from experiments.mission.shortest import shortest_path
from experiments.mission.trial import (
    GATE,
    BeliefResult,
    MissionResult,
    MissionTrial,
    PathResult,
    generators,
    prepared,
    upright,
)
from models.clutter import ScreenConfig
from models.configuration import check_screens
from models.datasheets import RADIO
from twin.hardware.emulator.modem import ModemConfig


def result(**changes):
    """A mission that has succeeded, with changes."""
    good = BeliefResult("place", "rover1", 100.0, 0.01, 0.01, 6.0)
    ends = {name: 20.0 * (index + 1) for index, name in enumerate(STAGES)}
    values = {
        "failed_stage": "", "reason": "", "stages": ends, "seconds": 120.0, "wall_over_sim": 0.4,
        "beliefs": (good,), "place_error": 0.02, "place_turn": 0.02,
        "misses": np.array([[0.05, 0.1]]), "detected": True, "seated": True, "peak": 0.5,
        "touch": 1.0, "snap": 3.0, "card": np.array([1e-4, 0.04, 0.0, 0.0, 0.0, 0.0]),
        "driven": (3.0, 4.0), "paths": (), "collisions": (),
        "fallen": (), "tracks": {}, "radio_bytes": {}, "map_bytes": 0, "notices": (),
        "identifications": (),
    }  # fmt: skip
    return MissionResult(**{**values, **changes})


def test_a_mission_arrives_only_with_consistent_beliefs_and_both_rovers_at_their_places():
    assert result().arrived
    assert not result(stages={"search": 9.0}, failed_stage="approach", reason="lost").arrived
    assert not result(place_error=0.06).arrived
    assert not result(place_turn=math.radians(6.0)).arrived
    assert not result(detected=False).arrived
    wrong = BeliefResult("map", "rover2", 90.0, 0.1, 0.1, GATE + 1.0)
    assert not result(beliefs=(wrong,)).arrived
    assert result(beliefs=(wrong,)).inconsistent == "map"
    # It may arrive, and not insert the card.
    failed = result(failed_stage="insert", reason="force", seated=False)
    assert failed.arrived and not failed.success


def test_a_seated_card_is_no_success_where_harm_was_done():
    assert result(peak=29.0).success
    assert not result(peak=31.0).success
    assert not result(fallen=("rover1",)).success


def test_a_seated_card_is_no_success_where_a_stage_believed_wrong():
    assert result().success
    wrong = BeliefResult("search", "rover2", 90.0, 0.1, 0.1, GATE + 1.0)
    assert not result(beliefs=(wrong,)).success


def test_results_are_stored_and_read_back(tmp_path):
    tracks = {"rover1": np.arange(6.0).reshape(3, 2)}
    made = result(
        tracks=tracks,
        paths=(PathResult("rover1", 3.0, math.inf),),
        radio_bytes={"search": 812},
        notices=("4.0 s: rover1 hears rover2 again",),
        place_error=math.nan,
    )
    _write(tmp_path / "job.npz", MissionTrial(1), made)
    (got,) = _read(tmp_path / "job.npz", MissionResult)
    assert got.radio_bytes == {"search": 812} and got.notices == made.notices
    assert got.stages == made.stages and got.beliefs == made.beliefs and got.paths == made.paths
    np.testing.assert_array_equal(got.tracks["rover1"], tracks["rover1"])
    np.testing.assert_array_equal(got.misses, made.misses)
    assert math.isnan(got.place_error)


def test_gate_is_that_of_one_in_a_thousand():
    draws = np.random.default_rng(0).chisquare(6, 1_000_000)
    assert np.mean(draws > GATE) == pytest.approx(1e-3, rel=0.15)


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.1, -0.15, 0.98)])
def test_upright_takes_out_pitch_and_roll_as_an_inclinometer_measures_them(up):
    up = np.array(up) / np.linalg.norm(up)
    tilted = Rotation.from_euler("ZXY", [0.7, 0.12, -0.08])
    level = upright(tilted, up)
    np.testing.assert_allclose(level.apply([0.0, 0.0, 1.0]), up, atol=1e-12)
    if up[2] == 1.0:
        np.testing.assert_allclose(level.as_euler("ZXY"), [0.7, 0.0, 0.0], atol=1e-12)


def test_every_drawn_scene_can_be_built():
    # One robot's block would stand at the other's start, or at the panel, in one of 140 draws.
    for seed in range(300, 800):
        scene = draw_scene(MissionTrial(1).width, generators(seed)[0])
        check_screens(scene.field, scene.robots)


def test_shortest_path_leads_around_what_truly_stands_there():
    scene_rng, site_rng, _ = generators(1)
    drawn = draw_scene(MissionTrial(1).width, scene_rng)
    site = survey(drawn, site_rng)
    start, goal = np.array([2.0, -3.0]), np.array([2.0, -6.0])

    def length(*screens):
        field = dataclasses.replace(drawn.field, rocks=0, blocks=0, screens=screens)
        return shortest_path(dataclasses.replace(drawn, field=field), site, start, goal)

    assert length() == pytest.approx(3.0, abs=0.06)
    wall = ScreenConfig((2.0, -4.5), 0.0, (1.0, 0.12, 0.6))
    # Around its corner with a rover's radius of 0.3 m.
    corner = 2.0 * math.hypot(0.8, 1.5 - 0.06)
    assert corner - 0.1 < length(wall) < corner + 0.5
    low = ScreenConfig((2.0, -4.5), 0.0, (1.0, 0.12, 0.02))
    assert length(low) == pytest.approx(3.0, abs=0.06)
    assert math.isnan(shortest_path(drawn, site, np.full(2, np.nan), goal))


class Asked(Exception):
    """Ends a preparation where robots would be connected."""


@pytest.mark.parametrize(("loss", "lost"), [(0.0, RADIO.packet_loss), (0.2, 0.2)])
def test_messages_are_lost_as_by_the_realism_or_more(monkeypatch, loss, lost):
    asked = {}

    def connect(target, **settings):
        asked.update(settings)
        raise Asked

    monkeypatch.setattr(trial_room, "connect", connect)
    with pytest.raises(Asked), prepared(MissionTrial(1, loss=loss)):
        pass
    assert asked["lines"].modems == dataclasses.replace(ModemConfig.of(RADIO), packet_loss=lost)
    assert asked["seed"] == 1 and len(asked["robots"]) == 2
