"""Commands into motor duty, from measured values only, so that every robot shares it.

A motor at duty d turns with torque = stall_torque * (d - speed / no_load_speed) at its output
shaft; an effort, a rate or a position is reached through the inverse of this line and a
proportional-integral loop on what was measured.
"""

import dataclasses
import math
from typing import Any

import numba
import numpy as np

from perception.geometry.arrays import FloatArray
from twin.description import MotorDescription, RobotDescription
from twin.robot import (
    NOTHING,
    ArmMode,
    Channel,
    Command,
    Observation,
    RobotError,
    Validity,
    WheelMode,
)

SERVO_PERIOD = 0.01
"""Default servo tick [s]."""


@dataclasses.dataclass(frozen=True)
class ServoConfig:
    """Motor lines and loop gains.

    Attributes:
        wheels: Motors of the wheels, in contract order.
        joints: Motors of the arm's joints, in contract order.
        rate_gain: Duty per relative speed error (error / no-load speed); below 1 the loop is
            stable at any motor inertia, however fast the motor follows within a tick.
        rate_integral: Growth of the duty per relative speed error and time [1/s].
        position_gain: Desired rate per position error [1/s].
    """

    wheels: tuple[MotorDescription, ...]
    joints: tuple[MotorDescription, ...]
    rate_gain: float = 0.5
    rate_integral: float = 15.0
    position_gain: float = 15.0

    @classmethod
    def of(cls, robot: RobotDescription) -> "ServoConfig":
        """Return the usual gains for a robot's motors as drawn."""
        wheels = len(robot.wheels)
        return cls(robot.motors[:wheels], robot.motors[wheels:])


_PASS, _PUSH, _FOLLOW, _REACH = range(4)
_DONE, _MISFIT, _NO_NUMBER = range(3)
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


class Servo:
    """Converts a command and the latest observation into duty, once a servo tick."""

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
            full: (axes,) motor input at full duty; None for 1.
            motors: (axes,) receives the motor inputs at each call; None for an array of its own.
        """
        lines = (*config.wheels, *config.joints)
        size = len(lines)
        self._wheels = len(config.wheels)
        # NumPy makes the views of both parts in one call.
        self._parts = np.dtype(
            [("wheels", np.float64, (self._wheels,)), ("arm", np.float64, (size - self._wheels,))]
        )
        # Wheels then arm joints; the rows as `_act` reads them, the integrals last.
        self._axes = np.array(
            [
                [line.stall_torque for line in lines],
                [line.no_load_speed for line in lines],
                [config.rate_gain] * size,
                [config.rate_integral * period] * size,
                [config.position_gain] * size,
                [1.0] * size if full is None else full,
                [0.0] * size,
            ]
        )
        self.motors = np.zeros(size) if motors is None else motors
        self._lay_out()

    def reset(self) -> None:
        """Zero the integrals."""
        self._axes[-1] = 0.0

    def weaken(self, axis: int, share: float) -> None:
        """Take a share of a motor's input at full duty, for good, as a low battery does.

        Args:
            axis: Number of the axis, wheels first.
            share: What is lost of what it got, 0 to 1.
        """
        self._axes[5, axis] *= 1.0 - share

    def _lay_out(self) -> None:
        """Allocate the next block of duties, which is written here and read-only outside."""
        self._block: Any = np.zeros(_BLOCK, self._parts)
        self._duties = list(self._block.view(np.float64).reshape(_BLOCK, -1))
        self._block.flags.writeable = False
        self._row = -1

    def duty(self, command: Command, observation: Observation) -> FloatArray:
        """Return (axes,) duty in [-1, 1], wheels then arm joints; else as `drive`."""
        return np.concatenate(self.drive(command, observation))

    def drive(self, command: Command, observation: Observation) -> tuple[FloatArray, FloatArray]:
        """Apply a command to the motors, and return their duty in [-1, 1].

        Args:
            command: Desired duty, effort, rate or position.
            observation: Latest measurements; the channels that the modes need must be usable.

        Returns:
            (wheels,) and (joints,) duty, read-only.

        Raises:
            RobotError: If a needed channel is missing or stale.
            ValueError: If the command has another number of wheels or joints than the robot, or a
                duty is not a number, as from a command that was changed after its check; the
                motors get nothing then.
        """
        wheel_mode, arm_mode = command.wheel_mode, command.arm_mode
        wheel_law, arm_law = _WHEEL_LAWS[id(wheel_mode)], _ARM_LAWS[id(arm_mode)]
        speeds: Any = NOTHING
        rates: Any = NOTHING
        angles: Any = NOTHING
        if wheel_law != _PASS:
            speeds = _measured(observation.wheel_speeds, "wheel_speeds", wheel_mode)
        if arm_law != _PASS:
            rates = _measured(observation.arm_rates, "arm_rates", arm_mode)
        if arm_law == _REACH:
            angles = _measured(observation.arm_angles, "arm_angles", arm_mode)
        row = self._row + 1
        if row == _BLOCK:
            self._lay_out()
            row = 0
        self._row = row
        result = _act(
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
            self._duties[row],
            self._wheels,
        )
        if result != _DONE:
            self.motors[:] = 0.0
            if result == _MISFIT:
                raise ValueError(
                    f"command with {len(command.wheels)} wheels, {len(command.arm)} arm joints and "
                    f"{len(command.arm_rates)} arm rates; the robot has {self._wheels} wheels and "
                    f"{len(self.motors) - self._wheels} joints"
                )
            raise ValueError(f"duty {self._duties[row]} is not finite; nothing was sent")
        return self._block.item(row)

    def save(self) -> FloatArray:
        """Return the complete state: (axes,) integrals of the speed loops as duty."""
        return self._axes[-1].copy()

    def restore(self, state: FloatArray) -> None:
        """Go back to a saved state."""
        self._axes[-1] = state


# Named tuples of arrays would take compiled code 4 to 7 us a call to receive, arrays take 1.6 us.
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
    count: int,
) -> int:
    """Write all axes' duties and update their integrals; the first `count` axes are wheels.

    Returns:
        _DONE; _MISFIT if arrays are neither empty, for zeros, nor as long as there are axes;
        _NO_NUMBER if a duty is not a number.
    """
    full, integrals = axes[5], axes[6]
    joints = axes.shape[1] - count
    for part, size in ((wheels.size, count), (arm.size, joints), (forward.size, joints)):
        if part != 0 and part != size:
            return _MISFIT
    if wheel_law != _PASS and speeds.size != count or arm_law != _PASS and rates.size != joints:
        return _MISFIT
    if arm_law == _REACH and angles.size != joints:
        return _MISFIT
    result = _DONE
    for axis in range(count + joints):
        joint = axis - count
        if axis < count:
            law, speed = wheel_law, speeds[axis] if wheel_law != _PASS else 0.0
            target = wheels[axis] if wheels.size else 0.0
        else:
            law, speed = arm_law, rates[joint] if arm_law != _PASS else 0.0
            target = arm[joint] if arm.size else 0.0
        stall, no_load, gain, integral, reach = axes[:5, axis]
        duty = target
        if law == _PUSH:
            duty = target / stall + speed / no_load
        if law == _REACH:
            rate = forward[joint] if forward.size else 0.0
            target = rate + reach * (target - angles[joint])
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
        if math.isnan(duty):
            result = _NO_NUMBER
        duty = min(max(duty, -1.0), 1.0)
        duties[axis], motors[axis] = duty, duty * full[axis]
    return result


def _measured(channel: Channel, name: str, mode: WheelMode | ArmMode) -> Any:
    """Return the value of a channel, if it is usable."""
    value, _, validity = channel
    if validity is not _MEASURED and not channel.usable:
        raise RobotError(f"{mode.value} mode needs {name}, which is {validity.value}")
    return value
