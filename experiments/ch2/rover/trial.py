"""One identification of the complete rover through the robot contract."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from controllers.identification.information import mutual_information
from controllers.identification.pitch import (
    NAMES,
    RANGES,
    PitchEstimate,
)
from controllers.identification.pitch_model import predict_tilt
from controllers.identification.rover_identifier import (
    ROLL_TILT_LIMIT,
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from controllers.identification.swing_plane import PITCH, ROLL
from experiments.ch2.rover.acceleration import acceleration_gain
from experiments.ch2.rover.roll import front_alone
from experiments.ch2.rover.rover_options import Axis
from models.compose import LABORATORY, RobotPlacement
from perception.geometry.arrays import FloatArray
from twin.connect import Connection, connect
from twin.describe import describe_rover
from twin.loop import LoopRecorder, run
from twin.optics.realism import RealismName
from twin.realism import make_robots

ROBOT = "rover1"
PLANES = {PITCH.name: PITCH, ROLL.name: ROLL}
"""Planes in which the arm swings, by the tilt that they show."""


@dataclasses.dataclass(frozen=True)
class RoverTrial:
    """Parameters of one identification.

    Attributes:
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        excitation: One of `rover_identifier.ROVER_EXCITATIONS`.
        seed: Random seed of sensor noise and planner.
        duration: Duration of the excitation [s].
        unseen: Duration of the motion that the result is tried on [s].
        realism: How far the robot and its sensors are from their drawings.
        axis: Tilt to identify.
    """

    robot: str
    excitation: str
    seed: int
    duration: float = 10.0
    unseen: float = 4.0
    realism: RealismName = "ideal"
    axis: Axis = "pitch"

    @property
    def seeds(self) -> tuple[int, int, int]:
        """Random seeds of the robot with its sensors, of the planner, and of the other motion."""
        robot, plan, other = np.random.SeedSequence(self.seed).generate_state(3).tolist()
        return robot, plan, other

    @property
    def placement(self) -> RobotPlacement:
        """Robot as made; a seed's robot is the same under every excitation.

        A real robot is what it is: the laboratory can measure its drawing only.
        """
        realism = "ideal" if self.robot.startswith("serial:") else self.realism
        (robot,) = make_robots([RobotPlacement(ROBOT)], realism, self.seeds[0])
        return robot


def rover_config(excitation: str, duration: float, axis: Axis) -> RoverIdentifierConfig:
    """Return the configuration of an identification of `ROBOT` as drawn.

    Args:
        excitation: One of `rover_identifier.ROVER_EXCITATIONS`.
        duration: Duration of the excitation [s].
        axis: Tilt to identify.
    """
    config = RoverIdentifierConfig(
        ROBOT,
        SwingingArm.of(describe_rover(ROBOT)),
        excitation,
        duration=duration,
        plane=PLANES[axis],
    )
    return dataclasses.replace(config, tilt_limit=ROLL_TILT_LIMIT) if axis == "roll" else config


def identify(
    connection: Connection,
    config: RoverIdentifierConfig,
    generator: np.random.Generator,
    recorders: Sequence[LoopRecorder] = (),
) -> RoverIdentifier:
    """Run one identification on a robot and return the controller with its log."""
    controller = RoverIdentifier(config, generator)
    run(connection.robots, [controller], connection.clock, recorders, config.total)
    controller.finish()
    return controller


@dataclasses.dataclass(frozen=True)
class RoverIdentification:
    """One identification of the complete rover.

    Attributes:
        estimate: Final estimate.
        front_alone: Estimate of roll without the centre joint's angle; none of pitch.
        unidentifiable: Names of the parameters that the data leave unknown.
        doubts: Why the estimate is not to be used; none if it is.
        tilt_nrmse: Error of the predicted inclinometer in an unseen motion [%].
        acceleration_gain: (5,) see `acceleration_gain`, in this motion.
        history: (n, 5) estimates after every window, SI units.
        bits: (n, 5) mutual information on each parameter [bit].
        excitations: (n, 3) offset [rad], amplitude [rad] and frequency [rad/s] of every window.
        shoulder: (m,) measured shoulder angle at every tick [rad].
        tilt: (k,) tilt read from the inclinometer, of roll the mean of both halves [rad].
        tilt_times: (k,) when it was read [s].
        step_seconds: (n,) computing time of every window [s].
    """

    estimate: PitchEstimate
    front_alone: PitchEstimate | None
    unidentifiable: tuple[str, ...]
    doubts: tuple[str, ...]
    tilt_nrmse: float
    acceleration_gain: FloatArray
    history: FloatArray
    bits: FloatArray
    excitations: FloatArray
    shoulder: FloatArray
    tilt: FloatArray
    tilt_times: FloatArray
    step_seconds: FloatArray


def run_rover_trial(trial: RoverTrial) -> RoverIdentification:
    """Identify, then predict the tilt of a motion that was not used."""
    seed, plan, other = trial.seeds
    config = rover_config(trial.excitation, trial.duration, trial.axis)
    with connect(
        trial.robot,
        robots=[trial.placement],
        field=LABORATORY,
        realism=trial.realism,
        seed=seed,
    ) as connection:
        controller = identify(connection, config, np.random.default_rng(plan))
        unseen = dataclasses.replace(config, excitation="random", duration=trial.unseen)
        trying = identify(connection, unseen, np.random.default_rng(other))
    log, estimate = controller.log, controller.fit.estimate
    sigmas = np.array([np.sqrt(np.diag(e.covariance)) for e in log.estimates])
    parameters = np.array([e.parameters for e in log.estimates])
    bits = [mutual_information(p, s, RANGES) for p, s in zip(parameters, sigmas)]
    return RoverIdentification(
        estimate=estimate,
        front_alone=front_alone(controller) if config.plane.twists else None,
        unidentifiable=tuple(estimate.unidentifiable(config.prior)),
        doubts=estimate.doubts(config.prior),
        tilt_nrmse=tilt_nrmse(estimate.parameters, trying),
        acceleration_gain=acceleration_gain(
            estimate.parameters,
            np.array(log.wrench),
            log.tilt_indices,
            config.sensors,
            config.prior,
        ),
        history=parameters,
        bits=np.array(bits),
        excitations=np.array(log.excitations),
        shoulder=np.array(log.shoulder),
        tilt=np.array(log.tilt),
        tilt_times=np.array(log.tilt_indices) * config.sensors.period,
        step_seconds=np.array(log.step_seconds),
    )


def tilt_nrmse(parameters: FloatArray, trying: RoverIdentifier) -> float:
    """Return the r.m.s. error of the predicted inclinometer over its own r.m.s., in percent.

    The sensor's known noise is subtracted from both.
    """
    log, sensors = trying.log, trying.config.sensors
    predicted = predict_tilt(parameters, np.array(log.wrench), sensors)
    tilt = np.array(log.tilt)
    noise = sensors.tilt_sigma**2
    wrong = max(float(np.var(tilt - predicted[log.tilt_indices, 2])) - noise, 0.0)
    return float(100 * np.sqrt(wrong / max(float(np.var(tilt)) - noise, noise)))


def error_percent(parameters: FloatArray, truth: Mapping[str, float]) -> FloatArray:
    """Return the magnitude of each parameter's error in percent of its true value, (5,)."""
    true = np.array([truth[name] for name in NAMES])
    return 100 * np.abs(parameters - true) / np.abs(true)
