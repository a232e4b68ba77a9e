"""What a run of robots leaves behind, recordings for the rerun viewer, and moving pictures."""

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image

from experiments.harness.contract import LoggedOptions
from experiments.harness.output import Output
from perception.geometry.arrays import FloatArray
from twin.connect import Connection, ConnectionSettings
from twin.logs.writing import LogWriter
from twin.loop import LoopRecorder
from twin.recording.record import Recorder


@dataclasses.dataclass(frozen=True)
class RunFiles:
    """Which files of a run are written.

    Attributes:
        recording: Recording for the rerun viewer, ``.rrd``; empty for none.
        log: Log, ``.mcap``; empty for none.
    """

    recording: str = ""
    log: str = ""

    @classmethod
    def of(cls, options: LoggedOptions, output: Output) -> "RunFiles":
        """Return those that options ask for, in the output's folder."""
        recording = str(output.file("run.rrd")) if options.record else ""
        return cls(recording, str(output.file("run.mcap")) if options.log else "")

    def __bool__(self) -> bool:
        """Whether there is any."""
        return bool(self.recording or self.log)

    @contextlib.contextmanager
    def logged(self, settings: ConnectionSettings | None) -> Iterator[list[LoopRecorder]]:
        """Yield what writes the log, if there is to be one.

        Args:
            settings: How the robots were connected; None for a scene that no settings describe.
        """
        if not self.log:
            yield []
            return
        with LogWriter(Path(self.log), settings) as writer:
            yield [writer]

    @contextlib.contextmanager
    def written(self, connection: Connection) -> Iterator[list[LoopRecorder]]:
        """Yield what writes both, the recording in its usual layout."""
        with self.logged(connection.settings) as recorders:
            if not self.recording:
                yield recorders
                return
            with Recorder(self.recording, connection.robots, connection.simulation) as recorder:
                yield [recorder, *recorders]


NO_FILES = RunFiles()
"""A run of which nothing is kept."""


@contextlib.contextmanager
def recording(path: Path, blueprint: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Open a recording, and write all of it to its file at the end.

    Args:
        path: File to write, ``.rrd``.
        blueprint: Layout in which the viewer shows the recording.
    """
    stream = rr.RecordingStream("fieldtwin")
    stream.save(path)
    stream.send_blueprint(blueprint)
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()


def viridis(values: FloatArray) -> NDArray[np.uint8]:
    """Return (N, 3) colours from dark to bright of values (N,) from 0 to 1, clipped."""
    colours = np.asarray(matplotlib.colormaps["viridis"](np.clip(values, 0.0, 1.0)))
    return (255 * colours[:, :3]).astype(np.uint8)


def closed(corners: FloatArray) -> FloatArray:
    """Return the corners (K + 1, D) of a closed line around a polygon (K, D)."""
    return np.vstack([corners, corners[:1]])


def write_gif(
    path: Path, frames: Sequence[Image.Image], palette: Image.Image, frame: float, last: float
) -> None:
    """Write a moving picture that repeats itself.

    Args:
        path: File to write, ``.gif``.
        frames: Pictures of one size.
        palette: Picture whose colours all of them get.
        frame: Duration of a picture [ms].
        last: Duration of the last one [ms].
    """
    first, *rest = (each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames)
    times = [round(frame)] * len(rest) + [round(last)]
    first.save(path, save_all=True, append_images=rest, duration=times, loop=0)
