"""Stereo pairs from two captures, or from one whose images hold both views side by side.

A device is read by its own thread, because OpenCV waits for the next image (up to seconds when a
camera is unplugged) and the control loop must not; the newest pair is kept. Files play at their
rate. Images are as the cameras give them: rectification is not done here.
"""

import contextlib
import functools
import glob
import re
import threading
import time
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import UnidentifiedImageError

from perception.geometry.arrays import ImageArray
from perception.geometry.files import check_picture, check_pixels
from twin.hardware.cameras import frames
from twin.hardware.serial_link import LinkError
from twin.robot import Channel, ImageChannel, Validity

Source: TypeAlias = int | str | Path
_SIDES = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
_STOP_TIME = 2.0  # [s] A capture that hangs is left behind after this.


class StereoCapture:
    """A stereo pair source."""

    def __init__(
        self,
        source: Source | tuple[Source, Source],
        max_age: float = 0.5,
        max_skew: float = 0.02,
        rate: float | None = None,
        scene_time: bool = False,
        slow_down: float = 1.0,
    ) -> None:
        """Open the captures and see that a pair can be made of them.

        Args:
            source: Device number, video file or image sequence ("left_%04d.png"): left and right,
                or one with both views side by side, the left one first. Or the file in which an
                emulator puts the pairs of its own scene (`frames`), named "....frames".
            max_age: Age from which a pair is refused [s].
            max_skew: Most time between the images of two devices [s].
            rate: Pairs a second of files [Hz]; by default their own.
            scene_time: Whether the caller's clock is that of an emulator's scene.
            slow_down: Wall-clock time over the caller's time, with pairs of an emulator.

        Raises:
            LinkError: If a capture cannot be opened, gives no image, or the sizes do not fit.
            ValueError: If a device is paired with a file, or the rate is not positive.
        """
        sources = source if isinstance(source, tuple) else (source,)
        if rate is not None and not rate > 0.0:
            raise ValueError(f"rate must be positive, got {rate}")
        devices = {isinstance(each, int) for each in sources}
        if len(devices) > 1:
            raise ValueError(f"a device and a file make no pair: {sources}")
        self._max_age = max_age
        if Path(str(source)).suffix == frames.SUFFIX:
            self._feed: _SceneFeed | _DeviceFeed | _FileFeed = _SceneFeed(
                Path(str(source)), scene_time, slow_down
            )
            return
        eyes = _Eyes(sources)
        try:
            self._feed = _DeviceFeed(eyes, max_skew) if devices == {True} else _FileFeed(eyes, rate)
        except LinkError:
            eyes.release()
            raise

    def read(self, now: float) -> Channel | None:
        """Return the newest pair; None if there is none that is new and young enough.

        Its value is (2, height, width) uint8 grey, left and right, read-only; an emulator's pair is
        drawn when that is read.

        Args:
            now: The caller's clock, on which the stamp is given [s].

        Raises:
            LinkError: If a capture has failed or gave an empty image.
        """
        taken = self._feed.newest(now)
        return None if taken is None or now - taken.stamp > self._max_age else taken

    def close(self) -> None:
        """Release the captures."""
        self._feed.close()


class _Eyes:
    """The captures of one source, and how their images make a pair."""

    def __init__(self, sources: tuple[Source, ...]) -> None:
        self.names = [f"camera {s}" if isinstance(s, int) else str(s) for s in sources]
        self._captures: list[cv2.VideoCapture] = []
        try:
            for source, name in zip(sources, self.names):
                self._captures.append(_opened(source, name))
        except LinkError:
            self.release()
            raise

    def take(self) -> tuple[ImageArray, float, float] | None:
        """Wait for the next images; return the pair, its time and its skew [s]; None at the end.

        Raises:
            LinkError: If an image is empty, of the wrong kind, or the sizes differ.
        """
        times: list[float] = []
        for capture in self._captures:
            # Both are grabbed before either is decoded, which takes longer.
            if not capture.grab():
                return None
            times.append(time.monotonic())
        views = [
            _grey(capture.retrieve(), name) for capture, name in zip(self._captures, self.names)
        ]
        return self._pair(views), times[0], times[-1] - times[0]

    def rate(self) -> float:
        """Return the images a second that the file says, or 0 [Hz]."""
        return float(self._captures[0].get(cv2.CAP_PROP_FPS))

    def release(self) -> None:
        for capture in self._captures:
            capture.release()

    def _pair(self, views: list[ImageArray]) -> ImageArray:
        if len(views) == 1:
            height, width = views[0].shape
            if width % 2:
                raise LinkError(f"{self.names[0]}: {width} columns are not two views side by side")
            pair = views[0].reshape(height, 2, width // 2).transpose(1, 0, 2).copy()
        elif views[0].shape != views[1].shape:
            sizes = " and ".join(
                f"{name}: {view.shape[1]} x {view.shape[0]}"
                for name, view in zip(self.names, views)
            )
            raise LinkError(f"the images of a pair differ in size ({sizes})")
        else:
            pair = np.stack(views)
        pair.flags.writeable = False
        return pair


class _FileFeed:
    """Pairs of files, each due at its time after the first `newest`."""

    def __init__(self, eyes: _Eyes, rate: float | None) -> None:
        self._eyes = eyes
        rate = eyes.rate() if rate is None else rate
        if not rate > 0.0:
            raise LinkError(f"{eyes.names[0]}: says no rate; give one")
        self._period = 1.0 / rate
        self._start: float | None = None
        self._count = 0
        self._next = eyes.take()
        if self._next is None:
            raise LinkError(f"{' and '.join(eyes.names)}: no image")

    def newest(self, now: float) -> Channel | None:
        """Return the latest pair that is due at `now` [s]."""
        if self._start is None:
            self._start = now
        newest: Channel | None = None
        while self._next is not None and now >= self._due() - 1e-9:
            newest = Channel(self._next[0], self._due(), Validity.MEASURED)
            self._count += 1
            self._next = None  # So that a failure does not bring the same pair again.
            self._next = self._eyes.take()
        return newest

    def close(self) -> None:
        """Release the captures."""
        self._eyes.release()

    def _due(self) -> float:
        assert self._start is not None
        return self._start + self._count * self._period


class _SceneFeed:
    """Pairs of an emulator's own scene."""

    def __init__(self, path: Path, scene_time: bool, slow_down: float) -> None:
        self._reader = frames.FrameReader(path)
        self._scene_time, self._slow_down = scene_time, slow_down

    def newest(self, now: float) -> Channel | None:
        """Return the newest pair, its time as the scene says or carried over to `now` [s]."""
        found = self._reader.newest()
        if found is None:
            return None
        carried = now - (time.monotonic() - found.moment) / self._slow_down - found.age
        stamp = found.stamp if self._scene_time else carried
        return ImageChannel.deferred(functools.partial(self._reader.fetch, found.number), stamp)

    def close(self) -> None:
        """Do nothing: only memory is held."""


class _DeviceFeed:
    """Pairs of cameras, taken by a thread of its own."""

    def __init__(self, eyes: _Eyes, max_skew: float) -> None:
        self._eyes, self._max_skew = eyes, max_skew
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._error: str | None = None
        self._newest: Channel | None = None  # Stamped by `time.monotonic`.
        if eyes.take() is None:
            raise LinkError(f"{' and '.join(eyes.names)}: no image")
        self._thread = threading.Thread(target=self._run, name="stereo capture", daemon=True)
        self._thread.start()

    def newest(self, now: float) -> Channel | None:
        """Return the newest pair, its time carried over to the clock of `now` [s]."""
        with self._lock:
            taken, self._newest = self._newest, None
            error = self._error
        if error is not None:
            raise LinkError(error)
        if taken is None:
            return None
        return taken._replace(stamp=now - (time.monotonic() - taken.stamp))

    def close(self) -> None:
        """Stop the thread, which releases the captures."""
        self._stopping.set()
        self._thread.join(_STOP_TIME)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._take()
        except (LinkError, cv2.error) as error:
            with self._lock:
                self._error = str(error)
        finally:
            self._eyes.release()

    def _take(self) -> None:
        taken = self._eyes.take()
        if taken is None:
            raise LinkError(f"{' and '.join(self._eyes.names)}: no more images; is it plugged in?")
        images, moment, skew = taken
        if skew <= self._max_skew:
            with self._lock:
                self._newest = Channel(images, moment, Validity.MEASURED)


def _opened(source: Source, name: str) -> cv2.VideoCapture:
    """Open a capture whose images are no larger than may be read.

    Raises:
        LinkError: If it cannot be opened, or its images are larger.
    """
    try:
        # OpenCV decodes a first image when it opens a file; of pictures, the header says enough.
        for path in [] if isinstance(source, int) else _pictures(source):
            with contextlib.suppress(UnidentifiedImageError):  # A video.
                check_picture(path)
        capture = cv2.VideoCapture(source if isinstance(source, int) else str(source))
        if not capture.isOpened():
            raise LinkError(f"{name}: cannot be opened")
        width, height = (capture.get(side) for side in _SIDES)
        check_pixels(name, int(width), int(height))
    except cv2.error as error:
        raise LinkError(f"{name}: cannot be opened ({error.err})") from None
    except OSError as error:
        raise LinkError(f"{error.filename}: {error.strerror}") from None
    return capture


def _pictures(source: str | Path) -> list[Path]:
    """Return the files that a source names: one, or those of a sequence; none of a network's."""
    path = Path(str(source))
    pattern = re.sub(r"%\d*d", "*", glob.escape(path.name))
    return sorted(each for each in path.parent.glob(pattern) if each.is_file())


def _grey(retrieved: tuple[bool, cv2.typing.MatLike], name: str) -> ImageArray:
    """Return (height, width) grey of what a capture retrieved.

    Raises:
        LinkError: If it is empty or not of 8 bits.
    """
    good, image = retrieved
    # OpenCV's types leave out that a failed retrieval gives None.
    array: NDArray[Any] = np.asarray(image) if good else np.empty(0, np.uint8)
    if array.size == 0:
        raise LinkError(f"{name}: empty image")
    if array.dtype != np.uint8:
        raise LinkError(f"{name}: images of {array.dtype}, needed are 8 bits")
    if array.ndim == 3 and array.shape[2] > 1:
        array = cv2.cvtColor(array, cv2.COLOR_BGR2GRAY)
    return np.asarray(array, dtype=np.uint8).reshape(array.shape[:2])
