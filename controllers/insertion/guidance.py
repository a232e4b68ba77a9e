"""Message of the master to the slave: pose of the slot in the card's frame, from stereo images.

A message has 60 bytes, so that one frame of the radio carries it: time, detections, the pose in
steps of 20 um and 0.1 mrad, and its covariance's 21 numbers in half precision.
"""

import contextlib
import dataclasses
import struct

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray
from twin.link import Link

KIND = 0x14
"""First byte: format version 1, type 4."""
_CARD, _SLOT, _POSE = 1, 2, 4
_FORM = struct.Struct(">BBi6h21e")
_LENGTH, _ANGLE, _TIME = 2e-5, 1e-4, 1e-3
_UPPER = np.triu_indices(6)


class GuidanceError(ValueError):
    """A message that cannot be sent or decoded."""


@dataclasses.dataclass(frozen=True)
class Guidance:
    """Measurement of the master in one stereo pair.

    Attributes:
        time: Time stamp of the images [s].
        card_seen: Whether the card was detected in the images.
        slot_seen: Whether the slot was detected in the images.
        transform_slot_to_card: Transform from the slot to the card; None if the card was not
            detected.
        covariance: (6, 6) covariance of xi, rotation [rad] then translation [m], in
            ``true = from_exp_coords(xi) * transform_slot_to_card``; zeros without a pose.
    """

    time: float
    card_seen: bool
    slot_seen: bool
    transform_slot_to_card: RigidTransform | None = None
    covariance: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((6, 6)))

    def pack(self) -> bytes:
        """Return the message's bytes.

        Raises:
            GuidanceError: If the pose is too far away or a number is not finite.
        """
        flags = _CARD * self.card_seen | _SLOT * self.slot_seen
        steps, variances = np.zeros(6), np.zeros(21)
        if self.transform_slot_to_card is not None:
            flags |= _POSE
            place = self.transform_slot_to_card.translation / _LENGTH
            turn = self.transform_slot_to_card.rotation.as_rotvec() / _ANGLE
            steps = np.rint(np.concatenate([turn, place]))
            # Milliradians and millimetres, so that half precision has room on both sides.
            variances = 1e6 * self.covariance[_UPPER]
        numbers = np.concatenate([steps, variances, [self.time]])
        if not np.all(np.isfinite(numbers)) or np.abs(steps).max() > 0x7FFF:
            raise GuidanceError(f"guidance {self}: not finite, or farther than 0.65 m")
        halves = np.clip(variances, -6e4, 6e4)
        return _FORM.pack(
            KIND, flags, round(self.time / _TIME), *(int(n) for n in steps), *halves.tolist()
        )


def unpack(message: bytes) -> Guidance:
    """Return the guidance of a message.

    Args:
        message: Bytes of `Guidance.pack`.

    Raises:
        GuidanceError: If it is not such a message.
    """
    if len(message) != _FORM.size or message[0] != KIND:
        raise GuidanceError(f"no guidance message: {len(message)} bytes, begins {message[:1]!r}")
    _, flags, time, *numbers = _FORM.unpack(message)
    covariance = np.zeros((6, 6))
    covariance[_UPPER] = np.array(numbers[6:]) * 1e-6
    if not np.all(np.isfinite(covariance)):
        raise GuidanceError("guidance message: its covariance is not finite")
    covariance = covariance + covariance.T - np.diag(np.diag(covariance))
    pose = None
    if flags & _POSE:
        turn = Rotation.from_rotvec(np.array(numbers[:3]) * _ANGLE)
        pose = RigidTransform.from_components(np.array(numbers[3:6]) * _LENGTH, turn)
        covariance = _positive(covariance)
    return Guidance(time * _TIME, bool(flags & _CARD), bool(flags & _SLOT), pose, covariance)


class GuidanceLink:
    """One robot's end of the radio, for guidance alone.

    Args:
        link: The robot's end of the radio.
    """

    def __init__(self, link: Link) -> None:
        self._link = link

    def send(self, guidance: Guidance | None) -> None:
        """Send guidance, replacing any that still waits; to be called every tick.

        A pose out of the message's range is discarded: it is a false detection of card or slot.

        Args:
            guidance: Newest measurement of the master; None without a new one.
        """
        if guidance is not None:
            with contextlib.suppress(GuidanceError):
                self._link.send_latest(guidance.pack())
        self._link.poll()

    def receive(self) -> list[Guidance]:
        """Return the guidance received since the last call, in order."""
        return [unpack(message) for message in self._link.poll().messages]


def _positive(covariance: FloatArray) -> FloatArray:
    """Return a rounded covariance made positive definite."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.maximum(values, 1e-12)) @ vectors.T
