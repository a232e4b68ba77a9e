"""BRAID carries the datasheet's numbers, its detents are double wells, its wires heat and cool."""

import mujoco
import numpy as np
import pytest

from controllers.braid.arm.flexure import MATERIALS, greatest_thickness, joint_angles, stiffness
from controllers.braid.arm.stage import RADIAL, StageGeometry
from models.braid.build import BENCH, TIMESTEP, BraidConfig, build_bench, build_rover
from models.compose import FLAT, RobotPlacement
from models.datasheets import BRAID, MUSCLE_WIRE

LEG = f"{BENCH}stage1_leg1"


@pytest.fixture(scope="module")
def stage() -> mujoco.MjModel:
    return build_bench(BraidConfig(1, head=False, flexures=False), gravity=False).compile()


def lifted(model: mujoco.MjModel, along: float) -> mujoco.MjData:
    """All three legs at a place from their middle [m]: the platform goes straight up."""
    data = mujoco.MjData(model)
    data.joint(f"{BENCH}stage1_z_joint").qpos = along
    for leg in (1, 2, 3):
        data.joint(f"{BENCH}stage1_leg{leg}_joint").qpos = along
    mujoco.mj_forward(model, data)
    return data


def test_detent_is_at_rest_at_both_lengths_and_its_greatest_force_is_the_barrier(stage):
    h = BRAID.half_stroke
    places = np.linspace(-1.2 * h, 1.2 * h, 481)
    up = []
    for place in places:
        data = lifted(stage, place)
        assert data.tendon(LEG).length == pytest.approx(BRAID.middle + place)
        up.append(float(data.joint(f"{BENCH}stage1_z_joint").qfrc_passive[0]) / 3.0)
    up = np.array(up)
    for rest in (-h, 0.0, h):
        assert abs(up[np.argmin(np.abs(places - rest))]) < 1e-9 * BRAID.barrier
    inside = np.abs(places) < h
    assert up[inside].max() == pytest.approx(BRAID.barrier, rel=1e-4)
    assert up[inside].min() == pytest.approx(-BRAID.barrier, rel=1e-4)


def test_feet_lie_on_the_circle_of_the_exact_kinematics(stage):
    data = lifted(stage, 0.0)
    for leg in range(3):
        foot = data.site(f"{BENCH}stage1_foot{leg + 1}").xpos
        end = data.site(f"{LEG[:-1]}{leg + 1}_end").xpos
        np.testing.assert_allclose(foot[:2], BRAID.radius * RADIAL[leg], atol=1e-12)
        np.testing.assert_allclose(end, foot, atol=1e-12)


def test_wire_takes_the_makers_times_to_heat_and_cool(stage):
    data = mujoco.MjData(stage)
    hot, cold = (
        MUSCLE_WIRE.austenite[1] - MUSCLE_WIRE.ambient,
        MUSCLE_WIRE.martensite_finish - MUSCLE_WIRE.ambient,
    )
    data.actuator(f"{LEG}_extend").ctrl = MUSCLE_WIRE.heating
    mujoco.mj_step(stage, data, nstep=round(MUSCLE_WIRE.heating_time / TIMESTEP))
    assert data.act[0] == pytest.approx(hot, rel=1e-6)
    data.ctrl[:] = 0.0
    mujoco.mj_step(stage, data, nstep=round(MUSCLE_WIRE.cooling_time / TIMESTEP))
    assert data.act[0] == pytest.approx(cold, rel=1e-6)


def test_wires_time_constant_is_that_of_its_metal_within_a_sixth():
    """The maker's times against the maker's heat capacity, which the model does not use."""
    area = np.pi / 4.0 * MUSCLE_WIRE.diameter**2
    capacity = MUSCLE_WIRE.density * area * MUSCLE_WIRE.specific_heat
    loss = MUSCLE_WIRE.current**2 * MUSCLE_WIRE.resistance / MUSCLE_WIRE.heating
    assert capacity / loss == pytest.approx(MUSCLE_WIRE.time_constant, rel=1.0 / 6.0)


@pytest.mark.parametrize(("end", "along"), [("extend", -1.0), ("retract", 1.0)])
def test_wires_only_pull_and_fall_slack_over_their_contraction(stage, end, along):
    data = lifted(stage, along * BRAID.half_stroke)
    index = stage.actuator(f"{LEG}_{end}").id
    start, finish = (t - MUSCLE_WIRE.ambient for t in MUSCLE_WIRE.austenite)
    strength = BRAID.strands * MUSCLE_WIRE.force
    slack = lifted(stage, -along * BRAID.half_stroke)
    for share in (-1.0, 0.0, 0.5, 1.0, 9.0):
        for where, level in ((data, share), (slack, share - 1.0)):
            where.act[index] = start + share * (finish - start)
            mujoco.mj_forward(stage, where)
            expected = strength * float(np.clip(level, 0.0, 1.0))
            assert where.actuator_force[index] == pytest.approx(expected, abs=1e-9)


def test_flexures_are_as_stiff_as_beams_and_bear_the_joints_angles():
    length, width, thickness = BRAID.flexure
    material = MATERIALS["ultra-high-molecular-weight polyethylene"]
    strip = stiffness(length, width, thickness, material)
    assert BRAID.flexure_stiffness == pytest.approx(strip)
    angles = joint_angles(StageGeometry(BRAID.radius, BRAID.short, BRAID.long))
    assert thickness < greatest_thickness(length, max(angles), material)
    model = build_bench(BraidConfig(1)).compile()
    hinge = model.joint(f"{LEG}_hinge_joint")
    assert hinge.stiffness[0] == pytest.approx(BRAID.flexure_stiffness)


def test_mechanism_shaken_by_all_wires_for_a_second_gives_no_warning():
    model = build_bench(BraidConfig(3)).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    rng = np.random.default_rng(0)
    for _ in range(100):
        data.ctrl[:] = rng.uniform(0.0, MUSCLE_WIRE.heating, model.nu)
        mujoco.mj_step(model, data, nstep=10)
    assert np.all(np.isfinite(data.qpos))
    assert all(warning.number == 0 for warning in data.warning)


def test_braid_on_a_rover_is_upright_with_the_stereo_head_at_its_tip():
    model = build_rover(BraidConfig(2), FLAT, RobotPlacement()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    base, tip = data.site("rover1/braid_base").xpos, data.site("rover1/tip").xpos
    np.testing.assert_allclose(tip - base, [0.0, 0.0, 2.0 * BRAID.short], atol=1e-9)
    centre = data.site("rover1/stereo_centre").xpos - tip
    np.testing.assert_allclose(centre[:2], [0.0, 0.0305], atol=1e-9)
    assert model.camera("rover1/stereo_left").id >= 0
    mujoco.mj_step(model, data, nstep=1000)
    legs = [data.tendon(f"rover1/stage{k}_leg{j}").length for k in (1, 2) for j in (1, 2, 3)]
    np.testing.assert_allclose(legs, BRAID.short, atol=2e-3)
    assert all(warning.number == 0 for warning in data.warning)


@pytest.mark.parametrize("stages", [0, 21])
def test_no_stages_or_too_many_are_refused(stages):
    with pytest.raises(ValueError, match=f"stages {stages}: expected 1 to 20"):
        BraidConfig(stages)
