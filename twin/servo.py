"""Commands into motor duty, from measured values only, so that every robot shares it.

A motor at duty d turns with torque = stall_torque * (d - speed / no_load_speed) at its output
shaft; an effort, a rate or a position is reached through the inverse of this line and a
proportional-integral loop on what was measured.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numba
import numpy as np

from models.datasheets import ARM_MOTOR, WHEEL_MOTOR
from twin.robot import (
    NOTHING,
    ArmMode,
    Channel,
    Command,
    FloatArray,
    Observation,
    RobotError,
    Validity,
    WheelMode,
)

SERVO_PERIOD = 0.01
"""Default servo tick [s]."""


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


_PASS, _PUSH, _FOLLOW, _REACH = range(4)
# By identity: members of an enumeration are hashed by Python code.
_WHEEL_LAWS = {id(WheelMode.DUTY): _PASS, id(WheelMode.EFFORT): _PUSH, id(WheelMode.SPEED): _FOLLOW}
_ARM_LAWS = {
    id(ArmMode.DUTY): _PASS,
    id(ArmMode.EFFORT): _PUSH,
    id(ArmMode.RATE): _FOLLOW,
    id(ArmMode.POSITION): _REACH,
}
_MEASURED = Validity.MEASURED
_BLOCK = 64  # ticks of duties laid out at a time
# NumPy makes the views of both parts in one call.
_DUTIES = np.dtype([("wheels", np.float64, (4,)), ("arm", np.float64, (4,))])


class Servo:
    """Turns a command and the latest observation into duty, once a servo tick."""

    def __init__(
        self,
        config: ServoConfig,
        period: float,
        full: FloatArray | None = None,
        motors: FloatArray | None = None,
    ) -> None:
        """Prepare the motor lines.

        Args:
            config: Motors and gains.
            period: Servo tick [s].
            full: (8,) what a motor gets at full duty; None for 1.
            motors: (8,) receives what the motors get, each time; None for an array of its own.
        """
        # Wheels then arm joints; the rows as `_act` reads them, the integrals last.
        self._axes = np.array(
            [
                [*config.wheel_stall_torque, *config.arm_stall_torque],
                [*config.wheel_no_load_speed, *config.arm_no_load_speed],
                [config.rate_gain] * 8,
                [config.rate_integral * period] * 8,
                [config.position_gain] * 8,
                [1.0] * 8 if full is None else full,
                [0.0] * 8,
            ]
        )
        self.motors = np.zeros(8) if motors is None else motors
        self._lay_out()

    def reset(self) -> None:
        """Forget the integrals."""
        self._axes[-1] = 0.0

    def _lay_out(self) -> None:
        """Make room for the next block of duties, which is written here and read-only outside."""
        self._block: Any = np.zeros(_BLOCK, _DUTIES)
        self._duties = self._block.view(np.float64).reshape(_BLOCK, 8)
        self._block.flags.writeable = False
        self._row = -1

    def duty(self, command: Command, observation: Observation) -> FloatArray:
        """Return (8,) duty in [-1, 1], wheels then arm joints; else as `drive`."""
        return np.concatenate(self.drive(command, observation))

    def drive(self, command: Command, observation: Observation) -> tuple[FloatArray, FloatArray]:
        """Bring a command to the motors, and return their duty in [-1, 1].

        Args:
            command: What is asked for.
            observation: What was measured; only the channels that the modes need must be usable.

        Returns:
            (4,) of the wheels and (4,) of the arm joints, read-only.

        Raises:
            RobotError: If a needed channel is missing or stale.
            ValueError: If a duty comes to no number, as from a command that was written to after
                its check; the motors get nothing then.
        """
        wheel_mode, arm_mode = command.wheel_mode, command.arm_mode
        wheel_law, arm_law = _WHEEL_LAWS[id(wheel_mode)], _ARM_LAWS[id(arm_mode)]
        speeds: Any = NOTHING
        rates: Any = NOTHING
        angles: Any = NOTHING
        if wheel_law != _PASS:
            speeds, _, validity = observation.wheel_speeds
            if validity is not _MEASURED:
                _insist(observation.wheel_speeds, "wheel_speeds", wheel_mode)
        if arm_law != _PASS:
            rates, _, validity = observation.arm_rates
            if validity is not _MEASURED:
                _insist(observation.arm_rates, "arm_rates", arm_mode)
        if arm_law == _REACH:
            angles, _, validity = observation.arm_angles
            if validity is not _MEASURED:
                _insist(observation.arm_angles, "arm_angles", arm_mode)
        row = self._row + 1
        if row == _BLOCK:
            self._lay_out()
            row = 0
        self._row = row
        finite = _act(
            wheel_law,
            arm_law,
            command.wheels,
            command.arm,
            command.arm_rates,
            speeds,
            rates,
            angles,
            self._axes,
            self.motors,
            self._duties,
            row,
        )
        if not finite:
            self.motors[:] = 0.0
            raise ValueError(f"duty {self._duties[row]} is not finite; nothing was sent")
        return self._block.item(row)

    def save(self) -> FloatArray:
        """Return the complete state: (8,) integrals of the speed loops as duty."""
        return self._axes[-1].copy()

    def restore(self, state: FloatArray) -> None:
        """Go back to a saved state."""
        self._axes[-1] = state


@numba.njit(cache=True)
def _act(
    wheel_law: int,
    arm_law: int,
    wheels: FloatArray,
    arm: FloatArray,
    forward: FloatArray,
    speeds: FloatArray,
    rates: FloatArray,
    angles: FloatArray,
    axes: FloatArray,
    motors: FloatArray,
    duties: FloatArray,
    row: int,
) -> bool:
    """Write eight axes' duties, bring their integrals on, and return whether all are numbers."""
    finite, full, integrals = True, axes[5], axes[6]
    for axis in range(8):
        joint = axis - 4
        if axis < 4:
            law, target, speed = wheel_law, wheels[axis], speeds[axis]
        else:
            law, target, speed = arm_law, arm[joint], rates[joint]
        stall, no_load, gain, integral, reach = axes[:5, axis]
        duty = target
        if law == _PUSH:
            duty = target / stall + speed / no_load
        if law == _REACH:
            target = forward[joint] + reach * (target - angles[joint])
        if law == _FOLLOW or law == _REACH:
            wanted = min(max(target / no_load, -1.0), 1.0)
            error = wanted - speed / no_load
            grown = integrals[axis] + integral * error
            duty = wanted + gain * error + grown
            # A saturated axis must not wind up: its integral stays where it was.
            if -1.0 < duty < 1.0:
                integrals[axis] = grown
        else:
            integrals[axis] = 0.0
        # Not by the limited duty, which a NaN may pass for a limit.
        finite = finite and not math.isnan(duty)
        duty = min(max(duty, -1.0), 1.0)
        duties[row, axis], motors[axis] = duty, duty * full[axis]
    return finite


def _insist(channel: Channel, name: str, mode: WheelMode | ArmMode) -> None:
    """Refuse to drive blind."""
    if not channel.usable:
        raise RobotError(f"{mode.value} mode needs {name}, which is {channel.validity.value}")
