"""Messages between rovers: poses and wrenches packed into bytes.

The first byte is the format's version and the message's type; numbers are big-endian integers in
fixed steps, so that both ends round alike.
"""

import dataclasses
import math
import struct
from collections.abc import Callable

from twin.link import RadioError

VERSION = 1
_POSE_TYPE, _WRENCH_TYPE = (VERSION << 4 | kind for kind in (1, 2))
_POSE = struct.Struct(">BBi3h3hH")
_WRENCH = struct.Struct(">BBi6h")

_MILLI = 1e-3  # steps of time [s], position [m], moment [N m]
_FORCE = 1e-2  # [N]
_ANGLE = math.pi / (1 << 15)  # [rad]

Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class PoseMessage:
    """A robot's estimate of its pose; 20 bytes.

    Attributes:
        robot: Number of the robot, 0 to 255.
        time: Robot time of the pose [s], within 24 days, in steps of 1 ms.
        position: x, y, z [m], world, within 32.7 m, in steps of 1 mm.
        attitude: Pitch, roll and yaw about x, y and z [rad], modulo a turn, in steps of pi / 2^15.
        deviation: Standard deviation of the position [m], up to 65.5 m, in steps of 1 mm.
    """

    robot: int
    time: float
    position: Vector
    attitude: Vector
    deviation: float

    def pack(self) -> bytes:
        """Return the message's bytes.

        Raises:
            RadioError: If a number is out of range or not finite.
        """
        wrapped = [math.remainder(_finite("attitude", a), math.tau) for a in self.attitude]
        # Half a turn is the one angle that is out of the integers' range.
        angles = [(round(a / _ANGLE) + (1 << 15)) % (1 << 16) - (1 << 15) for a in wrapped]
        return _POSE.pack(
            _POSE_TYPE,
            _integer("robot", self.robot, 1, 0, 0xFF),
            _integer("time", self.time, _MILLI, -0x80000000, 0x7FFFFFFF),
            *(_integer("position", p, _MILLI, -0x8000, 0x7FFF) for p in self.position),
            *angles,
            _integer("deviation", self.deviation, _MILLI, 0, 0xFFFF),
        )


@dataclasses.dataclass(frozen=True)
class WrenchMessage:
    """The wrench of a rover on its arm; 18 bytes.

    Attributes:
        robot: Number of the robot, 0 to 255.
        time: Robot time of the sample [s], within 24 days, in steps of 1 ms.
        force: Force [N], arm base frame, within 327 N, in steps of 0.01 N.
        moment: Moment [N m] about the arm base frame, within 32.7 N m, in steps of 0.001 N m.
    """

    robot: int
    time: float
    force: Vector
    moment: Vector

    def pack(self) -> bytes:
        """Return the message's bytes.

        Raises:
            RadioError: If a number is out of range or not finite.
        """
        return _WRENCH.pack(
            _WRENCH_TYPE,
            _integer("robot", self.robot, 1, 0, 0xFF),
            _integer("time", self.time, _MILLI, -0x80000000, 0x7FFFFFFF),
            *(_integer("force", f, _FORCE, -0x8000, 0x7FFF) for f in self.force),
            *(_integer("moment", m, _MILLI, -0x8000, 0x7FFF) for m in self.moment),
        )


Message = PoseMessage | WrenchMessage


def unpack(message: bytes) -> Message:
    """Return the content of a message.

    Args:
        message: Bytes as received.

    Raises:
        RadioError: If its type, version or length is unknown.
    """
    if not message:
        raise RadioError("radio message is empty")
    kind = message[0]
    if kind not in _UNPACK:
        known = ", ".join(f"0x{each:02x}" for each in _UNPACK)
        raise RadioError(f"radio message of type 0x{kind:02x} is unknown; known: {known}")
    try:
        return _UNPACK[kind](message)
    except struct.error:
        raise RadioError(
            f"radio message of type 0x{kind:02x} with {len(message)} bytes has a wrong length"
        ) from None


def _unpack_pose(message: bytes) -> PoseMessage:
    _, robot, time, x, y, z, pitch, roll, yaw, deviation = _POSE.unpack(message)
    position = x * _MILLI, y * _MILLI, z * _MILLI
    attitude = pitch * _ANGLE, roll * _ANGLE, yaw * _ANGLE
    return PoseMessage(robot, time * _MILLI, position, attitude, deviation * _MILLI)


def _unpack_wrench(message: bytes) -> WrenchMessage:
    _, robot, time, *axes = _WRENCH.unpack(message)
    force = axes[0] * _FORCE, axes[1] * _FORCE, axes[2] * _FORCE
    moment = axes[3] * _MILLI, axes[4] * _MILLI, axes[5] * _MILLI
    return WrenchMessage(robot, time * _MILLI, force, moment)


_UNPACK: dict[int, Callable[[bytes], Message]] = {
    _POSE_TYPE: _unpack_pose,
    _WRENCH_TYPE: _unpack_wrench,
}


def _finite(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise RadioError(f"radio message: {name} {value} is not finite; nothing was sent")
    return value


def _integer(name: str, value: float, step: float, low: int, high: int) -> int:
    """Return a number in steps, or refuse it."""
    count = round(_finite(name, value) / step)
    if not low <= count <= high:
        raise RadioError(
            f"radio message: {name} {value} is not within {low * step:g} to {high * step:g}"
        )
    return count
