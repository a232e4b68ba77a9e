"""All that passes between the two robots of a mission, by named messages.

Guidance goes over the radio. The rest is passed within the process, where the next versions may put
a radio: of each kind of message the newest that a robot has posted can be read. The robots are
stepped one after the other, so that the second reads what the first posts in the same tick.
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
    """The sender has done its part of so many stages.

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
    """The sender has found the panel, and maps on together with the other robot."""


@dataclasses.dataclass(frozen=True)
class CardMet:
    """The sender has recognised its card in the other robot's guidance."""


@dataclasses.dataclass(frozen=True)
class SlotPose:
    """Pose of the slot from the sender.

    Attributes:
        transform_slot_to_robot: Transform from the slot to the sender's robot frame.
        covariance: (6, 6) covariance of its twist.
        tilt: (2,) pitch and roll of the sender then [rad].
        met: Whether the pose was measured; if not it is drawn.
    """

    transform_slot_to_robot: RigidTransform
    covariance: FloatArray
    tilt: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))
    met: bool = False


@dataclasses.dataclass(frozen=True)
class TurnShare:
    """Share of turns that skidding leaves on this ground.

    Attributes:
        share: Share of rolling wheels' turn.
    """

    share: float


@dataclasses.dataclass(frozen=True)
class ArmReady:
    """Whether the sender's arm is where the insertion begins.

    Attributes:
        ready: Whether the arm is there, at rest.
    """

    ready: bool


class Exchange:
    """The only channel between the robots.

    Args:
        links: Each robot's end of the radio, by robot name.

    Attributes:
        guidance: Each robot's end of the radio, for guidance, by robot name.
        mapper: Mapper of the map that both build; None before they do.
    """

    def __init__(self, links: Mapping[str, Link]) -> None:
        self.guidance = {name: GuidanceLink(link) for name, link in links.items()}
        self.mapper: StereoMapper | None = None
        self._posted: dict[tuple[str, type], object] = {}

    def post(self, robot: str, message: object) -> None:
        """Post a message for the other robot, in place of the one before of its kind.

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
