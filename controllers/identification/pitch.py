"""Identification of a rover's pitch from the wrench under its arm (Thesis section 2.6.2).

Five parameters, and four more that the inclinometer's readings depend on, are fitted to what the
inclinometer reads while the arm swings; `pitch_model` says how they make it.

The wrench drives the model, so its noise goes on as an error of the motion, and dies away as the
motion does. A Kalman filter carries it; what is fitted are the filter's prediction errors, which
are white, so that chi squared and the covariance mean what they say.

Where a wheel leaves the ground the base obeys another equation. It shows as a reading that the
filter could not foresee; from there on the motion counts as unknown until later readings tell it.
"""

import dataclasses
import itertools
from collections.abc import Callable, Generator, Iterator

import numpy as np
from numpy.typing import ArrayLike

from controllers.identification import ROVER_CRITERIA
from controllers.identification.information import BITS, mutual_information
from controllers.identification.pitch_model import (
    CALIBRATED,
    Nuisance,
    PitchModel,
    PitchSensors,
    dry_moment,
    kalman_gains,
    predict_tilt,
    prediction_errors,
)
from controllers.identification.swing_plane import PITCH
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray

NAMES = PITCH.parameters
UNITS = ("kg m^2", "m", "m", "N m s/rad", "N m/rad")
_LOGARITHMIC = np.array([0, 3, 4])
_STEP = 1e-5  # of a search coordinate, for central differences
_SURPRISE = 6.0  # Deviations from which on a reading could not be foreseen.
_FACTORS = (0.3, 1.0, 3.0)  # of the guesses of inertia and stiffness, where searches start
SMALLEST_GAIN = 1e-4
"""Gain of half the squared residuals at which a fit has converged."""
LARGEST_CHI_SQUARE = 1.3
"""Chi squared from which on a fit is not believed: the usual 250 readings scatter by 0.09."""
LARGEST_LOSS = 0.1
"""Share of the readings with an unforeseen motion from which on a fit is not believed."""
RANGES = np.array([[0.0, 0.5], [-0.5, 0.5], [-0.5, 0.5], [0.0, 20.0], [0.0, 2000.0]])
"""Spans on which the information metric is read: generic for a small rover."""


@dataclasses.dataclass(frozen=True)
class PitchPrior:
    """An order of magnitude for each of the five parameters, and deviations of the nuisance.

    Attributes:
        inertia: Guess [kg m^2].
        damping: Guess [N m s/rad].
        stiffness: Guess [N m/rad].
        log_sigma: Deviation of the logarithms of these three.
        height: Guess of rz, the height of the arm's force/torque sensor over the ground [m].
        lever_sigma: Deviation of ry about zero, and of rz about that [m].
        nuisance: Deviations of the nuisance about zero.
    """

    inertia: float = 0.2
    damping: float = 5.0
    stiffness: float = 500.0
    log_sigma: float = 1.5
    height: float = 0.1
    lever_sigma: float = 0.2
    nuisance: Nuisance = Nuisance(0.005, 0.2, 0.002, 0.005)

    def mean(self) -> FloatArray:
        """Return (9,) search coordinates: the five, positive ones as logs, then the nuisance."""
        logs = np.log([self.inertia, self.damping, self.stiffness])
        return np.array([logs[0], 0.0, self.height, logs[1], logs[2], *CALIBRATED])

    def sigma(self) -> FloatArray:
        """Return the deviations (9,)."""
        log, lever = self.log_sigma, self.lever_sigma
        return np.array([log, lever, lever, log, log, *self.nuisance])


@dataclasses.dataclass(frozen=True)
class PitchMisfit:
    """What one pitching base misses of a rover, whose springs differ and whose arm has play.

    The default was measured on 125 rovers as made, on rough ground.

    Attributes:
        moment: Standard deviation of what the model misses of a period's moment [N m].
        moment_share: The same beside it, as a share of the moment.
        parameters: (5,) standard deviations of the parameters beyond the noise's: levers [m], all
            others as shares.
    """

    moment: float = 0.03
    moment_share: float = 0.015
    parameters: tuple[float, float, float, float, float] = (0.075, 0.013, 0.002, 0.15, 0.06)


ROVER_MISFIT = PitchMisfit()


def physical(coordinates: FloatArray) -> FloatArray:
    """Return the five physical parameters of search coordinates (9,)."""
    parameters = coordinates[: len(NAMES)].copy()
    parameters[_LOGARITHMIC] = np.exp(parameters[_LOGARITHMIC])
    return parameters


def search_coordinates(parameters: FloatArray) -> FloatArray:
    """Return (5,) search coordinates of the physical parameters: positive ones as logarithms."""
    coordinates = parameters.copy()
    coordinates[_LOGARITHMIC] = np.log(coordinates[_LOGARITHMIC])
    return coordinates


def _scale(parameters: FloatArray) -> FloatArray:
    """Return the derivatives (5,) of the parameters by the search coordinates."""
    scale = np.ones(len(NAMES))
    scale[_LOGARITHMIC] = parameters[_LOGARITHMIC]
    return scale


@dataclasses.dataclass(frozen=True)
class PitchEstimate:
    """Result of a fit.

    Attributes:
        parameters: (5,) in the order of `NAMES`.
        covariance: (5, 5).
        information: (9, 9) posterior, in search coordinates.
        coordinates: (9,) search coordinates.
        chi_square: Squared prediction errors over their variances, per tilt sample.
        samples: Number of tilt samples.
        lost: Number of samples before which the motion was unknown.
        gain_left: What a whole Newton step promises to gain of half the squared residuals.
        cost: Negative logarithm of the posterior density, but for a constant.
        names: Names of the five parameters.
    """

    parameters: FloatArray
    covariance: FloatArray
    information: FloatArray
    coordinates: FloatArray
    chi_square: float
    samples: int
    lost: int
    gain_left: float
    cost: float
    names: tuple[str, ...] = NAMES

    def doubts(self, prior: PitchPrior) -> tuple[str, ...]:
        """Return why the estimate is not to be used, in words; none if it is."""
        lost = self.lost / max(self.samples, 1)
        reasons = {
            "the fit did not converge": self.gain_left > SMALLEST_GAIN,
            f"chi squared is {self.chi_square:.1f}": self.chi_square > LARGEST_CHI_SQUARE,
            f"{100 * lost:.0f} % of the motion could not be foreseen": lost > LARGEST_LOSS,
        }
        unknown = ", ".join(self.unidentifiable(prior))
        reasons[f"the motion does not show {unknown}"] = bool(unknown)
        return tuple(words for words, holds in reasons.items() if holds)

    def unidentifiable(self, prior: PitchPrior, shrinkage: float = 0.5) -> tuple[str, ...]:
        """Return the parameters whose deviation stayed above `shrinkage` of the prior's."""
        deviation = np.sqrt(np.diag(np.linalg.inv(self.information)))[:5]
        return tuple(
            self.names[i] for i in np.flatnonzero(deviation > shrinkage * prior.sigma()[:5])
        )


@dataclasses.dataclass(frozen=True)
class _Filter:
    """Gains (m, 4) of a Kalman filter, and the deviations (m,) of its prediction errors [rad]."""

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
        misfit: What the model misses.
    """

    data: PitchData
    sensors: PitchSensors
    misfit: PitchMisfit = ROVER_MISFIT

    def filter(self, coordinates: FloatArray) -> _Filter:
        """Return the Kalman filter at (9,) search coordinates."""
        model = self._model(coordinates)
        moment = model.moment(self.data.wrench)
        variance = model.moment_variance(self.sensors)
        misfit = self.misfit
        unsure = variance + misfit.moment**2 + (misfit.moment_share * moment) ** 2
        return _Filter(
            *kalman_gains(
                model.step,
                model.shown[2],
                self.data.indices + model.lead,
                self.data.lost,
                unsure,
                self.sensors.tilt_sigma**2,
            )
        )

    def residuals(self, coordinates: FloatArray, given: _Filter) -> FloatArray:
        """Return the filter's prediction errors (m,) at `coordinates`, over its deviations."""
        model = self._model(coordinates)
        moment = model.moment(self.data.wrench)
        moment -= dry_moment(model.step, moment, model.friction)
        errors = prediction_errors(
            model.step,
            model.shown[2],
            moment,
            self.data.indices + model.lead,
            self.data.tilt - coordinates[len(NAMES)],
            given.gains,
        )
        return errors / given.deviations

    def _model(self, coordinates: FloatArray) -> PitchModel:
        nuisance = Nuisance(*coordinates[len(NAMES) :].tolist())
        return PitchModel.of(physical(coordinates), self.sensors, nuisance)

    def slopes(self, coordinates: FloatArray, given: _Filter) -> FloatArray:
        """Return the derivatives (m, 9) of what is predicted, by central differences."""
        columns = [
            self.residuals(coordinates - step, given) - self.residuals(coordinates + step, given)
            for step in _STEP * np.eye(len(coordinates))
        ]
        return np.stack(columns, axis=1) / (2 * _STEP)


class PitchFit:
    """Maximum a posteriori fit of the tilt, warm-started from one window to the next.

    Args:
        sensors: Sampling and noise of wrench and inclinometer.
        prior: Prior of the five parameters and its deviations; a generic guess by default.
        misfit: What the model misses of the base.
        names: Names of the five parameters.
    """

    def __init__(
        self,
        sensors: PitchSensors,
        prior: PitchPrior | None = None,
        misfit: PitchMisfit = ROVER_MISFIT,
        names: tuple[str, ...] = NAMES,
    ) -> None:
        self.prior = prior or PitchPrior()
        self._sensors, self._misfit, self._names = sensors, misfit, names
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
            Nothing, after each iteration, since the whole takes longer than a robot waits for a
            command.
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
        return _Likelihood(data, self._sensors, self._misfit)

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
        """Return cost, gradient (9,) and information (9, 9), the prior's share in each."""
        slopes, precision = likelihood.slopes(point, given), np.diag(self.prior.sigma() ** -2)
        gradient = slopes.T @ likelihood.residuals(point, given)
        gradient -= precision @ (point - self.prior.mean())
        return self._cost(likelihood, point, given), gradient, slopes.T @ slopes + precision

    def _summary(self, likelihood: _Likelihood, point: FloatArray) -> PitchEstimate:
        given = likelihood.filter(point)
        cost, gradient, information = self._normal(likelihood, point, given)
        residual, parameters = likelihood.residuals(point, given), physical(point)
        scale, together = _scale(parameters), np.zeros(len(NAMES))
        # A wrench on another scale makes a base heavier, stiffer and more damped, no more.
        together[_LOGARITHMIC] = self._sensors.wrench_scale_sigma
        covariance = np.linalg.inv(information)[: len(NAMES), : len(NAMES)]
        covariance += np.outer(together, together) + np.diag(np.square(self._misfit.parameters))
        return PitchEstimate(
            parameters=parameters,
            covariance=covariance * np.outer(scale, scale),
            information=information,
            coordinates=point,
            chi_square=float(residual @ residual) / max(len(residual), 1),
            samples=len(residual),
            lost=int(likelihood.data.lost.sum()),
            gain_left=0.5 * float(gradient @ np.linalg.solve(information, gradient)),
            cost=cost + float(np.sum(np.log(given.deviations))),
            names=self._names,
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
    """Return the Fisher information (9, 9) of the tilt over the last `samples` of a wrench.

    Args:
        estimate: Estimate about which the model is linearised.
        wrench: (n, 6) past and forecast deviation from rest.
        samples: Number of forecast samples at its end.
        sensors: The sensors.
    """
    every = round(sensors.tilt_period / sensors.period)
    indices = np.arange(len(wrench) - 1, -1, -every)[::-1]
    readings = predict_tilt(estimate.parameters, wrench, sensors)[indices, 2]
    data = PitchData.of(wrench, indices, readings + estimate.coordinates[len(NAMES)])
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


CRITERIA = dict(zip(ROVER_CRITERIA, (information, d_optimal, a_optimal), strict=True))
