"""A file in memory through which an emulator hands on the stereo pairs of its scene.

It holds the newest pair, its time in the scene and on the machine's clock, and two counters that
differ while a pair is being written. Nothing listens: who knows the file's name reads it.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.hardware.serial_link import LinkError

ImageArray = NDArray[np.uint8]

SUFFIX = ".frames"
_MAGIC, _VERSION = b"FTFRAMES", 1
_HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u4"),
        ("height", "<u4"),
        ("width", "<u4"),
        ("unplugged", "<u4"),
        ("begun", "<u8"),
        ("ended", "<u8"),
        ("stamp", "<f8"),
        ("moment", "<f8"),
    ]
)
_TRIES = 5
"""Copies of a pair that is overwritten meanwhile, before it is left for the next cycle."""


class Taken(NamedTuple):
    """A pair that was read.

    Attributes:
        images: (2, height, width) uint8, left and right, read-only.
        stamp: When it was taken, in the scene's time [s].
        moment: When it was written, on the clock of `time.monotonic` [s].
        skipped: Pairs since the one read before that were never read.
    """

    images: ImageArray
    stamp: float
    moment: float
    skipped: int


class FrameWriter:
    """The emulator's end of the file."""

    def __init__(self, path: Path, height: int, width: int) -> None:
        """Make the file, without a pair.

        Args:
            path: It; its name ends in ``.frames``.
            height: Rows of an image.
            width: Columns.
        """
        self.path = path
        size = _HEADER.itemsize + 2 * height * width
        raw = np.memmap(path, np.uint8, "w+", shape=(size,))
        self._header, self._images = _parts(raw, height, width)
        self._header["version"], self._header["height"], self._header["width"] = (
            _VERSION,
            height,
            width,
        )
        self._header["magic"] = _MAGIC

    def write(self, images: ImageArray, stamp: float) -> None:
        """Put a pair (2, height, width) in the place of the one before.

        Args:
            images: It.
            stamp: When it was taken, in the scene's time [s].
        """
        header = self._header
        header["begun"] += 1
        self._images[:] = images
        header["stamp"], header["moment"] = stamp, time.monotonic()
        header["ended"] = header["begun"]

    def unplug(self, gone: bool = True) -> None:
        """Say whether the cameras are gone."""
        self._header["unplugged"] = int(gone)


class FrameReader:
    """The host's end of the file."""

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            LinkError: If it is not there, or no emulator's.
        """
        self.path = path
        try:
            raw = np.memmap(path, np.uint8, "r")
        except (OSError, ValueError) as error:
            raise LinkError(f"{path}: cannot be opened ({error})") from None
        if raw.size < _HEADER.itemsize:
            raise LinkError(f"{path}: no stereo pairs of an emulator")
        head = raw[: _HEADER.itemsize].view(_HEADER)[0]
        height, width = int(head["height"]), int(head["width"])
        known = bytes(head["magic"]) == _MAGIC and head["version"] == _VERSION
        if not known or raw.size != _HEADER.itemsize + 2 * height * width:
            raise LinkError(f"{path}: no stereo pairs of an emulator")
        self._header, self._images = _parts(raw, height, width)
        self._count = 0

    def newest(self) -> Taken | None:
        """Return the newest pair not returned before, None if there is none.

        Raises:
            LinkError: If the cameras are gone.
        """
        header = self._header
        if header["unplugged"]:
            raise LinkError(f"{self.path}: no more images; is it plugged in?")
        for _ in range(_TRIES):
            count = int(header["ended"])
            if count == self._count:
                return None
            images = self._images.copy()
            stamp, moment = float(header["stamp"]), float(header["moment"])
            if int(header["begun"]) == count:
                skipped = count - self._count - 1
                self._count = count
                images.flags.writeable = False
                return Taken(images, stamp, moment, skipped)
        return None


def _parts(raw: Any, height: int, width: int) -> tuple[Any, ImageArray]:
    """Return the header and the pair (2, height, width) in the bytes of a file."""
    plain = np.asarray(raw)
    size = _HEADER.itemsize
    return plain[:size].view(_HEADER)[0], plain[size:].reshape(2, height, width)
