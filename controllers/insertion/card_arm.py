"""The card at the end of the slave's arm: its pose, its motion, and its contact wrench.

Functions that run several times a tick take and return poses as matrices (4, 4), as
`SerialChain.tool_frame` does: a fiftieth of the time of a `RigidTransform`.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.arm_inverse import GripperInverse
from controllers.kinematics.rigid_motion import at_rest
from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray
from perception.geometry.se3 import cross_matrix
from twin.description import RobotDescription

CARD_IN_WRIST = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Columns: across, ahead and normal of the card in the axes of the last link, y forward."""


def planar(pose: ArrayLike) -> FloatArray:
    """Return a pose in the slot's plane as (4, 4) from card to slot.

    Args:
        pose: (3,) across, ahead [m] and turn about the normal [rad].
    """
    x, y, turn = (float(value) for value in np.asarray(pose, dtype=float))
    c, s = math.cos(turn), math.sin(turn)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def to_plane(card_in_slot: FloatArray) -> FloatArray:
    """Return (5,) of a card in the slot's frame: across, ahead, turn, and beside and yaw out of it.

    The turn is that of the card's forward axis within the plane, the yaw the angle of this axis
    with the plane.

    Args:
        card_in_slot: (4, 4) pose of the card.
    """
    x, y, z = card_in_slot[:3, 3]
    right, forward, out = card_in_slot[:3, 1]
    return np.array([x, y, math.atan2(-right, forward), z, math.asin(min(max(out, -1.0), 1.0))])


def pitch_of(card_in_robot: FloatArray) -> float:
    """Return the pitch of a card's forward axis [rad], from (4, 4)."""
    x, y, z = card_in_robot[:3, 1]
    return math.atan2(z, math.hypot(x, y))


def inverse(transform: FloatArray) -> FloatArray:
    """Return the inverse of a rigid transform (4, 4)."""
    result = np.eye(4)
    result[:3, :3] = transform[:3, :3].T
    result[:3, 3] = -result[:3, :3] @ transform[:3, 3]
    return result


class CardArm:
    """Kinematics and weight of the arm with the card in its gripper, robot frame.

    Args:
        robot: Description of the rover; its wrist's body includes the card.
        tip: Distance from the wrist's joint to the middle of the card's leading edge [m].

    Attributes:
        limits: (4, 2) lowest and highest joint angles [rad].
        mount: (3,) position of the arm's base in the robot frame [m].

    Raises:
        ValueError: If the robot has no arm, naming it.
    """

    def __init__(self, robot: RobotDescription, tip: float) -> None:
        arm, place = SerialChain.of_robot(robot), [0.0, tip, 0.0]
        self._inverse = GripperInverse(arm, place)
        card = RigidTransform.from_components(place, Rotation.from_matrix(CARD_IN_WRIST))
        self._chain = dataclasses.replace(arm, transform_tool_to_link=card)
        self._base = arm.transform_base_to_robot.as_matrix()
        self.limits, self.mount = arm.limits, self._base[:3, 3]

    def card_frame(self, angles: ArrayLike) -> FloatArray:
        """Return (4, 4) from the card to the robot frame at joint angles (4,) [rad]."""
        return self._chain.tool_frame(angles)

    def transform_card_to_robot(self, angles: ArrayLike) -> RigidTransform:
        """Return the transform from the card to the robot frame at joint angles (4,) [rad]."""
        return RigidTransform.from_matrix(self.card_frame(angles))

    def angles_at(self, place: ArrayLike, pitch: float, near: ArrayLike) -> FloatArray:
        """Return the joint angles that bring the card to a position.

        The arm has four joints: the card's yaw is that of the arm, and its roll is the robot's.

        Args:
            place: (3,) position of the middle of the leading edge [m], robot frame.
            pitch: Pitch of the card's forward axis [rad].
            near: (4,) present angles [rad]; the nearest solution is returned.

        Returns:
            (4,) [rad]; NaN if it is out of reach.
        """
        found = self._inverse.solutions([*np.asarray(place, dtype=float), pitch], near)
        return found[0] if len(found) else np.full(4, np.nan)

    def weight(self, angles: ArrayLike, up: ArrayLike) -> FloatArray:
        """Return the wrench by the rover that holds arm and card up at rest.

        Args:
            angles: (4,) joint angles [rad].
            up: (3,) unit vector that points up, robot frame.

        Returns:
            (6,) in and about the arm's base [N, N m].
        """
        level = self._base[:3, :3].T @ np.asarray(up, dtype=float)
        zero = np.zeros(len(self._chain))
        return self._chain.inverse_dynamics(angles, zero, zero, at_rest(level))[1]

    def contact(self, wrench: ArrayLike, angles: ArrayLike, up: ArrayLike) -> FloatArray:
        """Return what touches the card, from the wrench under the arm.

        Args:
            wrench: (6,) by the rover on the arm, in and about the arm's base [N, N m].
            angles: (4,) joint angles [rad].
            up: (3,) unit vector that points up, robot frame.

        Returns:
            (6,) force and moment on the card, in its frame and about the middle of its leading
            edge, at rest and slow motion [N, N m].
        """
        outside = self.weight(angles, up) - np.asarray(wrench, dtype=float)
        card = inverse(self._base) @ self._chain.tool_frame(angles)
        moment = outside[3:] - cross_matrix(card[:3, 3]) @ outside[:3]
        turn = card[:3, :3].T
        return np.concatenate([turn @ outside[:3], turn @ moment])
