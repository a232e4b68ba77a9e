"""Simple motions of all axes, for timing the loop and for exercising boards and sensors."""

from collections.abc import Mapping
from typing import cast

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation, WheelMode

SPEED, SWING, RATE = 3.0, 0.2, 2.0
"""Amplitudes of wheel speed [rad/s] and joint angle [rad], and angular frequency [rad/s]."""


class WaveMotion:
    """Drives one robot to and fro and swings its arm, so that all channels change.

    Args:
        robot: Name of the robot.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._start: FloatArray | None = None

    def reset(self) -> None:
        """Swing about the arm's pose at the next step."""
        self._start = None

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the wheels' speeds and the arm's angles at this time."""
        seen = observations[self._robot]
        if self._start is None:
            self._start = np.array(seen.arm_angles.value, dtype=float)
        wave = np.sin(RATE * seen.time)
        wheels = np.full(seen.wheel_speeds.value.shape, SPEED * wave)
        arm = self._start + SWING * wave
        return {self._robot: Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION)}


class DriveAndHold:
    """Drives all robots straight on with their arms held where they are.

    Args:
        speed: Speed of all wheels [rad/s].
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the wheels' speeds, and the arm's angles as observed."""
        return {
            name: Command(
                wheels=np.full(seen.wheel_speeds.value.shape, self._speed),
                arm=cast("FloatArray", seen.arm_angles.value),
                wheel_mode=WheelMode.SPEED,
                arm_mode=ArmMode.POSITION,
            )
            for name, seen in observations.items()
        }
