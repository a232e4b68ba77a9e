"""What the experiments' recordings for the rerun viewer have in common."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

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
