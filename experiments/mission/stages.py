"""The stages of ``mission``, each of which adds to what the robots know."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from controllers.identification.rover_identifier import RoverIdentifier, RoverIdentifierConfig
from controllers.insertion.camera_station import camera_arm
from controllers.insertion.marker_guide import MarkerGuide
from controllers.insertion.team import marker_guide_config
from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.localization import RobotLocalization, tilt_to_level
from controllers.mapping.looking import MapperConfig, RobotBrief
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.motion.arm_move import ArmMove
from experiments.ch2.rover.trial import known_swinging_arm
from experiments.ch3.stereo.mapping_scene import head_geometry
from experiments.ch5.insertion_scene import insertion_drawing
from experiments.mission.knowledge import Knowledge
from experiments.mission.scene import MASTER, SLAVE
from models.datasheets import ARM
from perception.geometry.se3 import composed_covariance, transport_covariance
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from twin.describe import describe_rover
from twin.robot import Command, Observation
from twin.servo import SERVO_PERIOD

FloatArray = NDArray[np.float64]
Observations = Mapping[str, Observation]

HOME = np.array(ARM.home)
PERIOD = SERVO_PERIOD
VOXEL = 0.01  # [m]
_SEARCH_SCANS = 20  # All views of the search, and some hints that it follows.
BOX = ((-1.8, -2.4, -0.2), (1.8, 1.4, 0.68))
"""Corners of the map [m], about the panel."""


class MissionStage(Protocol):
    """One stage."""

    name: str

    @property
    def done(self) -> bool:
        """Whether the next one may begin."""
        ...

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Take what was measured and return the next commands."""
        ...


class SwingArms:
    """Chapter 2: each rover swings its arm and finds how it pitches on its springs."""

    name = "identify"

    def __init__(self, knowledge: Knowledge, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Gets how both rovers pitch.
            rng: Of the planners.
        """
        self._knowledge = knowledge
        self._identifiers = {
            name: RoverIdentifier(
                RoverIdentifierConfig(name, known_swinging_arm(card=name == SLAVE)), source
            )
            for name, source in zip((MASTER, SLAVE), rng.spawn(2))
        }

    @property
    def done(self) -> bool:
        """Whether all arms have swung."""
        return len(self._knowledge.pitch) == len(self._identifiers)

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Swing on; the last step fits everything once more."""
        commands: dict[str, Command] = {}
        for name, identifier in self._identifiers.items():
            if identifier.done:
                self._knowledge.pitch[name] = identifier.finish()
            else:
                commands |= identifier.step(observations)
        return commands


class FindPanel:
    """Chapter 3: the master looks for the panel, and maps what it sees on the way."""

    name = "find"

    def __init__(self, knowledge: Knowledge, scans: int, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Gets the map, and where the slot is from the master.
            scans: Looks; more only until it has found the panel.
            rng: Draws candidate views.
        """
        self._knowledge = knowledge
        self.mapper = StereoMapper(
            {MASTER: brief()},
            head_geometry(),
            knowledge.site.target,
            VoxelMap(VoxelGrid(VOXEL, *BOX)),
            MapperConfig(scans=scans, search_scans=_SEARCH_SCANS),
            rng,
        )
        self._rest = ArmMove(HOME)

    @property
    def done(self) -> bool:
        """Whether no look is left."""
        return self.mapper.done

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look on."""
        commands = dict(self.mapper.step(observations))
        commands[SLAVE] = self._rest.command(observations[SLAVE])
        found = self.mapper.standings.get(MASTER)
        if self.mapper.done and found is not None:
            self._knowledge.shared = self.mapper.shared
            take_standing(self._knowledge, found)
        return commands


class MapTogether:
    """Chapter 3: both rovers map the place, each leaving to the other what it is about to see."""

    name = "map"

    def __init__(self, knowledge: Knowledge, scans: int, rng: np.random.Generator) -> None:
        """Begin.

        Args:
            knowledge: Has the map that the master began, and where both stand.
            scans: Looks of each.
            rng: Draws candidate views.
        """
        assert knowledge.shared is not None and knowledge.standing is not None
        standings = {MASTER: knowledge.standing}
        if knowledge.met:
            standings[SLAVE] = _slave_standing(knowledge)
        self.mapper = StereoMapper(
            {name: brief() for name in standings},
            head_geometry(),
            knowledge.site.target,
            knowledge.shared.voxels,
            MapperConfig(scans=scans),
            rng,
            begun=knowledge.shared,
            standings=standings,
        )
        self._rest = ArmMove(HOME)

    @property
    def done(self) -> bool:
        """Whether no look is left."""
        return self.mapper.done

    def step(self, observations: Observations) -> Mapping[str, Command]:
        """Look on."""
        rest = {SLAVE: self._rest.command(observations[SLAVE])}
        return rest | dict(self.mapper.step(observations))


def _slave_standing(knowledge: Knowledge) -> RobotLocalization:
    """Return where the slave stands, by what the master has seen of its card."""
    assert knowledge.standing is not None
    arm, master = reference_arm(), knowledge.standing
    to_world = master.transform_level_to_world * knowledge.slot_in_level
    slot_in_slave = RigidTransform.from_matrix(knowledge.slot_in_slave)
    slave = to_world * slot_in_slave.inv()
    spread = composed_covariance(slave, master.covariance, knowledge.slave_covariance)
    tilt = knowledge.slave_tilt
    level = slave * tilt_to_level(tilt).inv()
    sighting = slave * arm.tool_in_robot(HOME)
    return RobotLocalization(arm, level, spread, sighting, master.config)


@functools.cache
def brief() -> RobotBrief:
    """Return what is known of either robot beforehand."""
    return RobotBrief(reference_arm(), HOME, describe_rover(MASTER).body_spheres)


def reference_arm() -> SerialChain:
    """Return the arm with its camera, as drawn."""
    return camera_arm(describe_rover(MASTER))[0]


def take_standing(knowledge: Knowledge, standing: RobotLocalization) -> None:
    """Work out where the slot is, from where the master stands.

    Args:
        knowledge: Has the drawing and the map's frame; gets the slot.
        standing: Of the master.
    """
    shared, site = knowledge.shared, knowledge.site
    assert shared is not None and shared.transform_target_to_world is not None
    to_world = shared.transform_target_to_world
    slot = to_world * site.transform_slot_to_panel
    to_level = standing.transform_level_to_world.inv()
    spread = composed_covariance(to_world, standing.covariance, site.covariance)
    knowledge.standing = standing
    knowledge.slot_in_level = to_level * slot
    knowledge.slot_covariance = transport_covariance(to_level, spread)


def marker_guide(
    width: float, slot: RigidTransform, covariance: FloatArray, card: RigidTransform, plan: bool
) -> MarkerGuide:
    """Return the master's eyes for card and slot.

    Args:
        width: Of the slot [m].
        slot: From the slot to the robot.
        covariance: (6, 6) of its xi.
        card: From the card to the robot, roughly.
        plan: Whether the camera is placed, or stays.
    """
    config = marker_guide_config(describe_rover(MASTER), insertion_drawing(width), plan)
    return MarkerGuide(config, reference_arm(), head_geometry(), (slot, covariance), card, None)
