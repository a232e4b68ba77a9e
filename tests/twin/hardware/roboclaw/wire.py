"""RoboClaw boards for tests: behind a pseudo-terminal on the wall clock, or in virtual time."""

import contextlib
import math
import select
import time
import types
from unittest import mock

from tests.twin.hardware.serving import Served
from twin.hardware import serial_link as link
from twin.hardware.emulator.ports import PseudoTerminal
from twin.hardware.emulator.roboclaw_board import Motors, RoboClawBoard, RoboClawLine
from twin.hardware.roboclaw import client as roboclaw
from twin.hardware.roboclaw.codec import BoardCommand
from twin.hardware.serial_link import SerialLink

BAUD = 460800


class StillMotors(Motors):
    """Motors at rest, in a board whose surroundings a test sets."""

    def __init__(self):
        super().__init__([0, 0], [0.0, 0.0])
        self.logic, self.temperature = 50, 250  # [0.1 V], [0.1 deg C]


class NotedBoard(RoboClawBoard):
    """A board that notes which writes it carried out, and whose surroundings change."""

    def __init__(self, address, motors, old_firmware=False):
        self.obeyed = []
        super().__init__(address, motors, old_firmware)

    def obey(self, command, values):
        self.obeyed.append((command, tuple(values)))
        super().obey(command, values)

    def _values(self, command):
        match command:
            case BoardCommand.GET_LOGIC_VOLTAGE:
                return (self.motors.logic,)
            case BoardCommand.GET_TEMPERATURE:
                return (self.motors.temperature,)
        return super()._values(command)


def boards_on_a_line(addresses=(0x80,), old_firmware=False):
    boards = [NotedBoard(address, StillMotors(), old_firmware) for address in addresses]
    return boards, RoboClawLine(boards)


class PtyWire(Served):
    """Serves a device at a pseudo-terminal in a thread; `clock` is the device's clock."""

    def __init__(self, device, clock=time.monotonic):
        self.port = PseudoTerminal()
        self._rounds = 0
        self._device, self._clock = device, clock
        super().__init__()

    def close(self):
        self.port.close()

    def open(self):
        return SerialLink(self.port.name, BAUD)

    def settle(self):
        """Wait until the device has heard all that was sent."""
        end = self._rounds + 3
        while self._rounds < end:
            time.sleep(0.0005)

    def serve(self):
        ready, _, _ = select.select([self.port], [], [], 0.0005)
        heard = self.port.read() if ready else b""
        said = self._device.feed(heard, self._clock())
        if said:
            self.port.write(said)
        self._rounds += 1


class VirtualLink:
    """A link to a device in virtual time, which passes only while the client waits.

    `drain` is the serial link's own, so it must run under `virtual_time`.
    """

    port = "virtual"
    drain = SerialLink.drain
    _COST = 0.00002  # [s] Of a call: a line that never falls silent must not stop the clock.

    def __init__(self, device):
        self.now = 100.0
        self.sent = []  # (time, bytes)
        self._device = device
        self._heard = bytearray()

    def write(self, data):
        self.sent.append((self.now, data))
        self._heard += self._device.feed(data, self.now)

    def _take(self, most):
        return self.read(most, self.now)

    def read(self, count, deadline):
        self.now += self._COST
        self._listen()
        while len(self._heard) < count and self.now < deadline:
            self.now = min(deadline, self._next_arrival())
            self._listen()
        taken = bytes(self._heard[:count])
        del self._heard[:count]
        return taken

    def stray(self, data):
        """Let bytes come that nobody asked for."""
        self._heard += data

    def close(self):
        pass

    def _next_arrival(self):
        on_the_way = getattr(self._device, "_waiting", ())
        return on_the_way[0][0] if on_the_way else math.inf

    def _listen(self):
        self._heard += self._device.feed(b"", self.now)


@contextlib.contextmanager
def virtual_time(virtual):
    """Let the bus and the link read the time of a `VirtualLink`."""
    clock = types.SimpleNamespace(monotonic=lambda: virtual.now)
    with mock.patch.object(roboclaw, "time", clock), mock.patch.object(link, "time", clock):
        yield
