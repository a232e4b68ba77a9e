"""Analogue inputs of a board that runs StandardFirmata (protocol 2.4 or newer).

Firmata has neither checksum nor request numbers, so both are made from what every StandardFirmata
does: `REPORT_ANALOG pin 1` is answered at once with the present value, and `PIN_STATE_QUERY n` is
answered with n even where no such pin is. A request is an echo with a new number and two polls of
each pin; what comes before its echo belongs to an earlier request, and a value counts only when
two polls of the pin agree. What is left is one damage to both polls alike.

pyfirmata2 2.5.1 does not hold up: at 3 % damaged transmissions it gave 24 wrong values of 7232, of
which 16 were above full scale; it has no polling and no time stamp, so a silent board leaves
its last value in place; and it cannot set itself up from the answer of Firmata 2.5 to its query.

10 bits on 5 V are 4.9 mV a count: 0.145 degrees of the thesis' inclinometer. At 57600 baud, the
rate of StandardFirmata, three pins take 5 ms and the bridge's latency twice; one by FTDI needs its
latency timer at 1 ms.
"""

import contextlib
import time
from collections.abc import Sequence

from twin.hardware.analogue.firmata_codec import (
    ANALOGUE_MESSAGE,
    FULL_SCALE,
    LARGEST,
    PIN_STATE_QUERY,
    PIN_STATE_RESPONSE,
    REPORT_FIRMWARE,
    REPORT_VERSION,
    SAMPLING_INTERVAL,
    START_SYSEX,
    Message,
    Parser,
    checked_pin,
    fourteen_bits,
    report_analogue,
    sysex,
)
from twin.hardware.serial_link import LinkError, SerialLink

BAUD = 57600
_LONGEST_INTERVAL = LARGEST  # [ms]
_ATTEMPTS = 3  # Requests in a call.
_ROUNDS = 2  # Polls of a pin in one request.
_TOKENS = range(72, 128)  # Numbers beyond the pins of the Arduinos, whose echo is shortest.
_QUERY_PERIOD = 0.25  # [s]


class AnalogueBoard:
    """Polls analogue inputs; `open` before the first poll."""

    def __init__(
        self,
        link: SerialLink,
        window: int = 2,
        deadline: float = 0.008,
        silence: float = 0.003,
    ) -> None:
        """Take a link; nothing is sent yet.

        Args:
            link: Serial port of the board, at `BAUD`.
            window: Largest difference of two polls of a pin, in counts.
            deadline: Longest call of `poll` [s]; a request that the port does not take ends in a
                `LinkError` by the link's own time.
            silence: Time without a byte after which a request is given up [s].
        """
        self._link = link
        self._window, self._deadline, self._silence = window, deadline, silence
        self._parser = Parser()
        self._token = 0
        self._asked: set[int] = set()  # Numbers of the present call.
        self._polled: set[int] = set()
        self._interval_lost = False

    def open(self, boot: float = 5.0) -> str:
        """Wait for the board, which may reset when its port is opened, and quieten it.

        Args:
            boot: Longest time until it answers [s].

        Returns:
            Name and version of its firmware.

        Raises:
            LinkError: If no board answers, or with firmware that cannot be polled.
        """
        end = time.monotonic() + boot
        version, firmware = self._identify(end)
        if version[0] != 2:
            raise LinkError(
                f"{self._link.port}: Firmata protocol {version}, needed is 2.4 or newer"
            )
        self._link.write(sysex(SAMPLING_INTERVAL, fourteen_bits(_LONGEST_INTERVAL)))
        if not self._probe():
            raise LinkError(
                f"{self._link.port}: {firmware} does not answer polls; "
                "flash StandardFirmata of Firmata 2.4 or newer"
            )
        return firmware

    def poll(self, pins: Sequence[int]) -> dict[int, int | None]:
        """Return the present values of analogue inputs.

        Args:
            pins: Numbers of the inputs, 0 to 15.

        Returns:
            Counts 0 to 1023 for each pin; None where none was read within the deadline.

        Raises:
            ValueError: If there can be no such pin.
            LinkError: If the port is gone.
        """
        deadline = time.monotonic() + self._deadline
        wanted = [checked_pin(pin) for pin in dict.fromkeys(pins)]
        self._drain()
        if self._interval_lost:
            self._link.write(sysex(SAMPLING_INTERVAL, fourteen_bits(_LONGEST_INTERVAL)))
            self._interval_lost = False
        values: dict[int, int | None] = dict.fromkeys(wanted)
        previous: dict[int, int] = {}
        for _ in range(_ATTEMPTS):
            missing = [pin for pin in wanted if values[pin] is None]
            if not missing or time.monotonic() >= deadline:
                break
            self._request(missing)
            self._collect(missing, values, previous, deadline)
        return values

    def close(self) -> None:
        """Stop the board's reports and close the link."""
        with contextlib.suppress(LinkError):
            self._link.write(b"".join(report_analogue(pin, False) for pin in sorted(self._polled)))
        self._link.close()

    def _drain(self) -> None:
        """Forget what came and what was asked before."""
        end = time.monotonic() + self._silence
        while time.monotonic() < end and (data := self._link.read(4096, 0.0)):
            for message in self._parser.feed(data):
                self._note_reset(message)
        self._parser.reset()
        self._asked.clear()

    def _note_reset(self, message: Message) -> None:
        if message.command == REPORT_VERSION:
            self._interval_lost = True

    def _request(self, pins: list[int]) -> None:
        """Ask for an echo and `_ROUNDS` values of each pin."""
        self._token = (self._token + 1) % len(_TOKENS)
        token = _TOKENS[self._token]
        self._asked.add(token)
        polls = b"".join(report_analogue(pin, True) for pin in pins) * _ROUNDS
        self._link.write(sysex(PIN_STATE_QUERY, (token,)) + polls)
        self._polled.update(pins)

    def _collect(
        self,
        pins: list[int],
        values: dict[int, int | None],
        previous: dict[int, int],
        deadline: float,
    ) -> None:
        """Fill `values` from the replies to one request, until all came or nothing more comes."""
        expected = _ROUNDS * len(pins)
        echoed = False
        while expected > 0 and any(values[pin] is None for pin in pins):
            if time.monotonic() >= deadline:
                return
            messages = self._receive(min(deadline, time.monotonic() + self._silence))
            if messages is None:
                return
            for message in messages:
                if _is_pin_state(message):
                    # Another number is an earlier call's: so is what follows it.
                    echoed = self._is_echo(message)
                elif message.command == ANALOGUE_MESSAGE:
                    expected -= echoed
                    if echoed:
                        self._take(message, values, previous)
                else:
                    self._note_reset(message)

    def _receive(self, deadline: float) -> list[Message] | None:
        """Return the messages that came, perhaps none yet; None if no byte came by `deadline`."""
        data = self._link.read(1, deadline)
        if not data:
            return None
        return self._parser.feed(data + self._link.read(4096, 0.0))

    def _is_echo(self, message: Message) -> bool:
        """Tell whether this echoes a request of the present call."""
        return len(message.data) > 1 and message.data[1] in self._asked

    def _take(
        self,
        message: Message,
        values: dict[int, int | None],
        previous: dict[int, int],
    ) -> None:
        """Accept a value that agrees with the one before."""
        pin, value = message.channel, message.data[0] | message.data[1] << 7
        if values.get(pin, value) is None and value <= FULL_SCALE:
            before, previous[pin] = previous.get(pin), value
            if before is not None and abs(value - before) <= self._window:
                values[pin] = value

    def _identify(self, end: float) -> tuple[tuple[int, int], str]:
        """Return protocol version and firmware, asked for until they come."""
        found: dict[int, bytes] = {}
        asked = -_QUERY_PERIOD
        while time.monotonic() < end:
            if time.monotonic() - asked >= _QUERY_PERIOD:
                self._link.write(bytes((REPORT_VERSION,)) + sysex(REPORT_FIRMWARE))
                asked = time.monotonic()
            for message in self._receive(min(end, asked + _QUERY_PERIOD)) or ():
                exclusive = message.command == START_SYSEX
                found[message.data[0] if exclusive else message.command] = message.data
            if REPORT_VERSION in found and REPORT_FIRMWARE in found:
                major, minor = found[REPORT_VERSION]
                return (major, minor), _firmware_text(found[REPORT_FIRMWARE])
        raise LinkError(f"{self._link.port}: no Firmata board answers")

    def _probe(self) -> bool:
        """Return whether the board echoes, and reports an input at once on request."""
        for _ in range(_ATTEMPTS):
            self._drain()
            self._request([0])
            echoed = False
            end = time.monotonic() + _QUERY_PERIOD
            while time.monotonic() < end:
                for message in self._receive(end) or ():
                    echoed = echoed or (_is_pin_state(message) and self._is_echo(message))
                    if echoed and message.command == ANALOGUE_MESSAGE:
                        self._link.write(report_analogue(0, False))
                        return True
        return False


def _is_pin_state(message: Message) -> bool:
    return message.command == START_SYSEX and message.data[0] == PIN_STATE_RESPONSE


def _firmware_text(data: bytes) -> str:
    """Return "name major.minor" from a firmware report."""
    pairs = zip(data[3::2], data[4::2])
    name = "".join(chr(low | high << 7) for low, high in pairs)
    numbers = ".".join(str(number) for number in data[1:3])
    return f"{name or 'unnamed firmware'} {numbers}".strip()
