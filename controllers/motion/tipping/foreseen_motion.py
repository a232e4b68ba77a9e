"""A swing or a drive as it is planned, and how likely it is held to tip the rover over."""

import dataclasses
import math
import time
from collections.abc import Mapping

import numpy as np

from controllers.motion.arm_control import ArmControlConfig, ArmController, Reference
from controllers.motion.base_motion import level_of
from controllers.motion.driving import SkidSteer
from controllers.motion.tipping.look_ahead import PERIOD, LookAhead, Plan
from controllers.motion.tipping.tip_over import Sweep
from perception.geometry.arrays import FloatArray
from twin.robot import Command, Observation, WheelMode


@dataclasses.dataclass(frozen=True)
class MotionConfig:
    """A motion, and how it is looked at.

    Attributes:
        arm: Control of the arm.
        steer: Wheels of the rover.
        approach: Motion of the arm to where it begins.
        path: Its motion from there.
        ways: (k, 2) forward speeds [m/s] and turning rates [rad/s] of a drive; none for a swing.
        stretch: Time for which each of them lasts [s].
        rest: Time for which the arm rests before it begins [s].
        horizon: How far it looks ahead [s].
        every: Time from one look to the next [s], of a drive; a swing is looked at before it.
    """

    arm: ArmControlConfig
    steer: SkidSteer
    approach: Sweep
    path: Sweep
    ways: FloatArray
    stretch: float
    rest: float
    horizon: float
    every: float


class ForeseenMotion:
    """Makes one motion whatever it foresees.

    Args:
        config: The motion.
        ahead: Looks ahead for the rover.
        rng: Random generator of what is looked at.

    Attributes:
        asked: Times at which it looked ahead, from the motion's beginning [s].
        chances: Probabilities to tip over within the horizon, as it foresaw.
        took: Longest time that one look took [s].
    """

    def __init__(self, config: MotionConfig, ahead: LookAhead, rng: np.random.Generator) -> None:
        self._config, self._ahead, self._rng = config, ahead, rng
        self._arm = ArmController(config.arm, self._reference)
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._arm.reset()
        self._ticks = -round(self._before / PERIOD)
        self.asked: list[float] = []
        self.chances: list[float] = []
        self.took = 0.0

    @property
    def time(self) -> float:
        """Time since the motion began [s]; below 0 before."""
        return self._ticks * PERIOD

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Command arm and wheels, and look ahead when it is time."""
        config = self._config
        seen = observations[config.arm.robot]
        if self._is_due():
            begun = time.perf_counter()
            found = self._ahead.outlook(self._plan(seen), self._rng, level_of(seen))
            self.asked.append(self.time)
            self.chances.append(found.tip())
            self.took = max(self.took, time.perf_counter() - begun)
        arm = self._arm.step(observations)[config.arm.robot]
        wheels = config.steer.wheel_speeds(*self._way(self.time))
        self._ticks += 1
        command = dataclasses.replace(arm, wheels=wheels, wheel_mode=WheelMode.SPEED)
        return {config.arm.robot: command}

    @property
    def _before(self) -> float:
        return self._config.approach.duration + self._config.rest

    def _is_due(self) -> bool:
        every = round(self._config.every / PERIOD)
        drives = len(self._config.ways) > 0
        return self._ticks == 0 or (drives and self._ticks > 0 and self._ticks % every == 0)

    def _plan(self, seen: Observation) -> Plan:
        """Return what is planned from now on, with the arm and the wheels as they are measured."""
        config = self._config
        angles = np.array(seen.arm_angles.value, dtype=float)
        if not len(config.ways):
            path = dataclasses.replace(config.path, start=angles)
            return Plan.of_arm(path.at, config.horizon)
        times = self.time + PERIOD * np.arange(round(config.horizon / PERIOD))
        wheels = np.array([config.steer.wheel_speeds(*self._way(each))[:2] for each in times])
        radius, turning = config.steer.wheel_radius, float(seen.gyro.value[2])
        now = radius * np.reshape(seen.wheel_speeds.value, (2, 2)).mean(axis=0)
        return Plan.of_drive(angles, radius * wheels, now, turning)

    def _way(self, at: float) -> tuple[float, float]:
        """Return speed [m/s] and turning rate [rad/s] at a time."""
        index = math.floor(at / self._config.stretch + 1e-9)
        if not 0 <= index < len(self._config.ways):
            return 0.0, 0.0
        speed, turn = self._config.ways[index].tolist()
        return speed, turn

    def _reference(self, at: float) -> Reference:
        begun = at - self._before
        config = self._config
        return Reference(*(config.approach.at(at) if begun < 0.0 else config.path.at(begun)))
