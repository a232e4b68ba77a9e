"""The RoboClaw packet-serial protocol, byte by byte; nothing here touches a port.

A write is ``address command payload crc``, answered by one 0xFF. A read is ``address command``
without a checksum, answered by ``payload crc`` in which the checksum also covers address and
command: the answer to another question never passes for this one's. All numbers are big-endian.
"""

import enum
import math
import struct

import fastcrc

ACKNOWLEDGE = 0xFF
FULL_DUTY = 32767
"""Duty code of full forward drive; -32767 is full reverse."""
PACKET_GAP = 0.01
"""A board drops a partial packet after such a silence [s]."""
LONGEST_VERSION = 48
VERSION_END = b"\n\0"


class BoardCommand(enum.IntEnum):
    """Commands in use, by their numbers on the wire."""

    SET_TIMEOUT = 14
    GET_TIMEOUT = 15
    GET_ENCODER_1 = 16
    GET_ENCODER_2 = 17
    GET_SPEED_1 = 18
    GET_SPEED_2 = 19
    RESET_ENCODERS = 20
    GET_VERSION = 21
    SET_ENCODER_1 = 22
    SET_ENCODER_2 = 23
    GET_MAIN_VOLTAGE = 24
    GET_LOGIC_VOLTAGE = 25
    SET_VELOCITY_PID_1 = 28
    SET_VELOCITY_PID_2 = 29
    DUTY_1 = 32
    DUTY_2 = 33
    DUTY_BOTH = 34
    SPEED_1 = 35
    SPEED_2 = 36
    SPEED_BOTH = 37
    GET_DUTIES = 48
    GET_CURRENTS = 49
    GET_VELOCITY_PID_1 = 55
    GET_VELOCITY_PID_2 = 56
    POSITION_1 = 65
    POSITION_2 = 66
    POSITION_BOTH = 67
    GET_ENCODERS = 78
    GET_RAW_SPEEDS = 79
    GET_TEMPERATURE = 82
    GET_STATUS = 90
    SET_CURRENT_LIMIT_1 = 133
    SET_CURRENT_LIMIT_2 = 134
    GET_CURRENT_LIMIT_1 = 135
    GET_CURRENT_LIMIT_2 = 136
    SET_PWM_MODE = 148
    GET_PWM_MODE = 149
    RESET_E_STOP = 200


# Payload layouts for `struct`; what is not listed is not spoken. The status of an encoder or a
# speed is a byte behind it: 1 underflow, 2 backward, 4 overflow.
WRITES: dict[BoardCommand, str] = {
    BoardCommand.SET_TIMEOUT: ">B",
    BoardCommand.RESET_ENCODERS: ">",
    BoardCommand.SET_ENCODER_1: ">i",
    BoardCommand.SET_ENCODER_2: ">i",
    BoardCommand.SET_VELOCITY_PID_1: ">IIII",  # D, P, I (16.16 fixed point), counts/s at full duty
    BoardCommand.SET_VELOCITY_PID_2: ">IIII",
    BoardCommand.DUTY_1: ">h",
    BoardCommand.DUTY_2: ">h",
    BoardCommand.DUTY_BOTH: ">hh",
    BoardCommand.SPEED_1: ">i",
    BoardCommand.SPEED_2: ">i",
    BoardCommand.SPEED_BOTH: ">ii",
    BoardCommand.POSITION_1: ">IIIiB",  # acceleration, speed, deceleration, position, at once
    BoardCommand.POSITION_2: ">IIIiB",
    BoardCommand.POSITION_BOTH: ">IIIiIIIiB",
    BoardCommand.SET_CURRENT_LIMIT_1: ">II",  # most and least, 10 mA
    BoardCommand.SET_CURRENT_LIMIT_2: ">II",
    BoardCommand.SET_PWM_MODE: ">B",
    BoardCommand.RESET_E_STOP: ">",
}
READS: dict[BoardCommand, str] = {
    BoardCommand.GET_TIMEOUT: ">B",
    BoardCommand.GET_ENCODER_1: ">iB",
    BoardCommand.GET_ENCODER_2: ">iB",
    BoardCommand.GET_SPEED_1: ">iB",
    BoardCommand.GET_SPEED_2: ">iB",
    BoardCommand.GET_MAIN_VOLTAGE: ">H",
    BoardCommand.GET_LOGIC_VOLTAGE: ">H",
    BoardCommand.GET_DUTIES: ">hh",
    BoardCommand.GET_CURRENTS: ">hh",
    BoardCommand.GET_VELOCITY_PID_1: ">IIII",  # P, I, D, counts/s
    BoardCommand.GET_VELOCITY_PID_2: ">IIII",
    BoardCommand.GET_ENCODERS: ">ii",
    BoardCommand.GET_RAW_SPEEDS: ">ii",
    BoardCommand.GET_TEMPERATURE: ">H",
    BoardCommand.GET_CURRENT_LIMIT_1: ">II",
    BoardCommand.GET_CURRENT_LIMIT_2: ">II",
    BoardCommand.GET_PWM_MODE: ">B",
}
# Twice is not once: after a lost acknowledgement these are not sent again.
NOT_REPEATABLE = frozenset(
    {
        BoardCommand.RESET_ENCODERS,
        BoardCommand.SET_ENCODER_1,
        BoardCommand.SET_ENCODER_2,
        BoardCommand.RESET_E_STOP,
    }
)


class Status(enum.IntFlag):
    """Status bits of present firmware (32 bits); the upper half are warnings."""

    NORMAL = 0
    E_STOP = 0x1
    TEMPERATURE = 0x2
    TEMPERATURE_2 = 0x4
    MAIN_VOLTAGE_HIGH = 0x8
    LOGIC_VOLTAGE_HIGH = 0x10
    LOGIC_VOLTAGE_LOW = 0x20
    DRIVER_FAULT_1 = 0x40
    DRIVER_FAULT_2 = 0x80
    SPEED_ERROR_1 = 0x100
    SPEED_ERROR_2 = 0x200
    POSITION_ERROR_1 = 0x400
    POSITION_ERROR_2 = 0x800
    CURRENT_ERROR_1 = 0x1000
    CURRENT_ERROR_2 = 0x2000
    OVER_CURRENT_WARNING_1 = 0x10000
    OVER_CURRENT_WARNING_2 = 0x20000
    MAIN_VOLTAGE_HIGH_WARNING = 0x40000
    MAIN_VOLTAGE_LOW_WARNING = 0x80000
    TEMPERATURE_WARNING = 0x100000
    TEMPERATURE_2_WARNING = 0x200000

    @property
    def errors(self) -> "Status":
        """The bits that must stop the robot."""
        return self & Status(0xFFFF)


# Old firmware answers with 16 bits in another layout; over-current and low voltage, which it
# knows as warnings, stay warnings.
_OLD_LAYOUT: dict[int, Status] = {
    0x1: Status.OVER_CURRENT_WARNING_1,
    0x2: Status.OVER_CURRENT_WARNING_2,
    0x4: Status.E_STOP,
    0x8: Status.TEMPERATURE,
    0x10: Status.TEMPERATURE_2,
    0x20: Status.MAIN_VOLTAGE_HIGH,
    0x40: Status.LOGIC_VOLTAGE_HIGH,
    0x80: Status.LOGIC_VOLTAGE_LOW,
    0x100: Status.DRIVER_FAULT_1,
    0x200: Status.DRIVER_FAULT_2,
    0x400: Status.MAIN_VOLTAGE_HIGH_WARNING,
    0x800: Status.MAIN_VOLTAGE_LOW_WARNING,
    0x1000: Status.TEMPERATURE_WARNING,
    0x2000: Status.TEMPERATURE_2_WARNING,
}


def checksum(data: bytes) -> bytes:
    """Return the CRC-16/XMODEM of `data` as two bytes."""
    return fastcrc.crc16.xmodem(data).to_bytes(2, "big")


def encode_read(address: int, command: BoardCommand) -> bytes:
    """Return the packet that asks a question."""
    return bytes((address, command))


def encode_write(address: int, command: BoardCommand, *values: int) -> bytes:
    """Return the packet of a write.

    Args:
        address: Address of the board, 0x80 to 0x87.
        command: A key of `WRITES`.
        values: The payload.

    Raises:
        ValueError: If a value does not fit its field: it is never cut or wrapped.
    """
    try:
        payload = struct.pack(WRITES[command], *values)
    except struct.error as error:
        raise ValueError(f"{command.name} {values}: {error}; nothing was sent") from None
    body = bytes((address, command)) + payload
    return body + checksum(body)


def reply_length(command: BoardCommand) -> int:
    """Return the length of a read's reply with its checksum, for fixed layouts."""
    return struct.calcsize(READS[command]) + 2


def decode_reply(address: int, command: BoardCommand, reply: bytes) -> tuple[int, ...] | None:
    """Return the values of a reply, or None if it is not the answer to this question."""
    payload = checked(address, command, reply)
    if payload is None or len(payload) != struct.calcsize(READS[command]):
        return None
    return struct.unpack(READS[command], payload)


def checked(address: int, command: BoardCommand, reply: bytes) -> bytes | None:
    """Return a reply without its checksum, or None if that does not fit."""
    payload, crc = reply[:-2], reply[-2:]
    return payload if checksum(bytes((address, command)) + payload) == crc else None


def decode_status_reply(address: int, reply: bytes) -> Status | None:
    """Return the status in a reply of either layout, or None if it is not the answer.

    The checksum does not see zeros behind it: a short reply and two zeros would pass for a long
    one, with bits that nobody set.
    """
    payload = checked(address, BoardCommand.GET_STATUS, reply)
    short = len(reply) > 4 and checked(address, BoardCommand.GET_STATUS, reply[:4])
    return None if payload is None or short else decode_status(payload)


def decode_status(payload: bytes) -> Status | None:
    """Return the status of either layout, distinguished by its length; None for other lengths."""
    if len(payload) == 4:
        return Status(int.from_bytes(payload, "big"))
    if len(payload) != 2:
        return None
    old = int.from_bytes(payload, "big")
    status = Status.NORMAL
    for bit, meaning in _OLD_LAYOUT.items():
        if old & bit:
            status |= meaning
    return status


def encode_status(status: Status, old_layout: bool = False) -> bytes:
    """Return a status as a board sends it; the old layout has no room for some bits."""
    if not old_layout:
        return int(status).to_bytes(4, "big")
    return sum(bit for bit, meaning in _OLD_LAYOUT.items() if status & meaning).to_bytes(2, "big")


def signed_difference(later: int, earlier: int, bits: int = 32) -> int:
    """Return ``later - earlier`` of a counter that wraps at `bits`, as the shorter way round."""
    half = 1 << (bits - 1)
    return (later - earlier + half) % (1 << bits) - half


def duty_code(duty: float) -> int:
    """Return the wire code of a duty in [-1, 1]; outside it saturates, it never wraps.

    Raises:
        ValueError: If it is not a number: comparisons would make full drive of it.
    """
    if math.isnan(duty):
        raise ValueError("duty is not a number")
    return round(max(-1.0, min(1.0, duty)) * FULL_DUTY)
