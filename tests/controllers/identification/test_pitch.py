"""The rover's pitch equation, held to an independent integration and to known truths."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate

from controllers.identification import pitch
from controllers.identification.arm_motion import Trajectory
from controllers.identification.pitch import (
    NAMES,
    PitchData,
    PitchFit,
    PitchPrior,
    PitchSensors,
    fisher_information,
    predict_tilt,
    smoothed,
)
from controllers.identification.rover_identifier import (
    GRAVITY,
    RoverIdentifierConfig,
    SwingingArm,
)

TRUTH = np.array([0.072, 0.054, 0.1, 1.5, 317.0])
SENSORS = PitchSensors()
ARM = SwingingArm(0.56, 0.0107, (0.31, 0.015), (0.0, 0.06))


FREQUENCIES = np.array([1.0, 3.0, 7.0, 15.0, 30.0, 60.0])
COLUMNS = (1, 2, 3)


def waves(seed=0):
    """Return amplitudes and phases (3, 6) of a smooth wrench with energy up to the resonance."""
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, (3, 6))
    return np.array([[5.0], [5.0], [1.0]]) * rng.uniform(0.5, 1.0, (3, 6)), phases


def rich_wrench(seconds=10.0, seed=0):
    """Return the ticks that end each period, and the wrench's means over the periods."""
    time = SENSORS.period * np.arange(1.0, round(seconds / SENSORS.period) + 1)
    wrench = np.zeros((len(time), 6))
    for column, sizes, phases in zip(COLUMNS, *waves(seed)):
        for frequency, size, phase in zip(FREQUENCIES, sizes, phases):
            ends = -np.cos(frequency * np.array([time, time - SENSORS.period]) + phase) / frequency
            mean = (ends[0] - ends[1]) / SENSORS.period
            wrench[:, column] += size * (mean - np.sin(phase))
    return time, wrench


@pytest.mark.parametrize("height", [None, -0.036, 0.2])
def test_motion_and_reading_agree_with_an_independent_integration(height):
    ahead = 0.004
    sensors = dataclasses.replace(
        SENSORS, tilt_height=height, wrench_age=ahead - SENSORS.period / 2
    )
    time, wrench = rich_wrench(2.0)
    inertia, ry, rz, damping, stiffness = TRUTH
    pole, sizes_and_phases = 2 * np.pi * sensors.tilt_bandwidth, list(zip(*waves()))
    lever = 0.0 if height is None else rz + height

    def turn(t, x):
        force_y, force_z, moment = (
            np.sum(sizes * (np.sin(FREQUENCIES * t + phases) - np.sin(phases)))
            for sizes, phases in sizes_and_phases
        )
        pitching = -(moment + ry * force_z - rz * force_y)
        return (pitching - damping * x[1] - stiffness * x[0]) / inertia

    def rates(t, x):
        apparent = x[0] - lever * turn(t, x) / GRAVITY
        return [x[1], turn(t, x), pole * (apparent - x[2])]

    seen = time - sensors.period + ahead
    result = scipy.integrate.solve_ivp(
        rates, (0, 2.0), [0, 0, 0], t_eval=seen, max_step=1e-3, rtol=1e-8, atol=1e-12
    )
    found = predict_tilt(TRUTH, wrench, sensors)
    apparent = [x[0] - lever * turn(t, x) / GRAVITY for t, x in zip(seen, result.y.T)]
    for column, wanted in zip(found.T, (result.y[0], np.array(apparent), result.y[2])):
        # The first and the last period lack a neighbour to slope to.
        late = slice(20, -1)
        # A moment held over each period would be 4 % off at the resonance.
        np.testing.assert_allclose(column[late], wanted[late], atol=8e-3 * np.abs(wanted).max())


def test_wrench_that_lags_by_more_than_a_period_is_led_by_whole_samples():
    _, wrench = rich_wrench(1.0)
    late = dataclasses.replace(SENSORS, wrench_age=SENSORS.wrench_age + 2 * SENSORS.period)
    prompt = predict_tilt(TRUTH, wrench, SENSORS)
    np.testing.assert_allclose(predict_tilt(TRUTH, wrench, late)[:-2], prompt[2:])


def disturbed(seed, seconds=10.0):
    """Return a wrench with noise on it, and every fourth tick's noisy reading of the true one."""
    rng = np.random.default_rng(seed)
    _, wrench = rich_wrench(seconds)
    reading = predict_tilt(TRUTH, wrench, SENSORS)[:, 2]
    indices = np.arange(0, len(reading), 4)
    noisy = reading[indices] + SENSORS.tilt_sigma * rng.standard_normal(len(indices))
    sigma = [SENSORS.force_sigma] * 3 + [SENSORS.torque_sigma] * 3
    return wrench + sigma * rng.standard_normal(wrench.shape), indices, noisy


@pytest.mark.slow
def test_noise_of_the_wrench_counts_in_what_the_fit_says_of_itself():
    """Over 20 draws; what is left of the wrench's noise draws each fit off by part of its own."""
    fits = []
    for seed in range(20):
        wrench, indices, tilt = disturbed(seed)
        data = PitchData.of(smoothed(wrench, SENSORS), indices, tilt)
        fits.append(PitchFit(SENSORS).finish(data))
    scores = [(fit.parameters - TRUTH) / np.sqrt(np.diag(fit.covariance)) for fit in fits]
    # 100 squares, in groups of five that hang together: within 0.6 to 1.5 but for that.
    assert 0.6 < np.mean(np.square(scores)) < 2.5
    chi_squares = [fit.chi_square for fit in fits]
    # 250 squares each: the mean of 20 scatters by 0.02.
    assert np.mean(chi_squares) == pytest.approx(0.95, abs=0.15)


def test_smoothing_takes_out_noise_where_nothing_moves_and_leaves_the_motion():
    _, wrench = rich_wrench()
    noisy = disturbed(0)[0]
    found = smoothed(noisy, SENSORS)
    before, after = (np.std(each - wrench, axis=0) for each in (noisy, found))
    # The motion takes 10 of the 50 Hz.
    assert np.all(after < 0.85 * before)
    high = np.fft.rfftfreq(len(wrench), SENSORS.period) > 15.0
    spectra = (np.fft.rfft(each - wrench, axis=0)[high] for each in (noisy, found))
    before, after = (np.linalg.norm(each, axis=0) for each in spectra)
    assert np.all(after < 0.7 * before)
    np.testing.assert_allclose(found, wrench, atol=6 * SENSORS.force_sigma)


def test_fit_recovers_the_truth_within_its_own_deviation():
    estimate = PitchFit(SENSORS).finish(PitchData.of(*disturbed(1)))
    score = (estimate.parameters - TRUTH) / np.sqrt(np.diag(estimate.covariance))
    assert np.abs(score).max() < 4
    assert estimate.chi_square == pytest.approx(1, abs=0.3)
    assert estimate.unidentifiable(PitchPrior()) == ()


def test_noise_free_fit_recovers_the_truth():
    _, wrench = rich_wrench()
    tilt = predict_tilt(TRUTH, wrench, SENSORS)[:, 2]
    fit = PitchFit(SENSORS, PitchPrior(log_sigma=50, lever_sigma=10))
    estimate = fit.finish(PitchData.of(wrench, np.arange(len(tilt)), tilt), iterations=60)
    np.testing.assert_allclose(estimate.parameters, TRUTH, rtol=2e-3)


def with_a_kick(seed, first, ticks=6, moment=-8.0):
    """Return `disturbed` data through which another moment pushed, as where a wheel lifts."""
    _, wrench = rich_wrench()
    pushed = wrench.copy()
    pushed[first : first + ticks, 3] += moment
    kick = (predict_tilt(TRUTH, pushed, SENSORS) - predict_tilt(TRUTH, wrench, SENSORS))[:, 2]
    measured, indices, tilt = disturbed(seed)
    return PitchData.of(measured, indices, tilt + kick[indices])


@pytest.mark.parametrize("seed", range(3))
def test_lifted_wheel_is_noticed_and_left_out(seed):
    data, seen = with_a_kick(seed, 700), 150
    before = dataclasses.replace(
        data,
        wrench=data.wrench[: 4 * seen],
        indices=data.indices[:seen],
        tilt=data.tilt[:seen],
        lost=data.lost[:seen],
    )
    fit = PitchFit(SENSORS)
    fit.finish(before)
    judged = fit.with_losses(data, seen)
    lost = data.indices[judged.lost]
    assert lost.size and lost.min() >= 700 and lost.max() <= 760
    scores = []
    for each in (judged, data):
        found = fit.finish(each)
        scores.append(np.abs(found.parameters - TRUTH) / np.sqrt(np.diag(found.covariance)))
    assert scores[0].max() < 5.0 < scores[1].max()


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_left_out_of_a_motion_that_obeys_the_model(seed):
    data, fit = PitchData.of(*disturbed(seed)), PitchFit(SENSORS)
    fit.finish(data)
    assert not fit.with_losses(data, 0).lost.any()


def test_slow_motion_leaves_inertia_and_damping_unidentified():
    time = np.arange(0.0, 10.0, SENSORS.period)
    wrench = np.zeros((len(time), 6))
    wrench[:, 3] = 0.5 * np.sin(0.5 * time)
    tilt = predict_tilt(TRUTH, wrench, SENSORS)[:, 2]
    indices = np.arange(0, len(tilt), 4)
    estimate = PitchFit(SENSORS).fit(PitchData.of(wrench, indices, tilt[indices]))
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
        PitchFit(SENSORS).fit(PitchData.of(wrench, np.arange(len(tilt)), tilt))


def test_a_step_to_where_the_model_overflows_is_no_gain(monkeypatch):
    _, wrench = rich_wrench(1.0)
    tilt = predict_tilt(TRUTH, wrench, SENSORS)[:, 2]
    residuals = pitch._Likelihood.residuals

    def overflowing(likelihood, coordinates, given):
        soft = coordinates[4] < np.log(0.9 * PitchPrior().stiffness)
        return residuals(likelihood, coordinates, given) * (np.nan if soft else 1.0)

    monkeypatch.setattr(pitch._Likelihood, "residuals", overflowing)
    estimate = PitchFit(SENSORS).fit(PitchData.of(wrench, np.arange(len(tilt)), tilt))
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
