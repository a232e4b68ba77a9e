"""ATI Net F/T force and torque sensor: raw data transfer (RDT) over UDP, one record a request.

A request asks for one sample, so that no stream of thousands of records a second has to be read
behind the controller's back. A record has no checksum of its own but UDP's, and nothing that names
the request: a late one is recognised by the sensor's sample number, and a local port whose requests
were not answered one for one is closed, so that late records are discarded.

pynetft 2.1.3 does hold up as to values: under the same faults it gave none that was wrong and kept
its call times. But it can only stream, so it cannot be stepped with an emulated robot; after 0.15 s
of silence it was away for 0.2 s more, after 1 s for another; its `latest_sample` was then 1 s old;
and by default it goes on after a restart of the sensor, which has lost its bias.
"""

import contextlib
import select
import socket
import struct
import time
from typing import NamedTuple

from twin.hardware.roboclaw.codec import signed_difference
from twin.hardware.serial_link import LinkError

PORT = 49152
DEADLINE = 0.005  # [s]
_ATTEMPTS = 2  # Requests in a call.
HEADER = 0x1234
STOP = 0x0000
START_REALTIME = 0x0002
SET_BIAS = 0x0042

MONITOR_LATCHED = 0x80010000  # A threshold of the user's was passed; the reading is sound.
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">III6i")


class Record(NamedTuple):
    """One sample as the sensor sends it.

    Attributes:
        rdt_sequence: Number within the answer to a request, from 1.
        ft_sequence: Number of the sensor's internal sample, modulo 2^32.
        status: System status; 0 is sound.
        counts: Forces and torques in the sensor's frame (x, y, z each), in counts.
    """

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, ...]


def encode_request(command: int, samples: int) -> bytes:
    """Return a request.

    Args:
        command: STOP, START_REALTIME or SET_BIAS.
        samples: Number of records wanted; 0 is without end.
    """
    return _REQUEST.pack(HEADER, command, samples)


def decode_request(datagram: bytes) -> tuple[int, int] | None:
    """Return command and sample count of a request; None if it is none."""
    if len(datagram) != _REQUEST.size:
        return None
    header, command, samples = _REQUEST.unpack(datagram)
    return (command, samples) if header == HEADER else None


def encode_record(record: Record) -> bytes:
    """Return a record as the sensor sends it."""
    return _RECORD.pack(*record[:3], *record.counts)


def decode_record(datagram: bytes) -> Record | None:
    """Return the record in a datagram; None if it is not one."""
    if len(datagram) != _RECORD.size:
        return None
    rdt_sequence, ft_sequence, status, *counts = _RECORD.unpack(datagram)
    return Record(rdt_sequence, ft_sequence, status, tuple(counts))


class NetForceTorque:
    """Reads a Net F/T, one sample a call."""

    def __init__(self, host: str, port: int = PORT, deadline: float = DEADLINE) -> None:
        """Find the sensor's address; nothing is sent yet.

        Args:
            host: Sensor; records from other hosts are not received.
            port: UDP port of the sensor.
            deadline: Longest call of `read` [s].

        Raises:
            LinkError: If there is no such host.
        """
        self._deadline = deadline
        try:
            found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
        except OSError as error:
            raise LinkError(f"force sensor {host}: {error}") from None
        self._address = found[0][4]
        self._socket = self._connected()
        self._last: int | None = None

    def read(self) -> Record | None:
        """Return a sample newer than the last one; None if none came or none can be trusted.

        A sensor that restarted has forgotten its bias, so its samples are refused from then on.

        Raises:
            LinkError: If the network interface gives no socket.
        """
        deadline = time.monotonic() + self._deadline
        self._drain()
        record, sent = None, 0
        while record is None and sent < _ATTEMPTS:
            sent += 1
            self._request()
            waiting = (deadline - time.monotonic()) / (_ATTEMPTS - sent + 1)
            record = self._await(time.monotonic() + max(0.0, waiting))
        if record is None or sent > 1:
            self._renew()
        if record is None:
            return None
        self._last = record.ft_sequence
        return record if record.status in (0, MONITOR_LATCHED) else None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _connected(self) -> socket.socket:
        """Return a socket on a new local port that only the sensor's datagrams reach."""
        made: socket.socket | None = None
        try:
            made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            made.setblocking(False)
            made.connect(self._address)
        except OSError as error:
            if made is not None:
                made.close()
            raise LinkError(f"force sensor {self._address[0]}: {error}") from None
        return made

    def _renew(self) -> None:
        self._socket.close()
        self._socket = self._connected()

    def _request(self) -> None:
        # An error of the network is a sample that does not come.
        with contextlib.suppress(OSError):
            self._socket.send(encode_request(START_REALTIME, 1))

    def _drain(self) -> None:
        """Discard what came since the last call, of which a flood must not hold this one."""
        for _ in range(64):
            try:
                self._socket.recv(2048)
            except BlockingIOError:
                return
            except OSError:
                continue
        self._renew()

    def _await(self, deadline: float) -> Record | None:
        """Return the first new record by `deadline`."""
        while (remaining := deadline - time.monotonic()) > 0.0:
            ready, _, _ = select.select([self._socket], [], [], remaining)
            if not ready:
                return None
            try:
                record = decode_record(self._socket.recv(2048))
            except OSError:
                # If the port is closed there, the next attempt may find the sensor up again.
                continue
            if record is not None and self._is_new(record):
                return record
        return None

    def _is_new(self, record: Record) -> bool:
        return self._last is None or signed_difference(record.ft_sequence, self._last) > 0
