"""Simple motions of all axes: to time the loop, to exercise boards and sensors, to be watched."""

from collections.abc import Mapping
from typing import cast

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.robot import ArmMode, Command, Observation, WheelMode

SPEED, SWING, RATE = 3.0, 0.2, 2.0
"""Amplitudes of wheel speed [rad/s] and joint angle [rad], and angular frequency [rad/s]."""
AROUND = np.array([0.8, 0.3, 0.3, 0.4])
"""How far the arm's postures lie from the middle, either way [rad]."""
MIDDLE = np.array([0.0, 0.2, 0.1, 0.0])
"""Middle of the arm's postures from its rest posture [rad]."""
ARM_RATE = 0.5
"""Mean rate of the joint that has the longest way [rad/s]."""
STAYS = 0.2, 1.5
"""Time for which the arm stays in a posture [s]."""
SPEEDS = 0.8, 3.0
"""Speeds of the wheels [rad/s]."""
STRETCHES = 1.5, 4.0
"""Time for which the wheels do one thing [s]."""
WAYS = np.array([[0.0, 0.0], [1.0, 1.0], [0.5, -0.5], [1.0, 0.5]])
"""Speeds of left and right wheels, over the speed: to stand, drive, turn and drive a curve."""
AHEAD = 0.6
"""Share of the stretches that go ahead."""
_SPEEDING = 4.0  # Change of the wheels' speed [rad/s^2].
_SHORTEST = 1.5  # Shortest way of the arm [s].


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


class Work:
    """Works at random: drives, turns and stands by turns, while the arm goes to new postures.

    Args:
        robot: The rover as drawn.
        rng: Random generator of its motion.
    """

    def __init__(self, robot: RobotDescription, rng: np.random.Generator) -> None:
        assert robot.arm is not None
        self._name, self._home, self._rng = robot.name, np.asarray(robot.arm.home), rng
        self.reset()

    def reset(self) -> None:
        """Begin anew, with the arm in its rest posture."""
        self._from, self._to = self._home, self._home
        self._begin = self._arrival = self._leave = self._until = -np.inf
        self._sides = self._wanted = np.zeros(2)
        self._time: float | None = None

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the rover's next command."""
        time = observations[self._name].time
        if time >= self._leave:
            self._go(time)
        if time >= self._until:
            self._turn(time)
        part = min(1.0, (time - self._begin) / (self._arrival - self._begin))
        way = self._to - self._from
        # Without a jump of rate or acceleration at either end.
        angles = self._from + way * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        rates = way * 30.0 * (part * (1.0 - part)) ** 2 / (self._arrival - self._begin)
        wheels = self._wheels(time)
        return {self._name: Command(wheels, angles, WheelMode.SPEED, ArmMode.POSITION, rates)}

    def _wheels(self, time: float) -> FloatArray:
        passed = 0.0 if self._time is None else max(0.0, time - self._time)
        self._time, most = time, _SPEEDING * passed
        self._sides = self._sides + np.clip(self._wanted - self._sides, -most, most)
        return np.tile(self._sides, 2)

    def _go(self, time: float) -> None:
        """Choose the arm's next posture."""
        self._from, self._begin = self._to, time
        self._to = self._home + MIDDLE + AROUND * self._rng.uniform(-1.0, 1.0, 4)
        farthest = float(np.abs(self._to - self._from).max())
        self._arrival = time + max(_SHORTEST, farthest / ARM_RATE)
        self._leave = self._arrival + self._rng.uniform(*STAYS)

    def _turn(self, time: float) -> None:
        """Choose what the wheels do next."""
        sign = 1.0 if self._rng.random() < AHEAD else -1.0
        self._wanted = sign * self._rng.uniform(*SPEEDS) * self._rng.choice(WAYS)
        self._until = time + self._rng.uniform(*STRETCHES)
