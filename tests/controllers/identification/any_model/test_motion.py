"""Motions and their design, against sums, closed forms and chance."""

import numpy as np
import pytest

from controllers.identification.any_model.motion import BLEND, Series, design, largest

SERIES = Series(np.array([0.5, -1.0]), 10.0, 2.0, harmonics=3)


def test_motion_is_a_series_blended_in_and_out():
    shape = np.arange(1.0, 15.0)
    offset, sines, cosines = shape[:2], shape[2:8].reshape(3, 2), shape[8:].reshape(3, 2)
    np.testing.assert_allclose(SERIES.frequencies * 10.0, np.round(SERIES.frequencies * 10.0))
    assert SERIES.frequencies[-1] == 2.0
    (found,) = SERIES.commands(shape, np.array([3.7]))
    for column in range(2):
        expected = SERIES.home[column] + offset[column]
        for number, rate in enumerate(SERIES.frequencies):
            expected += sines[number, column] * np.sin(2.0 * np.pi * rate * 3.7)
            expected += cosines[number, column] * np.cos(2.0 * np.pi * rate * 3.7)
        assert found[column] == pytest.approx(expected)
    stamps = np.linspace(0.0, 10.0, 2001)
    whole = SERIES.commands(shape, stamps)
    np.testing.assert_array_equal(whole[[0, -1]], [SERIES.home, SERIES.home])
    rates = np.abs(np.diff(whole, axis=0)).max(axis=1)
    assert rates[0] < 0.02 * rates[(stamps[1:] > BLEND)].max()


def test_a_shape_is_made_as_large_as_limits_allow():
    shape = np.array([3.0, 4.0])
    found = largest(shape, lambda each: float(np.hypot(*each)) / 20.0, 0.1)
    assert np.hypot(*found) == pytest.approx(20.0, rel=0.02)
    assert np.hypot(*found) <= 20.0
    assert not largest(shape, lambda _: np.inf, 0.1).any()


def test_design_finds_more_than_chance_does():
    target = np.random.default_rng(1).standard_normal(SERIES.size)
    target /= np.linalg.norm(target)

    def worth(shape):
        return float(shape @ target)

    def excess(shape):
        return float(np.linalg.norm(shape))

    found = design(SERIES, worth, excess, np.random.default_rng(2), 16, 12)
    generator = np.random.default_rng(2)
    chance = [SERIES.random(generator) for _ in range(192)]
    best = max(worth(each) / excess(each) for each in chance)
    assert excess(found) <= 1.0
    assert 1.0 - worth(found) < 0.5 * (1.0 - best)
