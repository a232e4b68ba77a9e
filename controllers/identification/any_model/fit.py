"""Fit of any model's parameters to what was measured, and what the measurements can tell of them.

The model is a function from coordinates to what its sensors would read. Each coordinate has a
standard normal distribution beforehand, and the fit is the most probable point (maximum a
posteriori), found by Levenberg and Marquardt's steps.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import chi2

from controllers.identification.information import mutual_information
from perception.geometry.arrays import BoolArray, FloatArray, IntArray

Predict = Callable[[FloatArray], FloatArray]
"""From (m, n) coordinates to (m, r) predictions; NaN where they cannot be made."""

COARSE = 1e-3
"""Step of a coordinate from which on derivatives need steps to both sides."""
MOST_STEPS = 30
"""Most steps of a fit."""
PATIENCE, HOPE = 8, 0.1
"""Steps in which a fit that may be given up has to lower chi^2 to this share."""
SMALLEST_GAIN = 0.01
"""Gain of the logarithm of the probability at which a fit has converged."""
LONGEST = 1.0
"""Longest step of a coordinate, in deviations beforehand: a model far off may not stay upright."""
DAMPING = 1e-3
"""Share of the information's diagonal that is added to it in the first step."""
MOST_DAMPING = 1e6
"""Damping beyond which no step leads on."""
SUSPECT = 2.0
"""Chi^2 per sample above which an optimum may be a local one, and is left if a jump leads lower."""
SMALL_GAIN = 0.01
"""Gain of a step, over all that there is to gain, that is hardly worth one."""
JUMPS = (-2.0, -1.0, -0.5, -0.25, 0.25, 0.5, 1.0, 2.0)
"""Jumps of one coordinate that are tried there, in deviations beforehand."""
SCAN = np.arange(0.0, 2.6, 0.125)
"""Values of a coordinate that ends at zero that are tried before a fit, above its start."""
MOST_JUMPS = 3
"""Most jumps of a fit."""
SHRINKAGE = 0.5
"""A parameter of which the deviation stays above this share of the one beforehand was not told."""
RANGE = 2.0
"""Range on which information is counted in bits, in deviations beforehand to either side."""
DIVERGED = "the model diverges under the commands of the log; is its step too long?"
USUAL, SPIKE = 0.98, 30.0
"""Share of a channel's samples that are usual, and size over theirs of a derivative that is not."""
WIDE, LINEAR = 1e-2, 3.0
"""Step of derivatives that look past small jumps of a prediction, or a tenth or ten times of it,
and by how much it may change the prediction, in deviations of the noise."""
STEEP = 1.5
"""How much larger a derivative of the small step is where it fell on a jump."""
MOVES = 2
"""Steps to the likeliest point of another prediction by the same derivatives."""
LAGS = 20
"""Lags by which residuals are compared with themselves."""
WHITE = 0.01
"""Probability below which residuals are not white."""
NOTED = 0.2
"""Least weight of a parameter that is named in a combination."""


class FitError(ValueError):
    """Measurements to which the model cannot be fitted; in one line."""


@dataclasses.dataclass(frozen=True)
class Measurements:
    """What was measured.

    Attributes:
        values: (r,) samples; all finite.
        sigma: (r,) standard deviations of their noise.
        channels: Where the samples of each channel are.
        steps: (n,) steps of the coordinates that derivatives need.
    """

    values: FloatArray
    sigma: FloatArray
    channels: Sequence[slice]
    steps: FloatArray

    def heat(self, residuals: FloatArray) -> FloatArray:
        """Return by how much the noise's variance has to be larger to explain residuals.

        Args:
            residuals: (r,) over `sigma`.

        Returns:
            (r,) factors, each 1 or more, its channel's chi^2 per sample.
        """
        heat = np.ones(len(residuals))
        for channel in self.channels:
            heat[channel] = max(1.0, float(np.mean(residuals[channel] ** 2)))
        return heat

    def repeats(self, residuals: FloatArray) -> FloatArray:
        """Return how many samples tell as much as one would whose noise were white.

        Args:
            residuals: (r,) what is left.

        Returns:
            (r,) factors, each 1 or more. That of a channel that is not white is the integral of
            its autocorrelation, up to where that of two neighbours is no longer above zero.
        """
        factor = np.ones(len(residuals))
        for channel in self.channels:
            if ljung_box(residuals[channel]) < WHITE:
                factor[channel] = _correlation_time(residuals[channel])
        return factor


@dataclasses.dataclass(frozen=True)
class Told:
    """What measurements tell of each coordinate.

    Attributes:
        sigma: (n,) deviations left, of one beforehand.
        bits: (n,) mutual information (Thesis eq. 2-12b) in a range of two deviations to each side.
        unknown: Names of the coordinates that are hardly told.
        combinations: What stays unknown, as name -> weight, largest weights first.
    """

    sigma: FloatArray
    bits: FloatArray
    unknown: tuple[str, ...]
    combinations: tuple[Mapping[str, float], ...]


@dataclasses.dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        coordinates: (n,) the fitted point.
        information: (n, n) of the measurements alone, each channel as noisy as its residuals say.
        residuals: (r,) what was measured less what is predicted, over the noise's deviation.
        gain_left: What another step promises to gain of the logarithm of the probability.
        gained: What the better of the last two steps gained; infinity before these, zero where no
            step gains.
        steps: Number of steps.
        spread: (r,) deviation of as much noise as the residuals say, over that of `Measurements`.
        weighted: (r, n) derivatives of the predictions, over that deviation.
        shift: (n,) by which the better of two finer predictions moved the point further; zero
            before.
        edges: Coordinates beside which the prediction jumps by more than the noise, so that their
            deviations mean nothing; none unless `sobered`.
    """

    coordinates: FloatArray
    information: FloatArray
    residuals: FloatArray
    gain_left: float
    gained: float
    steps: int
    spread: FloatArray
    weighted: FloatArray
    shift: FloatArray
    edges: tuple[int, ...] = ()

    @property
    def chi_square(self) -> float:
        """Squared residuals per sample; 1 when the model explains all but the noise."""
        return float(np.mean(self.residuals**2))

    @property
    def converged(self) -> bool:
        """True when another step would gain next to nothing, or the last two did.

        Where dry friction holds a joint the likeliest point may lie in a sharp bend of the
        prediction: what derivatives promise there no step gains.
        """
        return min(self.gain_left, self.gained) <= SMALLEST_GAIN

    @property
    def covariance(self) -> FloatArray:
        """(n, n) of the coordinates; a shift counts as one deviation, as as much may be left."""
        return self._of_noise + np.outer(self.shift, self.shift)

    @property
    def shifted(self) -> FloatArray:
        """(n,) size of the shift, over the deviation that is due to noise."""
        return np.abs(self.shift) / np.sqrt(np.diag(self._of_noise))

    @property
    def _of_noise(self) -> FloatArray:
        return np.linalg.inv(self.information + np.eye(len(self.information))).astype(np.float64)

    def sobered(self, predict: Predict, measured: Measurements, lowest: FloatArray) -> "Fit":
        """Return the fit without what derivatives claim that fell on a jump of the prediction.

        Where time passes in steps a joint that sticks or slips does so a step sooner or later: the
        prediction jumps a little at many places, and a derivative across one is large. So each is
        taken as well over the widest step that changes the prediction by `LINEAR` at most.

        Args:
            predict: The model.
            measured: What was measured, with the steps of the derivatives.
            lowest: (n,) least values of the coordinates.
        """
        weighted, edges = self.weighted.copy(), set[int]()
        columns = np.flatnonzero(measured.steps <= COARSE)
        widths = np.full(len(columns), WIDE)
        for _ in range(2):
            rows = self._across(predict, measured, lowest, columns, widths)
            changes = widths * np.linalg.norm(rows, axis=1)
            for index, row, change in zip(columns.tolist(), rows, changes, strict=True):
                steep = np.linalg.norm(weighted[:, index]) > STEEP * np.linalg.norm(row)
                edges.discard(index)
                if steep and change > LINEAR:  # neither of NaN
                    edges.add(index)
                elif steep:
                    weighted[:, index] = row
            wider = 10.0 * changes <= LINEAR
            again = wider | ~(changes <= LINEAR)
            widths = np.where(wider, 10.0, 0.1)[again] * widths[again]
            columns = columns[again]
        return dataclasses.replace(
            self,
            information=weighted.T @ weighted,
            weighted=weighted,
            edges=tuple(sorted(edges)),
        )

    def _across(
        self,
        predict: Predict,
        measured: Measurements,
        lowest: FloatArray,
        columns: IntArray,
        widths: FloatArray,
    ) -> FloatArray:
        """Return weighted derivatives (m, r) by some coordinates over steps to both sides."""
        steps = np.zeros((len(columns), len(lowest)))
        steps[np.arange(len(columns)), columns] = widths
        above = self.coordinates + steps
        below = np.maximum(self.coordinates - steps, lowest)
        found = predict(np.vstack([above, below]))
        apart = np.sum(above - below, axis=1)[:, None]
        rows = (found[: len(columns)] - found[len(columns) :]) / apart
        return (rows / measured.sigma / self.spread).astype(np.float64)

    def coloured(self, measured: Measurements) -> "Fit":
        """Return the fit with as much less information as residuals repeat themselves."""
        factor = measured.repeats(self.residuals)
        weighted = self.weighted / np.sqrt(factor)[:, None]
        spread = self.spread * np.sqrt(factor)
        return dataclasses.replace(
            self, information=weighted.T @ weighted, spread=spread, weighted=weighted
        )

    def moved(self, predict: Predict, measured: Measurements, lowest: FloatArray) -> FloatArray:
        """Return the point (n,) that a better prediction makes likeliest, by the same derivatives.

        Args:
            predict: The better prediction.
            measured: What was measured.
            lowest: (n,) least values of the coordinates.

        Raises:
            FitError: If it diverges.
        """
        x = self.coordinates
        for _ in range(MOVES):
            off = (measured.values - predict(x[None])[0]) / measured.sigma / self.spread
            if not np.isfinite(off).all():
                raise FitError(DIVERGED)
            x = np.maximum(x + self._of_noise @ (self.weighted.T @ off - x), lowest)
        return x


def fit(
    predict: Predict,
    measured: Measurements,
    lowest: FloatArray,
    watch: Callable[[int, float], None] = lambda step, chi_square: None,
    begin: FloatArray | None = None,
    hopeful: bool = True,
    rough: bool = False,
) -> Fit:
    """Fit coordinates to measurements.

    Args:
        predict: The model.
        measured: What was measured.
        lowest: (n,) least values of the coordinates; minus infinity where there is none.
        watch: Called with the number of each step and the chi^2 per sample before it.
        begin: (n,) coordinates to begin with; None for zero.
        hopeful: Whether it goes on where the first `PATIENCE` steps have hardly led anywhere.
        rough: Whether it ends with the first step that is hardly worth one.

    Raises:
        FitError: If the model diverges where it begins.
    """
    x = np.maximum(np.zeros(len(lowest)) if begin is None else begin, lowest)
    x = _scanned(predict, measured, x, lowest)
    damping, step, left = DAMPING, 0, MOST_JUMPS
    last = previous = enough = np.inf
    careful = False
    while True:
        residuals, rows = _linearised(predict, measured, x, careful)
        chi_square = float(np.mean(residuals**2))
        watch(step, chi_square)
        if step == 0 and not hopeful:
            enough = max(HOPE * chi_square, SUSPECT)
        # A channel far off counts for less, or what the measurements hardly tell would run away.
        heat = measured.heat(residuals)
        information = rows.T @ (rows / heat[:, None])
        gradient = x - rows.T @ (residuals / heat)
        free = (x > lowest) | (gradient < 0.0)
        posterior = information + np.eye(len(x))
        gain = -0.5 * float(gradient @ _solve(posterior, gradient, free))
        gained = max(last, previous)
        spread = np.sqrt(heat)
        weighted = rows / spread[:, None]
        shift = np.zeros(len(x))
        done = Fit(x, information, residuals, gain, gained, step, spread, weighted, shift)
        if step == MOST_STEPS or (step == PATIENCE and chi_square > enough):
            return done.coloured(measured)
        stalled = done.converged or gain < SMALL_GAIN * _cost(residuals, heat, x)
        if rough and 0.0 <= last < SMALL_GAIN * _cost(residuals, heat, x):
            return done.coloured(measured)
        better = None
        if stalled and left and done.chi_square > SUSPECT:
            better, left = _jump(predict, measured, done, lowest), left - 1
        if better is None and not done.converged:
            better, damping = _descent(predict, measured, done, lowest, gradient, free, damping)
        if better is None and not careful and not done.converged:
            careful = True
            continue
        if better is None:
            return dataclasses.replace(done, gained=0.0).coloured(measured)
        (x, now), previous, step, careful = better, last, step + 1, False
        last = _cost(residuals, heat, done.coordinates) - now


def _scanned(
    predict: Predict, measured: Measurements, x: FloatArray, lowest: FloatArray
) -> FloatArray:
    """Return a start at which each coordinate that ends at zero is likeliest, one after another.

    These are delays above all, of which many values are better than those beside them where
    commands come in steps.
    """
    for index in np.flatnonzero(np.isfinite(lowest)):
        trials = np.repeat(x[None], len(SCAN), axis=0)
        trials[:, index] += SCAN
        off = (measured.values - predict(trials)) / measured.sigma
        if not np.isfinite(off[0]).all():
            raise FitError(DIVERGED)
        heat = measured.heat(off[0])
        costs = [_cost(each, heat, trial) for each, trial in zip(off, trials, strict=True)]
        x = trials[int(np.nanargmin(costs))]
    return x


def _descent(
    predict: Predict,
    measured: Measurements,
    now: Fit,
    lowest: FloatArray,
    gradient: FloatArray,
    free: BoolArray,
    damping: float,
) -> tuple[tuple[FloatArray, float] | None, float]:
    """Return a likelier point with its cost, or none, and the damping to go on with."""
    posterior = now.information + np.eye(len(gradient))
    heat = measured.heat(now.residuals)
    cost = _cost(now.residuals, heat, now.coordinates)
    while damping < MOST_DAMPING:
        move = _solve(posterior + damping * np.diag(np.diag(posterior)), gradient, free)
        move *= min(1.0, LONGEST / np.abs(move).max())
        trial = np.maximum(now.coordinates + move, lowest)
        off = (measured.values - predict(trial[None])[0]) / measured.sigma
        found = _cost(off, heat, trial)
        if found < cost:  # never of NaN
            return (trial, found), damping / 10.0
        damping *= 10.0
    return None, DAMPING


def _jump(
    predict: Predict, measured: Measurements, now: Fit, lowest: FloatArray
) -> tuple[FloatArray, float] | None:
    """Return a likelier point at which one coordinate is elsewhere with its cost, or none."""
    count = len(lowest)
    moves = [jump * row for row in np.eye(count) for jump in JUMPS]
    trials = np.maximum(now.coordinates + np.array(moves), lowest)
    off = (measured.values - predict(trials)) / measured.sigma
    heat = measured.heat(now.residuals)
    costs = [_cost(each, heat, trial) for each, trial in zip(off, trials, strict=True)]
    best = int(np.argmin(np.nan_to_num(costs, nan=np.inf)))
    likelier = costs[best] < _cost(now.residuals, heat, now.coordinates)
    return (trials[best], costs[best]) if likelier else None


def _cost(residuals: FloatArray, heat: FloatArray, x: FloatArray) -> float:
    return float(0.5 * (residuals @ (residuals / heat) + x @ x))


def ljung_box(residuals: FloatArray) -> float:
    """Return the probability that white noise is as alike to itself at `LAGS` lags or fewer."""
    count = len(residuals)
    lags = min(LAGS, count // 4)
    power = float(np.sum((residuals - residuals.mean()) ** 2))
    if not lags or not power:
        return 1.0
    alike = _autocorrelation(residuals, lags)
    statistic = count * (count + 2.0) * np.sum(alike**2 / (count - np.arange(1, lags + 1)))
    return float(chi2.sf(statistic, lags))


def _correlation_time(residuals: FloatArray) -> float:
    """Return the integral of an autocorrelation, in samples, by Geyer's initial positive sums."""
    alike = np.concatenate([[1.0], _autocorrelation(residuals, len(residuals) // 2)])
    pairs = alike[: len(alike) // 2 * 2].reshape(-1, 2).sum(axis=1)
    last = int(np.argmax(pairs <= 0.0)) if np.any(pairs <= 0.0) else len(pairs)
    return max(1.0, float(2.0 * pairs[:last].sum() - 1.0))


def _autocorrelation(residuals: FloatArray, lags: int) -> FloatArray:
    """Return the autocorrelation (lags,) at one lag or more."""
    off = residuals - residuals.mean()
    return np.array([off[lag:] @ off[:-lag] for lag in range(1, lags + 1)]) / (off @ off)


def information_of(predict: Predict, measured: Measurements, x: FloatArray) -> FloatArray:
    """Return the Fisher information (n, n) that measurements have at coordinates (n,)."""
    _, rows = _linearised(predict, measured, x)
    return rows.T @ rows


def told(information: FloatArray, names: Sequence[str], coordinates: FloatArray) -> Told:
    """Return what measurements tell of each coordinate.

    Args:
        information: (n, n) of the measurements alone.
        names: Names of the coordinates.
        coordinates: (n,) where the information was taken.
    """
    posterior = information + np.eye(len(information))
    sigma = np.sqrt(np.diag(np.linalg.inv(posterior)))
    bounds = np.tile([-RANGE, RANGE], (len(sigma), 1))
    bits = mutual_information(coordinates, sigma, bounds)
    unknown = tuple(name for name, left in zip(names, sigma, strict=True) if left > SHRINKAGE)
    values, vectors = np.linalg.eigh(posterior)
    combinations: list[dict[str, float]] = []
    for value, vector in zip(values, vectors.T, strict=True):
        if value * SHRINKAGE**2 > 1.0:
            break
        weights = sorted(zip(names, vector.tolist(), strict=True), key=lambda pair: -abs(pair[1]))
        combinations.append({name: each for name, each in weights if abs(each) > NOTED})
    return Told(sigma, bits, unknown, tuple(combinations))


def _linearised(
    predict: Predict, measured: Measurements, x: FloatArray, careful: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (r,) and the weighted derivatives (r, n) of the predictions.

    Where a robot sticks on one side of a point and slips on the other, what it does from then on
    jumps. Careful, derivatives are those of the side on which the prediction changes less.
    """
    steps = measured.steps
    above = np.vstack([x, x + np.diag(steps)])
    coarse = steps > COARSE
    below = x - np.diag(steps)[coarse]
    found = predict(np.vstack([above, below]))
    if not np.isfinite(found).all():
        raise FitError(DIVERGED)
    rows = (found[1 : len(above)] - found[0]) / steps[:, None]
    rows[coarse] = (found[1 : len(above)][coarse] - found[len(above) :]) / (
        2.0 * steps[coarse, None]
    )
    fine = np.flatnonzero(~coarse)
    doubted = [index for index in fine if careful or _has_spike(rows[index], measured)]
    if doubted:
        other = (found[0] - predict(x - np.diag(steps)[doubted])) / steps[doubted, None]
        smaller = np.abs(other) < np.abs(rows[doubted])
        if careful:
            sizes = [
                np.linalg.norm(each / measured.sigma, axis=1) for each in (other, rows[doubted])
            ]
            smaller = (sizes[0] < sizes[1])[:, None]
        rows[doubted] = np.where(smaller, other, rows[doubted])
    return (measured.values - found[0]) / measured.sigma, (rows / measured.sigma).T


def _has_spike(row: FloatArray, measured: Measurements) -> bool:
    """Return whether derivatives (r,) of a channel are much larger at few samples than at others.

    Where a robot sticks or slips, what an accelerometer reads jumps, and a sample may lie just
    there: the derivative is that of the side without the jump.
    """
    for place in measured.channels:
        sizes = np.sort(np.abs(row[place]))
        usual = sizes[: max(1, int(USUAL * len(sizes)))]
        if sizes[-1] > SPIKE * float(np.sqrt(np.mean(usual**2))):
            return True
    return False


def _solve(matrix: FloatArray, gradient: FloatArray, free: BoolArray) -> FloatArray:
    """Return the step (n,) of the coordinates that are free."""
    step = np.zeros(len(gradient))
    step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], gradient[free])
    return step
