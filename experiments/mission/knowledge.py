"""What the robots of ``mission`` know, stage by stage: told, drawn, then measured."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.identification.pitch import PitchEstimate, PitchPrior
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.motion.base_tilt import TiltAxis
from controllers.motion.driving import SkidSteer
from experiments.ch5.insertion_identify import rover_steer
from experiments.mission.scene import DROP_PLACE, DROP_YAW, MASTER, NOMINAL, SLAVE, Site
from models import datasheets
from models.card_and_slot.stand import CARD_AXES, SLOT_HEIGHT
from perception.geometry.se3 import transport_covariance
from twin.robot import Observation, RobotError

FloatArray = NDArray[np.float64]

SLOT_IN_SITE = RigidTransform.from_components(
    [0.0, 0.0, SLOT_HEIGHT], Rotation.from_matrix(CARD_AXES)
)
"""From the slot to the level ground below it: where `NOMINAL` and stands are given."""

_LEAN, _HEIGHT = 0.05, 0.03
"""Deviations of a robot's lean [rad] and height [m] by the ground, where nothing is measured."""


@dataclasses.dataclass
class Knowledge:
    """What is believed.

    Attributes:
        site: The drawing.
        pitch: How each robot pitches on its springs, once it has swung its arm.
        turn_share: Of rolling wheels' turn that skidding leaves; all of it until identified.
        shared: The map; None without.
        standing: Of the master, once it has found the panel.
        met: Whether the master has found the card.
        slave_tilt: (2,) pitch and roll of the slave then [rad].
        slot_in_level: From the slot to the master's robot frame brought level.
        slot_covariance: (6, 6) of its xi.
        slot_in_slave: (4, 4) from the slot to the slave's robot frame.
        slave_covariance: (6, 6) of its xi.
    """

    site: Site
    slot_in_level: RigidTransform
    slot_covariance: FloatArray
    slot_in_slave: FloatArray
    slave_covariance: FloatArray
    pitch: dict[str, PitchEstimate] = dataclasses.field(default_factory=dict)
    turn_share: float = 1.0
    shared: SharedMap | None = None
    standing: RobotLocalization | None = None
    met: bool = False
    slave_tilt: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))

    @classmethod
    def as_told(cls, site: Site) -> Knowledge:
        """Return what the robots know when they are dropped."""
        master, spread = _told(MASTER)
        slave, slave_spread = _told(SLAVE)
        return cls(site, master, spread, slave.as_matrix(), slave_spread)

    def steer(self) -> SkidSteer:
        """Return the wheels, alike for both rovers."""
        return rover_steer(self.turn_share)

    def springs(self, robot: str) -> tuple[TiltAxis, TiltAxis]:
        """Return how a robot pitches and rolls; by the prior's guess if it did not swing its arm.

        In roll the same springs act at half the track (Thesis eq. A-1).
        """
        if robot in self.pitch:
            pitch = TiltAxis.of(self.pitch[robot].parameters)
        else:
            prior = PitchPrior()
            pitch = TiltAxis(prior.inertia, prior.damping, prior.stiffness, (0.0, 0.0))
        rover = datasheets.ROVER
        ratio = (rover.half_track / rover.half_wheelbase) ** 2
        roll = TiltAxis(
            pitch.inertia * ratio,
            pitch.damping * ratio,
            pitch.stiffness * ratio,
            (0.0, pitch.lever[1]),
        )
        return pitch, roll

    def slot_in_master(self, tilt: FloatArray) -> tuple[RigidTransform, FloatArray]:
        """Return the slot in the leaning master's frame, and its covariance.

        Args:
            tilt: (2,) pitch and roll [rad].
        """
        upright = tilt_to_level(tilt).inv()
        covariance = transport_covariance(upright, self.slot_covariance)
        return upright * self.slot_in_level, covariance

    def card_in_master(self, tilt: FloatArray, card_in_slave: FloatArray) -> RigidTransform:
        """Return roughly where the card is in the master's frame.

        Args:
            tilt: (2,) pitch and roll of the master [rad].
            card_in_slave: (4, 4) by the slave's joints.
        """
        slot, _ = self.slot_in_master(tilt)
        slot_in_slave = RigidTransform.from_matrix(self.slot_in_slave)
        return slot * slot_in_slave.inv() * RigidTransform.from_matrix(card_in_slave)


def tilt_of(seen: Observation, robot: str) -> FloatArray:
    """Return (2,) pitch and roll of a robot [rad].

    Args:
        seen: Of the robot.
        robot: Its name.

    Raises:
        RobotError: If its inclinometer tells nothing.
    """
    channel = seen.inclinometer
    if not (channel.usable and np.isfinite(channel.value).all()):
        raise RobotError(
            f"the inclinometer of {robot} is {channel.validity.value}: without it the mission "
            "cannot tell how the robot leans; check its connection"
        )
    return np.asarray(channel.value, dtype=float)


def _told(robot: str) -> tuple[RigidTransform, FloatArray]:
    """Return the slot in a robot's level frame as told, and the covariance of an even spread."""
    x, y, yaw = NOMINAL[robot]
    place = [x, y, datasheets.ROVER.centre_height]
    robot_in_site = RigidTransform.from_components(place, Rotation.from_euler("z", yaw))
    slot = robot_in_site.inv() * SLOT_IN_SITE
    turn, far = DROP_YAW / math.sqrt(3.0), DROP_PLACE / math.sqrt(3.0)
    # About the robot: xi of where it stands, with the lean and the height of rough ground.
    return slot, np.diag(np.square([_LEAN, _LEAN, turn, far, far, _HEIGHT]))
