"""Choice of the arm's next excitation: thesis criterion and its peers, by Levenberg-Marquardt."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from controllers.identification import PLANT_CRITERIA
from controllers.identification.arm_motion import (
    ArmLimits,
    ArmState,
    Excitation,
    swing,
)
from controllers.identification.compliant_base import ArmOnMount, BaseState, simulate
from controllers.identification.information import BITS, mutual_information
from controllers.identification.linear_estimators import regressor
from controllers.identification.parameters import COUNT, RANGES
from perception.geometry.arrays import FloatArray

REPLAN_PERIOD = 0.4
"""Time between two plans [s] (Thesis section 2.6.1)."""


@dataclasses.dataclass(frozen=True)
class EstimationState:
    """State of the estimation that a plan starts from.

    Attributes:
        parameters: (22,) current estimate.
        information: (22, 22) inverse covariance of the physical parameters.
        sigma: (24,) standard deviations of the sensors' noise.
        arm_states: State of the arm by mode.
        base_states: Estimated state of the base by mode, with sensitivities.
        regressor_square: (22, 22) sum of A^T A so far, for the condition number.
    """

    parameters: FloatArray
    information: FloatArray
    sigma: FloatArray
    arm_states: Mapping[str, ArmState]
    base_states: Mapping[str, BaseState]
    regressor_square: FloatArray


class Forecast(NamedTuple):
    """What the next window would add, in one mode or summed over the modes.

    Attributes:
        information: (22, 22) Fisher information by the physical parameters.
        regressor_square: (22, 22) sum of A^T A.
    """

    information: FloatArray
    regressor_square: FloatArray


Residuals = Callable[[Forecast], FloatArray]
Criterion = Callable[[EstimationState], Residuals]


def parameter_scale(parameters: FloatArray) -> FloatArray:
    """Return (22,) what an error is compared with: the value, or a floor where it may be zero."""
    scale = np.abs(parameters)
    scale[4:7] = np.maximum(scale[4:7], 0.1 * parameters[1:4].mean())
    scale[7:10] = np.maximum(scale[7:10], 0.03)
    return scale


def _predicted_information(state: EstimationState, ranges: FloatArray) -> Residuals:
    def residuals(forecast: Forecast) -> FloatArray:
        covariance = np.linalg.inv(state.information + forecast.information)
        sigma = np.sqrt(np.diag(covariance))
        return mutual_information(state.parameters, sigma, ranges) / BITS

    return residuals


def information(state: EstimationState) -> Residuals:
    """Thesis eq. 2-13 as its text describes it.

    V = 1/2 sum [1 - (1 - u_now) u(d)], u = In / 10 bits: the weight of a parameter is frozen at
    what is known of it now, so that the uncertain ones count most.
    """
    predict = _predicted_information(state, RANGES)
    now = predict(Forecast(np.zeros((COUNT, COUNT)), np.zeros((COUNT, COUNT))))

    def residuals(forecast: Forecast) -> FloatArray:
        return np.sqrt(1 - (1 - now) * predict(forecast))

    return residuals


def literal(state: EstimationState) -> Residuals:
    """Thesis eq. 2-13 as printed, 1 - u + u^2: its minimum lies at u = 1/2, half known."""
    predict = _predicted_information(state, RANGES)

    def residuals(forecast: Forecast) -> FloatArray:
        known = predict(forecast)
        return np.sqrt(1 - known + known**2)

    return residuals


def d_optimal(state: EstimationState) -> Residuals:
    """Least volume of the ellipsoid of uncertainty: -log det of the information."""
    scale = parameter_scale(state.parameters)

    def residuals(forecast: Forecast) -> FloatArray:
        total = (state.information + forecast.information) * np.outer(scale, scale)
        # Squares sum to a constant less log det; 50 keeps each term positive.
        pivots = np.log(np.diag(np.linalg.cholesky(total)))
        return np.sqrt(np.maximum(50 - 2 * pivots, 1e-6))

    return residuals


def a_optimal(state: EstimationState) -> Residuals:
    """Least sum of the relative variances."""
    scale = parameter_scale(state.parameters)

    def residuals(forecast: Forecast) -> FloatArray:
        covariance = np.linalg.inv(state.information + forecast.information)
        return np.sqrt(np.diag(covariance)) / scale

    return residuals


def condition(state: EstimationState) -> Residuals:
    """Condition number of the matrix A of the sensed values (Thesis section 2.6.1)."""
    return _condition(state, np.ones(COUNT))


def condition_scaled(state: EstimationState) -> Residuals:
    """Condition number of A with each column scaled to its parameter, so that units cancel."""
    return _condition(state, parameter_scale(state.parameters))


def _condition(state: EstimationState, scale: FloatArray) -> Residuals:
    def residuals(forecast: Forecast) -> FloatArray:
        square = (state.regressor_square + forecast.regressor_square) * np.outer(scale, scale)
        values = np.linalg.eigvalsh(square)
        return np.array([0.5 * np.log(values[-1] / max(values[0], 1e-18 * values[-1]))])

    return residuals


CRITERIA: dict[str, Criterion] = dict(
    zip(
        PLANT_CRITERIA,
        (information, literal, condition, condition_scaled, d_optimal, a_optimal),
        strict=True,
    )
)


class Planner:
    """Chooses offset, amplitude and frequency of every mode for the next window.

    Args:
        criterion: One of `CRITERIA`, or another of that form.
        arms: The arm in each mode.
        limits: The arm's limits.
        time_step: Sampling time [s].
        steps: Samples in the window planned for.
        iterations: Levenberg-Marquardt iterations.
        candidates: Random excitations a mode to start from, besides the present one.
    """

    def __init__(
        self,
        criterion: Criterion,
        arms: Mapping[str, ArmOnMount],
        limits: ArmLimits,
        time_step: float = 0.005,
        steps: int = 80,
        iterations: int = 1,
        candidates: int = 2,
    ) -> None:
        self._criterion = criterion
        self._arms = dict(arms)
        self._limits = limits
        self._needs_regressor = criterion in (condition, condition_scaled)
        # The forecast samples twice as coarsely as the sensors: a plan needs no better.
        self._time_step, self._steps = 2 * time_step, steps // 2
        self._iterations, self._candidates = iterations, candidates

    def plan(
        self,
        state: EstimationState,
        present: Mapping[str, Excitation],
        generator: np.random.Generator,
    ) -> dict[str, Excitation]:
        """Return the next excitation of each mode.

        Args:
            state: State of the estimation now.
            present: Excitations of the window before.
            generator: Random generator of the starting points.
        """
        residuals = self._criterion(state)
        chosen, forecasts = self._start(state, present, residuals, generator)
        damping = 1e-2
        for _ in range(self._iterations):
            values, jacobian = self._jacobian(state, chosen, forecasts, residuals)
            gradient, hessian = jacobian.T @ values, jacobian.T @ jacobian
            for _ in range(3):
                damped = hessian + damping * np.diag(np.diag(hessian) + 1e-12)
                step = np.linalg.solve(damped, -gradient).astype(np.float64)
                trial = self._moved(chosen, step)
                trial_forecasts = {m: self._forecast(state, m, trial[m]) for m in trial}
                cost = _cost(residuals, trial_forecasts)
                if cost < 0.5 * values @ values:
                    chosen, forecasts, damping = trial, trial_forecasts, damping / 10
                    break
                damping *= 10
        return chosen

    def _start(
        self,
        state: EstimationState,
        present: Mapping[str, Excitation],
        residuals: Residuals,
        generator: np.random.Generator,
    ) -> tuple[dict[str, Excitation], dict[str, Forecast]]:
        """Pick the best of a few candidates, mode after mode: their information adds up."""
        chosen = dict(present)
        forecasts = {m: self._forecast(state, m, e) for m, e in chosen.items()}
        best = _cost(residuals, forecasts)
        for mode in self._arms:
            for _ in range(self._candidates):
                candidate = random_excitation(self._limits, generator)
                trial = {**forecasts, mode: self._forecast(state, mode, candidate)}
                cost = _cost(residuals, trial)
                if cost < best:
                    best, forecasts = cost, trial
                    chosen[mode] = candidate
        return chosen, forecasts

    def _forecast(self, state: EstimationState, mode: str, excitation: Excitation) -> Forecast:
        trajectory, _ = swing(
            state.arm_states[mode], excitation, self._limits, self._steps, self._time_step
        )
        arm = self._arms[mode]
        outputs, derivatives, _ = simulate(
            state.parameters, arm, trajectory, state.base_states[mode]
        )
        weighted = (derivatives / state.sigma[:, None]).reshape(-1, COUNT)
        square = np.zeros((COUNT, COUNT))
        if self._needs_regressor:
            matrix = regressor(outputs, arm)[0].reshape(-1, COUNT)
            square = 2 * matrix.T @ matrix
        return Forecast(2 * weighted.T @ weighted, square)

    def _jacobian(
        self,
        state: EstimationState,
        chosen: Mapping[str, Excitation],
        forecasts: Mapping[str, Forecast],
        residuals: Residuals,
    ) -> tuple[FloatArray, FloatArray]:
        """Return residuals (n,) and their derivatives (n, 9) in units of the bounds' spans."""
        total = _total(forecasts)
        values = residuals(total)
        columns = []
        for mode, excitation in chosen.items():
            others = np.subtract(total, forecasts[mode])
            for axis in range(3):
                step = np.zeros(3)
                # Step inwards, so that a bound does not flatten the derivative.
                low, high = self._limits.bounds()[axis]
                inwards = excitation[axis] > (low + high) / 2
                step[axis] = -1e-3 if inwards else 1e-3
                moved = self._forecast(state, mode, self._stepped(excitation, step))
                columns.append((residuals(Forecast(*np.add(others, moved))) - values) / step[axis])
        return values, np.array(columns).T

    def _stepped(self, excitation: Excitation, step: FloatArray) -> Excitation:
        bounds = self._limits.bounds()
        vector = excitation + step * (bounds[:, 1] - bounds[:, 0])
        return Excitation(*np.clip(vector, bounds[:, 0], bounds[:, 1]).tolist())

    def _moved(self, chosen: Mapping[str, Excitation], step: FloatArray) -> dict[str, Excitation]:
        step = np.clip(step, -0.5, 0.5).reshape(-1, 3)
        return {
            mode: self._stepped(excitation, part)
            for (mode, excitation), part in zip(chosen.items(), step, strict=True)
        }


def _total(forecasts: Mapping[str, Forecast]) -> Forecast:
    return Forecast(*np.sum(list(forecasts.values()), axis=0))


def _cost(residuals: Residuals, forecasts: Mapping[str, Forecast]) -> float:
    values = residuals(_total(forecasts))
    return float(0.5 * values @ values)


def random_excitation(limits: ArmLimits, generator: np.random.Generator) -> Excitation:
    """Return a feasible excitation: uniform offset and amplitude, log-uniform frequency."""
    low, high = np.log(limits.frequency)
    return Excitation(
        generator.uniform(*limits.offset),
        generator.uniform(*limits.amplitude),
        float(np.exp(generator.uniform(low, high))),
    )
