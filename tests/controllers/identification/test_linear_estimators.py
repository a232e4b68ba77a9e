"""Pseudo-inverse and Kalman filter: right where A is exact, over-confident where it is measured."""

import numpy as np
import pytest

from controllers.identification.arm_motion import MODES
from controllers.identification.compliant_base import SIGNALS
from controllers.identification.linear_estimators import (
    Equations,
    KalmanFilter,
    compensated,
    pseudo_inverse,
    regressor,
)
from controllers.identification.parameters import COUNT, LEVER, NAMES, Prior, from_coordinates
from tests.controllers.identification.recorded import (
    ARMS,
    TRUTH,
    fit,
    motion,
    noise_bound,
    noisy,
    predicted,
)


def test_pseudo_inverse_is_numpys_and_solves_the_normal_equations():
    generator = np.random.default_rng(0)
    matrix, right = generator.normal(size=(300, COUNT)), generator.normal(size=300)
    found = pseudo_inverse(matrix, right)
    np.testing.assert_allclose(found, np.linalg.pinv(matrix) @ right, rtol=1e-9)
    np.testing.assert_allclose(found, np.linalg.solve(matrix.T @ matrix, matrix.T @ right))


def test_pseudo_inverse_gives_the_least_norm_where_nothing_is_seen():
    matrix = np.random.default_rng(1).normal(size=(300, COUNT))
    matrix[:, 5] = 0
    assert pseudo_inverse(matrix, matrix @ TRUTH)[5] == pytest.approx(0, abs=1e-9)


def test_kalman_filter_equals_weighted_least_squares_with_the_same_prior():
    generator = np.random.default_rng(2)
    matrix = generator.normal(size=(50, 6, COUNT))
    sigma = generator.uniform(0.5, 3, 6)
    right = matrix @ TRUTH + generator.normal(size=(50, 6)) * sigma
    kalman = KalmanFilter.from_prior(Prior())
    guess, precision = kalman.estimate.copy(), np.diag(1 / np.diag(kalman.covariance))
    kalman.update(matrix[:20], right[:20], sigma)
    kalman.update(matrix[20:], right[20:], sigma)
    rows = (matrix / sigma[:, None]).reshape(-1, COUNT)
    information = precision + rows.T @ rows
    pull = precision @ guess + rows.T @ (right / sigma).ravel()
    np.testing.assert_allclose(kalman.estimate, np.linalg.solve(information, pull), rtol=1e-6)
    covariance = np.linalg.inv(information)
    scale = np.sqrt(np.diag(covariance))
    error = (kalman.covariance - covariance) / np.outer(scale, scale)
    assert np.abs(error).max() < 1e-6


def test_kalman_filter_starts_where_the_prior_does_and_as_vague():
    kalman, prior = KalmanFilter.from_prior(Prior()), Prior()
    sigma = np.sqrt(np.diag(kalman.covariance))
    assert kalman.estimate[0] == pytest.approx(prior.mass)
    np.testing.assert_allclose(sigma[LEVER], prior.lever_sigma)
    # 1.5 in the logarithm: up to 4.5 times the guess.
    assert sigma[0] == pytest.approx(prior.mass * (np.exp(1.5) - 1))
    assert np.all(sigma[1:7] == sigma[1])


def test_kalman_filter_refuses_another_number_of_columns():
    with pytest.raises(ValueError, match="expected 22 columns, got 21"):
        KalmanFilter.from_prior(Prior()).update(np.ones((3, 6, 21)), np.ones((3, 6)), np.ones(6))


def test_noise_adds_to_the_products_what_the_equations_say():
    """Against 400 draws of the noise, of the products that matter: rows and columns weighed by
    the truth."""
    clean = predicted("x")[100:150]
    sigma = noise_bound({mode: predicted(mode) for mode in MODES}) / np.sqrt(3)
    draws = 400
    generator = np.random.default_rng(6)
    turned = np.append(TRUTH, -1.0)
    without = Equations.of(clean, sigma, ARMS["x"])
    wanted = without.noise @ turned @ turned
    np.testing.assert_allclose(without.products @ turned @ turned, 0, atol=1e-3)
    outputs = clean + generator.normal(size=(draws, *clean.shape)) * sigma
    # Only the products are wanted: their residuals, of all draws at once.
    matrix, right = regressor(outputs.reshape(-1, clean.shape[1]), ARMS["x"])
    left = (matrix @ TRUTH - right).reshape(draws, len(clean), -1)
    products = np.einsum("dni,dnj->dij", left, left)
    for n in range(2):
        of_one = Equations.of(outputs[n], sigma, ARMS["x"]).products @ turned @ turned
        np.testing.assert_allclose(of_one, products[n], rtol=1e-6)
    scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    # Sums of 50 squares vary by a fifth; the mean of 400 such by a hundredth.
    np.testing.assert_allclose((products.mean(axis=0) - wanted) / scale, 0, atol=0.05)


def test_compensated_least_squares_lose_the_bias_of_plain_ones():
    """Means over draws of the noise: what is left is the prior's pull, a tenth of plain ones'."""
    found, plain = [], []
    for seed in range(12):
        outputs, sigma = noisy(seed, windows=10, part=0.5)
        parts = [Equations.of(outputs[mode], sigma, ARMS[mode]) for mode in MODES]
        found.append(compensated(parts, Prior()))
        both = [regressor(outputs[mode], ARMS[mode]) for mode in MODES]
        weight = 1 / sigma[SIGNALS["force"].start :, None]
        rows = np.concatenate([(matrix * weight).reshape(-1, COUNT) for matrix, _ in both])
        right = np.concatenate([(right * weight[:, 0]).ravel() for _, right in both])
        scale = np.linalg.norm(rows, axis=0)
        plain.append(pseudo_inverse(rows / scale, right) / scale)
    told = [NAMES.index(n) for n in ("mass", "izz", "ry", "bz", "kx", "ky", "kz", "k_pitch")]
    bias, before = (np.mean(x, axis=0)[told] / TRUTH[told] - 1 for x in (found, plain))
    assert np.all(np.abs(bias) < 0.25 * np.abs(before) + 0.005)
    assert np.mean(np.abs(bias)) < 0.15 * np.mean(np.abs(before))


def test_compensated_least_squares_keep_the_guess_where_the_data_tell_nothing():
    outputs, sigma = noisy(3, modes=("x",))
    found = compensated([Equations.of(outputs["x"], sigma, ARMS["x"])], Prior())
    guess = from_coordinates(Prior().mean())
    unknown = [NAMES.index(name) for name in ("bx", "kx", "k_roll", "k_yaw")]
    np.testing.assert_allclose(found[unknown], guess[unknown], rtol=0.05)
    known = [NAMES.index(name) for name in ("mass", "by", "bz", "ky", "kz")]
    np.testing.assert_allclose(found[known], TRUTH[known], rtol=0.05)


@pytest.mark.slow
def test_kalman_filter_is_over_confident_where_a_is_measured_and_ours_is_calibrated():
    ours, kalmans, errors = [], [], []
    paths = {mode: motion(mode, windows=3) for mode in MODES}
    for seed in range(4):
        outputs, sigma = noisy(seed, windows=3, part=0.2)
        estimate = fit(outputs, paths, sigma)
        kalman = KalmanFilter.from_prior(Prior())
        for mode in MODES:
            matrix, right = regressor(outputs[mode], ARMS[mode])
            kalman.update(matrix, right, sigma[18:24])
        for found, covariance, nees in (
            (estimate.parameters, estimate.covariance, ours),
            (kalman.estimate, kalman.covariance, kalmans),
        ):
            nees.append(np.mean((found - TRUTH) ** 2 / np.diag(covariance)))
        errors.append(estimate.chi_square)
    # 88 squares of standard normals, mostly independent: 0.7 to 1.3 in 95 % of cases.
    assert 0.5 < np.mean(ours) < 1.5
    assert np.mean(kalmans) > 10
    # 17280 measurements vary by 0.7 %.
    np.testing.assert_allclose(errors, 1, atol=0.03)
