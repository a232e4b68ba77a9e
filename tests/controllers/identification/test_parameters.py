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
    closest_body,
    coordinate_scale,
    from_coordinates,
    from_mapping,
    inertia_tensor,
    physical_step,
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


def test_a_step_is_bent_so_that_it_ends_at_a_body():
    generator = np.random.default_rng(1)
    bent = 0
    for _ in range(200):
        start = to_coordinates(random_body(generator))
        step = generator.normal(size=COUNT)
        step[1:7] *= np.exp(generator.uniform(np.log(1e-4), np.log(1e2)))
        found = physical_step(start, step)
        np.testing.assert_array_equal(np.delete(found, np.s_[1:7]), np.delete(step, np.s_[1:7]))
        end = second_moments(start + found)
        ratios = np.linalg.eigvals(np.linalg.solve(second_moments(start), end)).real
        assert ratios.min() > 0.0999 and ratios.max() < 10.2
        check_physical(from_coordinates(start + found))
        values = np.linalg.eigvalsh(end)
        assert values[0] > 0.999e-4 * values[-1]
        bent += not np.allclose(found, step)
    assert 20 < bent < 200


def test_a_step_to_a_body_near_by_is_taken_whole():
    step = np.ones(COUNT)
    step[1:7] = 0.02 * TRUTH[1:7]
    np.testing.assert_allclose(physical_step(to_coordinates(TRUTH), step), step, atol=1e-15)


def test_closest_body_to_a_body_is_itself_and_others_are_mended_where_they_must_be():
    least = 0.01 * from_coordinates(Prior().mean())
    np.testing.assert_allclose(closest_body(TRUTH, least), TRUTH, atol=1e-15)
    generator = np.random.default_rng(4)
    for _ in range(100):
        values = random_body(generator) + generator.normal(size=COUNT)
        body = closest_body(values, least)
        check_physical(body)
        np.testing.assert_array_equal(body[7:10], values[7:10])
        others = [0, *range(10, COUNT)]
        np.testing.assert_array_equal(body[others], np.maximum(values, least)[others])
        # No direction that had enough is changed: the mended moments exceed those given by no more
        # than the floor in the directions that lacked it.
        before, after = np.linalg.eigvalsh(second_moments(values)), second_moments(body)
        np.testing.assert_allclose(
            np.linalg.eigvalsh(after), np.maximum(before, np.linalg.eigvalsh(after)[0]), atol=1e-12
        )


def test_draws_of_the_prior_are_bodies_that_lie_as_far_off_the_guess_as_it_says():
    generator, prior = np.random.default_rng(5), Prior()
    draws = [prior.draw(generator) for _ in range(2000)]
    for draw in draws[:100]:
        check_physical(from_coordinates(draw))
    deviations = np.array([prior.deviations(draw)[0] for draw in draws])
    # 2000 draws: the mean is known to 0.022, the covariance to 0.022 (0.032 on its diagonal).
    np.testing.assert_allclose(deviations.mean(axis=0), 0, atol=0.1)
    np.testing.assert_allclose(np.cov(deviations.T), np.eye(COUNT), atol=0.14)


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
