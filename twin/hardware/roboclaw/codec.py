"""Encoding and decoding of the RoboClaw packet-serial protocol, without input or output.

A write is ``address command payload crc``, acknowledged by one byte 0xFF. A read is ``address
command`` without a checksum; its reply is ``payload crc``, where the checksum also covers address
and command, so that the reply to another command is never accepted. Numbers are big-endian.
"""

import enum
import math
import struct

import fastcrc

ACKNOWLEDGE = 0xFF
FULL_DUTY = 32767
"""Duty code of full forward drive; -32767 is full reverse."""
PACKET_GAP = 0.01
"""Silence after which a board discards a partial packet [s]."""
LONGEST_VERSION = 48
VERSION_END = b"\n\0"


class BoardCommand(enum.IntEnum):
    """Command numbers of the protocol that are in use."""

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


# Payload layouts for `struct`; other commands are not supported. An encoder is followed by a status
# byte, `EncoderStatus`, a speed by 1 if it is backward.
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
    BoardCommand.POSITION_1: ">IIIiB",  # acceleration, speed, deceleration, position, immediate
    BoardCommand.POSITION_2: ">IIIiB",
    BoardCommand.POSITION_BOTH: ">IIIiIIIiB",
    BoardCommand.SET_CURRENT_LIMIT_1: ">II",  # maximum and minimum, 10 mA
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
# Commands that may make a motor turn.
DRIVES = frozenset(
    command for command in WRITES if command.name.startswith(("DUTY", "SPEED", "POSITION"))
)
# Not idempotent: not sent again after a lost acknowledgement.
NOT_REPEATABLE = frozenset(
    {
        BoardCommand.RESET_ENCODERS,
        BoardCommand.SET_ENCODER_1,
        BoardCommand.SET_ENCODER_2,
        BoardCommand.RESET_E_STOP,
    }
)


class EncoderStatus(enum.IntFlag):
    """Status bits of one encoder, whose counter has the range 0 to 2**32 - 1."""

    UNDERFLOW = 0x1
    """The counter fell below 0 since this status was read last."""
    BACKWARD = 0x2
    OVERFLOW = 0x4
    """The counter rose above 2**32 - 1 since this status was read last."""


class Status(enum.IntFlag):
    """Status bits of current firmware (32 bits); the upper half are warnings."""

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
        """Error bits, on which the robot must stop."""
        return self & Status(0xFFFF)


# Old firmware replies with 16 bits in another layout; over-current and low voltage are warnings
# there too.
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
    """Return the packet of a read command."""
    return bytes((address, command))


def encode_write(address: int, command: BoardCommand, *values: int) -> bytes:
    """Return the packet of a write command.

    Args:
        address: Address of the board, 0x80 to 0x87.
        command: A key of `WRITES`.
        values: Payload of the command.

    Raises:
        ValueError: If a value does not fit its field; it is never truncated or wrapped.
    """
    try:
        payload = struct.pack(WRITES[command], *values)
    except struct.error as error:
        raise ValueError(f"{command.name} {values}: {error}; nothing was sent") from None
    body = bytes((address, command)) + payload
    return body + checksum(body)


def reply_length(command: BoardCommand) -> int:
    """Return the length of a reply of fixed layout, including its checksum [bytes]."""
    return struct.calcsize(READS[command]) + 2


def decode_reply(address: int, command: BoardCommand, reply: bytes) -> tuple[int, ...] | None:
    """Return the values of a reply, or None if it is not a valid reply to this command."""
    payload = checked(address, command, reply)
    if payload is None or len(payload) != struct.calcsize(READS[command]):
        return None
    return struct.unpack(READS[command], payload)


def checked(address: int, command: BoardCommand, reply: bytes) -> bytes | None:
    """Return the payload of a reply, or None if its checksum does not match."""
    payload, crc = reply[:-2], reply[-2:]
    return payload if checksum(bytes((address, command)) + payload) == crc else None


def decode_status_reply(address: int, reply: bytes) -> Status | None:
    """Return the status in a reply of either layout, or None if it is invalid.

    The checksum does not detect zeros appended to it: a short reply followed by two zeros would be
    accepted as a long one with wrong bits.
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
    """Return a status as the bytes that a board sends; the old layout omits some bits."""
    if not old_layout:
        return int(status).to_bytes(4, "big")
    return sum(bit for bit, meaning in _OLD_LAYOUT.items() if status & meaning).to_bytes(2, "big")


def signed_difference(later: int, earlier: int, bits: int = 32) -> int:
    """Return the smallest difference ``later - earlier`` of a counter that wraps at `bits`."""
    half = 1 << (bits - 1)
    return (later - earlier + half) % (1 << bits) - half


def duty_code(duty: float) -> int:
    """Return the wire code of a duty, saturated to [-1, 1].

    Raises:
        ValueError: If the duty is NaN, which saturation would turn into full drive.
    """
    if math.isnan(duty):
        raise ValueError("duty is not a number")
    return round(max(-1.0, min(1.0, duty)) * FULL_DUTY)
