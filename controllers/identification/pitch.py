"""Pitch of a rover on its suspension, from the wrench under its arm (Thesis section 2.6.2).

The physical rover has an inclinometer and a force/torque sensor, no more. So the pitch row of
eq. 2-1 is simulated, driven by the measured wrench through the inclinometer's own filter, and
five parameters are fitted to the tilt: I tilt'' + b tilt' + k tilt = -(N_x + ry F_z - rz F_y).

On wheels that neither slip nor roll a base does not pitch about its centre of gravity but about a
line near the ground: the inertia is about that line, and (ry, rz) leads from it to the arm.
"""

import dataclasses
from collections.abc import Callable

import numba
import numpy as np
import scipy.linalg
import scipy.optimize

from controllers.identification.information import BITS, mutual_information
from perception.geometry.arrays import FloatArray, IndexArray

NAMES = ("ixx", "ry", "rz", "b_pitch", "k_pitch")
UNITS = ("kg m^2", "m", "m", "N m s/rad", "N m/rad")
_LOGARITHMIC = np.array([0, 3, 4])
RANGES = np.array([[0.0, 0.5], [-0.5, 0.5], [-0.5, 0.5], [0.0, 20.0], [0.0, 2000.0]])
"""Spans on which the information metric is read: generic for a small rover."""


@dataclasses.dataclass(frozen=True)
class PitchSensors:
    """Sampling and noise of the sensors of the pitch identification.

    Attributes:
        period: Sampling period of the wrench [s].
        tilt_bandwidth: First-order pole of the inclinometer [Hz].
        tilt_sigma: Standard deviation of the inclinometer's noise [rad].
        tilt_period: Time between its samples [s].
        wrench_age: Age of a wrench sample beyond that of a tilt sample of the same tick [s].
    """

    period: float = 0.01
    tilt_bandwidth: float = 6.0
    tilt_sigma: float = np.deg2rad(0.05)
    tilt_period: float = 0.04
    wrench_age: float = 0.0055


@dataclasses.dataclass(frozen=True)
class PitchPrior:
    """An order of magnitude for each of the five parameters, and for the inclinometer's zero.

    Attributes:
        inertia: Guess [kg m^2].
        damping: Guess [N m s/rad].
        stiffness: Guess [N m/rad].
        log_sigma: Deviation of the logarithms of these three.
        lever_sigma: Deviation of ry and rz about zero [m].
        zero_sigma: Deviation of the tilt at rest from its tare [rad].
    """

    inertia: float = 0.2
    damping: float = 5.0
    stiffness: float = 500.0
    log_sigma: float = 1.5
    lever_sigma: float = 0.2
    zero_sigma: float = 0.005

    def mean(self) -> FloatArray:
        """Return (6,) search coordinates: the five parameters, positive ones as logs, and zero."""
        logs = np.log([self.inertia, self.damping, self.stiffness])
        return np.array([logs[0], 0.0, 0.0, logs[1], logs[2], 0.0])

    def sigma(self) -> FloatArray:
        """Return the deviations (6,)."""
        log, lever = self.log_sigma, self.lever_sigma
        return np.array([log, lever, lever, log, log, self.zero_sigma])


def physical(coordinates: FloatArray) -> FloatArray:
    """Return the five physical parameters of search coordinates (6,)."""
    parameters = coordinates[:5].copy()
    parameters[_LOGARITHMIC] = np.exp(parameters[_LOGARITHMIC])
    return parameters


def _scale(parameters: FloatArray) -> FloatArray:
    """Return the derivatives (5,) of the parameters by the search coordinates."""
    return np.where([name in ("ry", "rz") for name in NAMES], 1.0, parameters)


def predict_tilt(
    parameters: FloatArray, wrench: FloatArray, sensors: PitchSensors, ahead: float = 0.0
) -> FloatArray:
    """Return what the inclinometer shows while the arm pulls, from rest.

    Exact for a wrench that runs straight from sample to sample.

    Args:
        parameters: (5,) in the order of `NAMES`.
        wrench: (n, 6) deviation from rest of force and moment on the arm, arm-base frame.
        sensors: The sensors.
        ahead: Delay from a wrench sample to the tilt that is read within it [s].

    Returns:
        (n,) filtered tilt [rad], deviation from rest, `ahead` after each of the wrench's samples.
    """
    inertia, ry, rz, damping, stiffness = parameters
    moment = -(wrench[:, 3] + ry * wrench[:, 2] - rz * wrench[:, 1])
    pole = 2 * np.pi * sensors.tilt_bandwidth
    # tilt, rate, filtered tilt, moment, and the moment's slope over a step
    dynamics = np.zeros((5, 5))
    dynamics[0, 1] = 1.0
    dynamics[1, [0, 1, 3]] = np.array([-stiffness, -damping, 1.0]) / inertia
    dynamics[2, 0], dynamics[2, 2] = pole, -pole
    dynamics[3, 4] = 1.0
    step, part = scipy.linalg.expm(np.array([dynamics * sensors.period, dynamics * ahead]))
    return _march(step[:3], part[2], moment, sensors.period)


@numba.njit(cache=True)
def _march(step, part, moment, period):
    tilt = np.zeros(moment.shape[0])
    x = y = z = slope = 0.0
    for n in range(moment.shape[0]):
        m = moment[n]
        if n + 1 < moment.shape[0]:
            slope = (moment[n + 1] - m) / period
        tilt[n] = part[0] * x + part[1] * y + part[2] * z + part[3] * m + part[4] * slope
        x, y, z = (
            step[0, 0] * x + step[0, 1] * y + step[0, 2] * z + step[0, 3] * m + step[0, 4] * slope,
            step[1, 0] * x + step[1, 1] * y + step[1, 2] * z + step[1, 3] * m + step[1, 4] * slope,
            step[2, 0] * x + step[2, 1] * y + step[2, 2] * z + step[2, 3] * m + step[2, 4] * slope,
        )
    return tilt


@dataclasses.dataclass(frozen=True)
class PitchEstimate:
    """Result of a fit.

    Attributes:
        parameters: (5,) in the order of `NAMES`.
        covariance: (5, 5).
        information: (6, 6) posterior, in search coordinates.
        coordinates: (6,) search coordinates.
        chi_square: Weighted squared residuals per tilt sample.
        samples: Number of tilt samples.
    """

    parameters: FloatArray
    covariance: FloatArray
    information: FloatArray
    coordinates: FloatArray
    chi_square: float
    samples: int

    def unidentifiable(self, prior: PitchPrior, shrinkage: float = 0.5) -> tuple[str, ...]:
        """Return the parameters whose deviation stayed above `shrinkage` of the prior's."""
        deviation = np.sqrt(np.diag(np.linalg.inv(self.information)))[:5]
        return tuple(NAMES[i] for i in np.flatnonzero(deviation > shrinkage * prior.sigma()[:5]))


def _derivatives(
    coordinates: FloatArray, wrench: FloatArray, sensors: PitchSensors
) -> tuple[FloatArray, FloatArray]:
    """Return predicted tilt (n,) and its derivatives (n, 6) by central differences."""
    columns = np.ones((len(wrench), 6))
    for i in range(5):
        step = np.zeros(6)
        step[i] = 1e-5
        more = predict_tilt(physical(coordinates + step), wrench, sensors, sensors.wrench_age)
        less = predict_tilt(physical(coordinates - step), wrench, sensors, sensors.wrench_age)
        columns[:, i] = (more - less) / 2e-5
    predicted = predict_tilt(physical(coordinates), wrench, sensors, sensors.wrench_age)
    return predicted + coordinates[5], columns


class PitchFit:
    """Maximum a posteriori fit of the tilt, warm-started from one window to the next.

    Args:
        sensors: Sampling and noise of wrench and inclinometer.
        prior: Prior of the five parameters and its deviations; a generic guess by default.
    """

    def __init__(self, sensors: PitchSensors, prior: PitchPrior | None = None) -> None:
        self.prior = prior or PitchPrior()
        self._sensors = sensors
        self.estimate = self._summary(self.prior.mean(), np.zeros((6, 6)), 0.0, 0)

    def fit(
        self, wrench: FloatArray, indices: IndexArray, tilt: FloatArray, iterations: int = 30
    ) -> PitchEstimate:
        """Fit all that was measured since rest, and keep the result as `estimate`.

        Args:
            wrench: (n, 6) deviation from rest at every sample.
            indices: (m,) integer samples of `wrench` at which the tilt was read.
            tilt: (m,) tilt read, deviation from rest [rad].
            iterations: Most Gauss-Newton iterations.

        Raises:
            ValueError: If a measurement is not finite.
        """
        for name, values in (("arm_base_wrench", wrench), ("inclinometer", tilt)):
            if not np.all(np.isfinite(values)):
                raise ValueError(f"{name}: a sample is not finite; check the sensor")
        precision = np.diag(self.prior.sigma() ** -2)
        point, damping = self.estimate.coordinates.copy(), 1e-3
        cost, residual, jacobian = self._evaluate(point, wrench, indices, tilt)
        for _ in range(iterations):
            information = jacobian.T @ jacobian + precision
            gradient = jacobian.T @ residual - precision @ (point - self.prior.mean())
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            trial = point + step * min(1.0, 1.0 / np.abs(step).max())
            trial_cost, trial_residual, trial_jacobian = self._evaluate(
                trial, wrench, indices, tilt
            )
            if not trial_cost < cost:  # NaN is no gain either.
                damping *= 10
                if damping > 1e6:
                    break
                continue
            gain, damping = cost - trial_cost, damping / 10
            point, cost, residual, jacobian = trial, trial_cost, trial_residual, trial_jacobian
            if gain < 1e-4:
                break
        self.estimate = self._summary(
            point, jacobian.T @ jacobian, float(residual @ residual), len(tilt)
        )
        return self.estimate

    def _evaluate(
        self, point: FloatArray, wrench: FloatArray, indices: IndexArray, tilt: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        predicted, columns = _derivatives(point, wrench, self._sensors)
        residual = (tilt - predicted[indices]) / self._sensors.tilt_sigma
        deviation = (point - self.prior.mean()) / self.prior.sigma()
        cost = 0.5 * float(residual @ residual + deviation @ deviation)
        return cost, residual, columns[indices] / self._sensors.tilt_sigma

    def _summary(
        self, point: FloatArray, data: FloatArray, squares: float, samples: int
    ) -> PitchEstimate:
        information = data + np.diag(self.prior.sigma() ** -2)
        scale = _scale(physical(point))
        covariance = np.linalg.inv(information)[:5, :5] * np.outer(scale, scale)
        chi_square = squares / max(samples, 1)
        return PitchEstimate(physical(point), covariance, information, point, chi_square, samples)


def fisher_information(
    estimate: PitchEstimate, wrench: FloatArray, samples: int, sensors: PitchSensors
) -> FloatArray:
    """Return the Fisher information (6, 6) of the tilt over the last `samples` of a wrench.

    Args:
        estimate: Estimate about which the model is linearised.
        wrench: (n, 6) past and forecast deviation from rest.
        samples: Number of forecast samples at its end.
        sensors: The sensors.
    """
    _, columns = _derivatives(estimate.coordinates, wrench, sensors)
    every = round(sensors.tilt_period / sensors.period)
    rows = columns[len(wrench) - samples :: every] / sensors.tilt_sigma
    return rows.T @ rows


def _bits(estimate: PitchEstimate, information: FloatArray) -> FloatArray:
    sigma = _scale(estimate.parameters) * np.sqrt(np.diag(np.linalg.inv(information))[:5])
    return mutual_information(estimate.parameters, sigma, RANGES) / BITS


def information(estimate: PitchEstimate) -> Callable[[FloatArray], FloatArray]:
    """Thesis eq. 2-13 as its text describes it; see `excitation.information`."""
    now = _bits(estimate, estimate.information)

    def residuals(added: FloatArray) -> FloatArray:
        return np.sqrt(1 - (1 - now) * _bits(estimate, estimate.information + added))

    return residuals


def d_optimal(estimate: PitchEstimate) -> Callable[[FloatArray], FloatArray]:
    """Least volume of uncertainty of the five parameters, the zero marginalised."""

    def residuals(added: FloatArray) -> FloatArray:
        covariance = np.linalg.inv(estimate.information + added)[:5, :5]
        return np.sqrt(50 + 2 * np.log(np.diag(np.linalg.cholesky(covariance))))

    return residuals


def a_optimal(estimate: PitchEstimate) -> Callable[[FloatArray], FloatArray]:
    """Least sum of relative variances; levers count relative to 0.03 m at least."""
    scale = np.ones(5)
    scale[1:3] = np.maximum(np.abs(estimate.parameters[1:3]), 0.03)

    def residuals(added: FloatArray) -> FloatArray:
        return np.sqrt(np.diag(np.linalg.inv(estimate.information + added))[:5]) / scale

    return residuals


CRITERIA = {"information": information, "d_optimal": d_optimal, "a_optimal": a_optimal}
