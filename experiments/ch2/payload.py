"""``ch2-payload``: an unknown mass in the gripper is identified from the wrench under the arm.

Each seed draws a box, its mass and its place in the grip; the controller swings the arm and sees
observations only. The truth is used for scoring alone.
"""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

from controllers.identification.arm_sensing import IdentificationError, SensingConfig
from controllers.identification.payload import (
    PayloadEstimate,
    PayloadIdentifier,
    PayloadIdentifierConfig,
)
from controllers.kinematics.rigid_body import NAMES, inertial_parameters
from controllers.kinematics.serial_chain import SerialChain
from experiments.harness import contract
from experiments.harness.contract import ExperimentError
from experiments.harness.intervals import distribution, fraction
from experiments.harness.output import Output
from experiments.harness.sweep import sweep
from models import datasheets
from models.compose import FieldConfig, RobotPlacement
from models.configuration import PayloadConfig as Box
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.connect import Connection, connect
from twin.describe import describe_rover
from twin.description import RigidBody
from twin.loop import LoopRecorder
from twin.loop import run as run_loop
from twin.record import Recorder
from twin.robot import Controller

ROBOT = "rover1"
MASSES = (0.05, 0.3)  # [kg]
OFFSET = 0.02  # Largest distance from the grip point along each axis [m]
HALF_SIZES = (0.01, 0.03)  # [m]
GRIP = np.array([0.0, datasheets.ARM.wrist_length, 0.0])
MASS_BOUND = 1.0  # [%]
CENTRE_BOUND = 3.0  # [mm]
FIELD = FieldConfig(texture_pixels=64)


@dataclasses.dataclass(frozen=True)
class Options(contract.SimulatedOptions):
    """Options of the payload identification.

    Attributes:
        duration: Time for which the arm swings [s].
    """

    targets: ClassVar[tuple[str, ...]] = ("sim", "quantised", "emulated")
    duration: float = 30.0

    def __post_init__(self) -> None:
        """Refuse what cannot be run.

        Raises:
            OptionError: If the robot is unknown or the swing too short.
        """
        super().__post_init__()
        if not 3.0 <= self.duration <= 600.0:
            raise contract.OptionError(f"--duration: expected 3 to 600 s, got {self.duration}")


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
            str(output.file("run.rrd")) if options.record and index == 0 else None,
        )
        for index, seed in enumerate(options.job_seeds(24, 6))
    ]
    results = sweep(identify_one, configs, options, output, label="payloads")
    _measure(results, output)
    _tabulate(results, output)
    output.figure("payload_errors", _error_figure(results))
    output.figure("payload_residual", _residual_figure(results[0]))


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
    """Return how the rover's signals are read, from its datasheets."""
    mount = datasheets.ROVER.arm_mount
    return SensingConfig(
        gravity=GRAVITY,
        lever=(mount[0], mount[1], mount[2] + datasheets.ROVER.centre_height),
        inclinometer_bandwidth=datasheets.INCLINOMETER.bandwidth,
    )


def payload_config(arm: SerialChain) -> PayloadIdentifierConfig:
    """Return what the identification may know beforehand."""
    sheet = datasheets.FORCE_TORQUE
    return PayloadIdentifierConfig(
        arm,
        wrench_noise=(sheet.force_noise,) * 3 + (sheet.torque_noise,) * 3,
        sensing=sensing(),
        scales=(MASSES[1], 0.15),
    )


def identify(
    box: Box, seed: int, robot: str = "sim", duration: float = 30.0, record: str | None = None
) -> PayloadEstimate:
    """Swing an arm that holds a box, and return what was identified.

    Args:
        box: What it holds.
        seed: Seed of the sensor noise.
        robot: Which robot.
        duration: Duration of the swing [s].
        record: File for a recording, if any.

    Raises:
        IdentificationError: If a sensor is missing or the run too short.
    """
    arm = SerialChain.of_robot(describe_rover(ROBOT))
    identifier = PayloadIdentifier(ROBOT, payload_config(arm))
    placement = RobotPlacement(ROBOT, payload=box)
    connection = connect(robot, robots=[placement], field=FIELD, seed=seed)
    run_recorded(connection, identifier, duration, record)
    return identifier.estimate()


def run_recorded(
    connection: Connection, controller: Controller, duration: float, record: str | None
) -> None:
    """Run a controller on a connection, and close that afterwards.

    Args:
        connection: The robot and its clock.
        controller: Controller of the robot.
        duration: Duration of the run [s].
        record: File for a recording, if any.
    """
    with contextlib.ExitStack() as stack:
        stack.enter_context(connection)
        recorders: list[LoopRecorder] = []
        if record is not None:
            recorder = Recorder(record, connection.robots, connection.simulation)
            recorders.append(stack.enter_context(recorder))
        run_loop(connection.robots, [controller], connection.clock, recorders, duration)


@dataclasses.dataclass(frozen=True)
class PayloadJob:
    """One payload to identify.

    Attributes:
        seed: Random seed of the payload and of the sensor noise.
        robot: Which robot, as `twin.connect.connect` takes it.
        duration: Time for which the arm swings [s].
        record: File for a recording, if any.
    """

    seed: int
    robot: str
    duration: float
    record: str | None = None


@dataclasses.dataclass(frozen=True)
class PayloadRun:
    """What was identified of one payload, compared with the truth.

    Attributes:
        seed: Random seed of the job.
        mass: True mass [kg].
        mass_estimate: Estimated mass [kg].
        mass_error_percent: Error of the mass [%].
        centre: (3,) true centre of mass in the wrist's frame [m].
        centre_estimate: (3,) estimated centre of mass in the wrist's frame [m].
        centre_error_mm: Distance between the two centres [mm].
        parameters: (10,) true inertial parameters, order of `serial_arm.NAMES`, SI units.
        estimate: (10,) estimated inertial parameters, SI units.
        sigma: (10,) standard deviations of the estimate, SI units.
        corrected: Whether the linear estimate had to be moved to a physical body.
        chi_squared: Mean squared residual over the noise's variance.
        unidentifiable: Names of the parameters that the data leave unknown.
        residual: (n, 6) what the fit leaves of the wrench, in standard deviations of the noise.
        times: (n,) times of the samples [s].
    """

    seed: int
    mass: float
    mass_estimate: float
    mass_error_percent: float
    centre: FloatArray
    centre_estimate: FloatArray
    centre_error_mm: float
    parameters: FloatArray
    estimate: FloatArray
    sigma: FloatArray
    corrected: bool
    chi_squared: float
    unidentifiable: tuple[str, ...]
    residual: FloatArray
    times: FloatArray


def identify_one(config: PayloadJob) -> PayloadRun:
    """Draw, identify and score one payload; a job of the sweep.

    Raises:
        ExperimentError: If the payload cannot be identified.
    """
    draws, noise = np.random.SeedSequence(config.seed).spawn(2)
    box = draw_box(np.random.default_rng(draws))
    try:
        estimate = identify(
            box,
            int(noise.generate_state(1)[0]),
            config.robot,
            config.duration,
            config.record,
        )
    except IdentificationError as error:
        raise ExperimentError(str(error)) from error
    truth = true_body(box)
    return PayloadRun(
        seed=config.seed,
        mass=box.mass,
        mass_estimate=estimate.mass,
        mass_error_percent=100.0 * abs(estimate.mass / box.mass - 1.0),
        centre=truth.centre,
        centre_estimate=estimate.centre,
        centre_error_mm=1e3 * float(np.linalg.norm(estimate.centre - truth.centre)),
        parameters=inertial_parameters(truth),
        estimate=estimate.parameters,
        sigma=np.sqrt(np.diag(estimate.covariance)),
        corrected=bool(np.any(estimate.parameters != estimate.linear)),
        chi_squared=estimate.chi_squared,
        unidentifiable=tuple(estimate.unidentifiable),
        residual=estimate.residual,
        times=estimate.times,
    )


def _measure(results: Sequence[PayloadRun], output: Output) -> None:
    """Store the metrics and hold them against the bars."""
    bounds = {"mass_error_percent": MASS_BOUND, "centre_error_mm": CENTRE_BOUND}
    for key, bound in bounds.items():
        errors = np.array([getattr(result, key) for result in results])
        summary = distribution(errors)
        output.measure(key, summary)
        output.check(f"{key}, median", summary["median"], f"<= {bound:g}", _within(summary, bound))
        within = fraction(int(np.sum(errors <= bound)), len(errors))
        output.measure(f"{key}/within_{bound:g}", within)
        worst = float(errors.max())
        output.check(f"{key}, every run", worst, f"<= {bound:g}", worst <= bound)
    output.measure("chi_squared", distribution([result.chi_squared for result in results]))
    least = min(result.mass_estimate for result in results)
    output.check("mass is positive, every run", least, "> 0", least > 0.0)
    corrected = sum(result.corrected for result in results)
    output.measure("corrected_to_physical", fraction(corrected, len(results)))
    for name in NAMES:
        hidden = sum(name in result.unidentifiable for result in results)
        output.measure(f"unidentifiable/{name}", fraction(hidden, len(results)))
    share = len(results) / 2
    named = [n for n in NAMES if sum(n in r.unidentifiable for r in results) > share]
    output.measure("unidentifiable", ", ".join(named) or "none")


def _within(summary: Mapping[str, float], bound: float) -> bool:
    return summary["median"] <= bound


def _tabulate(results: Sequence[PayloadRun], output: Output) -> None:
    """Write one row for each run."""
    columns = ["seed", "mass [kg]", "mass estimate [kg]", "mass error [%]", "centre error [mm]"]
    keys = ("seed", "mass", "mass_estimate", "mass_error_percent", "centre_error_mm")
    axes = [f"centre {axis} error [mm]" for axis in "xyz"]
    rows = [
        [
            *(getattr(result, key) for key in keys),
            *(1e3 * (result.centre_estimate - result.centre)),
            result.chi_squared,
            " ".join(result.unidentifiable),
        ]
        for result in results
    ]
    output.table("payload_runs", [*columns, *axes, "chi squared", "unidentifiable"], rows)
    rows = [
        [result.seed, name, *(float(getattr(result, key)[index]) for key in keys)]
        for keys in [("parameters", "estimate", "sigma")]
        for result in results
        for index, name in enumerate(NAMES)
    ]
    columns = ["seed", "parameter", "truth [SI]", "estimate [SI]", "standard deviation [SI]"]
    output.table("payload_parameters", columns, rows)


def _error_figure(results: Sequence[PayloadRun]) -> Figure:
    """Draw the errors over the payload's mass, with the bars."""
    figure = Figure(figsize=(10, 4))
    mass = [1e3 * result.mass for result in results]
    panels = (
        ("mass_error_percent", "error of the mass [%]", MASS_BOUND),
        ("centre_error_mm", "error of the centre of mass [mm]", CENTRE_BOUND),
    )
    for index, (key, label, bound) in enumerate(panels, 1):
        axes = figure.add_subplot(1, 2, index)
        axes.plot(mass, [getattr(result, key) for result in results], "o")
        axes.axhline(bound, color="tab:red", linestyle="--", label=f"bound {bound:g}")
        axes.set(xlabel="mass of the payload [g]", ylabel=label, ylim=(0.0, None))
        axes.legend()
        axes.grid(alpha=0.3)
    return figure


def _residual_figure(result: PayloadRun) -> Figure:
    """Draw what one fit leaves of the wrench."""
    figure = Figure(figsize=(10, 5))
    for index, name in enumerate(("force", "moment")):
        axes = figure.add_subplot(2, 1, index + 1)
        part = result.residual[:, 3 * index : 3 * index + 3]
        for axis, column in zip("xyz", part.T, strict=True):
            axes.plot(result.times, column, label=f"{name} {axis}")
        axes.set(ylabel="residual / sensor noise [-]")
        axes.legend(loc="upper right")
        axes.set_xlabel("time [s]")
        axes.grid(alpha=0.3)
    return figure
