"""Both rovers of a mission; the controller that the loop runs."""

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import (
    GAP,
    CameraStation,
    best_camera_station,
    camera_arm,
    stereo_geometry,
    watch_plan,
)
from controllers.insertion.card_arm import CardArm
from controllers.insertion.watching import best_angles
from controllers.mission.belief import MissionBelief, tilt_of
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
from perception.geometry.arrays import FloatArray
from twin.link import Link
from twin.robot import Command, Observation

_ROOMS = (0.12, 0.02, None)
"""Room about the camera station that is wanted, and what is content with if there is none [m]: a
rover slides as it turns there."""
_ELSEWHERE = 0.15  # Distance of a place from one that did not suit [m].
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
        once_more = rng.spawn(2)
        self.master = RobotMission(master, radios[0], 1, guides, once_more[0])
        held = _slave_stages(slave, radios[1], config, holding)
        self.slave = RobotMission(slave, radios[1], 2, held, once_more[1])

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
    stations = CameraStations(belief, occluders)
    yield GoToPlace("place", belief, lambda: stations.best().place, _NEAR_STATION, stations.suits)
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


class CameraStations:
    """Camera stations of the master, on its map.

    Args:
        belief: Estimates of the master.
        occluders: Whether what is mapped is taken into account.
    """

    def __init__(self, belief: MissionBelief, occluders: bool) -> None:
        self._belief, self._occluders = belief, occluders
        self._unfit: list[FloatArray] = []  # Places (2,) that did not suit, ground frame.

    def best(self) -> CameraStation:
        """Return the best station within reach.

        Raises:
            StageError: If there is none.
        """
        belief, reason = self._belief, ""
        ground = belief.mapped_ground() if self._occluders else None
        for room in _ROOMS:
            stands = belief.navigator.standing_places(room)
            try:
                return best_camera_station(
                    belief.robot,
                    belief.site.insertion,
                    ground=ground,
                    may_stand=lambda place, stands=stands: self._may_stand(place, stands),
                )
            except PlacementError as error:
                reason = str(error)
        raise StageError("place", reason)

    def suits(self, seen: Observation) -> bool:
        """Return whether an arm at rest has a view of slot and aligned card from where it stands.

        Args:
            seen: Observation of the master.
        """
        belief = self._belief
        drawing, (arm, head) = belief.site.insertion, camera_arm(belief.robot)
        slot, _ = belief.slot_in_robot(tilt_of(seen, belief.robot.name))
        to_robot = slot * drawing.transform_slot_to_ground.inv()
        about = belief.surroundings(slot) if self._occluders else None
        view = best_angles(
            watch_plan(head, drawing),
            drawing.parts(GAP, to_robot),
            arm,
            stereo_geometry(belief.robot),
            belief.home,
            sure=False,
            about=about,
        )
        if not view.whole:
            self._unfit.append(belief.place_in_ground()[:2])
        return view.whole

    def _may_stand(self, place: FloatArray, stands: Callable[[ArrayLike], bool]) -> bool:
        """Return whether the master may stand at a place (2,), ground frame."""
        if any(math.dist(place, each) < _ELSEWHERE for each in self._unfit):
            return False
        return stands(self._belief.transform_ground_to_map.apply([*place, 0.0])[:2])
