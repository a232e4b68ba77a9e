"""The 22 parameters: what is refused, the prior's derivatives, and the way to stay physical."""

import numpy as np
import pytest

from controllers.identification.parameters import (
    COUNT,
    NAMES,
    RANGES,
    ParameterError,
    Prior,
    average_error_percent,
    check_physical,
    coordinate_scale,
    from_coordinates,
    from_mapping,
    inertia_tensor,
    largest_physical_step,
    second_moments,
    to_coordinates,
)
from models.datasheets import TABLE_2_1_CONSTANT, TABLE_2_1_TRUTH

TRUTH = from_mapping(TABLE_2_1_TRUTH)


def random_body(generator: np.random.Generator) -> np.ndarray:
    """Parameters of a cloud of points on springs."""
    points = generator.normal(size=(20, 3)) * generator.uniform(0.05, 0.4, 3)
    moments = points.T @ points / 20
    tensor = np.trace(moments) * np.eye(3) - moments
    vector = np.exp(generator.normal(size=COUNT))
    vector[1:7] = tensor[[0, 1, 2, 0, 1, 0], [0, 1, 2, 2, 2, 1]]
    return vector


@pytest.mark.parametrize(
    "change, message",
    [
        ({"mass": -3.0}, "mass = -3.0: must be positive"),
        ({"kz": 0.0}, "kz = 0.0"),
        ({"b_yaw": float("nan")}, "b_yaw = nan"),
        ({"rx": float("inf")}, "rx is not finite"),
        ({"ixx": 0.5}, "no mass distribution"),
        ({"iyz": 0.2}, "no mass distribution"),
        ({"weight": 3.0}, r"unknown \['weight'\]"),
        ({"mass": "heavy"}, "heavy"),
    ],
)
def test_impossible_parameter_is_refused_by_name(change, message):
    with pytest.raises(ParameterError, match=message):
        from_mapping({**TABLE_2_1_TRUTH, **change})


def test_missing_parameter_is_named():
    values = {name: TABLE_2_1_TRUTH[name] for name in NAMES if name != "izz"}
    with pytest.raises(ParameterError, match=r"missing \['izz'\]"):
        from_mapping(values)


def test_second_moments_are_those_of_the_mass_points():
    generator = np.random.default_rng(0)
    points = generator.normal(size=(6, 3))
    tensor = sum(p @ p * np.eye(3) - np.outer(p, p) for p in points)
    vector = np.array(TRUTH)
    vector[1:7] = tensor[[0, 1, 2, 0, 1, 0], [0, 1, 2, 2, 2, 1]]
    np.testing.assert_allclose(inertia_tensor(vector), tensor)
    np.testing.assert_allclose(second_moments(vector), points.T @ points, atol=1e-12)


def test_coordinates_invert_and_their_scale_is_the_derivative():
    coordinates = to_coordinates(TRUTH)
    np.testing.assert_allclose(from_coordinates(coordinates), TRUTH)
    step = 1e-6
    for index, scale in enumerate(coordinate_scale(coordinates)):
        unit = np.eye(COUNT)[index] * step
        change = from_coordinates(coordinates + unit) - from_coordinates(coordinates - unit)
        np.testing.assert_allclose(change[index] / (2 * step), scale, rtol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_gradient_of_the_prior_equals_central_differences(seed):
    prior, coordinates = Prior(), to_coordinates(random_body(np.random.default_rng(seed)))
    _, gradient, _ = prior.term(coordinates)
    for index in range(COUNT):
        unit = np.eye(COUNT)[index] * 1e-6 * max(abs(coordinates[index]), 1e-2)
        change = prior.term(coordinates + unit)[0] - prior.term(coordinates - unit)[0]
        expected = change / (2 * unit[index])
        np.testing.assert_allclose(gradient[index], expected, rtol=1e-5, atol=1e-5)


def test_information_of_the_prior_is_its_curvature_where_the_cost_is_least():
    prior = Prior()
    mean = prior.mean()
    cost, gradient, information = prior.term(mean)
    assert cost == pytest.approx(0, abs=1e-20)
    np.testing.assert_allclose(gradient, 0, atol=1e-10)
    step = 1e-5
    rows = [
        prior.term(mean + step * unit)[1] - prior.term(mean - step * unit)[1]
        for unit in np.eye(COUNT)
    ]
    curvature = np.array(rows) / (2 * step)
    np.testing.assert_allclose(information, curvature, rtol=1e-6, atol=1e-4)


def test_prior_matters_only_along_what_the_data_know_less_well_than_asked():
    generator = np.random.default_rng(2)
    coordinates = to_coordinates(random_body(generator))
    _, change = Prior().deviations(coordinates)
    turn, _ = np.linalg.qr(generator.normal(size=(COUNT, COUNT)))
    information = np.geomspace(1e-2, 1e6, COUNT)
    data = change.T @ (turn * information) @ turn.T @ change
    found = Prior().noticeable(coordinates, data, share=0.01)
    weak = turn[:, information < 99.0]
    np.testing.assert_allclose(found @ found.T, weak @ weak.T, atol=1e-6)


def test_parts_of_the_prior_add_up_to_the_whole():
    generator = np.random.default_rng(3)
    coordinates = to_coordinates(random_body(generator))
    turn, _ = np.linalg.qr(generator.normal(size=(COUNT, COUNT)))
    parts = [Prior().term(coordinates, turn[:, rows]) for rows in (slice(0, 5), slice(5, COUNT))]
    for whole, *pieces in zip(Prior().term(coordinates), *parts, strict=True):
        np.testing.assert_allclose(sum(pieces), whole, rtol=1e-9, atol=1e-9)


def test_prior_grows_without_bound_towards_a_flat_body():
    costs = []
    for thickness in (1e-1, 1e-3, 1e-6, 1e-9):
        flat = np.array(TRUTH)
        flat[1:7] = [0.1 + thickness, 0.1 + thickness, 0.2, 0, 0, 0]
        costs.append(Prior().term(to_coordinates(flat))[0])
    assert np.all(np.diff(costs) > 5)


def test_a_step_is_shortened_so_that_it_stays_inside_a_body():
    generator = np.random.default_rng(1)
    shortened = 0
    for _ in range(200):
        start = to_coordinates(random_body(generator))
        step = generator.normal(size=COUNT)
        step[1:7] *= np.exp(generator.uniform(np.log(1e-4), 0))
        factor = largest_physical_step(start, step)
        assert 0 < factor <= 1
        end = second_moments(start + factor * step)
        # What is left of the second moment in any direction is at least a tenth.
        left = np.linalg.eigvals(np.linalg.solve(second_moments(start), end))
        assert left.real.min() > 0.0999
        check_physical(from_coordinates(start + factor * step))
        shortened += factor < 1
    assert 20 < shortened < 200


def test_a_step_without_change_of_the_inertia_is_taken_whole():
    step = np.ones(COUNT)
    step[1:7] = 0
    assert largest_physical_step(to_coordinates(TRUTH), step) == 1


def test_average_error_of_table_2_1_is_over_its_20_non_zero_rows():
    constant = np.array([TABLE_2_1_CONSTANT[name] for name in NAMES])
    assert average_error_percent(constant, TRUTH) == pytest.approx(110.1, abs=0.05)


def test_truth_of_table_2_1_lies_inside_the_ranges_and_not_at_their_middle():
    bounds = RANGES
    assert np.all((TRUTH > bounds[:, 0]) & (TRUTH < bounds[:, 1]))
    middle = bounds.mean(axis=1)
    span = bounds[:, 1] - bounds[:, 0]
    away = np.abs(TRUTH - middle) / span
    # Products of inertia are zero in the table, and in the middle of any symmetric range.
    assert np.sum(away < 0.02) <= 3
