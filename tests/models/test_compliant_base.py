"""The compiled plant of chapter 2 carries Table 2-1's values, rests, and reads what it should."""

import mujoco
import numpy as np
import pytest

from models.compliant_base.build import XML, compile_plant
from models.datasheets import ROD_ARM, TABLE_2_1_TRUTH
from perception.geometry.gravity import GRAVITY

AXIS, ROTATION = np.array([1.0, 0.0, 0.0]), np.eye(3)
DOFS = ("x", "y", "z", "pitch", "roll", "yaw")
OTHER = dict(TABLE_2_1_TRUTH) | {
    "mass": 7.5, "ixx": 0.5, "iyy": 0.4, "izz": 0.3, "ixz": 0.05, "ixy": -0.04, "iyz": 0.02,
    "rx": -0.1, "ry": 0.05, "rz": 0.2, "bz": 40.0, "k_yaw": 123.0,
}  # fmt: skip


def check(model: mujoco.MjModel, values) -> None:
    base = model.body("base")
    assert base.mass[0] == pytest.approx(values["mass"])
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, base.iquat)
    turn = turn.reshape(3, 3)
    tensor = turn @ np.diag(base.inertia) @ turn.T
    names = [["ixx", "ixy", "ixz"], ["ixy", "iyy", "iyz"], ["ixz", "iyz", "izz"]]
    expected = [[values[name] for name in row] for row in names]
    np.testing.assert_allclose(tensor, expected, atol=1e-9)
    np.testing.assert_allclose(base.ipos, 0)
    np.testing.assert_allclose(model.body("arm").pos, [values[n] for n in ("rx", "ry", "rz")])
    for dof in DOFS:
        joint = model.joint(f"{dof}_joint")
        suffix = dof if len(dof) == 1 else f"_{dof}"
        stiffness = model.jnt_stiffness[joint.id].flat[0]
        damping = model.dof_damping[joint.dofadr[0]].flat[0]
        assert stiffness == pytest.approx(values[f"k{suffix}"]), dof
        assert damping == pytest.approx(values[f"b{suffix}"]), dof


def test_model_file_holds_the_values_of_table_2_1():
    check(mujoco.MjModel.from_xml_path(str(XML)), TABLE_2_1_TRUTH)


@pytest.mark.parametrize("values", [TABLE_2_1_TRUTH, OTHER], ids=["table 2-1", "another"])
@pytest.mark.parametrize("hinges_outermost", [False, True])
def test_compiled_plant_has_the_values_asked_for(values, hinges_outermost):
    model = compile_plant(values, AXIS, ROTATION, hinges_outermost)
    check(model, values)
    order = [model.joint(j).name for j in range(6)]
    expected = [f"{dof}_joint" for dof in DOFS]
    assert order == (expected[3:] + expected[:3] if hinges_outermost else expected)


def test_arm_is_the_rod_of_the_simulation_study():
    model = mujoco.MjModel.from_xml_path(str(XML))
    arm = model.body("arm")
    assert arm.mass[0] == ROD_ARM.mass
    moments = (ROD_ARM.ixx, ROD_ARM.iyy, ROD_ARM.izz)
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, arm.iquat)
    turn = turn.reshape(3, 3)
    np.testing.assert_allclose(turn @ np.diag(arm.inertia) @ turn.T, np.diag(moments), atol=1e-12)
    np.testing.assert_allclose(arm.ipos, [0, ROD_ARM.centre, 0])
    # A slender rod of this inertia is 0.49 m long.
    assert np.sqrt(12 * ROD_ARM.ixx / ROD_ARM.mass) == pytest.approx(2 * ROD_ARM.centre, rel=1e-3)


def test_integrator_is_rk4_at_half_a_millisecond_and_gravity_that_of_the_datasheets():
    model = mujoco.MjModel.from_xml_path(str(XML))
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert model.opt.timestep == 5e-4
    np.testing.assert_allclose(model.opt.gravity, [0, 0, -GRAVITY])


def loaded(values, angle: float) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The plant with its springs loaded so that it rests with the arm at `angle`."""
    model = compile_plant(values, AXIS, ROTATION)
    data = mujoco.MjData(model)
    data.qpos[6] = angle
    mujoco.mj_forward(model, data)
    data.qfrc_applied[:] = data.qfrc_bias
    return model, data


@pytest.mark.parametrize("values", [TABLE_2_1_TRUTH, OTHER], ids=["table 2-1", "another"])
def test_plant_with_loaded_springs_stays_at_rest(values):
    model, data = loaded(values, np.pi / 4)
    mujoco.mj_step(model, data, nstep=2000)
    assert np.abs(data.qpos[:6]).max() < 1e-9
    assert data.qpos[6] == pytest.approx(np.pi / 4, abs=1e-9)
    assert all(warning.number == 0 for warning in data.warning)


def test_force_sensor_reads_the_arms_weight_upward_at_rest_and_its_moment():
    model, data = loaded(TABLE_2_1_TRUTH, np.pi / 4)
    mujoco.mj_forward(model, data)
    c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
    to_base = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    force, moment = data.sensordata.reshape(2, 3) @ to_base.T
    weight = ROD_ARM.mass * GRAVITY
    np.testing.assert_allclose(force, [0, 0, weight], atol=1e-9)
    np.testing.assert_allclose(moment, [ROD_ARM.centre * c * weight, 0, 0], atol=1e-9)


def test_unloaded_springs_sag_by_weight_over_stiffness():
    model = compile_plant(TABLE_2_1_TRUTH, AXIS, ROTATION)
    data = mujoco.MjData(model)
    data.qpos[6] = np.pi / 4
    data.qfrc_applied[6] = 0.245 * np.cos(np.pi / 4) * GRAVITY
    mujoco.mj_step(model, data, nstep=20000)
    assert data.qpos[2] == pytest.approx(-4 * GRAVITY / 500, rel=1e-3)


def test_compliance_has_time_constants_below_a_millisecond():
    p = TABLE_2_1_TRUTH
    shortest = [p["ixx"] / p["b_pitch"], p["iyy"] / p["b_roll"], p["izz"] / p["b_yaw"]]
    assert 3e-4 < min(shortest) < max(shortest) < 1e-3


def test_plant_driven_with_noise_for_a_second_gives_no_warning():
    model, data = loaded(TABLE_2_1_TRUTH, np.pi / 4)
    generator = np.random.default_rng(0)
    for _ in range(200):
        data.ctrl[0] = generator.uniform(-500, 500)
        mujoco.mj_step(model, data, nstep=10)
    assert np.all(np.isfinite(data.qpos))
    assert all(warning.number == 0 for warning in data.warning)
