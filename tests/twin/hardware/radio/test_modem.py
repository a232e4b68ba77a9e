"""The emulated modems: pace, delay and errors, in virtual time and on real ports."""

import math
import time

import numpy as np
import pytest

from models.datasheets import HARSH_RADIO, RADIO
from twin.hardware.emulator.modem import Line, ModemConfig, VirtualModems, pty_modems
from twin.hardware.radio.channel import SerialChannel
from twin.hardware.radio.framed_radio import FramedLink
from twin.hardware.radio.frames import Frame, encode_frame
from twin.hardware.radio.handshake import HandshakeConfig, HandshakeLink
from twin.hardware.serial_link import LinkError, SerialLink

pytestmark = pytest.mark.virtual_time


def test_modem_has_the_configured_rate_delay_and_byte_errors():
    line = Line(ModemConfig(delay=0.01), np.random.default_rng(0))
    line.put(bytes(96), 1.0)
    assert line.next_arrival() == pytest.approx(1.0 + 1 / 960 + 0.01)
    assert len(line.take(1.06)) == 48
    assert len(line.take(1.1101)) == 48
    line.put(bytes(2000), 2.0)
    assert len(line.take(math.inf)) == 1024
    for kinds, expected in (((1, 0, 0), 1.0), ((0, 1, 0), 0.99), ((0, 0, 1), 1.01)):
        flip, loss, insertion = kinds
        config = ModemConfig(
            error_rate=0.01, flip=flip, loss=loss, insertion=insertion, buffer=10**6
        )
        line = Line(config, np.random.default_rng(1))
        line.put(bytes(100_000), 0.0)
        arrived = line.take(math.inf)
        assert len(arrived) == pytest.approx(expected * 1e5, abs=150)
        assert flip == 0 or sum(map(bool, arrived)) == pytest.approx(1000, abs=120)


@pytest.mark.parametrize("radio", [RADIO, HARSH_RADIO])
def test_radio_of_a_data_sheet_loses_as_many_frames_as_its_bits_and_packets_say(radio):
    """A frame arrives if its packet does, and all bits of it and of the zero before it."""
    count, body = 6000, bytes(range(1, 61))
    modems = VirtualModems(ModemConfig.of(radio), np.random.default_rng(7))
    sender, receiver = (FramedLink(end, np.random.default_rng(0)) for end in modems.ends)
    arrived = 0
    for frame in range(count):
        modems.time = 0.2 * frame
        sender.send_latest(body)
        sender.poll()
        arrived += len(receiver.poll().messages)
    size = len(encode_frame(Frame(2, 0, 1, 1, body)))
    intact, loss = (1.0 - radio.bit_error_rate) ** 8, radio.packet_loss
    expected = (1.0 - loss) * intact**size * (loss + (1.0 - loss) * intact)
    deviation = math.sqrt(count * expected * (1.0 - expected))
    assert abs(arrived - count * expected) < 4.0 * deviation + 1.0


def test_lost_packet_takes_its_time_on_the_line():
    line = Line(ModemConfig(packet_loss=1.0), np.random.default_rng(0))
    line.put(bytes(96), 0.0)
    assert line.next_arrival() == math.inf
    line = Line(ModemConfig(packet_loss=0.5), np.random.default_rng(2))
    for packet in range(1000):
        line.put(bytes([packet % 256] * 8), 0.0)
    assert not len(line.take(math.inf)) % 8


def exchange(links, now, wait, messages):
    """Send messages one after another; return arrivals, confirmations and the duration."""
    begin, got, confirmed = now(), [], []
    for message in messages:
        links[0].send(message)
        done = False
        while not done:
            polled = links[0].poll()
            confirmed += [outcome.confirmed for outcome in polled.outcomes]
            got += links[1].poll().messages
            done = bool(polled.outcomes)
            if not done:
                wait()
    end = now()
    for _ in range(20):
        wait()
        got += links[1].poll().messages
    return got, confirmed, end - begin


def make_links(kind, ends):
    if kind == "framed":
        return [FramedLink(end, np.random.default_rng(i)) for i, end in enumerate(ends)]
    config = HandshakeConfig(send_within=0.4, receive_within=0.35)
    return [HandshakeLink(end, config) for end in ends]


def exchange_over_ports(kind, config, seed, messages):
    with pty_modems(config, np.random.default_rng(seed)) as paths:
        ports = [SerialLink(path, 9600) for path in paths]
        links = make_links(kind, [SerialChannel(port) for port in ports])
        result = exchange(links, time.monotonic, lambda: time.sleep(0.001), messages)
        for port in ports:
            port.close()
    return result


@pytest.mark.real_time
@pytest.mark.parametrize("kind", ["handshake", "framed"])
def test_real_ports_at_the_real_pace_agree_with_virtual_time(kind):
    rng = np.random.default_rng(3)
    messages = [rng.bytes(8) for _ in range(6)]
    config, seed = ModemConfig(error_rate=0.01, delay=0.002), 5
    modems = VirtualModems(config, np.random.default_rng(seed))

    def advance():
        modems.time += 0.001

    virtual = exchange(make_links(kind, modems.ends), lambda: modems.time, advance, messages)
    assert virtual[2] > 0.1
    for _ in range(3):  # Another process may hold this one up: once of three times must agree.
        measured = exchange_over_ports(kind, config, seed, messages)
        if measured[:2] == virtual[:2] and measured[2] == pytest.approx(virtual[2], rel=0.3):
            return
    assert measured == (*virtual[:2], pytest.approx(virtual[2], rel=0.3))


@pytest.mark.real_time
def test_disconnected_port_is_one_clear_error():
    with pty_modems(ModemConfig(), np.random.default_rng(0)) as paths:
        port = SerialLink(paths[0], 9600)
        link = FramedLink(SerialChannel(port), np.random.default_rng(0))
    with pytest.raises(LinkError, match=paths[0]):
        for _ in range(3):
            link.send_latest(b"x")
            link.poll()
    port.close()
