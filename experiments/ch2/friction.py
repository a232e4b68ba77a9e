"""``ch2-friction``: the arm's jerks show the friction under the wheels, and when they slip.

Each seed makes a robot within its drawing's tolerances, tyres and all; of robots as drawn it draws
the ground's friction. The arm jerks twice: hard, to break the rover loose, and gently, where mostly
a lower bound can be given. The controller sees the arm's encoders, the force/torque sensor, the
inclinometer and the tachometers only; the truth is for scoring alone.
"""

import dataclasses
from collections.abc import Sequence

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
from experiments.ch2.deviations import arm_deviations
from experiments.ch2.friction_options import Options
from experiments.ch2.payload import JUDGED, judge_errors, run_recorded, sensing
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.recording import NO_FILES, RunFiles
from experiments.harness.sweep import sweep
from models.as_made import alter_rover
from models.compose import WHEELS, FieldConfig, RobotPlacement, load_part
from twin.connect import connect
from twin.describe import describe_rover
from twin.description import RobotDescription
from twin.optics.realism import RealismName
from twin.realism import make_robots

ROBOT = "rover1"
FRICTIONS = (0.2, 0.9)
EFFORTS = {"hard": JerkConfig().rates, "gentle": (0.4, 1.4)}  # first and last yaw rate [rad/s]
DURATION = 13.0  # [s]
CALIBRATION, SWEEP = 20.0, 6.0  # Slow motions of arms that are not their drawings [s].
ERROR_BOUND = 15.0  # [%]
HOLDS_BOUND = 0.95
FIELD = FieldConfig(texture_pixels=64)


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
            options.realism,
            RunFiles.of(options, output) if index == 0 and effort == "hard" else NO_FILES,
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
    friction: float | None,
    seed: int,
    effort: str,
    robot: str = "sim",
    realism: RealismName = "ideal",
    files: RunFiles = NO_FILES,
) -> FrictionEstimate:
    """Jerk an arm on some ground, and return what was estimated.

    Args:
        friction: Friction coefficient of the ground; None for that of the robot's own tyres.
        seed: Seed of the robot as made, of its sensors' errors and of their noise.
        effort: Key of `EFFORTS`.
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        realism: How far the robot and its sensors are from their drawings.
        files: Files of the run.

    Raises:
        IdentificationError: If a sensor is missing.
    """
    drawn = describe_rover(ROBOT)
    config = friction_config(drawn, effort, realism)
    controller = FrictionProbe(ROBOT, config)
    field = dataclasses.replace(FIELD, friction=friction)
    connection = connect(
        robot, robots=[RobotPlacement(ROBOT)], field=field, realism=realism, seed=seed
    )
    run_recorded(connection, controller, config.calibration + config.jerks.sweep + DURATION, files)
    return controller.estimate()


def friction_config(drawn: RobotDescription, effort: str, realism: RealismName) -> FrictionConfig:
    """Return the prior knowledge of the estimate, and its motions.

    Args:
        drawn: Robot as drawn.
        effort: Key of `EFFORTS`.
        realism: How far the robot and its sensors are from their drawings.
    """
    deviations, jerks = arm_deviations(realism), JerkConfig(rates=EFFORTS[effort])
    config = FrictionConfig(
        SerialChain.of_robot(drawn),
        KnownBase.of_robot(drawn),
        dataclasses.replace(sensing(), tilt_motion=False),
        jerks,
    )
    if deviations is None:
        return config
    # At each reversal a link flies through its gear's play and hits the other side, of which no
    # encoder tells: the window holds both, whose sum is nothing.
    return dataclasses.replace(
        config,
        window=21,
        jerks=dataclasses.replace(jerks, sweep=SWEEP),
        deviations=deviations,
        calibration=CALIBRATION,
    )


@dataclasses.dataclass(frozen=True)
class FrictionJob:
    """One ground to probe.

    Attributes:
        seed: Random seed of the ground and of the sensor noise.
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        effort: Strength of the jerks, a key of `EFFORTS`.
        realism: How far the robot and its sensors are from their drawings.
        files: Files of the run.
    """

    seed: int
    robot: str
    effort: str
    realism: RealismName
    files: RunFiles = NO_FILES


@dataclasses.dataclass(frozen=True)
class FrictionRun:
    """What was estimated on one ground, compared with the truth.

    Attributes:
        seed: Random seed of the job.
        effort: Strength of the jerks.
        friction: True friction coefficient between tyres and ground.
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
    seed = int(noise.generate_state(1)[0])
    (robot,) = make_robots([RobotPlacement(ROBOT)], config.realism, seed)
    ground = None if robot.made else float(np.random.default_rng(draws).uniform(*FRICTIONS))
    try:
        estimate = probe(ground, seed, config.effort, config.robot, config.realism, config.files)
    except IdentificationError as error:
        raise ExperimentError(str(error)) from error
    friction = ground if ground is not None else tyre_friction(robot)
    return FrictionRun(config.seed, config.effort, friction, estimate)


def tyre_friction(robot: RobotPlacement) -> float:
    """Return the friction coefficient of a robot's tyres, all alike, as made.

    Args:
        robot: Robot, and how it was made.
    """
    spec = load_part("rover")
    if robot.made is not None:
        alter_rover(spec, robot.made)
    return float(spec.geom(f"{WHEELS[0]}_tyre").friction[0])


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
