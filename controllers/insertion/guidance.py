"""Message of the master to the slave: pose of the slot in the card's frame, from stereo images.

A message has 60 bytes, so that one frame of the radio carries it: time, detections, the pose in
steps of 20 um and 0.1 mrad, and its covariance's 21 numbers in half precision.

The time is the sender's. The receiver learns the difference of the clocks by asking for the
sender's time: the answer was given between question and receipt, so the middle of the two is wrong
by half the round trip at most, and by less if both ways take equally long.
"""

import contextlib
import dataclasses
import math
import struct

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.arrays import FloatArray
from twin.link import LatestLink

KIND = 0x14
"""First byte: format version 1, type 4."""
_CARD, _SLOT, _POSE = 1, 2, 4
_FORM = struct.Struct(">BBi6h21e")
_QUESTION, _ANSWER = 0x15, 0x16
"""First bytes: types 5 and 6. Both are as long, so that both ways take equally long."""
KINDS = KIND, _QUESTION, _ANSWER
"""First bytes of all messages of a `GuidanceLink`."""
_TIMES = struct.Struct(">B2i")  # Times of question and answer, each by its robot's clock.
_ASK_PERIOD = 0.83
"""Time between two questions [s]; in no step with pictures, so that not every answer waits behind
guidance."""
_DRIFT = 2e-4  # Largest drift of two quartz clocks against each other.
_LENGTH, _ANGLE, _TIME = 2e-5, 1e-4, 1e-3
_UPPER = np.triu_indices(6)


class GuidanceError(ValueError):
    """A message that cannot be sent or decoded."""


@dataclasses.dataclass(frozen=True)
class Guidance:
    """Measurement of the master in one stereo pair.

    Attributes:
        time: Time stamp of the images [s], by the sender's clock in a message and by the receiver's
            in what `GuidanceLink.receive` returns.
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
    """One robot's end of the radio, for guidance and what its time stamps need.

    Args:
        link: The robot's end of the radio.

    Attributes:
        offset: Time of the sender's clock less that of the receiver's own [s]; NaN before the first
            answer.
        offset_limit: Largest error of the offset [s], whatever the ways of question and answer.
    """

    def __init__(self, link: LatestLink) -> None:
        self.offset, self.offset_limit = math.nan, math.inf
        self._link = link
        self._asked = self._received = -math.inf

    def send(self, guidance: Guidance | None, now: float) -> None:
        """Send guidance, replacing any that still waits, and answer; to be called every tick.

        A pose out of the message's range is discarded: it is a false detection of card or slot.

        Args:
            guidance: Newest measurement of the master; None without a new one.
            now: Time of the sender's clock [s].
        """
        if guidance is not None:
            with contextlib.suppress(GuidanceError):
                self._link.send_latest(guidance.pack())
        for message in self._link.poll().messages:
            asked, _ = _times(message, _QUESTION)
            self._link.send_latest(_TIMES.pack(_ANSWER, asked, round(now / _TIME)))
            self._link.poll()

    def receive(self, now: float) -> list[Guidance]:
        """Return the guidance received since the last call, in order, stamped by the own clock.

        What arrives before the first answer is discarded: nobody knows how old it is.

        Args:
            now: Time of the receiver's own clock [s].
        """
        self.offset_limit += _DRIFT * max(now - self._received, 0.0)
        self._received = now
        if now >= self._asked + _ASK_PERIOD:
            self._asked = now
            self._link.send_latest(_TIMES.pack(_QUESTION, round(now / _TIME), 0))
        views: list[Guidance] = []
        for message in self._link.poll().messages:
            if message[0] == _ANSWER:
                asked, answered = _times(message, _ANSWER)
                self._compare(_TIME * asked, _TIME * answered, now)
            elif not math.isnan(self.offset):
                sent = unpack(message)
                views.append(dataclasses.replace(sent, time=sent.time - self.offset))
        return views

    def _compare(self, asked: float, answered: float, now: float) -> None:
        """Take over the clocks' difference unless an earlier answer still tells it better."""
        limit = 0.5 * (now - asked) + _TIME
        if limit <= self.offset_limit:
            self.offset, self.offset_limit = answered - 0.5 * (asked + now), limit


def _times(message: bytes, kind: int) -> tuple[int, int]:
    """Return the times of a question or an answer, in milliseconds.

    Raises:
        GuidanceError: If it is not such a message.
    """
    if len(message) != _TIMES.size or message[0] != kind:
        raise GuidanceError(f"no message of type 0x{kind:x}: {message.hex(' ')}")
    _, asked, answered = _TIMES.unpack(message)
    return asked, answered


def _positive(covariance: FloatArray) -> FloatArray:
    """Return a rounded covariance made positive definite."""
    values, vectors = np.linalg.eigh(covariance)
    return (vectors * np.maximum(values, 1e-12)) @ vectors.T
