"""Skid steering: wheel speeds for a motion, and the motion that follows from wheel speeds.

Wheels fixed to the body scrub sideways when it turns, so it turns by a share of what
rolling wheels would make of their speeds. The share depends on load and ground: track and wheelbase
tell it roughly, a drive (`identify_turn_share`) well.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from perception.geometry.se3 import transport_covariance
from twin.description import RobotDescription
from twin.robot import ArmMode, Channel, Command, Observation, WheelMode

_SPEED, _TURN = 0.06, 0.25  # Speed and turn rate of the identification drive [m/s, rad/s].
_TURN_EVERY = 1.5  # Time from a curve to the left to one to the right [s].
_ASLANT = 0.01
"""Standard deviation of the pitch against the ground [rad]. Assumption: a rover at rest hangs by
half of that on its springs, and the inclinometer shows half of it of a roll of 10 degrees."""


@dataclasses.dataclass(frozen=True)
class SkidSteer:
    """Relation of wheel speeds and motion.

    Attributes:
        wheel_radius: [m].
        half_track: Distance of a wheel from the middle plane [m].
        turn_share: Turn rate over that of rolling wheels, (v_right - v_left) / track.
        turn_sigma: Standard deviation of `turn_share`.
        most: Largest speed of a wheel [rad/s].
        slide: How far it slides downhill while rolling wheels would turn it by a radian, over the
            slope [m/rad]: wheels that scrub hold on a slope with the friction that is left.
    """

    wheel_radius: float
    half_track: float
    turn_share: float = 1.0
    turn_sigma: float = 0.0
    most: float = 5.0
    slide: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers that drive nothing.

        Raises:
            ValueError: Naming the number and what is valid.
        """
        check_numbers("skid steering", self, "wheel_radius", "half_track", "turn_share", "most")
        check_numbers("skid steering", self, "turn_sigma", "slide", zero=True)

    @classmethod
    def of(
        cls, robot: RobotDescription, turn_share: float = 1.0, turn_sigma: float = 0.0
    ) -> "SkidSteer":
        """Return the wheels of a robot as drawn.

        Args:
            robot: The rover.
            turn_share: Share of rolling wheels' turn rate.
            turn_sigma: Standard deviation of that share.
        """
        return cls(robot.wheel_radius, robot.half_track, turn_share, turn_sigma)

    def wheel_speeds(self, forward: float, turn: float) -> FloatArray:
        """Return (4,) wheel speeds for a motion [rad/s], in the order of `WHEELS`.

        Speeds beyond the largest are all reduced alike, so that the curve is kept.

        Args:
            forward: Forward speed [m/s].
            turn: Turning rate to the left [rad/s].
        """
        half = turn * self.half_track / self.turn_share
        left, right = (forward - half) / self.wheel_radius, (forward + half) / self.wheel_radius
        speeds = np.array([left, right, left, right])
        return speeds * min(1.0, self.most / max(float(np.abs(speeds).max()), 1e-9))

    def motion(self, speeds: ArrayLike) -> tuple[float, float]:
        """Return forward speed [m/s] and turn rate [rad/s] by wheel speeds.

        Args:
            speeds: (4,) [rad/s], in the order of `WHEELS`.
        """
        front_left, front_right, rear_left, rear_right = np.asarray(speeds, dtype=float)
        left = self.wheel_radius * (front_left + rear_left) / 2.0
        right = self.wheel_radius * (front_right + rear_right) / 2.0
        turn = self.turn_share * (right - left) / (2.0 * self.half_track)
        return float(left + right) / 2.0, float(turn)

    def sliding(self, turn: float, tilt: ArrayLike) -> FloatArray:
        """Return the speed (2,) to the right and ahead at which it slides as it turns [m/s].

        Args:
            turn: Turning rate [rad/s].
            tilt: (2,) pitch and roll [rad].
        """
        rate = self.slide * abs(turn) / self.turn_share
        return rate * downhill(tilt)


class Odometry:
    """Dead reckoning: pose of a rover by its tachometers and inclinometer.

    The rover drives along its own forward axis and turns about its own up, as on a slope.

    Args:
        steer: Relation of wheel speeds and motion.
        place: Initial x, y [m].
        yaw: Initial yaw [rad].
        tilt_lag: Time constant that smooths the tilt [s].

    Attributes:
        place: (2,) x, y [m], in the frame of the start, or of the world if it began there.
        height: Height over the start [m].
        yaw: [rad]; forward is y at zero.
        distance: Distance driven, forward and back [m].
        climbed: Rise and fall of as long a drive straight up and down the slopes [m].
        turned: Angle turned, left and right [rad].
    """

    def __init__(
        self,
        steer: SkidSteer,
        place: tuple[float, float] = (0.0, 0.0),
        yaw: float = 0.0,
        tilt_lag: float = 0.3,
    ) -> None:
        self.place = np.array(place, dtype=float)
        self.height, self.yaw = 0.0, float(yaw)
        self.distance = self.climbed = self.turned = 0.0
        self._steer = steer
        self._slopes = np.zeros(3)  # Derivatives of place and yaw by the turn share.
        self._lag = tilt_lag
        self._tilt: FloatArray | None = None

    def update(self, observation: Observation, period: float) -> None:
        """Integrate a period [s]; what is missing, stale or not finite moves nothing."""
        if is_good(observation.inclinometer):
            tilt = np.asarray(observation.inclinometer.value, dtype=float)
            share = period / (period + self._lag)
            self._tilt = tilt if self._tilt is None else self._tilt + share * (tilt - self._tilt)
        if not is_good(observation.wheel_speeds):
            return
        forward, turn = self._steer.motion(observation.wheel_speeds.value)
        # The inclinometer senses specific force: gravity, and acceleration alike. At a constant
        # speed its low-passed value is the tilt, since the bumps of the ground average out; an
        # acceleration a adds a / g, 1.2 degrees at 0.2 m/s^2. Up to a speed v that adds v^2 / 2 g
        # to the height, 2 mm at 0.2 m/s, and braking takes it back, but for what the low pass
        # delays: 2 v a lag / g, not 3 mm for each start and stop.
        pitch, roll = self.tilt
        ahead, up = math.cos(pitch), math.sin(pitch)
        # R = Rz(yaw) Rx(pitch) Ry(roll) turns at (0, 0, turn) in its own axes.
        turn *= math.cos(roll) / ahead
        middle = self.yaw + 0.5 * turn * period
        aside, on = self._steer.sliding(turn, self.tilt)
        s, c = math.sin(middle), math.cos(middle)
        step = period * (forward * ahead + on) * np.array([-s, c])
        step += period * aside * np.array([c, s])
        turning = turn * period / self._steer.turn_share
        self._slopes[:2] += (self._slopes[2] + 0.5 * turning) * np.array([-step[1], step[0]])
        self._slopes[2] += turning
        self.place += step
        self.height += forward * up * period
        self.yaw += turn * period
        self.distance += abs(forward) * period
        self.climbed += abs(forward) * math.sqrt(1.0 - (ahead * math.cos(roll)) ** 2) * period
        self.turned += abs(turn) * period

    @property
    def tilt(self) -> FloatArray:
        """(2,) smoothed pitch and roll [rad]; zeros before the first sample."""
        return np.zeros(2) if self._tilt is None else self._tilt

    def slip(self) -> FloatArray:
        """Return (6,) twist in the frame of the start, by which the pose errs if the share does.

        It is that of one standard deviation: ``true = from_exp_coords(slip) * pose`` of a robot
        that keeps so much more of its turns. The height is that of the measured pitch all the same.
        """
        x, y = self.place
        aside, ahead, turn = self._steer.turn_sigma * self._slopes
        return np.array([0.0, 0.0, turn, aside + turn * y, ahead - turn * x, 0.0])

    def transform_level_to_start(self) -> RigidTransform:
        """Return the transform from the level frame of the robot to the frame of the start."""
        x, y = self.place
        heading = Rotation.from_euler("z", self.yaw)
        return RigidTransform.from_components([x, y, self.height], heading)

    def covariance(self) -> FloatArray:
        """Return the covariance (6, 6) of the pose, as a twist in the level frame of the robot.

        Assumptions, for rocks: 2 cm and 5 % of the distance, 0.03 rad and 5 % of the turns, 0.02
        rad of tilt and 1 cm of height. A rover that slips by 5 % of the distance does so along the
        slope, up or down by 5 % of what that climbs; and where the body is not parallel to the
        ground, it drives in another direction than its own. What an error of the turn share brings
        is added (`slip`).
        """
        place, turn, slip = 0.02 + 0.05 * self.distance, 0.03 + 0.05 * self.turned, self.slip()
        height = math.hypot(0.01, 0.05 * self.climbed, _ASLANT * self.distance)
        own = np.diag(np.square([0.02, 0.02, turn, place, place, height]))
        level = self.transform_level_to_start().inv()
        return own + transport_covariance(level, np.outer(slip, slip))

    def pose(self) -> FloatArray:
        """Return (4, 4) from the robot to the frame of the start."""
        pitch, roll = self.tilt
        (cy, sy), (cp, sp), (cr, sr) = (
            (math.cos(angle), math.sin(angle)) for angle in (self.yaw, pitch, roll)
        )
        # R = Rz(yaw) Rx(pitch) Ry(roll)
        return np.array(
            [
                [cy * cr - sy * sp * sr, -sy * cp, cy * sr + sy * sp * cr, self.place[0]],
                [sy * cr + cy * sp * sr, cy * cp, sy * sr - cy * sp * cr, self.place[1]],
                [-cp * sr, sp, cp * cr, self.height],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


def downhill(tilt: ArrayLike) -> FloatArray:
    """Return the direction (2,) downhill of a tilted rover, to its right and ahead.

    Args:
        tilt: (2,) pitch and roll [rad].

    Returns:
        As long as the slope.
    """
    pitch, roll = np.asarray(tilt, dtype=float)
    return np.array([math.tan(roll) / math.cos(pitch), -math.tan(pitch)])


def is_good(channel: Channel) -> bool:
    """Return whether a channel is usable and its numbers are finite."""
    return channel.usable and bool(np.isfinite(channel.value).all())


class TurnShareDrive:
    """Drives curves to the left and right on flat ground; a `twin.robot.Controller`.

    Args:
        robot: Name of the rover, which has a heading sensor.
        steer: Wheels of the rover.
        period: Servo tick [s].
    """

    def __init__(self, robot: str, steer: SkidSteer, period: float) -> None:
        self._robot, self._steer, self._period = robot, steer, period
        self.reset()

    def reset(self) -> None:
        """Forget all measurements."""
        self._speeds: list[FloatArray] = []
        self._headings: list[float] = []
        self._held: FloatArray | None = None

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Take wheel speeds and heading, and drive on with the arm held."""
        seen = observations[self._robot]
        if self._held is None:
            self._held = np.array(seen.arm_angles.value, dtype=float)
        left = math.floor(len(self._headings) * self._period / _TURN_EVERY) % 2 == 0
        self._speeds.append(np.asarray(seen.wheel_speeds.value, dtype=float))
        self._headings.append(float(seen.heading.value[0]))
        wheels = self._steer.wheel_speeds(_SPEED, _TURN if left else -_TURN)
        return {self._robot: Command(wheels, self._held, WheelMode.SPEED, ArmMode.POSITION)}

    def finish(self) -> float:
        """Return `identify_turn_share` of the drive."""
        return identify_turn_share(self._steer, self._speeds, self._headings, self._period)


def identify_turn_share(
    steer: SkidSteer, speeds: ArrayLike, headings: ArrayLike, period: float
) -> float:
    """Return the share of rolling wheels' turn that a drive kept.

    Args:
        steer: The wheels; its own share plays no part.
        speeds: (N, 4) wheel speeds [rad/s].
        headings: (N,) measured yaw [rad].
        period: Sampling period [s].

    Returns:
        The share, by least squares of heading against rolled turn.

    Raises:
        ValueError: If the lengths differ or the drive hardly turned.
    """
    rolling = dataclasses.replace(steer, turn_share=1.0)
    rates = np.array([rolling.motion(row)[1] for row in np.asarray(speeds, dtype=float)])
    yaw = np.unwrap(np.asarray(headings, dtype=float))
    if yaw.shape != rates.shape:
        raise ValueError(f"headings {yaw.shape} and speeds {rates.shape}: expected as many")
    rolled = np.cumsum(rates) * period
    basis = np.column_stack([rolled, np.ones(len(rolled))])
    if np.ptp(rolled) < math.radians(5.0):
        raise ValueError("the drive turned by less than 5 degrees: expected a larger turn")
    return float(np.linalg.lstsq(basis, yaw, rcond=None)[0][0])
