"""Reliable radio link between two rovers at 9600 baud, with checksummed frames.

The modems may lose, change and insert bytes, but do not reorder them. `frames` encodes the frames;
`handshake` is the protocol of the thesis (appendix D).

All calls are non-blocking: `poll`, called in the servo loop, processes the received bytes and sends
as much as the line's capacity permits.
"""

import dataclasses
import math
from collections import deque

import numpy as np

from perception.geometry.checks import check_numbers
from twin.hardware.radio.channel import BITS_PER_BYTE, ByteChannel
from twin.hardware.radio.frames import Frame, FrameParser, encode_frame
from twin.link import MESSAGE_LIMIT, Outcome, Polled, RadioError

_MAX_WINDOW = 8  # Number of frames that the flags of an acknowledgement (a byte) cover.
_LONGEST_MESSAGE = 1024  # [bytes]
_DATA, _LATEST, _ACKNOWLEDGE = 1, 2, 3


def check_message(message: bytes, limit: int) -> bytes:
    """Check the length of a message, and return a copy of it.

    Args:
        message: Body of the message.
        limit: Largest length [bytes].

    Raises:
        RadioError: If the message is empty or too long.
    """
    if not 1 <= len(message) <= limit:
        raise RadioError(f"radio message of {len(message)} bytes: 1 to {limit} can be sent")
    return bytes(message)


@dataclasses.dataclass(frozen=True)
class FramedConfig:
    """Configuration of a framed link; both ends should use the same.

    Attributes:
        baud: Bit rate of the line [bit/s].
        message_limit: Longest message [bytes].
        window: Largest number of unconfirmed messages in transit, 1 to 8.
        queue_limit: Largest number of messages that wait for transmission.
        acknowledge_within: Time from a frame's last byte to its acknowledgement [s]: delays of both
            directions, both ends' polling, and one frame sent before the acknowledgement.
        deliver_within: Time from `send` until a message is reported as unconfirmed [s].
        write_ahead: Time before the line is free at which the next frame is written [s]: two polls.
    """

    baud: int = 9600
    message_limit: int = MESSAGE_LIMIT
    window: int = _MAX_WINDOW
    queue_limit: int = 32
    acknowledge_within: float = 0.15
    deliver_within: float = 5.0
    write_ahead: float = 0.02

    def __post_init__(self) -> None:
        """Reject numbers that are out of range.

        Raises:
            ValueError: Naming the field and its value.
        """
        counts = "baud", "message_limit", "window", "queue_limit"
        check_numbers("radio", self, *counts, "acknowledge_within", "deliver_within")
        check_numbers("radio", self, "write_ahead", zero=True)
        if self.window > _MAX_WINDOW or self.message_limit > _LONGEST_MESSAGE:
            raise ValueError(
                f"radio window = {self.window}, message_limit = {self.message_limit}: expected at "
                f"most {_MAX_WINDOW} and {_LONGEST_MESSAGE}"
            )


@dataclasses.dataclass
class _Pending:
    """Message that is neither confirmed nor expired; `first` and `last` number transmissions."""

    ticket: int
    message: bytes
    expires: float
    sequence: int = 0
    first: int = 0
    last: int = 0
    due: float = 0.0


class FramedLink:
    """One end of the framed link.

    `send` delivers messages in order and once, or reports them as unconfirmed. `send_latest` is for
    values that the next one replaces, without confirmation. The session number changes at each
    start and after each expired message, so that old sequence numbers are not taken for new ones.

    Attributes:
        bytes_sent: Number of bytes written to the line.
        latest_missed: Number of latest values lost, from gaps in the received sequence numbers.
    """

    def __init__(
        self, channel: ByteChannel, rng: np.random.Generator, config: FramedConfig | None = None
    ) -> None:
        """Begin a session.

        Args:
            channel: Channel to the modem.
            rng: Random generator for the session number, with a new seed at each start of a robot.
            config: Configuration of the link.
        """
        self.bytes_sent = self.latest_missed = 0
        self._channel = channel
        self._config = config or FramedConfig()
        self._parser = FrameParser(self._config.message_limit)
        self._session = int(rng.integers(1 << 16))
        self._next_sequence = 0
        self._next_latest = 0
        self._transmissions = 0
        self._tickets = 0
        self._queue: deque[_Pending] = deque()
        self._flight: deque[_Pending] = deque()
        self._latest: dict[int, bytes] = {}
        self._latest_went = False
        self._line_free = -math.inf
        self._peer: int | None = None
        self._expected = 0
        self._held: dict[int, bytes] = {}
        self._latest_seen: tuple[int, int] | None = None  # session, sequence
        self._acknowledge = False

    @property
    def pending(self) -> int:
        """Number of messages neither confirmed nor expired."""
        return len(self._queue) + len(self._flight)

    def send(self, message: bytes) -> int:
        """Queue a message for confirmed delivery.

        Returns:
            Ticket that identifies the message in an `Outcome` of a later `poll`.

        Raises:
            RadioError: If the message is empty or too long, or the queue is full.
        """
        message = check_message(message, self._config.message_limit)
        if len(self._queue) >= self._config.queue_limit:
            raise RadioError(f"radio queue is full: {len(self._queue)} messages wait to be sent")
        self._tickets += 1
        expires = self._channel.now() + self._config.deliver_within
        self._queue.append(_Pending(self._tickets, message, expires))
        return self._tickets

    def send_latest(self, message: bytes) -> None:
        """Queue a value without confirmation; it replaces a queued one of its type (first byte).

        Raises:
            RadioError: If the message is empty or too long.
        """
        message = check_message(message, self._config.message_limit)
        self._latest[message[0]] = message

    def poll(self) -> Polled:
        """Process the received bytes, and send as much as the line's capacity permits.

        Raises:
            LinkError: If the port is disconnected.
        """
        now = self._channel.now()
        result = Polled([], [])
        for frame in self._parser.feed(self._channel.read()):
            self._take(frame, now, result)
        self._expire(now, result.outcomes)
        self._transmit(now)
        return result

    def next_event(self) -> float:
        """Return when `poll` must run next if no bytes arrive [s]; infinity for never."""
        times = [pending.expires for pending in (*self._flight, *self._queue)]
        send = min((pending.due for pending in self._flight), default=math.inf)
        if self._acknowledge or self._latest or self._can_begin():
            send = -math.inf
        if send < math.inf:
            times.append(max(send, self._line_free - self._config.write_ahead))
        return min(times, default=math.inf)

    def _take(self, frame: Frame, now: float, result: Polled) -> None:
        if frame.kind == _ACKNOWLEDGE and len(frame.body) == 1:
            self._take_acknowledgement(frame, now, result.outcomes)
        elif frame.kind == _DATA and frame.age < self._config.window:
            self._take_data(frame, result.messages)
        elif frame.kind == _LATEST:
            self._take_latest(frame, result.messages)
        else:
            self._parser.rejected += 1

    def _meet(self, frame: Frame) -> None:
        """Resynchronize to a new session of the other end, at its oldest unconfirmed message."""
        if frame.session != self._peer:
            self._peer = frame.session
            self._expected = (frame.sequence - frame.age) & 0xFF
            self._held.clear()

    def _take_data(self, frame: Frame, messages: list[bytes]) -> None:
        self._meet(frame)
        ahead = (frame.sequence - self._expected) & 0xFF
        self._acknowledge = True
        if ahead >= self._config.window or frame.sequence in self._held:
            return  # It has come before.
        self._held[frame.sequence] = frame.body
        while self._expected in self._held:
            messages.append(self._held.pop(self._expected))
            self._expected = (self._expected + 1) & 0xFF

    def _take_latest(self, frame: Frame, messages: list[bytes]) -> None:
        if self._latest_seen is not None and self._latest_seen[0] == frame.session:
            step = (frame.sequence - self._latest_seen[1]) & 0xFF
            if step == 0:
                return  # It has come before.
            self.latest_missed += step - 1
        self._latest_seen = frame.session, frame.sequence
        messages.append(frame.body)

    def _take_acknowledgement(self, frame: Frame, now: float, outcomes: list[Outcome]) -> None:
        """Confirm all messages before the frame's number, and those flagged in its body."""
        oldest = self._flight[0].sequence if self._flight else self._next_sequence
        confirmed = (frame.sequence - oldest) & 0xFF
        if frame.session != self._session or confirmed > len(self._flight):
            return
        newest = 0
        for _ in range(confirmed):
            done = self._flight.popleft()
            newest = max(newest, done.first)
            outcomes.append(Outcome(done.ticket, True))
        for index, pending in enumerate(self._flight):
            if index and frame.body[0] >> (index - 1) & 1:
                newest = max(newest, pending.first)
                pending.due = math.inf
            elif pending.due == math.inf:
                pending.due = now  # The other end restarted and lost it.
        for pending in self._flight:
            # Frames are not reordered: one sent before another that arrived is lost.
            if pending.last < newest and pending.due < math.inf:
                pending.due = now

    def _expire(self, now: float, outcomes: list[Outcome]) -> None:
        """Report expired messages; if one in transit expires, give up all in transit."""
        if self._flight and now >= self._flight[0].expires:
            outcomes += [Outcome(pending.ticket, False) for pending in self._flight]
            self._flight.clear()
            self._session = (self._session + 1) & 0xFFFF
            self._next_sequence = 0
        while self._queue and now >= self._queue[0].expires:
            outcomes.append(Outcome(self._queue.popleft().ticket, False))

    def _transmit(self, now: float) -> None:
        """Write frames until the line is busy for longer than `write_ahead`."""
        while now >= self._line_free - self._config.write_ahead:
            line = self._next_line(now)
            if line is None:
                return
            self._channel.write(line)
            self.bytes_sent += len(line)

    def _next_line(self, now: float) -> bytes | None:
        """Return the next frame: first acknowledgements, then values and messages alternately."""
        if self._acknowledge:
            self._acknowledge = False
            bits = sum(1 << ((held - self._expected - 1) & 0xFF) for held in self._held)
            body = bytes([bits])
            return self._line(Frame(_ACKNOWLEDGE, 0, self._peer or 0, self._expected, body), now)
        pending = self._find_message(now)
        if self._latest and not (self._latest_went and pending):
            self._latest_went = True
            body = self._latest.pop(next(iter(self._latest)))
            self._next_latest = (self._next_latest + 1) & 0xFF
            return self._line(Frame(_LATEST, 0, self._session, self._next_latest, body), now)
        if pending is None:
            return None
        self._latest_went = False
        return self._message_line(pending, now)

    def _can_begin(self) -> bool:
        return bool(self._queue) and len(self._flight) < self._config.window

    def _find_message(self, now: float) -> _Pending | None:
        """Return the message to send next; retransmissions precede new messages."""
        due = (pending for pending in self._flight if now >= pending.due)
        return next(due, self._queue[0] if self._can_begin() else None)

    def _message_line(self, pending: _Pending, now: float) -> bytes:
        self._transmissions += 1
        if not pending.first:
            self._flight.append(self._queue.popleft())
            pending.first = self._transmissions
            pending.sequence = self._next_sequence
            self._next_sequence = (self._next_sequence + 1) & 0xFF
        pending.last = self._transmissions
        age = (pending.sequence - self._flight[0].sequence) & 0xFF
        frame = Frame(_DATA, age, self._session, pending.sequence, pending.message)
        line = self._line(frame, now)
        pending.due = self._line_free + self._config.acknowledge_within
        return line

    def _line(self, frame: Frame, now: float) -> bytes:
        line = encode_frame(frame)
        duration = len(line) * BITS_PER_BYTE / self._config.baud
        self._line_free = max(now, self._line_free) + duration
        return line
