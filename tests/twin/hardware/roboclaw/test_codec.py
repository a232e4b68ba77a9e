import binascii
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, Status

pytestmark = pytest.mark.virtual_time

# Packets as the user manual writes them: address, command, payload, checksum.
WRITES = [
    (0x80, BoardCommand.SET_TIMEOUT, (0,), "80 0e 00 18 55"),
    (0x87, BoardCommand.SET_TIMEOUT, (255,), "87 0e ff 83 35"),
    (0x80, BoardCommand.RESET_ENCODERS, (), "80 14 49 2d"),
    (0x80, BoardCommand.SET_ENCODER_1, (-(2**31),), "80 16 80 00 00 00 c0 c7"),
    (0x81, BoardCommand.SET_ENCODER_2, (2**31 - 1,), "81 17 7f ff ff ff b6 f9"),
    (0x80, BoardCommand.SET_ENCODER_2, (-1,), "80 17 ff ff ff ff 2e 61"),
    (
        0x82,  # D, P, I, counts a second: 0.25, 1.0, 0.5, 44000
        BoardCommand.SET_VELOCITY_PID_1,
        (0x4000, 0x10000, 0x8000, 44000),
        "82 1c 00 00 40 00 00 01 00 00 00 00 80 00 00 00 ab e0 d6 b9",
    ),
    (
        0x82,
        BoardCommand.SET_VELOCITY_PID_2,
        (0, 2**32 - 1, 1, 2**32 - 1),
        "82 1d 00 00 00 00 ff ff ff ff 00 00 00 01 ff ff ff ff 8b 79",
    ),
    (0x80, BoardCommand.DUTY_1, (32767,), "80 20 7f ff 5d 69"),
    (0x80, BoardCommand.DUTY_2, (-32767,), "80 21 80 01 67 77"),
    (0x80, BoardCommand.DUTY_BOTH, (32767, -32767), "80 22 7f ff 80 01 ca 56"),
    (0x83, BoardCommand.DUTY_BOTH, (0, -1), "83 22 00 00 ff ff 4b f8"),
    (0x80, BoardCommand.SPEED_1, (-(2**31),), "80 23 80 00 00 00 ef 7e"),
    (0x80, BoardCommand.SPEED_2, (2**31 - 1,), "80 24 7f ff ff ff 11 65"),
    (0x81, BoardCommand.SPEED_BOTH, (-1, 1), "81 25 ff ff ff ff 00 00 00 01 74 4e"),
    (
        0x80,
        BoardCommand.POSITION_1,
        (1000, 2000, 3000, -10, 1),
        "80 41 00 00 03 e8 00 00 07 d0 00 00 0b b8 ff ff ff f6 01 91 ca",
    ),
    (
        0x80,
        BoardCommand.POSITION_2,
        (2**32 - 1, 0, 1, -(2**31), 0),
        "80 42 ff ff ff ff 00 00 00 00 00 00 00 01 80 00 00 00 00 77 4a",
    ),
    (
        0x80,
        BoardCommand.POSITION_BOTH,
        (1, 2, 3, 4, 5, 6, 7, -8, 1),
        "80 43 00 00 00 01 00 00 00 02 00 00 00 03 00 00 00 04"
        "00 00 00 05 00 00 00 06 00 00 00 07 ff ff ff f8 01 1b 14",
    ),
    # Where the manual explains 133, its packet shows 134; the motors' numbers distinguish them.
    (0x80, BoardCommand.SET_CURRENT_LIMIT_1, (1500, 0), "80 85 00 00 05 dc 00 00 00 00 d3 82"),
    (0x80, BoardCommand.SET_CURRENT_LIMIT_2, (2**32 - 1, 0), "80 86 ff ff ff ff 00 00 00 00 3e 20"),
    (0x80, BoardCommand.SET_PWM_MODE, (1,), "80 94 01 ff 54"),
    (0x80, BoardCommand.RESET_E_STOP, (), "80 c8 43 dc"),
]
READS = [
    (0x80, BoardCommand.GET_TIMEOUT, "80 0f", "05 7b c1", (5,)),
    (0x80, BoardCommand.GET_ENCODER_1, "80 10", "80 00 00 00 02 b3 ef", (-(2**31), 2)),
    (0x80, BoardCommand.GET_ENCODER_2, "80 11", "7f ff ff ff 04 4b 19", (2**31 - 1, 4)),
    (0x80, BoardCommand.GET_SPEED_1, "80 12", "ff ff ff ff 01 f7 8c", (-1, 1)),
    (0x80, BoardCommand.GET_SPEED_2, "80 13", "00 00 00 00 00 7f 9d", (0, 0)),
    (0x80, BoardCommand.GET_MAIN_VOLTAGE, "80 18", "00 78 c8 65", (120,)),
    (0x80, BoardCommand.GET_LOGIC_VOLTAGE, "80 19", "ff ff 1d c5", (65535,)),
    (0x80, BoardCommand.GET_DUTIES, "80 30", "7f ff 80 01 8a 8f", (32767, -32767)),
    (0x80, BoardCommand.GET_CURRENTS, "80 31", "ff f6 0b b8 92 e7", (-10, 3000)),
    (
        0x80,  # P, I, D, counts a second: not the order in which they are set
        BoardCommand.GET_VELOCITY_PID_1,
        "80 37",
        "00 01 00 00 00 00 80 00 00 00 40 00 00 00 ab e0 ab c0",
        (0x10000, 0x8000, 0x4000, 44000),
    ),
    (
        0x80,
        BoardCommand.GET_VELOCITY_PID_2,
        "80 38",
        "ff ff ff ff 00 00 00 00 00 00 00 01 ff ff ff ff b2 f2",
        (2**32 - 1, 0, 1, 2**32 - 1),
    ),
    (
        0x83,
        BoardCommand.GET_ENCODERS,
        "83 4e",
        "80 00 00 00 7f ff ff ff c0 23",
        (-(2**31), 2**31 - 1),
    ),
    (0x80, BoardCommand.GET_RAW_SPEEDS, "80 4f", "ff ff ff ff 00 00 00 00 1c 97", (-1, 0)),
    (0x80, BoardCommand.GET_TEMPERATURE, "80 52", "00 fa a3 c3", (250,)),
    (0x80, BoardCommand.GET_CURRENT_LIMIT_1, "80 87", "00 00 05 dc 00 00 00 00 15 e5", (1500, 0)),
    (
        0x80,
        BoardCommand.GET_CURRENT_LIMIT_2,
        "80 88",
        "ff ff ff ff 00 00 00 00 4d 57",
        (2**32 - 1, 0),
    ),
    (0x80, BoardCommand.GET_PWM_MODE, "80 95", "01 cc 65", (1,)),
]
# Present and old status words of the manual; the old one's home bits have no present ones.
PRESENT = {
    "E_STOP": 0x1,
    "TEMPERATURE": 0x2,
    "TEMPERATURE_2": 0x4,
    "MAIN_VOLTAGE_HIGH": 0x8,
    "LOGIC_VOLTAGE_HIGH": 0x10,
    "LOGIC_VOLTAGE_LOW": 0x20,
    "DRIVER_FAULT_1": 0x40,
    "DRIVER_FAULT_2": 0x80,
    "SPEED_ERROR_1": 0x100,
    "SPEED_ERROR_2": 0x200,
    "POSITION_ERROR_1": 0x400,
    "POSITION_ERROR_2": 0x800,
    "CURRENT_ERROR_1": 0x1000,
    "CURRENT_ERROR_2": 0x2000,
    "OVER_CURRENT_WARNING_1": 0x10000,
    "OVER_CURRENT_WARNING_2": 0x20000,
    "MAIN_VOLTAGE_HIGH_WARNING": 0x40000,
    "MAIN_VOLTAGE_LOW_WARNING": 0x80000,
    "TEMPERATURE_WARNING": 0x100000,
    "TEMPERATURE_2_WARNING": 0x200000,
}
OLD = [
    "OVER_CURRENT_WARNING_1",
    "OVER_CURRENT_WARNING_2",
    "E_STOP",
    "TEMPERATURE",
    "TEMPERATURE_2",
    "MAIN_VOLTAGE_HIGH",
    "LOGIC_VOLTAGE_HIGH",
    "LOGIC_VOLTAGE_LOW",
    "DRIVER_FAULT_1",
    "DRIVER_FAULT_2",
    "MAIN_VOLTAGE_HIGH_WARNING",
    "MAIN_VOLTAGE_LOW_WARNING",
    "TEMPERATURE_WARNING",
    "TEMPERATURE_2_WARNING",
]
RANGES = {
    "B": (0, 255),
    "H": (0, 65535),
    "h": (-32768, 32767),
    "I": (0, 2**32 - 1),
    "i": (-(2**31), 2**31 - 1),
}


def values_of(layout):
    return st.tuples(*(st.integers(*RANGES[letter]) for letter in layout[1:]))


def named(command):
    return command.name if isinstance(command, BoardCommand) else None


def test_checksum_is_xmodem():
    assert codec.checksum(b"123456789") == bytes.fromhex("31c3")
    noise = np.random.default_rng(0).bytes(1000)
    assert all(
        int.from_bytes(codec.checksum(noise[:n]), "big") == binascii.crc_hqx(noise[:n], 0)
        for n in range(1000)
    )


def test_every_write_and_read_has_a_vector():
    assert {write[1] for write in WRITES} == set(codec.WRITES)
    assert {read[1] for read in READS} == set(codec.READS)
    both = (
        set(codec.WRITES) | set(codec.READS) | {BoardCommand.GET_VERSION, BoardCommand.GET_STATUS}
    )
    assert both == set(BoardCommand)
    # The manual's firmwares disagree on these.
    assert not {int(command) for command in BoardCommand} & set(range(98, 105))


@pytest.mark.parametrize(("address", "command", "values", "packet"), WRITES, ids=named)
def test_write_is_the_manuals_packet(address, command, values, packet):
    assert codec.encode_write(address, command, *values) == bytes.fromhex(packet)


@pytest.mark.parametrize(("address", "command", "request_", "reply", "values"), READS, ids=named)
def test_read_is_the_manuals_exchange(address, command, request_, reply, values):
    assert codec.encode_read(address, command) == bytes.fromhex(request_)
    assert codec.reply_length(command) == len(bytes.fromhex(reply))
    assert codec.decode_reply(address, command, bytes.fromhex(reply)) == values


def test_answer_to_another_board_or_question_is_none():
    reply = bytes.fromhex("80 00 00 00 7f ff ff ff c0 23")
    assert codec.decode_reply(0x83, BoardCommand.GET_ENCODERS, reply) is not None
    assert codec.decode_reply(0x82, BoardCommand.GET_ENCODERS, reply) is None
    assert codec.decode_reply(0x83, BoardCommand.GET_RAW_SPEEDS, reply) is None
    # A checksum over the payload alone, as one public emulator sends it.
    alone = reply[:8] + binascii.crc_hqx(reply[:8], 0).to_bytes(2, "big")
    assert codec.decode_reply(0x83, BoardCommand.GET_ENCODERS, alone) is None


def test_reply_of_another_length_is_none_though_its_checksum_fits():
    payload = bytes(4)
    crc = binascii.crc_hqx(bytes((0x80, BoardCommand.GET_MAIN_VOLTAGE)) + payload, 0)
    reply = payload + crc.to_bytes(2, "big")
    assert codec.checked(0x80, BoardCommand.GET_MAIN_VOLTAGE, reply) == payload
    assert codec.decode_reply(0x80, BoardCommand.GET_MAIN_VOLTAGE, reply) is None
    assert codec.decode_reply(0x80, BoardCommand.GET_MAIN_VOLTAGE, b"") is None
    assert codec.decode_reply(0x80, BoardCommand.GET_MAIN_VOLTAGE, b"\0") is None


@pytest.mark.parametrize(("command", "layout"), codec.WRITES.items(), ids=named)
def test_value_that_does_not_fit_is_refused_not_wrapped(command, layout):
    fields = layout[1:]
    for place, letter in enumerate(fields):
        low, high = RANGES[letter]
        for wrong in (low - 1, high + 1, 0.5, math.nan, math.inf, None):
            values = [0] * len(fields)
            values[place] = wrong
            with pytest.raises(ValueError, match=f"{command.name} .*nothing was sent"):
                codec.encode_write(0x80, command, *values)
    with pytest.raises(ValueError, match="nothing was sent"):
        codec.encode_write(0x80, command, *([0] * (len(fields) + 1)))


def test_duty_saturates_at_full_drive_and_never_wraps():
    assert [codec.duty_code(duty) for duty in (-1.0, -0.5, 0.0, 0.5, 1.0)] == [
        -32767,
        -16384,
        0,
        16384,
        32767,
    ]
    # 40000 counts, which a public client sends as -25536.
    for duty in (1.0 + 1e-12, 40000 / 32767, 1e300, math.inf):
        assert codec.duty_code(duty) == 32767 and codec.duty_code(-duty) == -32767


def test_duty_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="not a number"):
        codec.duty_code(math.nan)


@pytest.mark.parametrize(("name", "bit"), PRESENT.items())
def test_status_bit_has_the_manuals_place(name, bit):
    status = codec.decode_status(bit.to_bytes(4, "big"))
    assert status == Status[name] == bit
    assert codec.encode_status(status) == bit.to_bytes(4, "big")
    assert bool(status.errors) == (bit < 0x10000)


@pytest.mark.parametrize(("place", "name"), list(enumerate(OLD)))
def test_old_status_bit_means_the_same_as_the_present_one(place, name):
    old = (1 << place).to_bytes(2, "big")
    assert codec.decode_status(old) == Status[name]
    assert codec.encode_status(Status[name], old_layout=True) == old


def test_both_layouts_are_distinguished_by_length_and_checksum():
    new, old = bytes.fromhex("00002001 917b"), bytes.fromhex("0084 953b")
    read = codec.decode_status_reply(0x80, new)
    assert read == Status.CURRENT_ERROR_2 | Status.E_STOP
    read = codec.decode_status_reply(0x80, old)
    assert read == Status.LOGIC_VOLTAGE_LOW | Status.E_STOP
    assert codec.decode_status_reply(0x81, new) is None
    assert codec.decode_status_reply(0x80, new[:4]) is None
    assert codec.decode_status_reply(0x80, old[:3]) is None
    for length in (0, 1, 3, 5):
        assert codec.decode_status(bytes(length)) is None
    assert not codec.decode_status(bytes.fromhex("c000"))  # Both homes.
    assert not codec.decode_status(bytes.fromhex("00c00000")).errors  # S4 and S5.


def test_old_status_with_zeros_behind_it_is_no_present_one():
    old = bytes.fromhex("0084 953b")
    assert binascii.crc_hqx(b"\x80\x5a" + old + b"\0\0", 0) == 0  # The checksum does not see it.
    assert codec.decode_status_reply(0x80, old + b"\0\0") is None


def test_version_is_checked_text():
    text = b"USB Roboclaw 2x15a v4.3.6\n\0"
    assert codec.checked(0x80, BoardCommand.GET_VERSION, text + bytes.fromhex("0032")) == text
    assert text.endswith(codec.VERSION_END) and len(text) <= codec.LONGEST_VERSION
    assert codec.checked(0x80, BoardCommand.GET_VERSION, text + bytes.fromhex("0033")) is None


@given(st.sampled_from(sorted(codec.WRITES)), st.integers(0x80, 0x87), st.data())
def test_write_is_read_back(command, address, draw):
    layout = codec.WRITES[command]
    values = draw.draw(values_of(layout))
    packet = codec.encode_write(address, command, *values)
    assert packet[:2] == bytes((address, command))
    assert struct.unpack(layout, packet[2:-2]) == values
    assert binascii.crc_hqx(packet, 0) == 0  # Nothing is left over a sound packet.


@given(st.sampled_from(sorted(codec.READS)), st.integers(0x80, 0x87), st.data())
def test_reply_is_read_back_and_refused_when_up_to_three_bits_flip(command, address, draw):
    values = draw.draw(values_of(codec.READS[command]))
    payload = struct.pack(codec.READS[command], *values)
    crc = binascii.crc_hqx(bytes((address, command)) + payload, 0)
    reply = payload + crc.to_bytes(2, "big")
    assert codec.decode_reply(address, command, reply) == values
    places = draw.draw(st.sets(st.integers(0, 8 * len(reply) - 1), min_size=1, max_size=3))
    flipped = int.from_bytes(reply, "big") ^ sum(1 << place for place in places)
    assert codec.decode_reply(address, command, flipped.to_bytes(len(reply), "big")) is None


@given(st.integers(0, 2**32 - 1))
def test_present_status_is_kept_whole(word):
    assert int(codec.decode_status(word.to_bytes(4, "big"))) == word
    assert codec.encode_status(Status(word)) == word.to_bytes(4, "big")


@given(st.integers(-(2**40), 2**40), st.integers(-(2**31), 2**31 - 1))
def test_difference_of_wrapped_counters_is_the_smallest(count, step):
    def wrapped(value):
        return (value + 2**31) % 2**32 - 2**31

    assert codec.signed_difference(wrapped(count + step), wrapped(count)) == step


@given(st.floats(allow_nan=False))
def test_duty_code_keeps_sign_and_range(duty):
    code = codec.duty_code(duty)
    assert abs(code) <= 32767 and code * duty >= 0
