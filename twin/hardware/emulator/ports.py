"""Where emulated devices are reached: pseudo-terminals, which no network sees."""

import contextlib
import os
import pty
import tty


class PseudoTerminal:
    """A raw pseudo-terminal; the device sits on this side, the host opens `name`."""

    def __init__(self) -> None:
        """Open the pair."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.name = os.ttyname(self._slave)

    def fileno(self) -> int:
        """Return the device's end, for `select`."""
        return self._master

    def read(self) -> bytes:
        """Return what the host sent, without waiting."""
        try:
            return os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return b""

    def write(self, data: bytes) -> None:
        """Send to the host; what its full buffer does not take is lost, as on a wire."""
        if data:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)

    def unplug(self) -> None:
        """Take the port away from the host, for good; the device no longer hears anything."""
        self.close()
        self._master, self._slave = pty.openpty()

    def close(self) -> None:
        """Take the port away."""
        os.close(self._master)
        os.close(self._slave)
