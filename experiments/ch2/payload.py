"""``ch2-payload``: an unknown mass in the gripper is identified from the wrench under the arm.

Each seed draws a box, its mass and its place in the grip, and makes a robot within its drawing's
tolerances. That swings its arm empty, takes the box and swings again. The controller sees
observations only, and knows the drawing and its tolerances; the truth is used for scoring alone.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import chi2

from controllers.identification.arm_sensing import IdentificationError, SensingConfig
from controllers.identification.payload import (
    WIDE_SWING,
    PayloadEstimate,
    PayloadIdentifier,
    PayloadIdentifierConfig,
)
from controllers.kinematics.rigid_motion import NAMES, inertial_parameters
from controllers.kinematics.serial_chain import SerialChain
from experiments.ch2.deviations import arm_deviations
from experiments.ch2.payload_options import Options
from experiments.harness.contract import ExperimentError
from experiments.harness.figure_style import RED
from experiments.harness.intervals import distribution, fraction, success_fraction
from experiments.harness.output import Output
from experiments.harness.recording import NO_FILES, RunFiles
from experiments.harness.sweep import sweep
from models import datasheets
from models.compose import FieldConfig, RobotPlacement
from models.configuration import PayloadConfig as Box
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.connect import Connection, connect
from twin.describe import describe_rover
from twin.description import RigidBody
from twin.loop import run as run_loop
from twin.optics.realism import RealismName
from twin.robot import Controller

ROBOT = "rover1"
MASSES = (0.05, 0.3)  # [kg]
OFFSET = 0.02  # Largest distance from the grip point along each axis [m]
HALF_SIZES = (0.01, 0.03)  # [m]
GRIP = np.array([0.0, datasheets.ARM.wrist_length, 0.0])
MASS_BOUND = 1.0  # [%]
CENTRE_BOUND = 3.0  # [mm]
COVERAGE_BOUND = (
    0.8  # Of 24 bands of 95 %, 20 or more hold the truth in 99.4 % of all honest tries.
)
FIELD = FieldConfig(texture_pixels=64)
JUDGED = ("median", "every run")
"""Errors of all runs that are held to a bound."""


def run(options: Options, output: Output) -> None:
    """Identify one payload for each seed, and score.

    Args:
        options: ``quick`` takes 6 seeds instead of 24.
        output: Receives ``mass_error_percent`` and ``centre_error_mm`` among others.
    """
    configs = [
        PayloadJob(
            seed,
            options.robot,
            options.duration,
            options.realism,
            RunFiles.of(options, output) if index == 0 else NO_FILES,
        )
        for index, seed in enumerate(options.job_seeds(24, 6))
    ]
    results = sweep(identify_one, configs, options, output, label="payloads")
    _measure(results, output)
    _tabulate(results, output)
    output.figure("payload_errors", _error_figure(results))
    output.figure("payload_residual", _residual_figure(results[0].estimate))


def draw_box(rng: np.random.Generator) -> Box:
    """Return a random box, held off centre.

    Args:
        rng: Source of randomness.
    """
    offset = rng.uniform(-OFFSET, OFFSET, 3)
    half = rng.uniform(*HALF_SIZES, 3)
    return Box(float(rng.uniform(*MASSES)), tuple(offset.tolist()), tuple(half.tolist()))


def true_body(box: Box) -> RigidBody:
    """Return a box as a rigid body in the wrist's frame."""
    half = np.array(box.half_size)
    inertia = box.mass / 3.0 * np.diag(half @ half - half**2)
    return RigidBody(box.mass, GRIP + np.array(box.centre), inertia)


def sensing() -> SensingConfig:
    """Return the interpretation of the rover's signals, from its datasheets."""
    mount = datasheets.ROVER.arm_mount
    return SensingConfig(
        gravity=GRAVITY,
        lever=(mount[0], mount[1], mount[2] + datasheets.ROVER.centre_height),
        inclinometer_bandwidth=datasheets.INCLINOMETER.bandwidth,
    )


def payload_config(
    arm: SerialChain, duration: float = 30.0, realism: RealismName = "ideal"
) -> PayloadIdentifierConfig:
    """Return the prior knowledge and the course of the identification.

    Args:
        arm: The empty arm as drawn.
        duration: Duration of a swing [s].
        realism: How far robots and their sensors are from their drawings.
    """
    sheet, deviations = datasheets.FORCE_TORQUE, arm_deviations(realism)
    drawn = PayloadIdentifierConfig(
        arm,
        wrench_noise=(sheet.force_noise,) * 3 + (sheet.torque_noise,) * 3,
        sensing=sensing(),
        scales=(MASSES[1], 0.15),
    )
    if deviations is None:
        return drawn
    # What the tilt says of the base's accelerations is noise, and what pitches meanwhile is faster
    # than the longer window: left in, the unknowns would be bent to explain either.
    return dataclasses.replace(
        drawn,
        sensing=dataclasses.replace(drawn.sensing, tilt_motion=False),
        swing=WIDE_SWING,
        window=199,
        deviations=deviations,
        empty=duration,
    )


def identify(
    box: Box,
    seed: int,
    robot: str = "sim",
    duration: float = 30.0,
    realism: RealismName = "ideal",
    files: RunFiles = NO_FILES,
) -> PayloadEstimate:
    """Swing an arm that holds a box, and return what was identified.

    Args:
        box: Box in the gripper.
        seed: Seed of the robot as made, of its sensors' errors and of their noise.
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        duration: Duration of a swing [s].
        realism: How far the robot and its sensors are from their drawings.
        files: Files of the run.

    Raises:
        IdentificationError: If a sensor is missing or the run too short.
    """
    arm = SerialChain.of_robot(describe_rover(ROBOT))
    config = payload_config(arm, duration, realism)
    identifier = PayloadIdentifier(ROBOT, config)
    placement = RobotPlacement(ROBOT, payload=dataclasses.replace(box, taken=config.taken))
    connection = connect(robot, robots=[placement], field=FIELD, realism=realism, seed=seed)
    run_recorded(connection, identifier, config.begin + duration, files)
    return identifier.estimate()


def run_recorded(
    connection: Connection, controller: Controller, duration: float, files: RunFiles
) -> None:
    """Run a controller on a connection, and close that afterwards.

    Args:
        connection: The robot and its clock.
        controller: Controller of the robot.
        duration: Duration of the run [s].
        files: Files of the run.
    """
    with connection, files.written(connection) as recorders:
        run_loop(connection.robots, [controller], connection.clock, recorders, duration)


@dataclasses.dataclass(frozen=True)
class PayloadJob:
    """One payload to identify.

    Attributes:
        seed: Random seed of the payload and of the sensor noise.
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        duration: Time for which the arm swings [s].
        realism: How far the robot and its sensors are from their drawings.
        files: Files of the run.
    """

    seed: int
    robot: str
    duration: float
    realism: RealismName
    files: RunFiles = NO_FILES


@dataclasses.dataclass(frozen=True)
class PayloadRun:
    """What was identified of one payload, compared with the truth.

    Attributes:
        seed: Random seed of the job.
        truth: The payload, in the wrist's frame.
        estimate: The payload as identified, in the same frame.
    """

    seed: int
    truth: RigidBody
    estimate: PayloadEstimate

    @property
    def mass_error_percent(self) -> float:
        """Error of the mass [%]."""
        return 100.0 * abs(self.estimate.mass / self.truth.mass - 1.0)

    @property
    def centre_error_mm(self) -> float:
        """Distance between true and estimated centre of mass [mm]."""
        return 1e3 * float(np.linalg.norm(self.estimate.centre - self.truth.centre))

    @property
    def covered(self) -> dict[str, bool]:
        """Whether mass and centre lie within the estimate's own bands of 95 %."""
        mass = self.estimate.mass - self.truth.mass
        centre = self.estimate.centre - self.truth.centre
        squares = {
            "mass": mass**2 / self.estimate.covariance[0, 0],
            "centre": centre @ np.linalg.solve(self.estimate.centre_covariance, centre),
        }
        return {
            name: bool(square <= chi2.ppf(0.95, 1 if name == "mass" else 3))
            for name, square in squares.items()
        }


def identify_one(config: PayloadJob) -> PayloadRun:
    """Draw, identify and score one payload; a job of the sweep.

    Raises:
        ExperimentError: If the payload cannot be identified.
    """
    draws, noise = np.random.SeedSequence(config.seed).spawn(2)
    box = draw_box(np.random.default_rng(draws))
    noise_seed = int(noise.generate_state(1)[0])
    try:
        estimate = identify(
            box, noise_seed, config.robot, config.duration, config.realism, config.files
        )
    except IdentificationError as error:
        raise ExperimentError(str(error)) from error
    return PayloadRun(config.seed, true_body(box), estimate)


def _measure(results: Sequence[PayloadRun], output: Output) -> None:
    """Store the metrics and hold them against the bars."""
    bounds = {"mass_error_percent": MASS_BOUND, "centre_error_mm": CENTRE_BOUND}
    for key, bound in bounds.items():
        errors = np.array([getattr(result, key) for result in results])
        judge_errors(output, key, errors, bound)
    for name in ("mass", "centre"):
        covered = success_fraction(result.covered[name] for result in results)
        output.measure(f"coverage95/{name}", covered)
        share = covered["mean"]
        least = f">= {COVERAGE_BOUND:g}"
        output.check(f"{name} within its band of 95 %", share, least, share >= COVERAGE_BOUND)
    estimates = [result.estimate for result in results]
    output.measure("chi_squared", distribution([found.chi_squared for found in estimates]))
    least = min(found.mass for found in estimates)
    output.check("mass is positive, every run", least, "> 0", least > 0.0)
    corrected = sum(bool(np.any(found.parameters != found.linear)) for found in estimates)
    output.measure("corrected_to_physical", fraction(corrected, len(results)))
    hidden = {name: sum(name in found.unidentifiable for found in estimates) for name in NAMES}
    for name, count in hidden.items():
        output.measure(f"unidentifiable/{name}", fraction(count, len(results)))
    named = [name for name, count in hidden.items() if count > len(results) / 2]
    output.measure("unidentifiable", ", ".join(named) or "none")


def judge_errors(
    output: Output, key: str, errors: FloatArray, bound: float, labels: Sequence[str] = ()
) -> None:
    """Measure the errors of all runs, and hold their median and the worst to a bound.

    Args:
        output: Output that receives metrics and checks.
        key: Name of the metric.
        errors: (n,) errors of the runs.
        bound: Largest permissible error.
        labels: Names of the two checks; empty for the metric's name with those of `JUDGED`.
    """
    summary = distribution(errors)
    output.measure(key, summary)
    output.measure(f"{key}/within_{bound:g}", fraction(int(np.sum(errors <= bound)), len(errors)))
    names = labels or [f"{key}, {which}" for which in JUDGED]
    for name, value in zip(names, (summary["median"], float(errors.max())), strict=True):
        output.check(name, value, f"<= {bound:g}", value <= bound)


def _tabulate(results: Sequence[PayloadRun], output: Output) -> None:
    """Write one row for each run."""
    columns = ["seed", "mass [kg]", "mass estimate [kg]", "mass error [%]", "centre error [mm]"]
    axes = [f"centre {axis} error [mm]" for axis in "xyz"]
    rows = [
        [
            run.seed,
            run.truth.mass,
            run.estimate.mass,
            run.mass_error_percent,
            run.centre_error_mm,
            *(1e3 * (run.estimate.centre - run.truth.centre)),
            run.estimate.chi_squared,
            " ".join(run.estimate.unidentifiable),
        ]
        for run in results
    ]
    output.table("payload_runs", [*columns, *axes, "chi squared", "unidentifiable"], rows)
    rows = [
        [run.seed, name, *map(float, numbers)]
        for run in results
        for name, *numbers in zip(
            NAMES,
            inertial_parameters(run.truth),
            run.estimate.parameters,
            np.sqrt(np.diag(run.estimate.covariance)),
            strict=True,
        )
    ]
    columns = ["seed", "parameter", "truth [SI]", "estimate [SI]", "standard deviation [SI]"]
    output.table("payload_parameters", columns, rows)


def _error_figure(results: Sequence[PayloadRun]) -> Figure:
    """Draw the errors over the payload's mass, with the bars."""
    figure = Figure(figsize=(10, 4))
    mass = [1e3 * result.truth.mass for result in results]
    panels = (
        ("mass_error_percent", "error of the mass [%]", MASS_BOUND),
        ("centre_error_mm", "error of the centre of mass [mm]", CENTRE_BOUND),
    )
    for index, (key, label, bound) in enumerate(panels, 1):
        axes = figure.add_subplot(1, 2, index)
        axes.plot(mass, [getattr(result, key) for result in results], "o")
        axes.axhline(bound, color=RED, linestyle="--", label=f"bound {bound:g}")
        axes.set(xlabel="mass of the payload [g]", ylabel=label, ylim=(0.0, None))
        axes.legend()
        axes.grid(alpha=0.3)
    return figure


def _residual_figure(estimate: PayloadEstimate) -> Figure:
    """Draw what one fit leaves of the wrench."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    for index, name in enumerate(("force", "moment")):
        axes = figure.add_subplot(2, 1, index + 1)
        part = estimate.residual[:, 3 * index : 3 * index + 3]
        for axis, column in zip("xyz", part.T, strict=True):
            axes.plot(estimate.times, column, label=f"{name} {axis}")
        axes.set(xlabel="time [s]", ylabel="residual / sensor noise [-]")
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes.grid(alpha=0.3)
    return figure
