"""What a mapping controller may know beforehand: where its arm carries the stereo head."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.camera_arm import CameraArm, Hinge
from models.compose import ARM_JOINTS
from twin.camera import camera_pose

FloatArray = NDArray[np.float64]
SPACING = 0.03
"""Between the points that stand for a link [m]."""
MARGIN = 0.03
"""Radius about them that covers the link, half the spacing and a reserve [m]."""

_COLLISION_GROUP = 3


def known_camera_arm(model: mujoco.MjModel, robot: str = "rover1") -> CameraArm:
    """Return the arm of a robot and what it carries; the robot frame is that of its chassis.

    Args:
        model: A scene with the robot.
        robot: Name of the robot.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    chassis = body_pose(data, model.body(f"{robot}/chassis").id)
    parent = model.body(f"{robot}/arm_base_link").id
    base = chassis.inv() * body_pose(data, parent)
    hinges: list[Hinge] = []
    shapes: list[FloatArray] = []
    for name in ARM_JOINTS:
        joint = model.joint(f"{robot}/{name}_joint")
        body = int(joint.bodyid[0])
        place = body_pose(data, parent).inv() * body_pose(data, body)
        axis = (float(joint.axis[0]), float(joint.axis[1]), float(joint.axis[2]))
        hinges.append(Hinge(place, axis, (float(joint.range[0]), float(joint.range[1]))))
        fixed = model.body_weldid[model.geom_bodyid] == model.body_weldid[body]
        shapes.append(_points_on(model, data, np.flatnonzero(fixed), body))
        parent = body
    camera = camera_in_world(model, data, f"{robot}/stereo_left")
    return CameraArm(
        base, tuple(hinges), body_pose(data, parent).inv() * camera, tuple(shapes), MARGIN
    )


def known_body(model: mujoco.MjModel, robot: str = "rover1") -> FloatArray:
    """Return spheres (K, 4), centre and radius [m], that cover a rover without its arm.

    Args:
        model: A scene with the robot.
        robot: Name of the robot.
    """
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    chassis = model.body(f"{robot}/chassis").id
    # Bodies are numbered along the tree: the arm's follow its base without a gap.
    first = model.body(f"{robot}/turret").id
    last = model.body(f"{robot}/stereo_head").id
    body = model.geom_bodyid
    rover = (model.body_rootid[body] == chassis) & ~((first <= body) & (body <= last))
    points = _points_on(model, data, np.flatnonzero(rover), chassis)
    return np.column_stack([points, np.full(len(points), MARGIN)])


def body_pose(data: mujoco.MjData, body: int) -> RigidTransform:
    """Return the transform from a body to the world."""
    rotation = Rotation.from_matrix(data.xmat[body].reshape(3, 3))
    return RigidTransform.from_components(data.xpos[body], rotation)


def camera_in_world(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> RigidTransform:
    """Return the transform from a camera, with z along the view, to the world."""
    rotation, translation = camera_pose(data, model.camera(name).id)
    return RigidTransform.from_components(translation, Rotation.from_matrix(rotation))


def _points_on(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.intp], body: int
) -> FloatArray:
    """Return points (k, 3) [m] within the collision shapes among geoms, in a body's frame."""
    to_body = body_pose(data, body).inv()
    found = [np.zeros((0, 3))]
    for geom in geoms[model.geom_group[geoms] == _COLLISION_GROUP]:
        centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        counts = np.maximum(1, np.ceil(2.0 * half / SPACING).astype(int))
        sides = [(np.arange(n) + 0.5) / n * 2.0 * h - h for n, h in zip(counts, half, strict=True)]
        grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3) + centre
        rotation = Rotation.from_matrix(data.geom_xmat[geom].reshape(3, 3))
        place = RigidTransform.from_components(data.geom_xpos[geom], rotation)
        found.append((to_body * place).apply(grid))
    return np.concatenate(found)
