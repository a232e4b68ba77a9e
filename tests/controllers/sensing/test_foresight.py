"""Bands of predictions, against the distribution of errors that are drawn."""

import numpy as np
import pytest

from controllers.sensing.foresight import Foresight, ForesightConfig

SIGMA = np.array([0.1, 3.0, 20.0, 0.004])


def test_bands_are_those_of_the_errors_of_each_kind_of_motion():
    rng, foresight = np.random.default_rng(0), Foresight(ForesightConfig(least=20, memory=1e9))
    for _ in range(2000):
        for kind in (0, 1):
            foresight.add((1.0 + 4.0 * kind) * SIGMA * rng.standard_normal(4), kind)
    for kind in (0, 1):
        np.testing.assert_allclose(foresight.band(kind), (1.0 + 4.0 * kind) * SIGMA, rtol=0.06)
    assert len(foresight.nees) == 2 * (2000 - 20)
    # Four squares of a normal number have a mean of 1, whose variance is a half.
    assert np.mean(foresight.nees[2000:]) == pytest.approx(1.0, abs=4.0 * np.sqrt(0.5 / 1960))


def test_a_reading_that_sticks_has_no_band_and_breaks_no_other_s():
    foresight = Foresight(ForesightConfig(least=2))
    for error in (1.0, -1.0):
        foresight.add(np.array([error, 0.0]), 0)
    np.testing.assert_array_equal(foresight.band(0), [1.0, np.nan])
    foresight.add(np.array([2.0, 0.5]), 0)
    assert foresight.nees == [4.0]


@pytest.mark.parametrize(("factor", "expected"), [(0.5, 0.25), (3.0, 9.0)])
def test_errors_that_grow_leave_the_band(factor, expected):
    rng, foresight = np.random.default_rng(1), Foresight(ForesightConfig(memory=1e9))
    for _ in range(5000):
        foresight.add(SIGMA * rng.standard_normal(4), 0)
    before = len(foresight.nees)
    for _ in range(200):
        foresight.add(factor * SIGMA * rng.standard_normal(4), 0)
    # Within 200 more of 5000 the band hardly follows.
    assert np.mean(foresight.nees[before:]) == pytest.approx(expected, rel=0.25)


def test_a_band_takes_some_predictions_and_what_is_not_measured_none():
    foresight = Foresight(ForesightConfig(least=2))
    assert foresight.band(0) is None
    for error in (1.0, -1.0, 1.0):
        foresight.add(np.array([error, np.nan]), 0)
    assert foresight.nees == [1.0]
    np.testing.assert_array_equal(foresight.band(0), [1.0, np.nan])
    assert foresight.band(1) is None
    with pytest.raises(ValueError, match="foresight least = 0: expected a positive number"):
        ForesightConfig(least=0)
