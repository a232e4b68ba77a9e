"""Two rovers drive and tell each other where they are, over the emulated radio."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from controllers.motion.driving import Odometry, SkidSteer
from models.compose import FieldConfig, RobotPlacement
from models.datasheets import ROVER
from twin.connect import connect
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.framed_radio import FramedLink
from twin.hardware.radio.messages import PoseMessage, WrenchMessage, unpack
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop
from twin.record import Recorder
from twin.robot import ArmMode, Command, Observation, WheelMode

ROBOTS = ("rover1", "rover2")
SEND_PERIOD = 0.25  # [s]
SWING = 0.2  # [rad] of the shoulder, so that the wrench has something to tell
SWING_RATE = 2.0  # [rad/s]
DRIFT = 0.1  # Assumption: standard deviation of dead reckoning, share of the way
# Share of the turn of rolling wheels that skidding leaves; fitted to one simulated drive.
TURN_SHARE = 0.56
WHEEL_SPEEDS = {"rover1": (1.6, 3.4), "rover2": (3.4, 1.6)}  # left and right [rad/s]
FIELD = FieldConfig(texture_pixels=64)
PLACEMENTS = (RobotPlacement("rover1"), RobotPlacement("rover2", (1.5, 0.0)))


def pose_message(odometry: Odometry, robot: int, observation: Observation) -> bytes:
    """Return the pose of a rover as it is sent.

    Args:
        odometry: Of the rover.
        robot: Its number.
        observation: Its latest.
    """
    tilt = observation.inclinometer
    pitch, roll = map(float, tilt.value) if tilt.usable else (0.0, 0.0)
    position = float(odometry.place[0]), float(odometry.place[1]), 0.0
    attitude = pitch, roll, odometry.yaw
    return PoseMessage(robot, observation.time, position, attitude, DRIFT * odometry.way).pack()


@dataclasses.dataclass
class _Knowledge:
    """What one rover sent, and what it knows of the other, tick by tick or message by message."""

    sent: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    received: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    forces: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    measured: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    age: list[float] = dataclasses.field(default_factory=list)
    bytes_sent: list[int] = dataclasses.field(default_factory=list)
    newest: float = math.nan


class _Rover:
    """One rover: drives, dead-reckons, sends and listens; it sees its own observation only."""

    def __init__(self, placement: RobotPlacement, number: int, link: FramedLink) -> None:
        self.name = placement.name
        self.link = link
        self.knowledge = _Knowledge()
        self._number = number
        steer = SkidSteer(ROVER.wheel_radius, ROVER.half_track, TURN_SHARE)
        self._odometry = Odometry(steer, placement.position, placement.yaw)
        self._arm: np.ndarray | None = None
        self._next_send = 0.0
        self._before: float | None = None

    def step(self, seen: Observation) -> Command:
        """Do one tick."""
        if self._before is not None:
            self._odometry.update(seen, seen.time - self._before)
        self._before = seen.time
        if seen.time >= self._next_send - 1e-9:
            self._next_send += SEND_PERIOD
            self._send(seen)
        self._listen(seen.time)
        return self._drive(seen)

    def _send(self, seen: Observation) -> None:
        place = self._odometry.place
        self.knowledge.sent.append((seen.time, float(place[0]), float(place[1])))
        self.link.send_latest(pose_message(self._odometry, self._number, seen))
        wrench = seen.arm_base_wrench
        if wrench.usable:  # A stale or missing wrench is not told as if it were one.
            fx, fy, fz, mx, my, mz = map(float, wrench.value)
            message = WrenchMessage(self._number, wrench.stamp, (fx, fy, fz), (mx, my, mz))
            self.link.send_latest(message.pack())
            self.knowledge.measured.append((wrench.stamp, fz))

    def _listen(self, now: float) -> None:
        known = self.knowledge
        for data in self.link.poll().messages:
            message = unpack(data)
            if isinstance(message, PoseMessage):
                known.newest = message.time
                known.received.append((now, message.time, *message.position[:2]))
            elif isinstance(message, WrenchMessage):
                known.forces.append((now, message.time, message.force[2]))
        known.age.append(now - known.newest)
        known.bytes_sent.append(self.link.statistics.bytes_sent)

    def _drive(self, seen: Observation) -> Command:
        if self._arm is None and seen.arm_angles.usable:
            self._arm = seen.arm_angles.value.astype(float)
        if self._arm is None:
            return Command()
        left, right = WHEEL_SPEEDS[self.name]
        arm = self._arm.copy()
        arm[1] += SWING * math.sin(SWING_RATE * seen.time)
        wheels = np.array([left, right, left, right])
        return Command(wheels, arm, WheelMode.SPEED, ArmMode.POSITION)


class Conversation:
    """Both rovers' controllers, with the radio between them in the time of their observations."""

    def __init__(self, config: ModemConfig, rng: np.random.Generator) -> None:
        """Place the modems; `rng` draws byte errors and sessions."""
        self._modems = VirtualModems(config, rng)
        links = [FramedLink(end, rng) for end in self._modems.ends]
        self.rovers = [_Rover(p, i + 1, link) for i, (p, link) in enumerate(zip(PLACEMENTS, links))]

    def reset(self) -> None:
        """Nothing is learnt that a new run could not be made for."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Let each rover see itself, and hear the other by radio."""
        self._modems.time = max(seen.time for seen in observations.values())
        return {rover.name: rover.step(observations[rover.name]) for rover in self.rovers}


class _Truth(LoopRecorder):
    """Keeps where the rovers are, for the figure only."""

    def __init__(self, data: Any) -> None:
        self.rows: list[list[float]] = []
        self._bodies = [data.body(f"{name}/chassis") for name in ROBOTS]

    def record(self, tick: Tick) -> None:
        """Keep one tick."""
        self.rows.append([tick.time, *(float(x) for body in self._bodies for x in body.xpos[:2])])


def converse(
    config: ModemConfig, duration: float, seed: int, robot: str = "sim", record: str | None = None
) -> dict[str, Any]:
    """Let both rovers drive and talk.

    Args:
        config: The modems.
        duration: Of the drive [s].
        seed: Of sensor noise, byte errors and sessions.
        robot: Which robots.
        record: File for a recording, if any.

    Returns:
        ``truth`` (n, 5): time and both rovers' x, y; and by robot name what `_Knowledge` holds, as
        arrays, with ``missed`` (latest values that the numbers' gaps show as lost).
    """
    sensors, radio = np.random.SeedSequence(seed).spawn(2)
    conversation = Conversation(config, np.random.default_rng(radio))
    with contextlib.ExitStack() as stack:
        noise = int(sensors.generate_state(1)[0])
        connection = stack.enter_context(connect(robot, robots=PLACEMENTS, field=FIELD, seed=noise))
        assert connection.simulation is not None
        truth = _Truth(connection.simulation.data)
        recorders: list[LoopRecorder] = [truth]
        if record is not None:
            recorders.append(
                stack.enter_context(Recorder(record, connection.robots, connection.simulation))
            )
        run_loop(connection.robots, [conversation], connection.clock, recorders, duration)
    result: dict[str, Any] = {"truth": np.array(truth.rows)}
    for rover in conversation.rovers:
        known = dataclasses.asdict(rover.knowledge)
        arrays = {name: np.array(value) for name, value in known.items()}
        result[rover.name] = {**arrays, "missed": rover.link.statistics.latest_missed}
    return result
