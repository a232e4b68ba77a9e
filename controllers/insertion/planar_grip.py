"""A gripper in the plane of its arm: its pose, and its wrench on the grasped object.

The plan frame is shared by all robots that work in one vertical plane: s along it, z up, angles
about its normal from s to z. A robot faces along s or against it. Poses are (s, z, angle) [m, m,
rad], wrenches (f_s, f_z, m) [N, N, N m].

A robot has no sensor in its hand. The gripper's wrench on the object is the measured wrench under
the arm less the arm's own weight (surrogate sensing, Thesis figure A-8).
"""

import dataclasses
import math

import numpy as np
from numpy.typing import ArrayLike

from controllers.kinematics.serial_chain import SerialChain
from controllers.motion.base_motion import level_of
from perception.geometry.arrays import FloatArray
from twin.robot import Observation


@dataclasses.dataclass(frozen=True)
class PlanarArm:
    """Shoulder, elbow and wrist, their axes across the plane; the yaw is held.

    Attributes:
        shoulder: (2,) position forward and up in the robot frame [m].
        lengths: (3,) shoulder to elbow, elbow to wrist, wrist to grip point [m].
    """

    shoulder: tuple[float, float]
    lengths: tuple[float, float, float]

    def task(self, bends: ArrayLike) -> FloatArray:
        """Return (3,) the grip's position forward and up [m] and its pitch [rad].

        Args:
            bends: (3,) angles of the joints [rad].
        """
        pitches = np.cumsum(np.asarray(bends, dtype=float))
        lengths = np.array(self.lengths)
        forward = self.shoulder[0] + lengths @ np.cos(pitches)
        return np.array([forward, self.shoulder[1] + lengths @ np.sin(pitches), pitches[2]])

    def jacobian(self, bends: ArrayLike) -> FloatArray:
        """Return (3, 3): change of `task` per angle of a joint.

        Args:
            bends: (3,) angles of the joints [rad].
        """
        pitches = np.cumsum(np.asarray(bends, dtype=float))
        lengths = np.array(self.lengths)
        # A joint moves its own link and all beyond.
        forward = -np.cumsum((lengths * np.sin(pitches))[::-1])[::-1]
        up = np.cumsum((lengths * np.cos(pitches))[::-1])[::-1]
        return np.array([forward, up, np.ones(3)])


@dataclasses.dataclass(frozen=True)
class Stance:
    """Estimate of a robot's pose in the plan frame.

    Attributes:
        place: (2,) origin of the robot frame [m].
        facing: 1 if the robot faces along s, -1 if against.
        tilt: Pitch of the robot, nose up [rad].
    """

    place: tuple[float, float]
    facing: int
    tilt: float = 0.0

    def __post_init__(self) -> None:
        """Refuse an invalid stance.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        if self.facing not in (1, -1):
            raise ValueError(f"facing {self.facing}: needs 1, along the plan, or -1, against it")
        if len(self.place) != 2 or not all(map(math.isfinite, (*self.place, self.tilt))):
            raise ValueError(f"stance {self.place}, {self.tilt} rad: expected finite numbers")

    def to_plan(self, task: ArrayLike) -> FloatArray:
        """Return a pose of the robot's plane in the plan frame.

        Args:
            task: (3,) forward, up [m] and pitch [rad].
        """
        forward, up, pitch = np.asarray(task, dtype=float)
        s, z = self.turned((forward, up))
        return np.array([self.place[0] + s, self.place[1] + z, self.facing * (pitch + self.tilt)])

    def to_robot(self, pose: ArrayLike) -> FloatArray:
        """Return a pose of the plan frame in the robot's plane; undoes `to_plan`.

        Args:
            pose: (3,) pose in the plan frame [m, m, rad].
        """
        s, z, angle = np.asarray(pose, dtype=float)
        forward, up = self._turned_back(s - self.place[0], z - self.place[1])
        return np.array([forward, up, self.facing * angle - self.tilt])

    def rate_to_robot(self, rate: ArrayLike) -> FloatArray:
        """Return a rate of the plan frame in the robot's plane.

        Args:
            rate: (3,) rate in the plan frame [m/s, m/s, rad/s].
        """
        s, z, turning = np.asarray(rate, dtype=float)
        return np.array([*self._turned_back(s, z), self.facing * turning])

    def _turned_back(self, s: float, z: float) -> tuple[float, float]:
        """Return a vector along s and z in the robot frame, forward and up; undoes `turned`."""
        c, n, ahead = math.cos(self.tilt), math.sin(self.tilt), self.facing * s
        return c * ahead + n * z, c * z - n * ahead

    def turned(self, vector: ArrayLike) -> FloatArray:
        """Return a vector (forward, up) of the robot frame along s and z.

        Args:
            vector: (2,) forward and up, robot frame.
        """
        forward, up = np.asarray(vector, dtype=float)
        c, n = math.cos(self.tilt), math.sin(self.tilt)
        return np.array([self.facing * (c * forward - n * up), n * forward + c * up])


@dataclasses.dataclass(frozen=True)
class GripSensor:
    """Wrench of the gripper on the grasped object, from the sensor under the arm.

    Attributes:
        chain: Chain of the arm, with the mass between the sensor and the first joint.
        arm: Plane model of the arm, in the robot frame.
        mount: (2,) position of the sensor's frame forward and up in the robot frame [m].
    """

    chain: SerialChain
    arm: PlanarArm
    mount: tuple[float, float]

    def felt(self, seen: Observation, stance: Stance) -> FloatArray | None:
        """Return (3,) the wrench of the gripper on the grasped object, about the grip point.

        Slow motion is assumed: inertial forces of the arm are not subtracted.

        Args:
            seen: Observation of the robot.
            stance: Facing and tilt of the robot, which turn the wrench into the plan frame.

        Returns:
            Wrench in the plan frame; None if the wrench or the joint angles are missing or stale.
        """
        if not (seen.arm_base_wrench.usable and seen.arm_angles.usable):
            return None
        angles = np.asarray(seen.arm_angles.value, dtype=float)
        level, still = level_of(seen), np.zeros(len(self.chain))
        own = self.chain.inverse_dynamics(angles, still, still, level)[1]
        pushed = np.asarray(seen.arm_base_wrench.value, dtype=float) - own
        forward, up = self.arm.task(angles[1:])[:2] - self.mount
        moment = pushed[3] - (forward * pushed[2] - up * pushed[1])
        return np.array([*stance.turned(pushed[1:3]), stance.facing * moment])
