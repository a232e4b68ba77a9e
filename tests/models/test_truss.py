"""The truss scene is as wide, as heavy and as still as it should be."""

import mujoco
import numpy as np
import pytest

from models.truss import MASTER, SLAVE, TRUSS, make_truss, settle_truss
from tests.models.scenes import warnings

ANGLES = np.array([0.0, 1.25668735, -1.38412868, -0.37255863])
"""Bring the grips to the segment's ends with its chord 0.27 m high."""


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return make_truss(0.27, ANGLES, 0.003, 0.02)


def test_segment_weighs_its_sheet_and_fits_the_mouth_with_3_percent(model):
    assert model.body("segment").mass[0] == pytest.approx(TRUSS.mass)
    near, far = model.geom("stage_near"), model.geom("stage_far")
    mouth = far.pos[1] - far.size[1] - near.pos[1] - near.size[1]
    width = 2.0 * model.geom("segment_web").size[1]
    assert mouth / width - 1.0 == pytest.approx(0.03)


def test_stage_is_at_the_given_pose(model):
    np.testing.assert_allclose(model.body("stage").pos, [0.0, 0.003, TRUSS.mouth_height])
    quaternion = model.body("stage").quat
    assert 2.0 * np.arctan2(quaternion[1], quaternion[0]) == pytest.approx(0.02)


def test_rovers_hold_the_segment_still_in_both_hands(model):
    data = settle_truss(model)
    mujoco.mj_step(model, data, 200)
    assert not warnings(data)
    assert np.abs(data.qvel).max() < 1e-3
    for robot in (MASTER, SLAVE):
        apart = data.site(f"{robot}/gripper").xpos - data.site(f"segment_{robot}").xpos
        assert np.linalg.norm(apart) < 3e-4
    assert data.body("segment").xpos[2] == pytest.approx(0.27 - TRUSS.grip_rise, abs=0.003)


def test_scene_of_numbers_that_are_none_is_refused():
    with pytest.raises(ValueError, match="four angles"):
        make_truss(0.27, ANGLES[:3], 0.0, 0.0)
    with pytest.raises(ValueError, match="finite"):
        make_truss(np.nan, ANGLES, 0.0, 0.0)
