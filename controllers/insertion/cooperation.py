"""Two robots hold one segment: decentralised master-slave hybrid control (Thesis figure A-8).

In the plane two rigid grips transmit six forces, and the segment has three degrees of freedom:
three forces are internal. So of the six directions of the two grips three are controlled in
position and three in force. The master controls its grip's position along s and z, the slave its
own along z; both yield to moments, and the slave yields along the segment until it exerts the
wanted squeeze. Each robot uses its own sensors. The radio carries the segment's set point to the
slave, and the wrench of the slave's grip on the segment to the master.

A position is reached by the servo, a force by moving the servo's target in proportion to the force
error: the suspension, the arm and the grip are the spring (Thesis eq. A-1).
"""

import dataclasses
import math
import struct

import numpy as np
from numpy.typing import ArrayLike

from controllers.insertion.planar_grip import GripSensor, PlanarArm, Stance
from perception.geometry.arrays import FloatArray
from perception.geometry.checks import check_numbers
from twin.robot import ArmMode, Command, Observation, RobotError

MASTER_FORCES = (False, False, True)
SLAVE_FORCES = (True, False, True)
NO_FORCES = (False, False, False)
"""Which of s, z and angle a robot controls by force."""
SET_POINT, REPORT = 1, 2
"""First byte of the two messages."""
_FORMAT = {SET_POINT: "<B6h", REPORT: "<B3h"}
_UNITS = {
    SET_POINT: np.array([2e-5, 2e-5, 5e-5, 1e-5, 1e-5, 5e-5]),  # m, m, rad and these a second
    REPORT: np.array([2e-3, 2e-3, 5e-4]),  # N, N, N m
}


def encode(kind: int, values: ArrayLike) -> bytes:
    """Return a message for the radio; values are clipped to its range.

    Args:
        kind: `SET_POINT`, (6,) pose and rate, or `REPORT`, (3,) wrench.
        values: Numbers in SI units, plan frame.

    Raises:
        ValueError: If the kind is unknown or a number is missing or not finite.
    """
    units = _UNITS.get(kind)
    numbers = np.asarray(values, dtype=float)
    if units is None or numbers.shape != units.shape or not np.all(np.isfinite(numbers)):
        raise ValueError(
            f"message {kind} of {values}: valid are {SET_POINT} with 6 and {REPORT} with 3 finite "
            "numbers"
        )
    counts = np.clip(np.rint(numbers / units), -32767, 32767).astype(int)
    return struct.pack(_FORMAT[kind], kind, *counts.tolist())


def decode(message: bytes) -> tuple[int, FloatArray]:
    """Return kind and values of a message; undoes `encode` but for rounding.

    Raises:
        ValueError: If it is none.
    """
    kind = message[0] if message else 0
    if kind not in _FORMAT or len(message) != struct.calcsize(_FORMAT[kind]):
        raise ValueError(f"message {message.hex(' ')}: neither a set point nor a report")
    return kind, np.array(struct.unpack(_FORMAT[kind], message)[1:]) * _UNITS[kind]


@dataclasses.dataclass(frozen=True)
class Grip:
    """A robot's grip on the segment.

    Attributes:
        place: (2,) position in the segment's frame [m].
        angle: Angle of the gripper against the segment, plan frame [rad].
    """

    place: tuple[float, float]
    angle: float

    def on(self, segment: ArrayLike) -> FloatArray:
        """Return the gripper's pose (3,) for a segment's.

        Args:
            segment: (3,) pose in the plan frame [m, m, rad].
        """
        s, z, angle = np.asarray(segment, dtype=float)
        lever = self.lever(angle)
        return np.array([s + lever[0], z + lever[1], angle + self.angle])

    def rate_on(self, segment: ArrayLike, rate: ArrayLike) -> FloatArray:
        """Return the gripper's rate (3,) for a segment's pose and rate, (3,) each."""
        s, z, turning = np.asarray(rate, dtype=float)
        lever = self.lever(float(np.asarray(segment)[2]))
        return np.array([s - turning * lever[1], z + turning * lever[0], turning])

    def segment_of(self, gripper: ArrayLike) -> FloatArray:
        """Return the segment's pose (3,) for a gripper's; undoes `on`."""
        s, z, angle = np.asarray(gripper, dtype=float)
        lever = self.lever(angle - self.angle)
        return np.array([s - lever[0], z - lever[1], angle - self.angle])

    def lever(self, angle: float) -> FloatArray:
        """Return (2,) from the segment's origin to the grip, plan frame [m]."""
        c, n = math.cos(angle), math.sin(angle)
        x, y = self.place
        return np.array([c * x - n * y, n * x + c * y])

    def about_segment(self, wrench: ArrayLike, angle: float) -> FloatArray:
        """Return a wrench (3,) at the grip about the segment's origin, plan frame.

        Args:
            wrench: (3,) wrench at the grip, plan frame [N, N, N m].
            angle: Angle of the segment [rad].
        """
        f_s, f_z, moment = np.asarray(wrench, dtype=float)
        x, y = self.lever(angle)
        return np.array([f_s, f_z, moment + x * f_z - y * f_s])


@dataclasses.dataclass(frozen=True)
class HybridConfig:
    """Gains and limits of force and position control.

    Attributes:
        forces: Whether each of s, z, angle is controlled by force.
        wanted: (3,) commanded wrench of the gripper on the segment, where by force [N, N, N m].
        give: Admittance, speed over force error [m/s/N].
        give_turn: Admittance, turning rate over moment error [rad/s/(N m)].
        speed: Largest speed of a correction [m/s].
        turn_rate: Largest turning rate of a correction [rad/s].
        reach: Largest correction by force [m].
        turn_reach: Largest correction of the angle by force [rad].
        take_up: Time constant of the decay of an initial position error, where by position [s].
        filter_time: Time constant of the wrench's low pass [s].
        joint_rate: Largest rate of a joint [rad/s].
        period: Servo tick [s].
    """

    forces: tuple[bool, bool, bool]
    wanted: tuple[float, float, float] = (0.0, 0.0, 0.0)
    give: float = 0.002
    give_turn: float = 0.05
    speed: float = 0.02
    turn_rate: float = 0.1
    reach: float = 0.02
    turn_reach: float = math.radians(15.0)
    take_up: float = 0.3
    filter_time: float = 0.03
    joint_rate: float = 0.5
    period: float = 0.01

    def __post_init__(self) -> None:
        """Refuse values out of range.

        Raises:
            ValueError: Naming the field.
        """
        _, _, *numbers = (field.name for field in dataclasses.fields(self))
        check_numbers("grip", self, *numbers)
        if not len(self.forces) == len(self.wanted) == 3:
            raise ValueError(f"forces {self.forces}, wanted {self.wanted}: expected three of each")


class HybridGrip:
    """Hybrid position and force control of one gripper, by its own sensors alone.

    Args:
        config: Directions of force and position control, with their gains and limits.
        arm: Plane model of the robot's arm.
        sensor: Sensor of the gripper's wrench.
        stance: Stance of the robot; its tilt is measured later.

    Attributes:
        wrench: (3,) low-passed wrench of the gripper on the segment, plan frame [N, N, N m]; None
            without a measurement.
        stance: Stance of the gripper's robot.
    """

    def __init__(
        self, config: HybridConfig, arm: PlanarArm, sensor: GripSensor, stance: Stance
    ) -> None:
        self.stance = stance
        self.wrench: FloatArray | None = None
        self._config, self._arm, self._sensor = config, arm, sensor
        self._gives, self._speeds, self._reaches = np.array(
            [
                [config.give, config.give, config.give_turn],
                [config.speed, config.speed, config.turn_rate],
                [config.reach, config.reach, config.turn_reach],
            ]
        )
        self._angles: FloatArray | None = None
        self._begin: FloatArray | None = None
        self._correction: FloatArray | None = None

    def hold(self, seen: Observation) -> Command:
        """Return the command that holds the joint angles of the first call.

        Raises:
            RobotError: If the joint angles are missing or stale at the first call.
        """
        if self._angles is None:
            if not seen.arm_angles.usable:
                state = seen.arm_angles.validity.value
                raise RobotError(f"grip needs arm_angles, which is {state}")
            self._angles = np.array(seen.arm_angles.value, dtype=float)
        return Command(arm=self._angles.copy(), arm_mode=ArmMode.POSITION)

    def start(self, tilt: float) -> FloatArray:
        """Switch from `hold` to `command`, and return the gripper's pose (3,).

        Args:
            tilt: Pitch of the robot from now on [rad].

        Raises:
            RobotError: If `hold` has not been called.
        """
        if self._angles is None:
            raise RobotError("grip: started before it held")
        self.stance = dataclasses.replace(self.stance, tilt=tilt)
        self._begin = self.stance.to_plan(self._arm.task(self._angles[1:]))
        return self._begin.copy()

    def feel(self, seen: Observation) -> None:
        """Filter the wrench of this tick."""
        felt, config = self._sensor.felt(seen, self.stance), self._config
        if felt is not None and self.wrench is not None:
            share = config.period / (config.period + config.filter_time)
            felt = self.wrench + share * (felt - self.wrench)
        self.wrench = felt

    def command(self, target: FloatArray, rate: FloatArray) -> Command:
        """Return the arm's command; without a wrench the force corrections stay constant.

        Args:
            target: (3,) planned pose of the gripper.
            rate: (3,) rate of that pose.

        Raises:
            RobotError: If `start` has not been called.
        """
        if self._angles is None or self._begin is None:
            raise RobotError("grip: commanded before it was started")
        config = self._config
        if self._correction is None:
            self._correction = self._begin - target
        missing = np.zeros(3) if self.wrench is None else np.array(config.wanted) - self.wrench
        by_place = -self._correction / config.take_up
        moved = np.where(config.forces, self._gives * missing, by_place)
        moved = np.clip(moved, -self._speeds, self._speeds)
        corrected = self._correction + config.period * moved
        # An initial error may exceed the reach: it is allowed, but must not grow.
        bound = np.maximum(self._reaches, np.abs(self._correction))
        self._correction = np.clip(corrected, -bound, bound)
        self._angles, rates = self._moved(self._angles, target + self._correction, rate + moved)
        return Command(arm=self._angles.copy(), arm_mode=ArmMode.POSITION, arm_rates=rates)

    def _moved(
        self, angles: FloatArray, pose: FloatArray, rate: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return joints (4,) a step of Newton nearer to a gripper's pose, and their rates (4,)."""
        bends, most = angles[1:], self._config.joint_rate
        jacobian, limit = self._arm.jacobian(bends), most * self._config.period
        step = _solve(jacobian, self.stance.to_robot(pose) - self._arm.task(bends))
        moved = np.append(angles[0], bends + np.clip(step, -limit, limit))
        rates = np.clip(_solve(jacobian, self.stance.rate_to_robot(rate)), -most, most)
        return moved, np.append(0.0, rates)


def _solve(jacobian: FloatArray, motion: FloatArray) -> FloatArray:
    """Solve for the joints, damped so that a stretched arm does not jump."""
    damped = jacobian.T @ jacobian + 1e-6 * np.eye(3)
    return np.asarray(np.linalg.solve(damped, jacobian.T @ motion), dtype=float)
