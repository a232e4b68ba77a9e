"""The arm stays within its limits, whatever is asked of it."""

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.identification.arm_motion import (
    CONSTANT,
    MODES,
    ArmLimits,
    ArmState,
    Excitation,
    RigidArm,
    mode_axes,
    swing,
)
from controllers.identification.compliant_base import ArmOnMount

LIMITS = ArmLimits()
STEP = 0.005
CORNERS = st.tuples(
    st.sampled_from(LIMITS.offset) | st.floats(*LIMITS.offset),
    st.sampled_from(LIMITS.amplitude) | st.floats(*LIMITS.amplitude),
    st.sampled_from(LIMITS.frequency) | st.floats(*LIMITS.frequency),
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.lists(CORNERS, min_size=2, max_size=12), st.sampled_from([8, 40, 80]))
def test_rate_acceleration_and_position_hold_through_every_transition(excitations, steps):
    state = ArmState()
    low = LIMITS.offset[0] - LIMITS.amplitude[1]
    high = LIMITS.offset[1] + LIMITS.amplitude[1]
    for values in excitations:
        path, state = swing(state, Excitation(*values), LIMITS, steps, STEP)
        assert np.abs(path.rate).max() <= LIMITS.rate
        assert np.abs(path.acceleration).max() <= LIMITS.acceleration
        # A triple pole passes what it filters: a stop of 5 rad/s takes 0.15 rad.
        assert low - 0.15 <= path.angle.min() and path.angle.max() <= high + 0.15


def test_worst_jumps_at_resonance_do_not_break_the_limits():
    reached = 0.0
    for frequency in (0.5, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0):
        for steps in (5, 11, 23, 47, 80):
            state = ArmState()
            for n in range(30):
                offset = LIMITS.offset[n % 2]
                excitation = Excitation(offset, LIMITS.amplitude[1], frequency)
                path, state = swing(state, excitation, LIMITS, steps, STEP)
                assert np.abs(path.rate).max() <= LIMITS.rate
                assert np.abs(path.acceleration).max() <= LIMITS.acceleration
                reached = max(reached, np.abs(path.rate).max())
    assert reached > 0.9 * LIMITS.rate


def test_arm_is_a_triple_pole_at_20_rad_s_while_no_limit_is_active():
    excitation = Excitation(np.pi / 4, 0.1, 4.0)
    path, _ = swing(ArmState(), excitation, LIMITS, 4000, 0.0005)
    times = 0.0005 * np.arange(4001)
    pole = LIMITS.bandwidth
    system = scipy.signal.lti([], [-pole] * 3, pole**3)
    _, expected, _ = scipy.signal.lsim(system, 0.1 * np.sin(4.0 * times), times)
    # The loop runs on samples: half of one late.
    np.testing.assert_allclose(path.angle - np.pi / 4, expected, atol=3e-4)
    error = {}
    for step in (0.001, 0.0005):
        count = round(1 / step)
        path, _ = swing(ArmState(), excitation, LIMITS, count, step)
        at_one = scipy.signal.lsim(
            system, 0.1 * np.sin(4.0 * step * np.arange(count + 1)), step * np.arange(count + 1)
        )[1][-1]
        error[step] = abs(path.angle[-1] - np.pi / 4 - at_one)
    assert error[0.0005] == pytest.approx(error[0.001] / 2, rel=0.1)


def test_trajectory_is_piecewise_cubic_with_continuous_acceleration():
    first, state = swing(ArmState(), CONSTANT, LIMITS, 80, STEP)
    second, _ = swing(state, Excitation(0.0, 0.9, 30.0), LIMITS, 80, STEP)
    path = first.then(second)
    assert len(path.angle) == 161 and len(path.jerk) == 160
    h = path.time_step
    angle, rate, acceleration, jerk = path.angle, path.rate, path.acceleration, path.jerk
    np.testing.assert_allclose(np.diff(acceleration), h * jerk, atol=1e-12)
    rise = h * acceleration[:-1] + h**2 / 2 * jerk
    np.testing.assert_allclose(np.diff(rate), rise, atol=1e-12)
    way = h * rate[:-1] + h**2 / 2 * acceleration[:-1] + h**3 / 6 * jerk
    np.testing.assert_allclose(np.diff(angle), way, atol=1e-12)


def test_constant_excitation_is_that_of_equation_2_21():
    path, _ = swing(ArmState(), CONSTANT, LIMITS, 2000, STEP)
    swings = path.angle[400:]
    assert swings.max() == pytest.approx(np.pi / 4 + 2 * np.pi / 9, rel=0.02)
    assert swings.min() == pytest.approx(np.pi / 4 - 2 * np.pi / 9, abs=0.02)
    rising = np.flatnonzero(np.diff(np.sign(swings - np.pi / 4)) > 0)
    assert np.diff(rising) * STEP == pytest.approx(4.0, abs=0.01)


def test_rod_points_forward_elevates_in_modes_x_and_y_and_yaws_in_z():
    raised = {}
    for mode in MODES:
        arm = ArmOnMount.of(RigidArm(), mode, rest_angle=np.pi / 6)
        raised[mode] = arm.rest_centre() / 0.245
    half, root = 0.5, np.sqrt(3) / 2
    np.testing.assert_allclose(raised["x"], [0, root, half], atol=1e-12)
    np.testing.assert_allclose(raised["y"], [root, 0, half], atol=1e-12)
    np.testing.assert_allclose(raised["z"], [-half, root, 0], atol=1e-12)


def test_unknown_mode_is_named_with_those_that_there_are():
    with pytest.raises(ValueError, match="mode 'w': expected one of x, y, z"):
        mode_axes("w")
