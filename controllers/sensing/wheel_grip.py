"""Friction under each wheel by itself: one wheel spins in place while the others hold the rover.

A motor without voltage brakes: its short-circuited windings resist, and so does its gear. Three
braked wheels hold the rover against the push of the fourth, which slips as soon as it turns. While
it slips at a steady speed, its motor's torque less its gear's friction is the coefficient times the
load times the radius, whatever the speed; the torque follows from duty and speed. The load is that
of the rover as drawn, at rest, with the measured wrench of its arm. Each wheel spins forward and
backward, so that what its own push moves of the load cancels.

Needed are tachometers, inclinometer and the force/torque sensor under the arm.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np

from controllers.identification.arm_sensing import IdentificationError, ObservationLog
from controllers.identification.friction import KnownBase, normal_forces
from controllers.motion.arm_move import ArmMove
from perception.geometry.arrays import BoolArray, FloatArray, IndexArray
from perception.geometry.gravity import GRAVITY
from twin.description import RobotDescription
from twin.robot import Command, Observation, WheelMode

_CHANNELS = ("wheel_speeds", "inclinometer", "arm_base_wrench")


@dataclasses.dataclass(frozen=True)
class WheelGripConfig:
    """Motion of the wheels.

    Attributes:
        duty: Duty of the wheel that spins; enough to slip on any ground.
        settle: Time at rest, with the arm at home, over which the load is measured [s].
        spin: Time that a wheel spins each way [s]; its second half counts.
        rest: Time at rest after each spin [s].
        still: Mean speed below which a wheel did not spin, and above which a braked one gave way
            [rad/s].
        unlike: Share of the larger friction by which both ways may differ.
    """

    duty: float = 0.2
    settle: float = 0.5
    spin: float = 0.8
    rest: float = 0.3
    still: float = 0.1
    unlike: float = 0.4


@dataclasses.dataclass(frozen=True)
class WheelGrips:
    """Friction under each wheel.

    Attributes:
        friction: (wheels,) coefficients; NaN for a wheel that bears nothing, did not slip alone, or
            not alike both ways, as beside a stone.
        loads: (wheels,) normal forces at rest, as drawn [N].
    """

    friction: FloatArray
    loads: FloatArray


class WheelGripProbe:
    """Spins a robot's wheels, one after the other.

    Args:
        robot: The robot as drawn.
        config: Motion of the wheels.

    Attributes:
        config: Motion of the wheels.
        done: Whether all wheels have spun.

    Raises:
        ValueError: If it has no arm or not four wheels.
    """

    def __init__(self, robot: RobotDescription, config: WheelGripConfig | None = None) -> None:
        self._base, self._robot = KnownBase.of_robot(robot), robot
        self.config = config or WheelGripConfig()
        self.reset()

    def reset(self) -> None:
        """Forget what was measured."""
        self._log = ObservationLog("friction under the wheels", _CHANNELS)
        self._begin: float | None = None
        assert self._robot.arm is not None
        self._move = ArmMove(self._robot.arm.home, wheel_mode=WheelMode.DUTY)
        self.done = False

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Record a tick and return the command.

        Raises:
            IdentificationError: If a sensor that is needed is missing or reads nonsense.
        """
        seen = observations[self._robot.name]
        held = self._move.command(seen)
        if self._begin is None:
            if self._move.is_there(seen):
                self._begin = seen.time
            return {self._robot.name: held}
        self._log.take(seen)
        duty = np.zeros(len(self._robot.wheels))
        turn, since = self._turn(np.array([seen.time - self._begin]))
        self.done = bool(turn[0] >= 2 * len(duty))
        if 0 <= turn[0] < 2 * len(duty) and since[0] < self.config.spin:
            duty[turn[0] // 2] = self.config.duty * (1 - 2 * (turn[0] % 2))
        command = Command(duty, held.arm, WheelMode.DUTY, held.arm_mode, held.arm_rates)
        return {self._robot.name: command}

    def _turn(self, times: FloatArray) -> tuple[IndexArray, FloatArray]:
        """Return which spin each time belongs to, negative before the first, and the time in it."""
        config = self.config
        turn, since = np.divmod(times - config.settle + 1e-6, config.spin + config.rest)
        return turn.astype(np.intp), since

    def estimate(self) -> WheelGrips:
        """Return the friction under each wheel.

        Raises:
            IdentificationError: If the wheels have not all spun yet.
        """
        if not self.done or self._begin is None:
            raise IdentificationError("friction under the wheels: not all wheels have spun yet")
        config, wheels = self.config, self._robot.wheels
        times = self._log.times - self._begin
        turn, since = self._turn(times)
        speeds, loads = self._log.values("wheel_speeds"), self._loads(times < config.settle)
        counted = (since > config.spin / 2) & (since < config.spin)
        friction = np.full((len(wheels), 2), np.nan)
        for index in range(2 * len(wheels)):
            wheel, way = divmod(index, 2)
            mean = np.abs(speeds[counted & (turn == index)].mean(axis=0))
            others = np.delete(mean, wheel)
            alone = mean[wheel] > config.still and np.all(others < config.still)
            if alone and loads[wheel] > 0.0:
                torque = self._torque(wheel, float(mean[wheel]))
                friction[wheel, way] = torque / (wheels[wheel].radius * loads[wheel])
        unlike = np.abs(np.diff(friction, axis=1)[:, 0]) > config.unlike * friction.max(axis=1)
        return WheelGrips(np.where(unlike, np.nan, friction.mean(axis=1)), loads)

    def _torque(self, wheel: int, speed: float) -> float:
        """Return the torque of a wheel on the ground at a steady speed [N m]."""
        motor = self._robot.motors[wheel]
        torque = motor.stall_torque * (self.config.duty - speed / motor.no_load_speed)
        return torque - self._robot.wheels[wheel].friction

    def _loads(self, resting: BoolArray) -> FloatArray:
        """Return the wheels' normal forces (wheels,) over some ticks [N]."""
        pitch, roll = np.median(self._log.values("inclinometer")[resting], axis=0)
        wrench = np.median(self._log.values("arm_base_wrench")[resting], axis=0)
        base = self._base
        up = [-np.cos(pitch) * np.sin(roll), np.sin(pitch), np.cos(pitch) * np.cos(roll)]
        weight = base.body.mass * GRAVITY * np.array(up)
        moment = wrench[3:] + np.cross(base.mount, wrench[:3]) + np.cross(base.body.centre, weight)
        return normal_forces((weight + wrench[:3])[None], moment[None], base.wheels)[0]
