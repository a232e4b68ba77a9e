"""ATI Net F/T force and torque sensor: raw data transfer (RDT) over UDP, one record a request.

A request asks for one sample, so that no stream of thousands of records a second has to be read
behind the controller's back. A record has no checksum of its own but UDP's, and nothing that names
the request: a late one is told by the sensor's sample number, and a local port whose requests were
not answered one for one is given up, so that what still comes to it reaches nobody.

pynetft 2.1.3 does hold up as to values: under the same faults it gave none that was wrong and kept
its call times. But it can only stream, so it cannot be stepped with an emulated robot; after 0.15 s
of silence it was away for 0.2 s more, after 1 s for another; its `latest_sample` was then 1 s old;
and by default it goes on after a restart of the sensor, which has lost its bias.
"""

import dataclasses
import select
import socket
import struct
import time
from typing import NamedTuple

import numpy as np

from perception.geometry.arrays import FloatArray
from twin.hardware.serial_link import LinkError

PORT = 49152
HEADER = 0x1234
STOP = 0x0000
START_REALTIME = 0x0002
START_BUFFERED = 0x0003
RESET_LATCH = 0x0041
SET_BIAS = 0x0042

MONITOR_LATCHED = 0x80010000  # A threshold of the user's was passed; the reading is sound.
_ERROR_SUMMARY = 1 << 31
_CONDITIONS = {
    30: "processor or memory",
    29: "digital board",
    28: "analogue board",
    27: "serial link",
    26: "program memory",
    25: "halted by its configuration",
    24: "settings",
    23: "configuration does not fit the calibration",
    22: "network",
    21: "CAN",
    20: "RDT",
    19: "EtherNet/IP",
    18: "DeviceNet",
    17: "saturated or converter failed",
    16: "monitor condition latched",
    14: "watchdog",
    13: "stack",
    12: "serial memory (I2C)",
    11: "serial flash (SPI)",
    10: "analogue board watchdog",
    9: "gauge excitation too high",
    8: "gauge excitation too low",
    7: "artificial ground",
    6: "analogue supply too high",
    5: "analogue supply too low",
    4: "no data on the serial link",
    3: "reference voltage",
    2: "temperature",
    1: "HTTP",
}
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">III6i")
RECORD_SIZE = _RECORD.size
_MODULUS = 1 << 32


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


class Reading(NamedTuple):
    """One accepted sample.

    Attributes:
        wrench: (6,) forces [N] and torques [N m] in the sensor's frame.
        sequence: Number of the sensor's internal sample, modulo 2^32.
        status: System status: 0 or `MONITOR_LATCHED`.
    """

    wrench: FloatArray
    sequence: int
    status: int


def encode_request(command: int, samples: int) -> bytes:
    """Return a request.

    Args:
        command: One of STOP to SET_BIAS.
        samples: Records wanted; 0 is without end.

    Raises:
        ValueError: If one does not fit its field.
    """
    try:
        return _REQUEST.pack(HEADER, command, samples)
    except struct.error:
        raise ValueError(f"command {command} or sample count {samples} does not fit") from None


def decode_request(datagram: bytes) -> tuple[int, int] | None:
    """Return command and sample count of a request; None if it is none."""
    if len(datagram) != _REQUEST.size:
        return None
    header, command, samples = _REQUEST.unpack(datagram)
    return (command, samples) if header == HEADER else None


def encode_record(record: Record) -> bytes:
    """Return a record's bytes.

    Raises:
        ValueError: If a field does not fit.
    """
    try:
        return _RECORD.pack(*record[:3], *record.counts)
    except struct.error:
        raise ValueError(f"a field of {record} does not fit") from None


def decode_record(datagram: bytes) -> Record | None:
    """Return the record in a datagram; None if it is not one."""
    if len(datagram) != RECORD_SIZE:
        return None
    fields = _RECORD.unpack(datagram)
    return Record(fields[0], fields[1], fields[2], fields[3:])


def is_serious(status: int) -> bool:
    """Tell whether a record with this status must not be used."""
    return status not in (0, MONITOR_LATCHED)


def describe_status(status: int) -> str:
    """Return what a status word says, in words."""
    said = [text for bit, text in _CONDITIONS.items() if status >> bit & 1]
    if not said:
        return "unnamed error" if status & _ERROR_SUMMARY else "sound"
    return ", ".join(said)


def advance(sequence: int, last: int) -> int:
    """Return by how many samples `sequence` is ahead of `last`, modulo 2^32; may be negative."""
    return (sequence - last + _MODULUS // 2) % _MODULUS - _MODULUS // 2


@dataclasses.dataclass
class ForceTorqueStatistics:
    """What happened on the link so far.

    Attributes:
        reads: Calls of `read`.
        readings: Readings returned.
        retries: Requests beyond the first of a call.
        unanswered: Calls in which no acceptable record came.
        repeated: Records of a sample that had been accepted before.
        late: Records of samples older than one accepted before.
        restarts: Older samples that only an answer to the present request can be: it restarted.
        malformed: Datagrams that are no record.
        serious: Records refused for their status.
        drained: Datagrams found before a request and discarded.
        socket_errors: Errors of the network interface, such as nobody listening.
        last_status: The last status word seen; `describe_status` says it in words.
    """

    reads: int = 0
    readings: int = 0
    retries: int = 0
    unanswered: int = 0
    repeated: int = 0
    late: int = 0
    restarts: int = 0
    malformed: int = 0
    serious: int = 0
    drained: int = 0
    socket_errors: int = 0
    last_status: int = 0


class NetForceTorque:
    """Reads a Net F/T, one sample a call."""

    def __init__(
        self,
        host: str,
        counts_per_newton: float,
        counts_per_newton_metre: float,
        port: int = PORT,
        deadline: float = 0.005,
        attempts: int = 2,
    ) -> None:
        """Find the sensor's address; nothing is sent yet.

        Args:
            host: The sensor; records from elsewhere are not received.
            counts_per_newton: Counts by the active calibration, in its force unit [1/N].
            counts_per_newton_metre: Likewise; many calibrations count in N mm [1/(N m)].
            port: UDP port of the sensor.
            deadline: Longest call of `read` [s].
            attempts: Most requests in a call.

        Raises:
            ValueError: If a scale is not positive.
            LinkError: If there is no such host.
        """
        if not (counts_per_newton > 0.0 and counts_per_newton_metre > 0.0):
            raise ValueError("counts per newton and per newton metre must be positive")
        self._scale = np.repeat([1.0 / counts_per_newton, 1.0 / counts_per_newton_metre], 3)
        self._deadline, self._attempts = deadline, attempts
        try:
            found = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)
        except OSError as error:
            raise LinkError(f"force sensor {host}: {error}") from None
        self._address = found[0][4]
        self._socket = self._connected()
        self._unspoilt = True  # Nothing but the answers to this call can come to the socket.
        self._last: int | None = None
        self.statistics = ForceTorqueStatistics()

    def read(self) -> Reading | None:
        """Return a sample taken since the last one; None if none came or none can be trusted.

        After a restart of the sensor its samples are refused until `resynchronise`, because it
        has forgotten its bias.

        Raises:
            LinkError: If the network interface gives no socket.
        """
        deadline = time.monotonic() + self._deadline
        self.statistics.reads += 1
        self._drain()
        record, sent = None, 0
        while record is None and sent < self._attempts:
            sent += 1
            self._send(START_REALTIME, 1)
            waiting = (deadline - time.monotonic()) / (self._attempts - sent + 1)
            record = self._await(time.monotonic() + max(0.0, waiting))
        self.statistics.retries += sent - 1
        if record is None or sent > 1:
            self._renew()
        else:
            self._unspoilt = False
        if record is None:
            self.statistics.unanswered += 1
            return None
        return self._judged(record)

    def set_bias(self) -> None:
        """Make the present load the sensor's zero.

        The sensor does not acknowledge: see that the next readings are near zero.

        Raises:
            LinkError: If it cannot be sent.
        """
        errors = self.statistics.socket_errors
        self._send(SET_BIAS, 0)
        if self.statistics.socket_errors > errors:
            raise LinkError(f"force sensor {self._address[0]}: the bias could not be sent")

    def resynchronise(self) -> None:
        """Accept any sample next, as after a restart of the sensor; its bias is to be set again."""
        self._last = None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _connected(self) -> socket.socket:
        """Return a socket on a new local port that hears the sensor only."""
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
        self._unspoilt = True

    def _send(self, command: int, samples: int) -> None:
        try:
            self._socket.send(encode_request(command, samples))
        except OSError:
            self.statistics.socket_errors += 1

    def _drain(self) -> None:
        """Discard what came since the last call, of which a flood must not hold this one."""
        for _ in range(64):
            try:
                self._socket.recv(2048)
            except BlockingIOError:
                return
            except OSError:
                self.statistics.socket_errors += 1
            else:
                self.statistics.drained += 1
        self._renew()

    def _await(self, deadline: float) -> Record | None:
        """Return the first new record by `deadline`."""
        while (remaining := deadline - time.monotonic()) > 0.0:
            ready, _, _ = select.select([self._socket], [], [], remaining)
            if not ready:
                return None
            try:
                datagram = self._socket.recv(2048)
            except BlockingIOError:
                continue
            except OSError:
                # Nobody listens there; the next attempt may find the sensor up again.
                self.statistics.socket_errors += 1
                continue
            record = decode_record(datagram)
            if record is None:
                self.statistics.malformed += 1
            elif self._is_new(record):
                return record
        return None

    def _is_new(self, record: Record) -> bool:
        if self._last is None:
            return True
        ahead = advance(record.ft_sequence, self._last)
        if ahead > 0:
            return True
        if ahead == 0:
            self.statistics.repeated += 1
        elif self._unspoilt:
            self.statistics.restarts += 1
        else:
            self.statistics.late += 1
        return False

    def _judged(self, record: Record) -> Reading | None:
        """Return the reading in a new record, unless its status forbids."""
        self._last = record.ft_sequence
        self.statistics.last_status = record.status
        if is_serious(record.status):
            self.statistics.serious += 1
            return None
        self.statistics.readings += 1
        wrench = np.array(record.counts, dtype=np.float64) * self._scale
        return Reading(wrench, record.ft_sequence, record.status)
