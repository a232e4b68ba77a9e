"""``excite``: the motion that tells most of a model's parameters, or most beyond what is known."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from controllers.identification.any_model.fit import FitError, Told, information_of, told
from controllers.identification.any_model.motion import Series, design
from experiments.harness.contract import ExperimentError
from experiments.own.excite_options import Options
from experiments.own.identification import load_model, measurements
from experiments.own.identify import print_told
from experiments.own.motion_file import write_motion
from perception.geometry import files
from perception.geometry.arrays import FloatArray
from twin.logs.log import Log, LogError, Signal
from twin.prediction.limits import Limits, read_limits
from twin.prediction.parameters import ModelError, Parameter, explicit, select, write_all
from twin.prediction.predictor import ModelPredictor


def run(options: Options) -> int:
    """Design a motion, write it, and print what it will tell.

    Raises:
        ExperimentError: If the model or the limits cannot be used.
    """
    try:
        spec = load_model(options.model)
        model = spec.compile()
        series = Series(home(model, options.home), options.duration, options.highest)
        silent = [name for name in sensors(model) if not model.sensor(name).noise[0] > 0.0]
        if silent:
            raise ExperimentError(
                f"{options.model}: noise of sensors {', '.join(silent)} is 0; say it in the model"
            )
        limits = Limits.of_model(model)
        if options.limits is not None:
            limits = read_limits(options.limits, model)
        parameters = select(explicit(spec), options.parameters, sensors(model))
        before = Prior.as_drawn(len(parameters))
        if options.known is not None:
            before = known_before(options.known, parameters)
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with Progress(*columns) as progress:
            task = progress.add_task("motions", total=options.generations)

            def watch(generation: int, best: float) -> None:
                text = f"deviations to {100.0 * 2.0**-best:.2g} % of those of the drawing"
                progress.update(task, completed=generation + 1, description=text)

            shape = best_shape(spec, parameters, series, limits, options, watch, before)
    except (LogError, ModelError, FitError) as error:
        raise ExperimentError(str(error)) from None
    stamps = np.arange(0.0, options.duration + 0.5 * options.period, options.period)
    names = [model.actuator(index).name for index in range(model.nu)]
    write_motion(options.out, names, stamps, series.commands(shape, stamps))
    will_tell = foretold(spec, parameters, series, shape, options, before)
    print_told(will_tell)
    sizes = ", ".join(
        f"{each.name} to {100.0 * left * each.spread:.2g} %"
        if each.scale == "factor"
        else f"{each.name} to {left * each.spread:.2g} {each.unit}"
        for each, left in zip(parameters, will_tell.sigma)
        if each.name not in will_tell.unknown
    )
    print(f"tells (one deviation): {sizes}")
    print(
        f"next: let the robot follow {options.out} (a rover of ours by play), log it, and identify"
    )
    return 0


@dataclasses.dataclass(frozen=True)
class Prior:
    """What is known of parameters before a motion.

    Attributes:
        coordinates: (n,) where they are believed to be.
        covariance: (n, n) of these.
    """

    coordinates: FloatArray
    covariance: FloatArray

    @classmethod
    def as_drawn(cls, count: int) -> "Prior":
        """Return what the drawing says of a number of parameters."""
        return cls(np.zeros(count), np.eye(count))

    @property
    def precision(self) -> FloatArray:
        """(n, n) inverse of the covariance."""
        return np.linalg.inv(self.covariance).astype(np.float64)


def known_before(path: Path, parameters: Sequence[Parameter]) -> Prior:
    """Return what runs before told; of parameters that were not sought, what the drawing says.

    Args:
        path: File ``identified.json`` of `identify`.
        parameters: Parameters of the model.

    Raises:
        ExperimentError: If it cannot be read, or holds none of them.
    """
    try:
        content = files.read_json(path, files.RESULTS)
        rows = {each["name"]: (row, each) for row, each in enumerate(content["parameters"])}
        covariance = np.array(content["covariance"], dtype=float)
        before = Prior.as_drawn(len(parameters))
        shared = [index for index, each in enumerate(parameters) if each.name in rows]
        if not shared:
            raise ValueError(f"none of {', '.join(each.name for each in parameters)} is in it")
        scale = np.empty(len(shared))
        for place, index in enumerate(shared):
            each = parameters[index]
            _, found = rows[each.name]
            before.coordinates[index] = each.coordinate(float(found["value"]))
            scale[place] = float(found["spread"]) / each.spread
        chosen = [rows[parameters[index].name][0] for index in shared]
        found = covariance[np.ix_(chosen, chosen)] * np.outer(scale, scale)
        before.covariance[np.ix_(shared, shared)] = found
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ExperimentError(f"{path}: no result of identify: {reason}") from None
    return before


def home(model: mujoco.MjModel, given: Sequence[float]) -> FloatArray:
    """Return the commands at rest.

    Raises:
        ExperimentError: If there are not as many as actuators.
    """
    if given:
        if len(given) != model.nu:
            raise ExperimentError(f"--home: {len(given)} commands for {model.nu} actuators")
        return np.array(given)
    return model.key_ctrl[0].copy() if model.nkey else np.zeros(model.nu)


def sensors(model: mujoco.MjModel) -> dict[str, int]:
    """Return the count of numbers of each sensor."""
    return {model.sensor(i).name: int(model.sensor_dim[i]) for i in range(model.nsensor)}


def best_shape(
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    series: Series,
    limits: Limits,
    options: Options,
    watch: Callable[[int, float], None],
    before: Prior | None = None,
) -> FloatArray:
    """Return the shape of the motion after which least is left of what is unknown.

    That is the mean of the parameters' squared deviations, in those of the drawing. The motion
    keeps to its limits on the robot as it is believed to be.

    Raises:
        ExperimentError: If no motion keeps to the limits.
    """
    before = before or Prior.as_drawn(len(parameters))
    believed = explicit(spec)
    write_all(believed, parameters, before.coordinates)
    model = believed.compile()
    steps = np.arange(0.0, series.duration, model.opt.timestep)

    def excess(shape: FloatArray) -> float:
        return limits.excess(model, series.commands(shape, steps))

    if not excess(np.zeros(series.size)) <= 1.0:
        raise ExperimentError("at rest the robot is beyond a limit; say another --home")

    def worth(shape: FloatArray) -> float:
        found = information_in(spec, parameters, series, shape, options, before.coordinates)
        left = np.linalg.inv(found + before.precision)
        return -0.5 * float(np.log2(np.trace(left) / len(parameters)))

    generator = np.random.default_rng(options.seed)
    return design(series, worth, excess, generator, options.generations, watch=watch)


def information_in(
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    series: Series,
    shape: FloatArray,
    options: Options,
    coordinates: FloatArray,
) -> FloatArray:
    """Return the information (n, n) that a log of a motion would have at coordinates (n,)."""
    model = spec.compile()
    stamps = np.arange(0.0, series.duration, options.period)
    samples = np.arange(0.0, series.duration, 1.0 / options.rate)
    commands = series.commands(shape, stamps)
    signals = {
        model.actuator(index).name: Signal("actuator", stamps, commands[:, [index]])
        for index in range(model.nu)
    }
    for name, count in sensors(model).items():
        signals[name] = Signal("sensor", samples, np.zeros((len(samples), count)))
    predictor = ModelPredictor(spec, parameters, [Log(signals)])
    try:
        return information_of(predictor, measurements(predictor), coordinates)
    finally:
        predictor.close()


def foretold(
    spec: mujoco.MjSpec,
    parameters: Sequence[Parameter],
    series: Series,
    shape: FloatArray,
    options: Options,
    before: Prior,
) -> Told:
    """Return what will be known after a log of a motion."""
    at = before.coordinates
    information = information_in(spec, parameters, series, shape, options, at)
    beyond_drawing = information + before.precision - np.eye(len(at))
    return told(beyond_drawing, [each.name for each in parameters], at)
