"""RoboClaw boards that share one emulated serial line."""

import dataclasses
import math
import struct
from collections.abc import Callable, Mapping, Sequence

from twin.hardware.roboclaw import codec
from twin.hardware.roboclaw.codec import BoardCommand, EncoderStatus, Status

VERSION = "USB Roboclaw 2x15a v4.3.6\n\0"
_FIXED_POINT = 65536


@dataclasses.dataclass
class Motors:
    """State of the two motors of one board.

    Attributes:
        counts: Encoder counts (2,) since power-on.
        currents: Motor currents (2,) [A].
        voltage: Main battery voltage [V].
    """

    counts: Sequence[int] = (0, 0)
    currents: Sequence[float] = (0.0, 0.0)
    voltage: float = 12.0


@dataclasses.dataclass
class MotorChannel:
    """State of one motor in its board."""

    duty: int = 0
    target_speed: float | None = None
    target_position: tuple[int, int] | None = None  # position, most speed
    offset: int = 0
    wrapped: EncoderStatus = EncoderStatus(0)
    turn: int = 0
    rate: float = 0.0
    last_count: int = 0
    integral: float = 0.0
    gains: tuple[int, int, int, int] = (_FIXED_POINT, _FIXED_POINT // 2, 0, 44000)
    current_limit: int = 1500

    def stop(self) -> None:
        """Set the duty to zero and end speed and position control."""
        self.duty, self.integral = 0, 0.0
        self.target_speed = self.target_position = None

    def set_duty(self, values: Sequence[int]) -> None:
        """Set the duty code, the first of the values."""
        self.stop()
        self.duty = max(-codec.FULL_DUTY, values[0])

    def set_speed(self, values: Sequence[int]) -> None:
        """Control the speed to the first of the values."""
        self.target_speed, self.target_position = float(values[0]), None

    def set_position(self, values: Sequence[int]) -> None:
        """Control the position; the values are acceleration, speed, deceleration and position."""
        self.target_position = values[3], values[1]

    def set_gains(self, values: Sequence[int]) -> None:
        """Set the gains of the speed control; the values are D, P, I and the full speed."""
        derivative, proportional, integral, full_speed = values
        self.gains = proportional, integral, derivative, full_speed

    def set_current_limit(self, values: Sequence[int]) -> None:
        """Set the largest current, the first of the values."""
        self.current_limit = values[0]

    def notice_wrap(self, count: int) -> None:
        """Note that the counter of 32 bits left its range."""
        turn = (count + self.offset) >> 32
        if turn != self.turn:
            up = turn > self.turn
            self.wrapped |= EncoderStatus.OVERFLOW if up else EncoderStatus.UNDERFLOW
            self.turn = turn

    def take_status(self) -> EncoderStatus:
        """Return the encoder's status, which forgets its wraps by that."""
        status = self.wrapped | (EncoderStatus.BACKWARD if round(self.rate) < 0 else 0)
        self.wrapped = EncoderStatus(0)
        return EncoderStatus(status)

    def regulate(self, count: int, period: float) -> None:
        """Set the duty if speed or position is controlled."""
        if self.target_position is not None:
            position, most = self.target_position
            # As fast as may still be stopped within a few ticks.
            speed = (position - count) / (5.0 * period)
            self.target_speed = max(-most, min(most, speed))
        if self.target_speed is None:
            return
        proportional, integral, _, full_speed = self.gains
        error = (self.target_speed - self.rate) / max(1, full_speed)
        self.integral += error * period * integral / _FIXED_POINT
        forward = self.target_speed / max(1, full_speed)
        duty = forward + error * proportional / _FIXED_POINT + self.integral
        self.duty = codec.duty_code(duty if math.isfinite(duty) else 0.0)


_CHANNEL_WRITES: Mapping[str, Callable[[MotorChannel, Sequence[int]], None]] = {
    "DUTY": MotorChannel.set_duty,
    "SPEED": MotorChannel.set_speed,
    "POSITION": MotorChannel.set_position,
    "SET_VELOCITY_PID": MotorChannel.set_gains,
    "SET_CURRENT_LIMIT": MotorChannel.set_current_limit,
}
"""Writes that end in _1, _2 or _BOTH, by the rest of their names."""


class RoboClawBoard:
    """State and commands of one board.

    Speed and position commands run in the board, once a servo tick, with proportional and integral
    gains; position commands go straight, without the board's acceleration ramps.

    Attributes:
        dead: Whether it has no power: it neither hears nor drives.
    """

    def __init__(self, address: int, motors: Motors, old_firmware: bool = False) -> None:
        """Power on.

        Args:
            address: Address on the bus.
            motors: Motors that it drives.
            old_firmware: Whether its status has 16 bits in the old layout.
        """
        self.address = address
        self.motors = motors
        self.old_firmware = old_firmware
        self.dead = False
        self.reset()

    def reset(self) -> None:
        """Power on anew: all settings are forgotten, the encoders count from zero."""
        one, two = (MotorChannel(offset=-count, last_count=count) for count in self.motors.counts)
        self.channels = one, two
        self.timeout = 0
        self.pwm_mode = 0
        self._idle_since: float | None = None
        self.status = Status.NORMAL

    def duties(self) -> tuple[int, int]:
        """Return both duty codes that drive the motors; zero while an error is latched."""
        if self.dead or self.status.errors:
            return 0, 0
        return self.channels[0].duty, self.channels[1].duty

    def tick(self, time: float, period: float) -> None:
        """Run the board's own loops and its watchdog to `time` [s]."""
        if self._idle_since is None:
            self._idle_since = time
        if self.timeout and time - self._idle_since >= 0.1 * self.timeout:
            for channel in self.channels:
                channel.stop()
        for channel, count in zip(self.channels, self.motors.counts, strict=True):
            channel.rate = codec.signed_difference(count, channel.last_count) / period
            channel.last_count = count
            channel.notice_wrap(count)
            channel.regulate(count + channel.offset, period)
        for number, current in enumerate(self.motors.currents):
            if abs(current) > 0.01 * self.channels[number].current_limit:
                self.status |= (Status.CURRENT_ERROR_1, Status.CURRENT_ERROR_2)[number]

    def preset(self, count: int) -> None:
        """Set both encoders to `count`."""
        self._set_encoder(0, count)
        self._set_encoder(1, count)

    def heard(self, time: float) -> None:
        """Note that a valid packet came: the watchdog starts anew."""
        self._idle_since = time

    def encoders(self) -> tuple[int, int]:
        """Return both encoders as signed 32-bit numbers."""
        pairs = zip(self.motors.counts, self.channels, strict=True)
        one, two = (codec.signed_difference(count + each.offset, 0) for count, each in pairs)
        return one, two

    def answer(self, command: BoardCommand) -> bytes:
        """Return the payload of a read."""
        if command is BoardCommand.GET_VERSION:
            return VERSION.encode()
        if command is BoardCommand.GET_STATUS:
            low = self.motors.voltage < 10.0
            warning = Status.MAIN_VOLTAGE_LOW_WARNING if low else Status.NORMAL
            return codec.encode_status(self.status | warning, self.old_firmware)
        if command in (BoardCommand.GET_ENCODER_1, BoardCommand.GET_ENCODER_2):
            number = command - BoardCommand.GET_ENCODER_1
            channel = self.channels[number]
            channel.notice_wrap(self.motors.counts[number])
            status = channel.take_status()
            return struct.pack(codec.READS[command], self.encoders()[number], status)
        return struct.pack(codec.READS[command], *self._values(command))

    def _values(self, command: BoardCommand) -> Sequence[int]:
        one, two = self.channels
        encoders = self.encoders()
        speeds = round(one.rate), round(two.rate)
        values: Mapping[BoardCommand, Sequence[int]] = {
            BoardCommand.GET_TIMEOUT: (self.timeout,),
            BoardCommand.GET_SPEED_1: (speeds[0], int(speeds[0] < 0)),
            BoardCommand.GET_SPEED_2: (speeds[1], int(speeds[1] < 0)),
            BoardCommand.GET_MAIN_VOLTAGE: (round(10 * self.motors.voltage),),
            BoardCommand.GET_LOGIC_VOLTAGE: (50,),
            BoardCommand.GET_DUTIES: self.duties(),
            BoardCommand.GET_CURRENTS: [round(100 * each) for each in self.motors.currents],
            BoardCommand.GET_VELOCITY_PID_1: one.gains,
            BoardCommand.GET_VELOCITY_PID_2: two.gains,
            BoardCommand.GET_ENCODERS: encoders,
            # Counts in the last 1/300 s, as a rate [1/s]: 300 counts/s is the least step.
            BoardCommand.GET_RAW_SPEEDS: [300 * int(speed / 300) for speed in speeds],
            BoardCommand.GET_TEMPERATURE: (250,),
            BoardCommand.GET_CURRENT_LIMIT_1: (one.current_limit, 0),
            BoardCommand.GET_CURRENT_LIMIT_2: (two.current_limit, 0),
            BoardCommand.GET_PWM_MODE: (self.pwm_mode,),
        }
        return values[command]

    def obey(self, command: BoardCommand, values: Sequence[int]) -> None:
        """Carry out a write."""
        match command:
            case BoardCommand.SET_TIMEOUT:
                self.timeout = values[0]
            case BoardCommand.RESET_ENCODERS:
                self.preset(0)
            case BoardCommand.SET_ENCODER_1 | BoardCommand.SET_ENCODER_2:
                self._set_encoder(command - BoardCommand.SET_ENCODER_1, values[0])
            case BoardCommand.SET_PWM_MODE:
                self.pwm_mode = values[0]
            case BoardCommand.RESET_E_STOP:
                self.status &= ~Status.E_STOP
            case _:
                kind, _, which = command.name.rpartition("_")
                channels = self.channels if which == "BOTH" else [self.channels[int(which) - 1]]
                share = len(values) // len(channels)
                for number, channel in enumerate(channels):
                    _CHANNEL_WRITES[kind](channel, values[number * share :])

    def _set_encoder(self, number: int, count: int) -> None:
        channel = self.channels[number]
        channel.offset, channel.turn = count - self.motors.counts[number], count >> 32


class RoboClawLine:
    """Boards on one line: cuts the bytes into packets; only the addressed board answers.

    Args:
        boards: Boards with different addresses.
    """

    def __init__(self, boards: Sequence[RoboClawBoard]) -> None:
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
        """Take the bytes that came at `now` [s], and return the answers."""
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
        if board is None or board.dead or command is None:
            # An unknown address or command: it is dropped with all that follows it.
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
