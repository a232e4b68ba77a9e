"""What the arm's controller refuses, and what the tip-over guard makes of a motion."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.rigid_motion import LEVEL, WEIGHTLESS, FrameMotion
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.arm_control import ArmControlConfig, ArmController, ArmGains, Reference
from controllers.motion.base_motion import BaseMotionFilter, level_of
from controllers.motion.tipping.tip_over import (
    Footing,
    GuardConfig,
    Sweep,
    ground_wrench,
    guard,
    least_margin,
    zero_moment_point,
)
from perception.geometry.gravity import GRAVITY
from twin.description import JointDescription, RigidBody
from twin.robot import Channel, Observation, RobotError, Validity

SQUARE = 0.2 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])

X = (1.0, 0.0, 0.0)


def rod(load=1.0, length=0.5):
    """A light arm that turns about x with a point load at its end."""
    body = RigidBody(load, np.array([0.0, length, 0.0]), np.zeros((3, 3)))
    return SerialChain((JointDescription("rod", RigidTransform.identity(), X, body),))


def footing(load=1.0):
    base = RigidBody(3.0, np.zeros(3), 0.01 * np.eye(3))
    return Footing(base, rod(load), np.zeros(3), SQUARE, -0.1)


def measured(value):
    return Channel(np.array(value, dtype=float), 0.0, Validity.MEASURED)


def test_zero_moment_point_at_rest_is_below_the_centre_of_mass():
    still = np.zeros(1)
    point = footing().zero_moment_point([0.3], still, still)
    np.testing.assert_allclose(point, [0.0, 0.5 * np.cos(0.3) / 4.0], atol=1e-12)


def test_zero_moment_point_of_an_accelerated_load_is_the_printed_a_5():
    """A point mass: no moment of its own, so that the printed equation is complete."""
    angle, rate, growth = 0.3, 1.1, 4.0
    y, z = 0.5 * np.cos(angle), 0.5 * np.sin(angle)
    ay = -z * growth - y * rate**2
    az = y * growth - z * rate**2 + GRAVITY
    up = 0.1 + z
    expected = (az * y - ay * up) / (az + 3.0 * GRAVITY)
    point = footing().zero_moment_point([angle], [rate], [growth])
    np.testing.assert_allclose(point, [0.0, expected], atol=1e-12)


def test_particles_and_external_forces_balance_at_the_point_of_a_5():
    """A-5 with the outer forces' sign as in its denominator; as printed its y has the other."""
    rng = np.random.default_rng(2)
    masses, places = rng.uniform(0.5, 2.0, 4), rng.normal(size=(4, 3))
    felt = rng.normal(size=(4, 3)) + [0.0, 0.0, GRAVITY]
    push, at = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.1, 0.4])
    pushes = [np.concatenate([push, np.zeros(3), at])]
    up = masses @ felt[:, 2] - push[2]
    x = masses @ (felt[:, 2] * places[:, 0] - felt[:, 0] * places[:, 2])
    y = masses @ (felt[:, 2] * places[:, 1] - felt[:, 1] * places[:, 2])
    x += at[2] * push[0] - at[0] * push[2]
    y += at[2] * push[1] - at[1] * push[2]
    wrench = ground_wrench(masses, places, felt, np.zeros((4, 3)), pushes)
    np.testing.assert_allclose(zero_moment_point(wrench), [x / up, y / up])


def test_turning_base_asks_the_ground_for_what_its_particles_do():
    rng = np.random.default_rng(3)
    masses, places = rng.uniform(0.5, 2.0, 5), 0.2 * rng.normal(size=(5, 3))
    force, omega, alpha = rng.normal(size=(3, 3))
    centre = masses @ places / masses.sum()
    levers = places - centre
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, levers))
    base = RigidBody(float(masses.sum()), centre, inertia)
    bare = Footing(base, rod(0.0), np.array([0.1, 0.2, 0.3]), SQUARE, -0.1)
    felt = force + np.cross(alpha, places) + np.cross(omega, np.cross(omega, places))
    expected = ground_wrench(masses, places, felt, np.zeros((5, 3)))
    wrench = bare.wrench([0.3], [0.0], [0.0], FrameMotion(force, omega, alpha))
    np.testing.assert_allclose(wrench, expected, atol=1e-12)


def test_ground_cannot_pull():
    with pytest.raises(ValueError, match="needs a push"):
        zero_moment_point([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])


def test_harmless_motion_is_left_as_it_is():
    sweep = Sweep(np.array([1.2]), np.array([1.0]), 2.0)
    verdict = guard(footing(0.5), sweep)
    assert verdict.sweep is sweep
    assert verdict.report == ""


@pytest.mark.parametrize("duration", [0.3, 0.2, 0.1])
def test_fast_motion_is_slowed_until_it_keeps_the_reserve_and_no_further(duration):
    sweep = Sweep(np.array([1.4]), np.array([0.8]), duration)
    verdict = guard(footing(0.8), sweep)
    assert verdict.margin == least_margin(footing(0.8), sweep, LEVEL, GuardConfig().samples) < 0.03
    # However fast it is asked for, the same motion comes of it.
    assert verdict.stretch * duration == pytest.approx(0.4207, rel=0.01)
    assert verdict.sweep == dataclasses.replace(sweep, duration=verdict.stretch * duration)
    assert f"slowed {verdict.stretch:.2f} times" in verdict.report
    assert least_margin(footing(0.8), verdict.sweep, LEVEL, 201) > 0.028
    faster = dataclasses.replace(verdict.sweep, duration=0.99 * verdict.sweep.duration)
    assert least_margin(footing(0.8), faster, LEVEL, GuardConfig().samples) < 0.03


def test_motion_that_no_allowed_speed_keeps_on_the_wheels_is_refused():
    sweep = Sweep(np.array([1.4]), np.array([0.8]), 0.1)
    verdict = guard(footing(0.8), sweep, config=GuardConfig(slowest=3.0))
    assert verdict.sweep is None and verdict.stretch == 1.0
    assert verdict.report == "refused: no speed keeps the rover on its wheels"
    allowed = guard(footing(0.8), sweep, config=GuardConfig(slowest=6.0))
    assert allowed.sweep is not None


def test_reach_beyond_the_footprint_is_cut_short():
    sweep = Sweep(np.array([1.4]), np.array([0.0]), 2.0)
    verdict = guard(footing(3.0), sweep)
    assert 0.0 < verdict.sweep.part < 1.0
    assert "cut" in verdict.report
    # Where it stops the arm could stand with its reserve, and a step further not.
    still = np.zeros(1)
    parts = verdict.sweep.part + np.array([0.0, 1.0 / (GuardConfig().samples - 1)])
    margins = [
        footing(3.0).margin(footing(3.0).zero_moment_point([1.4 * (1.0 - part)], still, still))
        for part in parts
    ]
    assert margins[0] >= 1.1 * GuardConfig().reserve > margins[1]
    refused = guard(footing(20.0), Sweep(np.array([0.0]), np.array([0.1]), 1.0))
    assert refused.sweep is None and refused.margin < 0.0
    assert refused.report == "refused: the arm's pose is at the edge of tipping as is"


def test_motion_that_is_only_cut_short_is_no_faster_than_requested():
    sweep = Sweep(np.array([1.4]), np.array([0.0]), 30.0)
    verdict = guard(footing(3.0), sweep)
    assert 0.0 < verdict.sweep.part < 1.0 and verdict.margin < 0.0
    assert verdict.stretch == 1.0 and verdict.sweep.duration == 30.0


def test_motion_of_another_arm_is_an_error_and_not_a_rover_that_tips():
    with pytest.raises(ValueError, match="expected 1 finite numbers"):
        guard(footing(0.5), Sweep(np.zeros(3), np.full(3, 0.1), 1.0))


def test_sweep_rests_at_both_ends_and_its_rates_are_its_derivatives():
    sweep = Sweep(np.array([0.5]), np.array([2.0]), 0.8, 0.5)
    for time, place in ((-1.0, 0.5), (0.0, 0.5), (0.4, 0.875), (0.8, 1.25), (5.0, 1.25)):
        angles, rates, growths = sweep.at(time)
        # Half way it is fastest: 15 / 8 of the mean rate.
        rate = 0.75 / 0.8 * 15.0 / 8.0 if time == 0.4 else 0.0
        np.testing.assert_allclose(
            [angles[0], rates[0], growths[0]], [place, rate, 0.0], atol=1e-12
        )
    step = 1e-6
    before, after = sweep.at(0.3 - step), sweep.at(0.3 + step)
    for order in (0, 1):
        slope = (after[order] - before[order]) / (2.0 * step)
        np.testing.assert_allclose(slope, sweep.at(0.3)[order + 1], rtol=1e-6)


def test_base_filter_gives_steady_acceleration_in_full_and_forgets_without_a_gyro():
    base = BaseMotionFilter(lag=0.02)
    push = [0.0, 1.0, GRAVITY]
    for tick in range(40):
        gyro = measured([0.02 * tick, 0.0, 0.0])
        state = base.update(Observation(0.0, accelerometer=measured(push), gyro=gyro))
    np.testing.assert_allclose(state.specific_force, push, atol=1e-6)
    np.testing.assert_allclose(state.angular_acceleration, [2.0, 0.0, 0.0], atol=1e-6)
    assert base.update(Observation(0.0, accelerometer=measured(push))) is None


def controller(law="feed_forward"):
    config = ArmControlConfig("rover1", rod(), np.zeros(3), law=law, friction=np.zeros(1),
                              motor_damping=np.zeros(1))  # fmt: skip
    still = Reference(np.zeros(1), np.zeros(1), np.zeros(1))
    return ArmController(config, lambda _: still)


@pytest.mark.parametrize("law", ["pd", "pd_gravity", "feed_forward"])
def test_efforts_are_those_of_a_4_for_a_rod_in_closed_form(law):
    """A point load on a rod: H = m l^2, G = m g l cos(angle above level)."""
    load, length, pitch, q, rate = 0.6, 0.5, 0.12, 0.4, 0.3
    nothing = JointDescription("more", RigidTransform.identity(), X, WEIGHTLESS)
    chain, first = SerialChain((*rod(load, length).joints, *(nothing,) * 3)), np.eye(4)[0]
    config = ArmControlConfig(
        "rover1", chain, np.array([0.0, 0.1, 0.2]), ArmGains(15.0, 0.7), law,
        lag=0.0, friction=0.05 * first, motor_damping=0.2 * first, most=50.0,
    )  # fmt: skip

    def reference(time):
        return Reference((0.5 + 2.0 * time) * first, (2.0 + 3.0 * time) * first, 3.0 * first)

    arm, turning = ArmController(config, reference), 1.5
    force = np.array([0.0, 2.0, 12.0])  # felt where the accelerometer is
    for tick in range(2):
        seen = Observation(
            0.01 * tick, arm_angles=measured(q * first), arm_rates=measured(rate * first),
            inclinometer=measured([pitch, 0.0]), accelerometer=measured(force),
            gyro=measured([0.01 * tick * turning, 0.0, 0.0]),
        )  # fmt: skip
        effort = arm.step({"rover1": seen})["rover1"].arm[0]
    inertia = load * length**2
    wanted, middle = reference(0.01), reference(0.015)
    pull = 15.0**2 * (wanted.angles[0] - q) + 2.0 * 0.7 * 15.0 * (wanted.rates[0] - rate)
    expected = inertia * (pull + middle.accelerations[0]) + 0.05 + 0.2 * 0.015
    if law == "pd_gravity":
        expected += load * GRAVITY * length * np.cos(q + pitch)
    elif law == "feed_forward":
        spin = 0.01 * turning
        foot = force[1:] + turning * np.array([-0.2, 0.1]) - spin**2 * np.array([0.1, 0.2])
        expected += load * length * (foot[1] * np.cos(q) - foot[0] * np.sin(q)) + inertia * turning
    assert effort == pytest.approx(expected, rel=1e-9)


def test_level_is_worlds_up_by_pitch_about_x_and_roll_about_y():
    pitch, roll = 0.2, -0.3
    up = Rotation.from_euler("XY", [pitch, roll]).inv().apply([0.0, 0.0, GRAVITY])
    seen = Observation(0.0, inclinometer=measured([pitch, roll]))
    np.testing.assert_allclose(level_of(seen).specific_force, up, atol=1e-12)
    assert level_of(Observation(0.0)) is LEVEL


def test_another_point_of_a_turning_base_has_its_centripetal_acceleration():
    omega, alpha, lever = np.array([[0.3, -0.5, 0.7], [1.0, 2.0, -1.5], [0.1, 0.2, -0.3]])
    start, step = np.array([0.5, -0.2, 9.9]), 1e-4

    def place(time):
        turn = Rotation.from_rotvec(omega * time + 0.5 * alpha * time**2)
        return turn.apply(lever) + 0.5 * start * time**2

    bend = (place(step) - 2.0 * place(0.0) + place(-step)) / step**2
    moved = FrameMotion(start, omega, alpha).at(lever)
    np.testing.assert_allclose(moved.specific_force, bend, atol=1e-5)


def test_margin_is_the_distance_to_the_nearest_edge():
    rover = footing()
    assert rover.margin([0.15, -0.02]) == pytest.approx(0.05)
    assert rover.margin([0.0, 0.27]) == pytest.approx(-0.07)


def test_arm_is_not_driven_blind_and_wrong_settings_are_named():
    with pytest.raises(RobotError, match="arm_angles, which is missing"):
        controller().step({"rover1": Observation(0.0)})
    with pytest.raises(ValueError, match="law 'pid'"):
        controller("pid")
    with pytest.raises(ValueError, match="lag"):
        BaseMotionFilter(lag=-1.0)
    with pytest.raises(ValueError, match="frequency"):
        ArmGains(frequency=0.0)
