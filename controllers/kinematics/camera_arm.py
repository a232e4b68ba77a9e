"""Kinematics of a stereo head on an arm: from joint angles to where the camera is.

Frames: the robot frame stands at the rover's start with x to the right, y forward and z up; the
camera frame is that of the left camera, x to the right, y down and z along the view.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from twin.description import ArmDescription, StereoHeadDescription

FloatArray = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Hinge:
    """A joint and the link that it turns.

    Attributes:
        to_parent: From the link's frame to its parent's at joint angle zero.
        axis: (3,) unit vector of the hinge in the link's frame.
        limits: Lowest and highest angle [rad].
    """

    to_parent: RigidTransform
    axis: tuple[float, float, float]
    limits: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class CameraArm:
    """An arm that carries a stereo head.

    Attributes:
        transform_base_to_robot: From the arm's base to the robot frame.
        hinges: From the base to the wrist.
        transform_camera_to_wrist: From the left camera to the last link.
        body_points: For each link (k, 3) points in its frame [m] that with `body_radius` cover it
            and what is fixed to it.
        body_radius: [m].
    """

    transform_base_to_robot: RigidTransform
    hinges: tuple[Hinge, ...]
    transform_camera_to_wrist: RigidTransform
    body_points: tuple[FloatArray, ...]
    body_radius: float

    @classmethod
    def of(cls, arm: ArmDescription, head: StereoHeadDescription) -> CameraArm:
        """Return the arm of a robot as drawn, with its stereo head."""
        hinges = [Hinge(j.transform_link_to_parent, j.axis, j.limits) for j in arm.joints]
        return cls(
            arm.transform_base_to_robot,
            tuple(hinges),
            head.transform_camera_to_wrist,
            tuple(joint.cover_points for joint in arm.joints),
            arm.cover_radius,
        )

    @property
    def limits(self) -> FloatArray:
        """(joints, 2) lowest and highest angles [rad]."""
        return np.array([hinge.limits for hinge in self.hinges])

    def camera_in_robot(self, angles: ArrayLike) -> RigidTransform:
        """Return the transform from the left camera to the robot frame.

        Args:
            angles: (joints,) [rad] for one transform, or (N, joints) for N.

        Raises:
            ValueError: If the number of angles is wrong or one is not finite.
        """
        rotations, origins = self._links(angles)[-1]
        single = np.ndim(angles) == 1
        wrist = RigidTransform.from_components(
            origins[0] if single else origins,
            Rotation.from_matrix(rotations[0] if single else rotations),
        )
        return wrist * self.transform_camera_to_wrist

    def body_in_robot(self, angles: ArrayLike) -> FloatArray:
        """Return (N, K, 3) points that cover the arm [m], robot frame.

        Args:
            angles: (N, joints) [rad].

        Raises:
            ValueError: As `camera_in_robot`.
        """
        placed = [
            points @ np.swapaxes(rotations, 1, 2) + origins[:, None]
            for (rotations, origins), points in zip(
                self._links(angles), self.body_points, strict=True
            )
        ]
        return np.concatenate(placed, axis=1)

    def _links(self, angles: ArrayLike) -> list[tuple[FloatArray, FloatArray]]:
        """Return (N, 3, 3) rotations and (N, 3) origins of each link, robot frame.

        Thousands at once: rigid transforms as objects would take ten times as long.
        """
        turns = np.asarray(angles, dtype=float)
        if turns.shape[-1:] != (len(self.hinges),) or turns.ndim > 2:
            raise ValueError(f"arm angles of shape {turns.shape}: expected {len(self.hinges)}")
        if not np.all(np.isfinite(turns)):
            raise ValueError(f"arm angles are not finite: {turns}")
        turns = np.atleast_2d(turns)
        base = self.transform_base_to_robot
        rotations = np.broadcast_to(base.rotation.as_matrix(), (len(turns), 3, 3))
        origins = np.broadcast_to(base.translation, (len(turns), 3))
        links: list[tuple[FloatArray, FloatArray]] = []
        for column, hinge in enumerate(self.hinges):
            origins = origins + rotations @ hinge.to_parent.translation
            turn = Rotation.from_rotvec(turns[:, column, None] * np.array(hinge.axis))
            rotations = rotations @ hinge.to_parent.rotation.as_matrix() @ turn.as_matrix()
            links.append((rotations, origins))
        return links
