"""What the rovers send each other: poses, wrenches and changes of a map, packed into bytes.

The first byte is the format's version and the message's type; numbers are big-endian integers in
fixed steps, so that both ends round alike.
"""

import dataclasses
import math
import struct
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.link import MESSAGE_LIMIT, RadioError

VERSION = 1
_POSE_TYPE, _WRENCH_TYPE, _MAP_TYPE = (VERSION << 4 | kind for kind in (1, 2, 3))
_POSE = struct.Struct(">BBi3h3hH")
_WRENCH = struct.Struct(">BBi6h")
_MAP = struct.Struct(">BBHH")
_PAIR = np.dtype([("voxel", ">u4"), ("occupancy", "u1")])

_MILLI = 1e-3  # steps of time [s], position [m], moment [N m]
_FORCE = 1e-2  # [N]
_ANGLE = math.pi / (1 << 15)  # [rad]

Vector = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class PoseMessage:
    """Where a robot believes to be; 20 bytes.

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
    """The wrench by the rover on its arm; 18 bytes.

    Attributes:
        robot: Number of the robot, 0 to 255.
        time: Robot time of the sample [s], within 24 days, in steps of 1 ms.
        force: [N], arm base frame, within 327 N, in steps of 0.01 N.
        moment: [N m], about the arm base frame, within 32.7 N m, in steps of 0.001 N m.
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


@dataclasses.dataclass(frozen=True)
class MapDelta:
    """A run of voxels of a map that have changed.

    Attributes:
        robot: Number of the robot, 0 to 255.
        revision: Map revision, 0 to 65535: all messages of one change carry the same.
        remaining: Voxels of this change that later messages bring; 0 in the last one.
        voxels: (n,) indices, uint32.
        occupancies: (n,) occupancy, uint8.
    """

    robot: int
    revision: int
    remaining: int
    voxels: NDArray[np.uint32]
    occupancies: NDArray[np.uint8]


Message = PoseMessage | WrenchMessage | MapDelta


def pack_map_change(
    robot: int,
    revision: int,
    voxels: ArrayLike,
    occupancies: ArrayLike,
    limit: int = MESSAGE_LIMIT,
) -> Iterator[bytes]:
    """Cut a change of a map into messages, to be sent in this order by the acknowledged `send`.

    Args:
        robot: Number of the robot, 0 to 255.
        revision: Map revision, 0 to 65535.
        voxels: (n,) indices, 0 to 2^32 - 1; n up to 65535, 0 for no message at all.
        occupancies: (n,) occupancy of each, 0 to 255.
        limit: Longest message [bytes].

    Returns:
        The messages, each with as many voxels as it can hold: 11 in 64 bytes.

    Raises:
        RadioError: If a number is out of range, the lengths differ or not one voxel fits.
    """
    _integer("robot", robot, 1, 0, 0xFF)
    _integer("revision", revision, 1, 0, 0xFFFF)
    indices, values = np.asarray(voxels).ravel(), np.asarray(occupancies).ravel()
    if indices.size != values.size or indices.size > 0xFFFF:
        raise RadioError(
            f"radio map change: {indices.size} voxels with {values.size} occupancies; "
            "expected as many of both, 65535 at most"
        )
    each = (limit - _MAP.size) // _PAIR.itemsize
    if each < 1:
        raise RadioError(f"radio map change: no voxel fits into {limit} bytes")
    pairs = np.empty(indices.size, _PAIR)
    for name, array, most in (("voxel", indices, 0xFFFFFFFF), ("occupancy", values, 0xFF)):
        whole = array.size == 0 or array.dtype.kind in "iu"
        if not (whole and np.all(array >= 0) and np.all(array <= most)):
            raise RadioError(f"radio map change: a {name} is no integer within 0 to {most}")
        pairs[name] = array
    return _map_messages(robot, revision, pairs, each)


def _map_messages(robot: int, revision: int, pairs: NDArray[np.void], each: int) -> Iterator[bytes]:
    for begin in range(0, pairs.size, each):
        part = pairs[begin : begin + each]
        remaining = pairs.size - begin - part.size
        yield _MAP.pack(_MAP_TYPE, robot, revision, remaining) + part.tobytes()


def unpack(message: bytes) -> Message:
    """Return what a message says.

    Args:
        message: As received.

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


def _unpack_map(message: bytes) -> MapDelta:
    _, robot, revision, remaining = _MAP.unpack_from(message)
    body = message[_MAP.size :]
    if not body or len(body) % _PAIR.itemsize:
        raise struct.error
    pairs = np.frombuffer(body, _PAIR)
    voxels, occupancies = pairs["voxel"].astype(np.uint32), pairs["occupancy"].astype(np.uint8)
    return MapDelta(robot, revision, remaining, voxels, occupancies)


_UNPACK: dict[int, Callable[[bytes], Message]] = {
    _POSE_TYPE: _unpack_pose,
    _WRENCH_TYPE: _unpack_wrench,
    _MAP_TYPE: _unpack_map,
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
