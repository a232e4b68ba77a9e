"""Our model of the plant against MuJoCo, an independent integration and finite differences."""

import numpy as np
import pytest

from controllers.identification import compliant_base
from controllers.identification.arm_motion import MODES, mode_axes
from controllers.identification.compliant_base import (
    CHANNELS,
    SIGNALS,
    BaseState,
    _Motion,
    simulate,
)
from controllers.identification.parameters import COUNT, NAMES
from models.datasheets import TABLE_2_1_TRUTH
from tests.controllers.identification import newton_euler
from tests.controllers.identification.recorded import ARMS, TRUTH, motion, predicted, recorded

START = BaseState.at_rest()


def relative_rms(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Per signal, over its three components."""
    parts = SIGNALS.values()
    error = [np.sqrt(np.mean((found - expected)[:, rows] ** 2)) for rows in parts]
    return np.array(error) / [np.sqrt(np.mean(expected[:, rows] ** 2)) for rows in parts]


BOUND = np.where([name == "angle_accelerations" for name in SIGNALS], 1e-3, 1e-4)


@pytest.mark.parametrize("mode", MODES)
def test_model_agrees_with_mujoco(mode):
    assert np.all(relative_rms(predicted(mode), recorded(mode)) <= BOUND)


@pytest.mark.parametrize("mode", MODES)
def test_model_and_mujoco_agree_with_newton_euler_integrated_by_scipy(mode):
    count = 6
    axis, turn = mode_axes(mode)
    arm = (1.0, (0.02, 0.001, 0.02), 0.245)
    plant = newton_euler.Plant(TABLE_2_1_TRUTH, arm, axis, turn, motion(mode))
    expected = plant.outputs(count)
    assert np.all(relative_rms(predicted(mode)[:count], expected) <= BOUND)
    assert np.all(relative_rms(recorded(mode)[:count], expected) <= BOUND)


def test_estimator_integrates_within_a_tenth_of_a_percent_of_a_finer_integration():
    for mode in MODES:
        coarse, _, _ = simulate(TRUTH, ARMS[mode], motion(mode), START, False, substeps=2)
        assert relative_rms(coarse, predicted(mode)).max() < 1e-3


@pytest.mark.parametrize("mode", MODES)
def test_sensitivities_equal_central_differences(mode):
    path = motion(mode, windows=1)
    outputs, sensitivities, _ = simulate(TRUTH, ARMS[mode], path, START, substeps=2)
    noise = 0.1 * np.abs(outputs).max(axis=0) + 1e-12
    for index in range(COUNT):
        step = np.zeros(COUNT)
        step[index] = 1e-4 * max(abs(TRUTH[index]), 0.05)
        ends = [
            simulate(TRUTH + sign * step, ARMS[mode], path, START, False, substeps=2)[0]
            for sign in (1, -1)
        ]
        expected = (ends[0] - ends[1]) / (2 * step[index])
        error = sensitivities[:, :, index] - expected
        assert np.linalg.norm(error / noise) <= 5e-4 * np.linalg.norm(expected / noise)
        for name, rows in SIGNALS.items():
            # Also where the effect is of second order, and drowned by the noise.
            size = np.abs(expected[:, rows]).max()
            assert np.abs(error[:, rows]).max() <= 3e-3 * size + 1e-9, (NAMES[index], name)


def equations(motion: np.ndarray) -> np.ndarray:
    """Equations of motion, force and moment (12,) of an arm in full swing, by q, v and a (18,)."""
    plant, kinematics = swinging_arm()
    out = np.empty(6)
    wrench = compliant_base._residual(plant, kinematics, _Motion(*motion.reshape(3, 6)), out)
    return np.concatenate([out, *wrench])


def swinging_arm():
    arm = ARMS["y"]
    swing = (arm.inertia, arm.centre, arm.axis, 0.4, 2.0, -15.0)
    plant = compliant_base._Plant(TRUTH, arm.mass, np.zeros(6))
    return plant, compliant_base._arm_kinematics(*swing)


def test_equations_derivatives_by_motion_are_exact():
    here, found = np.random.default_rng(1).uniform(-1.0, 1.0, 18), np.empty((12, 18))
    compliant_base._by_motion(*swinging_arm(), _Motion(*here.reshape(3, 6)), found)
    steps = 1e-5 * np.eye(18)
    differences = [(equations(here + s) - equations(here - s)) / 2e-5 for s in steps]
    np.testing.assert_allclose(found, np.array(differences).T, rtol=1e-8, atol=1e-6)


def test_windows_one_after_another_equal_one_long_window():
    path = motion("x", windows=2)
    whole, derivatives, end = simulate(TRUTH, ARMS["x"], path, START)
    half = len(path.jerk) // 2
    first = motion("x", windows=1)
    rest = type(path)(
        path.time_step,
        path.angle[half:],
        path.rate[half:],
        path.acceleration[half:],
        path.jerk[half:],
    )
    outputs1, derivatives1, middle = simulate(TRUTH, ARMS["x"], first, START)
    outputs2, derivatives2, last = simulate(TRUTH, ARMS["x"], rest, middle)
    joined = np.concatenate([outputs1, outputs2])
    # Newton's starting point is not carried over, hence the tolerance.
    scale = np.abs(whole).max(axis=0)
    assert np.all(np.abs(joined - whole) <= 1e-5 * scale)
    sizes = np.abs(derivatives).max(axis=0)
    both = np.concatenate([derivatives1, derivatives2])
    assert np.all(np.abs(both - derivatives) <= 1e-3 * sizes + 1e-12)
    np.testing.assert_allclose(last.position, end.position, rtol=1e-5, atol=1e-10)


def test_base_stays_at_rest_while_the_arm_does():
    path = motion("x", windows=1)
    still = np.zeros_like(path.angle)
    held = type(path)(path.time_step, still + np.pi / 4, still, still, still[1:])
    outputs, _, _ = simulate(TRUTH, ARMS["x"], held, START, False)
    assert outputs.shape == (80, CHANNELS)
    assert np.abs(outputs).max() < 1e-12
