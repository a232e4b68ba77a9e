"""A rover that drives, dead-reckons, and exchanges pose and wrench with another by radio."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from controllers.mapping.messages import PoseMessage, WrenchMessage, unpack
from controllers.motion.driving import Odometry, SkidSteer
from perception.geometry.arrays import FloatArray
from twin.link import Link
from twin.robot import ArmMode, Command, Observation, WheelMode


@dataclasses.dataclass(frozen=True)
class SharingConfig:
    """Configuration of one rover's motion and messages.

    Attributes:
        robot: Name of the robot.
        number: Number of the robot in its messages.
        steer: Kinematics of the rover's wheels.
        position: Initial position x, y [m], world.
        yaw: Initial heading [rad], world.
        wheel_speeds: Speeds of the left and the right wheels [rad/s].
        send_period: Time between two messages [s].
        swing: Amplitude of the shoulder's angle, so that the wrench changes [rad].
        swing_rate: Angular frequency of the shoulder [rad/s].
        drift: Standard deviation of dead reckoning, as a share of the distance driven.
    """

    robot: str
    number: int
    steer: SkidSteer
    position: tuple[float, float]
    yaw: float
    wheel_speeds: tuple[float, float]
    send_period: float = 0.25
    swing: float = 0.2
    swing_rate: float = 2.0
    drift: float = 0.1


@dataclasses.dataclass
class SharingLog:
    """Messages that one rover sent, and that it received from the other.

    Attributes:
        sent: (time, x, y) of each pose sent [s, m].
        received: (time of arrival, time of the pose, x, y) of each pose received [s, m].
        forces: (time of arrival, time of the force, vertical force) of each wrench received [s, N].
        measured: (time, vertical force) of each wrench sent [s, N].
        age: Age of the newest pose received at every tick [s]; NaN before the first.
    """

    sent: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    received: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    forces: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    measured: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    age: list[float] = dataclasses.field(default_factory=list)


class PoseSharing:
    """Drives one rover in an arc and shares its pose and wrench by radio.

    Attributes:
        log: Messages sent and received.

    Args:
        config: Motion and messages.
        link: Radio link of the rover.
    """

    def __init__(self, config: SharingConfig, link: Link) -> None:
        self._config, self._link = config, link
        self.reset()

    def reset(self) -> None:
        """Start again from the initial pose."""
        config = self._config
        self.log = SharingLog()
        self._odometry = Odometry(config.steer, config.position, config.yaw)
        self._arm: FloatArray | None = None
        self._next_send, self._newest = 0.0, math.nan
        self._before: float | None = None

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Update the odometry, send what is due, receive, and drive on."""
        seen = observations[self._config.robot]
        if self._before is not None:
            self._odometry.update(seen, seen.time - self._before)
        self._before = seen.time
        if seen.time >= self._next_send - 1e-9:
            self._next_send += self._config.send_period
            self._send(seen)
        self._receive(seen.time)
        return {self._config.robot: self._drive(seen)}

    def _send(self, seen: Observation) -> None:
        odometry, tilt, number = self._odometry, seen.inclinometer, self._config.number
        x, y = map(float, odometry.place)
        pitch, roll = map(float, tilt.value) if tilt.usable else (0.0, 0.0)
        deviation = self._config.drift * odometry.distance
        attitude = pitch, roll, odometry.yaw
        pose = PoseMessage(number, seen.time, (x, y, odometry.height), attitude, deviation)
        self.log.sent.append((seen.time, x, y))
        self._link.send_latest(pose.pack())
        wrench = seen.arm_base_wrench
        if wrench.usable:  # A stale or missing wrench is not sent as if it were measured.
            fx, fy, fz, mx, my, mz = map(float, wrench.value)
            message = WrenchMessage(number, wrench.stamp, (fx, fy, fz), (mx, my, mz))
            self._link.send_latest(message.pack())
            self.log.measured.append((wrench.stamp, fz))

    def _receive(self, now: float) -> None:
        for data in self._link.poll().messages:
            message = unpack(data)
            if isinstance(message, PoseMessage):
                self._newest = message.time
                self.log.received.append((now, message.time, *message.position[:2]))
            elif isinstance(message, WrenchMessage):
                self.log.forces.append((now, message.time, message.force[2]))
        self.log.age.append(now - self._newest)

    def _drive(self, seen: Observation) -> Command:
        if self._arm is None and seen.arm_angles.usable:
            self._arm = seen.arm_angles.value.astype(float)
        if self._arm is None:
            return Command()
        arm = self._arm.copy()
        arm[1] += self._config.swing * math.sin(self._config.swing_rate * seen.time)
        left, right = self._config.wheel_speeds
        wheels = np.array([left, right, left, right])
        return Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION)
