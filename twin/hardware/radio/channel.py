"""The line between a computer and its radio modem, on a serial port or in virtual time."""

import time
from collections.abc import Callable
from typing import Protocol

from twin.hardware.serial_link import SerialLink

BITS_PER_BYTE = 10  # 8N1: a start bit, eight data bits, a stop bit


class ByteChannel(Protocol):
    """A line to and from a modem, with its own clock."""

    def now(self) -> float:
        """Time of the channel's clock [s], never going back."""
        ...

    def write(self, data: bytes) -> None:
        """Send bytes, without waiting."""

    def read(self) -> bytes:
        """Return what has come, without waiting."""
        ...


class SerialChannel:
    """A real modem, or an emulated one, on a serial port.

    Args:
        link: Port of the modem, which the caller closes.
        clock: Returns the time that the link keeps [s].
    """

    def __init__(self, link: SerialLink, clock: Callable[[], float] = time.monotonic) -> None:
        self._link = link
        self.now = clock

    def write(self, data: bytes) -> None:
        """Send bytes.

        Raises:
            LinkError: If the port is gone or does not take them.
        """
        self._link.write(data)

    def read(self) -> bytes:
        """Return what has come.

        Raises:
            LinkError: If the port is gone.
        """
        return self._link.read(4096, time.monotonic())
