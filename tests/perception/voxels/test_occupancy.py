"""Log-odds are the odds' logarithms, and are clamped at their limits."""

import math

import numpy as np
import pytest

from perception.voxels.occupancy import UpdateModel, binary_entropy, log_odds, probability


def test_log_odds_and_probability_are_inverse():
    p = np.linspace(0.001, 0.999, 101)
    np.testing.assert_allclose(probability(log_odds(p)), p, rtol=1e-12)
    assert log_odds(0.75) == pytest.approx(math.log(3.0))


def test_adding_log_odds_is_the_rule_of_bayes():
    prior, hit = 0.3, 0.7
    bayes = prior * hit / (prior * hit + (1 - prior) * (1 - hit))
    assert probability(log_odds(prior) + log_odds(hit)) == pytest.approx(bayes)


def test_entropy_is_one_bit_at_a_half_and_none_when_certain():
    np.testing.assert_allclose(binary_entropy([0.0, 0.5, 1.0]), [0.0, 1.0, 0.0])
    p = 0.11
    assert binary_entropy(p) == pytest.approx(-p * math.log2(p) - 0.89 * math.log2(0.89))


def test_steps_are_those_of_octomap():
    hit, miss = UpdateModel().steps
    assert (hit, miss) == (pytest.approx(0.847, abs=1e-3), pytest.approx(-0.405, abs=1e-3))
    assert UpdateModel().clamps == (pytest.approx(-2.0, abs=1e-3), pytest.approx(3.511, abs=1e-2))


@pytest.mark.parametrize("bad", [{"hit": 0.4}, {"miss": 0.6}, {"lowest": 0.0}, {"highest": 1.0}])
def test_probabilities_out_of_order_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        UpdateModel(**bad)
