"""RoboClaw boards that share one emulated serial line."""

import dataclasses
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Protocol

from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, Status

VERSION = "USB Roboclaw 2x15a v4.3.6\n\0"
_FIXED_POINT = 65536


class Motors(Protocol):
    """The two motors of one board, as the physics show them."""

    def counts(self) -> tuple[int, int]:
        """Return both encoders since power-on."""
        ...

    def currents(self) -> tuple[float, float]:
        """Return both motor currents [A]."""
        ...

    def voltage(self) -> float:
        """Return the main battery voltage [V]."""
        ...


@dataclasses.dataclass
class MotorChannel:
    """What a board keeps of one motor."""

    duty: int = 0
    target_speed: float | None = None
    target_position: tuple[int, int] | None = None  # position, most speed
    offset: int = 0
    rate: float = 0.0
    last_count: int = 0
    integral: float = 0.0
    gains: tuple[int, int, int, int] = (_FIXED_POINT, _FIXED_POINT // 2, 0, 44000)
    current_limit: int = 1500


class RoboClawBoard:
    """State and commands of one board.

    Speed and position commands run in the board, once a servo tick, with proportional and integral
    gains; position commands go straight, without the board's acceleration ramps.
    """

    def __init__(self, address: int, motors: Motors, old_firmware: bool = False) -> None:
        """Power on.

        Args:
            address: On the bus.
            motors: What it drives.
            old_firmware: Whether its status has 16 bits in the old layout.
        """
        self.address = address
        self.motors = motors
        self.old_firmware = old_firmware
        self.status = Status.NORMAL
        self.reset()

    def reset(self) -> None:
        """Power on anew: all that was set is forgotten, the encoders count from zero."""
        first, second = self.motors.counts()
        self.channels = (
            MotorChannel(offset=-first, last_count=first),
            MotorChannel(offset=-second, last_count=second),
        )
        self.timeout = 0
        self.pwm_mode = 0
        self._idle_since: float | None = None
        self.status = Status.NORMAL

    def duties(self) -> tuple[int, int]:
        """Return both duty codes that drive the motors; zero while an error is latched."""
        if self.status.errors:
            return 0, 0
        return self.channels[0].duty, self.channels[1].duty

    def tick(self, time: float, period: float) -> None:
        """Run the board's own loops and its watchdog to `time` [s]."""
        if self._idle_since is None:
            self._idle_since = time
        if self.timeout and time - self._idle_since >= 0.1 * self.timeout:
            for channel in self.channels:
                _stop(channel)
        for channel, count in zip(self.channels, self.motors.counts(), strict=True):
            channel.rate = codec.signed_difference(count, channel.last_count) / period
            channel.last_count = count
            _regulate(channel, count + channel.offset, period)
        for number, current in enumerate(self.motors.currents()):
            if abs(current) > 0.01 * self.channels[number].current_limit:
                self.status |= (Status.CURRENT_ERROR_1, Status.CURRENT_ERROR_2)[number]

    def preset(self, count: int) -> None:
        """Let both encoders stand at `count`, as after many turns."""
        self._set_encoder(0, count)
        self._set_encoder(1, count)

    def heard(self, time: float) -> None:
        """Note that a valid packet came: the watchdog starts anew."""
        self._idle_since = time

    def encoder(self, number: int) -> int:
        """Return an encoder as a signed 32-bit number."""
        count = self.motors.counts()[number] + self.channels[number].offset
        return codec.signed_difference(count, 0)

    def answer(self, command: BoardCommand) -> bytes:
        """Return the payload of a read."""
        if command is BoardCommand.GET_VERSION:
            return VERSION.encode()
        if command is BoardCommand.GET_STATUS:
            return self._status_word()
        return struct.pack(codec.READS[command], *self._values(command))

    def _status_word(self) -> bytes:
        status = self.status
        if self.motors.voltage() < 10.0:
            status |= Status.MAIN_VOLTAGE_LOW_WARNING
        return codec.encode_status(status, self.old_firmware)

    def _values(self, command: BoardCommand) -> Sequence[int]:
        one, two = self.channels
        encoders = self.encoder(0), self.encoder(1)
        speeds = round(one.rate), round(two.rate)
        match command:
            case BoardCommand.GET_TIMEOUT:
                return (self.timeout,)
            case BoardCommand.GET_ENCODER_1 | BoardCommand.GET_ENCODER_2:
                number = command - BoardCommand.GET_ENCODER_1
                return encoders[number], 2 * (speeds[number] < 0)
            case BoardCommand.GET_SPEED_1 | BoardCommand.GET_SPEED_2:
                number = command - BoardCommand.GET_SPEED_1
                return speeds[number], int(speeds[number] < 0)
            case BoardCommand.GET_MAIN_VOLTAGE:
                return (round(10 * self.motors.voltage()),)
            case BoardCommand.GET_LOGIC_VOLTAGE:
                return (50,)
            case BoardCommand.GET_DUTIES:
                return self.duties()
            case BoardCommand.GET_CURRENTS:
                return [round(100 * current) for current in self.motors.currents()]
            case BoardCommand.GET_VELOCITY_PID_1:
                return one.gains
            case BoardCommand.GET_VELOCITY_PID_2:
                return two.gains
            case BoardCommand.GET_ENCODERS:
                return encoders
            case BoardCommand.GET_RAW_SPEEDS:
                # Counts in the last 1/300 s, as a rate [1/s]: 300 counts/s is the least step.
                return [300 * int(speed / 300) for speed in speeds]
            case BoardCommand.GET_TEMPERATURE:
                return (250,)
            case BoardCommand.GET_CURRENT_LIMIT_1:
                return one.current_limit, 0
            case BoardCommand.GET_CURRENT_LIMIT_2:
                return two.current_limit, 0
            case _:
                return (self.pwm_mode,)

    def obey(self, command: BoardCommand, values: Sequence[int]) -> None:
        """Carry out a write."""
        one, two = self.channels
        match command:
            case BoardCommand.SET_TIMEOUT:
                self.timeout = values[0]
            case BoardCommand.RESET_ENCODERS:
                self._set_encoder(0, 0)
                self._set_encoder(1, 0)
            case BoardCommand.SET_ENCODER_1 | BoardCommand.SET_ENCODER_2:
                self._set_encoder(command - BoardCommand.SET_ENCODER_1, values[0])
            case BoardCommand.SET_VELOCITY_PID_1 | BoardCommand.SET_VELOCITY_PID_2:
                derivative, proportional, integral, full_speed = values
                channel = self.channels[command - BoardCommand.SET_VELOCITY_PID_1]
                channel.gains = proportional, integral, derivative, full_speed
            case BoardCommand.DUTY_1 | BoardCommand.DUTY_2:
                _set_duty(self.channels[command - BoardCommand.DUTY_1], values[0])
            case BoardCommand.DUTY_BOTH:
                _set_duty(one, values[0])
                _set_duty(two, values[1])
            case BoardCommand.SPEED_1 | BoardCommand.SPEED_2:
                _set_speed(self.channels[command - BoardCommand.SPEED_1], values[0])
            case BoardCommand.SPEED_BOTH:
                _set_speed(one, values[0])
                _set_speed(two, values[1])
            case BoardCommand.POSITION_1 | BoardCommand.POSITION_2:
                _set_position(
                    self.channels[command - BoardCommand.POSITION_1], values[3], values[1]
                )
            case BoardCommand.POSITION_BOTH:
                _set_position(one, values[3], values[1])
                _set_position(two, values[7], values[5])
            case BoardCommand.SET_CURRENT_LIMIT_1 | BoardCommand.SET_CURRENT_LIMIT_2:
                self.channels[command - BoardCommand.SET_CURRENT_LIMIT_1].current_limit = values[0]
            case BoardCommand.SET_PWM_MODE:
                self.pwm_mode = values[0]
            case BoardCommand.RESET_E_STOP:
                self.status &= ~Status.E_STOP
            case _:
                raise AssertionError(command)

    def _set_encoder(self, number: int, count: int) -> None:
        self.channels[number].offset = count - self.motors.counts()[number]


def _stop(channel: MotorChannel) -> None:
    channel.duty, channel.integral = 0, 0.0
    channel.target_speed = channel.target_position = None


def _set_duty(channel: MotorChannel, duty: int) -> None:
    _stop(channel)
    channel.duty = max(-codec.FULL_DUTY, duty)


def _set_speed(channel: MotorChannel, speed: int) -> None:
    channel.target_speed, channel.target_position = float(speed), None


def _set_position(channel: MotorChannel, position: int, speed: int) -> None:
    channel.target_position = position, speed


def _regulate(channel: MotorChannel, count: int, period: float) -> None:
    """Set the duty of a channel whose speed or position is asked for."""
    if channel.target_position is not None:
        position, most = channel.target_position
        # As fast as may still be stopped within a few ticks.
        speed = (position - count) / (5.0 * period)
        channel.target_speed = max(-most, min(most, speed))
    if channel.target_speed is None:
        return
    proportional, integral, _, full_speed = channel.gains
    error = (channel.target_speed - channel.rate) / max(1, full_speed)
    channel.integral += error * period * integral / _FIXED_POINT
    forward = channel.target_speed / max(1, full_speed)
    duty = forward + error * proportional / _FIXED_POINT + channel.integral
    channel.duty = codec.duty_code(duty if math.isfinite(duty) else 0.0)


class RoboClawLine:
    """Boards on one line: cuts the bytes into packets; only the board that is meant answers."""

    def __init__(self, boards: Sequence[RoboClawBoard]) -> None:
        """Put boards on the line.

        Args:
            boards: With different addresses.
        """
        self.boards: Mapping[int, RoboClawBoard] = {board.address: board for board in boards}
        self.time = 0.0
        self._buffer = b""
        self._last = -math.inf

    def tick(self, time: float, period: float) -> None:
        """Advance all boards to `time` [s] of the robot."""
        self.time = time
        for board in self.boards.values():
            board.tick(time, period)

    def feed(self, data: bytes, now: float) -> bytes:
        """Take what came on the wire at `now` [s], and return the answers."""
        if not data:
            return b""
        if now - self._last > codec.PACKET_GAP:
            self._buffer = b""
        self._last = now
        self._buffer += data
        replies = b""
        while len(self._buffer) >= 2:
            length, reply = self._packet()
            if length == 0:
                break
            self._buffer = self._buffer[length:]
            replies += reply
        return replies

    def _packet(self) -> tuple[int, bytes]:
        """Return the length of the first packet, zero if it is not whole, and its answer."""
        address, number = self._buffer[:2]
        board = self.boards.get(address)
        try:
            command = BoardCommand(number)
        except ValueError:
            command = None
        if board is None or command is None:
            # Nobody is meant, or nobody understands: it is dropped with all that follows it.
            return len(self._buffer), b""
        if command not in codec.WRITES:
            board.heard(self.time)
            payload = board.answer(command)
            return 2, payload + codec.checksum(bytes((address, command)) + payload)
        length = 4 + struct.calcsize(codec.WRITES[command])
        if len(self._buffer) < length:
            return 0, b""
        packet = self._buffer[:length]
        if codec.checksum(packet[:-2]) != packet[-2:]:
            return len(self._buffer), b""
        board.heard(self.time)
        board.obey(command, struct.unpack(codec.WRITES[command], packet[2:-2]))
        return length, bytes((codec.ACKNOWLEDGE,))
