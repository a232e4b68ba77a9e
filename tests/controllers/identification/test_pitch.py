"""The rover's pitch equation, held to an independent integration and to known truths."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

from controllers.identification import pitch
from controllers.identification.arm_motion import Trajectory
from controllers.identification.pitch import (
    NAMES,
    PitchData,
    PitchFit,
    PitchMisfit,
    PitchPrior,
    fisher_information,
)
from controllers.identification.pitch_model import (
    Nuisance,
    PitchModel,
    PitchSensors,
    exponential,
    kalman_gains,
    predict_tilt,
    prediction_errors,
    smoothed,
)
from controllers.identification.rover_identifier import (
    GRAVITY,
    RoverIdentifierConfig,
    SwingingArm,
)

TRUTH = np.array([0.072, 0.054, 0.1, 1.5, 317.0])
SENSORS = PitchSensors()
EXACT = dataclasses.replace(SENSORS, wrench_scale_sigma=0.0)
"""A wrench as calibrated."""
ARM = SwingingArm(0.56, 0.0107, (0.31, 0.015), (0.0, 0.06))


def test_the_exponential_is_that_of_scipy_for_slow_and_stiff_bases():
    rng = np.random.default_rng(0)
    for size in 10.0 ** rng.uniform(-6.0, 1.0, 200):
        matrix = size * rng.normal(size=(4, 4))
        expected = scipy.linalg.expm(matrix)
        np.testing.assert_allclose(
            exponential(matrix), expected, rtol=0.0, atol=1e-11 * np.abs(expected).max()
        )
    assert np.isnan(exponential(np.full((4, 4), np.nan))).all()


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


@pytest.mark.parametrize("height", [-0.1, -0.036, 0.2])
@pytest.mark.parametrize("nuisance", [Nuisance(), Nuisance(0.002, 0.1, 0.01, 0.05)])
def test_motion_and_reading_agree_with_an_independent_integration(height, nuisance):
    ahead = 0.004
    sensors = dataclasses.replace(
        SENSORS, tilt_height=height, wrench_age=ahead - SENSORS.period / 2
    )
    _, wrench = rich_wrench(2.0)
    inertia, ry, rz, damping, stiffness = TRUTH
    pole = 2 * np.pi * sensors.tilt_bandwidth
    lever = rz + height + nuisance.mounting
    moment = -(wrench[:, 3] + ry * wrench[:, 2] - rz * wrench[:, 1])

    def turn(now, x):
        dry = nuisance.friction * np.tanh(x[1] / 0.03)
        return (now - dry - damping * x[1] - stiffness * x[0]) / inertia

    def rates(t, x, now):
        apparent = x[0] - lever * turn(now, x) / GRAVITY
        return [x[1], turn(now, x), pole * ((1 + nuisance.scale) * apparent - x[2])]

    state, wanted = np.zeros(3), []
    for now in moment:
        ends = [ahead, sensors.period]
        result = scipy.integrate.solve_ivp(
            rates, (0, ends[-1]), state, args=(now,), t_eval=ends, rtol=1e-9, atol=1e-12
        )
        seen, state = result.y.T
        apparent = seen[0] - lever * turn(now, seen) / GRAVITY
        wanted.append([seen[0], apparent, seen[2] + nuisance.zero])
    found = predict_tilt(TRUTH, wrench, sensors, nuisance)
    # Dry friction acts at once, and is held for a period in the model.
    share = 1e-6 if nuisance.friction == 0.0 else 0.03
    largest, off = np.abs(wanted).max(axis=0), np.abs(found - wanted).max(axis=0)
    assert np.all(off < share * largest + 1e-9)


def test_gains_and_errors_are_those_of_a_textbook_filter():
    """Against the same filter with matrices, whose input's noise is white from period to period."""
    model, rng = PitchModel.of(TRUTH, SENSORS), np.random.default_rng(0)
    moment, count = rng.normal(size=60), 60
    indices, lost = np.arange(3, count, 4), np.zeros(15, bool)
    lost[7] = True
    readings = 0.01 * rng.normal(size=len(indices))
    variance, noise = 0.01 + 0.02 * rng.random(count), SENSORS.tilt_sigma**2
    reading = model.shown[2]
    gains, deviations = kalman_gains(model.step, reading, indices, lost, variance, noise)
    errors = prediction_errors(model.step, reading, moment, indices, readings, gains)
    mean, covariance, k = np.zeros(3), np.zeros((3, 3)), 0
    for n in range(count):
        whole, spread = np.append(mean, moment[n]), scipy.linalg.block_diag(covariance, variance[n])
        if k < len(indices) and indices[k] == n:
            if lost[k]:
                spread[:3, :3] = np.diag(np.square([0.03, 2.0, 0.1]))
            power = reading @ spread @ reading + noise
            assert deviations[k] == pytest.approx(np.sqrt(power))
            assert errors[k] == pytest.approx(readings[k] - reading @ whole)
            whole = whole + spread @ reading / power * errors[k]
            spread = spread - np.outer(spread @ reading, reading @ spread) / power
            k += 1
        mean, covariance = model.step @ whole, model.step @ spread @ model.step.T
    assert k == len(indices)


def test_dry_friction_is_told_from_damping():
    _, wrench = rich_wrench()
    seen = predict_tilt(TRUTH, wrench, SENSORS, Nuisance(friction=0.15))[::4, 2]
    rng = np.random.default_rng(3)
    noisy = seen + SENSORS.tilt_sigma * rng.standard_normal(len(seen))
    estimate = finished(PitchData.of(wrench, np.arange(0, len(wrench), 4), noisy))
    nuisance = Nuisance(*estimate.coordinates[len(NAMES) :])
    assert nuisance.friction == pytest.approx(0.15, abs=0.04)
    damping = NAMES.index("b_pitch")
    sigma = np.sqrt(estimate.covariance[damping, damping])
    assert abs(estimate.parameters[damping] - TRUTH[damping]) < 4 * sigma


def test_wrench_that_lags_by_more_than_a_period_is_led_by_whole_samples():
    _, wrench = rich_wrench(1.0)
    late = dataclasses.replace(SENSORS, wrench_age=SENSORS.wrench_age + 2 * SENSORS.period)
    prompt = predict_tilt(TRUTH, wrench, SENSORS)
    np.testing.assert_allclose(predict_tilt(TRUTH, wrench, late)[:-2], prompt[2:])


def thorough(data, prior=None, iterations=30):
    """Return a fit that has searched all data thoroughly."""
    fit = PitchFit(EXACT, prior, PitchMisfit(0.0, 0.0, (0.0,) * 5))
    for _ in fit.search(data, iterations):
        pass
    return fit


def finished(data, prior=None, iterations=30):
    return thorough(data, prior, iterations).estimate


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
        fits.append(finished(data))
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
    estimate = finished(PitchData.of(*disturbed(1)))
    score = (estimate.parameters - TRUTH) / np.sqrt(np.diag(estimate.covariance))
    assert np.abs(score).max() < 4
    assert estimate.chi_square == pytest.approx(1, abs=0.3)
    assert estimate.unidentifiable(PitchPrior()) == ()


def test_noise_free_fit_recovers_the_truth():
    _, wrench = rich_wrench()
    tilt = predict_tilt(TRUTH, wrench, SENSORS)[:, 2]
    data = PitchData.of(wrench, np.arange(len(tilt)), tilt)
    estimate = finished(data, PitchPrior(log_sigma=50, lever_sigma=10), iterations=60)
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
    judged = thorough(before).with_losses(data, seen)
    lost = data.indices[judged.lost]
    assert lost.size and lost.min() >= 700 and lost.max() <= 760
    scores = []
    for each in (judged, data):
        found = finished(each)
        scores.append(np.abs(found.parameters - TRUTH) / np.sqrt(np.diag(found.covariance)))
    assert scores[0].max() < 5.0 < scores[1].max()


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_left_out_of_a_motion_that_obeys_the_model(seed):
    data = PitchData.of(*disturbed(seed))
    assert not thorough(data).with_losses(data, 0).lost.any()


def test_estimate_says_why_it_is_not_to_be_used():
    prior, good = PitchPrior(), finished(PitchData.of(*disturbed(1)))
    assert good.doubts(prior) == ()
    for change, words in (
        ({"gain_left": 0.01}, "the fit did not converge"),
        ({"chi_square": 1.36}, "chi squared is 1.4"),
        ({"lost": 50}, "20 % of the motion could not be foreseen"),
    ):
        assert dataclasses.replace(good, **change).doubts(prior) == (words,)
    nothing = PitchFit(SENSORS).estimate
    assert nothing.doubts(prior) == ("the motion does not show ixx, ry, rz, b_pitch, k_pitch",)


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
