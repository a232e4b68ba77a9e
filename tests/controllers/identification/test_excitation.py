"""The planner: its criteria, its derivatives, and that its plans are better than their start."""

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
    EstimationState,
    Forecast,
    Planner,
    parameter_scale,
    random_excitation,
)
from controllers.identification.linear_estimators import regressor
from controllers.identification.parameters import COUNT, RANGES
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
def state() -> EstimationState:
    """After one window of each mode."""
    outputs, sigma = noisy(0, windows=1)
    paths = {mode: motion(mode, windows=1) for mode in MODES}
    estimate = fit(outputs, paths, sigma)
    arm_states, base_states = {}, {}
    for mode, path in paths.items():
        arm_states[mode] = ArmState(path.angle[-1], path.rate[-1], path.acceleration[-1])
        start = BaseState.at_rest()
        base_states[mode] = simulate(estimate.parameters, ARMS[mode], path, start)[2]
    square = np.diag(1 / parameter_scale(TRUTH) ** 2)
    information = estimate.physical_information()
    return EstimationState(estimate.parameters, information, sigma, arm_states, base_states, square)


def added(*forecasts: Forecast) -> Forecast:
    return Forecast(*np.sum(forecasts, axis=0))


def cost(planner: Planner, state: EstimationState, plan: dict[str, Excitation], name: str) -> float:
    forecasts = [planner._forecast(state, mode, plan[mode]) for mode in plan]
    total = added(*forecasts)
    return 0.5 * float(np.sum(CRITERIA[name](state)(total) ** 2))


@pytest.mark.parametrize("name", CRITERIA)
def test_plan_is_no_worse_than_its_start_and_within_the_bounds(state, name):
    present = dict.fromkeys(MODES, CONSTANT)
    planner = Planner(CRITERIA[name], ARMS, LIMITS, iterations=2)
    plan = planner.plan(state, present, np.random.default_rng(0))
    before, after = (cost(planner, state, p, name) for p in (present, plan))
    assert after < before
    for excitation in plan.values():
        bounds = LIMITS.bounds()
        assert np.all(np.array(excitation) >= bounds[:, 0] - 1e-12)
        assert np.all(np.array(excitation) <= bounds[:, 1] + 1e-12)


def test_iterations_of_levenberg_and_marquardt_lower_the_cost_further(state):
    present = {mode: Excitation(0.8, 0.4, 6.0) for mode in MODES}
    costs = []
    for iterations in (0, 1, 4):
        planner = Planner(
            CRITERIA["information"], ARMS, LIMITS, iterations=iterations, candidates=0
        )
        plan = planner.plan(state, present, np.random.default_rng(0))
        costs.append(cost(planner, state, plan, "information"))
    assert costs[0] > costs[1] > costs[2]


def test_jacobian_equals_finer_central_differences(state):
    planner = Planner(CRITERIA["information"], ARMS, LIMITS)
    residuals = CRITERIA["information"](state)
    chosen = {mode: Excitation(0.8, 0.4, 6.0) for mode in MODES}
    forecasts = {mode: planner._forecast(state, mode, chosen[mode]) for mode in MODES}
    total = added(*forecasts.values())
    values, jacobian = planner._jacobian(state, chosen, forecasts, residuals)
    np.testing.assert_allclose(values, residuals(total))
    step = 1e-4
    for column in range(9):
        mode, axis = MODES[column // 3], column % 3
        ends = []
        for sign in (1, -1):
            moved = planner._stepped(chosen[mode], sign * step * np.eye(3)[axis])
            other = planner._forecast(state, mode, moved)
            ends.append(residuals(added(*{**forecasts, mode: other}.values())))
        expected = (ends[0] - ends[1]) / (2 * step)
        error = np.linalg.norm(jacobian[:, column] - expected)
        assert error <= 0.03 * np.linalg.norm(expected) + 1e-4


def test_forecast_is_the_information_that_the_window_then_brings(state):
    planner = Planner(CRITERIA["information"], ARMS, LIMITS)
    excitation = Excitation(0.5, 0.5, 9.0)
    found = planner._forecast(state, "x", excitation).information
    path, _ = swing(state.arm_states["x"], excitation, LIMITS, WINDOW, 0.005)
    _, derivatives, _ = simulate(
        state.parameters, ARMS["x"], path, state.base_states["x"], substeps=2
    )
    rows = (derivatives / state.sigma[:, None]).reshape(-1, COUNT)
    expected = rows.T @ rows
    # Sampled twice as coarsely and counted twice; what says next to nothing may differ more.
    np.testing.assert_allclose(
        np.diag(found) * TRUTH**2, np.diag(expected) * TRUTH**2, rtol=0.5, atol=0.05
    )


def test_forecast_counts_each_equation_of_its_coarse_samples_twice(state):
    planner, excitation = Planner(CRITERIA["condition"], ARMS, LIMITS), Excitation(0.5, 0.5, 9.0)
    path, _ = swing(state.arm_states["x"], excitation, LIMITS, WINDOW // 2, 0.01)
    outputs, _, _ = simulate(state.parameters, ARMS["x"], path, state.base_states["x"])
    matrix = regressor(outputs, ARMS["x"])[0].reshape(-1, COUNT)
    found = planner._forecast(state, "x", excitation)
    np.testing.assert_allclose(found.regressor_square, 2 * matrix.T @ matrix, rtol=1e-9, atol=1e-9)


def test_start_is_the_best_of_its_candidates(state):
    arms, present = {"x": ARMS["x"]}, {"x": CONSTANT}
    planner = Planner(CRITERIA["information"], arms, LIMITS, iterations=0, candidates=8)
    generator = np.random.default_rng(0)
    offered = [CONSTANT, *(random_excitation(LIMITS, generator) for _ in range(8))]
    residuals = CRITERIA["information"](state)
    costs = [np.sum(residuals(planner._forecast(state, "x", e)) ** 2) for e in offered]
    best = offered[int(np.argmin(costs))]
    assert planner.plan(state, present, np.random.default_rng(0))["x"] == best


def test_step_descends_along_the_gradient_at_its_start(state):
    present = {mode: Excitation(0.8, 0.4, 6.0) for mode in MODES}
    planner = Planner(CRITERIA["d_optimal"], ARMS, LIMITS, iterations=1, candidates=0)
    forecasts = {mode: planner._forecast(state, mode, present[mode]) for mode in MODES}
    values, jacobian = planner._jacobian(state, present, forecasts, CRITERIA["d_optimal"](state))
    plan = planner.plan(state, present, np.random.default_rng(0))
    span = np.ptp(LIMITS.bounds(), axis=1)
    moved = [(np.subtract(plan[mode], present[mode])) / span for mode in MODES]
    assert np.concatenate(moved) @ (jacobian.T @ values) < 0


def test_derivative_at_a_bound_is_taken_inwards(state):
    planner = Planner(CRITERIA["information"], ARMS, LIMITS)
    residuals = CRITERIA["information"](state)
    for end in (0, 1):
        chosen = {mode: Excitation(*LIMITS.bounds()[:, end].tolist()) for mode in MODES}
        forecasts = {mode: planner._forecast(state, mode, chosen[mode]) for mode in MODES}
        _, jacobian = planner._jacobian(state, chosen, forecasts, residuals)
        assert np.any(jacobian[:, 2::3] != 0)
        step = np.zeros(3)
        step[2] = 1e-3 if end == 0 else -1e-3
        total = added(*forecasts.values())
        inner = planner._forecast(state, "x", planner._stepped(chosen["x"], step))
        change = residuals(added(*{**forecasts, "x": inner}.values())) - residuals(total)
        np.testing.assert_allclose(jacobian[:, 2], change / step[2], rtol=1e-6, atol=1e-9)


def bits_known(state: EstimationState, part: float) -> EstimationState:
    """The same, where each deviation is that part of its range and the estimate in its middle."""
    bounds = RANGES
    sigma = part * (bounds[:, 1] - bounds[:, 0])
    return dataclasses.replace(
        state, parameters=bounds.mean(axis=1), information=np.diag(sigma**-2)
    )


def test_literal_criterion_is_least_where_half_is_known(state):
    costs = {}
    for wanted in (0.1, 0.3, 0.5, 0.7, 0.9):
        # u = (log2(range / sigma) - 2.05) / 10
        sharp = bits_known(state, 2 ** -(10 * wanted + 2.047))
        values = CRITERIA["literal"](sharp)(NOTHING)
        np.testing.assert_allclose(values**2, 1 - wanted + wanted**2, atol=0.02)
        costs[wanted] = float(values @ values)
    assert min(costs, key=costs.__getitem__) == 0.5
    assert costs[0.9] > costs[0.7] and costs[0.1] > costs[0.3]


def test_information_criterion_weighs_by_what_is_unknown_now(state):
    for known in (0.2, 0.5, 0.8):
        sharp = bits_known(state, 2 ** -(10 * known + 2.047))
        values = CRITERIA["information"](sharp)(NOTHING)
        np.testing.assert_allclose(values**2, 1 - (1 - known) * known, atol=0.02)


def test_information_criterion_always_gains_by_knowing_more_and_most_by_the_uncertain(state):
    vague = bits_known(state, 0.05)
    residuals = CRITERIA["information"](vague)
    sigma = 0.05 * np.ptp(RANGES, axis=1)
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


def test_d_and_a_optimal_are_determinant_and_trace_of_the_relative_covariance(state):
    scale = parameter_scale(state.parameters)
    covariance = np.linalg.inv(state.information) / np.outer(scale, scale)
    d_values = CRITERIA["d_optimal"](state)(NOTHING)
    log_determinant = np.linalg.slogdet(covariance)[1]
    assert np.sum(d_values**2) == pytest.approx(50 * COUNT + log_determinant, rel=1e-6)
    a_values = CRITERIA["a_optimal"](state)(NOTHING)
    assert np.sum(a_values**2) == pytest.approx(np.trace(covariance), rel=1e-6)


def test_condition_criteria_are_the_logarithm_of_the_condition_number(state):
    scale = parameter_scale(state.parameters)
    generator = np.random.default_rng(0)
    matrix = generator.normal(size=(60, COUNT)) / scale
    seen = dataclasses.replace(state, regressor_square=matrix.T @ matrix)
    scaled = CRITERIA["condition_scaled"](seen)(NOTHING)[0]
    assert np.exp(scaled) == pytest.approx(np.linalg.cond(matrix * scale), rel=1e-6)
    flat = dataclasses.replace(seen, regressor_square=(matrix * scale).T @ (matrix * scale))
    plain = CRITERIA["condition"](flat)(NOTHING)[0]
    assert np.exp(plain) == pytest.approx(np.linalg.cond(matrix * scale), rel=1e-6)


def test_random_excitations_fill_the_bounds():
    generator = np.random.default_rng(1)
    drawn = np.array([random_excitation(LIMITS, generator) for _ in range(2000)])
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


def test_floor_of_an_inertia_is_a_tenth_of_the_mean_mass():
    parameters = np.zeros(COUNT)
    parameters[1:4] = [0.9, 0.2, 0.1]
    np.testing.assert_allclose(parameter_scale(parameters)[4:7], 0.04)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_one_step_of_a_plan_is_at_most_half_of_the_bounds(sign):
    planner, bounds = Planner(CRITERIA["information"], ARMS, LIMITS), LIMITS.bounds()
    start = {"x": Excitation(*bounds[:, 0 if sign > 0 else 1].tolist())}
    moved = planner._moved(start, np.array([0.3, 3.0, 0.5]) * sign)["x"]
    span = np.ptp(bounds, axis=1)
    np.testing.assert_allclose(
        np.subtract(moved, start["x"]) / span, sign * np.array([0.3, 0.5, 0.5])
    )
