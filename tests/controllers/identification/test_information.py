"""Mutual information against quadrature and closed form."""

import numpy as np
import pytest
import scipy.stats

from controllers.identification.information import BITS, mutual_information

RANGE = (-2.0, 6.0)


def bits(estimate: float, sigma: float, n: int = BITS) -> float:
    bounds = np.array([RANGE])
    return float(mutual_information(np.array([estimate]), np.array([sigma]), bounds, n)[0])


def by_quadrature(estimate: float, sigma: float, n: int) -> float:
    """Equation 2-12b by adding up the density on a fine grid."""
    edges = np.linspace(*RANGE, 2**n + 1)
    fine = np.linspace(*RANGE, 400 * 2**n + 1)
    density = scipy.stats.norm.pdf(fine, estimate, sigma)
    areas = (density[1:] + density[:-1]).reshape(2**n, -1).sum(axis=1)
    q = areas / areas.sum()
    assert len(edges) == len(q) + 1
    return n - scipy.stats.entropy(q, base=2)


@pytest.mark.parametrize("estimate", [-1.9, 0.3, 5.0])
@pytest.mark.parametrize("sigma", [0.05, 0.4, 3.0, 50.0])
@pytest.mark.parametrize("n", [4, 8])
def test_information_equals_numerical_integration(estimate, sigma, n):
    assert bits(estimate, sigma, n) == pytest.approx(by_quadrature(estimate, sigma, n), abs=1e-4)


@pytest.mark.parametrize("part", [20, 100, 400])
def test_information_well_inside_the_range_is_log_of_range_over_sigma_less_2_05(part):
    expected = np.log2(part) - 0.5 * np.log2(2 * np.pi * np.e)
    assert bits(1.7, 8.0 / part) == pytest.approx(expected, abs=0.01)
    assert expected == pytest.approx(np.log2(part) - 2.05, abs=0.01)


@pytest.mark.parametrize("sigma", [1e3, 1e12, 1e25, np.inf, np.nan])
def test_nothing_known_is_0_bits(sigma):
    assert bits(1.0, sigma) == pytest.approx(0, abs=1e-4)


def test_an_estimate_that_is_nan_has_no_information():
    assert bits(np.nan, 0.1) == 0.0


@pytest.mark.parametrize("sigma", [0.0, 1e-300, 1e-9])
@pytest.mark.parametrize("estimate", [-2.0, 1.003, 6.0, 60.0])
def test_exactly_known_is_10_bits(estimate, sigma):
    assert bits(estimate, sigma) == pytest.approx(10, abs=1e-6)


def test_edge_between_two_states_of_the_sensor_costs_one_bit():
    assert bits(2.0, 0.0) == pytest.approx(9, abs=1e-6)


def test_estimate_outside_its_range_counts_as_lying_at_its_end():
    for sigma in (1e-3, 0.1, 2.0):
        assert bits(1e6, sigma) == bits(RANGE[1], sigma)
        assert bits(-1e6, sigma) == bits(RANGE[0], sigma)


def test_information_grows_as_sigma_falls():
    found = [bits(0.7, sigma) for sigma in np.geomspace(100, 1e-4, 60)]
    assert np.all(np.diff(found) > -1e-9)
