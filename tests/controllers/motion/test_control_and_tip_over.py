"""What the arm's controller refuses, and what the tip-over guard makes of a motion."""

import numpy as np
import pytest

from controllers.identification.serial_arm import RigidBody
from controllers.motion.arm_control import ArmControlConfig, ArmController, ArmGains, Reference
from controllers.motion.base_motion import BaseFilterConfig, BaseMotionFilter
from controllers.motion.chain import GRAVITY, LEVEL, Chain, Joint
from controllers.motion.tip_over import Footing, Sweep, guard, least_margin, zero_moment_point
from twin.robot import Channel, Observation, RobotError, Validity

SQUARE = 0.2 * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def rod(load=1.0, length=0.5):
    """A light arm that turns about x with a point load at its end."""
    body = RigidBody(load, np.array([0.0, length, 0.0]), np.zeros((3, 3)))
    return Chain([Joint(body, np.zeros(3), np.eye(3), np.array([1.0, 0.0, 0.0]))])


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


def test_ground_cannot_pull():
    with pytest.raises(ValueError, match="needs a push"):
        zero_moment_point([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])


def test_harmless_motion_is_left_as_it_is():
    sweep = Sweep(np.array([1.2]), np.array([1.0]), 2.0)
    verdict = guard(footing(0.5), sweep)
    assert verdict.sweep is sweep
    assert verdict.report == ""


def test_fast_motion_is_slowed_until_it_keeps_the_reserve():
    sweep = Sweep(np.array([1.4]), np.array([0.8]), 0.3)
    verdict = guard(footing(0.8), sweep)
    assert verdict.margin < 0.03
    assert verdict.stretch > 1.0
    assert "slowed" in verdict.report
    assert least_margin(footing(0.8), verdict.sweep, LEVEL, 201) > 0.028


def test_reach_beyond_the_footprint_is_cut_short():
    sweep = Sweep(np.array([1.4]), np.array([0.0]), 2.0)
    verdict = guard(footing(3.0), sweep)
    assert 0.0 < verdict.sweep.part < 1.0
    assert "cut" in verdict.report
    assert guard(footing(20.0), Sweep(np.array([0.0]), np.array([0.1]), 1.0)).sweep is None


def test_sweep_rests_at_both_ends_and_its_rates_are_its_derivatives():
    sweep = Sweep(np.array([0.0]), np.array([2.0]), 0.8, 0.5)
    for time, place in ((0.0, 0.0), (0.8, 1.0), (5.0, 1.0)):
        angles, rates, growths = sweep.at(time)
        np.testing.assert_allclose([angles[0], rates[0], growths[0]], [place, 0.0, 0.0], atol=1e-12)
    step = 1e-6
    before, after = sweep.at(0.3 - step), sweep.at(0.3 + step)
    for order in (0, 1):
        slope = (after[order] - before[order]) / (2.0 * step)
        np.testing.assert_allclose(slope, sweep.at(0.3)[order + 1], rtol=1e-6)


def test_base_filter_gives_steady_acceleration_in_full_and_forgets_without_a_gyro():
    base = BaseMotionFilter(BaseFilterConfig(lag=0.02))
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


def test_arm_is_not_driven_blind_and_wrong_settings_are_named():
    with pytest.raises(RobotError, match="arm_angles, which is missing"):
        controller().step({"rover1": Observation(0.0)})
    with pytest.raises(ValueError, match="law 'pid'"):
        controller("pid")
    with pytest.raises(ValueError, match="lag"):
        BaseFilterConfig(lag=-1.0)
    with pytest.raises(ValueError, match="frequency"):
        ArmGains(frequency=0.0)
