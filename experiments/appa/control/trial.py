"""One run of ``appa-control``: the arm follows its reference while its base is pushed."""

import dataclasses

import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.arm_control import ArmControlConfig, ArmController, Law, Reference
from experiments.appa.control.plant import MOUNT, sprung_rover
from models import datasheets
from models.compose import ARM_JOINTS, settle
from perception.geometry.arrays import FloatArray
from twin.describe import describe_rover
from twin.simulation import Simulation

ROBOT = "rover1"
PERIOD = 0.01
HOME = np.array(datasheets.ARM.home)
START, DURATION = 1.5, 7.5
"""When the pushes and the score begin, and when the run ends [s]."""
PUSH_EVERY, PUSH_FOR = 0.5, 0.15
"""Time between pushes and how long each lasts [s]."""
_SWING = np.array([0.4, 0.15, 0.15, 0.15])  # the arm stays clear of ground and deck
_PACE = 2.0 * np.pi * np.array([0.3, 0.45, 0.6, 0.75])


@dataclasses.dataclass(frozen=True)
class ControlTrial:
    """Parameters of one run.

    Attributes:
        stiffness: Pitch stiffness of the bare base [N m/rad].
        law: Control law, of `controllers.motion.arm_control`.
        lag: Lag of the base's feed-forward [s].
        couple: Size of the pushes about the pitch axis [N m].
        seed: Random seed of the sensors and of the pushes' signs.
        traced: Whether errors and pitch over time are kept.
    """

    stiffness: float
    law: Law
    lag: float
    couple: float
    seed: int
    traced: bool = False


def reference(time: float) -> Reference:
    """Return sines of four different paces about the home pose, from rest.

    Args:
        time: Time since the start [s].
    """
    ramp = min(max(time, 0.0), 1.0)
    # A smooth start: the ramp's own derivatives are felt before the score begins only.
    phase = _PACE * time
    return Reference(
        HOME + ramp * _SWING * np.sin(phase),
        ramp * _SWING * _PACE * np.cos(phase),
        -ramp * _SWING * _PACE**2 * np.sin(phase),
    )


def arm_config(chain: SerialChain, law: Law, lag: float) -> ArmControlConfig:
    """Return the configuration of the controller of a rover's arm.

    Args:
        chain: Chain of the arm, with rotors and load.
        law: Control law.
        lag: Lag of the base's feed-forward [s].
    """
    motor = datasheets.ARM_MOTOR
    return ArmControlConfig(
        ROBOT,
        chain,
        MOUNT,
        law=law,
        lag=lag,
        friction=np.full(4, motor.friction),
        motor_damping=np.full(4, motor.gross_stall_torque / motor.gross_no_load_speed),
        period=PERIOD,
        most=motor.stall_torque,
    )


@dataclasses.dataclass(frozen=True)
class ControlRun:
    """How well the arm followed its reference.

    Attributes:
        rms_deg: (4,) r.m.s. error of each joint [deg].
        all_deg: R.m.s. error of all joints [deg].
        pitch_deg: Standard deviation of the base's pitch [deg].
        error_deg: (n, 4) joint errors over time [deg], if traced.
        base_deg: (n,) pitch of the base over time [deg], if traced.
    """

    rms_deg: FloatArray
    all_deg: float
    pitch_deg: float
    error_deg: FloatArray | None = None
    base_deg: FloatArray | None = None


def run_control(trial: ControlTrial) -> ControlRun:
    """Run a trial on the simulated rover, through the robot contract and its datasheet sensors."""
    model = sprung_rover(trial.stiffness)
    chain = SerialChain.of_robot(describe_rover(ROBOT))
    simulation = Simulation(model, [ROBOT], seed=trial.seed, data=settle(model))
    robot = simulation.robots[ROBOT]
    controller = ArmController(arm_config(chain, trial.law, trial.lag), reference)
    rng = np.random.default_rng(trial.seed)
    chassis = model.body(f"{ROBOT}/chassis").id
    places = [model.joint(f"{ROBOT}/{name}_joint").qposadr[0] for name in ARM_JOINTS]
    robot.activate()
    errors: list[FloatArray] = []
    pitches: list[float] = []
    push = 0.0
    every, span = round(PUSH_EVERY / PERIOD), round(PUSH_FOR / PERIOD)
    for tick in range(round(DURATION / PERIOD)):
        scored = tick >= round(START / PERIOD)
        if scored and tick % every == 0:
            push = trial.couple * float(rng.choice([-1.0, 1.0]))
        elif tick % every == span:
            push = 0.0
        simulation.data.xfrc_applied[chassis, 3] = push
        robot.command(controller.step({ROBOT: robot.observe()})[ROBOT])
        simulation.tick()
        if scored:
            wanted = reference((tick + 1) * PERIOD).angles
            errors.append(np.degrees(wanted - simulation.data.qpos[places]))
            upright = simulation.data.body(chassis).xmat.reshape(3, 3)
            pitches.append(float(np.degrees(np.arcsin(upright[2, 1]))))
    simulation.close()
    error, pitch = np.array(errors), np.array(pitches)
    return ControlRun(
        rms_deg=np.sqrt(np.mean(error**2, axis=0)),
        all_deg=float(np.sqrt(np.mean(error**2))),
        pitch_deg=float(np.std(pitch)),
        error_deg=error if trial.traced else None,
        base_deg=pitch if trial.traced else None,
    )
