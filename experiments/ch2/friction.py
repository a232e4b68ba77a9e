"""``ch2-friction``: the arm's jerks show the friction under the wheels, and when they slip.

Each seed draws the ground's friction. The arm jerks twice: hard, to break the rover loose, and
gently, where mostly a lower bound can be given. The controller sees the arm's encoders, the
force/torque sensor, the inclinometer and the tachometers only; the truth is for scoring alone.
"""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

from controllers.identification.arm_sensing import IdentificationError
from controllers.identification.friction import (
    FrictionConfig,
    FrictionEstimate,
    FrictionProbe,
    JerkConfig,
    KnownBase,
)
from controllers.kinematics.serial_chain import SerialChain
from experiments.ch2.payload import run_recorded, sensing
from experiments.harness import contract
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.compose import FieldConfig, RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.connect import connect
from twin.describe import describe_rover

ROBOT = "rover1"
FRICTIONS = (0.2, 0.9)
EFFORTS = {"hard": JerkConfig().rates, "gentle": (0.4, 1.4)}  # first and last yaw rate [rad/s]
DURATION = 13.0  # [s]
ERROR_BOUND = 15.0  # [%]
HOLDS_BOUND = 0.95
FIELD = FieldConfig(texture_pixels=64)


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of the friction estimation."""

    targets: ClassVar[tuple[str, ...]] = ("sim", "quantised", "emulated")


def run(options: Options, output: Output) -> None:
    """Estimate one friction for each seed and effort, and score.

    Args:
        options: ``quick`` takes 6 seeds instead of 24.
        output: Receives ``friction_error_percent`` and ``lower_bound_holds_fraction``.
    """
    configs = [
        FrictionJob(
            seed,
            options.robot,
            effort,
            str(output.file("run.rrd"))
            if options.record and index == 0 and effort == "hard"
            else None,
        )
        for index, seed in enumerate(options.job_seeds(24, 6))
        for effort in EFFORTS
    ]
    results = sweep(probe_one, configs, options, output, label="grounds")
    _measure(results, output)
    columns = ("seed", "effort", "friction", "slipped", "estimate", "error_percent")
    columns = (*columns, "lower_bound", "onset", "rolled")
    rows = [[getattr(result, key) for key in columns] for result in results]
    output.table("friction_runs", columns, rows)
    output.figure("friction_estimates", _estimate_figure(results))
    output.figure("friction_in_use", _history_figure(results[0]))


def probe(
    friction: float, seed: int, effort: str, robot: str = "sim", record: str | None = None
) -> FrictionEstimate:
    """Jerk an arm on some ground, and return what was estimated.

    Args:
        friction: Friction coefficient of the ground.
        seed: Seed of the sensor noise.
        effort: Key of `EFFORTS`.
        robot: Which robot.
        record: File for a recording, if any.

    Raises:
        IdentificationError: If a sensor is missing.
    """
    drawn = describe_rover(ROBOT)
    config = FrictionConfig(
        SerialChain.of_robot(drawn),
        KnownBase.of_robot(drawn),
        dataclasses.replace(sensing(), tilt_motion=False),
        JerkConfig(rates=EFFORTS[effort]),
    )
    controller = FrictionProbe(ROBOT, config)
    field = dataclasses.replace(FIELD, friction=friction)
    connection = connect(robot, robots=[RobotPlacement(ROBOT)], field=field, seed=seed)
    run_recorded(connection, controller, DURATION, record)
    return controller.estimate()


@dataclasses.dataclass(frozen=True)
class FrictionJob:
    """One ground to probe.

    Attributes:
        seed: Random seed of the ground and of the sensor noise.
        robot: Which robot, as `twin.connect.connect` takes it.
        effort: How hard the arm jerks, a key of `EFFORTS`.
        record: File for a recording, if any.
    """

    seed: int
    robot: str
    effort: str
    record: str | None = None


@dataclasses.dataclass(frozen=True)
class FrictionRun:
    """What was estimated on one ground, compared with the truth.

    Attributes:
        seed: Random seed of the job.
        effort: How hard the arm jerked.
        friction: True friction coefficient of the ground.
        slipped: Whether the wheels were seen to slip.
        estimate: Estimated friction coefficient; None without slip.
        error_percent: Its error [%]; None without slip.
        lower_bound: Largest friction coefficient that was used without slip.
        onset: Time at which the slip began [s]; None without slip.
        rolled: Whether the wheels rolled.
        times: (n,) times of the samples [s].
        used: (n,) friction coefficient in use.
        yaw_rate: (n,) yaw rate from the wrench [rad/s].
        slipping: (n,) whether the wheels slip, 0 or 1.
    """

    seed: int
    effort: str
    friction: float
    slipped: bool
    estimate: float | None
    error_percent: float | None
    lower_bound: float
    onset: float | None
    rolled: bool
    times: FloatArray
    used: FloatArray
    yaw_rate: FloatArray
    slipping: FloatArray


def probe_one(config: FrictionJob) -> FrictionRun:
    """Draw, estimate and score one ground; a job of the sweep.

    Raises:
        ExperimentError: If a sensor is missing.
    """
    draws, noise = np.random.SeedSequence(config.seed).spawn(2)
    friction = float(np.random.default_rng(draws).uniform(*FRICTIONS))
    seed = int(noise.generate_state(1)[0])
    try:
        estimate = probe(friction, seed, config.effort, config.robot, config.record)
    except IdentificationError as error:
        raise ExperimentError(str(error)) from error
    error = 100.0 * abs(estimate.friction / friction - 1.0)
    return FrictionRun(
        seed=config.seed,
        effort=config.effort,
        friction=friction,
        slipped=estimate.slipped,
        estimate=None if np.isnan(error) else estimate.friction,
        error_percent=None if np.isnan(error) else error,
        lower_bound=estimate.lower_bound,
        onset=estimate.onset if estimate.slipped else None,
        rolled=estimate.rolled,
        times=estimate.load.times,
        used=estimate.load.used,
        yaw_rate=estimate.load.yaw_rate,
        slipping=estimate.slipping.astype(float),
    )


def _measure(results: Sequence[FrictionRun], output: Output) -> None:
    """Store the metrics and hold them against the bars."""
    for effort in EFFORTS:
        chosen = [result for result in results if result.effort == effort]
        slips = sum(result.slipped for result in chosen)
        output.measure(f"slipped_fraction/{effort}", fraction(slips, len(chosen)))
        estimates = sum(result.estimate is not None for result in chosen)
        output.measure(f"estimated_fraction/{effort}", fraction(estimates, len(chosen)))
    rolled = sum(result.rolled for result in results)
    output.measure("wheels_rolled_fraction", fraction(rolled, len(results)))
    estimated = [(run.estimate, run) for run in results if run.estimate is not None]
    if estimated:
        errors = np.array([run.error_percent for _, run in estimated])
        summary = distribution(errors)
        output.measure("friction_error_percent", summary)
        median, worst = summary["median"], float(errors.max())
        bound = f"<= {ERROR_BOUND:g}"
        output.check(
            "friction error where it slides, median [%]", median, bound, median <= ERROR_BOUND
        )
        output.check(
            "friction error where it slides, every run [%]", worst, bound, worst <= ERROR_BOUND
        )
        within = fraction(int(np.sum(errors <= ERROR_BOUND)), len(errors))
        output.measure(f"friction_error_percent/within_{ERROR_BOUND:g}", within)
        biases = [100.0 * (value / run.friction - 1.0) for value, run in estimated]
        output.measure("friction_bias_percent", distribution(biases))
    held = [result for result in results if result.estimate is None]
    if held:
        holds = sum(result.lower_bound <= result.friction for result in held)
        output.measure("lower_bound_holds_fraction", fraction(holds, len(held)))
        share = holds / len(held)
        output.check(
            "lower bound holds where it does not slide",
            share,
            f">= {HOLDS_BOUND:g}",
            share >= HOLDS_BOUND,
        )
        ratios = [result.lower_bound / result.friction for result in held]
        output.measure("lower_bound_over_friction", distribution(ratios))


def _estimate_figure(results: Sequence[FrictionRun]) -> Figure:
    """Draw estimates and lower bounds over the true friction."""
    figure = Figure(figsize=(7, 6))
    axes = figure.add_subplot()
    truth = np.array([0.15, 0.95])
    axes.plot(truth, truth, "k-", linewidth=0.8, label="truth")
    wide = ERROR_BOUND / 100.0
    axes.fill_between(
        truth, truth * (1 - wide), truth * (1 + wide), alpha=0.15, label=f"{ERROR_BOUND:g} %"
    )
    told = [(r.friction, r.estimate) for r in results if r.estimate is not None]
    held = [(r.friction, r.lower_bound) for r in results if r.estimate is None]
    for points, style, label in ((told, "o", "estimate, it slid"), (held, "^", "lower bound")):
        if points:
            axes.plot(*np.array(points).T, style, label=label)
    axes.set(xlabel="friction coefficient of the ground [-]", ylabel="estimated [-]")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


def _history_figure(result: FrictionRun) -> Figure:
    """Draw one run: the friction in use, and the yaw rate that shows the slip."""
    figure = Figure(figsize=(10, 5))
    upper, lower = figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2)
    times, slipping = result.times, result.slipping > 0.5
    upper.plot(times, result.used, linewidth=0.9, label="in use")
    upper.plot(times[slipping], result.used[slipping], "r.", markersize=3, label="slipping")
    upper.axhline(result.friction, color="k", linestyle="--", label="friction of the ground")
    upper.set(ylabel="friction coefficient [-]", ylim=(0.0, 2.0 * result.friction))
    upper.legend(loc="upper left")
    lower.plot(times, result.yaw_rate)
    lower.set(xlabel="time [s]", ylabel="yaw rate from the wrench [rad/s]")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure
