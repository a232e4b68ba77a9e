"""The reduced suspension against pushes on the compiled rover."""

import mujoco
import numpy as np
import pytest

from experiments.appa.control.plant import PLAIN
from models.compose import RobotPlacement, make_model, settle
from models.datasheets import ROVER
from tests.models.suspension import Corner, reduce_suspension

TYRE = 3.1e6  # of one contact [N/m], README of the rover


def corners():
    """The rover's: the springs hold up, the braked wheels roll and so hold nothing forward."""
    return [
        Corner((x * ROVER.half_track, y * ROVER.half_wheelbase, -ROVER.centre_height),
               (0.0, 0.0, ROVER.spring), (0.0, 0.0, TYRE))
        for x in (-1, 1) for y in (-1, 1)
    ]  # fmt: skip


def test_reduced_suspension_is_what_pushing_the_compiled_rover_shows():
    model = make_model(PLAIN, [RobotPlacement("rover1", arm=False)])
    rest, body = settle(model), model.body("rover1/chassis").id
    reduced = reduce_suspension(corners())
    weight = ROVER.sprung_mass * 9.81 * (ROVER.sprung_height - ROVER.wheel_radius)

    def moved(force, couple):
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, rest)
        data.xfrc_applied[body] = [0.0, 0.0, force, couple, 0.0, 0.0]
        mujoco.mj_step(model, data, 1500)
        pitch = np.arcsin(data.xmat[body, 7]) - np.arcsin(rest.xmat[body, 7])
        return data.xpos[body, 2] - rest.xpos[body, 2], pitch

    assert -10.0 / moved(-10.0, 0.0)[0] == pytest.approx(reduced[2, 2], rel=0.01)
    assert 3.0 / moved(0.0, 3.0)[1] == pytest.approx(reduced[3, 3] - weight, rel=0.01)


def test_off_centre_push_tilts_and_rigid_corners_are_refused():
    moved = reduce_suspension(corners(), about=(0.0, 0.05, 0.0))
    assert moved[2, 3] == pytest.approx(-0.05 * moved[2, 2])
    rigid = Corner((0.0, 0.0, 0.0), (np.inf,) * 3, (np.inf,) * 3)
    with pytest.raises(ValueError, match="both rigid"):
        reduce_suspension([rigid])
    with pytest.raises(ValueError, match="three numbers >= 0"):
        Corner((0.0, 0.0, 0.0), (1.0, 1.0, -1.0), (1.0, 1.0, 1.0))
