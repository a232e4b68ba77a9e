"""Plants of ``appa-control``: the nine coordinates in MuJoCo, and rovers on other springs."""

import dataclasses

import mujoco
import numpy as np

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.lagrange import NineCoordinates
from models import datasheets
from models.compose import WHEELS, FieldConfig, RobotPlacement, load_part, make_model
from perception.geometry.arrays import FloatArray
from perception.geometry.gravity import GRAVITY
from twin.describe import describe_rover
from twin.description import RigidBody

PLAIN = FieldConfig(texture_pixels=16)
"""Flat ground with a small texture: quick to compile."""
MOUNT = np.array(datasheets.ROVER.arm_mount)
_SHEET = datasheets.ROVER
_BASE_SIDES = np.array([_SHEET.deck_half_x, 2.0 * _SHEET.deck_half_y, _SHEET.deck_half_z])


@dataclasses.dataclass(frozen=True)
class PlanarPlant:
    """The nine coordinates twice: in MuJoCo, and as the controllers' model.

    Attributes:
        model: Slides y and z and pitch of the vehicle, pitch and slides y and z of the suspension,
            then shoulder, elbow and wrist; nothing else moves.
        coordinates: Ours.
    """

    model: mujoco.MjModel
    coordinates: NineCoordinates


def planar_plant() -> PlanarPlant:
    """Build both from the rover's sheet and the arm's model."""
    wheels = 4.0 * _SHEET.wheel_mass
    wheel_inertia = wheels * np.array([_SHEET.half_wheelbase**2, 1e-3, _SHEET.half_wheelbase**2])
    depth = _SHEET.wheel_radius - _SHEET.centre_height
    vehicle = RigidBody(wheels, np.array([0.0, 0.0, depth]), np.diag(wheel_inertia))
    squares = _BASE_SIDES**2
    inertia = _SHEET.sprung_mass / 3.0 * np.diag(squares.sum() - squares)
    rise = _SHEET.sprung_height - _SHEET.centre_height
    base = RigidBody(_SHEET.sprung_mass, np.array([0.0, 0.0, rise]), inertia)
    spec = mujoco.MjSpec()
    lower = _moving(spec.worldbody, vehicle, "vehicle", ("y", "z", "pitch"))
    upper = _moving(lower, base, "base", ("pitch", "y", "z"))
    site = upper.add_site(name="mount", pos=MOUNT)
    arm = load_part("arm")
    for name in ("timestep", "integrator", "cone", "impratio", "jacobian"):
        setattr(spec.option, name, getattr(arm.option, name))
    arm.attach(load_part("stereo_head"), site=arm.site("stereo_mount"), prefix="head/")
    for kind in (arm.sensors, arm.actuators):
        for element in list(kind):
            arm.delete(element)
    arm.delete(arm.joint("base_yaw_joint"))
    for joint in list(arm.joints):
        joint.frictionloss = 0.0
    spec.attach(arm, site=site, prefix="rover1/")
    coordinates = NineCoordinates(vehicle, base, SerialChain.of_robot(describe_rover()))
    return PlanarPlant(spec.compile(), coordinates)


def _moving(
    parent: mujoco.MjsBody, body: RigidBody, name: str, joints: tuple[str, ...]
) -> mujoco.MjsBody:
    made = parent.add_body(name=name)
    made.mass, made.ipos = body.mass, body.centre
    made.inertia, made.explicitinertial = np.diag(body.inertia), True
    axes = {"y": [0.0, 1.0, 0.0], "z": [0.0, 0.0, 1.0], "pitch": [1.0, 0.0, 0.0]}
    kinds = mujoco.mjtJoint
    for joint in joints:
        kind = kinds.mjJNT_HINGE if joint == "pitch" else kinds.mjJNT_SLIDE
        made.add_joint(name=f"{name}_{joint}", type=kind, axis=axes[joint])
    return made


def model_errors(plant: PlanarPlant, states: int, rng: np.random.Generator) -> FloatArray:
    """Return (states, 3) relative errors of mass matrix, bias and efforts at random states.

    Each is the Frobenius norm of the difference from MuJoCo's ``mj_fullM``, ``qfrc_bias`` and
    ``mj_inverse`` over that of MuJoCo's own.

    Args:
        plant: Both models.
        states: Number of states.
        rng: Random generator of angles of any size and of rates and accelerations of some rad/s
            and rad/s^2.
    """
    model, ours = plant.model, plant.coordinates
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, mass = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    errors: list[list[float]] = []
    for _ in range(states):
        q = rng.uniform(-1.0, 1.0, 9) * np.array([1.0, 1.0, 3.0, 0.5, 0.1, 0.1, 3.0, 3.0, 3.0])
        rates, accelerations = 3.0 * rng.standard_normal((2, 9))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, rates, accelerations
        mujoco.mj_inverse(model, data)
        mujoco.mj_fullM(model, data, mass)
        pairs = (
            (ours.mass_matrix(q), mass),
            (ours.bias(q, rates), data.qfrc_bias),
            (ours.efforts(q, rates, accelerations), data.qfrc_inverse),
        )
        errors.append([float(np.linalg.norm(a - b) / np.linalg.norm(b)) for a, b in pairs])
    return np.array(errors)


def sprung_rover(stiffness: float) -> mujoco.MjModel:
    """Return the rover on springs of another stiffness, with the dampers that it has.

    Args:
        stiffness: Pitch stiffness of the bare rover [N m/rad]; by eq. A-1 the springs also carry
            the bare rover level.
    """
    model = make_model(PLAIN, [RobotPlacement("rover1")])
    weight = _SHEET.sprung_mass * GRAVITY
    lever = _SHEET.sprung_height - _SHEET.wheel_radius
    spring = (stiffness + weight * lever) / (4.0 * _SHEET.half_wheelbase**2)
    for wheel in WHEELS:
        joint = model.joint(f"rover1/{wheel}_suspension_joint")
        joint.stiffness[0] = spring
        model.qpos_spring[joint.qposadr[0]] = -weight / (4.0 * spring)
    return model
