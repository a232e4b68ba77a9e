"""Our estimator: fit of the outputs, the noise where it is.

Both sides of A x = F are measured, so least squares on it is biased (errors in variables). Here
the base's motion and the wrench are simulated from the arm's known motion and compared with all
that was measured; Gauss-Newton with the model's sensitivities, in coordinates in which every point
is a physical body.

The final fit starts where least squares with that bias taken out lead, a few per cent from the end:
from the prior's guess many robots unlike it are never reached.

A weak prior holds what the data do not determine. On line it counts in
full (maximum a posteriori). In the final fit it counts only in those combinations of parameters
along which it gives a noticeable share of the information; all others are as the data alone have
them (maximum likelihood). There it could no longer sharpen the fit, only pull it towards the guess.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from controllers.identification.arm_motion import Trajectory
from controllers.identification.compliant_base import CHANNELS, ArmOnMount, BaseState, simulate
from controllers.identification.linear_estimators import (
    Equations,
    MeasurementError,
    check_finite,
    compensated,
)
from controllers.identification.parameters import (
    COUNT,
    INERTIA,
    Prior,
    closest_body,
    coordinate_scale,
    from_coordinates,
    physical_step,
    to_coordinates,
)
from perception.geometry.arrays import FloatArray

CHI_SQUARE_TOLERANCE = 0.01
"""How far chi^2 per measurement may lie from 1 before the fit is refused."""

SMALLEST_GAIN = 1e-4
"""Gain of half the squared residuals at which a fit has converged, 0.014 deviations away."""

LARGEST_LEFT = 0.5
"""Gain at which the whole prior has brought the fit near: one standard deviation away."""

LARGEST_ERROR = 0.5
"""Error of the linearisation, in deviations of the on-line estimate, above which all windows are
simulated anew: the Newton step in deviations, times its change of the coordinates."""

LARGEST_CHANGE = 0.1
"""Change of a search coordinate (of the inertia's, by its trace) that is not small."""

FAR = 2.0
"""Chi^2 per measurement above which a point that is left by such a change lies far from the data:
Newton's steps from there may follow the data for all 10 s and never reach them."""

FIRST_DAMPING = 1e-3
"""Share of the information's diagonal that is added to it in a descent's first step."""

MOST_ANEW = 3
"""Most steps of descent when a window comes; each simulates all windows anew. With two, an estimate
was left twelve deviations away on Table 2-1's robot."""

SUBSTEPS = 2
"""Integration steps a sample, on line and until a fit is near: one would leave 0.3 % in the angular
accelerations."""

FINAL_SUBSTEPS = 4
"""Integration steps a sample of the final fit: on a light, stiff body two bias it by more than its
deviation."""

LEAST_SHARE = 0.01
"""Share of the prior's guess to which mass, damping and stiffness are raised where a fit starts."""

PRIOR_SHARE = 0.01
"""Share of the information along a combination of parameters below which the final fit leaves the
prior out: with it the deviation would fall by half a percent, but the fit move by a tenth of a
deviation for each of the prior's that the truth lies off the guess."""

_PriorTerm = Callable[[FloatArray], tuple[float, FloatArray, FloatArray]]


@dataclasses.dataclass(frozen=True)
class Window:
    """Motion of one mode of the arm, with what was measured meanwhile.

    Attributes:
        trajectory: Arm motion over n steps.
        outputs: (n, 24) measured deviations from rest at the steps' ends.
        sigma: (24,) standard deviations of the noise.
    """

    trajectory: Trajectory
    outputs: FloatArray
    sigma: FloatArray

    def __post_init__(self) -> None:
        """Refuse what cannot be weighed.

        Raises:
            MeasurementError: If there is not one sample of 24 channels for each step, not one
                deviation for each channel, a measurement is not finite or a deviation not positive.
        """
        expected = (len(self.trajectory.jerk), CHANNELS)
        if self.outputs.shape != expected:
            raise MeasurementError(f"outputs of shape {self.outputs.shape}: expected {expected}")
        check_finite(self.outputs)
        if self.sigma.shape != (CHANNELS,):
            raise MeasurementError(f"sigma of shape {self.sigma.shape}: expected ({CHANNELS},)")
        if not np.all(self.sigma > 0):
            raise MeasurementError(f"sigma {self.sigma}: every channel needs a positive deviation")


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Result of a fit.

    Attributes:
        parameters: (22,) physical parameters.
        covariance: (22, 22) covariance of the physical parameters.
        theta: (22,) search coordinates.
        information: (22, 22) information of data and prior, as far as the prior counts, in search
            coordinates.
        chi_square: Weighted squared residuals per measurement; 1 when the model holds.
        measurements: Number of scalar measurements.
        gain_left: What a whole Newton step promises to gain of half the squared residuals.
    """

    parameters: FloatArray
    covariance: FloatArray
    theta: FloatArray
    information: FloatArray
    chi_square: float
    measurements: int
    gain_left: float

    @property
    def converged(self) -> bool:
        """True at an optimum, by the gradient in the metric of the information."""
        return self.gain_left <= SMALLEST_GAIN

    @property
    def trustworthy(self) -> bool:
        """True when the fit converged, and chi^2 per measurement says that the model explains all.

        The tolerance widens to four standard deviations where data are few: those of uniform
        noise, whose squares vary by 0.8 (2 if Gaussian: then four count as two and a half). No data
        explain nothing.
        """
        if not self.measurements:
            return False
        tolerance = 4 * np.sqrt(0.8 / self.measurements)
        explained = abs(self.chi_square - 1) <= max(CHI_SQUARE_TOLERANCE, tolerance)
        return bool(explained and self.converged)

    def physical_information(self) -> FloatArray:
        """Return the posterior information (22, 22) by the physical parameters."""
        scale = coordinate_scale(self.theta)
        return self.information / np.outer(scale, scale)


@dataclasses.dataclass
class _Normal:
    """Normal equations of the data at one point: cost, gradient and information."""

    cost: float
    gradient: FloatArray
    information: FloatArray


_Linearised = tuple[_Normal, dict[str, BaseState]]


@dataclasses.dataclass(frozen=True)
class _Point:
    """A point of a descent, with the data linearised there, states reached and damping left."""

    theta: FloatArray
    normal: _Normal
    states: dict[str, BaseState]
    substeps: int
    damping: float = FIRST_DAMPING


class OutputError:
    """Fits the 22 parameters to windows of all three modes, on line and at the end.

    On line the sensitivities are kept from one window to the next, and everything is simulated
    anew only when the linearisation errs: a few steps of descent follow, from least squares without
    their bias if the estimate is far from the data.

    Args:
        arms: The arm in each mode, by mode name.
        prior: Prior of the 22 parameters; a generic guess by default.

    Attributes:
        estimate: Latest estimate.
        states: Estimated state of the base by mode, with sensitivities.
    """

    def __init__(self, arms: Mapping[str, ArmOnMount], prior: Prior | None = None) -> None:
        self._arms = dict(arms)
        self._prior = prior or Prior()
        self._windows: dict[str, list[Window]] = {mode: [] for mode in arms}
        self._equations: dict[str, Equations] = {}
        self._linearised_at = self._prior.mean()
        self.states = {mode: BaseState.at_rest() for mode in arms}
        # Kept from window to window: starting anew, a descent could be refused every step.
        self._damping = FIRST_DAMPING
        self._data = _Normal(0.0, np.zeros(COUNT), np.zeros((COUNT, COUNT)))
        self.estimate = self._summary(self._linearised_at, self._data, self._prior.term)

    @property
    def measurements(self) -> int:
        """Number of scalar measurements so far."""
        return sum(w.outputs.size for windows in self._windows.values() for w in windows)

    def add(self, windows: Mapping[str, Window], relinearise: bool = True) -> Estimate:
        """Take one window of each mode in, and update the estimate.

        Args:
            windows: The latest window by mode.
            relinearise: Whether all windows may be simulated anew.

        Returns:
            The new estimate, also kept as `estimate`.

        Raises:
            ValueError: If a mode is unknown.
        """
        unknown = sorted(set(windows) - set(self._windows))
        if unknown:
            raise ValueError(f"modes {unknown}: expected {', '.join(self._windows)}")
        for mode, window in windows.items():
            self._windows[mode].append(window)
            found = Equations.of(window.outputs, window.sigma, self._arms[mode])
            known = self._equations.get(mode)
            self._equations[mode] = known + found if known else found
            self._accumulate(mode, [window], self._linearised_at, self._data, self.states, SUBSTEPS)
        if relinearise:
            self._linearise_anew()
        theta = _step_from(self._linearised_at, self._data, self._prior.term)
        theta = self._held(self._linearised_at, theta)
        self.estimate = self._summary(theta, self._data, self._prior.term)
        return self.estimate

    def _linearise_anew(self) -> None:
        """Descend by simulating all windows anew, if the linearisation errs."""
        term, theta, data = self._prior.term, self._linearised_at, self._data
        change = _change(theta, _step_from(theta, data, term))
        if change * np.sqrt(2.0 * _gain_left(theta, data, term)) <= LARGEST_ERROR:
            return
        point = _Point(theta, data, self.states, SUBSTEPS, self._damping)
        if change > LARGEST_CHANGE and data.cost > FAR * self.measurements:
            point = self._at(self._unbiased(), SUBSTEPS)
        point, _ = self._descend_under(term, point, LARGEST_LEFT, 0, MOST_ANEW)
        self._linearised_at, self._data, self.states = point.theta, point.normal, point.states
        self._damping = point.damping

    def fit(self, iterations: int = 40) -> Estimate:
        """Fit all windows to convergence by damped Gauss-Newton, finely integrated.

        Starts from least squares without their bias; only if that leads to no fit to be trusted,
        also from the latest estimate.

        Args:
            iterations: Most iterations of one attempt.

        Returns:
            The better estimate, also kept as `estimate`.
        """
        best, reached = self._descend(self._unbiased(), iterations)
        if not best.trustworthy:
            other, there = self._descend(self.estimate.theta, iterations)
            if other.chi_square < best.chi_square:
                best, reached = other, there
        self._linearised_at = best.theta
        # Later windows are added to what was linearised here.
        self._data, self.states = reached.normal, reached.states
        self.estimate = best
        return best

    def fit_from(self, theta: FloatArray, iterations: int = 40) -> Estimate:
        """Fit all windows from one starting point (22,) alone, and keep nothing of it."""
        return self._descend(theta, iterations)[0]

    def _unbiased(self) -> FloatArray:
        """Return search coordinates (22,) near the optimum, without a search."""
        parts = list(self._equations.values())
        guess = from_coordinates(self._prior.mean())
        found = compensated(parts, self._prior) if parts else guess
        return to_coordinates(closest_body(found, LEAST_SHARE * guess))

    def _descend(self, theta: FloatArray, iterations: int) -> tuple[Estimate, _Point]:
        """Descend under the whole prior until near, then let it count only where it must."""
        term: _PriorTerm = self._prior.term
        point, count = self._descend_under(
            term, self._at(theta, SUBSTEPS), LARGEST_LEFT, 0, iterations
        )
        point, gain, held = self._at(point.theta, FINAL_SUBSTEPS), LARGEST_LEFT, -1
        while True:
            point, count = self._descend_under(term, point, gain, count, iterations)
            information = point.normal.information
            directions = self._prior.noticeable(point.theta, information, PRIOR_SHARE)
            # What the data determine only while the prior holds it needs the prior: not released.
            if directions.shape[1] <= held:
                break
            held, gain = directions.shape[1], SMALLEST_GAIN
            point = dataclasses.replace(point, damping=FIRST_DAMPING)
            term = functools.partial(self._prior.term, directions=directions)
        return self._summary(point.theta, point.normal, term), point

    def _descend_under(
        self, term: _PriorTerm, point: _Point, gain: float, count: int, iterations: int
    ) -> tuple[_Point, int]:
        """Descend until no more than `gain` is left, or `iterations` are done, `count` before."""
        objective, damping = _objective(point, term), point.damping
        while count < iterations and _gain_left(point.theta, point.normal, term) > gain:
            count += 1
            target = _step_from(point.theta, point.normal, term, damping)
            candidate = self._held(point.theta, target)
            other = self._at(candidate, point.substeps)
            improved = _objective(other, term)
            if np.isfinite(improved) and improved < objective:
                objective, point, damping = improved, other, damping / 10
            elif np.abs(candidate - point.theta).max() < 1e-6 or damping > 1e8:
                break
            else:
                damping *= 10
        return dataclasses.replace(point, damping=damping), count

    def _at(self, theta: FloatArray, substeps: int) -> _Point:
        return _Point(theta, *self._linearise(theta, substeps), substeps)

    def _linearise(self, theta: FloatArray, substeps: int) -> _Linearised:
        """Simulate all windows at `theta`; return normal equations and the states reached."""
        normal = _Normal(0.0, np.zeros(COUNT), np.zeros((COUNT, COUNT)))
        states = {mode: BaseState.at_rest() for mode in self._windows}
        for mode, windows in self._windows.items():
            self._accumulate(mode, windows, theta, normal, states, substeps)
        return normal, states

    def _accumulate(
        self,
        mode: str,
        windows: Sequence[Window],
        theta: FloatArray,
        normal: _Normal,
        states: dict[str, BaseState],
        substeps: int,
    ) -> None:
        parameters, scale = from_coordinates(theta), coordinate_scale(theta)
        gradient, information = np.zeros(COUNT), np.zeros((COUNT, COUNT))
        for window in windows:
            predicted, derivatives, states[mode] = simulate(
                parameters, self._arms[mode], window.trajectory, states[mode], substeps=substeps
            )
            weighted = (derivatives / window.sigma[:, None]).reshape(-1, COUNT)
            residual = ((window.outputs - predicted) / window.sigma).ravel()
            normal.cost += float(residual @ residual)
            gradient += weighted.T @ residual
            information += weighted.T @ weighted
        normal.gradient += scale * gradient
        normal.information += information * np.outer(scale, scale)

    def _held(self, theta: FloatArray, target: FloatArray) -> FloatArray:
        """Return `target`, or as far towards it as stays near, and the inertia physical."""
        step = target - theta
        # The inertia's elements have no scale but the body's own, to which they are held.
        step /= max(np.abs(np.delete(step, INERTIA)).max(), 1.0)
        return theta + physical_step(theta, step)

    def _summary(self, theta: FloatArray, normal: _Normal, term: _PriorTerm) -> Estimate:
        information = normal.information + term(theta)[2]
        scale = coordinate_scale(theta)
        return Estimate(
            parameters=from_coordinates(theta),
            covariance=np.linalg.inv(information) * np.outer(scale, scale),
            theta=theta,
            information=information,
            chi_square=normal.cost / max(self.measurements, 1),
            measurements=self.measurements,
            gain_left=_gain_left(theta, normal, term),
        )


def _change(theta: FloatArray, target: FloatArray) -> np.float64:
    """Return the greatest change of a coordinate, the inertia's as shares of its trace."""
    change = np.abs(target - theta)
    change[INERTIA] /= theta[INERTIA][:3].sum()
    return change.max()


def _gain_left(theta: FloatArray, normal: _Normal, term: _PriorTerm) -> float:
    """Return what a full Newton step promises to gain of half the squared residuals."""
    _, pull, precision = term(theta)
    gradient = normal.gradient - pull
    step = np.linalg.solve(normal.information + precision, gradient)
    return 0.5 * float(gradient @ step)


def _objective(point: _Point, term: _PriorTerm) -> float:
    return 0.5 * point.normal.cost + term(point.theta)[0]


def _step_from(
    theta: FloatArray, normal: _Normal, term: _PriorTerm, damping: float = 0.0
) -> FloatArray:
    _, pull, precision = term(theta)
    information, gradient = normal.information + precision, normal.gradient - pull
    damped = information + damping * np.diag(np.diag(information))
    return theta + np.linalg.solve(damped, gradient)
