"""Descriptions of robots, extracted from a model as drawn.

Every number comes from the model's drawing or a datasheet; a model of a robot as made must never
be given here. `describe` reads any rover of the scenes' naming, `describe_rover` is the thesis'
rover as its drawings have it.
"""

import dataclasses
import functools
import math
from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from models.compose import FieldConfig, RobotPlacement, make_model
from models.datasheets import ARM_MOTOR, CAMERA, ROVER, TOLERANCES, WHEEL_MOTOR
from perception.geometry.arrays import FloatArray
from twin.camera import camera_model, camera_pose
from twin.description import (
    ArmDescription,
    JointDescription,
    MotorDescription,
    RigidBody,
    RobotDescription,
    StereoHeadDescription,
    WheelDescription,
)
from twin.sensors import DATASHEET

COVER_SPACING = 0.03
"""Distance between the points in a link's or a body's collision shapes [m]."""
COVER_RADIUS = 0.03
"""Radius of the spheres about these points [m]: half the spacing and a reserve."""

_COLLISION_GROUP = 3
_BARE = FieldConfig(texture_pixels=16)
_ARM_BASE = "arm_base_link"
_LEFT, _RIGHT = "stereo_left", "stereo_right"


@functools.cache
def describe_rover(
    name: str = "rover1", *, arm: bool = True, card: bool = False, mast: float = 0.0
) -> RobotDescription:
    """Return the thesis' rover as drawn, with its stereo head.

    Args:
        name: Name of the robot.
        arm: True for a robot with the arm.
        card: True for a card in the gripper, which counts as part of the wrist.
        mast: Height by which the stereo head is raised above its place on the wrist [m].
    """
    model = make_model(_BARE, [RobotPlacement(name, arm=arm, card=card, mast=mast)])
    drawn = describe(model, name)
    # The model's literals are rounded; the datasheets' numbers are not.
    camera = CAMERA.pinhole
    head = drawn.head
    if head is not None:
        head = dataclasses.replace(head, camera=camera, baseline=CAMERA.baseline)
    motors = [WHEEL_MOTOR] * len(drawn.wheels) + [ARM_MOTOR] * len(drawn.joint_names)
    return dataclasses.replace(
        drawn,
        centre_height=ROVER.centre_height,
        head=head,
        # The friction that the sheets' shaft torque leaves out is a control loop's to find.
        motors=tuple(
            MotorDescription(sheet.gross_stall_torque, sheet.gross_no_load_speed)
            for sheet in motors
        ),
    )


def describe_placement(robot: RobotPlacement) -> RobotDescription:
    """Return a robot of a scene as drawn: the thesis' rover, or one of the user's own.

    Args:
        robot: Robot as placed in the scene; its pose and payload do not count.
    """
    if robot.model:
        return describe(
            make_model(_BARE, [RobotPlacement(robot.name, model=robot.model)]), robot.name
        )
    drawn = describe_rover(robot.name, arm=robot.arm, card=robot.card)
    return drawn if robot.stereo else dataclasses.replace(drawn, head=None)


def describe(model: mujoco.MjModel, robot: str) -> RobotDescription:
    """Return a robot of a scene as drawn, with what its gripper holds as part of the wrist.

    Its names begin with the robot's and a slash: the free body ``chassis``, the arm's first body
    ``arm_base_link``, for each motor ``x`` a hinge ``x_joint``, cameras ``stereo_left`` and
    ``stereo_right``. Driven hinges that are not the arm's turn wheels.

    Args:
        model: A scene with the robot as drawn.
        robot: Name of the robot.

    Raises:
        ValueError: If the scene has no such robot, or its arm is not a chain of hinges through
            their bodies' origins.
    """
    chassis = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{robot}/chassis")
    if chassis < 0:
        raise ValueError(f"the scene has no robot {robot!r}: there is no body '{robot}/chassis'")
    data = mujoco.MjData(model)
    # At the origin and level, so that the placement in the scene does not round the numbers.
    root = model.jnt_qposadr[model.body_jntadr[chassis]]
    data.qpos[[root, root + 1]], data.qpos[root + 3 : root + 7] = 0.0, [1.0, 0.0, 0.0, 0.0]
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{robot}/{_ARM_BASE}")
    on_arm = descendants(model, base) if base >= 0 else np.zeros(model.nbody, dtype=bool)
    motors = _motors(model, robot)
    wheels = tuple(
        _wheel(model, data, chassis, name, joint)
        for name, joint in motors.items()
        if not on_arm[model.jnt_bodyid[joint]]
    )
    arm, joints = None, dict[str, int]()
    if base >= 0:
        joints = {n: j for n, j in motors.items() if on_arm[model.jnt_bodyid[j]]}
        arm = _arm(model, data, robot, joints)
    own = (model.body_rootid == chassis) & ~on_arm
    points = _points_on(model, data, np.flatnonzero(own[model.geom_bodyid]), chassis)
    return RobotDescription(
        robot,
        wheels,
        _body(model, data, np.flatnonzero(own), chassis),
        np.column_stack([points, np.full(len(points), COVER_RADIUS)]),
        float(np.mean([wheel.radius - wheel.centre[2] for wheel in wheels])) if wheels else 0.0,
        arm,
        _head(model, data, robot, on_arm),
        {name: np.asarray(spec.noise, dtype=float) for name, spec in DATASHEET.channels.items()},
        tuple(
            _motor(model, f"{robot}/{name}")
            for name in (*(wheel.name for wheel in wheels), *joints)
        ),
    )


def body_pose(data: mujoco.MjData, body: int) -> RigidTransform:
    """Return the transform from a body to the world."""
    rotation = Rotation.from_quat(data.xquat[body], scalar_first=True)
    return RigidTransform.from_components(data.xpos[body], rotation)


def camera_in_world(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> RigidTransform:
    """Return the transform from a camera, with z along the view, to the world."""
    rotation, translation = camera_pose(data, model.camera(name).id)
    return RigidTransform.from_components(translation, Rotation.from_matrix(rotation))


def _merge(parts: Iterable[tuple[float, FloatArray, FloatArray]]) -> RigidBody:
    """Return rigid parts as one body: masses, centres and inertias about them, in one frame."""
    masses, centres, tensors = zip(*parts, strict=True)
    weights = np.array(masses)
    mass = float(weights.sum())
    centre = weights @ np.array(centres) / mass
    levers = np.array(centres) - centre
    steiner = sum(
        m * (lever @ lever * np.eye(3) - np.outer(lever, lever))
        for m, lever in zip(weights, levers)
    )
    return RigidBody(mass, centre, np.sum(tensors, axis=0) + steiner)


def _motors(model: mujoco.MjModel, robot: str) -> dict[str, int]:
    """Return the driven joint of each motor of a robot, by name, in the scene's order."""
    named = {model.actuator(i).name: int(model.actuator_trnid[i, 0]) for i in range(model.nu)}
    prefix = f"{robot}/"
    return {name[len(prefix) :]: joint for name, joint in named.items() if name.startswith(prefix)}


def _motor(model: mujoco.MjModel, actuator: str) -> MotorDescription:
    """Return the torque-speed line of an actuator: a ``dcmotor``, or an affine one in volts.

    Raises:
        ValueError: If it is of another kind, whose line is unknown.
    """
    motor = model.actuator(actuator)
    volts, bias = float(motor.ctrlrange[1]), motor.biasprm
    if motor.gaintype[0] == mujoco.mjtGain.mjGAIN_DCMOTOR:
        resistance, constant = motor.gainprm[:2].tolist()
        return MotorDescription(volts * constant / resistance, volts / constant)
    if volts > 0.0 and motor.biastype[0] == mujoco.mjtBias.mjBIAS_AFFINE and bias[2] < 0.0:
        torque = volts * float(motor.gainprm[0])
        return MotorDescription(torque, -torque / float(bias[2]))
    raise ValueError(
        f"actuator {actuator}: neither a dcmotor with a range of volts nor an affine one with "
        "a speed term, so its torque by speed is not known"
    )


def descendants(model: mujoco.MjModel, ancestor: int) -> NDArray[np.bool_]:
    """Return (nbody,) whether a body is the ancestor or one of its descendants."""
    below = np.zeros(model.nbody, dtype=bool)
    below[ancestor] = True
    for body in range(ancestor + 1, model.nbody):  # parents come before their children
        below[body] = below[model.body_parentid[body]]
    return below


def _wheel(
    model: mujoco.MjModel, data: mujoco.MjData, chassis: int, name: str, joint: int
) -> WheelDescription:
    body = int(model.jnt_bodyid[joint])
    centre = (body_pose(data, chassis).inv() * body_pose(data, body)).translation
    tyres = (model.geom_bodyid == body) & (model.geom_group == _COLLISION_GROUP)
    # Of a wheel's three half extents two are its radius.
    radius = np.median(model.geom_aabb[tyres, 3:], axis=1).max(initial=0.0)
    sliding = np.flatnonzero(
        (model.jnt_bodyid == body) & (model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    )
    spring, damper = math.inf, 0.0
    if len(sliding):
        spring = float(model.jnt_stiffness[sliding[0]])
        damper = float(model.dof_damping[model.jnt_dofadr[sliding[0]]])
    mass = float(model.body_mass[body])
    friction = float(model.dof_frictionloss[model.jnt_dofadr[joint]])
    sigma = TOLERANCES.spring / math.sqrt(3.0)  # uniform
    place = np.asarray(centre)
    return WheelDescription(name, place, float(radius), mass, spring, damper, friction, sigma)


def _arm(
    model: mujoco.MjModel, data: mujoco.MjData, robot: str, motors: dict[str, int]
) -> ArmDescription:
    chassis, base = model.body(f"{robot}/chassis").id, model.body(f"{robot}/{_ARM_BASE}").id
    joints: list[JointDescription] = []
    parent = base
    for name, joint in motors.items():
        body, dof = int(model.jnt_bodyid[joint]), model.jnt_dofadr[joint]
        if np.any(model.jnt_pos[joint]) or model.body_parentid[body] != parent:
            raise ValueError(f"joint {name} of {robot}: not a hinge through its body's origin")
        fixed = model.body_weldid[model.geom_bodyid] == model.body_weldid[body]
        place = RigidTransform.from_components(
            model.body_pos[body], Rotation.from_quat(model.body_quat[body], scalar_first=True)
        )
        x, y, z = model.jnt_axis[joint].tolist()
        low, high = model.jnt_range[joint].tolist()
        joints.append(
            JointDescription(
                name,
                place,
                (x, y, z),
                _rigid_body(model, body),
                (low, high),
                rotor_inertia=float(model.dof_armature[dof]),
                friction=float(model.dof_frictionloss[dof]),
                cover_points=_points_on(model, data, np.flatnonzero(fixed), body),
            )
        )
        parent = body
    home = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    rest = model.key_qpos[home] if home >= 0 else model.qpos0
    angles = rest[[model.jnt_qposadr[joint] for joint in motors.values()]].copy()
    transform = body_pose(data, chassis).inv() * body_pose(data, base)
    return ArmDescription(transform, _rigid_body(model, base), tuple(joints), angles, COVER_RADIUS)


def _head(
    model: mujoco.MjModel, data: mujoco.MjData, robot: str, on_arm: NDArray[np.bool_]
) -> StereoHeadDescription | None:
    camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, f"{robot}/{_LEFT}")
    if camera < 0 or not on_arm[model.cam_bodyid[camera]]:
        return None
    left = camera_in_world(model, data, f"{robot}/{_LEFT}")
    right = camera_in_world(model, data, f"{robot}/{_RIGHT}")
    wrist = int(model.body_weldid[model.cam_bodyid[camera]])
    return StereoHeadDescription(
        camera_model(model, f"{robot}/{_LEFT}"),
        float((left.inv() * right).translation[0]),
        body_pose(data, wrist).inv() * left,
    )


def _rigid_body(model: mujoco.MjModel, body: int) -> RigidBody:
    """Return a body with all that is fixed to it, in its frame."""
    parts = [(body, np.zeros(3), np.eye(3))]
    found: list[tuple[float, FloatArray, FloatArray]] = []
    while parts:
        part, offset, rotation = parts.pop()
        axes = rotation @ _matrix(model.body_iquat[part])
        tensor = axes @ np.diag(model.body_inertia[part]) @ axes.T
        found.append(
            (float(model.body_mass[part]), offset + rotation @ model.body_ipos[part], tensor)
        )
        for child in np.flatnonzero(model.body_parentid == part):
            if child != part and model.body_jntnum[child] == 0:
                place = offset + rotation @ model.body_pos[child]
                parts.append((int(child), place, rotation @ _matrix(model.body_quat[child])))
    return _merge(found)


def _body(
    model: mujoco.MjModel, data: mujoco.MjData, parts: NDArray[np.intp], frame: int
) -> RigidBody:
    """Return bodies as one in the frame of another, whose axes are the world's."""
    axes = data.ximat[parts].reshape(-1, 3, 3)
    tensors = [a @ np.diag(i) @ a.T for a, i in zip(axes, model.body_inertia[parts])]
    centres = data.xipos[parts] - data.xpos[frame]
    return _merge(zip(model.body_mass[parts].tolist(), centres, tensors))


def _points_on(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.intp], body: int
) -> FloatArray:
    """Return points (k, 3) [m] within the collision shapes among geoms, in a body's frame."""
    to_body = body_pose(data, body).inv()
    found = [np.zeros((0, 3))]
    for geom in geoms[model.geom_group[geoms] == _COLLISION_GROUP]:
        centre, half = np.split(np.asarray(model.geom_aabb[geom], dtype=float), 2)
        sides: list[FloatArray] = []
        for h in half.tolist():
            count = max(1, math.ceil(2.0 * h / COVER_SPACING))
            sides.append((np.arange(count) + 0.5) / count * 2.0 * h - h)
        grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3) + centre
        rotation = Rotation.from_matrix(data.geom_xmat[geom].reshape(3, 3))
        place = RigidTransform.from_components(data.geom_xpos[geom], rotation)
        found.append((to_body * place).apply(grid))
    return np.concatenate(found)


def _matrix(quaternion: FloatArray) -> FloatArray:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
