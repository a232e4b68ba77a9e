"""Newton-Euler dynamics of a known serial arm on a moving base, for many samples at once.

The wrench on the arm is linear in the ten inertial parameters of each link, so the forward
recursion of Newton and Euler gives both the prediction for a known arm and the regressor for an
unknown body in its gripper. All vectors of a `FrameMotion` are in the base frame: the face of the
force/torque sensor under the arm.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from perception.geometry.se3 import axis_rotation, cross_matrix
from twin.description import ArmDescription

FloatArray = NDArray[np.float64]

NAMES = ("mass", "hx", "hy", "hz", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Inertial parameters of a body: mass [kg], first moment of mass h [kg m], inertia [kg m^2].

First moment and inertia are about the origin of the body's frame; off-diagonal inertias are
elements of the tensor, minus the products of inertia.
"""
COUNT = len(NAMES)
INERTIA_ELEMENTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclasses.dataclass(frozen=True)
class RigidBody:
    """A rigid body in its own frame.

    Attributes:
        mass: [kg].
        centre: (3,) centre of mass from the frame's origin [m].
        inertia: (3, 3) inertia tensor about the centre of mass [kg m^2].
    """

    mass: float
    centre: FloatArray
    inertia: FloatArray

    def parameters(self) -> FloatArray:
        """Return (10,) the inertial parameters, in the order of `NAMES`."""
        centre = np.asarray(self.centre)
        about_origin = self.inertia + self.mass * (
            centre @ centre * np.eye(3) - np.outer(centre, centre)
        )
        upper = [about_origin[row, column] for row, column in INERTIA_ELEMENTS]
        return np.array([self.mass, *(self.mass * centre), *upper])


@dataclasses.dataclass(frozen=True)
class Link:
    """A link and the hinge that turns it; the hinge's axis goes through the frame's origin.

    Attributes:
        body: The link's mass, in the link's frame.
        offset: (3,) origin of the link's frame in its parent's frame [m].
        rotation: (3, 3) the link's axes in its parent's frame at joint angle zero.
        axis: (3,) unit vector of the hinge in the link's frame.
    """

    body: RigidBody
    offset: FloatArray
    rotation: FloatArray
    axis: FloatArray


@dataclasses.dataclass(frozen=True)
class SerialArm:
    """An arm above its force/torque sensor.

    Attributes:
        base: What the sensor carries before the first joint, in the base frame.
        links: From the base to the wrist.
    """

    base: RigidBody
    links: tuple[Link, ...]

    @classmethod
    def of(cls, arm: ArmDescription) -> SerialArm:
        """Return the arm of a robot as drawn."""
        links = [
            Link(
                RigidBody(j.body.mass, j.body.centre, j.body.inertia),
                j.transform_link_to_parent.translation,
                j.transform_link_to_parent.rotation.as_matrix(),
                np.array(j.axis),
            )
            for j in arm.joints
        ]
        return cls(RigidBody(arm.base.mass, arm.base.centre, arm.base.inertia), tuple(links))


@dataclasses.dataclass(frozen=True)
class BaseMotion:
    """How the base frame moves, in its own coordinates.

    Attributes:
        acceleration: (n, 3) acceleration of the origin minus that of free fall [m/s^2]; at rest
            and level it is 9.81 upward.
        angular_velocity: (n, 3) [rad/s].
        angular_acceleration: (n, 3) [rad/s^2].
    """

    acceleration: FloatArray
    angular_velocity: FloatArray
    angular_acceleration: FloatArray


@dataclasses.dataclass(frozen=True)
class JointMotion:
    """How the joints move.

    Attributes:
        angles: (n, joints) [rad].
        rates: (n, joints) [rad/s].
        accelerations: (n, joints) [rad/s^2].
    """

    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray


@dataclasses.dataclass(frozen=True)
class FrameMotion:
    """How a link's frame stands and moves; vectors in the base frame.

    Attributes:
        rotation: (n, 3, 3) from the link's frame to the base frame.
        position: (n, 3) origin [m].
        acceleration: (n, 3) of the origin, minus that of free fall [m/s^2].
        angular_velocity: (n, 3) [rad/s].
        angular_acceleration: (n, 3) [rad/s^2].
    """

    rotation: FloatArray
    position: FloatArray
    acceleration: FloatArray
    angular_velocity: FloatArray
    angular_acceleration: FloatArray


def frame_motions(arm: SerialArm, joints: JointMotion, base: BaseMotion) -> list[FrameMotion]:
    """Return the motion of the base and of each link's frame, from base to wrist.

    Args:
        arm: The arm.
        joints: Of its joints.
        base: Of its base.

    Raises:
        ValueError: If there is not one column for each joint.
    """
    count = len(joints.angles)
    if joints.angles.shape != (count, len(arm.links)):
        raise ValueError(
            f"joint angles: expected shape (n, {len(arm.links)}), got {joints.angles.shape}"
        )
    still = np.zeros((count, 3))
    frame = FrameMotion(
        np.broadcast_to(np.eye(3), (count, 3, 3)),
        still,
        base.acceleration,
        base.angular_velocity,
        base.angular_acceleration,
    )
    frames = [frame]
    for index, link in enumerate(arm.links):
        angle, rate = joints.angles[:, index], joints.rates[:, index]
        frame = _next_frame(frame, link, angle, rate, joints.accelerations[:, index])
        frames.append(frame)
    return frames


def _next_frame(
    parent: FrameMotion, link: Link, angle: FloatArray, rate: FloatArray, acceleration: FloatArray
) -> FrameMotion:
    arm = np.einsum("nij,j->ni", parent.rotation, link.offset)
    omega, alpha = parent.angular_velocity, parent.angular_acceleration
    turned = np.asarray(np.cross(alpha, arm) + np.cross(omega, np.cross(omega, arm)), dtype=float)
    rotation = parent.rotation @ (link.rotation @ axis_rotation(link.axis, angle))
    spin = np.einsum("nij,j->ni", rotation, link.axis)
    turning = spin * rate[:, None]
    return FrameMotion(
        rotation,
        parent.position + arm,
        parent.acceleration + turned,
        omega + turning,
        alpha + spin * acceleration[:, None] + np.cross(omega, turning),
    )


def wrench_regressor(frame: FrameMotion) -> FloatArray:
    """Return (n, 6, 10): wrench on a body fixed in a frame, per inertial parameter.

    Force [N] and moment [N m] about the base frame's origin, in the base frame; the parameters
    (order of `NAMES`) are in the body's frame.

    Args:
        frame: Motion of the body's frame.
    """

    def inside(vectors: FloatArray) -> FloatArray:
        return np.einsum("nji,nj->ni", frame.rotation, vectors)

    acceleration = inside(frame.acceleration)
    omega = cross_matrix(inside(frame.angular_velocity))
    alpha = inside(frame.angular_acceleration)
    local = np.zeros((len(acceleration), 6, COUNT))
    local[:, :3, 0] = acceleration
    local[:, :3, 1:4] = cross_matrix(alpha) + omega @ omega
    local[:, 3:, 1:4] = -cross_matrix(acceleration)
    turning = _inertia_times(inside(frame.angular_velocity))
    local[:, 3:, 4:] = _inertia_times(alpha) + omega @ turning
    force = frame.rotation @ local[:, :3]
    moment = frame.rotation @ local[:, 3:] + cross_matrix(frame.position) @ force
    return np.concatenate([force, moment], axis=1)


def _inertia_times(vectors: FloatArray) -> FloatArray:
    """Return (n, 3, 6): I v as a linear map of the six elements of I."""
    matrix = np.zeros((len(vectors), 3, 6))
    for index, (row, column) in enumerate(INERTIA_ELEMENTS):
        matrix[:, row, index] = vectors[:, column]
        matrix[:, column, index] = vectors[:, row]
    return matrix


def arm_wrench(arm: SerialArm, frames: list[FrameMotion]) -> FloatArray:
    """Return (n, 6) force [N] and moment [N m] by the rover on the arm, in the base frame.

    Args:
        arm: The arm.
        frames: From `frame_motions`.
    """
    bodies = [arm.base, *(link.body for link in arm.links)]
    return sum(
        (wrench_regressor(frame) @ body.parameters() for frame, body in zip(frames, bodies)),
        start=np.zeros((len(frames[0].position), 6)),
    )


def locked_inertia(arm: SerialArm, angles: FloatArray) -> FloatArray:
    """Return (n, 6, 6): wrench on the arm per base acceleration, with the joints at rest.

    Columns are the linear acceleration of the base's origin, then its angular acceleration.

    Args:
        arm: The arm.
        angles: (n, joints) [rad].
    """
    still = np.zeros((len(angles), 3))
    joints = JointMotion(angles, np.zeros_like(angles), np.zeros_like(angles))
    columns: list[FloatArray] = []
    for axis in range(6):
        unit = np.zeros((len(angles), 6))
        unit[:, axis] = 1.0
        base = BaseMotion(unit[:, :3], still, unit[:, 3:])
        columns.append(arm_wrench(arm, frame_motions(arm, joints, base)))
    return np.stack(columns, axis=-1)
