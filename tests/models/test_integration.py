"""The accelerations that MuJoCo's sensors show are those that move the robot."""

import mujoco
import numpy as np
import pytest

from models.compose import FOLDER, RobotPlacement
from tests.models.scenes import make_scene


def test_accelerations_of_a_rover_under_its_swinging_arm_are_those_of_its_motion():
    """An implicit integrator solves for other ones than the sensors show, by 3 to 5 %."""
    scene = make_scene(RobotPlacement())
    data, step = scene.start(), scene.model.opt.timestep
    shoulder, hold = scene.model.actuator("rover1/shoulder").id, scene.rest.ctrl.copy()
    shown, moved = [], []
    for tick in range(600):
        data.ctrl[:] = hold
        data.ctrl[shoulder] += 4.0 * np.sin(2.0 * np.pi * tick * step)
        before = data.qvel.copy()
        mujoco.mj_step(scene.model, data)
        shown.append(data.qacc.copy())
        moved.append((data.qvel - before) / step)
    shown, moved = np.array(shown), np.array(moved)
    assert np.std(shown[:, 3]) > 0.5
    np.testing.assert_allclose(shown, moved, atol=1e-6 * np.abs(shown).max())


@pytest.mark.parametrize("part", ["rover", "arm", "field"])
def test_parts_alone_are_integrated_as_in_a_scene(part):
    model = mujoco.MjModel.from_xml_path(str(FOLDER / part / f"{part}.xml"))
    scene = make_scene(RobotPlacement()).model
    assert model.opt.integrator == scene.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    undamped = int(mujoco.mjtDisableBit.mjDSBL_EULERDAMP)
    assert model.opt.disableflags & undamped and scene.opt.disableflags & undamped
