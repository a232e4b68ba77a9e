"""The fit of any model, against closed forms, SciPy and planted combinations."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

from controllers.identification.any_model.fit import (
    MOST_STEPS,
    PATIENCE,
    FitError,
    Measurements,
    fit,
    information_of,
    told,
)

OPEN = np.full(3, -np.inf)


def linear(matrix, offset=0.0):
    return lambda x: x @ matrix.T + offset


def measured(values, sigma, count=3):
    return Measurements(values, sigma, [slice(0, len(values))], np.full(count, 1e-4))


def test_linear_model_gives_the_posterior_of_bayes():
    generator = np.random.default_rng(1)
    matrix, sigma = generator.normal(size=(40, 3)), generator.uniform(0.5, 2.0, 40)
    values = matrix @ [0.4, -1.2, 0.8] + sigma * generator.standard_normal(40)
    found = fit(linear(matrix), measured(values, sigma), OPEN)
    heat = max(1.0, found.chi_square)
    precision = matrix.T @ (matrix / (heat * sigma**2)[:, None]) + np.eye(3)
    mean = np.linalg.solve(precision, matrix.T @ (values / (heat * sigma**2)))
    np.testing.assert_allclose(found.coordinates, mean, atol=0.02)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(precision), rtol=1e-4)
    assert found.converged


def test_coordinate_does_not_go_below_its_end():
    generator = np.random.default_rng(2)
    matrix = generator.normal(size=(60, 3))
    values = matrix @ [-1.5, 0.5, 1.0] + 0.01 * generator.standard_normal(60)
    lowest = np.array([0.0, -np.inf, -np.inf])
    found = fit(linear(matrix), measured(values, np.full(60, 3.0)), lowest)
    rows = np.vstack([matrix / 3.0, np.eye(3)])
    peer = lsq_linear(rows, np.append(values / 3.0, np.zeros(3)), (lowest, np.full(3, np.inf)))
    np.testing.assert_allclose(found.coordinates, peer.x, atol=0.02)
    assert found.coordinates[0] == 0.0


def test_noisier_channel_than_said_counts_as_it_scatters():
    """Two channels measure one number; one of them scatters ten times as much as is said."""
    generator = np.random.default_rng(3)
    values = 0.5 + 0.1 * np.concatenate([10.0, 1.0] * np.ones((400, 2)), axis=None).reshape(
        400, 2
    ).T.ravel() * generator.standard_normal(800)
    channels = [slice(0, 400), slice(400, 800)]
    noisy = Measurements(values, np.full(800, 0.1), channels, np.full(1, 1e-4))
    found = fit(linear(np.ones((800, 1))), noisy, np.full(1, -np.inf))
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.1 / np.sqrt(400 * 1.01), rel=0.05)
    assert abs(found.coordinates[0] - 0.5) < 4.0 * np.sqrt(found.covariance[0, 0])


def test_only_the_sum_of_two_is_told():
    matrix = np.zeros((100, 3))
    matrix[:, 0] = matrix[:, 1] = np.linspace(1.0, 2.0, 100)
    matrix[:, 2] = 10.0
    matrix[::2, 2] = -10.0
    result = told(matrix.T @ matrix, ["mass", "gain", "bias"], np.zeros(3))
    assert result.unknown == ("mass", "gain")
    (combination,) = result.combinations
    assert combination["mass"] == pytest.approx(-combination["gain"])
    assert abs(combination["mass"]) == pytest.approx(np.sqrt(0.5))
    assert result.sigma[2] < 0.02 and result.bits[2] > 6.0 and result.bits[0] < 1.0


def test_local_optimum_is_left_by_a_jump():
    """A phase that is off by a period: the model is alike there, and not alike enough."""
    times = np.linspace(0.0, 1.0, 400)

    def predict(x):
        return np.sin(30.0 * (times - 0.2 * x)) * np.exp(-(((times - 0.5 - 0.2 * x) / 0.3) ** 2))

    values = predict(np.array([[1.1]]))[0]
    found = fit(predict, measured(values, np.full(400, 0.01), 1), np.full(1, -np.inf))
    assert found.coordinates[0] == pytest.approx(1.1, abs=1e-3)


@pytest.mark.parametrize("lowest", [OPEN, np.zeros(3)])
def test_model_that_diverges_is_told(lowest):
    with pytest.raises(FitError, match="diverges"):
        fit(lambda x: np.full((len(x), 5), np.nan), measured(np.zeros(5), np.ones(5)), lowest)


@pytest.mark.parametrize("side", [1e-9, -1e-9])
def test_jump_of_one_sample_is_no_information(side):
    """As of an accelerometer that is sampled just where its robot begins to slip."""
    times = np.linspace(0.0, 1.0, 50)

    def predict(x):
        found = x[:, :1] * np.sin(9.0 * times)
        found[:, 20] += 0.5 * (x[:, 0] > side)
        return found

    values = measured(np.zeros(50), np.full(50, 0.1), 1)
    information = information_of(predict, values, np.zeros(1))
    expected = 100.0 * np.sum(np.sin(9.0 * times) ** 2)
    assert information[0, 0] == pytest.approx(expected, rel=1e-3)


def test_a_small_jump_beside_the_point_is_not_taken_for_information():
    """Of the third coordinate nothing is told, but a derivative falls on a jump of 1e-4."""
    generator = np.random.default_rng(8)
    matrix = np.column_stack([generator.normal(size=(40, 2)), np.zeros(40)])
    values = matrix @ [0.4, -1.2, 0.0] + generator.standard_normal(40)

    def predict(x):
        return x @ matrix.T + 1e-4 * (x[:, 2:] > 5e-5)

    seen = measured(values, np.ones(40))
    found = fit(predict, seen, OPEN)
    sober = found.sobered(predict, seen, OPEN)
    assert found.covariance[2, 2] < 0.05
    assert sober.covariance[2, 2] > 0.9
    assert not sober.edges
    smooth = fit(linear(matrix), seen, OPEN)
    np.testing.assert_allclose(np.diag(sober.covariance), np.diag(smooth.covariance), rtol=0.1)


def test_a_jump_that_no_noise_hides_is_told():
    """Past it the third coordinate moves all samples by two deviations of their noise."""
    generator = np.random.default_rng(8)
    matrix = np.column_stack([generator.normal(size=(40, 2)), np.zeros(40)])
    values = matrix @ [0.4, -1.2, 0.0] + generator.standard_normal(40)

    def predict(x):
        return x @ matrix.T + 2.0 * (x[:, 2:] > 5e-5)

    seen = measured(values, np.ones(40))
    assert fit(predict, seen, OPEN).sobered(predict, seen, OPEN).edges == (2,)
    strong = linear(1e4 * matrix)
    told = fit(strong, measured(1e4 * values, np.ones(40)), OPEN)
    assert not told.sobered(strong, measured(1e4 * values, np.ones(40)), OPEN).edges


def test_fit_is_moved_to_what_a_better_prediction_gives_and_counts_the_way():
    """A linear model, 2 % stronger and offset: least squares of that model give the same point."""
    generator = np.random.default_rng(6)
    matrix, noise = generator.normal(size=(60, 3)), 0.01
    values = matrix @ [0.3, 0.1, -0.2] + noise * generator.standard_normal(60)
    stronger, offset = 1.02 * matrix, 0.05 * generator.normal(size=60)
    data = measured(values, np.full(60, noise))
    found = fit(linear(matrix), data, OPEN)
    point = found.moved(linear(stronger, offset), data, OPEN)
    best = np.linalg.lstsq(stronger, values - offset)[0]
    shift = point - found.coordinates
    assert np.abs(shift).max() > 0.005
    np.testing.assert_allclose(point, best, atol=1e-3 * np.abs(shift).max())
    again = dataclasses.replace(found, coordinates=point, shift=shift)
    np.testing.assert_allclose(again.covariance, found.covariance + np.outer(shift, shift))
    np.testing.assert_allclose(
        again.shifted, np.abs(shift) / np.sqrt(np.diag(found.covariance)), rtol=1e-9
    )


def test_a_fit_is_not_moved_to_a_prediction_that_diverges():
    matrix = np.random.default_rng(7).normal(size=(60, 3))
    data = measured(matrix @ [0.3, 0.1, -0.2], np.ones(60))
    found = fit(linear(matrix), data, OPEN)
    with pytest.raises(FitError, match="diverges"):
        found.moved(lambda x: np.full((len(x), 60), np.nan), data, OPEN)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_noise_that_repeats_itself_tells_as_much_less(memory):
    """The variance of a mean of noise with a memory is larger by (1 + memory) / (1 - memory)."""
    generator = np.random.default_rng(5)
    count, deviations = 2000, []
    for _ in range(20):
        noise = lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], generator.normal(size=count))
        samples = measured(noise, 1.0, count=1)
        found = fit(linear(np.ones((count, 1))), samples, np.full(1, -np.inf))
        deviations.append(np.sqrt(found.covariance[0, 0]))
    exact = np.sqrt((1.0 + memory) / (1.0 - memory) / count)
    assert np.median(deviations) == pytest.approx(exact, rel=0.15)


def test_likeliest_point_in_a_bend_is_found_and_ends_the_fit():
    samples = measured(np.zeros(30), np.full(30, 0.1), count=1)
    found = fit(
        lambda x: np.repeat(1.0 + np.abs(x[:, :1] - 0.3), 30, axis=1), samples, np.full(1, -np.inf)
    )
    assert found.coordinates[0] == pytest.approx(0.3, abs=1e-2)
    assert found.gain_left > 1.0 and found.converged and found.steps < MOST_STEPS


@pytest.mark.parametrize(("hopeful", "most"), [(True, MOST_STEPS), (False, PATIENCE)])
def test_fit_that_leads_nowhere_is_given_up(hopeful, most, monkeypatch):
    monkeypatch.setattr("controllers.identification.any_model.fit.LONGEST", 0.01)
    samples = measured(np.full(30, 100.0), np.ones(30), count=1)
    found = fit(linear(np.full((30, 1), 100.0)), samples, np.full(1, -np.inf), hopeful=hopeful)
    assert found.steps == most and not found.converged


def test_a_jump_just_beside_a_point_does_not_end_the_fit():
    """Beyond the point a joint slips: what is predicted jumps, and its derivative says nothing."""

    def predict(x):
        return np.repeat(x + 10.0 * (x > 5e-5), 30, axis=1)

    samples = measured(np.full(30, -0.5), np.full(30, 0.01), count=1)
    found = fit(predict, samples, np.full(1, -np.inf))
    assert found.coordinates[0] == pytest.approx(-0.5, abs=0.01) and found.converged


def test_a_rough_fit_ends_with_the_first_step_that_is_hardly_worth_one(monkeypatch):
    monkeypatch.setattr("controllers.identification.any_model.fit.LONGEST", 0.01)
    samples = measured(np.full(30, 100.0), np.ones(30), count=1)
    model, lowest = linear(np.full((30, 1), 20.0)), np.full(1, -np.inf)
    rough, whole = (fit(model, samples, lowest, rough=each) for each in (True, False))
    assert rough.steps == 1 and whole.steps == MOST_STEPS
