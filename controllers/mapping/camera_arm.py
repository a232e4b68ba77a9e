"""Kinematics of a stereo head on an arm: from joint angles to where the camera is.

Frames: the robot frame stands at the rover's start with x to the right, y forward and z up; the
camera frame is that of the left camera, x to the right, y down and z along the view.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

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

    @property
    def limits(self) -> FloatArray:
        """(joints, 2) lowest and highest angles [rad]."""
        return np.array([hinge.limits for hinge in self.hinges])

    def links_in_robot(self, angles: ArrayLike) -> list[RigidTransform]:
        """Return the transforms from each link to the robot frame.

        Args:
            angles: (N, joints) or (joints,) [rad].

        Raises:
            ValueError: If the number of angles is wrong or one is not finite.
        """
        angles = np.asarray(angles, dtype=float)
        if angles.shape[-1:] != (len(self.hinges),) or angles.ndim > 2:
            raise ValueError(f"arm angles of shape {angles.shape}: expected {len(self.hinges)}")
        if not np.all(np.isfinite(angles)):
            raise ValueError(f"arm angles are not finite: {angles}")
        links: list[RigidTransform] = []
        here = self.transform_base_to_robot
        for column, hinge in enumerate(self.hinges):
            turn = Rotation.from_rotvec(angles[..., column, None] * np.array(hinge.axis))
            here = here * hinge.to_parent * RigidTransform.from_rotation(turn)
            links.append(here)
        return links

    def camera_in_robot(self, angles: ArrayLike) -> RigidTransform:
        """Return the transform from the left camera to the robot frame, for (N, joints) angles N.

        Raises:
            ValueError: As `links_in_robot`.
        """
        return self.links_in_robot(angles)[-1] * self.transform_camera_to_wrist

    def body_in_robot(self, angles: ArrayLike) -> FloatArray:
        """Return (N, K, 3) points that cover the arm [m], robot frame.

        Args:
            angles: (N, joints) [rad].

        Raises:
            ValueError: As `links_in_robot`.
        """
        links = self.links_in_robot(np.atleast_2d(np.asarray(angles, dtype=float)))
        placed: list[FloatArray] = []
        for link, points in zip(links, self.body_points, strict=True):
            rotations = np.atleast_3d(link.rotation.as_matrix()).reshape(-1, 3, 3)
            origins = link.translation.reshape(-1, 1, 3)
            placed.append(np.einsum("nij,kj->nki", rotations, points) + origins)
        return np.concatenate(placed, axis=1)
