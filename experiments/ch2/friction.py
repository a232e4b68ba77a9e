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
from experiments.ch2.payload import JUDGED, judge_errors, run_recorded, sensing
from experiments.harness import contract
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models.compose import FieldConfig, RobotPlacement
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
    rows = [
        [run.seed, run.effort, run.friction, run.estimate.slipped, run.estimate.friction,
         abs(run.bias_percent), run.estimate.lower_bound, run.estimate.onset, run.estimate.rolled]
        for run in results
    ]  # fmt: skip
    # A number that the run does not give is an empty cell.
    cells = [
        [None if isinstance(value, float) and np.isnan(value) else value for value in row]
        for row in rows
    ]
    output.table("friction_runs", columns, cells)
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
        robot: Robot to connect to, as `twin.connect.connect` takes it.
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
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        effort: Strength of the jerks, a key of `EFFORTS`.
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
        effort: Strength of the jerks.
        friction: True friction coefficient of the ground.
        estimate: Estimate of the friction by the run.
    """

    seed: int
    effort: str
    friction: float
    estimate: FrictionEstimate

    @property
    def bias_percent(self) -> float:
        """Error of the estimate [%]; NaN without one."""
        return 100.0 * (self.estimate.friction / self.friction - 1.0)


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
    return FrictionRun(config.seed, config.effort, friction, estimate)


def _measure(results: Sequence[FrictionRun], output: Output) -> None:
    """Store the metrics and hold them against the bars."""
    biases = np.array([run.bias_percent for run in results])
    known = np.isfinite(biases)
    for effort in EFFORTS:
        chosen = [run.effort == effort for run in results]
        slips = [run.estimate.slipped for run in results]
        for key, flags in (("slipped", slips), ("estimated", known)):
            count = int(np.sum(np.logical_and(chosen, flags)))
            output.measure(f"{key}_fraction/{effort}", fraction(count, sum(chosen)))
    rolled = sum(run.estimate.rolled for run in results)
    output.measure("wheels_rolled_fraction", fraction(rolled, len(results)))
    if known.any():
        labels = [f"friction error where it slides, {which} [%]" for which in JUDGED]
        judge_errors(output, "friction_error_percent", np.abs(biases[known]), ERROR_BOUND, labels)
        output.measure("friction_bias_percent", distribution(biases[known]))
    held = [run for run, estimated in zip(results, known, strict=True) if not estimated]
    if held:
        ratios = np.array([run.estimate.lower_bound / run.friction for run in held])
        holds = sum(run.estimate.lower_bound <= run.friction for run in held)
        output.measure("lower_bound_holds_fraction", fraction(holds, len(held)))
        share = holds / len(held)
        name = "lower bound holds where it does not slide"
        output.check(name, share, f">= {HOLDS_BOUND:g}", share >= HOLDS_BOUND)
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
    friction = np.array([run.friction for run in results])
    estimates = np.array([run.estimate.friction for run in results])
    bounds = np.array([run.estimate.lower_bound for run in results])
    held = np.isnan(estimates)
    for points, values, style, label in (
        (~held, estimates, "o", "estimate, it slid"),
        (held, bounds, "^", "lower bound"),
    ):
        if points.any():
            axes.plot(friction[points], values[points], style, label=label)
    axes.set(xlabel="friction coefficient of the ground [-]", ylabel="estimated [-]")
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


def _history_figure(result: FrictionRun) -> Figure:
    """Draw one run: the friction in use, and the yaw rate that shows the slip."""
    figure = Figure(figsize=(10, 5))
    upper, lower = figure.add_subplot(2, 1, 1), figure.add_subplot(2, 1, 2)
    load, slipping = result.estimate.load, result.estimate.slipping
    upper.plot(load.times, load.used, linewidth=0.9, label="in use")
    upper.plot(load.times[slipping], load.used[slipping], "r.", markersize=3, label="slipping")
    upper.axhline(result.friction, color="k", linestyle="--", label="friction of the ground")
    upper.set(ylabel="friction coefficient [-]", ylim=(0.0, 2.0 * result.friction))
    upper.legend(loc="upper left")
    lower.plot(load.times, load.yaw_rate)
    lower.set(xlabel="time [s]", ylabel="yaw rate from the wrench [rad/s]")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure
