"""The rating of a view (eq. 4-1 to 4-4) by hand, and what is no lens, target or exponent."""

import math

import numpy as np
import pytest

from controllers.placement.task import (
    Exponents,
    Lens,
    Target,
    rate_view,
    rating_terms,
    sharpness,
)

LENS = Lens(math.pi / 2, 100, 1.0, 5.0)
"""A pixel is 0.02 m wide for each metre of distance, as tan(45 deg) = 1."""
OUTLINE = [[-0.1, 0.0], [0.1, 0.0]]
PRIMARY = Target("hole", [0.0, 0.0], [0.0, 1.0], OUTLINE)
SECONDARY = Target("mark", [0.0, 0.0], [0.0, 1.0], OUTLINE, relation_error=0.01)


def rating(distance=2.0, cap=0.5, cosine=0.8, occupancy=0.02, target=PRIMARY, **exponents):
    terms = rating_terms(LENS, target, Exponents(**exponents))
    return rate_view(terms, distance, cap, cosine, occupancy)


def test_rating_is_the_product_of_equation_4_1():
    assert LENS.pixel_per_metre == pytest.approx(0.02)
    assert rating() == pytest.approx(1.0 / 0.04 * 0.5 * 0.8 * 0.98)
    assert rating(resolution=2.0) == pytest.approx(1.0 / 0.04**2 * 0.5 * 0.8 * 0.98)
    assert rating(field=2.0, angle=3.0) == pytest.approx(1.0 / 0.04 * 0.25 * 0.512 * 0.98)


def test_secondary_target_is_blurred_by_its_relation_error():
    assert rating(target=SECONDARY) == pytest.approx(1.0 / 0.05 * 0.5 * 0.8 * 0.98)
    primary, secondary = (rating_terms(LENS, each, Exponents()) for each in (PRIMARY, SECONDARY))
    assert sharpness(primary, 2.0) == pytest.approx(25.0)
    assert sharpness(secondary, 2.0) == pytest.approx(20.0)
    assert sharpness(secondary, 4.0) == pytest.approx(1.0 / 0.09)


@pytest.mark.parametrize(
    "change",
    [{"cap": 0.0}, {"cap": -0.1}, {"cosine": 0.0}, {"cosine": -0.5}, {"occupancy": 0.05}],
)
def test_hidden_averted_and_taken_places_are_no_view_whatever_the_exponents(change):
    assert rating(**change) == 0.0
    assert rating(**change, depth=0.0, resolution=0.0, field=0.0, angle=0.0) == 0.0


def test_place_is_free_below_a_chance_of_a_twentieth():
    assert rating(occupancy=0.0499) == pytest.approx(1.0 / 0.04 * 0.5 * 0.8 * 0.9501)


@pytest.mark.parametrize("distance", [0.999, 5.001])
def test_target_out_of_focus_is_a_view_only_without_the_depth_of_field(distance):
    assert rating(distance) == 0.0
    assert rating(distance, depth=0.0) > 0.0
    assert rating(1.0) > 0.0 and rating(5.0) > 0.0


def test_senseless_lenses_exponents_and_targets_are_refused():
    for numbers in [(0.0, 100, 1.0, 5.0), (4.0, 100, 1.0, 5.0), (0.7, 0, 1.0, 5.0)]:
        with pytest.raises(ValueError, match="expected"):
            Lens(*numbers)
    for near, far in [(5.0, 1.0), (0.0, 1.0), (1.0, math.inf)]:
        with pytest.raises(ValueError, match="expected 0 < near < far"):
            Lens(0.7, 100, near, far)
    for wrong in (-0.1, math.inf, math.nan):
        with pytest.raises(ValueError, match="exponent field"):
            Exponents(field=wrong)
    with pytest.raises(ValueError, match="no unit vector"):
        Target("hole", [0.0, 0.0], [0.0, 1.1], OUTLINE)
    for wrong in (-0.1, math.nan):
        with pytest.raises(ValueError, match="relation_error"):
            Target("hole", [0.0, 0.0], [0.0, 1.0], OUTLINE, wrong)
    with pytest.raises(ValueError, match="do not fit"):
        Target("hole", [0.0, 0.0], [0.0, 1.0], [[0.1, 0.0, 0.0]])


def test_target_keeps_its_own_copy_that_cannot_change():
    outline = np.array(OUTLINE)
    target = Target("hole", [0.0, 0.0], [0.0, 1.0], outline)
    outline[:] = 9.0
    np.testing.assert_array_equal(target.outline, OUTLINE)
    with pytest.raises(ValueError, match="read-only"):
        target.position[0] = 1.0
