"""Limits of a motion, against plain steps of MuJoCo."""

import dataclasses

import mujoco
import numpy as np
import pytest

from tests.experiments.own import hidden
from twin.prediction.limits import Limits, read_limits
from twin.prediction.parameters import ModelError

FREE = Limits({}, {}, {}, {}, {})


def model_of(name):
    return mujoco.MjModel.from_xml_path(hidden.robot(name))


def stepped(model, controls):
    """Places, rates, forces and the foot's place at each step, after settling."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = controls[0]
    mujoco.mj_step(model, data, round(2.0 / model.opt.timestep))
    rows = [(data.qpos.copy(), data.qvel.copy(), data.actuator_force.copy())]
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(model, data)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.actuator_force.copy()))
    return [np.array(each) for each in zip(*rows, strict=True)]


def swing(model, size, count=400):
    wave = np.sin(np.linspace(0.0, 6.0, count)) * np.linspace(0.0, 1.0, count)
    return model.key_ctrl[0] + size * np.outer(wave, np.ones(model.nu))


def test_excess_is_that_of_plain_steps():
    model = model_of("leg")
    controls = swing(model, 0.2)
    places, rates, forces = stepped(model, controls)
    knee = places[:, 2]
    low, high = -1.6, -0.7
    share = max((knee.max() - knee[0]) / (high - knee[0]), (knee[0] - knee.min()) / (knee[0] - low))
    found = dataclasses.replace(FREE, positions={"knee": (low, high)}).excess(model, controls)
    assert found == pytest.approx(share, rel=1e-9)
    found = dataclasses.replace(FREE, rates={"hip": 0.5}).excess(model, controls)
    assert found == pytest.approx(np.abs(rates[:, 1]).max() / 0.5, rel=1e-9)
    found = dataclasses.replace(FREE, forces={"hip": 3.0}).excess(model, controls)
    assert found == pytest.approx(np.abs(forces[:, 1]).max() / 3.0, rel=0.02)
    found = dataclasses.replace(FREE, commands={"hip": (0.0, 0.8)}).excess(model, controls)
    hip = controls[:, 1]
    assert found == pytest.approx(max((hip.max() - 0.5) / 0.3, (0.5 - hip.min()) / 0.5))


def test_a_motion_that_touches_or_starts_beyond_a_limit_is_out():
    model = model_of("leg")
    down = np.linspace(model.key_ctrl[0], [0.0, 0.0, -0.02], 500)  # the foot meets the plate
    assert FREE.excess(model, down) == np.inf
    assert dataclasses.replace(FREE, contacts=True).excess(model, down) == 0.0
    still = np.tile(model.key_ctrl[0], (100, 1))
    beyond = dataclasses.replace(FREE, positions={"knee": (-0.5, 0.0)})
    assert beyond.excess(model, still) == np.inf
    assert FREE.excess(model, still) == 0.0


def test_site_keeps_within_a_box():
    model = model_of("cart")
    controls = 5.0 * np.sin(np.linspace(0.0, 6.0, 500))[:, None]
    wide = dataclasses.replace(FREE, sites={"end": (np.full(3, -9.0), np.full(3, 9.0))})
    narrow = dataclasses.replace(
        FREE, sites={"end": (np.array([-0.01, -9, 0]), np.array([0.01, 9, 9]))}
    )
    assert wide.excess(model, controls) < 0.2 < 1.0 < narrow.excess(model, controls)


def test_limits_of_a_file_are_added_to_the_models_own(tmp_path):
    path, model = tmp_path / "limits.toml", model_of("cart")
    path.write_text(
        "contacts = true\n[joints.root]\nposition = [-0.5, 0.5]\nrate = 3\n"
        "[actuators.push]\nforce = 9\n[sites.end]\nlow = [-1, -1, 0]\nhigh = [1, 1, 2]\n"
    )
    found = read_limits(path, model)
    assert found.positions == {"rail": (-0.8, 0.8), "root": (-0.5, 0.5)}
    assert (found.rates, found.forces, found.contacts) == ({"root": 3.0}, {"push": 9.0}, True)
    assert found.commands == {"push": (-30.0, 30.0)}
    np.testing.assert_array_equal(found.sites["end"], [[-1, -1, 0], [1, 1, 2]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[joint.root]\nrate = 1", "unknown entry joint; there are contacts, joints"),
        ("[joints.elbow]\nrate = 1", "joints.elbow: not in the model; there are rail, root"),
        ("[joints.root]\nspeed = 1", "joints.root: expected some of position, rate"),
        ("[joints.root]\nrate = -1", "joints.root: expected a number above 0"),
        ("[joints.root]\nposition = [1, 0]", "joints.root: expected .lowest, highest."),
        ("[sites.end]\nlow = [1, 0]", "sites.end: low and high are x, y and z"),
        ("contacts = 3", "contacts is true or false"),
    ],
)
def test_bad_limits_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(ModelError, match=message) as caught:
        read_limits(path, model_of("cart"))
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
