"""One identification of the complete rover through the robot contract."""

import dataclasses
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from controllers.identification.information import mutual_information
from controllers.identification.pitch import (
    NAMES,
    RANGES,
    PitchEstimate,
)
from controllers.identification.pitch_model import predict_tilt
from controllers.identification.rover_identifier import (
    RoverIdentifier,
    RoverIdentifierConfig,
    SwingingArm,
)
from models.compose import FLAT, LABORATORY, RobotPlacement, make_model
from perception.geometry.arrays import FloatArray
from twin.connect import Connection, connect
from twin.describe import descendants
from twin.loop import LoopRecorder, Tick, run
from twin.realism import RealismName, make_robots
from twin.simulation import Simulation

ROBOT = "rover1"


@dataclasses.dataclass(frozen=True)
class RoverTrial:
    """Parameters of one identification.

    Attributes:
        robot: Robot to connect to, as `twin.connect.connect` takes it.
        excitation: One of `rover_identifier.EXCITATIONS`.
        seed: Random seed of sensor noise and planner.
        duration: Duration of the excitation [s].
        unseen: Duration of the motion that the result is tried on [s].
        realism: How far the robot and its sensors are from their drawings.
    """

    robot: str
    excitation: str
    seed: int
    duration: float = 10.0
    unseen: float = 4.0
    realism: RealismName = "ideal"

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


def known_swinging_arm() -> SwingingArm:
    """Return the mass properties of the rover's stretched arm, from its datasheet's model."""
    model = make_model(FLAT, [RobotPlacement(ROBOT)])
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    shoulder = model.body(f"{ROBOT}/upper_arm").id
    bodies = np.flatnonzero(descendants(model, shoulder))
    base = data.body(f"{ROBOT}/chassis")
    rotation, pivot = base.xmat.reshape(3, 3), data.xpos[shoulder]
    masses = model.body_mass[bodies]
    centres = (data.xipos[bodies] - pivot) @ rotation
    centre = masses @ centres / masses.sum()
    inertia = 0.0
    for index, mass, place in zip(bodies, masses, centres):
        axes = rotation.T @ data.ximat[index].reshape(3, 3)
        inertia += (axes @ np.diag(model.body_inertia[index]) @ axes.T)[0, 0]
        inertia += mass * np.sum((place - centre)[1:] ** 2)
    mount = (pivot - data.site(f"{ROBOT}/arm_base").xpos) @ rotation
    return SwingingArm(
        mass=float(masses.sum()),
        inertia=float(inertia),
        centre=(float(centre[1]), float(centre[2])),
        shoulder=(float(mount[1]), float(mount[2])),
    )


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
        unidentifiable: Names of the parameters that the data leave unknown.
        doubts: Why the estimate is not to be used; none if it is.
        tilt_nrmse: Error of the predicted tilt of an unseen motion [%].
        history: (n, 5) estimates after every window, SI units.
        bits: (n, 5) mutual information on each parameter [bit].
        excitations: (n, 3) offset [rad], amplitude [rad] and frequency [rad/s] of every window.
        shoulder: (m,) measured shoulder angle at every tick [rad].
        tilt: (k,) pitch read from the inclinometer [rad].
        tilt_times: (k,) when it was read [s].
        step_seconds: (n,) computing time of every window [s].
    """

    estimate: PitchEstimate
    unidentifiable: tuple[str, ...]
    doubts: tuple[str, ...]
    tilt_nrmse: float
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
    config = RoverIdentifierConfig(
        ROBOT,
        known_swinging_arm(),
        trial.excitation,
        duration=trial.duration,
    )
    with connect(
        trial.robot,
        robots=[trial.placement],
        field=LABORATORY,
        realism=trial.realism,
        seed=seed,
    ) as connection:
        controller = identify(connection, config, np.random.default_rng(plan))
        unseen = dataclasses.replace(config, excitation="random", duration=trial.unseen)
        truth = TrueTilt(connection.simulation) if connection.simulation else None
        trying = identify(
            connection, unseen, np.random.default_rng(other), [truth] if truth else []
        )
    log, estimate = controller.log, controller.fit.estimate
    sigmas = np.array([np.sqrt(np.diag(e.covariance)) for e in log.estimates])
    parameters = np.array([e.parameters for e in log.estimates])
    bits = [mutual_information(p, s, RANGES) for p, s in zip(parameters, sigmas)]
    return RoverIdentification(
        estimate=estimate,
        unidentifiable=tuple(estimate.unidentifiable(config.prior)),
        doubts=estimate.doubts(config.prior),
        tilt_nrmse=tilt_nrmse(estimate.parameters, trying, truth),
        history=parameters,
        bits=np.array(bits),
        excitations=np.array(log.excitations),
        shoulder=np.array(log.shoulder),
        tilt=np.array(log.tilt),
        tilt_times=np.array(log.tilt_indices) * config.sensors.period,
        step_seconds=np.array(log.step_seconds),
    )


class TrueTilt(LoopRecorder):
    """Records the chassis' true pitch at every tick, for the score alone."""

    def __init__(self, simulation: Simulation) -> None:
        """Watch a scene."""
        self._chassis = simulation.data.body(f"{ROBOT}/chassis")
        self.values: list[float] = []

    def record(self, tick: Tick) -> None:
        """Take one tick."""
        self.values.append(float(np.arcsin(self._chassis.xmat.reshape(3, 3)[2, 1])))


def tilt_nrmse(parameters: FloatArray, trying: RoverIdentifier, truth: TrueTilt | None) -> float:
    """Return the r.m.s. error of the predicted tilt over the tilt's own r.m.s., in percent.

    In simulation the prediction is held against the true tilt; on a real robot against the
    inclinometer, whose known noise is subtracted from the error.
    """
    log, sensors = trying.log, trying.config.sensors
    wrench = np.array(log.wrench)
    predicted = predict_tilt(parameters, wrench, sensors)
    if truth is not None:
        tilt = np.array(truth.values[-len(wrench) :])
        return float(100 * np.std(tilt - predicted[:, 0]) / np.std(tilt))
    tilt = np.array(log.tilt)
    noise = sensors.tilt_sigma**2
    wrong = max(float(np.var(tilt - predicted[log.tilt_indices, 2])) - noise, 0.0)
    return float(100 * np.sqrt(wrong / max(float(np.var(tilt)) - noise, noise)))


def error_percent(parameters: FloatArray, truth: Mapping[str, float]) -> FloatArray:
    """Return the magnitude of each parameter's error in percent of its true value, (5,)."""
    true = np.array([truth[name] for name in NAMES])
    return 100 * np.abs(parameters - true) / np.abs(true)
