"""The thesis' handshake: what it carries, and what a byte error does to it."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.twin.hardware.radio.wire import Wire, pump
from twin.hardware.emulator.modem import ModemConfig, VirtualModems
from twin.hardware.radio.handshake import (
    ACKNOWLEDGE,
    END_OF_BYTE,
    END_OF_DATA,
    RECEIVED_OK,
    TRANSMIT,
    HandshakeConfig,
    HandshakeLink,
)
from twin.link import Outcome, RadioError

pytestmark = pytest.mark.virtual_time


def shake(message, spoil=None):
    """Carry a message byte by byte; `spoil(count, byte)` returns what becomes of each."""
    there, back = Wire(), Wire()
    config = HandshakeConfig(send_within=1.0, receive_within=0.9)
    first, second = HandshakeLink(there, config), HandshakeLink(back, config)
    first.send(message)
    got, confirmations, count = [], [], 0
    for _ in range(200):
        for source, target, link in ((there, back, second), (back, there, first)):
            for byte in b"".join(source.out):
                data = bytes([byte])
                target.into += data if spoil is None else spoil(count, data)
                count += 1
            source.out.clear()
            polled = link.poll()
            got, confirmations = got + polled.messages, confirmations + polled.outcomes
        there.time = back.time = there.time + 0.01
    return got, confirmations, second


@given(st.binary(min_size=1, max_size=40))
def test_handshake_carries_any_bytes_over_a_clean_line(message):
    got, confirmations, _ = shake(message)
    assert got == [message]
    assert confirmations == [Outcome(1, True)]


def test_handshake_sends_the_byte_sequence_of_the_thesis():
    wire = Wire()
    link = HandshakeLink(wire)
    link.send(b"ab")
    for answer in (ACKNOWLEDGE, RECEIVED_OK):
        wire.into = bytes([answer])
        link.poll()
    expected = [[TRANSMIT], [ord("a"), END_OF_BYTE], [ord("b"), END_OF_DATA]]
    assert list(wire.out) == [bytes(each) for each in expected]


def test_handshake_delivers_a_changed_byte_and_calls_it_sent():
    got, confirmations, _ = shake(b"\x10\x20\x30", lambda n, b: b"\x21" if b == b"\x20" else b)
    assert got == [b"\x10\x21\x30"]
    assert confirmations == [Outcome(1, True)]


def test_handshake_takes_data_for_a_command_after_a_lost_byte():
    """No escaping: without its first byte the command is data, and data ends the message."""
    message = bytes([0x10, END_OF_DATA, 0x30])
    lost = [False]

    def lose_first(count, byte):
        if byte == b"\x10" and not lost[0]:
            lost[0] = True
            return b""
        # Noise in place of the received-ok that will not come.
        return byte + (bytes([END_OF_DATA]) if lost[0] and byte[0] == END_OF_BYTE else b"")

    got, _, _ = shake(message, lose_first)
    assert got == [bytes([END_OF_BYTE])]


def test_handshake_stalls_on_a_lost_received_ok_until_its_deadline():
    got, confirmations, second = shake(b"abc", lambda n, b: b"" if b[0] == RECEIVED_OK else b)
    assert got == []
    assert confirmations == [Outcome(1, False)]
    assert second.next_event() == math.inf  # It waits no more.


def test_handshake_calls_a_message_sent_whose_end_was_lost():
    got, confirmations, second = shake(b"abc", lambda n, b: b"" if b[0] == END_OF_DATA else b)
    assert got == []
    assert confirmations == [Outcome(1, True)]
    assert second.next_event() == math.inf


def test_handshake_stalls_when_both_begin_at_once():
    modems = VirtualModems(ModemConfig(), np.random.default_rng(0))
    links = [HandshakeLink(end) for end in modems.ends]
    for link in links:
        link.send(b"after you")
    messages, outcomes = pump(modems, links, 1.5)
    assert messages == ([], [])
    assert outcomes == ([Outcome(1, False)], [Outcome(1, False)])


def test_handshake_refuses_what_it_cannot_do():
    wire = Wire()
    link = HandshakeLink(wire, HandshakeConfig(message_limit=4))
    with pytest.raises(RadioError, match="of 5 bytes: 1 to 4"):
        link.send(bytes(5))
    link.send(b"a")
    with pytest.raises(RadioError, match="it sends a message"):
        link.send(b"b")
    other = HandshakeLink(wire)
    wire.into = bytes([TRANSMIT])
    other.poll()
    with pytest.raises(RadioError, match="it receives a message"):
        other.send(b"b")
