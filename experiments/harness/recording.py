"""What recordings for the rerun viewer have in common, and moving pictures."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image

from perception.geometry.arrays import FloatArray


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
