"""Messages of the Firmata protocol as bytes, and back; no device is touched here."""

from collections.abc import Iterable
from typing import NamedTuple

FULL_SCALE = 1023
PINS = 16  # An analogue message has room for a pin number of four bits.

DIGITAL_MESSAGE = 0x90
REPORT_ANALOGUE = 0xC0
REPORT_DIGITAL = 0xD0
ANALOGUE_MESSAGE = 0xE0
START_SYSEX = 0xF0
SET_PIN_MODE = 0xF4
SET_PIN_VALUE = 0xF5
END_SYSEX = 0xF7
REPORT_VERSION = 0xF9
SYSTEM_RESET = 0xFF

ANALOGUE_MAPPING_QUERY = 0x69
ANALOGUE_MAPPING_RESPONSE = 0x6A
CAPABILITY_QUERY = 0x6B
CAPABILITY_RESPONSE = 0x6C
PIN_STATE_QUERY = 0x6D
PIN_STATE_RESPONSE = 0x6E
REPORT_FIRMWARE = 0x79
SAMPLING_INTERVAL = 0x7A

_SEVEN_BITS = 0x7F
_COMMAND = 0x80  # Bytes from here on begin a message.
LARGEST = 0x3FFF  # Number of fourteen bits.
_DATA_BYTES = {ANALOGUE_MESSAGE: 2, DIGITAL_MESSAGE: 2, REPORT_VERSION: 2}  # From the board.


class Message(NamedTuple):
    """One message of a board.

    Attributes:
        command: ANALOGUE_MESSAGE, DIGITAL_MESSAGE, REPORT_VERSION or START_SYSEX.
        channel: Pin of an analogue, port of a digital message; else 0.
        data: Bytes of seven bits; a system-exclusive message begins with its kind.
    """

    command: int
    channel: int
    data: bytes


def sysex(kind: int, data: Iterable[int] = ()) -> bytes:
    """Return a system-exclusive message.

    Raises:
        ValueError: If a byte has more than seven bits.
    """
    body = bytes((kind, *data))
    if body and max(body) > _SEVEN_BITS:
        raise ValueError(f"Firmata data has seven bits a byte, got {body.hex(' ')}")
    return bytes((START_SYSEX, *body, END_SYSEX))


def fourteen_bits(value: int) -> bytes:
    """Return a number as two bytes of seven bits, the low one first.

    Raises:
        ValueError: If it does not fit.
    """
    if not 0 <= value <= LARGEST:
        raise ValueError(f"{value} does not fit in 14 bits")
    return bytes((value & _SEVEN_BITS, value >> 7))


def analogue_message(pin: int, value: int) -> bytes:
    """Return what a board sends of an analogue input.

    Raises:
        ValueError: If there can be no such pin or value.
    """
    return bytes((ANALOGUE_MESSAGE | checked_pin(pin),)) + fourteen_bits(value)


def report_analogue(pin: int, on: bool) -> bytes:
    """Return the command that starts (with a value at once) or stops reports of an input.

    Raises:
        ValueError: If there can be no such pin.
    """
    return bytes((REPORT_ANALOGUE | checked_pin(pin), int(on)))


def checked_pin(pin: int) -> int:
    """Return the number of an analogue input.

    Raises:
        ValueError: If there can be no such pin.
    """
    if not 0 <= pin < PINS:
        raise ValueError(f"analogue pin {pin} is outside 0 to {PINS - 1}")
    return pin


class Parser:
    """Messages of a board from its bytes; garbage is dropped and never raises."""

    def __init__(self, limit: int = 64) -> None:
        """Start between messages.

        Args:
            limit: Most bytes kept of one system-exclusive message; a longer one is dropped.
        """
        self._limit = limit
        self._data = bytearray()
        self._command = 0
        self._channel = 0

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that these bytes complete."""
        messages: list[Message] = []
        for byte in data:
            if byte >= _COMMAND:
                self._begin(byte, messages)
            elif self._command:
                self._data.append(byte)
                self._go_on(messages)
        return messages

    def reset(self) -> None:
        """Forget an unfinished message."""
        self._data.clear()
        self._command = self._channel = 0

    def _begin(self, byte: int, messages: list[Message]) -> None:
        if byte == END_SYSEX and self._command == START_SYSEX and self._data:
            self._finish(messages)
            return
        self.reset()
        command = byte if byte >= START_SYSEX else byte & 0xF0
        if command == START_SYSEX or command in _DATA_BYTES:
            self._command = command
            self._channel = byte & 0x0F if byte < START_SYSEX else 0

    def _go_on(self, messages: list[Message]) -> None:
        if self._command == START_SYSEX:
            if len(self._data) > self._limit:
                self.reset()
        elif len(self._data) == _DATA_BYTES[self._command]:
            self._finish(messages)

    def _finish(self, messages: list[Message]) -> None:
        messages.append(Message(self._command, self._channel, bytes(self._data)))
        self._data.clear()
        self._command = self._channel = 0
