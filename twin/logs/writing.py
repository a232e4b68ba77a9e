"""Logs of our runs as MCAP files, written as they go.

Each signal is a topic of JSON messages, ``{"stamp": seconds, "value": [...]}``; role, name, unit
and frame stand in the channel's metadata, so that `read_log` needs no mapping.
"""

import heapq
import json
import math
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.writer import Writer
from numpy.typing import ArrayLike

from twin.connect import ConnectionSettings
from twin.logs.log import Log, Role
from twin.logs.settings import SETTINGS, settings_text
from twin.loop import LoopRecorder, Tick
from twin.robot import Channel

SENSORS = {
    "wheel_speeds": ("rad/s", ""),
    "centre_angle": ("rad", ""),
    "arm_angles": ("rad", ""),
    "arm_rates": ("rad/s", ""),
    "inclinometer": ("rad", "front half"),
    "arm_base_wrench": ("N, N m", "arm base"),
    "accelerometer": ("m/s^2", "front half"),
    "gyro": ("rad/s", "front half"),
    "heading": ("rad", ""),
}
"""Unit and frame of each channel of an observation that is logged."""
CHUNK = 2**14
"""Size of what is written at once [byte]: a seventh of a second of one rover."""
_SCHEMA = {
    "type": "object",
    "properties": {
        "stamp": {"type": "number"},
        "value": {"type": "array", "items": {"type": ["number", "null"]}},
    },
}


def write_mcap(log: Log, path: Path) -> None:
    """Write any log as one of ours, which says itself what its signals are, by time.

    Raises:
        OSError: If it cannot be written.
    """
    samples = [
        [(stamp, name, row) for row, stamp in enumerate(each.stamps.tolist())]
        for name, each in log.signals.items()
    ]
    with LogWriter(path) as writer:
        for stamp, name, row in heapq.merge(*samples, key=itemgetter(0)):
            each = log.signals[name]
            writer.write(each.role, name, stamp, each.values[row], each.unit, each.frame)


class LogWriter(LoopRecorder):
    """Log of a run: what each robot measured, and the duty that was applied to it.

    A sample is logged once, when it is new. Signals are named ``robot/channel``, and
    ``robot/wheels`` and ``robot/arm``. Use it in a ``with`` statement: the file is complete when
    that ends. If the program is killed before, it lacks its end, which `twin.logs.mending.mend`
    adds, and less than the last second.

    Args:
        path: File to write, ``.mcap``.
        settings: How the robots were connected, with which a simulated run can be replayed.

    Raises:
        OSError: If it cannot be written.
    """

    def __init__(self, path: Path, settings: ConnectionSettings | None = None) -> None:
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=CHUNK)
        self._writer.start(profile="", library="fieldtwin")
        if settings is not None:
            self._writer.add_metadata(SETTINGS, {"json": settings_text(settings)})
        self._schema = self._writer.register_schema(
            "fieldtwin.Signal", "jsonschema", json.dumps(_SCHEMA).encode()
        )
        self._channels: dict[str, int] = {}
        self._last: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Complete the file."""
        self._writer.finish()
        self._stream.close()

    def record(self, tick: Tick) -> None:
        """Log what is new in a tick."""
        for robot, observation in tick.observations.items():
            for name, (unit, frame) in SENSORS.items():
                channel: Channel = getattr(observation, name)
                topic = f"{robot}/{name}"
                if channel.usable and channel.stamp != self._last.get(topic):
                    self._last[topic] = channel.stamp
                    self.write("sensor", topic, channel.stamp, channel.value, unit, frame)
        for robot, command in tick.applied.items():
            time = tick.observations[robot].time
            self.write("actuator", f"{robot}/wheels", time, command.wheels, "1", "")
            self.write("actuator", f"{robot}/arm", time, command.arm, "1", "")
        self.flush()

    def flush(self) -> None:
        """Hand on what is to be written; what is less than a chunk waits for more."""
        self._stream.flush()

    def write(
        self, role: Role, name: str, stamp: float, value: ArrayLike, unit: str, frame: str
    ) -> None:
        """Log one sample.

        Args:
            role: What it is of.
            name: Name of the actuator or sensor.
            stamp: Its time [s].
            value: (k,) numbers in SI units; NaN where there is none.
            unit: Their unit.
            frame: Frame of a vector.
        """
        if name not in self._channels:
            notes = {"role": role, "name": name, "unit": unit, "frame": frame}
            self._channels[name] = self._writer.register_channel(
                f"/{name}", "json", self._schema, metadata=notes
            )
        row = np.asarray(value, dtype=float).tolist()
        numbers = [each if math.isfinite(each) else None for each in row]
        data = json.dumps({"stamp": float(stamp), "value": numbers}).encode()
        time = max(0, round(1e9 * stamp))  # of the file, which knows no time before zero
        self._writer.add_message(self._channels[name], time, data, time)
