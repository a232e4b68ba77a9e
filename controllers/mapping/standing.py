"""Where a robot stands, from a target that it has seen, and where that puts its camera.

The world is level: its origin is the target's, z is up, and x lies in the vertical plane of the
target's x. The robot that finds the target first says how it leans; from then on all robots that
see it share one frame (Thesis section 3.2.2). While the arm moves the rover leans on its springs;
the inclinometer tells how far, and what it leaves open goes into the camera's covariance.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.se3 import adjoint, transport_covariance
from perception.registration.fiducial_map import PosePrior

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


SHARED = 12
"""Parameters of what a robot's looks err by alike: its place, and how its head sits."""


@dataclasses.dataclass(frozen=True)
class StandingConfig:
    """How well the arm and the inclinometer tell where the camera is.

    Attributes:
        tilt: Deviation of the base's lean, of each axis [rad]: the inclinometer's noise.
        yaw: Deviation of its turn on the springs [rad].
        place: Deviation of its place on the springs, of each axis [m].
        mount_turn: Deviation of the head's turn from how it should sit, about each axis [rad].
        mount_place: The same of its place [m].
    """

    tilt: float = 0.001
    yaw: float = 0.001
    place: float = 0.001
    mount_turn: float = 0.004
    mount_place: float = 0.001

    def base_covariance(self) -> FloatArray:
        """Return (6, 6) of xi = (rotation vector, translation), in the robot frame."""
        return np.diag(np.square([self.tilt, self.tilt, self.yaw] + 3 * [self.place]))

    def mount_covariance(self) -> FloatArray:
        """Return (6, 6) of xi, in the camera frame."""
        return np.diag(np.square(3 * [self.mount_turn] + 3 * [self.mount_place]))


@dataclasses.dataclass(frozen=True)
class CameraPose:
    """An uncertain camera.

    Attributes:
        transform_camera_to_world: Of the left camera.
        covariance: (6, 6) of xi in ``true = from_exp_coords(xi) * estimate``, in the world.
    """

    transform_camera_to_world: RigidTransform
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class Standing:
    """A robot that knows its place.

    Attributes:
        arm: Its kinematics.
        transform_level_to_world: From the robot frame, brought level, to the world.
        covariance: (6, 6) of it, in the world, but for how the head sits.
        transform_sighting_to_world: From the camera to the world when the target was seen. How the
            head sits was the same then, so there it does no harm.
        config: How well the rest is known.
    """

    arm: SerialChain
    transform_level_to_world: RigidTransform
    covariance: FloatArray
    transform_sighting_to_world: RigidTransform
    config: StandingConfig = StandingConfig()

    def camera(self, angles: FloatArray, tilt: FloatArray) -> CameraPose:
        """Return where the camera is.

        Args:
            angles: (joints,) of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
        """
        prior = self.prior(angles, tilt, np.arange(SHARED))
        shared = prior.by_offsets @ self.shared_covariance() @ prior.by_offsets.T
        return CameraPose(prior.transform_camera_to_world, shared + prior.covariance)

    def shared_covariance(self) -> FloatArray:
        """Return (12, 12) of what all looks err by alike.

        These are xi of the robot's place, in the world, and xi of the head's seat, in the camera
        frame.
        """
        spread = np.zeros((SHARED, SHARED))
        spread[:6, :6], spread[6:, 6:] = self.covariance, self.config.mount_covariance()
        return spread

    def prior(self, angles: FloatArray, tilt: FloatArray, offsets: IndexArray) -> PosePrior:
        """Return where the camera is, with its error's shared part kept apart.

        Args:
            angles: (joints,) of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
            offsets: (12,) numbers of the offsets whose covariance is `shared_covariance`.
        """
        pose = self.transform_level_to_world * camera_in_level(self.arm, angles, tilt)
        mount = adjoint(pose) - adjoint(self.transform_sighting_to_world)
        own = transport_covariance(self.transform_level_to_world, self.config.base_covariance())
        return PosePrior(pose, own, offsets, np.hstack([np.eye(6), mount]))


def lean(tilt: FloatArray) -> RigidTransform:
    """Return the transform from a leaning robot frame to the level one; (2,) pitch, roll [rad]."""
    return RigidTransform.from_rotation(Rotation.from_euler("XY", tilt))


def camera_in_level(arm: SerialChain, angles: FloatArray, tilt: FloatArray) -> RigidTransform:
    """Return the transform from the left camera to the level robot frame."""
    return lean(tilt) * arm.tool_in_robot(angles)


def level_target(transform_target_to_level: RigidTransform) -> RigidTransform:
    """Return the transform from a target to the world that it defines.

    Args:
        transform_target_to_level: As the first robot that saw it found it.

    Raises:
        ValueError: If the target's x axis is upright, so that it names no direction.
    """
    rotation = transform_target_to_level.rotation.as_matrix()
    across = rotation[:2, 0]
    if np.linalg.norm(across) < 0.1:  # noqa: PLR2004
        raise ValueError("the target's x axis is upright: it names no direction on the ground")
    turn = Rotation.from_euler("z", -np.arctan2(across[1], across[0]))
    return RigidTransform.from_rotation(turn * transform_target_to_level.rotation)


def stand(
    arm: SerialChain,
    angles: FloatArray,
    tilt: FloatArray,
    camera: CameraPose,
    config: StandingConfig | None = None,
) -> Standing:
    """Return where a robot stands whose camera is known.

    Args:
        arm: Its kinematics.
        angles: (joints,) of the arm [rad].
        tilt: (2,) pitch and roll of the robot [rad].
        camera: Where its camera is.
        config: How well the arm and the inclinometer tell.
    """
    how = config or StandingConfig()
    pose = camera.transform_camera_to_world
    level = pose * camera_in_level(arm, angles, tilt).inv()
    spread = camera.covariance + transport_covariance(level, how.base_covariance())
    return Standing(arm, level, spread, pose, how)
