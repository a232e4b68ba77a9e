"""A robot as made: within its tolerances, physically possible, and its drawing where told so."""

import dataclasses

import mujoco
import numpy as np
import pytest

from models.as_made import AsMade, Change, alter_arm
from models.compose import (
    ARM_JOINTS,
    LABORATORY,
    WHEELS,
    FieldConfig,
    RobotPlacement,
    build_scene,
    load_part,
    make_model,
)
from models.datasheets import ARM_MOTOR, EXACT, HARSH_TOLERANCES, ROVER, TOLERANCES
from tests.models.scenes import PLAIN, Scene, make_scene, settle, warnings

SEEDS = range(25)
WHEEL_BODIES = [f"rover1/{wheel}_wheel" for wheel in WHEELS]


def rover(made=None, **changes):
    return make_model(PLAIN, [RobotPlacement(made=made, **changes)])


@pytest.fixture(scope="module")
def drawn():
    return rover()


@pytest.fixture(scope="module")
def made():
    return [rover(AsMade(seed)) for seed in SEEDS]


def arrays(model):
    """Return every array of a compiled model, by name."""
    values = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}


def test_robot_without_tolerances_is_its_drawing_bit_for_bit(drawn):
    exact = arrays(rover(AsMade(7, EXACT)))
    for name, value in arrays(drawn).items():
        np.testing.assert_array_equal(exact[name], value, name)


def check_drawn(values, low, high):
    """Hold draws to their range, and to filling it as uniform ones of this number do."""
    values = np.ravel(values)
    assert len(values) >= 25
    span = high - low
    assert np.all((values >= low - 1e-9) & (values <= high + 1e-9))
    # That 25 uniform draws leave 42 % of the range empty at an end: 3 in a million.
    assert values.min() < low + span / 2.4 and values.max() > high - span / 2.4
    assert len(np.unique(values)) == len(values)


def ratio(models, drawn, read):
    return np.array([read(model) for model in models]) / read(drawn)


def suspensions(model):
    return [model.joint(f"rover1/{wheel}_suspension_joint") for wheel in WHEELS]


def test_springs_and_dampers_are_each_within_thirty_percent(made, drawn):
    def springs(model):
        return np.array([model.jnt_stiffness[joint.id] for joint in suspensions(model)])

    def dampers(model):
        return np.array([model.dof_damping[joint.dofadr[0]] for joint in suspensions(model)])

    check_drawn(ratio(made, drawn, springs), 0.7, 1.3)
    check_drawn(ratio(made, drawn, dampers), 0.7, 1.3)


def test_masses_are_within_five_percent_and_inertias_go_with_them(made, drawn):
    masses = ratio(made, drawn, lambda model: model.body_mass[1:])
    check_drawn(masses, 0.95, 1.05)
    inertias = ratio(made, drawn, lambda model: model.body_inertia[1:])
    np.testing.assert_allclose(inertias, np.repeat(masses[..., None], 3, axis=2), rtol=1e-9)


def test_inertias_are_those_of_real_bodies(made):
    for model in (*made, *(rover(AsMade(seed, HARSH_TOLERANCES)) for seed in range(5))):
        a, b, c = np.sort(model.body_inertia[1:], axis=1).T
        assert np.all(a > 0.0) and np.all(a + b >= c * (1.0 - 1e-9))
        # All of the robot as one body, about its centre of gravity.
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        levers = data.xipos[1:] - data.subtree_com[1]
        turns = data.ximat[1:].reshape(-1, 3, 3)
        total = np.einsum("nij,nj,nkj->ik", turns, model.body_inertia[1:], turns)
        squares = np.einsum("n,ni,nj->ij", model.body_mass[1:], levers, levers)
        total += np.trace(squares) * np.eye(3) - squares
        a, b, c = np.linalg.eigvalsh(total)
        assert a > 0.0 and a + b > c


def test_centres_of_gravity_are_within_ten_millimetres_but_wheels_are_balanced(made, drawn):
    wheels = [drawn.body(name).id for name in WHEEL_BODIES]
    others = [body for body in range(1, drawn.nbody) if body not in wheels]
    shifts = np.array([model.body_ipos - drawn.body_ipos for model in made])
    check_drawn(shifts[:, others], -0.01, 0.01)
    np.testing.assert_array_equal(shifts[:, wheels], 0.0)


def test_wheels_arm_and_joints_are_within_two_millimetres_of_their_places(made, drawn):
    names = [*WHEEL_BODIES, *(f"rover1/{b}" for b in ("arm_base_link", "turret", "upper_arm"))]
    names += ["rover1/forearm", "rover1/wrist"]
    bodies = [drawn.body(name).id for name in names]
    check_drawn([model.body_pos[bodies] - drawn.body_pos[bodies] for model in made], -2e-3, 2e-3)
    fixed = drawn.body("rover1/stereo_head").id, drawn.body("rover1/rear_chassis").id
    for model in made:
        np.testing.assert_array_equal(model.body_pos[fixed, :], drawn.body_pos[fixed, :])


def test_each_wheel_has_its_own_radius_and_a_robot_its_own_tyres(made):
    tyres = [[model.geom(f"rover1/{wheel}_tyre") for wheel in WHEELS] for model in made]
    radii = np.array([[tyre.size[1] for tyre in four] for four in tyres])
    check_drawn(radii / ROVER.wheel_radius, 0.98, 1.02)
    np.testing.assert_array_equal(radii, [[tyre.size[2] for tyre in four] for four in tyres])
    friction = np.array([[tyre.friction[0] for tyre in four] for four in tyres])
    check_drawn(friction[:, 0], 0.3, 0.8)
    np.testing.assert_array_equal(friction, np.repeat(friction[:, :1], 4, axis=1))


def test_gears_of_the_arm_have_their_own_friction_and_play(made):
    friction = [
        [model.dof_frictionloss[model.joint(f"rover1/{n}_joint").dofadr[0]] for n in ARM_JOINTS]
        for model in made
    ]
    check_drawn(np.array(friction) / ARM_MOTOR.friction, 0.7, 1.3)
    plays = [[model.joint(f"rover1/{name}_play").range for name in ARM_JOINTS] for model in made]
    plays = np.array(plays)
    check_drawn(plays[..., 1] - plays[..., 0], *TOLERANCES.backlash)
    np.testing.assert_allclose(plays.sum(axis=2), 0.0, atol=1e-12)


def test_two_robots_of_a_scene_are_unlike_and_a_seed_makes_the_same_again():
    places = [RobotPlacement(made=AsMade(1)), RobotPlacement("rover2", (1.0, 0.0), made=AsMade(2))]
    first, again = make_model(PLAIN, places), make_model(PLAIN, places)
    for name, value in arrays(first).items():
        np.testing.assert_array_equal(getattr(again, name), value, name)
    for name in ("chassis", "wrist", "front_left_wheel"):
        assert first.body(f"rover1/{name}").mass != first.body(f"rover2/{name}").mass


def test_a_rover_is_the_same_with_and_without_its_arm():
    with_arm, bare = rover(AsMade(3)), rover(AsMade(3), arm=False)
    for name in ("chassis", "rear_chassis", *(f"{wheel}_wheel" for wheel in WHEELS)):
        one, other = with_arm.body(f"rover1/{name}"), bare.body(f"rover1/{name}")
        np.testing.assert_array_equal(one.mass, other.mass)
        np.testing.assert_array_equal(one.ipos, other.ipos)
        np.testing.assert_array_equal(one.pos, other.pos)
    for one, other in zip(suspensions(with_arm), suspensions(bare)):
        assert with_arm.jnt_stiffness[one.id] == bare.jnt_stiffness[other.id]


def test_known_friction_of_the_ground_holds_for_every_robot():
    def friction(field, made):
        return make_model(field, [RobotPlacement(made=made)]).geom("rover1/rear_left_tyre").friction

    plain = dataclasses.replace(LABORATORY, texture_pixels=16)
    assert friction(plain, AsMade(5))[0] == ROVER.tyre_friction
    assert friction(dataclasses.replace(plain, friction=0.45), AsMade(5))[0] == 0.45
    assert friction(PLAIN, None)[0] == ROVER.tyre_friction
    assert friction(PLAIN, AsMade(5))[0] != ROVER.tyre_friction


@pytest.mark.parametrize("seed", range(4))
def test_robot_as_made_settles_on_its_wheels_and_keeps_still(seed):
    for tolerances in (TOLERANCES, HARSH_TOLERANCES):
        model = rover(AsMade(seed, tolerances))
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        assert data.ncon == 0 or np.min(data.contact.dist) > -1e-4
        scene = Scene(model, settle(model))
        touching = {model.geom(int(geom)).name for geom in np.ravel(scene.rest.contact.geom)}
        assert touching == {"ground", *(f"rover1/{wheel}_tyre" for wheel in WHEELS)}
        data = scene.run(scene.start(), 1.0)
        assert np.abs(data.qvel).max() < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_driven_with_noise_it_gives_no_warning(seed):
    scene = make_scene(RobotPlacement(made=AsMade(seed)))
    data, rng = scene.start(), np.random.default_rng(seed)
    for _ in range(100):
        data.ctrl[:] = rng.uniform(-6.0, 6.0, scene.model.nu)
        mujoco.mj_step(scene.model, data, 10)
    assert not warnings(data)
    # Teeth yield by half a degree at most, with motors that turn about a hundred times a second.
    for name in ARM_JOINTS:
        joint = scene.model.joint(f"rover1/{name}_play")
        assert abs(data.joint(joint.name).qpos[0]) < joint.range[1] + np.deg2rad(0.5)


def gear(backlash):
    """The arm's turret alone on its motor, without gravity."""
    arm = load_part("arm")
    tolerances = dataclasses.replace(EXACT, backlash=(backlash, backlash))
    alter_arm(arm, AsMade(0, tolerances))
    arm.option.gravity = [0.0, 0.0, 0.0]
    model = arm.compile()
    return model, mujoco.MjData(model)


def test_link_stays_for_the_backlash_when_its_motor_turns_back():
    backlash = np.deg2rad(1.0)
    model, data = gear(backlash)
    motor, play = data.joint("base_yaw_joint"), data.joint("base_yaw_play")
    dofs = [model.joint(f"base_yaw_{kind}").dofadr[0] for kind in ("joint", "play")]
    angles = []
    for step in range(2000):
        data.actuator("base_yaw").ctrl = 1.0 if step < 1000 else -1.0
        # The link moves in tar: it follows its motor, and goes nowhere by itself.
        data.qfrc_applied[dofs] = -2.0 * (motor.qvel[0] + play.qvel[0])
        mujoco.mj_step(model, data)
        angles.append((motor.qpos[0], motor.qpos[0] + play.qpos[0]))
    turned, link = np.array(angles).T
    back = int(np.argmax(turned))
    assert back >= 1000
    assert play.qpos[0] == pytest.approx(backlash / 2.0, rel=0.1)
    assert turned[back] - link[back] == pytest.approx(backlash / 2.0, rel=0.1)
    crossed = back + int(np.argmax(turned[back:] < turned[back] - 0.9 * backlash))
    assert abs(link[crossed] - link[back]) < 0.1 * backlash
    assert link[-1] < link[back] - 5.0 * backlash
    mujoco.mj_forward(model, data)
    assert data.sensor("base_yaw_pos").data == motor.qpos  # the encoder is on the motor's side


def test_gravity_decides_on_which_tooth_a_link_rests():
    """The encoder is on the motor's side: it does not see on which."""
    backlash = np.deg2rad(0.8)
    tolerances = dataclasses.replace(EXACT, backlash=(backlash, backlash))
    model = rover(AsMade(0, tolerances))
    held = {}
    for pose, shoulder in {"ahead": 0.9, "behind": 2.2}.items():
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.joint("rover1/shoulder_joint").qpos = shoulder
        data.joint("rover1/elbow_joint").qpos = 0.0
        # Held by its brake.
        model.dof_frictionloss[model.joint("rover1/shoulder_joint").dofadr] = 20.0
        mujoco.mj_step(model, data, 1500)
        held[pose] = data.joint("rover1/shoulder_play").qpos[0]
    assert held["ahead"] == pytest.approx(-backlash / 2.0, rel=0.05)
    assert held["behind"] == pytest.approx(backlash / 2.0, rel=0.05)


def test_impossible_ways_of_making_are_refused():
    with pytest.raises(ValueError, match="got -1, needs 0 or more"):
        AsMade(-1)
    with pytest.raises(ValueError, match="nothing but name, position and yaw"):
        RobotPlacement(model="mine.xml", made=AsMade(0))


def test_payload_is_a_box_on_the_rear_deck():
    made = AsMade(3, change=Change(payload=1.0, payload_place=(0.02, -0.1)))
    before, after = rover(dataclasses.replace(made, change=Change())), rover(made)
    assert after.body_mass.sum() - before.body_mass.sum() == pytest.approx(1.0)
    box = after.body("rover1/payload")
    assert after.body(box.parentid[0]).name == "rover1/rear_chassis"
    deck, half = after.geom("rover1/rear_deck"), after.geom_size[box.geomadr[0]]
    assert box.pos[2] - half[2] == pytest.approx(deck.pos[2] + deck.size[2])
    np.testing.assert_array_equal(box.pos[:2], (0.02, -0.1))
    sides = 2.0 * half
    about_x = (sides[1] ** 2 + sides[2] ** 2) / 12.0  # of a homogeneous box, per kg
    assert np.isclose(box.inertia, about_x).any()


def test_change_of_springs_and_of_a_tyre_leaves_all_else():
    made = AsMade(4, change=Change(springs=0.5, worn_wheel="rear_left", grip=0.5))
    before, after = rover(dataclasses.replace(made, change=Change())), rover(made)
    springs = [joint.id for joint in suspensions(before)]
    tyre = before.geom("rover1/rear_left_tyre").id
    assert after.geom_friction[tyre, 0] == pytest.approx(0.5 * before.geom_friction[tyre, 0])
    np.testing.assert_allclose(after.jnt_stiffness[springs], 0.5 * before.jnt_stiffness[springs])
    after.geom_friction[tyre, 0] = before.geom_friction[tyre, 0]
    after.jnt_stiffness[springs] = before.jnt_stiffness[springs]
    for name in ("body_mass", "body_ipos", "geom_size", "dof_damping", "geom_friction"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name), name)


def test_softer_springs_on_the_left_leave_those_on_the_right():
    made = AsMade(4, change=Change(left_springs=0.3))
    before, after = rover(dataclasses.replace(made, change=Change())), rover(made)
    for joint in suspensions(before):
        share = 0.3 if "left" in joint.name else 1.0
        stiffness = before.jnt_stiffness[joint.id]
        assert after.jnt_stiffness[joint.id] == pytest.approx(share * stiffness)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"springs": 0.0}, "change springs = 0.0"),
        ({"payload": -1.0}, "change payload = -1.0"),
        ({"payload": float("nan")}, "change payload = nan"),
    ],
)
def test_change_that_cannot_be_is_refused(fields, words):
    with pytest.raises(ValueError, match=words):
        Change(**fields)


@pytest.mark.parametrize("friction", [{"friction": 0.6}, {"friction_patches": (0.3, 0.8)}])
def test_a_worn_tyre_on_a_field_that_says_its_friction_is_refused(friction):
    made = AsMade(1, change=Change(worn_wheel="rear_left", grip=0.5))
    with pytest.raises(ValueError, match="'rover1' has a worn tyre"):
        build_scene(FieldConfig(**friction), [RobotPlacement(made=made)])


def test_wheel_that_no_rover_has_is_refused():
    with pytest.raises(ValueError, match="no wheel 'left'; available: front_left"):
        rover(AsMade(1, change=Change(worn_wheel="left", grip=0.5)))
