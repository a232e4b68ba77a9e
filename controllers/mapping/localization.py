"""Localization of a robot by a detected target, and the resulting pose of its camera.

The world is level: its origin is the target's, z is up, and x lies in the vertical plane of the
target's x. The robot that detects the target first defines this frame by its own tilt; from then on
all robots that detect the target share it (Thesis section 3.2.2). While the arm moves, the rover
tilts on its springs; the inclinometer measures the tilt, and its error enters the camera's
covariance.
"""

import dataclasses

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from perception.geometry.arrays import FloatArray, IndexArray
from perception.geometry.se3 import adjoint, transport_covariance
from perception.registration.fiducial_map import PosePrior


@dataclasses.dataclass(frozen=True)
class LocalizationConfig:
    """Standard deviations of the camera pose by arm and inclinometer.

    Attributes:
        tilt: Deviation of the measured tilt about each axis [rad]: the inclinometer's noise.
        tilt_zero: Deviation of what is the same in all measurements [rad]: its zero, and shares.
        yaw: Deviation of the base's yaw on its springs [rad].
        place: Deviation of the base's position on its springs along each axis [m].
    """

    tilt: float = 0.001
    tilt_zero: float = 0.0
    yaw: float = 0.001
    place: float = 0.001

    def base_covariance(self) -> FloatArray:
        """Return the covariance (6, 6) of xi = (rotation, translation) of the base, robot frame."""
        return np.diag(np.square([self.tilt, self.tilt, self.yaw] + 3 * [self.place]))


@dataclasses.dataclass(frozen=True)
class CameraPose:
    """Pose of the left camera with its covariance.

    Attributes:
        transform_camera_to_world: Transform from the left camera to the world.
        covariance: (6, 6) covariance of xi in ``true = from_exp_coords(xi) * estimate``, in the
            world.
    """

    transform_camera_to_world: RigidTransform
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class RobotLocalization:
    """Localization estimate of a robot.

    Attributes:
        arm: Chain of the arm, with the left camera as its tool.
        transform_level_to_world: Transform from the robot frame, brought level, to the world.
        covariance: (6, 6) covariance of xi of that transform, in the world, without the lasting
            errors of arm and head (`SerialChain.error_covariance`).
        by_arm: (6, 6 + joints) xi of the camera, in the world, by these errors at the detection of
            the target; there they cancel.
        config: Standard deviations of arm and inclinometer.
    """

    arm: SerialChain
    transform_level_to_world: RigidTransform
    covariance: FloatArray
    by_arm: FloatArray
    config: LocalizationConfig = LocalizationConfig()

    def camera(self, angles: FloatArray, tilt: FloatArray) -> CameraPose:
        """Return the camera's pose.

        Args:
            angles: (joints,) joint angles of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
        """
        shared = self.shared_covariance()
        prior = self.prior(angles, tilt, np.arange(len(shared)))
        own = prior.by_offsets @ shared @ prior.by_offsets.T
        return CameraPose(prior.transform_camera_to_world, own + prior.covariance)

    def shared_covariance(self) -> FloatArray:
        """Return the covariance (12 + joints, 12 + joints) of the errors common to all views.

        They are the twist of the robot's pose, world, and the lasting errors of arm and head.
        """
        return np.asarray(block_diag(self.covariance, self.arm.error_covariance()))

    def robot_covariance(self) -> FloatArray:
        """Return the covariance (6, 6) of the level frame with the errors of arm and head."""
        return self.covariance + self.by_arm @ self.arm.error_covariance() @ self.by_arm.T

    def prior(self, angles: FloatArray, tilt: FloatArray, offsets: IndexArray) -> PosePrior:
        """Return the camera's pose with the common part of its error as separate offsets.

        Args:
            angles: (joints,) joint angles of the arm [rad].
            tilt: (2,) pitch and roll of the robot [rad].
            offsets: (12 + joints,) indices of the offsets whose covariance is `shared_covariance`.
        """
        level = self.transform_level_to_world
        pose = level * camera_in_level(self.arm, angles, tilt)
        left = arm_errors(self.arm, angles, tilt, level) - self.by_arm
        own = transport_covariance(level, self.config.base_covariance())
        return PosePrior(pose, own, offsets, np.hstack([np.eye(6), left]))


def tilt_to_level(tilt: FloatArray) -> RigidTransform:
    """Return the transform from a frame tilted by pitch and roll (2,) [rad] to a level one."""
    return RigidTransform.from_rotation(Rotation.from_euler("XY", tilt))


def camera_in_level(arm: SerialChain, angles: FloatArray, tilt: FloatArray) -> RigidTransform:
    """Return the transform from the left camera to the level robot frame."""
    return tilt_to_level(tilt) * arm.tool_in_robot(angles)


def arm_errors(
    arm: SerialChain,
    angles: FloatArray,
    tilt: FloatArray,
    transform_level_to_world: RigidTransform,
) -> FloatArray:
    """Return (6, 6 + joints): xi of the left camera, world, by the errors of arm and head.

    Args:
        arm: Chain of the arm, with the left camera as its tool.
        angles: (joints,) joint angles of the arm [rad].
        tilt: (2,) pitch and roll of the robot [rad].
        transform_level_to_world: Transform from the robot frame, brought level, to the world.
    """
    upright = transform_level_to_world * tilt_to_level(tilt)
    return adjoint(upright) @ arm.error_jacobian(angles)


def level_target(transform_target_to_level: RigidTransform) -> RigidTransform:
    """Return the transform from a target to the world that it defines.

    Args:
        transform_target_to_level: Transform from the target to the level frame of the first robot
            that detected it.

    Raises:
        ValueError: If the target's x axis is upright, so that it has no direction on the ground.
    """
    rotation = transform_target_to_level.rotation.as_matrix()
    across = rotation[:2, 0]
    if np.linalg.norm(across) < 0.1:  # noqa: PLR2004
        raise ValueError("the target's x axis is upright: it names no direction on the ground")
    turn = Rotation.from_euler("z", -np.arctan2(across[1], across[0]))
    return RigidTransform.from_rotation(turn * transform_target_to_level.rotation)


def localize(
    arm: SerialChain,
    angles: FloatArray,
    tilt: FloatArray,
    camera: CameraPose,
    config: LocalizationConfig | None = None,
) -> RobotLocalization:
    """Return the localization of a robot from its camera's pose.

    Args:
        arm: Chain of the arm, with the left camera as its tool.
        angles: (joints,) joint angles of the arm [rad].
        tilt: (2,) pitch and roll of the robot [rad].
        camera: Pose of the left camera.
        config: Standard deviations of arm and inclinometer; None for the default.
    """
    how = config or LocalizationConfig()
    pose = camera.transform_camera_to_world
    level = pose * camera_in_level(arm, angles, tilt).inv()
    base = how.base_covariance() + np.diag([how.tilt_zero**2] * 2 + [0.0] * 4)
    covariance = camera.covariance + transport_covariance(level, base)
    by_arm = arm_errors(arm, angles, tilt, level)
    return RobotLocalization(arm, level, covariance, by_arm, how)
