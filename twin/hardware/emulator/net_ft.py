"""An ATI Net F/T's raw data transfer (RDT): answers datagrams; sockets are the caller's."""

import math
from collections.abc import Callable, Hashable

from twin.hardware.force_torque.net_ft import (
    SET_BIAS,
    START_REALTIME,
    STOP,
    Record,
    decode_request,
    encode_record,
)

_MODULUS = 1 << 32
_LARGEST = (1 << 31) - 1
_MOST_AT_ONCE = 100  # Records sent in one `due`; after a pause, older ones are left out.


class NetFT:
    """The sensor's state and answers."""

    def __init__(
        self,
        counts: Callable[[], tuple[int, ...]],
        rate: float = 7000.0,
        output_rate: float = 7000.0,
    ) -> None:
        """Power the sensor up.

        Args:
            counts: Returns the six counts before bias, in the sensor's frame.
            rate: Internal sampling rate [Hz].
            output_rate: Rate of the records of a stream [Hz].
        """
        self._counts, self._rate = counts, rate
        self._period = 1.0 / output_rate
        self.status = 0
        self.power_cycle(0.0)

    def power_cycle(self, now: float) -> None:
        """Start again at `now` [s]: no stream, no bias, samples counted from 0."""
        self._started = now
        self._bias = (0,) * 6
        self._client: Hashable | None = None
        self._left = 0.0  # Records still to be sent; infinite for a stream without end.
        self._next = 0.0  # Time of the next record [s].
        self._rdt_sequence = 0

    def answer(self, datagram: bytes, address: Hashable, now: float) -> list[bytes]:
        """Take a datagram, and return those that go back to its sender at once.

        Args:
            datagram: Received datagram; anything but a request is ignored.
            address: Address of the sender, kept for the stream that it may start.
            now: Time [s].
        """
        request = decode_request(datagram)
        if request is None:
            return []
        command, samples = request
        if command == START_REALTIME:
            self._client, self._left = address, samples or math.inf
            self._rdt_sequence, self._next = 0, now
            return [sent for sent, _ in self.due(now)]
        if command == STOP:
            self._client = None
        elif command == SET_BIAS:
            self._bias = self._counts()
        return []

    def due(self, now: float) -> list[tuple[bytes, Hashable]]:
        """Return the records of the present stream that are due at `now` [s], with addresses."""
        self._next = max(self._next, now - _MOST_AT_ONCE * self._period)
        sent: list[tuple[bytes, Hashable]] = []
        while self._client is not None and self._next <= now:
            sent.append((encode_record(self._record(self._next)), self._client))
            self._next += self._period
            self._left -= 1
            if not self._left:
                self._client = None
        return sent

    def _record(self, time: float) -> Record:
        self._rdt_sequence = (self._rdt_sequence + 1) % _MODULUS
        sample = int((time - self._started) * self._rate) % _MODULUS
        values = (count - zero for count, zero in zip(self._counts(), self._bias))
        kept = tuple(min(max(value, -_LARGEST - 1), _LARGEST) for value in values)
        return Record(self._rdt_sequence, sample, self.status, kept)
