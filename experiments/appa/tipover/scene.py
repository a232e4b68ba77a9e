"""The rover of ``appa-tipover`` on its slope: what a guard knows of it, and what is true."""

import dataclasses
import math

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from controllers.kinematics.rigid_motion import at_rest
from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.tipping.look_ahead import LookAhead
from controllers.motion.tipping.tip_over import Footing, ground_wrench
from controllers.motion.tipping.tip_over import zero_moment_point as balance
from experiments.appa.control.plant import PLAIN
from experiments.appa.control.trial import ROBOT
from models import datasheets
from models.compose import (
    ARM_JOINTS,
    PayloadConfig,
    RobotPlacement,
    build_scene,
    compile_scene,
    settle,
)
from perception.geometry.arrays import FloatArray
from twin.describe import describe, describe_rover


class TipScene:
    """A loaded rover on a plane slope, and its true state.

    The ground's plane goes through the world's origin; the rover looks along the plane's y axis.

    Attributes:
        model: Compiled scene.
        data: State at rest with the arm folded.
        footing: Model of a guard: the rover by its datasheet, the arm and the load.
        ahead: What looks ahead for it: likewise, with its locked centre joint.
    """

    def __init__(self, load: float, folded: FloatArray, slope: float, downhill: float) -> None:
        """Build it and let it come to rest.

        Args:
            load: Mass in the gripper [kg].
            folded: (4,) joint angles at rest [rad].
            slope: Slope of the ground [rad].
            downhill: Direction in which it falls, from the plane's x axis [rad].
        """
        robot = RobotPlacement(ROBOT, centre_locked=True, payload=PayloadConfig(load))
        scene = build_scene(PLAIN, [robot])
        # Turning about the level line across the way down lowers that side.
        self._ground = Rotation.from_rotvec(
            slope * np.array([-math.sin(downhill), math.cos(downhill), 0.0])
        )
        scene.geom("ground").quat = self._ground.as_quat(scalar_first=True)
        self.model = compile_scene(scene)
        self.footing = footing_of(self.model)
        self.ahead = LookAhead(describe(self.model, ROBOT), centre_range=0.0)
        self._chassis = self.model.body(f"{ROBOT}/chassis").id
        self.data = self._resting(folded)
        self._now = mujoco.MjData(self.model)

    @property
    def tilt(self) -> float:
        """Angle between the rover's and the ground's normals [rad]."""
        axes = self.data.xmat[self._chassis].reshape(3, 3)
        up = self._ground.inv().apply(axes[:, 2])
        return math.acos(min(1.0, float(up[2])))

    def on_ground(self, point: FloatArray) -> FloatArray:
        """Return a point (2,) of the ground's plane from below the rover's origin [m]."""
        below = self._ground.inv().apply(self.data.xpos[self._chassis])
        return point - below[:2]

    def balance(self) -> tuple[FloatArray, FloatArray] | None:
        """Return eq. A-5's point and the contacts' centre of pressure (2,), on the ground's plane.

        Returns:
            From the origin along the plane's axes [m]; None without contact.
        """
        now = self._now
        mujoco.mj_copyData(now, self.model, self.data)
        mujoco.mj_forward(self.model, now)
        mujoco.mj_rnePostConstraint(self.model, now)
        pressure = self._turned(contact_wrench(self.model, now))
        if pressure[2] < 1.0:
            return None
        return balance(self._turned(bodies_wrench(self.model, now))), balance(pressure)

    def _turned(self, wrench: FloatArray) -> FloatArray:
        return self._ground.inv().apply(wrench.reshape(2, 3)).ravel()

    def _resting(self, folded: FloatArray) -> mujoco.MjData:
        """Return the rover at rest on the slope with its arm folded."""
        model, home = self.model, self.model.key("home").id
        root = int(model.joint(f"{ROBOT}/root_joint").qposadr[0])
        pose = model.key_qpos[home, root : root + 7]
        pose[:3] = self._ground.apply(pose[:3])
        turned = self._ground * Rotation.from_quat(pose[3:], scalar_first=True)
        pose[3:] = turned.as_quat(scalar_first=True)
        motor = datasheets.ARM_MOTOR
        tilted = at_rest(self._ground.inv().apply([0.0, 0.0, 1.0]))
        hold = self.footing.chain.bias(folded, np.zeros(4), tilted)
        voltages = hold / motor.gross_stall_torque * motor.voltage
        for name, angle, voltage in zip(ARM_JOINTS, folded, voltages, strict=True):
            model.key_qpos[home, model.joint(f"{ROBOT}/{name}_joint").qposadr[0]] = angle
            model.key_ctrl[home, model.actuator(f"{ROBOT}/{name}").id] = voltage
        return settle(model)


def footing_of(model: mujoco.MjModel) -> Footing:
    """Return what the guard knows of a rover: its sheet and its arm with the load.

    Args:
        model: The scene with it.
    """
    arm = SerialChain.of_robot(describe(model, ROBOT))
    return dataclasses.replace(Footing.of(describe_rover(ROBOT)), chain=arm)


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
