"""Byte channel between a computer and its radio modem, on a serial port or in virtual time."""

import time
from collections.abc import Callable
from typing import Protocol

from twin.hardware.serial_link import SerialLink

BITS_PER_BYTE = 10  # 8N1: a start bit, eight data bits, a stop bit


class ByteChannel(Protocol):
    """Bidirectional byte channel to a modem, with its own clock."""

    def now(self) -> float:
        """Return the time of the channel's monotonic clock [s]."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes without blocking."""

    def read(self) -> bytes:
        """Return the bytes received so far, without blocking."""
        ...


class SerialChannel:
    """Channel to a real or emulated modem on a serial port.

    Args:
        link: Port of the modem, which the caller closes.
        clock: Returns the monotonic time of the channel [s].
    """

    def __init__(self, link: SerialLink, clock: Callable[[], float] = time.monotonic) -> None:
        self._link = link
        self.now = clock

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            LinkError: If the port is disconnected or does not accept them.
        """
        self._link.write(data)

    def read(self) -> bytes:
        """Return the bytes received so far.

        Raises:
            LinkError: If the port is disconnected.
        """
        return self._link.read(4096, time.monotonic())
