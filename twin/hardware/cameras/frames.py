"""A file in memory through which an emulator hands on the stereo pairs of its scene.

It holds the number of the newest pair, when it was exposed and announced, and two counters that
differ while these are being written. Images are drawn when they are asked for: the host writes the
number of the pair that it wants, the emulator draws that pair and writes the same number beside the
images. Who knows the file's name reads it, one host at a time.
"""

import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from perception.geometry.arrays import ImageArray
from perception.geometry.files import check_pixels
from twin.hardware.serial_link import LinkError
from twin.robot import RobotError

SUFFIX = ".frames"
_MAGIC, _VERSION = b"FTFRAMES", 3
_HEADER = np.dtype(
    [
        ("magic", "S8"),
        ("version", "<u4"),
        ("height", "<u4"),
        ("width", "<u4"),
        ("unplugged", "<u4"),
        ("closed", "<u8"),
        ("begun", "<u8"),
        ("ended", "<u8"),
        ("stamp", "<f8"),
        ("age", "<f8"),
        ("moment", "<f8"),
        ("wanted", "<u8"),
        ("drawn", "<u8"),
        ("lost", "<u8"),
    ]
)
_TRIES = 5
"""Readings of a header that is overwritten meanwhile, before it is left for the next cycle."""
_KEPT = 16
"""Newest pairs that can still be drawn."""
_PATIENCE = 5.0
"""Longest wait for a pair to be drawn [s]."""


class Taken(NamedTuple):
    """A pair that can be fetched.

    Attributes:
        number: Number of the pair.
        stamp: When it was taken, in the scene's time [s].
        age: Time from then until it was announced, in the scene's time [s].
        moment: When it was announced, on the clock of `time.monotonic` [s].
    """

    number: int
    stamp: float
    age: float
    moment: float


class FrameWriter:
    """The emulator's end of the file, made without a pair.

    Args:
        path: File to make; its name ends in ``.frames``.
        height: Rows of an image [px].
        width: Columns of an image [px].
    """

    def __init__(self, path: Path, height: int, width: int) -> None:
        self.path = path
        size = _HEADER.itemsize + 2 * height * width
        raw = np.memmap(path, np.uint8, "w+", shape=(size,))
        self._header, self._images = _parts(raw, height, width)
        header = self._header
        header["version"], header["height"], header["width"] = _VERSION, height, width
        header["magic"] = _MAGIC
        self._kept: OrderedDict[int, Callable[[], ImageArray | Future[ImageArray]]] = OrderedDict()
        self._drawing: tuple[int, Future[ImageArray]] | None = None

    def announce(
        self,
        stamp: float,
        draw: Callable[[], ImageArray | Future[ImageArray]],
        age: float = 0.0,
    ) -> None:
        """Say that there is a new pair.

        Args:
            stamp: When it was taken, in the scene's time [s].
            draw: Returns its images (2, height, width), at once or in future; asked when the host
                wants them.
            age: Time since it was taken, in the scene's time [s].
        """
        header = self._header
        header["begun"] += 1
        number = int(header["begun"])
        self._kept[number] = draw
        if len(self._kept) > _KEPT:
            self._kept.popitem(last=False)
        header["stamp"], header["age"], header["moment"] = stamp, age, time.monotonic()
        header["ended"] = number

    def serve(self) -> None:
        """Draw the pair that the host waits for, if it waits."""
        header = self._header
        wanted = int(header["wanted"])
        if wanted in (int(header["drawn"]), int(header["lost"])):
            return
        if self._drawing is not None and self._drawing[0] == wanted:
            images = self._drawing[1]
        else:
            draw = self._kept.get(wanted)
            if draw is None:
                header["lost"] = wanted
                return
            images = draw()
        if isinstance(images, Future):
            self._drawing = wanted, images
            if not images.done():
                return
            images = images.result()
        self._images[:] = images
        header["drawn"] = wanted

    def unplug(self, gone: bool = True) -> None:
        """Say whether the cameras are gone."""
        self._header["unplugged"] = int(gone)

    def close(self) -> None:
        """Say that nothing will be drawn any more."""
        self.unplug()
        self._header["closed"] = 1


class FrameReader:
    """The host's end of the file.

    Args:
        path: File that an emulator made.

    Raises:
        LinkError: If it is not there, or no emulator's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            raw = np.memmap(path, np.uint8, "r+")
        except (OSError, ValueError) as error:
            raise LinkError(f"{path}: cannot be opened ({error})") from None
        if raw.size < _HEADER.itemsize:
            raise LinkError(f"{path}: no stereo pairs of an emulator")
        head = raw[: _HEADER.itemsize].view(_HEADER)[0]
        height, width = int(head["height"]), int(head["width"])
        known = bytes(head["magic"]) == _MAGIC and head["version"] == _VERSION
        if not known or raw.size != _HEADER.itemsize + 2 * height * width:
            raise LinkError(f"{path}: no stereo pairs of an emulator")
        try:
            check_pixels(path, width, height)
        except OSError as error:
            raise LinkError(f"{path}: {error.strerror}") from None
        self._header, self._images = _parts(raw, height, width)
        self._count = 0

    def newest(self) -> Taken | None:
        """Return the newest pair not returned before, None if there is none; draws nothing.

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
            taken = Taken(count, *(float(header[name]) for name in ("stamp", "age", "moment")))
            if int(header["begun"]) == count:
                self._count = count
                return taken
        return None

    def fetch(self, number: int) -> ImageArray:
        """Wait for a pair to be drawn, and return it (2, height, width), read-only.

        Args:
            number: Number of a pair that `newest` returned.

        Raises:
            RobotError: If the emulator is gone, or keeps the pair no more.
        """
        header, latest = self._header, time.monotonic() + _PATIENCE
        header["wanted"] = number
        while int(header["drawn"]) != number:
            if int(header["lost"]) == number:
                raise RobotError(f"{self.path}: pair {number} is too old to be drawn")
            if header["closed"] or time.monotonic() > latest:
                raise RobotError(f"{self.path}: the emulator is gone, and pair {number} with it")
            time.sleep(2e-4)
        images = self._images.copy()
        images.flags.writeable = False
        return images


def _parts(raw: Any, height: int, width: int) -> tuple[Any, ImageArray]:
    """Return the header and the pair (2, height, width) in the bytes of a file."""
    plain = np.asarray(raw)
    size = _HEADER.itemsize
    return plain[:size].view(_HEADER)[0], plain[size:].reshape(2, height, width)
