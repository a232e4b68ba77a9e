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
    """Integrals of the speed loops, (4,) each, as duty."""

    wheels: FloatArray
    arm: FloatArray


class Servo:
    """Turns a command and the latest observation into duty, once a servo tick."""

    def __init__(self, config: ServoConfig, period: float) -> None:
        """Prepare the motor lines.

        Args:
            config: Motors and gains.
            period: Servo tick [s].
        """
        self._config = config
        self._period = period
        self._wheel_torque = np.array(config.wheel_stall_torque)
        self._wheel_speed = np.array(config.wheel_no_load_speed)
        self._arm_torque = np.array(config.arm_stall_torque)
        self._arm_speed = np.array(config.arm_no_load_speed)
        self.reset()

    def reset(self) -> None:
        """Forget the integrals."""
        self._wheel_integral = np.zeros(4)
        self._arm_integral = np.zeros(4)

    def duty(self, command: Command, observation: Observation) -> FloatArray:
        """Return (8,) duty in [-1, 1], wheels then arm joints.

        Args:
            command: What is asked for.
            observation: What was measured; only the channels that the modes need must be usable.

        Raises:
            RobotError: If a needed channel is missing or stale.
        """
        result = np.empty(8)
        result[:4] = self._wheel_duty(command, observation)
        result[4:] = self._arm_duty(command, observation)
        np.maximum(result, -1.0, out=result)
        return np.minimum(result, 1.0, out=result)

    def _wheel_duty(self, command: Command, observation: Observation) -> FloatArray:
        if command.wheel_mode is WheelMode.DUTY:
            self._wheel_integral = np.zeros(4)
            return command.wheels
        speeds = _needed(observation.wheel_speeds, "wheel_speeds", command.wheel_mode.value)
        if command.wheel_mode is WheelMode.EFFORT:
            self._wheel_integral = np.zeros(4)
            return command.wheels / self._wheel_torque + speeds / self._wheel_speed
        duty, self._wheel_integral = self._follow(
            command.wheels, speeds, self._wheel_speed, self._wheel_integral
        )
        return duty

    def _arm_duty(self, command: Command, observation: Observation) -> FloatArray:
        mode = command.arm_mode
        if mode is ArmMode.DUTY:
            self._arm_integral = np.zeros(4)
            return command.arm
        rates = _needed(observation.arm_rates, "arm_rates", mode.value)
        if mode is ArmMode.EFFORT:
            self._arm_integral = np.zeros(4)
            return command.arm / self._arm_torque + rates / self._arm_speed
        target = command.arm
        if mode is ArmMode.POSITION:
            angles = _needed(observation.arm_angles, "arm_angles", mode.value)
            target = command.arm_rates + self._config.position_gain * (command.arm - angles)
        duty, self._arm_integral = self._follow(target, rates, self._arm_speed, self._arm_integral)
        return duty

    def _follow(
        self, target: FloatArray, speed: FloatArray, no_load: FloatArray, integral: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the duty that follows `target` [rad/s] and the next integral, (4,) each."""
        target = np.minimum(np.maximum(target, -no_load), no_load)
        error = (target - speed) / no_load
        grown = integral + (self._config.rate_integral * self._period) * error
        duty = target / no_load + self._config.rate_gain * error + grown
        # A saturated axis must not wind up: its integral stays where it was.
        return duty, np.where(np.abs(duty) < 1.0, grown, integral)

    def save(self) -> ServoState:
        """Return the complete state."""
        return ServoState(self._wheel_integral.copy(), self._arm_integral.copy())

    def restore(self, state: ServoState) -> None:
        """Go back to a saved state."""
        self._wheel_integral = state.wheels.copy()
        self._arm_integral = state.arm.copy()


def _needed(channel: Channel, name: str, mode: str) -> FloatArray:
    """Return a channel's value, or refuse to drive blind."""
    if not channel.usable:
        raise RobotError(f"{mode} mode needs {name}, which is {channel.validity.value}")
    return channel.value.astype(float, copy=False)
