"""A log of our rovers as the ticks that their controllers saw, also while it is written."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
from mcap.records import Channel as Topic
from mcap.records import Chunk, DataEnd, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader, breakup_chunk

from perception.geometry import files
from perception.geometry.arrays import FloatArray
from twin.connect import ConnectionSettings
from twin.logs.log import LogError
from twin.logs.settings import settings_of
from twin.logs.writing import SENSORS
from twin.robot import Channel, Command, Observation, Validity, applied_command


class RoverTick(NamedTuple):
    """What one rover measured, and what was applied to it from then on.

    Attributes:
        robot: Name of the rover.
        seen: All that was measured until then.
        applied: Duty.
    """

    robot: str
    seen: Observation
    applied: Command


def _end() -> bool:
    return False


class TickStream:
    """Reads a log that `twin.logs.writing.LogWriter` writes, from its beginning.

    Args:
        path: The file, ``.mcap``.
        more: Waits for more at the end of a log that is not complete yet, and returns whether to
            look again.

    Attributes:
        settings: How the robots were connected, once the first tick is read; None for real ones.
    """

    def __init__(self, path: Path, more: Callable[[], bool] = _end) -> None:
        self._path, self._more = path, more
        self.settings: ConnectionSettings | None = None

    def __iter__(self) -> Iterator[RoverTick]:
        """Yield the ticks of all rovers.

        Raises:
            LogError: If it cannot be read, or ends early and no more is waited for.
        """
        try:
            files.check_size(self._path, files.LOG)
            with self._path.open("rb") as stream:
                yield from self._ticks(self._records(stream))
        except LogError:
            raise
        except OSError as error:
            raise LogError(f"{self._path}: {error.strerror}") from None
        except Exception as error:  # What readers of damaged files raise has no base in common.
            reason = f"{type(error).__name__} {error}"[:200]
            raise LogError(f"{self._path}: damaged: {reason}") from None

    def _records(self, stream: IO[bytes]) -> Iterator[McapRecord]:
        """Yield records as they come, those of chunks too."""
        end = 0
        while True:
            stream.seek(end)
            reader = StreamReader(stream, skip_magic=end > 0, emit_chunks=True)
            # What the reader raises at the end of what there is has no type of its own.
            with contextlib.suppress(Exception):
                for record in reader.records:
                    end = stream.tell()
                    if isinstance(record, DataEnd):
                        return
                    yield record
            if not self._more():
                raise LogError(
                    f"{self._path}: damaged: it ends early; log --mend keeps what was written"
                )

    def _ticks(self, records: Iterator[McapRecord]) -> Iterator[RoverTick]:
        topics: dict[int, str] = {}
        seen: dict[str, dict[str, Channel]] = {}
        wheels: dict[str, FloatArray] = {}
        for record in records:
            for each in breakup_chunk(record) if isinstance(record, Chunk) else [record]:
                if isinstance(each, Topic):
                    topics[each.id] = each.metadata.get("name", each.topic.removeprefix("/"))
                elif isinstance(each, Metadata):
                    self.settings = settings_of(each) or self.settings
                elif isinstance(each, Message):
                    robot, _, name = topics[each.channel_id].rpartition("/")
                    stamp, value = _sample(each.data)
                    if name == "wheels":
                        wheels[robot] = value
                    elif name in SENSORS:
                        channel = Channel(value, stamp, Validity.MEASURED)
                        seen.setdefault(robot, {})[name] = channel
                    elif name == "arm" and robot in wheels:
                        latest = Observation(stamp, **seen.get(robot, {}))
                        yield RoverTick(robot, latest, applied_command(wheels[robot], value))


def _sample(data: bytes) -> tuple[float, FloatArray]:
    told = json.loads(data)
    row = [float("nan") if each is None else each for each in told["value"]]
    return float(told["stamp"]), np.array(row, dtype=float)
