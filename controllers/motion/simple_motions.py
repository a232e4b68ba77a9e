"""Simple motions of all axes, for timing the loop and for exercising boards and sensors."""

import dataclasses
from collections.abc import Mapping
from typing import cast

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.robot import ArmMode, Command, Observation, WheelMode


@dataclasses.dataclass(frozen=True)
class WaveConfig:
    """Sinusoidal motion of wheels and arm.

    Attributes:
        speed: Amplitude of the wheels' speed [rad/s].
        swing: Amplitude of each joint's angle [rad].
        rate: Angular frequency [rad/s].
    """

    speed: float = 3.0
    swing: float = 0.2
    rate: float = 2.0


class WaveMotion:
    """Drives one robot to and fro and swings its arm, so that all channels change.

    Args:
        robot: Name of the robot.
        config: Amplitudes and frequency.
    """

    def __init__(self, robot: str, config: WaveConfig | None = None) -> None:
        self._robot, self._config = robot, config or WaveConfig()
        self._start: FloatArray | None = None

    def reset(self) -> None:
        """Swing about the arm's pose at the next step."""
        self._start = None

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the wheels' speeds and the arm's angles at this time."""
        seen, config = observations[self._robot], self._config
        if self._start is None:
            self._start = np.array(seen.arm_angles.value, dtype=float)
        wave = np.sin(config.rate * seen.time)
        wheels = np.full(seen.wheel_speeds.value.shape, config.speed * wave)
        arm = self._start + config.swing * wave
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
