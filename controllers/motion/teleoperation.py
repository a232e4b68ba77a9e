"""A person who drives a rover and moves its arm: motion only as long as it is asked for again."""

from collections.abc import Mapping, Sequence

import numpy as np

from controllers.motion.driving import SkidSteer
from perception.geometry.arrays import FloatArray
from twin.description import RobotDescription
from twin.robot import NOTHING, ArmMode, Command, Observation, WheelMode

_PATIENCE = 0.15  # Time after which what was asked for last ends, unless it is asked for again [s].
_LEAD = 0.08  # Farthest that a joint's goal goes ahead of it [rad].
_LONGEST = 0.05  # Longest time between two steps that moves the arm's goal on [s].


def largest_speed(robot: RobotDescription) -> float:
    """Return the speed of a rover as drawn whose motors turn nothing but their gears [m/s].

    Args:
        robot: The rover.
    """
    return robot.wheel_radius * min(
        motor.no_load_speed * (1.0 - wheel.friction / motor.stall_torque)
        for motor, wheel in zip(robot.motors, robot.wheels)
    )


class Teleoperation:
    """Moves a rover as a person asks, and holds it still otherwise.

    What is asked for ends 0.15 s of robot time after it was asked for last, so that a rover whose
    person is gone, or the line to that person, stops. The goal of a joint that something holds up
    stays near, so that the joint does not leap when it comes free.

    Args:
        robot: The rover as drawn.
        speed: Largest speed of its wheels along the ground [m/s].
        arm_rate: Largest rate of a joint of its arm [rad/s].

    Attributes:
        pace: Share of the speeds that is given to what is asked for; 1 again after `reset`.

    Raises:
        ValueError: If the wheels cannot be as fast.
    """

    def __init__(self, robot: RobotDescription, speed: float, arm_rate: float = 0.4) -> None:
        most = largest_speed(robot)
        if not 0.0 < speed <= most:
            raise ValueError(f"expected above 0 to {most:.2f} m/s, got {speed}")
        radius = robot.wheel_radius
        self._steer = SkidSteer(radius, robot.half_track, most=speed / radius)
        self._name, self._speed, self._rate = robot.name, speed, arm_rate
        joints = len(robot.joint_names)
        self._limits = robot.arm.limits if robot.arm is not None else np.zeros((joints, 2))
        self._rest = 0.0, 0.0, np.zeros(joints)
        self.reset()

    def reset(self) -> None:
        """Hold the rover, its arm where it is at the next step."""
        self._asked, self._new = self._rest, False
        self.pace = 1.0
        self._until = self._time = -np.inf
        self._goal: FloatArray | None = None

    def ask(self, ahead: float, left: float, arm: Sequence[float]) -> None:
        """Ask for a motion from the next step on.

        Args:
            ahead: Speed ahead, -1 to 1 of the largest.
            left: Turning to the left, -1 to 1 of the wheels' largest speed.
            arm: (joints,) rates of the arm's joints, -1 to 1 of the largest.

        Raises:
            ValueError: If the arm has another number of joints.
        """
        rates = np.clip(np.array(arm, dtype=float), -1.0, 1.0)
        if rates.shape != self._rest[2].shape:
            raise ValueError(f"expected rates of {len(self._rest[2])} joints, got {arm}")
        self._asked = float(np.clip(ahead, -1.0, 1.0)), float(np.clip(left, -1.0, 1.0)), rates
        self._new = True

    def rest(self) -> None:
        """Ask for none from the next step on."""
        self._asked = self._rest

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Return the command for the rover; its arm is left alone until its angles are known."""
        seen = observations[self._name]
        if self._new:
            self._new, self._until = False, seen.time + _PATIENCE
        if seen.time > self._until:
            self._asked = self._rest
        ahead, left, arm = self._asked
        speed = self.pace * self._speed
        wheels = self._steer.wheel_speeds(ahead * speed, left * speed / self._steer.half_track)
        goal, rates = self._move_arm(seen, self.pace * self._rate * arm)
        return {self._name: Command(wheels, goal, WheelMode.SPEED, _mode(goal), rates)}

    def _move_arm(self, seen: Observation, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the arm's goal [rad] and its rates [rad/s], each of the joints or `NOTHING`."""
        period, self._time = max(min(seen.time - self._time, _LONGEST), 0.0), seen.time
        if not (rates.size and seen.arm_angles.usable):
            return (NOTHING if self._goal is None else self._goal), NOTHING
        angles = np.array(seen.arm_angles.value, dtype=float)
        if self._goal is None:
            self._goal = angles
        ahead = np.clip(self._goal + period * rates, angles - _LEAD, angles + _LEAD)
        goal = np.where(rates == 0.0, self._goal, np.clip(ahead, *self._limits.T))
        rates, self._goal = np.where(goal == self._goal, 0.0, rates), goal
        return goal, rates


def _mode(goal: FloatArray) -> ArmMode:
    """Return the mode of an arm's goal; without one the arm's motors get nothing."""
    return ArmMode.POSITION if goal.size else ArmMode.DUTY
