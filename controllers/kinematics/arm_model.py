"""Where the arm's gripper is, how fast, and which joint angles bring it somewhere.

The gripper's task is its place x, y, z and the pitch of its forward axis: as many numbers as the
arm has joints. Forward and inverse kinematics are those of the stereo head on the same arm, with
the gripper in the camera's place.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.arm_inverse import STRAIGHT, ArmGeometry
from controllers.kinematics.camera_arm import CameraArm

FloatArray = NDArray[np.float64]
LEAST_DISTANCE = 1e-6
"""Of the gripper from the yaw's axis [m]; nearer, every yaw is as good."""


class ArmModel:
    """Kinematics of a rover's arm for its gripper, robot frame."""

    def __init__(self, arm: CameraArm, grip: ArrayLike) -> None:
        """Put the gripper at the end of the arm.

        Args:
            arm: Hinges and limits; what it carries plays no part.
            grip: (3,) the grip point in the last link's frame, whose y axis points forward [m].

        Raises:
            ValueError: If the arm is not a yaw and three hinges about x, or the grip point is
                beside the plane in which they move it.
        """
        place = np.asarray(grip, dtype=float)
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise ValueError(f"grip point {grip}: expected three finite numbers")
        # As a camera: x to the right, y down, z along the gripper.
        looking = Rotation.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        self._arm = dataclasses.replace(
            arm, transform_camera_to_wrist=RigidTransform.from_components(place, looking)
        )
        self._geometry = ArmGeometry.of(self._arm)
        self._base = arm.transform_base_to_robot.rotation.as_matrix()
        self._place = np.asarray(arm.transform_base_to_robot.translation, dtype=float)
        if abs(self._geometry.beside) > STRAIGHT:
            raise ValueError(
                f"grip point {grip}: {self._geometry.beside} m beside the arm's plane, needs 0"
            )

    @property
    def limits(self) -> FloatArray:
        """(4, 2) lowest and highest angles [rad]."""
        return self._arm.limits

    def gripper_in_robot(self, angles: ArrayLike) -> RigidTransform:
        """Return the transform from the gripper, z along it and y down, to the robot frame.

        Args:
            angles: (4,) [rad].

        Raises:
            ValueError: If an angle is missing or not finite.
        """
        return self._arm.camera_in_robot(angles)

    def task(self, angles: ArrayLike) -> FloatArray:
        """Return (4,) the gripper's x, y, z [m] and the pitch of its forward axis [rad].

        The pitch is the sum of the last three joints' angles: it does not wrap.

        Args:
            angles: (4,) [rad].
        """
        place = self.gripper_in_robot(angles).translation
        return np.append(place, np.sum(np.asarray(angles, dtype=float)[1:]))

    def jacobian(self, angles: ArrayLike) -> FloatArray:
        """Return (6, 4): linear [m] and angular [rad] motion of the gripper per joint angle.

        Args:
            angles: (4,) [rad].

        Raises:
            ValueError: As `gripper_in_robot`.
        """
        turns = np.asarray(angles, dtype=float)
        tip = self.gripper_in_robot(turns).translation
        columns: list[FloatArray] = []
        for number, hinge in enumerate(self._arm.hinges):
            link = dataclasses.replace(
                self._arm,
                hinges=self._arm.hinges[: number + 1],
                transform_camera_to_wrist=RigidTransform.identity(),
            ).camera_in_robot(turns[: number + 1])
            axis = link.rotation.apply(hinge.axis)
            columns.append(np.concatenate([np.cross(axis, tip - link.translation), axis]))
        return np.column_stack(columns)

    def task_jacobian(self, angles: ArrayLike) -> FloatArray:
        """Return (4, 4): change of `task` per joint angle.

        Args:
            angles: (4,) [rad].
        """
        return np.vstack([self.jacobian(angles)[:3], [0.0, 1.0, 1.0, 1.0]])

    def inverse(self, task: ArrayLike, near: ArrayLike | None = None) -> FloatArray:
        """Return the joint angles that bring the gripper somewhere.

        The arm's base must stand level in the robot frame, as the rover's does.

        Args:
            task: (4,) x, y, z [m] and pitch [rad], robot frame.
            near: (4,) angles; the solutions are sorted by their distance to these. None for the
                order in which they are found.

        Returns:
            (N, 4) within the limits [rad]; none if it is out of reach.

        Raises:
            ValueError: If a number is missing or not finite, or the place is on the yaw's axis.
        """
        asked = np.asarray(task, dtype=float)
        if asked.shape != (4,) or not np.all(np.isfinite(asked)):
            raise ValueError(f"gripper task {task}: expected x, y, z and pitch, finite")
        eye = self._base.T @ (asked[:3] - self._place) - self._geometry.yaw_axis
        distance = math.hypot(eye[0], eye[1])
        if distance < LEAST_DISTANCE:
            raise ValueError(f"gripper task {task}: on the yaw's axis, where no yaw is singled out")
        heading = math.atan2(-eye[0], eye[1])
        # Facing the place, or turned away and reaching over the shoulder.
        yaws = self._geometry.turned([heading, heading + math.pi])
        bends = self._geometry.bend([distance, -distance], eye[2], asked[3])
        turns = np.broadcast_to(yaws[:, None, None], (2, 2, 1))
        angles = np.concatenate([turns, bends], axis=2).reshape(4, 4)
        angles = angles[np.isfinite(angles).all(axis=1)]
        if near is None:
            return angles
        return angles[np.argsort(np.linalg.norm(angles - np.asarray(near, dtype=float), axis=1))]
