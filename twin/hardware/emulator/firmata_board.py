"""A board that runs StandardFirmata, as an Arduino Uno does, with given analogue inputs.

What it answers follows the StandardFirmata sketch of Firmata 2.5: so does what it does with
damaged input, such as a system-exclusive message that goes on until its end byte comes.
"""

from collections.abc import Callable

from twin.hardware.analogue.firmata_codec import (
    ANALOGUE_MAPPING_QUERY,
    ANALOGUE_MAPPING_RESPONSE,
    ANALOGUE_MESSAGE,
    CAPABILITY_QUERY,
    CAPABILITY_RESPONSE,
    DIGITAL_MESSAGE,
    END_SYSEX,
    FULL_SCALE,
    PIN_STATE_QUERY,
    PIN_STATE_RESPONSE,
    REPORT_ANALOGUE,
    REPORT_DIGITAL,
    REPORT_FIRMWARE,
    REPORT_VERSION,
    SAMPLING_INTERVAL,
    SET_PIN_MODE,
    SET_PIN_VALUE,
    START_SYSEX,
    SYSTEM_RESET,
    analogue_message,
    sysex,
)

PROTOCOL = (2, 5)
_ANALOGUE_INPUTS = 6
_TOTAL_PINS = 20
_FIRST_ANALOGUE = 14  # Pin number of A0.
_FIRST_DIGITAL = 2  # Pins 0 and 1 are the serial line.
_PORTS = 3
_PWM = (3, 5, 6, 9, 10, 11)
_I2C = (18, 19)
_INPUT, _OUTPUT, _ANALOGUE, _PWM_MODE, _SERVO, _I2C_MODE, _PULL_UP = 0, 1, 2, 3, 4, 6, 11
_CAPABILITIES = (
    (range(_FIRST_DIGITAL, _TOTAL_PINS), (_INPUT, 1, _PULL_UP, 1, _OUTPUT, 1)),
    (range(_FIRST_ANALOGUE, _TOTAL_PINS), (_ANALOGUE, 10)),
    (_PWM, (_PWM_MODE, 8)),
    (range(_FIRST_DIGITAL, _TOTAL_PINS), (_SERVO, 14)),
    (_I2C, (_I2C_MODE, 1)),
)  # Pins, and a mode of theirs with its resolution [bit].
_BUFFER = 64  # Bytes of one message that the firmware keeps.
_SHORTEST_INTERVAL = 0.010  # [s]
_DEFAULT_INTERVAL = 0.019  # [s]
_DATA_BYTES = {
    ANALOGUE_MESSAGE: 2,
    DIGITAL_MESSAGE: 2,
    SET_PIN_MODE: 2,
    SET_PIN_VALUE: 2,
    REPORT_ANALOGUE: 1,
    REPORT_DIGITAL: 1,
}


class FirmataBoard:
    """The firmware's state and answers."""

    def __init__(self, analogue: Callable[[int], int], name: str = "StandardFirmata.ino") -> None:
        """Power the board up.

        Args:
            analogue: Counts of an analogue input, A0 being 0; kept within 0 to 1023.
            name: Name of the firmware.
        """
        self._analogue = analogue
        self._name = name
        self.power_cycle()

    def power_cycle(self) -> None:
        """Start the firmware again; it announces itself when it next gets to send."""
        self._reset()
        self._interval = _DEFAULT_INTERVAL
        self._last_report: float | None = None
        self._announce = True
        self._command = 0
        self._channel = 0
        self._wanted = 0
        self._data = bytearray()

    def feed(self, data: bytes, now: float) -> bytes:
        """Take what came on the wire at `now` [s], and return what the board answers."""
        answer = bytearray(self.due(now))
        for byte in data:
            answer += self._input(byte)
        return bytes(answer)

    def due(self, now: float) -> bytes:
        """Return what the board sends unasked at `now` [s]: its name once, then reports."""
        answer = b""
        if self._announce:
            self._announce = False
            answer = self._version() + self._firmware()
        if self._last_report is None:
            self._last_report = now
        if now - self._last_report <= self._interval:
            return answer
        self._last_report = max(self._last_report + self._interval, now - self._interval)
        pins = [p for p in range(_ANALOGUE_INPUTS) if self._reported[p] and self._is_input(p)]
        return answer + b"".join(self._report(pin) for pin in pins)

    def _input(self, byte: int) -> bytes:
        if self._command == START_SYSEX:
            if byte == END_SYSEX:
                self._command = 0
                return self._system_exclusive(bytes(self._data))
            self._keep(byte)
            return b""
        if self._wanted and byte < 0x80:
            self._keep(byte)
            self._wanted -= 1
            return b"" if self._wanted else self._short_message()
        return self._begin(byte)

    def _keep(self, byte: int) -> None:
        if len(self._data) < _BUFFER:
            self._data.append(byte)

    def _begin(self, byte: int) -> bytes:
        command = byte if byte >= START_SYSEX else byte & 0xF0
        if command in _DATA_BYTES or command == START_SYSEX:
            self._command, self._channel = command, byte & 0x0F
            self._wanted = _DATA_BYTES.get(command, 0)
            self._data.clear()
        elif command == SYSTEM_RESET:
            self._command = self._wanted = 0
            self._reset()
        elif command == REPORT_VERSION:
            return self._version()
        return b""

    def _short_message(self) -> bytes:
        command, self._command = self._command, 0
        first = self._data[0]
        if command == REPORT_ANALOGUE and self._channel < _ANALOGUE_INPUTS:
            return self._set_reported(self._channel, first != 0)
        if command == REPORT_DIGITAL and self._channel < _PORTS and first:
            return bytes((DIGITAL_MESSAGE | self._channel, 0, 0))
        if command == SET_PIN_MODE and first < _TOTAL_PINS:
            return self._set_mode(first, self._data[1])
        return b""

    def _set_reported(self, pin: int, on: bool) -> bytes:
        self._reported[pin] = on
        return self._report(pin) if on else b""

    def _set_mode(self, pin: int, mode: int) -> bytes:
        self._modes[pin] = mode
        if pin < _FIRST_ANALOGUE:
            return b""
        return self._set_reported(pin - _FIRST_ANALOGUE, mode == _ANALOGUE)

    def _system_exclusive(self, data: bytes) -> bytes:
        kind, body = data[:1], data[1:]
        if kind == bytes((REPORT_FIRMWARE,)):
            return self._firmware()
        if kind == bytes((CAPABILITY_QUERY,)):
            pins = b"".join(_capabilities(pin) for pin in range(_TOTAL_PINS))
            return sysex(CAPABILITY_RESPONSE, pins)
        if kind == bytes((ANALOGUE_MAPPING_QUERY,)):
            inputs = range(_TOTAL_PINS - _FIRST_ANALOGUE)
            return sysex(ANALOGUE_MAPPING_RESPONSE, (*[127] * _FIRST_ANALOGUE, *inputs))
        if kind == bytes((PIN_STATE_QUERY,)) and body:
            return self._pin_state(body[0])
        if kind == bytes((SAMPLING_INTERVAL,)) and len(body) > 1:
            interval = (body[0] + (body[1] << 7)) * 1e-3
            self._interval = max(interval, _SHORTEST_INTERVAL)
        return b""

    def _pin_state(self, pin: int) -> bytes:
        """Answer with the number even of a pin that is not there, as the sketch does."""
        state = (self._modes[pin], 0) if pin < _TOTAL_PINS else ()
        # Written byte by byte, so a damaged number of eight bits comes back as it is.
        return bytes((START_SYSEX, PIN_STATE_RESPONSE, pin, *state, END_SYSEX))

    def _report(self, pin: int) -> bytes:
        return analogue_message(pin, min(max(int(self._analogue(pin)), 0), FULL_SCALE))

    def _is_input(self, pin: int) -> bool:
        return self._modes[_FIRST_ANALOGUE + pin] == _ANALOGUE

    def _version(self) -> bytes:
        return bytes((REPORT_VERSION, *PROTOCOL))

    def _firmware(self) -> bytes:
        letters = (half for code in self._name.encode() for half in (code & 0x7F, code >> 7))
        return sysex(REPORT_FIRMWARE, (*PROTOCOL, *letters))

    def _reset(self) -> None:
        self._reported = [False] * _ANALOGUE_INPUTS
        analogue = _TOTAL_PINS - _FIRST_ANALOGUE
        self._modes = [_OUTPUT] * _FIRST_ANALOGUE + [_ANALOGUE] * analogue


def _capabilities(pin: int) -> bytes:
    """Return the modes of a pin with their resolutions, ended by 127."""
    modes = (each for pins, pair in _CAPABILITIES if pin in pins for each in pair)
    return bytes((*modes, 127))
