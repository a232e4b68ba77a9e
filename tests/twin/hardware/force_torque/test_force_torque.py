import select
import socket
import time

import numpy as np
import pynetft
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.twin.hardware.serving import Served
from twin.hardware.emulator.net_ft import NetFT
from twin.hardware.force_torque import net_ft as ft
from twin.hardware.force_torque.net_ft import NetForceTorque, Record
from twin.hardware.roboclaw.codec import signed_difference
from twin.hardware.serial_link import LinkError

FAULTS = ("lose", "twice", "late", "swap", "stranger", "cut", "join", "no_request")
WORST_CALL = 0.015  # [s] Three times the deadline.
STALL = 0.5  # [s] A busy machine may stop a call for a while; a client that hangs takes longer.
U32 = st.integers(0, 2**32 - 1)
I32 = st.integers(-(2**31), 2**31 - 1)


class Server(Served):
    """Serves a sensor on the loopback interface, and damages what passes at a given rate."""

    def __init__(self, sensor, rng=None, rate=0.0, kinds=FAULTS):
        self.sensor, self.rate, self.kinds = sensor, rate, kinds
        self.rng = rng or np.random.default_rng(0)
        self.faults = dict.fromkeys(kinds, 0)
        self.socket, self.stranger = (socket.socket(type=socket.SOCK_DGRAM) for _ in range(2))
        for made in (self.socket, self.stranger):
            made.bind(("127.0.0.1", 0))
        self.port = self.socket.getsockname()[1]
        self.last_address = None
        self._held = []  # (due, datagram, address)
        self._swapped = None
        super().__init__()

    def close(self):
        self.socket.close()
        self.stranger.close()

    def serve(self):
        ready, _, _ = select.select([self.socket], [], [], 0.001)
        now = time.monotonic()
        out = []
        if ready:
            try:
                data, self.last_address = self.socket.recvfrom(2048)
            except OSError:  # A client has given its port up.
                return
            if not self._strikes(("no_request",)):
                answers = self.sensor.answer(data, self.last_address, now)
                out += [(answer, self.last_address) for answer in answers]
        out += self.sensor.due(now)
        for datagram, address in out:
            self._send(datagram, address, now)
        for entry in [entry for entry in self._held if entry[0] <= now]:
            self._held.remove(entry)
            self._put(entry[1], entry[2])

    def _strikes(self, kinds):
        kind = str(self.rng.choice(self.kinds)) if self.rng.random() < self.rate else ""
        if kind not in kinds:
            return ""
        self.faults[kind] += 1
        return kind

    def _put(self, datagram, address, sender=None):
        try:
            (sender or self.socket).sendto(datagram, address)
        except OSError:
            pass

    def _send(self, datagram, address, now):
        kind = self._strikes(set(self.kinds) - {"no_request"})
        if kind == "lose":
            return
        if kind == "late":
            self._held.append((now + float(self.rng.uniform(0.001, 0.04)), datagram, address))
            return
        if kind == "swap":  # Kept until after the next one, whoever that is for.
            self._swapped = (datagram, address)
            return
        if kind == "stranger":
            lie = ft.encode_record(Record(1, 2**31, 0, (9,) * 6))
            self._put(lie, address, self.stranger)
        sent = {"cut": datagram[:-1], "join": datagram * 2}.get(kind, datagram)
        for _ in range(2 if kind == "twice" else 1):
            self._put(sent, address)
        if self._swapped is not None:
            self._put(*self._swapped)
            self._swapped = None


class Load:
    """Counts that a test sets."""

    def __init__(self):
        self.counts = (1_000_000, -2_000_000, 3_000_000, 4000, -5000, 6000)

    def __call__(self):
        return self.counts


@pytest.fixture
def load():
    return Load()


def client_of(server, **changes):
    patient = {"deadline": 0.1, **changes}  # A busy machine must not lose a value.
    return NetForceTorque("127.0.0.1", server.port, **patient)


def test_records_are_the_sensors_present_counts_numbered_by_its_samples(load):
    with Server(NetFT(load)) as server:
        client = client_of(server)
        first = client.read()
        assert first.counts == load.counts and first.status == 0
        time.sleep(0.01)
        load.counts = (1, 2, 3, 4, 5, -(2**31))
        time.sleep(0.001)
        second = client.read()
        assert second.counts == load.counts
        assert signed_difference(second.ft_sequence, first.ft_sequence) >= 70
        client.close()


def test_sample_of_the_last_reading_is_refused_as_repeated(load):
    sensor = NetFT(load)
    honest, sensor.answer = sensor.answer, lambda data, address, now: honest(data, address, 5.0)
    with Server(sensor) as server:
        client = client_of(server)
        assert client.read().ft_sequence == 35_000
        assert client.read() is None
        client.close()


def test_restart_of_the_sensor_is_refused_until_it_is_opened_anew(load):
    sensor = NetFT(load)
    with Server(sensor) as server:
        client = client_of(server)
        assert client.read() is not None
        sensor.power_cycle(time.monotonic())
        assert [client.read() for _ in range(3)] == [None] * 3
        client.close()
        client = client_of(server)
        assert client.read().counts == load.counts
        client.close()


def test_sample_number_may_wrap(load):
    sensor = NetFT(load, rate=2.0**32 / 1000.0)
    with Server(sensor) as server:
        client = client_of(server)
        start = time.monotonic()
        sensor._started = start - 999.95
        sequences = []
        while time.monotonic() < start + 0.1:
            sequences.append(client.read().ft_sequence)
        assert max(sequences) > 2**32 - 2**28 and sequences[-1] < 2**28
        client.close()


def test_serious_status_is_refused_and_a_latched_threshold_is_not(load):
    sensor = NetFT(load)
    with Server(sensor) as server:
        client = client_of(server)
        for status in (0x80020000, 1 << 31, 1):
            sensor.status = status
            assert client.read() is None
        sensor.status = ft.MONITOR_LATCHED
        assert client.read().status == ft.MONITOR_LATCHED
        client.close()


def test_absent_sensor_is_missing_within_the_deadline():
    free = socket.socket(type=socket.SOCK_DGRAM)
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
    for closed in (False, True):
        if closed:
            free.close()
        client = NetForceTorque("127.0.0.1", port)
        start = time.monotonic()
        assert [client.read() for _ in range(5)] == [None] * 5
        assert time.monotonic() - start < STALL
        client.close()


def test_flood_of_datagrams_cannot_hold_a_call(load):
    with Server(NetFT(load)) as server:
        client = client_of(server)
        assert client.read() is not None
        for size in (36, 7, 2000):
            for _ in range(200):
                server.socket.sendto(bytes(size), server.last_address)
            start = time.monotonic()
            client.read()
            assert time.monotonic() - start < STALL
        assert client.read() is not None
        client.close()


def test_late_answer_reaches_nobody(load):
    sensor = NetFT(load)
    with Server(sensor) as server:
        client = client_of(server)
        assert client.read() is not None
        honest, sensor.answer = sensor.answer, lambda *_: []
        assert client.read() is None
        old_port = server.last_address
        sensor.answer = honest
        # Newer than the last accepted sample, but an answer to an earlier call.
        late = sensor.answer(ft.encode_request(ft.START_REALTIME, 1), old_port, time.monotonic())
        server.socket.sendto(late[0], old_port)
        load.counts = (0,) * 6
        time.sleep(0.001)
        assert client.read().counts == load.counts
        client.close()


def faulted_reads(load, calls, rate, seed, waiting_time):
    """Reads on a damaged network; the load jumps before each, so a stale reading is a wrong one."""
    rng = np.random.default_rng(seed)
    wrong, readings, durations = 0, 0, []
    with Server(NetFT(load), np.random.default_rng(seed + 1)) as server:
        client = client_of(server, deadline=0.005)
        server.rate = rate
        last = -1
        for _ in range(calls):
            load.counts = tuple(int(n) for n in rng.integers(-(10**6), 10**6, 6))
            start = waiting_time()
            reading = client.read()
            durations.append(waiting_time() - start)
            if reading is not None:
                readings += 1
                wrong += reading.counts != load.counts
                wrong += reading.ft_sequence <= last
                last = reading.ft_sequence
        client.close()
    return readings, wrong, max(durations), server.faults


@pytest.mark.parametrize("rate", [0.03, 0.3])
def test_damaged_network_gives_no_wrong_and_no_stale_reading(load, rate, waiting_time):
    readings, wrong, longest, faults = faulted_reads(load, 600, rate, 7, waiting_time)
    assert wrong == 0
    assert sum(faults.values()) > 0.3 * rate * 600
    assert longest < WORST_CALL
    # A busy machine answers too late, so how many are answered is its own affair.
    assert readings > 60


CALIBRATION = pynetft.Calibration(
    1e6, 1e3, pynetft.ForceUnit.NEWTON, pynetft.TorqueUnit.NEWTON_METER
)


def pynetft_of(server, **changes):
    config = pynetft.Config(
        sensor_host="127.0.0.1",
        rdt_port=server.port,
        calibration_override=CALIBRATION,
        **changes,
    )
    return pynetft.Client(config)


def test_pynetft_streams_from_the_emulated_sensor_and_agrees(load):
    sensor = NetFT(load, output_rate=1000.0)
    with Server(sensor) as server, pynetft_of(server) as theirs:
        samples = theirs.samples(timeout=2.0)
        first = next(samples)
        assert first.raw_wrench == load.counts
        assert first.wrench == (1.0, -2.0, 3.0, 4.0, -5.0, 6.0)
        assert first.status == 0
        sequences = [next(samples) for _ in range(30)]
        ahead = sequences[-1].ft_sequence - sequences[0].ft_sequence
        assert ahead == 7 * (sequences[-1].rdt_sequence - sequences[0].rdt_sequence)
        for extreme in (2**31 - 1, -(2**31), 0, 1, -1):
            load.counts = (extreme, 0, 0, 0, 0, extreme)
            time.sleep(0.03)
            next(samples)  # It may have been waiting since before.
            assert next(samples).raw_wrench == load.counts
        load.counts = (5, 6, 7, 8, 9, 10)
        theirs.bias()
        time.sleep(0.05)
        next(samples)
        assert next(samples).raw_wrench == (0,) * 6
        assert theirs.health().lost_count == theirs.health().malformed_count == 0


def test_stream_ends_with_its_count(load):
    sensor = NetFT(load, rate=7000.0, output_rate=1000.0)
    sent = sensor.answer(ft.encode_request(ft.START_REALTIME, 10), "host", 0.0)
    for k in range(1, 30):
        sent += [record for record, _ in sensor.due(k * 1e-3 + 1e-9)]
    records = [ft.decode_record(record) for record in sent]
    assert [record.rdt_sequence for record in records] == list(range(1, 11))
    steps = np.diff([record.ft_sequence for record in records])
    np.testing.assert_allclose(steps, 7, atol=1)


def test_stream_stops_on_request_and_never_bursts(load):
    sensor = NetFT(load)
    sensor.answer(ft.encode_request(ft.START_REALTIME, 0), "host", 0.0)
    assert len(sensor.due(100.0)) <= 101
    sensor.answer(ft.encode_request(ft.STOP, 0), "host", 100.0)
    assert sensor.due(101.0) == []


@given(U32, U32, U32, st.tuples(*[I32] * 6))
def test_records_are_read_back(rdt, sample, status, counts):
    record = Record(rdt, sample, status, counts)
    assert ft.decode_record(ft.encode_record(record)) == record


@given(st.integers(0, 2**16 - 1), U32)
def test_requests_are_read_back(command, samples):
    assert ft.decode_request(ft.encode_request(command, samples)) == (command, samples)


def test_a_million_random_bytes_raise_nothing():
    rng = np.random.default_rng(3)
    sensor = NetFT(lambda: (0,) * 6)
    done = 0
    while done < 1_000_000:
        size = int(rng.choice([0, 7, 8, 35, 36, 37, 1400]))
        data = rng.bytes(size)
        done += size
        record = ft.decode_record(data)
        assert (record is not None) == (size == 36)
        ft.decode_request(data)
        sensor.answer(data, "host", 0.0)
        sensor.answer(b"\x12\x34" + data[:6], "host", done * 1e-6)


def raises(error):
    def fail(*_):
        raise error

    return fail


def test_unknown_host_is_named(monkeypatch):
    with monkeypatch.context() as patch, pytest.raises(LinkError, match="nowhere: unknown"):
        patch.setattr(socket, "getaddrinfo", raises(socket.gaierror("unknown")))
        NetForceTorque("nowhere")
