"""Looking ahead: the reduced model against MuJoCo and closed forms, and what is made of it."""

import dataclasses
import math

import mujoco
import numpy as np
import pytest

from controllers.kinematics.rigid_motion import at_rest
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.tipping.look_ahead import PERIOD, TIPPED, Doubt, LookAhead, Plan, slow
from controllers.motion.tipping.rocking import rock
from controllers.motion.tipping.tip_over import Sweep
from models.compose import FieldConfig, PayloadConfig, RobotPlacement, build_scene
from perception.geometry.gravity import GRAVITY
from twin.describe import describe, describe_rover

ROBOT = "rover1"
DRAWN = describe_rover(ROBOT)
HOME = DRAWN.arm.home
FRICTION = 0.55
KP, KV = 1000.0, 40.0
SURE = Doubt(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def resting(angles, seconds=1.0):
    return Plan.of_drive(np.asarray(angles), np.zeros((round(seconds / PERIOD), 2)))


def sideways(angle):
    """The base at rest, its right side lower by an angle [rad]."""
    return at_rest([-math.sin(angle), 0.0, math.cos(angle)])


def rocked(ahead, plan, still):
    """Heave, pitch, roll, heading and centre joint (copies, times, 5)."""
    copies = ahead._copies(np.random.default_rng(0), still.specific_force / GRAVITY)
    return rock(ahead._chassis, copies, ahead._moving(plan))[0]


def mujocos(rover, load, plan, slope=(0.0, 0.0)):
    """Pitch, roll and centre joint (n, 3) of MuJoCo's rover as drawn, with its wheels braked."""
    field = FieldConfig(texture_pixels=16, friction=FRICTION, slope=slope)
    scene = build_scene(field, [with_load(load)])
    for actuator in list(scene.actuators):
        scene.delete(actuator)
    for key in list(scene.keys):
        scene.delete(key)
    for name in rover.wheel_names:
        scene.joint(f"{ROBOT}/{name}_joint").frictionloss = 100.0
    for name in rover.joint_names:
        held = scene.add_actuator(name=name, target=f"{ROBOT}/{name}_joint")
        held.trntype = mujoco.mjtTrn.mjTRN_JOINT
        held.set_to_position(kp=KP, kv=KV)
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = scene.compile()
    data = mujoco.MjData(model)
    data.qpos[[model.joint(f"{ROBOT}/{name}_joint").qposadr[0] for name in rover.joint_names]] = (
        plan.angles[0]
    )
    data.ctrl[:] = plan.angles[0]
    mujoco.mj_step(model, data, round(1.5 / model.opt.timestep))
    chassis = model.body(f"{ROBOT}/chassis").id
    tilts = []
    for angles, rates in zip(plan.angles, plan.rates):
        # A servo's force is kp (control - angle) - kv rate.
        data.ctrl[:] = angles + KV / KP * rates
        mujoco.mj_step(model, data, round(PERIOD / model.opt.timestep))
        axes = data.xmat[chassis].reshape(3, 3)
        centre = data.joint(f"{ROBOT}/centre_joint").qpos[0]
        tilts.append([math.asin(axes[2, 1]), -math.atan2(axes[2, 0], axes[2, 2]), centre])
    return np.array(tilts)


def with_load(load):
    return RobotPlacement(ROBOT, payload=PayloadConfig(load), stereo=False)


def loaded(load):
    model = build_scene(FieldConfig(texture_pixels=16), [with_load(load)]).compile()
    return describe(model, ROBOT)


@pytest.mark.parametrize(
    ("change", "seconds", "load", "within", "error"),
    [
        ([0.0, -0.7, 1.2, 0.0], 0.5, 0.3, 1.5, 0.05),
        # To the side, slowly: the halves stay together, as tyres do not slide.
        ([0.6, 0.3, 1.3, 0.0], 2.5, 0.3, 2.5, 0.25),
        # Wheels lift.
        ([1.8, 0.2, 1.4, -0.2], 0.7, 0.34, 0.5, 0.7),
    ],
    ids=["ahead", "slowly aside", "wheels lift"],
)
def test_a_rover_rocks_as_mujocos_does(change, seconds, load, within, error):
    rover = loaded(load)
    plan = Plan.of_arm(Sweep(HOME, HOME + change, seconds).at, within)
    expected = np.degrees(mujocos(rover, load, plan))
    ahead = LookAhead(rover, friction=(FRICTION, FRICTION), doubt=SURE, copies=1)
    found = np.degrees(rocked(ahead, plan, at_rest())[0][:, [1, 2, 4]])
    np.testing.assert_allclose(found, expected, atol=error)
    assert np.ptp(expected, axis=0).max() > 0.3  # noqa: PLR2004


@pytest.mark.parametrize(("seconds", "over"), [(0.5, True), (2.0, False)])
def test_a_swing_tips_a_rover_over_when_it_is_too_fast(seconds, over):
    rover, load = loaded(0.8), 0.8
    plan = Plan.of_arm(Sweep(HOME, HOME + [1.0, -0.5, 1.2, 0.0], seconds).at, 3.0)
    tilts = np.abs(mujocos(rover, load, plan)[:, :2]).max(axis=1)
    assert (tilts.max() > TIPPED) == over
    found = LookAhead(rover, friction=(0.5, 0.6)).outlook(plan, np.random.default_rng(1))
    assert (found.tip() > 0.5) == over  # noqa: PLR2004
    if over:
        first = np.argmax(tilts > TIPPED) * PERIOD
        assert np.median(found.tips) == pytest.approx(first, abs=0.1)


def test_a_load_known_apart_counts_as_one_that_the_drawing_has():
    plan = Plan.of_arm(Sweep(HOME, HOME + [1.0, -0.2, 0.6, 0.1], 0.7).at, 1.0)
    within = LookAhead(loaded(0.4), doubt=SURE, copies=1)
    beside = LookAhead(loaded(1e-6), 0.4, np.array([0.0, 0.12, 0.0]), doubt=SURE, copies=1)
    found = rocked(beside, plan, at_rest())
    # A box of 4 cm has some inertia of its own.
    np.testing.assert_allclose(found, rocked(within, plan, at_rest()), atol=1e-4)


def test_at_rest_it_tips_where_the_centre_of_mass_leaves_the_wheels():
    rover = loaded(0.5)
    chain = SerialChain.of_robot(rover)
    # By the bodies' places: the centre of all masses from the ground below the rover's middle.
    rotations, origins = (part[0] for part in chain.link_frames(HOME))
    mount = np.asarray(chain.transform_base_to_robot.translation)
    masses, centres = [rover.body.mass, chain.base.mass], [rover.body.centre]
    centres.append(mount + chain.base.centre)
    for joint, rotation, origin in zip(chain.joints, rotations, origins):
        masses.append(joint.body.mass)
        centres.append(origin + rotation @ joint.body.centre)
    centre = np.average(centres, axis=0, weights=masses) + [0.0, 0.0, rover.centre_height]
    edge = math.atan2(rover.half_track - centre[0], centre[2])
    # Tyres that do not slide before.
    ahead = LookAhead(rover, friction=(3.0, 3.0), doubt=SURE, copies=1, centre_range=0.0)
    for angle, over in ((edge - 0.06, False), (edge + 0.02, True)):
        found = ahead.outlook(resting(HOME, 4.0), np.random.default_rng(0), sideways(angle))
        assert np.isfinite(found.tips[0]) == over, np.degrees(angle)


def test_friction_that_a_slope_takes_is_counted():
    angle = math.atan(0.4)
    given = resting(HOME), np.random.default_rng(0), sideways(angle)
    for friction, slides in (((0.3, 0.39), 1.0), ((0.43, 0.8), 0.0), ((0.3, 0.5), 0.5)):
        found = LookAhead(DRAWN, friction=friction, doubt=SURE, copies=200).outlook(*given)
        assert found.slide() == pytest.approx(slides, abs=0.1)
        assert found.tip() == 0.0


def test_a_load_that_a_joint_cannot_hold_strains_it():
    out = np.array([0.0, 0.0, 0.0, 0.0])
    chain = SerialChain.of_robot(DRAWN)
    held = chain.link_frames(out)[1][0, -1] + [0.0, 0.12, 0.0]
    reach = np.linalg.norm((held - chain.link_frames(out)[1][0, 1])[:2])
    own = abs(chain.bias(out, np.zeros(4))[1])
    most = (DRAWN.motors[5].stall_torque - own) / (GRAVITY * reach)
    for share, strained in ((0.97, 0.0), (1.03, 1.0)):
        ahead = LookAhead(DRAWN, share * most, np.array([0.0, 0.12, 0.0]), doubt=SURE)
        assert ahead.outlook(resting(out), np.random.default_rng(0)).strain() == strained


def test_an_arm_that_comes_down_touches_the_ground_when_its_lowest_point_does():
    ahead = LookAhead(DRAWN, doubt=SURE, copies=1)
    path = Sweep(HOME, HOME + [0.3, -1.4, 0.6, 0.0], 2.0)
    plan = Plan.of_arm(path.at, 2.0)
    found = ahead.outlook(plan, np.random.default_rng(0))
    # By MuJoCo: the first contact of anything but tyres with the ground.
    model = build_scene(
        FieldConfig(texture_pixels=16), [RobotPlacement(ROBOT, stereo=False)]
    ).compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    places = [model.joint(f"{ROBOT}/{name}_joint").qposadr[0] for name in DRAWN.joint_names]
    tyres = {model.geom(f"{ROBOT}/{name}_tyre").id for name in DRAWN.wheel_names}
    touching = math.inf
    for index, angles in enumerate(plan.angles):
        data.qpos[places] = angles
        mujoco.mj_forward(model, data)
        grounds = [contact for contact in data.contact if 0 in model.geom_bodyid[contact.geom]]
        if any(not tyres & set(contact.geom.tolist()) for contact in grounds):
            touching = index * PERIOD
            break
    # The spheres reach beyond what they cover by some 2 cm.
    assert touching - 0.15 < found.touches[0] < touching < math.inf
    assert ahead.outlook(resting(HOME), np.random.default_rng(0)).touch() == 0.0


def test_chances_grow_with_what_is_not_known():
    plan = Plan.of_arm(Sweep(HOME, HOME + [1.0, -0.5, 1.2, 0.0], 0.75).at, 2.0)
    rng = np.random.default_rng
    rover = loaded(0.6)
    sure = LookAhead(rover, friction=(0.55, 0.55), doubt=SURE).outlook(plan, rng(0))
    assert sure.tip() in (0.0, 1.0)
    spread = LookAhead(rover, copies=200).outlook(plan, rng(0)).tilts.max(axis=1)
    assert np.ptp(spread[spread < TIPPED]) > 10.0 * np.ptp(sure.tilts.max(axis=1))
    again = LookAhead(rover).outlook(plan, rng(3)), LookAhead(rover).outlook(plan, rng(3))
    np.testing.assert_array_equal(again[0].tips, again[1].tips)


def test_a_drive_goes_on_from_the_speed_that_the_rover_has():
    lag, rims = 0.05, np.array([0.3, 0.1])
    commanded = np.tile(rims, (40, 1))
    held = Plan.of_drive(HOME, commanded, rims, -0.4)
    np.testing.assert_allclose(held.rims, commanded, rtol=1e-12)
    assert (held.speed, held.turn) == (pytest.approx(0.2), -0.4)
    # A first-order lag, taken backward in time.
    left = (lag / (lag + PERIOD)) ** np.arange(1, 41)[:, None]
    slower = Plan.of_drive(HOME, commanded, -rims)
    np.testing.assert_allclose(slower.rims, rims * (1.0 - 2.0 * left), atol=1e-12)


def test_a_swing_is_slowed_until_it_hardly_tips_the_rover_over():
    rover, load = loaded(0.8), 0.8
    ahead = LookAhead(rover, friction=(0.5, 0.6))
    asked = Sweep(HOME, HOME + [1.0, -0.5, 1.2, 0.0], 0.5)
    found = slow(ahead, asked, np.random.default_rng(1))
    assert found.stretch > 1.2  # noqa: PLR2004
    assert found.report == f"tips over with 100%: slowed {found.stretch:.2f} times"
    plan = Plan.of_arm(found.sweep.at, 3.0)
    assert np.abs(mujocos(rover, load, plan)[:, :2]).max() < TIPPED
    slower = dataclasses.replace(asked, duration=5.0)
    kept = slow(ahead, slower, np.random.default_rng(1))
    assert (kept.sweep, kept.report) == (slower, "")
    steep = slow(ahead, slower, np.random.default_rng(1), sideways(-0.9))
    assert steep.sweep is None
    assert "refused" in steep.report


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="no arm"):
        LookAhead(describe_rover(ROBOT, arm=False))
    with pytest.raises(ValueError, match="has 3 wheels on springs: looking ahead needs 4"):
        LookAhead(dataclasses.replace(DRAWN, wheels=DRAWN.wheels[:3]))
    with pytest.raises(ValueError, match=r"doubt spring = -0.1: expected 0 or a positive number"):
        Doubt(spring=-0.1)


@pytest.mark.parametrize(
    ("slope", "posture", "load", "rims", "turns"),
    [
        (0.0, HOME, 1e-6, (-0.1, 0.1), True),
        (0.0, HOME, 1e-6, (0.15, 0.05), True),
        (math.radians(8.0), HOME, 0.3, (-0.1, 0.1), True),
        # With its arm aside and back the tyres there bear most, and the rover hardly turns.
        (math.radians(4.5), [-1.96, 0.8, -0.85, -0.26], 0.23, (0.16, -0.16), False),
    ],
    ids=["in place", "curve", "slope", "arm aside"],
)
def test_a_rover_turns_as_mujocos_does(slope, posture, load, rims, turns):
    rover, seconds = loaded(load), 1.5
    plan = Plan.of_drive(np.asarray(posture), np.tile(rims, (round(seconds / PERIOD), 1)))
    expected = driven(rover, load, plan, slope)
    ahead = LookAhead(rover, friction=(FRICTION, FRICTION), doubt=SURE, copies=1)
    found = rocked(ahead, plan, sideways(slope))[0, -1, 3]
    assert found == pytest.approx(expected, rel=0.15, abs=0.02)
    assert (abs(expected) > 0.1) == turns  # noqa: PLR2004


def driven(rover, load, plan, slope):
    """How far MuJoCo's rover as drawn has turned after a drive [rad]."""
    field = FieldConfig(texture_pixels=16, friction=FRICTION, slope=(-slope, 0.0))
    scene = build_scene(field, [with_load(load)])
    for each in list(scene.actuators) + list(scene.keys):
        scene.delete(each)
    for name in rover.axes:
        servo = scene.add_actuator(name=name, target=f"{ROBOT}/{name}_joint")
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        if name in rover.wheel_names:
            servo.set_to_velocity(kv=50.0)
        else:
            servo.set_to_position(kp=KP, kv=KV)
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = scene.compile()
    data = mujoco.MjData(model)
    arm = [model.joint(f"{ROBOT}/{name}_joint").qposadr[0] for name in rover.joint_names]
    data.qpos[arm] = data.ctrl[4:] = plan.angles[0]
    mujoco.mj_step(model, data, round(1.5 / model.opt.timestep))
    for left, right in plan.rims:
        data.ctrl[:4] = np.array([left, right, left, right]) / rover.wheel_radius
        mujoco.mj_step(model, data, round(PERIOD / model.opt.timestep))
    axes = data.xmat[model.body(f"{ROBOT}/chassis").id].reshape(3, 3)
    return math.atan2(-axes[0, 1], axes[1, 1])
