"""A serial port with deadlines, and what may go wrong on it."""

import contextlib
import os
import select
import time
from collections.abc import Callable

import serial

_TRIES_AT_REST = 5


class LinkError(RuntimeError):
    """A device did not answer as it must, after all retries."""


def at_rest(step: Callable[[], None]) -> None:
    """Take a step while nothing moves, where a late answer harms nobody, again if need be.

    Args:
        step: May be repeated. That a board did not answer may be because this process was held up.

    Raises:
        LinkError: If no try succeeds.
    """
    for _ in range(_TRIES_AT_REST - 1):
        with contextlib.suppress(LinkError):
            return step()
    step()


class SerialLink:
    """Bytes to and from one port; every call returns by its deadline."""

    def __init__(self, port: str, baud: int) -> None:
        """Open the port.

        Args:
            port: Device path.
            baud: Bits a second; a pseudo-terminal ignores it.

        Raises:
            LinkError: If the port cannot be opened.
        """
        self.port = port
        try:
            self._serial = serial.Serial(port, baud, timeout=0, exclusive=True)
        except (serial.SerialException, ValueError) as error:
            raise LinkError(
                f"{port}: cannot be opened ({error}); is the board plugged in?"
            ) from None

    def write(self, data: bytes) -> None:
        """Send bytes, without waiting: a port whose buffer is full is dead.

        pyserial's write fails when this process, not the port, was held up for its timeout.

        Raises:
            LinkError: If the port is gone or does not take them.
        """
        try:
            sent = os.write(self._serial.fileno(), data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise LinkError(f"{self.port}: {error}") from None
        if sent < len(data):
            raise LinkError(f"{self.port}: takes no bytes")

    def read(self, count: int, deadline: float) -> bytes:
        """Return up to `count` bytes: fewer if they are not there by `deadline`.

        Args:
            count: Bytes wanted.
            deadline: Time on the clock of `time.monotonic` [s] until which to wait; one in the past
                reads what has arrived.

        Raises:
            LinkError: If the port is gone.
        """
        received = bytearray()
        while len(received) < count:
            remaining = max(0.0, deadline - time.monotonic())
            try:
                ready, _, _ = select.select([self._serial.fileno()], [], [], remaining)
                if not ready:
                    break
                part = self._take(count - len(received))
            except OSError as error:
                raise LinkError(f"{self.port}: {error}") from None
            if not part:
                raise LinkError(f"{self.port}: is ready and gives nothing; is it unplugged?")
            received += part
        return bytes(received)

    def drain(self, quiet: float, most: float = 0.05) -> int:
        """Discard input until nothing came for `quiet` [s], but no longer than `most` [s].

        Returns:
            The number of bytes discarded.

        Raises:
            LinkError: If the port is gone.
        """
        end, count = time.monotonic() + most, 0
        while True:
            try:
                dropped = self._take(4096)
            except OSError as error:
                raise LinkError(f"{self.port}: {error}") from None
            # Twice for every call: not to wait costs no more than one look.
            if not dropped and quiet > 0.0:
                dropped = self.read(1, min(time.monotonic() + quiet, end))
            count += len(dropped)
            if not dropped or time.monotonic() >= end:
                return count

    def _take(self, most: int) -> bytes:
        """Return what is there, which may be nothing."""
        try:
            return os.read(self._serial.fileno(), most)
        except BlockingIOError:
            return b""

    def close(self) -> None:
        """Close the port."""
        self._serial.close()
