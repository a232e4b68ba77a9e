"""The rover's pitch equation, held to an independent integration and to known truths."""

import numpy as np
import pytest
import scipy.integrate

from controllers.identification import pitch
from controllers.identification.arm_motion import Trajectory
from controllers.identification.pitch import (
    NAMES,
    PitchFit,
    PitchPrior,
    PitchSensors,
    fisher_information,
    predict_tilt,
)
from controllers.identification.rover_identifier import (
    GRAVITY,
    RoverIdentifierConfig,
    SwingingArm,
)

TRUTH = np.array([0.072, 0.054, 0.1, 1.5, 317.0])
SENSORS = PitchSensors()
ARM = SwingingArm(0.56, 0.0107, (0.31, 0.015), (0.0, 0.06))


def rich_wrench(seconds=10.0, seed=0):
    """Return a smooth wrench with energy up to the base's resonance."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, SENSORS.period)
    wrench = np.zeros((len(time), 6))
    for column, size in ((1, 5.0), (2, 5.0), (3, 1.0)):
        for frequency in (1.0, 3.0, 7.0, 15.0, 30.0):
            phase = rng.uniform(0, 2 * np.pi)
            wave = np.sin(frequency * time + phase) - np.sin(phase)
            wrench[:, column] += size * rng.uniform(0.5, 1.0) * wave
    return time, wrench


def test_tilt_agrees_with_an_independent_integration():
    time, wrench = rich_wrench(2.0)
    inertia, ry, rz, damping, stiffness = TRUTH
    pole = 2 * np.pi * SENSORS.tilt_bandwidth

    def rates(t, x):
        force_y, force_z, moment = (np.interp(t, time, wrench[:, i]) for i in (1, 2, 3))
        pitching = -(moment + ry * force_z - rz * force_y)
        turn = (pitching - damping * x[1] - stiffness * x[0]) / inertia
        return [x[1], turn, pole * (x[0] - x[2])]

    ahead = 0.004
    result = scipy.integrate.solve_ivp(
        rates, (0, 2.0), [0, 0, 0], t_eval=time[:-1] + ahead, max_step=1e-3, rtol=1e-8, atol=1e-12
    )
    tilt = predict_tilt(TRUTH, wrench, SENSORS, ahead)[:-1]
    np.testing.assert_allclose(tilt, result.y[2], atol=1e-4 * np.abs(tilt).max())


def test_fit_recovers_the_truth_within_its_own_deviation():
    _, wrench = rich_wrench()
    rng = np.random.default_rng(1)
    tilt = predict_tilt(TRUTH, wrench, SENSORS, SENSORS.wrench_age)
    indices = np.arange(0, len(tilt), 4)
    noisy = tilt[indices] + SENSORS.tilt_sigma * rng.standard_normal(len(indices))
    estimate = PitchFit(SENSORS).fit(wrench, indices, noisy)
    score = (estimate.parameters - TRUTH) / np.sqrt(np.diag(estimate.covariance))
    assert np.abs(score).max() < 4
    assert estimate.chi_square == pytest.approx(1, abs=0.3)
    assert estimate.unidentifiable(PitchPrior()) == ()


def test_noise_free_fit_recovers_the_truth():
    _, wrench = rich_wrench()
    tilt = predict_tilt(TRUTH, wrench, SENSORS, SENSORS.wrench_age)
    fit = PitchFit(SENSORS, PitchPrior(log_sigma=50, lever_sigma=10))
    estimate = fit.fit(wrench, np.arange(len(tilt)), tilt, iterations=60)
    np.testing.assert_allclose(estimate.parameters, TRUTH, rtol=2e-3)


def test_slow_motion_leaves_inertia_and_damping_unidentified():
    time = np.arange(0.0, 10.0, SENSORS.period)
    wrench = np.zeros((len(time), 6))
    wrench[:, 3] = 0.5 * np.sin(0.5 * time)
    tilt = predict_tilt(TRUTH, wrench, SENSORS, SENSORS.wrench_age)
    indices = np.arange(0, len(tilt), 4)
    estimate = PitchFit(SENSORS).fit(wrench, indices, tilt[indices])
    assert {"ixx", "ry", "rz"} <= set(estimate.unidentifiable(PitchPrior()))
    assert "k_pitch" not in estimate.unidentifiable(PitchPrior())


def test_more_data_never_tell_less():
    _, wrench = rich_wrench()
    estimate = PitchFit(SENSORS).estimate
    few = fisher_information(estimate, wrench, 40, SENSORS)
    many = fisher_information(estimate, wrench, 400, SENSORS)
    assert np.linalg.eigvalsh(many - few).min() > -1e-6 * np.linalg.eigvalsh(many).max()


@pytest.mark.parametrize("name", ["arm_base_wrench", "inclinometer"])
def test_a_measurement_that_is_not_a_number_is_named(name):
    _, wrench = rich_wrench(1.0)
    tilt = np.zeros(len(wrench))
    (wrench if name == "arm_base_wrench" else tilt)[5] = np.nan
    with pytest.raises(ValueError, match=name):
        PitchFit(SENSORS).fit(wrench, np.arange(len(tilt)), tilt)


@pytest.mark.chosen_seed  # One whose first step goes there.
def test_a_step_to_where_the_model_overflows_is_no_gain(monkeypatch):
    _, wrench = rich_wrench(1.0)
    tilt = predict_tilt(TRUTH, wrench, SENSORS, SENSORS.wrench_age)

    def overflowing(parameters, *arguments):
        soft = parameters[4] < 0.9 * PitchPrior().stiffness
        return predict_tilt(parameters, *arguments) * (np.nan if soft else 1.0)

    monkeypatch.setattr(pitch, "predict_tilt", overflowing)
    estimate = PitchFit(SENSORS).fit(wrench, np.arange(len(tilt)), tilt)
    assert np.isfinite(estimate.chi_square) and np.all(np.isfinite(estimate.covariance))


def test_arm_at_rest_weighs_its_weight_at_the_shoulder():
    still = Trajectory(0.01, np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(0))
    wrench = ARM.wrench(still)[0]
    assert wrench[2] == pytest.approx(ARM.mass * GRAVITY)
    assert wrench[3] == pytest.approx(ARM.mass * GRAVITY * ARM.centre[0])


def test_an_unknown_excitation_is_named():
    with pytest.raises(ValueError, match="wiggle.*information"):
        RoverIdentifierConfig("rover1", ARM, "wiggle")


def test_parameters_are_those_of_table_2_2():
    assert NAMES == ("ixx", "ry", "rz", "b_pitch", "k_pitch")
