"""Two rovers drive and share their poses over the emulated radio."""

import contextlib
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from controllers.mapping.pose_sharing import PoseSharing, SharingConfig
from controllers.motion.driving import SkidSteer
from experiments.harness.recording import NO_FILES, RunFiles
from models.compose import FieldConfig, RobotPlacement
from models.datasheets import ROVER
from perception.geometry.arrays import FloatArray
from twin.connect import LineConfig, connect
from twin.hardware.emulator.modem import ModemConfig
from twin.hardware.radio.framed_radio import FramedLink
from twin.loop import LoopRecorder, Tick
from twin.loop import run as run_loop

ROBOTS = ("rover1", "rover2")
SEND_PERIOD = SharingConfig.send_period
# Share of the turn of rolling wheels that skidding leaves; fitted to one simulated drive.
TURN_SHARE = 0.56
WHEEL_SPEEDS = {"rover1": (1.6, 3.4), "rover2": (3.4, 1.6)}  # left and right [rad/s]
FIELD = FieldConfig(texture_pixels=64)
PLACEMENTS = (RobotPlacement("rover1"), RobotPlacement("rover2", (1.5, 0.0)))


@dataclasses.dataclass(frozen=True)
class Conversed:
    """What one rover sent and received.

    Attributes:
        sent: (p, 3) time [s] and x, y [m] of each pose sent.
        received: (q, 4) time of arrival [s], time of the pose [s] and x, y [m].
        forces: (r, 3) time of arrival [s], time of the force [s] and vertical force [N].
        measured: (s, 2) time [s] and vertical force [N] of each wrench sent.
        age: (n,) age of the newest pose received at every tick [s].
        bytes_sent: (n,) bytes sent by each tick.
        missed: Latest values lost, by the gaps in their numbers.
    """

    sent: FloatArray
    received: FloatArray
    forces: FloatArray
    measured: FloatArray
    age: FloatArray
    bytes_sent: FloatArray
    missed: int


@dataclasses.dataclass(frozen=True)
class Conversation:
    """A drive of both rovers.

    Attributes:
        truth: (n, 5) time [s] and both rovers' true x, y [m].
        rovers: Messages sent and received by each rover, by name.
    """

    truth: FloatArray
    rovers: dict[str, Conversed]


class _Truth(LoopRecorder):
    """Records the rovers' true positions and their bytes sent, for the figures only."""

    def __init__(self, data: Any, links: Mapping[str, FramedLink]) -> None:
        self.rows: list[list[float]] = []
        self.bytes_sent: list[list[int]] = []
        self._bodies = [data.body(f"{name}/chassis") for name in ROBOTS]
        self._links = links

    def record(self, tick: Tick) -> None:
        """Record one tick."""
        self.rows.append([tick.time, *(float(x) for body in self._bodies for x in body.xpos[:2])])
        self.bytes_sent.append([self._links[name].bytes_sent for name in ROBOTS])


def converse(
    modems: ModemConfig, duration: float, seed: int, files: RunFiles = NO_FILES
) -> Conversation:
    """Let both rovers drive and share their poses.

    Args:
        modems: Properties of the simulated radio.
        duration: Duration of the drive [s].
        seed: Random seed of sensor noise, byte errors and sessions.
        files: Files of the run.
    """
    sensors, radio = np.random.SeedSequence(seed).spawn(2)
    noise = int(sensors.generate_state(1)[0])
    lines = LineConfig(modems=modems, radio_rng=np.random.default_rng(radio))
    with contextlib.ExitStack() as stack:
        connection = stack.enter_context(
            connect("sim", robots=PLACEMENTS, field=FIELD, seed=noise, lines=lines)
        )
        assert connection.simulation is not None
        links = {n: link for n, link in connection.links.items() if isinstance(link, FramedLink)}
        steer = SkidSteer(ROVER.wheel_radius, ROVER.half_track, TURN_SHARE)
        controllers = [
            PoseSharing(
                SharingConfig(p.name, number, steer, p.position, p.yaw, WHEEL_SPEEDS[p.name]),
                links[p.name],
            )
            for number, p in enumerate(PLACEMENTS, 1)
        ]
        truth = _Truth(connection.simulation.data, links)
        recorders = stack.enter_context(files.written(connection))
        run_loop(connection.robots, controllers, connection.clock, [truth, *recorders], duration)
    counts = np.array(truth.bytes_sent)
    rovers: dict[str, Conversed] = {}
    for name, controller, column in zip(ROBOTS, controllers, counts.T, strict=True):
        log = {key: np.array(value) for key, value in vars(controller.log).items()}
        missed = links[name].latest_missed
        rovers[name] = Conversed(**log, bytes_sent=column, missed=missed)
    return Conversation(np.array(truth.rows), rovers)
