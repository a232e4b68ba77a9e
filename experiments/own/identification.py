"""Identification of any MuJoCo model from logs of its robot: checked, fitted, confirmed or not."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import mujoco
import numpy as np
from scipy.stats import chi2

from controllers.identification.any_model.fit import (
    SUSPECT,
    Fit,
    Measurements,
    Told,
    fit,
    information_of,
    ljung_box,
    told,
)
from perception.geometry.arrays import FloatArray
from twin.logs.log import Log
from twin.prediction.parameters import ModelError, Parameter, explicit, select
from twin.prediction.predictor import ModelPredictor, Start

CONFIRMED = 0.5
"""Largest error on unseen runs above the noise, over that of the model as drawn, that confirms."""
NOISE = 2.0
"""Chi^2 per sample up to which an error is hardly more than noise."""
SHORTER = (0.5, 0.25)
"""Shorter time steps by which a fit is mended, over those by which it was found."""
FINE = 5.0
"""Largest shift by the last halving of time steps, in deviations, of a result called good."""
FAR = 4.0
"""Deviations beforehand beyond which a parameter makes up for something else, or its spread is
too small."""
BEGINNINGS = (0.05, 0.1, 0.2, 0.4, 0.7)
"""Shares of the longest run that are fitted one after another where all cannot be explained."""
SHORTEST = 0.5
"""Shortest beginning of a run that is fitted [s]."""
SIGMAS = float(np.sqrt(chi2.ppf(0.95, 1)))
"""Half of a 95 % band, in deviations."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter.

    Attributes:
        name: Its name.
        unit: Its unit.
        drawn: Its value as drawn.
        spread: How far off that may well be: a share of what is above zero, else in `unit`.
        value: Its value as fitted.
        low: Lower end of its 95 % band.
        high: Upper end.
        left: Its deviation over the one beforehand; 1 when nothing is known of it.
        bits: Information that the logs have on it (Thesis eq. 2-12b).
        told: Whether the logs tell it.
    """

    name: str
    unit: str
    drawn: float
    spread: float
    value: float
    low: float
    high: float
    left: float
    bits: float
    told: bool


@dataclasses.dataclass(frozen=True)
class Residual:
    """What is left of one channel of one run.

    Attributes:
        run: Number of the run.
        channel: Name of the channel.
        drawn: Root mean square of the error as drawn, over the noise's deviation.
        tuned: That as fitted.
        noise: Deviation of the noise [SI].
        white: Probability that noise alone is as alike to itself at other times (Ljung-Box).
    """

    run: int
    channel: str
    drawn: float
    tuned: float
    noise: float
    white: float


@dataclasses.dataclass(frozen=True)
class Runs:
    """Runs as measured and as predicted.

    Attributes:
        predictor: The model with its logs.
        drawn: (r,) predictions as drawn.
        tuned: (r,) predictions as fitted.
    """

    predictor: ModelPredictor
    drawn: FloatArray
    tuned: FloatArray

    def residuals(self) -> list[Residual]:
        """Return what is left, by run and channel."""
        found: list[Residual] = []
        for (run, channel), place in self.predictor.channels.items():
            sigma = self.predictor.sigma[place]
            drawn, tuned = (
                (self.predictor.measured[place] - each[place]) / sigma
                for each in (self.drawn, self.tuned)
            )
            sizes = float(np.sqrt(np.mean(drawn**2))), float(np.sqrt(np.mean(tuned**2)))
            found.append(Residual(run, channel, *sizes, float(sigma[0]), ljung_box(tuned)))
        return found

    def chi_square(self, predicted: FloatArray) -> float:
        """Return the squared error per sample, over the noise's variance."""
        off = (self.predictor.measured - predicted) / self.predictor.sigma
        return float(np.mean(off**2))

    @property
    def ratio(self) -> float:
        """Error above the noise as fitted, over that as drawn."""
        drawn, tuned = (
            np.sqrt(max(self.chi_square(each) - 1.0, 0.0)) for each in (self.drawn, self.tuned)
        )
        return float(tuned / drawn) if drawn > 0.0 else float(tuned > 0.0)


@dataclasses.dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Attributes:
        fit: The fit.
        before: What the logs can tell, by the model as drawn.
        after: What they told, by the model as fitted.
        estimates: The parameters.
        seen: The runs that were fitted.
        unseen: Runs that were held out; None if none was.
        doubts: Why it is not good; empty if it is.
        time_step: Time step of the model as drawn [s].
    """

    fit: Fit
    before: Told
    after: Told
    estimates: Sequence[Estimate]
    seen: Runs
    unseen: Runs | None
    doubts: Sequence[str]
    time_step: float

    def model(self) -> mujoco.MjSpec:
        """Return the model as fitted, with its time step as drawn."""
        spec = self.seen.predictor.tuned(self.fit.coordinates)
        spec.option.timestep = self.time_step
        return spec


def load_model(path: Path) -> mujoco.MjSpec:
    """Return the specification of a model file (MJCF or URDF).

    Raises:
        ModelError: If it cannot be read; in one line that names it.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()
    except (ValueError, OSError) as error:
        raise ModelError(f"{path}: {' '.join(str(error).split())}") from None
    # What is written elsewhere still finds meshes and textures.
    for kind in ("meshdir", "texturedir"):
        setattr(spec, kind, str((path.parent / getattr(spec, kind)).resolve()))
    return spec


def identify(
    spec: mujoco.MjSpec,
    logs: Sequence[Log],
    patterns: Sequence[str],
    held_out: Sequence[Log] = (),
    start: Start = "rest",
    step: float = np.inf,
    watch: Callable[[int, float], None] = lambda step, chi_square: None,
    check: Callable[[Told], None] = lambda before: None,
) -> Identified:
    """Identify parameters of a model.

    Args:
        spec: The model as drawn.
        logs: Runs of the robot.
        patterns: Parameters, as `select` takes them.
        held_out: Further runs, which confirm what was found or do not.
        start: How runs begin, as `ModelPredictor` takes it.
        step: Longest time step of the simulations [s].
        watch: Called at each step of the fit with its number and the chi^2 per sample.
        check: Called before the fit with what the logs can tell.

    Raises:
        ModelError: If the model has no such parameter.
        LogError: If a log does not fit the model.
        FitError: If the model diverges.
    """
    drawn_step, spec = float(spec.option.timestep), spec.copy()
    spec.option.timestep = min(spec.option.timestep, step)
    parameters = select(explicit(spec), patterns, _sensors(logs))
    predictor = ModelPredictor(spec, parameters, logs, start)
    measured = measurements(predictor)
    drawn = np.zeros(len(predictor.names))
    before = _told(information_of(predictor, measured, drawn), parameters, drawn)
    check(before)
    found = fit(predictor, measured, predictor.lowest, watch, hopeful=False)
    if found.chi_square > SUSPECT:
        begin = _from_shorter(spec, parameters, logs, start, watch)
        other = fit(predictor, measured, predictor.lowest, watch, begin)
        found = min(found, other, key=lambda each: each.chi_square)
    found = found.sobered(predictor, measured, predictor.lowest)
    found = _by_finer_steps(found, predictor, spec, parameters, logs, start)
    after = _told(found.information, parameters, found.coordinates)
    seen = Runs(predictor, *predictor(np.vstack([drawn, found.coordinates])))
    unseen = _unseen(spec, parameters, found.coordinates, held_out, start) if held_out else None
    return Identified(
        found,
        before,
        after,
        _estimates(parameters, found, after),
        seen,
        unseen,
        _doubts(found, unseen, [each.name for each in parameters]),
        drawn_step,
    )


def _told(
    information: FloatArray, parameters: Sequence[Parameter], coordinates: FloatArray
) -> Told:
    """Return what is told of parameters, the first coordinates, whatever the others are."""
    count = len(parameters)
    left = np.linalg.inv(information + np.eye(len(information)))[:count, :count]
    own = np.linalg.inv(left) - np.eye(count)
    return told(own, [each.name for each in parameters], coordinates[:count])


def _from_shorter(
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    logs: Sequence[Log],
    start: Start,
    watch: Callable[[int, float], None],
) -> FloatArray:
    """Return coordinates that explain ever longer beginnings of the logs, one after another.

    Where a robot drifts off under its commands, a model that is far off has lost it at the end of a
    long run, and no direction from there leads back.
    """
    begin: FloatArray | None = None
    longest = max(last - first for first, last in (log.span for log in logs))
    for duration in sorted({max(share * longest, SHORTEST) for share in BEGINNINGS}):
        parts = [log.until(log.span[0] + duration) for log in logs]
        with closing(ModelPredictor(spec, parameters, parts, start)) as predictor:
            measured = measurements(predictor)
            found = fit(predictor, measured, predictor.lowest, watch, begin, rough=True)
            begin = found.coordinates
    assert begin is not None
    return begin


def _by_finer_steps(
    found: Fit,
    predictor: ModelPredictor,
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    logs: Sequence[Log],
    start: Start,
) -> Fit:
    """Return the fit that shorter time steps would give, by the same derivatives.

    Of a long log and little noise the steps are what the fit is least sure of. What the last
    halving moves is what may be left.
    """
    points: list[FloatArray] = []
    for share in SHORTER:
        finer = spec.copy()
        finer.option.timestep *= share
        with closing(ModelPredictor(finer, parameters, logs, start)) as other:
            points.append(found.moved(other, measurements(predictor), predictor.lowest))
    return dataclasses.replace(found, coordinates=points[-1], shift=points[-1] - points[-2])


def predicted(spec: mujoco.MjSpec, logs: Sequence[Log], start: Start) -> Runs:
    """Return runs as a model predicts them, as it is.

    Raises:
        LogError: If a log does not fit the model.
        FitError: If the model diverges.
    """
    return _unseen(spec, [], np.zeros(0), logs, start)


def _sensors(logs: Sequence[Log]) -> Mapping[str, int]:
    return {
        name: signal.values.shape[1]
        for log in logs
        for name, signal in log.signals.items()
        if signal.role == "sensor"
    }


def measurements(predictor: ModelPredictor) -> Measurements:
    """Return what was measured in the logs of a predictor."""
    places = list(predictor.channels.values())
    return Measurements(predictor.measured, predictor.sigma, places, predictor.steps)


def _estimates(parameters: Sequence[Parameter], found: Fit, after: Told) -> list[Estimate]:
    deviations = np.sqrt(np.diag(found.covariance)).tolist()
    estimates: list[Estimate] = []
    for index, each in enumerate(parameters):
        at, deviation = float(found.coordinates[index]), deviations[index]
        low, high = (
            each.value(max(at + sign * SIGMAS * deviation, each.lowest)) for sign in (-1.0, 1.0)
        )
        estimates.append(
            Estimate(
                each.name,
                each.unit,
                each.nominal,
                each.spread,
                each.value(at),
                low,
                high,
                deviation,
                float(after.bits[index]),
                each.name not in after.unknown,
            )
        )
    return estimates


def _unseen(
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    coordinates: FloatArray,
    logs: Sequence[Log],
    start: Start,
) -> Runs:
    """Return held-out runs as predicted; where they begin is sought in them, if need be."""
    predictor = ModelPredictor(spec, parameters, logs, start)
    count = len(parameters)
    extra = len(predictor.names) - count
    predicted: list[FloatArray] = []
    for own in (np.zeros(count), coordinates[:count]):
        begin = np.zeros(extra)
        if extra:

            def from_begin(begins: FloatArray, own: FloatArray = own) -> FloatArray:
                return predictor(np.hstack([np.tile(own, (len(begins), 1)), begins]))

            measured = dataclasses.replace(measurements(predictor), steps=predictor.steps[count:])
            begin = fit(from_begin, measured, predictor.lowest[count:]).coordinates
        predicted.append(predictor(np.concatenate([own, begin])[None])[0])
    return Runs(predictor, *predicted)


def _doubts(found: Fit, unseen: Runs | None, names: Sequence[str]) -> list[str]:
    doubts: list[str] = []
    if not found.converged:
        doubts.append("the fit did not converge")
    if found.chi_square > NOISE:
        doubts.append(
            f"chi^2 per sample is {found.chi_square:.3g}: the model does not explain the logs"
        )
    if float(found.shifted.max(initial=0.0)) > FINE:
        doubts.append(
            "time steps of a quarter of the length, not of half, move a parameter by "
            f"{found.shifted.max():.2g} of its deviations; say a shorter --step"
        )
    doubts += [
        f"{name} is {abs(at):.2g} times as far off as may well be: either that is said too small, "
        "or it makes up for what the model has not"
        for name, at in zip(names, found.coordinates.tolist())
        if abs(at) > FAR
    ]
    doubts += [
        f"what is predicted jumps beside the {names[index]} that was found, where something sticks "
        "or slips: its band means nothing"
        for index in found.edges
        if index < len(names)
    ]
    if unseen is None:
        doubts.append("no run was held out to confirm it")
    elif unseen.ratio > CONFIRMED and unseen.chi_square(unseen.tuned) > NOISE:
        doubts.append(
            f"on unseen runs its error above the noise is {unseen.ratio:.2g} of that as drawn "
            f"(at most {CONFIRMED:g} confirms it)"
        )
    return doubts
