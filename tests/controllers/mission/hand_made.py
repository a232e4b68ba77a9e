"""A site, estimates, a radio and rovers made by hand, for the stages of a mission."""

import math
import typing

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import RobotLocalization, level_target
from controllers.mission.belief import MissionBelief, drawn_turn_share
from controllers.mission.site import SiteDrawing
from experiments.ch5.insertion_scene import insertion_drawing
from models.clutter import PanelConfig
from models.datasheets import CARD_AND_SLOT
from perception.registration.target import TargetCad
from tests.controllers.motion.seen import PAIR, seen_at
from twin.describe import describe_rover
from twin.link import Polled
from twin.robot import Command, Observation

MASTER, SLAVE = "rover1", "rover2"
ROVERS = {MASTER: describe_rover(MASTER), SLAVE: describe_rover(SLAVE, card=True)}
POSES = {MASTER: (0.80, -0.40, math.pi / 2), SLAVE: (0.0, -0.90, 0.0)}
"""Initial poses of the rovers: x, y [m] and yaw [rad], ground frame."""
TICK = 0.01
"""Servo tick [s]."""
TILT = np.array([0.03, -0.02])
"""Pitch and roll that each rover measures [rad]."""
SHARE = drawn_turn_share(ROVERS[SLAVE]).share
"""Turn of either rover as drawn, over that of rolling wheels."""
HOME = typing.cast(typing.Any, ROVERS[SLAVE].arm).home


def site() -> SiteDrawing:
    """Return a drawing whose panel is half a metre aside of the slot."""
    panel = PanelConfig()
    cad = TargetCad(panel.marker_points, panel.markers[0].radius, panel.markers[0].dark)
    aside = RigidTransform.from_components([0.1, -0.5, 0.2], Rotation.from_euler("z", 0.4))
    drawing = insertion_drawing(CARD_AND_SLOT.slot_widths[-1])
    place = (0.0, -0.92, 0.0)
    return SiteDrawing(drawing, cad, aside, 1e-6 * np.eye(6), POSES, (0.5, 0.5), place)


SITE = site()


def belief_of(name: str) -> MissionBelief:
    """Return the estimates of a rover at the start."""
    return MissionBelief.initial(ROVERS[name], SITE)


def transform_robot_to_ground(name: str) -> RigidTransform:
    """Return the pose of a level rover at its initial pose."""
    x, y, yaw = POSES[name]
    height = ROVERS[name].centre_height
    return RigidTransform.from_components([x, y, height], Rotation.from_euler("z", yaw))


def planar_pose(x: float, y: float, yaw: float) -> RigidTransform:
    """Return a pose on the level ground."""
    return RigidTransform.from_components([x, y, 0.0], Rotation.from_euler("z", yaw))


def at_once(seen: Observation, *_: object) -> typing.Generator[Command, Observation, Observation]:
    """Return the observation: a behaviour that ends before its first tick."""
    return seen
    yield Command()


class HandLink:
    """An end of a radio that loses and delays nothing, unless it is silent.

    Attributes:
        silent: Whether what is sent is lost.
        sent: All messages that were sent, lost or not.
    """

    def __init__(self) -> None:
        self.silent = False
        self.sent: list[bytes] = []
        self.arrived: list[bytes] = []
        self.partner = self

    def send(self, message: bytes) -> int:
        """Send a message."""
        self.send_latest(message)
        return 0

    def send_latest(self, message: bytes) -> None:
        """Send a message."""
        self.sent.append(message)
        if not self.silent:
            self.partner.arrived.append(message)

    def poll(self) -> Polled:
        """Return what has arrived."""
        arrived, self.arrived = self.arrived, []
        return Polled(arrived, [])


def hand_links() -> tuple[HandLink, HandLink]:
    """Return both ends of a radio."""
    links = HandLink(), HandLink()
    links[0].partner, links[1].partner = links[1], links[0]
    return links


def localized(name: str) -> MissionBelief:
    """Return the estimates of a level rover that the panel has localized at its initial pose.

    The map's frame is the panel's as drawn.
    """
    belief = belief_of(name)
    belief.navigator.observe(seen_at(0.0))
    panel = SITE.transform_panel_to_ground
    to_world = level_target(transform_robot_to_ground(name).inv() * panel)
    belief.map.transform_target_to_world = to_world
    level = to_world * panel.inv() * transform_robot_to_ground(name)
    arm, _ = camera_arm(ROVERS[name])
    belief.localize(RobotLocalization(arm, level, 1e-6 * np.eye(6), np.zeros((6, 10))))
    return belief


class Stage(typing.Protocol):
    """A stage of a mission."""

    def step(self, seen: Observation) -> Command | None:
        """Return the command of a tick."""
        ...


class KinematicRover:
    """A tilted rover whose wheels and joints do what was commanded, one tick later.

    Args:
        name: Name of the rover.
        angles: (4,) initial joint angles [rad].
        left: Turn to the left over that of rolling wheels.
        right: Turn to the right over that of rolling wheels.

    Attributes:
        seen: Latest observation.
        command: Latest command.
        pose: Transform from the rover's level frame to where it began.
        rolled: Turn of rolling wheels [rad].
        turned: Sum of all turns of its heading, left and right [rad].
        driven: Distance driven [m].
    """

    def __init__(
        self, name: str, angles: np.ndarray = HOME, left: float = SHARE, right: float = SHARE
    ) -> None:
        self._robot, self._share = ROVERS[name], (right, left)
        self.pose = RigidTransform.identity()
        self.rolled = self.turned = self.driven = 0.0
        self.ticks = 0
        self.seen = seen_at(0.0)
        self.command = Command(np.zeros(4), np.array(angles, dtype=float))

    @property
    def yaw(self) -> float:
        """Yaw since the start [rad]."""
        return float(self.pose.rotation.as_euler("ZYX")[0])

    def step(self, stage: Stage) -> Command:
        """Move by the last command for a tick, and step the stage."""
        wheels, angles = self.command.wheels, self.command.arm
        left, right = (wheels[0] + wheels[2]) / 2, (wheels[1] + wheels[3]) / 2
        radius, track = self._robot.wheel_radius, 2.0 * self._robot.half_track
        turn, ahead = TICK * radius * (right - left) / track, TICK * radius * (left + right) / 2
        self.rolled += turn
        turn *= self._share[int(turn > 0.0)]
        # It drives along its own forward axis, and turns about its own up.
        tilted = Rotation.from_euler("XY", TILT)
        before = tilted.as_matrix()[:, 1]
        after = (tilted * Rotation.from_euler("Z", turn)).as_matrix()[:, 1]
        level = math.atan2(-after[0], after[1]) - math.atan2(-before[0], before[1])
        x, y, z = ahead * before
        self.turned += abs(level)
        self.driven += abs(ahead)
        half = Rotation.from_euler("z", level / 2)
        step = RigidTransform.from_components(half.apply([x, y, z]), half * half)
        self.pose = self.pose * step
        time = TICK * self.ticks
        seen = seen_at(time, wheels, angles, PAIR, time)
        self.seen = seen._replace(inclinometer=seen.inclinometer._replace(value=TILT))
        self.ticks += 1
        command = stage.step(self.seen)
        assert command is not None
        self.command = command
        return command

    @property
    def drives(self) -> bool:
        """Whether a wheel is commanded to turn."""
        return bool(np.any(self.command.wheels))
