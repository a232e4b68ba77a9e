"""Commands into motor duty, from measured values only, so that every robot shares it.

A motor at duty d turns with torque = stall_torque * (d - speed / no_load_speed) at its output
shaft; an effort, a rate or a position is reached through the inverse of this line and a
proportional-integral loop on what was measured.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from models.datasheets import ARM_MOTOR, WHEEL_MOTOR
from twin.robot import ArmMode, Channel, Command, FloatArray, Observation, RobotError, WheelMode


@dataclasses.dataclass(frozen=True)
class ServoConfig:
    """Motor line and loop gains; four numbers each, wheels and arm joints in contract order.

    Attributes:
        wheel_stall_torque: At full duty, at the output shaft [N m].
        wheel_no_load_speed: At full duty, at the output shaft [rad/s].
        arm_stall_torque: As above, for the arm joints [N m].
        arm_no_load_speed: As above, for the arm joints [rad/s].
        rate_gain: Duty per relative speed error (error / no-load speed); below 1 the loop is
            stable at any motor inertia, however fast the motor follows within a tick.
        rate_integral: Integral of the same [1/s].
        position_gain: Rate asked for per position error [1/s].
    """

    wheel_stall_torque: tuple[float, ...]
    wheel_no_load_speed: tuple[float, ...]
    arm_stall_torque: tuple[float, ...]
    arm_no_load_speed: tuple[float, ...]
    rate_gain: float = 0.5
    rate_integral: float = 15.0
    position_gain: float = 15.0

    def __post_init__(self) -> None:
        """Refuse motors that could not turn.

        Raises:
            ValueError: If a motor number is not positive, or not four are given.
        """
        for name in (
            "wheel_stall_torque",
            "wheel_no_load_speed",
            "arm_stall_torque",
            "arm_no_load_speed",
        ):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape != (4,) or not np.all(values > 0.0):
                raise ValueError(f"servo {name}: expected 4 positive numbers, got {values}")


# The friction that the sheets' shaft torque leaves out is the integral's to find.
ROVER_SERVO = ServoConfig(
    wheel_stall_torque=(WHEEL_MOTOR.gross_stall_torque,) * 4,
    wheel_no_load_speed=(WHEEL_MOTOR.gross_no_load_speed,) * 4,
    arm_stall_torque=(ARM_MOTOR.gross_stall_torque,) * 4,
    arm_no_load_speed=(ARM_MOTOR.gross_no_load_speed,) * 4,
)
"""The rover's motors, from their sheets."""


@dataclasses.dataclass(frozen=True)
class ServoState:
    """Integrals of the speed loops as duty, wheels then arm joints."""

    integrals: tuple[float, ...]


class Servo:
    """Turns a command and the latest observation into duty, once a servo tick.

    It works axis by axis in plain numbers: for eight axes that costs a fifth of array arithmetic.
    """

    def __init__(self, config: ServoConfig, period: float) -> None:
        """Prepare the motor lines.

        Args:
            config: Motors and gains.
            period: Servo tick [s].
        """
        self._gain = config.rate_gain
        self._growth = config.rate_integral * period
        self._position_gain = config.position_gain
        self._torque = (*config.wheel_stall_torque, *config.arm_stall_torque)
        self._no_load = (*config.wheel_no_load_speed, *config.arm_no_load_speed)
        self.reset()

    def reset(self) -> None:
        """Forget the integrals."""
        self._integrals = [0.0] * 8

    def duty(self, command: Command, observation: Observation) -> FloatArray:
        """Return (8,) duty in [-1, 1], wheels then arm joints.

        Args:
            command: What is asked for.
            observation: What was measured; only the channels that the modes need must be usable.

        Raises:
            RobotError: If a needed channel is missing or stale.
        """
        duties = self._wheel_duties(command, observation) + self._arm_duties(command, observation)
        return np.array([_clamp(duty) for duty in duties])

    def _wheel_duties(self, command: Command, observation: Observation) -> list[float]:
        asked, mode = command.wheels.tolist(), command.wheel_mode
        if mode is WheelMode.DUTY:
            return self._pass(0, asked)
        speeds = _needed(observation.wheel_speeds, "wheel_speeds", mode.value)
        if mode is WheelMode.EFFORT:
            return self._push(0, asked, speeds)
        return self._follow(0, asked, speeds)

    def _arm_duties(self, command: Command, observation: Observation) -> list[float]:
        asked, mode = command.arm.tolist(), command.arm_mode
        if mode is ArmMode.DUTY:
            return self._pass(4, asked)
        rates = _needed(observation.arm_rates, "arm_rates", mode.value)
        if mode is ArmMode.EFFORT:
            return self._push(4, asked, rates)
        if mode is ArmMode.POSITION:
            angles = _needed(observation.arm_angles, "arm_angles", mode.value)
            forward, gain = command.arm_rates.tolist(), self._position_gain
            asked = [f + gain * (a - x) for f, a, x in zip(forward, asked, angles)]
        return self._follow(4, asked, rates)

    def _pass(self, first: int, duties: list[float]) -> list[float]:
        """Return four duties as they are; the integrals are forgotten."""
        self._integrals[first : first + 4] = (0.0, 0.0, 0.0, 0.0)
        return duties

    def _push(self, first: int, efforts: list[float], speeds: list[float]) -> list[float]:
        """Return the duties that give four efforts [N m] at these speeds [rad/s]."""
        self._integrals[first : first + 4] = (0.0, 0.0, 0.0, 0.0)
        lines = zip(efforts, speeds, self._torque[first:], self._no_load[first:])
        return [effort / stall + speed / no_load for effort, speed, stall, no_load in lines]

    def _follow(self, first: int, targets: list[float], speeds: list[float]) -> list[float]:
        """Return the duties by which four axes follow `targets` [rad/s]."""
        duties: list[float] = []
        for axis, (target, speed) in enumerate(zip(targets, speeds), first):
            no_load = self._no_load[axis]
            wanted = _clamp(target / no_load)
            error = wanted - speed / no_load
            grown = self._integrals[axis] + self._growth * error
            duty = wanted + self._gain * error + grown
            # A saturated axis must not wind up: its integral stays where it was.
            if -1.0 < duty < 1.0:
                self._integrals[axis] = grown
            duties.append(duty)
        return duties

    def save(self) -> ServoState:
        """Return the complete state."""
        return ServoState(tuple(self._integrals))

    def restore(self, state: ServoState) -> None:
        """Go back to a saved state."""
        self._integrals = list(state.integrals)


def _clamp(value: float) -> float:
    return -1.0 if value < -1.0 else 1.0 if value > 1.0 else value


def _needed(channel: Channel, name: str, mode: str) -> list[float]:
    """Return a channel's values, or refuse to drive blind."""
    if not channel.usable:
        raise RobotError(f"{mode} mode needs {name}, which is {channel.validity.value}")
    return channel.value.tolist()
