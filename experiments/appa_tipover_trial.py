"""One run of ``appa-tipover``: the arm swings a load, guarded or not, and the ground tells."""

from __future__ import annotations

import dataclasses
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from controllers.motion.arm_control import ArmController, Reference
from controllers.motion.base_motion import level_of
from controllers.motion.chain import Chain
from controllers.motion.tip_over import Footing, Guarded, Sweep, ground_wrench, guard
from controllers.motion.tip_over import zero_moment_point as balance
from experiments.appa_control_plant import MOUNT, PLAIN
from experiments.appa_control_trial import PERIOD, ROBOT, arm_config
from experiments.known_arm import known_arm, known_base, merge
from models import datasheets
from models.compose import ARM_JOINTS, PayloadConfig, RobotPlacement, make_model, settle
from twin.simulation import Simulation

FloatArray = NDArray[np.float64]
FOLDED = np.array([0.0, 2.2, -2.4, 0.2])
"""Joint angles in which the load is nearest to the rover, but for the yaw [rad]."""
WAIT, AFTER = 0.5, 1.5
"""Rest before a motion and after it [s]."""
COMPARE_EVERY = 3
"""Servo ticks between two looks at the ground's pressure."""
TIPPED = np.radians(10.0)
"""Lean from which the rover counts as tipped: two wheels are 5 cm in the air."""


@dataclasses.dataclass(frozen=True)
class TipTrial:
    """What one run is.

    Attributes:
        load: Mass in the gripper [kg].
        yaw: Where the arm points before the motion [rad].
        target: (4,) joint angles of its end [rad].
        duration: Asked for [s].
        guarded: Whether the guard sees the motion first.
        seed: Of the sensors.
    """

    load: float
    yaw: float
    target: tuple[float, float, float, float]
    duration: float
    guarded: bool
    seed: int


def footing_of(model: mujoco.MjModel) -> Footing:
    """Return what the guard knows of a rover: its sheet and its arm with the load.

    Args:
        model: The scene with it.
    """
    base = known_base()
    arm = known_arm(model)
    # The flange under the first joint rides on the base.
    body = merge(
        [base.body.mass, arm.base.mass],
        [base.body.centre, arm.base.centre + MOUNT],
        [base.body.inertia, arm.base.inertia],
    )
    chain = Chain.of_arm(arm, datasheets.ARM_MOTOR.armature)
    x, y = datasheets.ROVER.half_track, datasheets.ROVER.half_wheelbase
    polygon = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    return Footing(body, chain, MOUNT, polygon, -datasheets.ROVER.centre_height)


def contact_wrench(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return (6,) all contacts' force and moment on the robot about the world's origin."""
    total, local = np.zeros(6), np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        mujoco.mj_contactForce(model, data, index, local)
        frame = contact.frame.reshape(3, 3)
        # It acts on the second geom; contacts within the robot cancel out.
        grounds = model.geom_bodyid[contact.geom] == 0
        if not grounds.any():
            continue
        sign = 1.0 if grounds[0] else -1.0
        force, moment = sign * frame.T @ local[:3], sign * frame.T @ local[3:]
        total += np.concatenate([force, moment + np.cross(contact.pos, force)])
    return total


def bodies_wrench(model: mujoco.MjModel, data: mujoco.MjData) -> FloatArray:
    """Return (6,) what the ground must do by eq. A-5, from every body's true motion.

    Args:
        model: The scene, with one robot on it.
        data: After ``mj_forward`` and ``mj_rnePostConstraint``.
    """
    count = model.nbody - 1
    forces, spins = np.empty((count, 3)), np.empty((count, 3))
    motion = np.empty(6)
    for index in range(count):
        body = index + 1
        axes = data.ximat[body].reshape(3, 3)
        inertia = axes @ np.diag(model.body_inertia[body]) @ axes.T
        kind = mujoco.mjtObj.mjOBJ_BODY
        mujoco.mj_objectVelocity(model, data, kind, body, motion, 0)
        omega = motion[:3].copy()
        mujoco.mj_objectAcceleration(model, data, kind, body, motion, 0)
        spins[index] = inertia @ motion[:3] + np.cross(omega, inertia @ omega)
        forces[index] = motion[3:]
    return ground_wrench(model.body_mass[1:], data.xipos[1:], forces, spins)


def run_tip(trial: TipTrial) -> dict[str, Any]:
    """Swing the arm and watch the wheels.

    Returns:
        ``tipped``, largest ``lean_deg``, the guard's ``report``, ``stretch`` and ``asked_margin``,
        and over the motion ``point`` and ``pressure`` (n, 2), eq. A-5's and MuJoCo's [m, world],
        and ``expected`` (n, 2), the guard's model on the reference [m, body frame].
    """
    model = make_model(
        PLAIN, [RobotPlacement(ROBOT, centre_locked=True, payload=PayloadConfig(trial.load))]
    )
    footing = footing_of(model)
    folded = FOLDED + [trial.yaw, 0.0, 0.0, 0.0]
    asked = Sweep(folded, np.array(trial.target), trial.duration)
    data = _resting(model, footing, folded)
    simulation = Simulation(model, [ROBOT], seed=trial.seed, data=data)
    robot = simulation.robots[ROBOT]
    verdict = Guarded(asked, 1.0, np.nan, "")
    if trial.guarded:
        verdict = guard(footing, asked, level_of(robot.observe()))
    sweep = verdict.sweep or Sweep(folded, folded, trial.duration)

    def reference(time: float) -> Reference:
        return Reference(*sweep.at(time - WAIT))

    # A load near the base's own weight makes the base's feed-forward a loop of gain above one.
    config = arm_config(footing.chain, "pd_gravity", 0.0)
    controller = ArmController(config, reference)
    robot.activate()
    chassis = model.body(f"{ROBOT}/chassis").id
    points, pressures, expected = [], [], []
    lean, gone = 0.0, 0
    for tick in range(round((WAIT + sweep.duration + AFTER) / PERIOD)):
        robot.command(controller.step({ROBOT: robot.observe()})[ROBOT])
        simulation.step()
        up = simulation.data.body(chassis).xmat.reshape(3, 3)[2, 2]
        lean = max(lean, float(np.arccos(min(1.0, up))))
        gone = tick
        if lean > TIPPED:
            break
        pair = _compare(model, simulation.data) if tick % COMPARE_EVERY == 0 else None
        if pair is None:
            continue
        wanted = reference((tick + 1) * PERIOD)
        points.append(pair[0])
        pressures.append(pair[1])
        expected.append(
            footing.zero_moment_point(wanted.angles, wanted.rates, wanted.accelerations)
        )
    simulation.close()
    return {
        "tipped": int(lean > TIPPED),
        "lean_deg": float(np.degrees(lean)),
        "seconds": gone * PERIOD,
        "report": verdict.report,
        "stretch": verdict.stretch,
        "part": 0.0 if verdict.sweep is None else verdict.sweep.part,
        "asked_margin": float(verdict.margin),
        "point": np.array(points),
        "pressure": np.array(pressures),
        "expected": np.array(expected),
    }


def _resting(model: mujoco.MjModel, footing: Footing, folded: FloatArray) -> mujoco.MjData:
    """Return the rover at rest with its arm folded."""
    home = model.key("home").id
    motor = datasheets.ARM_MOTOR
    hold = footing.chain.bias(folded, np.zeros(4)) / motor.gross_stall_torque * motor.voltage
    for name, angle, voltage in zip(ARM_JOINTS, folded, hold, strict=True):
        model.key_qpos[home, model.joint(f"{ROBOT}/{name}_joint").qposadr[0]] = angle
        model.key_ctrl[home, model.actuator(f"{ROBOT}/{name}").id] = voltage
    return settle(model)


def _compare(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[FloatArray, FloatArray] | None:
    """Return eq. A-5's point and the contacts' centre of pressure; None without contact."""
    now = mujoco.MjData(model)
    mujoco.mj_copyData(now, model, data)
    mujoco.mj_forward(model, now)
    mujoco.mj_rnePostConstraint(model, now)
    pressure = contact_wrench(model, now)
    if pressure[2] < 1.0:
        return None
    return balance(bodies_wrench(model, now)), balance(pressure)
