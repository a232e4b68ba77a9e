"""Client for several RoboClaw boards on one serial line, with checked replies and deadlines.

The manufacturer's and other public clients are not used: they block for seconds after a lost reply,
accept any byte as an acknowledgement, wrap a duty that is out of range (the motor reverses) and
read encoders as unsigned. Here a value is valid only if its checksum matches, and every call ends
within `BusTiming.call`.
"""

import contextlib
import dataclasses
import itertools
import threading
import time
from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError, SerialLink

T = TypeVar("T")

# Sent in turn to verify that the line is clear: a reply identifies its probe, unless it is late by
# a whole round, about 140 ms. All firmware versions reply alike, and the servo cycle does not use
# these commands.
_PROBES = (
    BoardCommand.GET_TEMPERATURE,
    BoardCommand.GET_ENCODER_1,
    BoardCommand.GET_ENCODER_2,
    BoardCommand.GET_SPEED_1,
    BoardCommand.GET_SPEED_2,
    BoardCommand.GET_VELOCITY_PID_1,
    BoardCommand.GET_VELOCITY_PID_2,
    BoardCommand.GET_LOGIC_VOLTAGE,
)


@dataclasses.dataclass(frozen=True)
class BusTiming:
    """Deadlines of the bus [s].

    Attributes:
        reply: Time from a request to the end of its reply.
        quiet: Silence after a failure; longer than `codec.PACKET_GAP`, so that the boards discard
            a partial packet.
        call: Time from the start of a call to its end, including all retries.
        ask: Time for which `halt` asks again whether the motors are at zero duty.
    """

    reply: float = 0.006
    quiet: float = 0.0115
    call: float = 0.045
    ask: float = 0.03


@dataclasses.dataclass
class BusStatistics:
    """Counts of the bus's transactions and errors.

    Attributes:
        transactions: Number of calls.
        retries: Number of requests sent again.
        silent: Number of requests without a reply, or with a partial one.
        refused: Number of replies with a wrong checksum or acknowledgement, or trailing bytes.
        stray: Number of unsolicited bytes.
        failures: Number of calls that ended with a `LinkError`.
    """

    transactions: int = 0
    retries: int = 0
    silent: int = 0
    refused: int = 0
    stray: int = 0
    failures: int = 0


@dataclasses.dataclass(frozen=True)
class Halt:
    """What is known of boards after `RoboClawBus.halt`.

    Attributes:
        confirmed: Addresses of the boards that answered with zero duty.
        sent: Whether the port took zero duty for all boards at least once.
    """

    confirmed: frozenset[int]
    sent: bool


class RoboClawBus:
    """Boards at several addresses behind one port.

    Any thread may call `halt`; all else is for one thread at a time.
    """

    def __init__(self, link: SerialLink, timing: BusTiming | None = None) -> None:
        """Initialize from an open port.

        Args:
            link: Serial port, which `close` closes.
            timing: Deadlines of the bus.
        """
        self.statistics = BusStatistics()
        self._link = link
        self._timing = timing or BusTiming()
        # After a failure a reply may still be pending; no reply is accepted until it has passed.
        self._suspect = True
        self._probes = itertools.cycle(_PROBES)
        self._status_length: dict[int, int] = {}
        self._sending = threading.Lock()
        self._halted = False
        # Boards to which zeros are repeated, and until when, on the clock of `time.monotonic` [s].
        self._repeated: tuple[int, ...] = ()
        self._repeat_until = 0.0
        # Until when nothing else is sent; None for no ban.
        self._mute_until: float | None = None

    def read(self, address: int, command: BoardCommand) -> tuple[int, ...]:
        """Send a read command, and return the values of the reply.

        Args:
            address: Address of the board.
            command: A key of `codec.READS`.

        Raises:
            LinkError: If no valid answer came in time.
        """
        length = codec.reply_length(command)

        def exchange(deadline: float) -> tuple[int, ...] | None:
            reply = self._ask(address, command, length, deadline)
            return self._judge(reply, length, codec.decode_reply(address, command, reply))

        return self._call(f"{command.name} of board {address:#x}", address, command, exchange)

    def write(self, address: int, command: BoardCommand, *values: int) -> None:
        """Send a write command, and wait for the acknowledgement.

        Args:
            address: Address of the board.
            command: A key of `codec.WRITES`.
            values: Payload of the command.

        Raises:
            ValueError: If a value does not fit its field; nothing was sent.
            LinkError: If it was not acknowledged in time; the board may have executed it.
        """
        packet = codec.encode_write(address, command, *values)

        def exchange(deadline: float) -> bool | None:
            self._send(packet, drives=command in codec.DRIVES)
            reply = self._link.read(1, deadline)
            return self._judge(reply, 1, reply == bytes((codec.ACKNOWLEDGE,)) or None)

        self._call(f"{command.name} to board {address:#x}", address, command, exchange)

    def status(self, address: int) -> Status:
        """Return a board's status, in the layout of any firmware version.

        Raises:
            LinkError: If no valid answer came in time.
        """
        command = BoardCommand.GET_STATUS

        def exchange(deadline: float) -> Status | None:
            length = self._status_length.get(address, 6)
            reply = self._ask(address, command, length, deadline)
            status = codec.decode_status_reply(address, reply)
            if status is None:
                self._status_length.pop(address, None)  # The firmware may have changed.
            else:
                self._status_length[address] = len(reply)
            return self._judge(reply, len(reply) or length, status)

        return self._call(f"status of board {address:#x}", address, command, exchange)

    def version(self, address: int) -> str:
        """Return the firmware version string that a board reports.

        Raises:
            LinkError: If no valid answer came in time.
        """
        command = BoardCommand.GET_VERSION

        def exchange(deadline: float) -> str | None:
            self._send(codec.encode_read(address, command))
            reply = b""
            while not reply.endswith(codec.VERSION_END) and len(reply) < codec.LONGEST_VERSION:
                byte = self._link.read(1, deadline)
                if not byte:
                    break
                reply += byte
            reply += self._link.read(2, deadline)
            payload = codec.checked(address, command, reply)
            text = None if payload is None else payload.decode("ascii", "replace").rstrip("\n\0")
            return self._judge(reply, len(reply) or 1, text)

        return self._call(f"version of board {address:#x}", address, command, exchange)

    def send(self, address: int, command: BoardCommand, *values: int) -> None:
        """Send a write command, and do not wait for the acknowledgement.

        Raises:
            ValueError: As `write`.
            LinkError: If the port does not take it; the board may have executed it all the same.
        """
        self._suspect = True
        self._send(codec.encode_write(address, command, *values), command in codec.DRIVES)

    def halt(self, addresses: Sequence[int], timeout: float) -> Halt:
        """Stop all motors, whether or not any board answers.

        Zero duty is sent to all boards at once, and read back. If a board does not confirm it,
        nothing is sent from then on but zero duty by `keep_halted`: questions would feed the
        timeout that is to stop the board. Motors are not driven before `resume`.

        Args:
            addresses: Addresses of the boards, those that are probably dead last.
            timeout: Serial timeout of the boards, on the wall clock [s].
        """
        with self._sending:
            self._halted, self._repeated, self._mute_until = True, (), None
        end = time.monotonic() + self._timing.ask
        confirmed: set[int] = set()
        sent = False
        while self._send_zeros(addresses):
            sent = True
            confirmed |= {a for a in addresses if a not in confirmed and self._at_zero(a)}
            if confirmed.issuperset(addresses):
                return Halt(frozenset(confirmed), sent)
            if time.monotonic() >= end:
                break
        with self._sending:
            self._repeated = tuple(addresses)
            self._repeat_until = time.monotonic() + timeout + self._timing.call
            self._mute_until = self._repeat_until + timeout + self._timing.call
        return Halt(frozenset(confirmed), sent)

    def keep_halted(self) -> None:
        """Send zero duty again after a halt that is not confirmed.

        It does so for longer than the boards' timeout, then nothing, so that the timeout acts.
        """
        if self._repeated and time.monotonic() < self._repeat_until:
            self._send_zeros(self._repeated)

    def resume(self) -> None:
        """Allow motors to be driven again, once boards that did not confirm a halt have stopped."""
        if self._mute_until is not None:
            self._wait(self._mute_until - time.monotonic())
        with self._sending:
            self._halted, self._repeated, self._mute_until = False, (), None

    def close(self) -> None:
        """Close the port."""
        self._link.close()

    def _send(self, data: bytes, drives: bool = False) -> None:
        """Send bytes, unless a halt forbids it; no thread can come in between."""
        with self._sending:
            if self._mute_until is not None or (drives and self._halted):
                raise LinkError(f"{self._link.port}: halted; nothing is sent before activation")
            self._link.write(data)

    def _send_zeros(self, addresses: Collection[int]) -> bool:
        """Send zero duty to all boards, and return whether the port took it."""
        self._suspect = True
        packets = [codec.encode_write(a, BoardCommand.DUTY_BOTH, 0, 0) for a in addresses]
        with contextlib.suppress(LinkError), self._sending:
            self._link.write(b"".join(packets))
            return True
        return False

    def _at_zero(self, address: int) -> bool:
        """Send zero duty to a board, and return whether it answers that both duties are zero.

        A late answer to an earlier question of the same halt will do: zero was sent before it.
        """
        # Not only among those for all: a board may drop what follows a packet to one that is gone.
        self._send_zeros([address])
        with contextlib.suppress(LinkError):
            deadline = time.monotonic() + self._timing.reply
            return self._find(address, BoardCommand.GET_DUTIES, deadline) == (0, 0)
        return False

    def _wait(self, duration: float) -> None:
        """Wait, and discard what comes meanwhile; a port that is gone is not waited for."""
        with contextlib.suppress(LinkError):
            end = time.monotonic() + duration
            while time.monotonic() < end:
                self.statistics.stray += self._link.drain(end - time.monotonic(), duration)

    def _ask(self, address: int, command: BoardCommand, length: int, deadline: float) -> bytes:
        self._send(codec.encode_read(address, command))
        return self._link.read(length, deadline)

    def _judge(self, reply: bytes, length: int, value: T | None) -> T | None:
        """Count a missing or invalid reply; return its value."""
        if value is None:
            if len(reply) < length:
                self.statistics.silent += 1
            else:
                self.statistics.refused += 1
        return value

    def _call(
        self,
        what: str,
        address: int,
        command: BoardCommand,
        exchange: Callable[[float], T | None],
    ) -> T:
        """Repeat an exchange until a reply is valid or the call's time is over."""
        end = time.monotonic() + self._timing.call
        self.statistics.transactions += 1
        tries = 0
        while time.monotonic() + self._timing.reply < end:
            if not self._clear(address, command, end):
                continue
            tries += 1
            self.statistics.retries += tries > 1
            value = exchange(min(time.monotonic() + self._timing.reply, end))
            if value is not None and self._stands_alone():
                return value
            self._suspect = True
            if command in codec.NOT_REPEATABLE:
                break
        self.statistics.failures += 1
        raise LinkError(f"{what}: no valid answer in {tries} tries on {self._link.port}")

    def _stands_alone(self) -> bool:
        """Return whether no bytes follow a reply.

        A reply with trailing bytes may be a repeated old one. It may also be the reply to a read
        command into which a write was corrupted: its first byte may equal an acknowledgement.
        """
        behind = self._link.drain(0.0, 0.0)
        self.statistics.stray += behind
        self.statistics.refused += behind > 0
        return not behind

    def _clear(self, address: int, command: BoardCommand, end: float) -> bool:
        """Ensure that no earlier reply can be mistaken for the next one.

        Bytes keep their order on a line: once a new probe has been answered, all replies that were
        pending before it have passed.
        """
        stray = self._link.drain(0.0, end - time.monotonic())
        self.statistics.stray += stray
        if not (self._suspect or stray):
            return True
        self._suspect = True
        self.statistics.stray += self._link.drain(self._timing.quiet, end - time.monotonic())
        if time.monotonic() < end:
            # A probe must differ from the command itself.
            question = next(probe for probe in self._probes if probe is not command)
            deadline = min(time.monotonic() + self._timing.reply, end)
            self._suspect = self._find(address, question, deadline) is None
        return not self._suspect

    def _find(
        self, address: int, question: BoardCommand, deadline: float
    ) -> tuple[int, ...] | None:
        """Send a read command, and return the values of its reply amid all bytes that come."""
        self._send(codec.encode_read(address, question))
        length, tail = codec.reply_length(question), b""
        # A faulty board may send without end.
        while time.monotonic() < deadline and (byte := self._link.read(1, deadline)):
            tail = (tail + byte)[-length:]
            values = codec.decode_reply(address, question, tail)
            if values is not None:
                return values
        return None
