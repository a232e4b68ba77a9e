"""The card at the end of the slave's arm: where it is, how it is moved, and what touches it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from controllers.kinematics.arm_model import ArmModel
from controllers.kinematics.camera_arm import CameraArm
from controllers.kinematics.chain import Chain, at_rest
from controllers.kinematics.serial_arm import RigidBody, SerialArm
from perception.geometry.gravity import GRAVITY
from perception.geometry.se3 import cross_matrix
from twin.description import RobotDescription

FloatArray = NDArray[np.float64]

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
        card_in_slot: (4, 4).
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
    """Kinematics and weight of the arm with the card in its gripper, robot frame."""

    def __init__(self, arm: CameraArm, chain: Chain, tip: float, plate: RigidBody) -> None:
        """Put the card into the gripper.

        Args:
            arm: Hinges and limits.
            chain: The arm with the card, for its weight.
            tip: From the wrist's joint to the middle of the card's leading edge [m].
            plate: What the force sensor carries before the first joint.
        """
        self._plate = plate
        self._model = ArmModel(arm, [0.0, tip, 0.0])
        self._base = arm.transform_base_to_robot.as_matrix()
        self._chain = chain
        self._card = np.eye(4)
        self._card[:3, :3], self._card[:3, 3] = CARD_IN_WRIST, [0.0, tip, 0.0]

    @classmethod
    def of(cls, robot: RobotDescription, tip: float) -> CardArm:
        """Return the arm of a robot as drawn, with the card in its gripper.

        Args:
            robot: The rover; its wrist's body counts the card.
            tip: From the wrist's joint to the middle of the card's leading edge [m].

        Raises:
            ValueError: If it has no arm, naming it.
        """
        arm = robot.arm
        if arm is None or robot.head is None:
            raise ValueError(f"robot {robot.name!r} has no arm with a stereo head to hold a card")
        known = SerialArm.of(arm)
        chain = Chain.of_arm(known, arm.joints[0].rotor_inertia)
        return cls(CameraArm.of(arm, robot.head), chain, tip, known.base)

    @property
    def limits(self) -> FloatArray:
        """(4, 2) lowest and highest joint angles [rad]."""
        return self._model.limits

    def card_in_robot(self, angles: ArrayLike) -> FloatArray:
        """Return (4, 4) from the card to the robot frame at joint angles (4,) [rad]."""
        return self._base @ self._chain.last_frame(angles) @ self._card

    def angles_at(self, place: ArrayLike, pitch: float, near: ArrayLike) -> FloatArray:
        """Return the joint angles that bring the card somewhere.

        The arm has four joints: the card's yaw is that of the arm, and its roll is the robot's.

        Args:
            place: (3,) of the middle of the leading edge [m], robot frame.
            pitch: Of the card's forward axis [rad].
            near: (4,) the angles now; the nearest solution is taken.

        Returns:
            (4,) [rad]; NaN if it is out of reach.
        """
        found = self._model.inverse([*np.asarray(place, dtype=float), pitch], near)
        return found[0] if len(found) else np.full(4, np.nan)

    @property
    def mount(self) -> FloatArray:
        """(3,) the arm's base in the robot frame [m]."""
        return self._base[:3, 3]

    def weight(self, angles: ArrayLike, up: ArrayLike) -> FloatArray:
        """Return the wrench by the rover that holds arm and card up at rest.

        Args:
            angles: (4,) of the joints [rad].
            up: (3,) unit vector that points up, robot frame.

        Returns:
            (6,) in and about the arm's base [N, N m].
        """
        level = self._base[:3, :3].T @ np.asarray(up, dtype=float)
        zero = np.zeros(len(self._chain))
        held = self._chain.inverse_dynamics(angles, zero, zero, at_rest(level))[1]
        plate = self._plate.mass * GRAVITY * level
        return held + np.concatenate([plate, cross_matrix(self._plate.centre) @ plate])

    def contact(self, wrench: ArrayLike, angles: ArrayLike, up: ArrayLike) -> FloatArray:
        """Return what touches the card, from the wrench under the arm.

        Args:
            wrench: (6,) by the rover on the arm, in and about the arm's base [N, N m].
            angles: (4,) of the joints [rad].
            up: (3,) unit vector that points up, robot frame.

        Returns:
            (6,) force and moment on the card, in its frame and about the middle of its leading
            edge, at rest and slow motion [N, N m].
        """
        outside = self.weight(angles, up) - np.asarray(wrench, dtype=float)
        card = self._chain.last_frame(angles) @ self._card
        moment = outside[3:] - cross_matrix(card[:3, 3]) @ outside[:3]
        turn = card[:3, :3].T
        return np.concatenate([turn @ outside[:3], turn @ moment])
