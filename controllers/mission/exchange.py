"""Message exchange between the two robots of a mission.

Guidance is sent by radio. All other messages are passed within the process: of each kind the newest
that a robot has posted can be read. The robots are stepped one after the other, so that the second
reads what the first posts in the same tick.
"""

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.guidance import GuidanceLink
from controllers.mapping.stereo_mapper import StereoMapper
from perception.geometry.arrays import FloatArray
from twin.link import Link

Message = TypeVar("Message")


@dataclasses.dataclass(frozen=True)
class StagesDone:
    """Number of stages whose part the sender has completed.

    Attributes:
        count: Number of stages.
    """

    count: int


@dataclasses.dataclass(frozen=True)
class ArmPosture:
    """Present posture of the sender's arm.

    Attributes:
        angles: (n,) joint angles [rad]; None if they are not known.
    """

    angles: FloatArray | None


@dataclasses.dataclass(frozen=True)
class MapBegun:
    """Notice that the sender has found the panel, and that both robots continue its map."""


@dataclasses.dataclass(frozen=True)
class CardMet:
    """Notice that the sender has recognised its card in the other robot's guidance."""


@dataclasses.dataclass(frozen=True)
class SlotPose:
    """Pose of the slot in the sender's frame.

    Attributes:
        transform_slot_to_robot: Transform from the slot to the sender's robot frame.
        covariance: (6, 6) covariance of the pose, as a twist in the sender's robot frame.
        tilt: (2,) pitch and roll of the sender at that time [rad].
        met: Whether the pose was measured; if not it is from the drawing.
    """

    transform_slot_to_robot: RigidTransform
    covariance: FloatArray
    tilt: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    met: bool = False


@dataclasses.dataclass(frozen=True)
class TurnShare:
    """Turn share of the skidding rovers on this ground.

    Attributes:
        share: Actual turn over that of rolling wheels.
        deviation: Standard deviation of the share in another turn.
    """

    share: float
    deviation: float


@dataclasses.dataclass(frozen=True)
class ArmReady:
    """State of the sender's arm before the insertion.

    Attributes:
        ready: Whether the arm is at its initial pose of the insertion, at rest.
    """

    ready: bool


class Exchange:
    """Channel by which the robots exchange all their messages.

    Args:
        links: Each robot's end of the radio, by robot name.

    Attributes:
        guidance: Each robot's end of the radio, for guidance, by robot name.
        mapper: Mapper of the common map; None before both robots map.
    """

    def __init__(self, links: Mapping[str, Link]) -> None:
        self.guidance = {name: GuidanceLink(link) for name, link in links.items()}
        self.mapper: StereoMapper | None = None
        self._posted: dict[tuple[str, type], object] = {}

    def post(self, robot: str, message: object) -> None:
        """Post a message for the other robot; it replaces the previous one of its kind.

        Args:
            robot: Name of the sender.
            message: One of this module's messages.
        """
        self._posted[robot, type(message)] = message

    def read(self, robot: str, kind: type[Message]) -> Message | None:
        """Return the newest message of a kind; None if there was none.

        Args:
            robot: Name of the sender.
            kind: Class of the message.
        """
        message = self._posted.get((robot, kind))
        return message if isinstance(message, kind) else None
