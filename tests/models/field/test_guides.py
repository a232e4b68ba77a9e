"""Card guides and connector: the snap by its arithmetic, the grooves by their clearances."""

import math

import mujoco
import numpy as np
import pytest

from models.card_and_slot.guides import build_guides_bench, width_of
from models.compose import FieldConfig, RobotPlacement, make_model
from models.datasheets import CARD_AND_SLOT, CARD_GUIDE

MEDIUM = CARD_GUIDE.clearances[1]
MOST_ROLL = math.asin(CARD_GUIDE.mouth / (CARD_AND_SLOT.card_width / 2.0))
"""At which a card's edges come to the mouths' edges [rad]."""


def insert(model, wrong=(0.0,) * 6, speed=0.005, begin=-0.015, end=0.043, stop=9.0):
    """Move the hand ahead; return forces on the card (N, 3) [N] and its places (N, 3) [m]."""
    data = mujoco.MjData(model)
    pose = np.array(wrong) + [0.0, begin, 0.0, 0.0, 0.0, 0.0]
    data.qpos[:6] = model.qpos_spring[:6] = pose
    data.qfrc_applied[1] = model.dof_damping[1] * speed
    forces, places = [], []
    while pose[1] < end and (not forces or np.linalg.norm(forces[-1]) < stop):
        pose[1] += speed * model.opt.timestep
        model.qpos_spring[:6] = pose
        mujoco.mj_step(model, data)
        forces.append(-data.sensordata[:3].copy())
        places.append(data.body("card").xpos.copy())
    assert all(warning.number == 0 for warning in data.warning)
    return np.array(forces), np.array(places)


def snap_force(friction):
    """Both springs, where the edge of the card first meets them: the normal leans ahead."""
    sheet = CARD_GUIDE
    sine = 1.0 - sheet.interference / sheet.spring_radius
    cosine = math.sqrt(1.0 - sine**2)
    normal = sheet.spring_force / (sine - friction * cosine)
    return 2.0 * normal * (cosine + friction * sine)


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.3, 0.5])
def test_the_card_snaps_in_at_the_force_of_the_springs_and_their_slopes(friction):
    forces, places = insert(build_guides_bench(MEDIUM, friction).compile(), speed=0.002, begin=0.03)
    before = places[:, 1] < CARD_GUIDE.depth - 1.5e-3
    assert -forces[before, 1].min() == pytest.approx(snap_force(friction), rel=0.08)
    # Then it slides between them, when the hand has come to rest, and the bottom stops it.
    inside = abs(places[:, 1] - CARD_GUIDE.depth + 3e-4) < 2e-4
    pressed = CARD_GUIDE.spring_force + CARD_GUIDE.spring_stiffness * CARD_GUIDE.interference
    assert np.median(-forces[inside, 1]) == pytest.approx(
        2.0 * friction * pressed, rel=0.3, abs=0.02
    )
    assert places[:, 1].max() == pytest.approx(CARD_GUIDE.depth, abs=1e-4)


def test_the_snap_as_drawn_is_3_newtons():
    assert snap_force(CARD_AND_SLOT.friction) == pytest.approx(CARD_GUIDE.snap, abs=0.02)


@pytest.mark.parametrize("clearance", CARD_GUIDE.clearances)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_groove_leaves_its_clearances(clearance, side):
    """A pushed card stops at the groove's walls, across and along the normal."""
    model = build_guides_bench(clearance, 0.0).compile()
    data = mujoco.MjData(model)
    data.qpos[1] = model.qpos_spring[1] = 0.03
    model.qpos_spring[[0, 2]] = side * 5e-3
    mujoco.mj_step(model, data, nstep=1000)
    across, _, beside = data.body("card").xpos
    assert across == pytest.approx(side * clearance, abs=1e-4)
    assert beside == pytest.approx(side * CARD_GUIDE.face_clearance, abs=1e-4)


@pytest.mark.parametrize(
    ("wrong", "enters"),
    [
        ((1.7e-3, 0, 0, 0, 0, 0), True),  # within clearance and lead-in
        ((1.9e-3, 0, 0, 0, 0, 0), False),
        ((0, 0, 5e-3, 0, 0, 0), True),  # along the normal
        ((0, 0, 9e-3, 0, 0, 0), False),
        ((0, 0, 0, 0, math.radians(8.0), 0), True),  # in roll
        ((0, 0, 0, 0, math.radians(9.5), 0), False),
        ((0, 0, 0, 0, MOST_ROLL - 0.003, 0), True),
        ((0, 0, 0, 0, MOST_ROLL + 0.003, 0), False),
    ],
)
def test_the_mouth_leads_in_what_lies_within_it(wrong, enters):
    _, places = insert(build_guides_bench(MEDIUM).compile(), wrong, speed=0.01)
    assert (places[:, 1].max() > 0.03) == enters


def test_the_gripper_gives_way_in_roll_and_along_the_normal_by_its_springs():
    model = build_guides_bench(MEDIUM).compile()
    data = mujoco.MjData(model)
    data.qpos[1] = model.qpos_spring[1] = -0.1
    load = {"card_normal": 1.5, "card_roll": 0.03}
    for name, value in load.items():
        data.qfrc_applied[model.joint(name).dofadr[0]] = value
    mujoco.mj_step(model, data, nstep=3000)
    assert data.joint("card_normal").qpos[0] == pytest.approx(1.5 / CARD_GUIDE.normal_stiffness)
    assert data.joint("card_roll").qpos[0] == pytest.approx(0.03 / CARD_GUIDE.roll_stiffness)


@pytest.mark.parametrize("name", ["card_slip", "card_normal", "card_roll"])
def test_a_rover_s_gripper_gives_way_as_that_of_the_bench(name):
    """An arm's body has defaults for the joints of its children."""
    bench = build_guides_bench(MEDIUM).compile()
    field = FieldConfig(texture_pixels=16, slot_width=width_of(MEDIUM), card_guides=True)
    rover = make_model(field, [RobotPlacement("rover2", (0.0, -1.5), card=True)])
    one, other = bench.joint(name), rover.joint(f"rover2/{name}")
    for what in ("stiffness", "damping", "armature", "frictionloss", "range", "axis", "solimp"):
        np.testing.assert_array_equal(getattr(one, what), getattr(other, what))
    np.testing.assert_array_equal(bench.body("card").mass, rover.body("rover2/card").mass)


@pytest.mark.parametrize(("push", "slips"), [(0.9, False), (1.1, True)])
def test_the_card_slips_in_the_gripper_beyond_its_grip_and_not_before(push, slips):
    model = build_guides_bench(MEDIUM).compile()
    data = mujoco.MjData(model)
    data.qpos[1] = model.qpos_spring[1] = -0.1
    data.qfrc_applied[model.joint("card_slip").dofadr[0]] = -push * CARD_GUIDE.grip
    mujoco.mj_step(model, data, nstep=1000)
    gone = -data.joint("card_slip").qpos[0]
    assert (gone > 0.01) == slips and (slips or gone < 2e-4)


@pytest.mark.parametrize("clearance", [0.0, -1e-3, math.nan, 3e-3])
def test_guides_that_would_not_hold_a_card_are_refused(clearance):
    with pytest.raises(ValueError, match="clearance"):
        build_guides_bench(clearance)
