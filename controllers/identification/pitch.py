"""Pitch of a rover on its suspension, from the wrench under its arm (Thesis section 2.6.2).

The physical rover has an inclinometer and a force/torque sensor, no more. So the pitch row of
eq. 2-1 is simulated, driven by the measured wrench, and five parameters are fitted to what the
inclinometer reads: I tilt'' + b tilt' + k tilt = -(N_x + ry F_z - rz F_y).

On wheels that neither slip nor roll a base does not pitch about its centre of gravity but about a
line near the ground: the inertia is about that line, and (ry, rz) leads from it to the arm.

An inclinometer does not read the tilt. Its masses feel the specific force along the base, that is
g tilt - h tilt'' at a height h above the line, through a low pass: at 10 Hz and 0.1 m the second
term is forty times the first. It is as linear in the motion as the tilt, and modelled with it.

The wrench drives the model, so its noise goes on as an error of the motion, and dies away as the
motion does. A Kalman filter carries it; what is fitted are the filter's prediction errors, which
are white, so that chi squared and the covariance mean what they say.

Where a wheel leaves the ground the base obeys another equation. It shows as a reading that the
filter could not foresee; from there on the motion counts as unknown until later readings tell it.
"""

import dataclasses
import itertools
from collections.abc import Callable, Generator, Iterator

import numba
import numpy as np
import scipy.linalg
import scipy.ndimage
from numpy.typing import ArrayLike

from controllers.identification.information import BITS, mutual_information
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.geometry.gravity import GRAVITY

NAMES = ("ixx", "ry", "rz", "b_pitch", "k_pitch")
UNITS = ("kg m^2", "m", "m", "N m s/rad", "N m/rad")
_LOGARITHMIC = np.array([0, 3, 4])
_STEP = 1e-5  # of a search coordinate, for central differences
_NEAR = 1.0  # Width over which the wrench's power is averaged [Hz].
_SURPRISE = 6.0  # Deviations from which on a reading could not be foreseen.
_UNKNOWN = (0.03, 2.0, 0.1)  # Deviations of a motion of which nothing is known [rad, rad/s, rad].
_CREEP = 0.03  # Rate of pitching from which dry friction is whole [rad/s].
_FACTORS = (0.3, 1.0, 3.0)  # of the guesses of inertia and stiffness, where searches start
SMALLEST_GAIN = 1e-4
"""Gain of half the squared residuals at which a fit has converged."""
DISTURB = 0.0
GAIN = 0.0
RANGES = np.array([[0.0, 0.5], [-0.5, 0.5], [-0.5, 0.5], [0.0, 20.0], [0.0, 2000.0]])
"""Spans on which the information metric is read: generic for a small rover."""


@dataclasses.dataclass(frozen=True)
class PitchSensors:
    """Sampling, place and noise of the sensors of the pitch identification.

    Attributes:
        period: Sampling period of the wrench, of which each sample is the mean [s].
        wrench_age: Age of a wrench sample beyond that of a tilt sample of the same tick, from the
            middle of its period [s].
        force_sigma: Standard deviation of the forces' noise [N].
        torque_sigma: Standard deviation of the moments' noise [N m].
        tilt_bandwidth: First-order pole of the inclinometer [Hz].
        tilt_sigma: Standard deviation of the inclinometer's noise [rad].
        tilt_period: Time between its samples [s].
        tilt_range: Apparent tilt beyond which its masses stop [rad].
        tilt_height: Its height over the arm's force/torque sensor [m]; None for one that reads the
            tilt itself.
    """

    period: float = 0.01
    wrench_age: float = 0.0045
    force_sigma: float = 0.1
    torque_sigma: float = 0.01
    tilt_bandwidth: float = 6.0
    tilt_sigma: float = np.deg2rad(0.05)
    tilt_period: float = 0.04
    tilt_range: float = np.deg2rad(20.0)
    tilt_height: float | None = -0.036


@dataclasses.dataclass(frozen=True)
class PitchPrior:
    """An order of magnitude for each of the five parameters, and for the inclinometer's zero.

    Attributes:
        inertia: Guess [kg m^2].
        damping: Guess [N m s/rad].
        stiffness: Guess [N m/rad].
        log_sigma: Deviation of the logarithms of these three.
        height: Guess of rz, the height of the arm's force/torque sensor over the ground [m].
        lever_sigma: Deviation of ry about zero, and of rz about that [m].
        zero_sigma: Deviation of the tilt at rest from its tare [rad].
        friction_sigma: Deviation of the dry friction about zero [N m].
    """

    inertia: float = 0.2
    damping: float = 5.0
    stiffness: float = 500.0
    log_sigma: float = 1.5
    height: float = 0.1
    lever_sigma: float = 0.2
    zero_sigma: float = 0.005
    friction_sigma: float = 0.2

    def mean(self) -> FloatArray:
        """Return (7,) search coordinates: the five parameters, positive ones as logs, then
        inclinometer's zero and dry friction."""
        logs = np.log([self.inertia, self.damping, self.stiffness])
        return np.array([logs[0], 0.0, self.height, logs[1], logs[2], 0.0, 0.0])

    def sigma(self) -> FloatArray:
        """Return the deviations (7,)."""
        log, lever = self.log_sigma, self.lever_sigma
        return np.array([log, lever, lever, log, log, self.zero_sigma, self.friction_sigma])


def physical(coordinates: FloatArray) -> FloatArray:
    """Return the five physical parameters of search coordinates (6,)."""
    parameters = coordinates[:5].copy()
    parameters[_LOGARITHMIC] = np.exp(parameters[_LOGARITHMIC])
    return parameters


def _scale(parameters: FloatArray) -> FloatArray:
    """Return the derivatives (5,) of the parameters by the search coordinates."""
    return np.where([name in ("ry", "rz") for name in NAMES], 1.0, parameters)


@dataclasses.dataclass(frozen=True)
class _Model:
    """The base and its inclinometer over one period of the wrench.

    The moment runs straight within a period, through its mean and at the slope from the period
    before to that after: held at its mean, it would turn a base that swings at 10 Hz by 4 % less.

    Rows and columns are tilt, its rate, the filtered reading, and the moment's mean and slope.

    Attributes:
        step: (3, 5) what the state after the period is made of.
        readings: (3, 5) what tilt, apparent tilt and reading are made of when the inclinometer is
            read.
        lead: Number of samples by which the wrench lags the tilt of the same tick.
        variance: Variance of the noise of the moment's mean [N^2 m^2].
    """

    step: FloatArray
    readings: FloatArray
    lead: int
    variance: float

    @classmethod
    def of(cls, parameters: FloatArray, sensors: PitchSensors) -> "_Model":
        inertia, ry, rz, damping, stiffness = parameters
        turn = np.array([-stiffness, -damping, 0.0, 1.0, 0.0]) / inertia
        height = 0.0 if sensors.tilt_height is None else rz + sensors.tilt_height
        apparent = np.array([1.0, 0.0, 0.0, 0.0, 0.0]) - height / GRAVITY * turn
        pole = 2 * np.pi * sensors.tilt_bandwidth
        dynamics = np.zeros((5, 5))
        dynamics[0, 1], dynamics[1], dynamics[2] = 1.0, turn, pole * apparent
        dynamics[2, 2], dynamics[3, 4] = -pole, 1.0
        start = np.eye(5)
        start[3, 4] = -sensors.period / 2
        lead, part = divmod(sensors.wrench_age + sensors.period / 2, sensors.period)
        spans = np.array([sensors.period, part])[:, None, None]
        step, until = scipy.linalg.expm(dynamics * spans) @ start
        readings = np.array([until[0], apparent @ until, until[2]])
        variance = sensors.torque_sigma**2 + (ry**2 + rz**2) * sensors.force_sigma**2
        return cls(step[:3], readings, int(lead), variance)

    def with_errors(self, period: float) -> tuple[FloatArray, FloatArray]:
        """Return transition (6, 6) and reading (6,) of the state of `_kalman_gains`."""
        spread = np.zeros((5, 6))
        spread[[0, 1, 2, 3], [0, 1, 2, 4]] = 1.0
        spread[4, [3, 5]] = np.array([-0.5, 0.5]) / period
        step = np.zeros((6, 6))
        step[:3], step[[3, 4], [4, 5]] = self.step @ spread, 1.0
        return step, self.readings[2] @ spread


def _moment(parameters: FloatArray, wrench: FloatArray, period: float) -> FloatArray:
    """Return mean and slope of the pitching moment in every period (n, 2)."""
    mean = -(wrench[:, 3] + parameters[1] * wrench[:, 2] - parameters[2] * wrench[:, 1])
    slope = SLOPE * np.gradient(mean, period) if len(mean) > 1 else np.zeros(len(mean))
    return np.stack([mean, slope], axis=1)


SLOPE = 1.0


def smoothed(wrench: FloatArray, sensors: PitchSensors) -> FloatArray:
    """Return the wrench with its noise shrunk, frequency by frequency (Wiener filter).

    A fit is driven by the measured wrench: at frequencies that hold more noise than motion it would
    explain the noise by heavier and stiffer bodies (errors in variables).

    Args:
        wrench: (n, 6) deviation from rest of force and moment on the arm.
        sensors: Its sampling and noise.
    """
    count = len(wrench)
    spectrum = np.fft.rfft(np.concatenate([wrench, wrench[::-1]]), axis=0)
    near = max(3, round(2 * count * sensors.period * _NEAR))
    power = scipy.ndimage.uniform_filter1d(np.abs(spectrum) ** 2, near, axis=0)
    sigma = np.repeat([sensors.force_sigma, sensors.torque_sigma], 3)
    kept = np.maximum(1.0 - 2 * count * sigma**2 / np.maximum(power, 1e-30), 0.0)
    return np.fft.irfft(spectrum * kept, 2 * count, axis=0)[:count].astype(np.float64)


def predict_tilt(
    parameters: FloatArray, wrench: FloatArray, sensors: PitchSensors, friction: float = 0.0
) -> FloatArray:
    """Return how the base tilts while the arm pulls, from rest, and what is read of it.

    Exact for a wrench that runs straight within each sample's period.

    Args:
        parameters: (5,) in the order of `NAMES`.
        wrench: (n, 6) deviation from rest of force and moment on the arm, arm-base frame.
        sensors: The sensors.
        friction: Dry friction of the pitching [N m].

    Returns:
        (n, 3) deviations from rest of the tilt, of the apparent tilt in the specific force, and of
        the reading, when the inclinometer is sampled at each tick [rad].
    """
    model = _Model.of(parameters, sensors)
    moment = _moment(parameters, wrench, sensors.period)
    found, _ = _march(model.step, model.readings, moment, friction)
    return found[np.minimum(np.arange(len(wrench)) + model.lead, len(wrench) - 1)]


@numba.njit(cache=True)
def _march(step, readings, moment, friction):
    """Return what is read (n, 3), and the moment that dry friction takes off in each period (n,)."""
    found, held = np.zeros((moment.shape[0], 3)), np.zeros(moment.shape[0])
    state = np.zeros(5)
    for n in range(moment.shape[0]):
        state[3:] = moment[n]
        if friction != 0.0:
            rate = 0.5 * (state[1] + step[1] @ state)
            held[n] = friction * np.tanh(rate / _CREEP)
            state[3] -= held[n]
        found[n] = readings @ state
        state[:3] = step @ state
    return found, held


@numba.njit(cache=True)
def _kalman_gains(step, reading, count, indices, lost, wrench_variance, tilt_variance):
    """Return the gains (m, 6) of the state by each reading, and the readings' deviations (m,).

    The state are tilt, rate, filtered reading, and the errors of the moment's mean in the periods
    before, now and next: the slope is from the first to the last of these.

    Args:
        step: (6, 6) transition of that state.
        reading: (6,) what a reading is made of.
        count: Number of periods.
        indices: (m,) periods in which the inclinometer is read.
        lost: (m,) whether the motion is unknown before a reading.
        wrench_variance: (count + 2,) variance of the moment's mean in every period.
        tilt_variance: Variance of a reading.
    """
    gains, deviations = np.zeros((indices.shape[0], 6)), np.ones(indices.shape[0])
    covariance, half, gain = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    covariance[4, 4], covariance[5, 5] = wrench_variance[0], wrench_variance[1]
    k = 0
    for n in range(count):
        if k < indices.shape[0] and n == indices[k]:
            if lost[k]:
                covariance[:3], covariance[:, :3] = 0.0, 0.0
                for i in range(3):
                    covariance[i, i] = _UNKNOWN[i] ** 2
            variance = tilt_variance
            for i in range(6):
                gain[i] = 0.0
                for j in range(6):
                    gain[i] += covariance[i, j] * reading[j]
                variance += gain[i] * reading[i]
            for i in range(6):
                gains[k, i] = gain[i] / variance
                for j in range(6):
                    covariance[i, j] -= gain[i] * gain[j] / variance
            deviations[k] = np.sqrt(variance)
            k += 1
        for i in range(6):
            for j in range(6):
                half[i, j] = 0.0
                for m in range(6):
                    half[i, j] += step[i, m] * covariance[m, j]
        for i in range(6):
            for j in range(6):
                covariance[i, j] = 0.0
                for m in range(6):
                    covariance[i, j] += half[i, m] * step[j, m]
        covariance[5, 5] = wrench_variance[n + 2]
    return gains, deviations


@numba.njit(cache=True)
def _prediction_errors(step, reading, driven, indices, tilt, gains):
    """Return what each reading differs by from the prediction by all before it (m,).

    Args:
        step: (6, 6) transition of the state, see `_kalman_gains`.
        reading: (6,) what a reading is made of.
        driven: (n, 3) what the measured moment adds to tilt, rate and filtered reading.
        indices: (m,) periods in which the inclinometer is read.
        tilt: (m,) readings less what the measured moment adds to them at once.
        gains: (m, 6) gains of the state.
    """
    errors, state, after = np.zeros(indices.shape[0]), np.zeros(6), np.zeros(6)
    k = 0
    for n in range(driven.shape[0]):
        if k < indices.shape[0] and n == indices[k]:
            errors[k] = tilt[k]
            for i in range(6):
                errors[k] -= reading[i] * state[i]
            for i in range(6):
                state[i] += gains[k, i] * errors[k]
            k += 1
        for i in range(6):
            after[i] = driven[n, i] if i < 3 else 0.0
            for j in range(6):
                after[i] += step[i, j] * state[j]
        state[:] = after
    return errors


@dataclasses.dataclass(frozen=True)
class PitchEstimate:
    """Result of a fit.

    Attributes:
        parameters: (5,) in the order of `NAMES`.
        covariance: (5, 5).
        information: (6, 6) posterior, in search coordinates.
        coordinates: (6,) search coordinates.
        chi_square: Squared prediction errors over their variances, per tilt sample.
        samples: Number of tilt samples.
        gain_left: What a whole Newton step promises to gain of half the squared residuals.
        cost: Negative logarithm of the posterior density, but for a constant.
    """

    parameters: FloatArray
    covariance: FloatArray
    information: FloatArray
    coordinates: FloatArray
    chi_square: float
    samples: int
    gain_left: float
    cost: float

    def unidentifiable(self, prior: PitchPrior, shrinkage: float = 0.5) -> tuple[str, ...]:
        """Return the parameters whose deviation stayed above `shrinkage` of the prior's."""
        deviation = np.sqrt(np.diag(np.linalg.inv(self.information)))[:5]
        return tuple(NAMES[i] for i in np.flatnonzero(deviation > shrinkage * prior.sigma()[:5]))


@dataclasses.dataclass(frozen=True)
class _Filter:
    """Gains (m, 6) of a Kalman filter, and the deviations (m,) of its prediction errors [rad]."""

    gains: FloatArray
    deviations: FloatArray


@dataclasses.dataclass(frozen=True)
class PitchData:
    """Measurements of a fit, deviations from rest.

    Attributes:
        wrench: (n, 6) force and moment at every tick.
        indices: (m,) ticks at which the inclinometer was read.
        tilt: (m,) readings [rad].
        lost: (m,) whether the motion before a reading is unknown.
    """

    wrench: FloatArray
    indices: IndexArray
    tilt: FloatArray
    lost: BoolArray

    def __post_init__(self) -> None:
        """Refuse what is no measurement.

        Raises:
            ValueError: Naming the sensor of which a sample is not finite.
        """
        for name, values in (("arm_base_wrench", self.wrench), ("inclinometer", self.tilt)):
            if not np.all(np.isfinite(values)):
                raise ValueError(f"{name}: a sample is not finite; check the sensor")

    @classmethod
    def of(cls, wrench: FloatArray, indices: ArrayLike, tilt: ArrayLike) -> "PitchData":
        """Hold measurements of a motion that was never lost; shapes as those of the attributes."""
        tilts = np.asarray(tilt, dtype=float)
        return cls(wrench, np.asarray(indices, dtype=np.intp), tilts, np.zeros(len(tilts), bool))


@dataclasses.dataclass(frozen=True)
class _Likelihood:
    """How well parameters explain measurements.

    Attributes:
        data: The measurements.
        sensors: Sampling, place and noise.
    """

    data: PitchData
    sensors: PitchSensors

    def filter(self, coordinates: FloatArray) -> _Filter:
        """Return the Kalman filter at (7,) search coordinates."""
        model = _Model.of(physical(coordinates), self.sensors)
        step, reading = model.with_errors(self.sensors.period)
        moment = _moment(physical(coordinates), self.data.wrench, self.sensors.period)[:, 0]
        unsure = model.variance + DISTURB**2 + (GAIN * moment) ** 2
        return _Filter(
            *_kalman_gains(
                step,
                reading,
                len(self.data.wrench),
                self.data.indices + model.lead,
                self.data.lost,
                np.append(unsure, [model.variance, model.variance]),
                self.sensors.tilt_sigma**2,
            )
        )

    def residuals(self, coordinates: FloatArray, given: _Filter) -> FloatArray:
        """Return the filter's prediction errors (m,) at `coordinates`, over its deviations."""
        parameters = physical(coordinates)
        model = _Model.of(parameters, self.sensors)
        moment = _moment(parameters, self.data.wrench, self.sensors.period)
        moment[:, 0] -= _march(model.step, model.readings, moment, coordinates[6])[1]
        step, reading = model.with_errors(self.sensors.period)
        indices = np.minimum(self.data.indices + model.lead, len(moment) - 1)
        at_once = np.sum(moment[indices] * model.readings[2, 3:], axis=1)
        errors = _prediction_errors(
            step,
            reading,
            moment @ model.step[:, 3:].T,
            indices,
            self.data.tilt - coordinates[5] - at_once,
            given.gains,
        )
        return errors / given.deviations

    def slopes(self, coordinates: FloatArray, given: _Filter) -> FloatArray:
        """Return the derivatives (m, 6) of what is predicted, by central differences."""
        columns = [
            self.residuals(coordinates - step, given) - self.residuals(coordinates + step, given)
            for step in _STEP * np.eye(7)
        ]
        return np.stack(columns, axis=1) / (2 * _STEP)


class PitchFit:
    """Maximum a posteriori fit of the tilt, warm-started from one window to the next.

    Args:
        sensors: Sampling and noise of wrench and inclinometer.
        prior: Prior of the five parameters and its deviations; a generic guess by default.
    """

    def __init__(self, sensors: PitchSensors, prior: PitchPrior | None = None) -> None:
        self.prior = prior or PitchPrior()
        self._sensors = sensors
        nothing = PitchData.of(np.zeros((0, 6)), [], [])
        self.estimate = self._summary(self._likelihood(nothing), self.prior.mean())

    def fit(self, data: PitchData, iterations: int = 30) -> PitchEstimate:
        """Fit all that was measured since rest, and keep the result as `estimate`.

        Args:
            data: All measurements.
            iterations: Most Gauss-Newton iterations.
        """
        start = self.estimate.coordinates
        self.estimate = _end_of(self._descend(self._likelihood(data), start, iterations))
        return self.estimate

    def search(self, data: PitchData, iterations: int = 30) -> Iterator[None]:
        """Fit as `fit`, from several guesses of how fast the base swings, and keep the likeliest.

        What swings out of step with the guess pulls it nowhere: a single start may end beside.

        Args:
            data: All measurements.
            iterations: Most Gauss-Newton iterations from each start.

        Yields:
            Nothing, after each iteration: the whole takes longer than a robot waits for a command.
        """
        likelihood, starts = self._likelihood(data), [self.estimate.coordinates]
        for inertia, stiffness in itertools.product(*[_FACTORS] * 2):
            start = self.prior.mean()
            start[[0, 4]] += np.log([inertia, stiffness])
            starts.append(start)
        found: list[PitchEstimate] = []
        for start in starts:
            found.append((yield from self._descend(likelihood, start, iterations)))
        self.estimate = min(found, key=lambda each: each.cost)

    def with_losses(self, data: PitchData, since: int) -> PitchData:
        """Return the data with the motion lost wherever a reading cannot be believed otherwise.

        Args:
            data: All measurements.
            since: First reading to look at; the present estimate comes from those before.
        """
        likelihood, lost = self._likelihood(data), data.lost.copy()
        point, spread = self.estimate.coordinates, np.linalg.inv(self.estimate.information)
        while True:
            given = likelihood.filter(point)
            slopes = likelihood.slopes(point, given)
            doubt = np.sqrt(1.0 + np.einsum("ni,ij,nj->n", slopes, spread, slopes))
            surprise = np.abs(likelihood.residuals(point, given)) / doubt
            beyond = np.flatnonzero((surprise > _SURPRISE) & ~lost)
            beyond = beyond[beyond >= since]
            if not beyond.size:
                return likelihood.data
            lost[beyond[0]] = True
            likelihood = self._likelihood(dataclasses.replace(data, lost=lost))

    def _likelihood(self, data: PitchData) -> _Likelihood:
        return _Likelihood(data, self._sensors)

    def _descend(
        self, likelihood: _Likelihood, start: FloatArray, iterations: int
    ) -> Generator[None, None, PitchEstimate]:
        """Return the estimate that a damped Gauss-Newton search ends at; yield in between."""
        point, damping = start.copy(), 1e-3
        for _ in range(iterations):
            yield
            # The filter stays while a step is judged: one that doubts its inputs more would gain.
            given = likelihood.filter(point)
            cost, gradient, information = self._normal(likelihood, point, given)
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            trial = point + step * min(1.0, 1.0 / np.abs(step).max())
            gain = cost - self._cost(likelihood, trial, given)
            if not gain > 0.0:  # NaN is no gain either.
                damping *= 10
                if damping > 1e6:
                    break
                continue
            point, damping = trial, damping / 10
            if gain < SMALLEST_GAIN:
                break
        return self._summary(likelihood, point)

    def _cost(self, likelihood: _Likelihood, point: FloatArray, given: _Filter) -> float:
        deviation = (point - self.prior.mean()) / self.prior.sigma()
        residual = likelihood.residuals(point, given)
        return 0.5 * float(residual @ residual + deviation @ deviation)

    def _normal(
        self, likelihood: _Likelihood, point: FloatArray, given: _Filter
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return cost, gradient (6,) and information (6, 6), the prior's share in each."""
        slopes, precision = likelihood.slopes(point, given), np.diag(self.prior.sigma() ** -2)
        gradient = slopes.T @ likelihood.residuals(point, given)
        gradient -= precision @ (point - self.prior.mean())
        return self._cost(likelihood, point, given), gradient, slopes.T @ slopes + precision

    def _summary(self, likelihood: _Likelihood, point: FloatArray) -> PitchEstimate:
        given = likelihood.filter(point)
        cost, gradient, information = self._normal(likelihood, point, given)
        residual, parameters = likelihood.residuals(point, given), physical(point)
        scale = _scale(parameters)
        return PitchEstimate(
            parameters=parameters,
            covariance=np.linalg.inv(information)[:5, :5] * np.outer(scale, scale),
            information=information,
            coordinates=point,
            chi_square=float(residual @ residual) / max(len(residual), 1),
            samples=len(residual),
            gain_left=0.5 * float(gradient @ np.linalg.solve(information, gradient)),
            cost=cost + float(np.sum(np.log(given.deviations))),
        )


def _end_of(search: Generator[None, None, PitchEstimate]) -> PitchEstimate:
    while True:
        try:
            next(search)
        except StopIteration as end:
            return end.value


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
    every = round(sensors.tilt_period / sensors.period)
    indices = np.arange(len(wrench) - 1, -1, -every)[::-1]
    readings = predict_tilt(estimate.parameters, wrench, sensors)[indices, 2]
    data = PitchData.of(wrench, indices, readings + estimate.coordinates[5])
    likelihood = _Likelihood(data, sensors)
    slopes = likelihood.slopes(estimate.coordinates, likelihood.filter(estimate.coordinates))
    rows = slopes[indices >= len(wrench) - samples]
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
