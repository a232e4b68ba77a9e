"""A placement is carried out by BRAID on a rover, and the camera then sees the target."""

import dataclasses

import mujoco
import numpy as np
import pytest

from experiments.appe.placement.placement import MEASURED, Options
from experiments.appe.placement.scene import PlacementSetting, draw_setting
from experiments.appe.placement.trial import (
    BraidPlanner,
    PlacedCamera,
    PlacementTrial,
    RoverView,
    run_placement,
)
from experiments.ch3.stereo.scene import look_at
from experiments.harness.contract import OptionError


@pytest.fixture(scope="module")
def scene() -> RoverView:
    return RoverView(PlacementSetting(np.array([0.0, 0.5, 0.33]), ()), 3)


def test_camera_looks_at_its_aim_with_its_top_up():
    place, aim = np.array([0.1, 0.2, 0.4]), np.array([0.0, 0.5, 0.3])
    camera = look_at(place, aim)
    seen = camera.inv().apply(aim)
    np.testing.assert_allclose(seen, [0.0, 0.0, np.linalg.norm(aim - place)], atol=1e-12)
    assert camera.rotation.as_matrix()[2, 0] == pytest.approx(0.0, abs=1e-12)  # rows are level
    assert camera.rotation.as_matrix()[2, 1] < 0.0


def test_kinematics_and_physics_agree_on_the_camera_but_for_sag_and_the_rovers_springs(scene):
    planner = BraidPlanner(scene, np.array([0.0, 0.5, 0.33]), ())
    for word in ([0, 0, 0], [1, 0, 6], [5, 5, 2]):
        scene.bench.put(np.array(word))
        mujoco.mj_forward(scene.bench.model, scene.bench.data)
        error = planner.camera_of(np.array(word)).inv() * scene.transform_camera_to_world()
        assert np.linalg.norm(error.translation) < 2e-3
        assert error.rotation.magnitude() < np.deg2rad(0.5)
    scene.bench.put(np.array([0, 0, 0]))


def test_a_target_that_nothing_hides_is_seen_whole_from_home(scene):
    part, pixels = scene.seen()
    assert part == 1.0
    assert pixels > 500.0


def test_obstacles_are_clear_of_the_rover_and_before_the_target():
    rng = np.random.default_rng(0)
    for _ in range(50):
        setting = draw_setting(rng)
        corners = np.concatenate([block.corners for block in setting.blocks])
        assert corners[:, 1].min() > 0.23
        assert corners[:, 1].max() < setting.target[1]


@pytest.mark.slow
def test_a_hidden_target_is_seen_after_braid_has_moved_to_its_word():
    result = run_placement(PlacementTrial(seed=2968811710, stages=5))
    assert result.home < 1.0
    assert result.placed is not None
    assert result.placed.wrong == 0
    assert result.placed.seen > 0.9
    assert result.placed.turn_deg < 5.0


def test_all_that_is_measured_of_a_setting_is_in_its_result():
    assert set(MEASURED) <= {field.name for field in dataclasses.fields(PlacedCamera)}


@pytest.mark.parametrize("stages", [0, 6])
def test_arms_whose_words_cannot_be_listed_are_refused(stages):
    with pytest.raises(OptionError, match=f"--stages {stages}"):
        Options(stages=stages)
