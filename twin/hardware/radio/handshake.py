"""Radio protocol of the thesis (appendix D): a handshake for n bytes, as the reference.

The transmitter sends a transmit command and waits for the acknowledge command. It then sends the
bytes one at a time, each followed by an end-of-byte command, and waits for received-ok before the
next one; the last byte is followed by an end-of-data command. The thesis does not give the values
of the commands; they are chosen here. Like the original, the protocol has no checksum, no escaping
and no sequence numbers, and it ignores unexpected bytes. Only deadlines are added.
"""

import dataclasses
import math

from perception.geometry.checks import check_numbers
from twin.hardware.radio.channel import ByteChannel
from twin.hardware.radio.framed_radio import check_message
from twin.link import Outcome, Polled, RadioError

TRANSMIT = 0x05
ACKNOWLEDGE = 0x06
END_OF_BYTE = 0x1F
RECEIVED_OK = 0x11
END_OF_DATA = 0x04


@dataclasses.dataclass(frozen=True)
class HandshakeConfig:
    """Configuration of a handshake link.

    Attributes:
        message_limit: Longest message [bytes].
        send_within: Time from the transmit command until the transmitter gives up [s].
        receive_within: Time from the transmit command until the receiver gives up [s]; shorter than
            `send_within`, so that the receiver is ready for the next transmit command.
    """

    message_limit: int = 1024
    send_within: float = 1.0
    receive_within: float = 0.9

    def __post_init__(self) -> None:
        """Reject numbers that are not positive.

        Raises:
            ValueError: Naming the field and its value.
        """
        check_numbers("radio", self)


class HandshakeLink:
    """One end of the handshake link, which sends one message at a time.

    A confirmed `Outcome` means only that the transmitter sent the end-of-data command.
    """

    def __init__(self, channel: ByteChannel, config: HandshakeConfig | None = None) -> None:
        """Initialize as a receiver on `channel`."""
        self._channel = channel
        self._config = config or HandshakeConfig()
        self._tickets = 0
        self._sending: bytes | None = None
        self._sent: int | None = None  # None until the transmit command is acknowledged
        self._send_until = math.inf
        self._received: bytearray | None = None
        self._byte: int | None = None  # received, its command is not
        self._receive_until = math.inf

    @property
    def pending(self) -> int:
        """Number of messages in transit, 0 or 1."""
        return int(self._sending is not None)

    def send(self, message: bytes) -> int:
        """Begin a transmission, which `poll` continues.

        Returns:
            Ticket that identifies the message in an `Outcome` of a later `poll`.

        Raises:
            RadioError: If the message is empty or too long, or the link is busy.
            LinkError: If the port is disconnected.
        """
        message = check_message(message, self._config.message_limit)
        if self._sending is not None or self._received is not None:
            busy = "sends" if self._received is None else "receives"
            raise RadioError(f"radio handshake: it {busy} a message, and can do one thing at once")
        self._tickets += 1
        self._sending, self._sent = message, None
        self._send_until = self._channel.now() + self._config.send_within
        self._channel.write(bytes([TRANSMIT]))
        return self._tickets

    def poll(self) -> Polled:
        """Process the received bytes, and reply to them.

        Raises:
            LinkError: If the port is disconnected.
        """
        now = self._channel.now()
        result = Polled([], [])
        if now >= self._receive_until:
            self._stop_receiving()
        for value in self._channel.read():
            if self._sending is not None:
                self._take_answer(value, result)
            else:
                self._take_data(value, now, result)
        if now >= self._send_until and self._sending is not None:
            self._finish_sending(False, result)
        return result

    def next_event(self) -> float:
        """Return when `poll` must run next if no bytes arrive [s]; infinity for never."""
        return min(self._send_until, self._receive_until)

    def _take_answer(self, value: int, result: Polled) -> None:
        """Send the next byte if this is the expected command."""
        message = self._sending
        if message is None or value != (ACKNOWLEDGE if self._sent is None else RECEIVED_OK):
            return
        index = 0 if self._sent is None else self._sent
        self._sent = index + 1
        last = self._sent == len(message)
        self._channel.write(bytes([message[index], END_OF_DATA if last else END_OF_BYTE]))
        if last:
            self._finish_sending(True, result)

    def _finish_sending(self, confirmed: bool, result: Polled) -> None:
        self._sending = None
        self._send_until = math.inf
        result.outcomes.append(Outcome(self._tickets, confirmed))

    def _take_data(self, value: int, now: float, result: Polled) -> None:
        if self._received is None:
            if value == TRANSMIT:
                self._received, self._byte = bytearray(), None
                self._receive_until = now + self._config.receive_within
                self._channel.write(bytes([ACKNOWLEDGE]))
        elif self._byte is None:
            self._byte = value
        elif value in (END_OF_BYTE, END_OF_DATA):
            self._received.append(self._byte)
            self._byte = None
            if value == END_OF_DATA:
                result.messages.append(bytes(self._received))
            if value == END_OF_DATA or len(self._received) >= self._config.message_limit:
                self._stop_receiving()
            else:
                self._channel.write(bytes([RECEIVED_OK]))

    def _stop_receiving(self) -> None:
        self._received = None
        self._byte = None
        self._receive_until = math.inf
