"""Several RoboClaw boards on one serial line, asked strictly and within a deadline.

The makers' and public clients are not used: after one lost reply they wait for seconds, they take
any byte as an acknowledgement, wrap a duty that is out of range (the motor reverses) and read
encoders without a sign. Here a value counts only when its checksum fits, and every call ends by
`BusTiming.call`.
"""

import dataclasses
import itertools
import time
from collections.abc import Callable
from typing import TypeVar

from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, Status
from twin.hardware.serial_link import LinkError, SerialLink

T = TypeVar("T")

# Sent in turn to find the line clear: each answer shows which of them it belongs to, unless it is
# later than a whole round, some 140 ms. All firmware answers them alike, and the servo cycle asks
# other ones.
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
        reply: Time from a request to its whole answer.
        quiet: Silence after a failure; longer than `codec.PACKET_GAP`, so that the boards drop
            what they hold of a broken packet.
        call: Time from a call to its end, with all its retries.
    """

    reply: float = 0.006
    quiet: float = 0.0115
    call: float = 0.045


@dataclasses.dataclass
class BusStatistics:
    """What the bus went through.

    Attributes:
        transactions: Calls.
        retries: Requests sent again.
        silent: Requests without an answer, or with a part of one.
        refused: Answers whose checksum or acknowledgement was wrong, or with bytes behind them.
        stray: Bytes that nobody had asked for.
        failures: Calls that ended with a `LinkError`.
    """

    transactions: int = 0
    retries: int = 0
    silent: int = 0
    refused: int = 0
    stray: int = 0
    failures: int = 0


class RoboClawBus:
    """Boards at several addresses behind one port."""

    def __init__(self, link: SerialLink, timing: BusTiming | None = None) -> None:
        """Take over an open port.

        Args:
            link: The port; closed by `close`.
            timing: Deadlines.
        """
        self.statistics = BusStatistics()
        self._link = link
        self._timing = timing or BusTiming()
        # After a failure an answer may still be on its way; nothing is believed before it passed.
        self._suspect = True
        self._probes = itertools.cycle(_PROBES)
        self._status_length: dict[int, int] = {}

    def read(self, address: int, command: BoardCommand) -> tuple[int, ...]:
        """Read from a board, and return the values of its answer.

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
        """Write to a board, and wait for its acknowledgement.

        Args:
            address: Address of the board.
            command: A key of `codec.WRITES`.
            values: Payload of the command.

        Raises:
            ValueError: If a value does not fit its field; nothing was sent.
            LinkError: If it was not acknowledged in time. It may have been carried out.
        """
        packet = codec.encode_write(address, command, *values)

        def exchange(deadline: float) -> bool | None:
            self._link.write(packet)
            reply = self._link.read(1, deadline)
            return self._judge(reply, 1, reply == bytes((codec.ACKNOWLEDGE,)) or None)

        self._call(f"{command.name} to board {address:#x}", address, command, exchange)

    def status(self, address: int) -> Status:
        """Return a board's status, of whichever layout its firmware has.

        Raises:
            LinkError: If no valid answer came in time.
        """
        command = BoardCommand.GET_STATUS

        def exchange(deadline: float) -> Status | None:
            length = self._status_length.get(address, 6)
            reply = self._ask(address, command, length, deadline)
            status = codec.decode_status_reply(address, reply)
            if status is None:
                self._status_length.pop(address, None)  # It may be another firmware by now.
            else:
                self._status_length[address] = len(reply)
            return self._judge(reply, len(reply) or length, status)

        return self._call(f"status of board {address:#x}", address, command, exchange)

    def version(self, address: int) -> str:
        """Return a board's firmware version, as it names itself.

        Raises:
            LinkError: If no valid answer came in time.
        """
        command = BoardCommand.GET_VERSION

        def exchange(deadline: float) -> str | None:
            self._link.write(codec.encode_read(address, command))
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

    def close(self) -> None:
        """Close the port."""
        self._link.close()

    def _ask(self, address: int, command: BoardCommand, length: int, deadline: float) -> bytes:
        self._link.write(codec.encode_read(address, command))
        return self._link.read(length, deadline)

    def _judge(self, reply: bytes, length: int, value: T | None) -> T | None:
        """Count what was wrong with an answer, if anything."""
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
        """Exchange until an answer is right or the time is up."""
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
        """Return whether nothing follows an answer.

        What is followed may be an old answer come again, or the first byte of the answer to a
        question that a damaged write became; that may well be the one of an acknowledgement.
        """
        behind = self._link.drain(0.0, 0.0)
        self.statistics.stray += behind
        self.statistics.refused += behind > 0
        return not behind

    def _clear(self, address: int, command: BoardCommand, end: float) -> bool:
        """Make sure that no earlier answer can be taken for the next one.

        Bytes keep their order on a line: once the answer to one more question has come, and to no
        earlier one like it, all that was on its way before has passed.
        """
        stray = self._link.drain(0.0, end - time.monotonic())
        self.statistics.stray += stray
        if not (self._suspect or stray):
            return True
        self._suspect = True
        self.statistics.stray += self._link.drain(self._timing.quiet, end - time.monotonic())
        if time.monotonic() < end:
            # A probe must not be the question itself.
            question = next(probe for probe in self._probes if probe is not command)
            self._suspect = not self._probe(address, question, end)
        return not self._suspect

    def _probe(self, address: int, question: BoardCommand, end: float) -> bool:
        """Ask, and let pass what comes before the answer."""
        deadline = min(time.monotonic() + self._timing.reply, end)
        self._link.write(codec.encode_read(address, question))
        length, tail = codec.reply_length(question), b""
        # A board that babbles sends for ever.
        while time.monotonic() < deadline and (byte := self._link.read(1, deadline)):
            tail = (tail + byte)[-length:]
            if codec.decode_reply(address, question, tail) is not None:
                return True
        return False
