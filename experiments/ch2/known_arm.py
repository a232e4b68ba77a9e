"""What a controller may know beforehand: the robot's own arm, read off its compiled model."""

from __future__ import annotations

import mujoco
import numpy as np

from controllers.identification.friction import KnownBase
from controllers.kinematics.serial_arm import FloatArray, Link, RigidBody, SerialArm
from models import datasheets
from models.compose import ARM_JOINTS, FLAT, RobotPlacement, make_model


def known_arm(model: mujoco.MjModel, robot: str = "rover1") -> SerialArm:
    """Return the arm above the force/torque sensor, with everything fixed to its links.

    Args:
        model: A scene with the robot; what its gripper holds counts as part of the wrist.
        robot: Name of the robot.

    Raises:
        ValueError: If the arm is not a chain of hinges through their bodies' origins.
    """
    base = model.body(f"{robot}/arm_base_link").id
    links: list[Link] = []
    parent = base
    for name in ARM_JOINTS:
        joint = model.joint(f"{robot}/{name}_joint")
        body = int(joint.bodyid[0])
        if np.any(joint.pos) or model.body_parentid[body] != parent:
            raise ValueError(f"joint {name} of {robot}: not a hinge through its body's origin")
        place = model.body_pos[body].copy(), _matrix(model.body_quat[body])
        links.append(Link(rigid_body(model, body), *place, axis=joint.axis.copy()))
        parent = body
    return SerialArm(rigid_body(model, base), tuple(links))


def rigid_body(model: mujoco.MjModel, body: int) -> RigidBody:
    """Return a body with all that is fixed to it, in its frame.

    Args:
        model: A compiled scene.
        body: Index of the body.
    """
    parts = [(body, np.zeros(3), np.eye(3))]
    masses: list[float] = []
    centres: list[FloatArray] = []
    tensors: list[FloatArray] = []
    while parts:
        part, offset, rotation = parts.pop()
        axes = rotation @ _matrix(model.body_iquat[part])
        masses.append(float(model.body_mass[part]))
        centres.append(offset + rotation @ model.body_ipos[part])
        tensors.append(axes @ np.diag(model.body_inertia[part]) @ axes.T)
        for child in np.flatnonzero(model.body_parentid == part):
            if child != part and model.body_jntnum[child] == 0:
                place = offset + rotation @ model.body_pos[child]
                parts.append((int(child), place, rotation @ _matrix(model.body_quat[child])))
    return merge(masses, centres, tensors)


def merge(masses: list[float], centres: list[FloatArray], tensors: list[FloatArray]) -> RigidBody:
    """Return several rigid parts as one body.

    Args:
        masses: Of the parts [kg].
        centres: Their centres of mass (3,), in one frame [m].
        tensors: Their inertias (3, 3) about their own centres, in the same axes [kg m^2].
    """
    weights = np.array(masses)
    mass = float(weights.sum())
    centre = weights @ np.array(centres) / mass
    levers = np.array(centres) - centre
    steiner = sum(
        m * (lever @ lever * np.eye(3) - np.outer(lever, lever))
        for m, lever in zip(weights, levers)
    )
    return RigidBody(mass, centre, np.sum(tensors, axis=0) + steiner)


def known_base() -> KnownBase:
    """Return the rover without its arm, in the body frame."""
    model = make_model(FLAT, [RobotPlacement("rover1", arm=False)])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    root = model.body("rover1/chassis").id
    parts = np.flatnonzero(model.body_rootid == root)
    axes = data.ximat[parts].reshape(-1, 3, 3)
    tensors = [a @ np.diag(i) @ a.T for a, i in zip(axes, model.body_inertia[parts])]
    centres = list(data.xipos[parts] - data.xpos[root])
    body = merge(model.body_mass[parts].tolist(), centres, tensors)
    sheet = datasheets.ROVER
    corners = [(-1, 1), (1, 1), (-1, -1), (1, -1)]
    wheels = [(x * sheet.half_track, y * sheet.half_wheelbase) for x, y in corners]
    ground = np.full((4, 1), -sheet.centre_height)
    return KnownBase(body, np.array(sheet.arm_mount), np.hstack([wheels, ground]))


def _matrix(quaternion: FloatArray) -> FloatArray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
