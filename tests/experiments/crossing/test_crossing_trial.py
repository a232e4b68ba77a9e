"""Scoring of a crossing against the truth."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from experiments.crossing.trial import (
    GATE,
    BeliefResult,
    CrossingResult,
    upright,
)


def result(**changes):
    good = BeliefResult("place", "rover1", 100.0, 0.01, 0.01, 6.0)
    values = {
        "failed_stage": "", "reason": "", "seconds": 100.0, "wall_over_sim": 0.4,
        "beliefs": (good,), "place_error": 0.02, "place_turn": 0.02, "driven": (3.0, 4.0),
        "collisions": (), "fallen": (), "tracks": {},
    }  # fmt: skip
    return CrossingResult(**{**values, **changes})


def test_a_crossing_arrives_only_with_consistent_beliefs_and_the_slave_at_its_place():
    assert result().arrived
    assert not result(failed_stage="search", reason="lost").arrived
    assert not result(place_error=0.06).arrived
    assert not result(place_turn=math.radians(6.0)).arrived
    assert not result(place_error=math.nan).arrived
    wrong = BeliefResult("map", "rover2", 90.0, 0.1, 0.1, GATE + 1.0)
    assert not result(beliefs=(wrong,)).arrived
    assert result(beliefs=(wrong,)).inconsistent == "map"


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
