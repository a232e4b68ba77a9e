"""One rover's end of the mission's radio: which message is whose, what it sent, what it heard.

All that passes between the rovers goes through here: a `Status` once a second, guidance, and parts
of the map. Messages are told apart by their first byte. Each may be lost; none is damaged, as the
link's frames carry a checksum, and the map's parts, which are put together of several, one of their
own.
"""

import collections
import dataclasses
import math
import struct
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mission.stage import StageError
from perception.geometry.arrays import FloatArray
from twin.link import Link, Polled, RadioError

STATUS = 0x19
"""First byte of a status: format version 1, type 9."""
FRAME_BYTES = 8
"""Bytes that a frame of the link adds to a message."""
PERIOD = 1.0
"""Time between two statuses [s]."""
SILENT = 4.0
"""Time from which on nothing heard counts as silence [s]; a status is sent every second."""
PATIENCE = 60.0
"""Longest silence for which a rover waits that has done its own part [s]."""
_KEPT = 32  # Number of messages that are kept until somebody takes them.
_FORM = struct.Struct(">BBB6h21e")
_READY, _LOCALIZED, _NEAR, _SIGHTED, _BLOCKED = 1, 2, 4, 8, 16
_LENGTH, _ANGLE = 5e-4, 1e-4
"""Steps of the slot's position [m], up to 16 m, and attitude [rad]."""
_UPPER = np.triu_indices(6)


@dataclasses.dataclass(frozen=True)
class SlotPose:
    """Pose of the slot in a rover's frame: where the rover stands, and how it is tilted.

    Attributes:
        transform_slot_to_robot: Transform from the slot to the rover's frame, tilted as it is.
        covariance: (6, 6) covariance of the pose, as a twist in the rover's frame.
    """

    transform_slot_to_robot: RigidTransform
    covariance: FloatArray


@dataclasses.dataclass(frozen=True)
class Status:
    """Where a rover is in the mission, and on the site; 57 bytes.

    Attributes:
        done: Number of stages whose part the rover has completed, up to 255.
        ready: Whether its arm is where the insertion begins, at rest.
        slot: Pose of the slot in its frame; None before it is localized.
        near: Whether it searches for the panel near the site.
        sighted: Whether it has sighted the panel from far away.
        blocked: Whether it has no path to where it wants to go, or but a long way around.
    """

    done: int
    ready: bool = False
    slot: SlotPose | None = None
    near: bool = False
    sighted: bool = False
    blocked: bool = False

    def pack(self) -> bytes:
        """Return the message's bytes.

        Raises:
            RadioError: If the slot is too far away, or a number is not finite.
        """
        flags, steps, variances = 0, np.zeros(6), np.zeros(21)
        flags |= _READY * self.ready | _NEAR * self.near | _SIGHTED * self.sighted
        flags |= _BLOCKED * self.blocked
        if self.slot is not None:
            flags |= _LOCALIZED
            pose = self.slot.transform_slot_to_robot
            turn, place = pose.rotation.as_rotvec() / _ANGLE, pose.translation / _LENGTH
            steps = np.rint(np.concatenate([turn, place]))
            # Milliradians and millimetres, so that half precision has room on both sides.
            variances = np.clip(1e6 * self.slot.covariance[_UPPER], -6e4, 6e4)
        if not (np.isfinite(steps).all() and np.isfinite(variances).all()):
            raise RadioError(f"status {self}: not finite")
        if np.abs(steps).max() > 0x7FFF:  # noqa: PLR2004
            raise RadioError(f"status {self}: farther than 16 m")
        numbers = (int(step) for step in steps)
        return _FORM.pack(STATUS, self.done, flags, *numbers, *variances.tolist())

    @classmethod
    def unpack(cls, message: bytes) -> "Status":
        """Return the content of a message.

        Args:
            message: Bytes of `pack`.

        Raises:
            RadioError: If it is not such a message.
        """
        if len(message) != _FORM.size or message[0] != STATUS:
            raise RadioError(f"no status: {len(message)} bytes, begins {message[:1]!r}")
        _, done, flags, *numbers = _FORM.unpack(message)
        slot = None
        if flags & _LOCALIZED:
            turn = Rotation.from_rotvec(np.array(numbers[:3]) * _ANGLE)
            place = np.array(numbers[3:6]) * _LENGTH
            covariance = np.zeros((6, 6))
            covariance[_UPPER] = np.array(numbers[6:]) * 1e-6
            covariance += np.triu(covariance, 1).T
            slot = SlotPose(RigidTransform.from_components(place, turn), covariance)
        ready, near, sighted, blocked = (
            bool(flags & flag) for flag in (_READY, _NEAR, _SIGHTED, _BLOCKED)
        )
        return cls(done, ready, slot, near, sighted, blocked)


class MissionRadio:
    """One rover's end of the radio.

    Args:
        link: The rover's end of the link.
        partner: Name of the other rover.

    Attributes:
        stage: Name of the present stage, to which what is sent is counted.
        ready: Whether the rover's arm is where the insertion begins, at rest.
        near: Whether the rover searches for the panel near the site.
        sighted: Whether it has sighted the panel from far away.
        blocked: Whether it has no path to where it wants to go, or but a long way around.
        partner: Newest status of the other rover.
        bytes_sent: Bytes on the air with their frames, by stage and first byte of the message.
        notices: What a person should know of the radio, in words, each with its time [s].
    """

    def __init__(self, link: Link, partner: str) -> None:
        self.stage, self.partner = "", Status(0)
        self.ready = self.near = self.sighted = self.blocked = False
        self.bytes_sent: collections.Counter[tuple[str, int]] = collections.Counter()
        self.notices: list[tuple[float, str]] = []
        self._link, self._name = link, partner
        self._heard, self._now = math.nan, 0.0
        self._quiet = self._waits = False
        self._told = (-math.inf, Status(0))
        self._inbox: collections.deque[bytes] = collections.deque(maxlen=_KEPT)

    @property
    def silence(self) -> float:
        """Time since anything was heard [s]; at the start, since the first tick."""
        return self._now - self._heard

    @property
    def silent(self) -> bool:
        """Whether the other rover has not been heard for some seconds."""
        return self.silence > SILENT

    def begin_tick(self, now: float) -> None:
        """Take what has arrived.

        Args:
            now: Time of the rover's own clock [s].
        """
        self._now = now
        if math.isnan(self._heard):
            self._heard = now
        self.poll()
        for message in self.take((STATUS,)):
            self.partner = Status.unpack(message)
        self._notice()

    def poll(self) -> None:
        """Transmit, and keep what has arrived until it is taken."""
        messages = self._link.poll().messages
        if messages:
            self._heard = self._now
        self._inbox.extend(messages)

    def take(self, kinds: Sequence[int]) -> list[bytes]:
        """Return the messages not taken yet with one of some first bytes, in order.

        Args:
            kinds: First bytes.
        """
        taken = [message for message in self._inbox if message[0] in kinds]
        for message in taken:
            self._inbox.remove(message)
        return taken

    def send(self, message: bytes) -> None:
        """Send a message once; one of its kind that still waits is replaced.

        Args:
            message: Bytes of the message.
        """
        self._link.send_latest(message)
        self.bytes_sent[self.stage, message[0]] += len(message) + FRAME_BYTES

    def tell(self, done: int, slot: Callable[[], SlotPose | None]) -> None:
        """Send the rover's status, once a second and when its part or its arm is done.

        Args:
            done: Number of stages whose part the rover has completed.
            slot: Function that returns the slot's pose in its frame, None before it is localized;
                called only for a status that is sent.
        """
        time, last = self._told
        if self._now >= time + PERIOD or (done, self.ready) != (last.done, last.ready):
            status = Status(done, self.ready, slot(), self.near, self.sighted, self.blocked)
            try:
                message = status.pack()
            except RadioError:  # A place out of range is not told; what is done is.
                message = Status(done, self.ready).pack()
            self.send(message)
            self._told = self._now, status

    def wait(self) -> None:
        """State that the rover can do no more without the other, and waits for it.

        Raises:
            StageError: If nothing was heard for too long.
        """
        if self.silence > PATIENCE:
            raise StageError(self.stage, f"nothing heard from {self._name} for {PATIENCE:.0f} s")
        if self.silent and not self._waits:
            self._waits = True
            self._note(f"waits for {self._name} in {self.stage}")

    def _notice(self) -> None:
        """Note the beginning and the end of a silence."""
        if self.silent and not self._quiet:
            self._note(f"has not heard {self._name} for {SILENT:.0f} s in {self.stage}")
        if self._quiet and not self.silent:
            self._note(f"hears {self._name} again")
            self._waits = False
        self._quiet = self.silent

    def _note(self, words: str) -> None:
        self.notices.append((self._now, words))


class RadioPort:
    """The part of a rover's radio that carries some kinds of messages.

    Args:
        radio: The rover's end of the radio.
        kinds: First bytes of the messages.
    """

    def __init__(self, radio: MissionRadio, kinds: Sequence[int]) -> None:
        self._radio, self._kinds = radio, kinds

    def send_latest(self, message: bytes) -> None:
        """Send a message once; one of its kind that still waits is replaced."""
        self._radio.send(message)

    def poll(self) -> Polled:
        """Transmit, and return what has arrived of these kinds."""
        self._radio.poll()
        return Polled(self._radio.take(self._kinds), [])
