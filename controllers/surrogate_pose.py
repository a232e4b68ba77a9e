"""Where a body on an arm is while its markers are hidden: dead reckoning from the last sighting.

The body is fixed to the arm's last link: the card in the slave's hand, or the camera on the
master's arm. Encoders, the base's tilt and the wheels carry its pose on, and its covariance grows.
What stands still in the target frame, as the slot, needs no more than where the camera has gone.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from perception.registration_uncertainty import adjoint
from twin.robot import Observation

FloatArray = NDArray[np.float64]
_STEP = 1e-5  # Of an angle, for the pose's change by it [rad].
_SAME_POSE = 0.05  # Joint angles within which slopes are taken as the same [rad].
_AT_REST = 0.05  # Tachometers of wheels at rest read as much [rad/s].


class PosePrediction(NamedTuple):
    """An uncertain pose.

    Attributes:
        transform_body_to_target: Of the body.
        covariance: (6, 6) of xi in ``true = from_exp_coords(xi) * estimate``, target frame.
    """

    transform_body_to_target: RigidTransform
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class DeadReckoningConfig:
    """How a body moves with its robot, and how well that is known.

    Attributes:
        tip_in_robot: Angles (4,) of the arm to the transform from its tip to the robot frame, such
            as `ArmModel.gripper_in_robot` or `CameraArm.camera_in_robot`.
        transform_body_to_tip: How the body sits in the hand.
        wheel_radius: [m].
        track: Distance of the wheels that turns the robot as the wheels do, slip included [m].
        encoder: Standard deviation of a joint's angle, from one sighting to now [rad].
        tilt: The same of the base's pitch and roll [rad].
        place: The same of the base's place on its springs [m], and of its yaw over 1 m [rad].
        drive: How fast the place becomes unsure by driving [m/sqrt(m)].
        turn: How fast the heading does [rad/sqrt(m)].
        creep: How fast the body slips in the hand [m/sqrt(s)].
    """

    tip_in_robot: Callable[[ArrayLike], RigidTransform]
    transform_body_to_tip: RigidTransform = dataclasses.field(
        default_factory=RigidTransform.identity
    )
    wheel_radius: float = 0.08
    track: float = 0.4
    encoder: float = 5e-4
    tilt: float = 0.001
    place: float = 5e-4
    drive: float = 0.02
    turn: float = 0.05
    creep: float = 1e-4

    def __post_init__(self) -> None:
        """Refuse numbers that could not be meant.

        Raises:
            ValueError: Naming the number.
        """
        for name in ("encoder", "tilt", "place", "drive", "turn", "creep"):
            if not 0.0 <= getattr(self, name) < math.inf:
                value = getattr(self, name)
                raise ValueError(f"dead reckoning {name}: got {value}, needs a number >= 0")
        for name in ("wheel_radius", "track"):
            if not 0.0 < getattr(self, name) < math.inf:
                value = getattr(self, name)
                raise ValueError(f"dead reckoning {name}: got {value}, needs a number above 0")


class DeadReckoning:
    """Carries the pose of a body on an arm on, from its last sighting."""

    def __init__(self, config: DeadReckoningConfig) -> None:
        """Prepare.

        Args:
            config: Kinematics and uncertainties.
        """
        self.config = config
        self.reset()

    def reset(self) -> None:
        """Forget the last sighting."""
        self._level: RigidTransform | None = None
        self._spread = np.zeros((6, 6))
        self._slopes: tuple[FloatArray, FloatArray] | None = None

    @property
    def begun(self) -> bool:
        """Whether the body was ever seen."""
        return self._level is not None

    def correct(
        self,
        seen: PosePrediction,
        observation: Observation,
        tilt_covariance: ArrayLike | None = None,
    ) -> None:
        """Take a sighting.

        Args:
            seen: The body's pose as the camera found it.
            observation: Of the robot that carries it, at the same time: arm angles, tilt.
            tilt_covariance: (2, 2) of pitch and roll if they were predicted; None as configured.
        """
        ride, own = self._ride(observation, tilt_covariance)
        self._level = seen.transform_body_to_target * ride.inv()
        carried = adjoint(self._level)
        self._spread = np.asarray(seen.covariance) + carried @ own @ carried.T

    def predict(
        self, observation: Observation, dt: float, tilt_covariance: ArrayLike | None = None
    ) -> PosePrediction:
        """Return where the body is.

        Args:
            observation: Of the robot that carries it: arm angles, tilt and wheel speeds.
            dt: Since the call before [s].
            tilt_covariance: As of `correct`.

        Raises:
            ValueError: If a channel is missing or not finite, the body was never seen, or dt is not
                positive.
        """
        if self._level is None:
            raise ValueError("dead reckoning: the body was never seen; call correct() first")
        if not dt > 0.0:
            raise ValueError(f"dead reckoning dt: got {dt}, needs a positive time [s]")
        self._level = self._drive(self._level, observation, dt)
        ride, own = self._ride(observation, tilt_covariance)
        carried = adjoint(self._level)
        return PosePrediction(self._level * ride, self._spread + carried @ own @ carried.T)

    def _drive(self, level: RigidTransform, observation: Observation, dt: float) -> RigidTransform:
        """Return the level robot frame after the wheels' motion, and let the spread grow."""
        config = self.config
        speeds = _read(observation, "wheel_speeds", 4)
        left, right = (config.wheel_radius * float(np.mean(speeds[i::2])) * dt for i in (0, 1))
        growth = np.zeros(6)
        if float(np.median(np.abs(speeds))) > _AT_REST:
            ahead, turned = 0.5 * (left + right), (right - left) / config.track
            way = 0.5 * (abs(left) + abs(right))
            # Along the chord of the arc.
            half = 0.5 * turned
            place = [-ahead * math.sin(half), ahead * math.cos(half), 0.0]
            step = RigidTransform.from_components(place, Rotation.from_rotvec([0, 0, turned]))
            level = level * step
            growth[2], growth[3:5] = config.turn**2 * way, config.drive**2 * way
        growth[3:] += config.creep**2 * dt
        carried = adjoint(level)
        self._spread = self._spread + carried @ np.diag(growth) @ carried.T
        return level

    def _ride(
        self, observation: Observation, tilt_covariance: ArrayLike | None
    ) -> tuple[RigidTransform, FloatArray]:
        """Return the transform from the body to the level robot frame, and its covariance."""
        config = self.config
        angles, tilt = _read(observation, "arm_angles", 4), _read(observation, "inclinometer", 2)
        lean = RigidTransform.from_rotation(Rotation.from_euler("XY", tilt))
        ride = lean * config.tip_in_robot(angles) * config.transform_body_to_tip
        own = np.zeros((6, 6))
        own[:2, :2] = config.tilt**2 * np.eye(2) if tilt_covariance is None else tilt_covariance
        own[2, 2] = config.place**2
        own[3:, 3:] = config.place**2 * np.eye(3)
        slopes = adjoint(lean) @ self._by_joints(angles)
        return ride, own + config.encoder**2 * slopes @ slopes.T

    def _by_joints(self, angles: FloatArray) -> FloatArray:
        """Return (6, 4) xi of the tip in the robot frame by the joints' angles."""
        if self._slopes is not None and np.max(np.abs(self._slopes[0] - angles)) < _SAME_POSE:
            return self._slopes[1]
        moved = [self.config.tip_in_robot(angles + step) for step in _STEP * np.eye(len(angles))]
        back = self.config.tip_in_robot(angles).inv()
        slopes = np.column_stack([(tip * back).as_exp_coords() for tip in moved]) / _STEP
        self._slopes = angles, slopes
        return slopes


def _read(observation: Observation, name: str, count: int) -> FloatArray:
    channel = getattr(observation, name)
    value = np.asarray(channel.value, dtype=float)
    if not channel.usable or value.shape != (count,) or not np.all(np.isfinite(value)):
        state = channel.validity.value
        raise ValueError(f"dead reckoning: {name} is {state} or not finite; needs {count} numbers")
    return value
