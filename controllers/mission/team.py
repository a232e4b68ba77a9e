"""Both rovers of a mission; the controller that the loop runs."""

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import CameraStation, best_camera_station
from controllers.insertion.card_arm import CardArm
from controllers.mission.belief import MissionBelief
from controllers.mission.config import STAGES, MissionConfig
from controllers.mission.radio import MissionRadio
from controllers.mission.robot_mission import RobotMission
from controllers.mission.site import MissionRoles, SiteDrawing
from controllers.mission.stage import MissionStage, StageError
from controllers.mission.stages.go_to import GoToPlace, Wait
from controllers.mission.stages.identify import SwingArm
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from controllers.mission.stages.map_site import MapSite
from controllers.mission.stages.search import SearchPanel
from controllers.placement.task import PlacementError
from twin.link import Link
from twin.robot import Command, Observation

_ROOMS = (0.12, 0.02, None)
"""Room about the camera station that is wanted, and what is content with if there is none [m]: a
rover slides as it turns there."""
_NEAR_SLOT, _NEAR_STATION = (0.04, 0.07), (0.06, 1.8)
"""Tolerances of both rovers' places: distance [m] and heading [rad]. The arm makes up for the
heading of the one that watches."""


class MissionTeam:
    """Runs both rovers' parts; a `twin.robot.Controller`.

    Stages are `STAGES`: both identify themselves and search; the master, which stands before the
    panel then, maps the site and goes to its camera station; the slave approaches the slot; then
    both insert the card.

    Args:
        roles: Descriptions of both rovers.
        site: Drawing of the site.
        config: Configuration of the mission.
        rng: Random generator for excitations, searches and candidate views.
        links: Each rover's end of the radio, by name.

    Attributes:
        master: Part of the rover with the camera.
        slave: Part of the rover that holds the card.
    """

    def __init__(
        self,
        roles: MissionRoles,
        site: SiteDrawing,
        config: MissionConfig,
        rng: np.random.Generator,
        links: Mapping[str, Link],
    ) -> None:
        guiding, holding = rng.spawn(2)
        names = roles.master.name, roles.slave.name
        radios = [
            MissionRadio(links[name], partner) for name, partner in zip(names, reversed(names))
        ]
        master = MissionBelief.initial(roles.master, site, config.without)
        slave = MissionBelief.initial(roles.slave, site, config.without)
        arm = CardArm(roles.slave, site.insertion.tip)
        card = arm.transform_card_to_robot(slave.home)
        guides = _master_stages(master, radios[0], config, guiding, card)
        self.master = RobotMission(master, radios[0], 1, guides)
        held = _slave_stages(slave, radios[1], config, holding)
        self.slave = RobotMission(slave, radios[1], 2, held)

    def reset(self) -> None:
        """Do nothing: each mission has a new team."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Step both rovers, each with its own observation."""
        commands = {part.name: part.step(observations[part.name]) for part in self.parts}
        return {name: command for name, command in commands.items() if command is not None}

    @property
    def parts(self) -> tuple[RobotMission, RobotMission]:
        """Both rovers' parts, the master's first."""
        return self.master, self.slave

    @property
    def over(self) -> bool:
        """Whether the last stage has ended."""
        return self.master.over and self.slave.over

    @property
    def ended(self) -> list[str]:
        """Names of the stages that both rovers have completed."""
        return [name for name, _ in zip(self.master.ended, self.slave.ended)]

    @property
    def stage(self) -> str:
        """Name of the first stage that not both rovers have completed; the last, if all are."""
        return STAGES[min(len(self.ended), len(STAGES) - 1)]

    @property
    def notices(self) -> list[str]:
        """What both rovers state of the radio, in words, by the time of their clocks."""
        found = [
            (time, part.name, words) for part in self.parts for time, words in part.radio.notices
        ]
        return [f"{time:.1f} s: {name} {words}" for time, name, words in sorted(found)]


def _master_stages(
    belief: MissionBelief,
    radio: MissionRadio,
    config: MissionConfig,
    rng: np.random.Generator,
    card: RigidTransform,
) -> Iterator[MissionStage]:
    """Yield the stages of the rover with the camera; the card's pose is in the slave's frame."""
    yield SwingArm(belief, rng)
    yield SearchPanel(belief, radio, True, rng)
    yield MapSite(belief, config.scans, rng)
    occluders = config.without != "occluders"
    yield GoToPlace("place", belief, lambda: best_station(belief, occluders).place, _NEAR_STATION)
    yield Wait("approach", belief)
    yield GuideInsertion(belief, radio, card, occluders)


def _slave_stages(
    belief: MissionBelief, radio: MissionRadio, config: MissionConfig, rng: np.random.Generator
) -> Iterator[MissionStage]:
    """Yield the stages of the rover that holds the card."""
    yield SwingArm(belief, rng)
    yield SearchPanel(belief, radio, False, rng)
    yield Wait(MapSite.name, belief)
    yield Wait("place", belief)
    yield GoToPlace("approach", belief, lambda: belief.site.card_place, _NEAR_SLOT)
    yield InsertCard(belief, radio, watched=config.without != "cooperation")


def best_station(belief: MissionBelief, occluders: bool) -> CameraStation:
    """Return the best camera station that the master can reach, on its map.

    Args:
        belief: Estimates of the master.
        occluders: Whether what is mapped is taken into account.

    Raises:
        StageError: If there is none.
    """
    to_map, reason = belief.transform_ground_to_map, ""
    ground = belief.mapped_ground() if occluders else None
    for room in _ROOMS:
        stands = belief.navigator.standing_places(room)
        try:
            return best_camera_station(
                belief.robot,
                belief.site.insertion,
                ground=ground,
                may_stand=lambda place, stands=stands: stands(to_map.apply([*place, 0.0])[:2]),
            )
        except PlacementError as error:
            reason = str(error)
    raise StageError("place", reason)
