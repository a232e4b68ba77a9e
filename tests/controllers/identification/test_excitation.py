"""The planner: its criteria, its derivatives, and that its plans are better than their start."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from controllers.identification.arm_motion import (
    CONSTANT,
    MODES,
    ArmLimits,
    ArmState,
    Excitation,
    swing,
)
from controllers.identification.compliant_base import BaseState, simulate
from controllers.identification.excitation import (
    CRITERIA,
    Forecast,
    Knowledge,
    Planner,
    parameter_scale,
    random_excitation,
)
from controllers.identification.parameters import COUNT, Ranges
from tests.controllers.identification.recorded import (
    ARMS,
    TRUTH,
    WINDOW,
    fit,
    motion,
    noise_bound,
    noisy,
    predicted,
)

LIMITS = ArmLimits()
NOTHING = Forecast(np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT)))


@pytest.fixture(scope="module")
def knowledge() -> Knowledge:
    """After one window of each mode."""
    outputs, sigma = noisy(0, windows=1)
    paths = {mode: motion(mode, windows=1) for mode in MODES}
    estimate = fit(outputs, paths, sigma, restarts=0)
    arm_states, base_states = {}, {}
    for mode, path in paths.items():
        arm_states[mode] = ArmState(path.angle[-1], path.rate[-1], path.acceleration[-1])
        start = BaseState.at_rest()
        base_states[mode] = simulate(estimate.parameters, ARMS[mode], path, start)[2]
    square = np.diag(1 / parameter_scale(TRUTH) ** 2)
    information = estimate.physical_information()
    return Knowledge(estimate.parameters, information, sigma, arm_states, base_states, square)


def cost(planner: Planner, knowledge: Knowledge, plan: dict[str, Excitation], name: str) -> float:
    forecasts = [planner._forecast(knowledge, mode, plan[mode]) for mode in plan]
    total = forecasts[0] + forecasts[1] + forecasts[2]
    return 0.5 * float(np.sum(CRITERIA[name](knowledge)(total) ** 2))


@pytest.mark.parametrize("name", CRITERIA)
def test_plan_is_no_worse_than_its_start_and_within_the_bounds(knowledge, name):
    present = dict.fromkeys(MODES, CONSTANT)
    planner = Planner(CRITERIA[name], ARMS, LIMITS, iterations=2)
    plan = planner.plan(knowledge, present, np.random.default_rng(0))
    before, after = (cost(planner, knowledge, p, name) for p in (present, plan))
    assert after < before
    for excitation in plan.values():
        bounds = LIMITS.bounds()
        assert np.all(excitation.vector() >= bounds[:, 0] - 1e-12)
        assert np.all(excitation.vector() <= bounds[:, 1] + 1e-12)


def test_iterations_of_levenberg_and_marquardt_lower_the_cost_further(knowledge):
    present = {mode: Excitation(0.8, 0.4, 6.0) for mode in MODES}
    costs = []
    for iterations in (0, 1, 4):
        planner = Planner(
            CRITERIA["information"], ARMS, LIMITS, iterations=iterations, candidates=0
        )
        plan = planner.plan(knowledge, present, np.random.default_rng(0))
        costs.append(cost(planner, knowledge, plan, "information"))
    assert costs[0] > costs[1] > costs[2]


def test_jacobian_equals_finer_central_differences(knowledge):
    planner = Planner(CRITERIA["information"], ARMS, LIMITS)
    residuals = CRITERIA["information"](knowledge)
    chosen = {mode: Excitation(0.8, 0.4, 6.0) for mode in MODES}
    forecasts = {mode: planner._forecast(knowledge, mode, chosen[mode]) for mode in MODES}
    total = forecasts["x"] + forecasts["y"] + forecasts["z"]
    values, jacobian = planner._jacobian(knowledge, chosen, forecasts, residuals)
    np.testing.assert_allclose(values, residuals(total))
    step = 1e-4
    for column in range(9):
        mode, axis = MODES[column // 3], column % 3
        ends = []
        for sign in (1, -1):
            moved = planner._stepped(chosen[mode], sign * step * np.eye(3)[axis])
            other = planner._forecast(knowledge, mode, moved)
            ends.append(residuals(total - forecasts[mode] + other))
        expected = (ends[0] - ends[1]) / (2 * step)
        error = np.linalg.norm(jacobian[:, column] - expected)
        assert error <= 0.03 * np.linalg.norm(expected) + 1e-4


def test_forecast_is_the_information_that_the_window_then_brings(knowledge):
    planner = Planner(CRITERIA["information"], ARMS, LIMITS)
    excitation = Excitation(0.5, 0.5, 9.0)
    found = planner._forecast(knowledge, "x", excitation).information
    path, _ = swing(knowledge.arm_states["x"], excitation, LIMITS, WINDOW, 0.005)
    _, derivatives, _ = simulate(
        knowledge.parameters, ARMS["x"], path, knowledge.base_states["x"], substeps=2
    )
    rows = (derivatives / knowledge.sigma[:, None]).reshape(-1, COUNT)
    expected = rows.T @ rows
    # Sampled twice as coarsely and counted twice; what says next to nothing may differ more.
    np.testing.assert_allclose(
        np.diag(found) * TRUTH**2, np.diag(expected) * TRUTH**2, rtol=0.5, atol=0.05
    )


def bits_known(knowledge: Knowledge, part: float) -> Knowledge:
    """The same, where each deviation is that part of its range and the estimate in its middle."""
    bounds = Ranges().bounds()
    sigma = part * (bounds[:, 1] - bounds[:, 0])
    return dataclasses.replace(
        knowledge, parameters=bounds.mean(axis=1), information=np.diag(sigma**-2)
    )


def test_literal_criterion_is_least_where_half_is_known(knowledge):
    costs = {}
    for wanted in (0.1, 0.3, 0.5, 0.7, 0.9):
        # u = (log2(range / sigma) - 2.05) / 10
        sharp = bits_known(knowledge, 2 ** -(10 * wanted + 2.047))
        values = CRITERIA["literal"](sharp)(NOTHING)
        np.testing.assert_allclose(values**2, 1 - wanted + wanted**2, atol=0.02)
        costs[wanted] = float(values @ values)
    assert min(costs, key=costs.__getitem__) == 0.5
    assert costs[0.9] > costs[0.7] and costs[0.1] > costs[0.3]


def test_information_criterion_always_gains_by_knowing_more_and_most_by_the_uncertain(knowledge):
    vague = bits_known(knowledge, 0.05)
    residuals = CRITERIA["information"](vague)
    sigma = 0.05 * np.ptp(Ranges().bounds(), axis=1)
    costs = [
        float(np.sum(residuals(Forecast(gain * np.diag(sigma**-2), NOTHING.regressor_square)) ** 2))
        for gain in (0, 1, 10, 100, 1000)
    ]
    assert np.all(np.diff(costs) < 0)
    known = vague.information.copy()
    known[0, 0] *= 1e4
    sharp = dataclasses.replace(vague, information=known)
    residuals = CRITERIA["information"](sharp)
    gains = []
    for index in (0, 1):
        more = np.zeros((COUNT, COUNT))
        more[index, index] = 3 * sharp.information[index, index]
        change = residuals(Forecast(more, more)) ** 2 - residuals(NOTHING) ** 2
        gains.append(-change.sum())
    assert gains[1] > 2 * gains[0]


def test_d_and_a_optimal_are_determinant_and_trace_of_the_relative_covariance(knowledge):
    scale = parameter_scale(knowledge.parameters)
    covariance = np.linalg.inv(knowledge.information) / np.outer(scale, scale)
    d_values = CRITERIA["d_optimal"](knowledge)(NOTHING)
    log_determinant = np.linalg.slogdet(covariance)[1]
    assert np.sum(d_values**2) == pytest.approx(50 * COUNT + log_determinant, rel=1e-6)
    a_values = CRITERIA["a_optimal"](knowledge)(NOTHING)
    assert np.sum(a_values**2) == pytest.approx(np.trace(covariance), rel=1e-6)


def test_condition_criteria_are_the_logarithm_of_the_condition_number(knowledge):
    scale = parameter_scale(knowledge.parameters)
    generator = np.random.default_rng(0)
    matrix = generator.normal(size=(60, COUNT)) / scale
    seen = dataclasses.replace(knowledge, regressor_square=matrix.T @ matrix)
    scaled = CRITERIA["condition_scaled"](seen)(NOTHING)[0]
    assert np.exp(scaled) == pytest.approx(np.linalg.cond(matrix * scale), rel=1e-6)
    flat = dataclasses.replace(seen, regressor_square=(matrix * scale).T @ (matrix * scale))
    plain = CRITERIA["condition"](flat)(NOTHING)[0]
    assert np.exp(plain) == pytest.approx(np.linalg.cond(matrix * scale), rel=1e-6)


def test_random_excitations_fill_the_bounds():
    generator = np.random.default_rng(1)
    drawn = np.array([random_excitation(LIMITS, generator).vector() for _ in range(2000)])
    bounds = LIMITS.bounds()
    assert np.all((drawn >= bounds[:, 0]) & (drawn <= bounds[:, 1]))
    assert np.median(drawn[:, 2]) == pytest.approx(np.sqrt(0.5 * 30), rel=0.1)
    assert np.ptp(drawn[:, 0]) > 0.98 * np.ptp(bounds[0])


def test_scale_of_a_parameter_that_may_be_zero_has_a_floor():
    scale = parameter_scale(np.zeros(COUNT) + np.where(np.arange(COUNT) < 4, 0.3, 0.0))
    np.testing.assert_allclose(scale[4:7], 0.03)
    np.testing.assert_allclose(scale[7:10], 0.03)


def test_noise_is_a_tenth_of_the_greatest_value():
    outputs = {mode: predicted(mode) for mode in MODES}
    assert noise_bound(outputs)[20] == pytest.approx(
        0.1 * max(np.abs(samples[:, 20]).max() for samples in outputs.values())
    )
