"""Both rovers that cross a field; the controller that the loop runs.

What one rover needs of the other is passed within the process: that it has ended its part of a
stage, and where it stands.
"""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from controllers.crossing.go_to import GoToPlace, Wait
from controllers.crossing.knowledge import FieldKnowledge
from controllers.crossing.map import MapSite
from controllers.crossing.rover import FieldRover, FieldStage, StageError
from controllers.crossing.search import SearchPanel
from controllers.crossing.site import FieldDrawing
from controllers.insertion.camera_station import CameraStation, best_camera_station
from controllers.mission.site import MissionRoles
from controllers.placement.mapped_ground import MappedGround
from controllers.placement.task import PlacementError
from perception.geometry.arrays import FloatArray
from twin.robot import Command, Observation

OMITTABLE = ("paths", "occluders")
"""Points of the map that an ablation takes away: those that paths avoid, or those by which the
camera station is chosen."""
_FILLING = 0.05  # Distance of points that stand for a disc [m].
_TELLING = 100  # Ticks between two messages of where a rover stands.
_NEAR_SLOT, _NEAR_STATION = (0.035, 0.06), (0.06, 0.12)
"""Tolerances of both rovers' places: distance [m] and heading [rad]."""


@dataclasses.dataclass(frozen=True)
class CrossingConfig:
    """Configuration of a crossing.

    Attributes:
        without: Part of `OMITTABLE` that is left out; empty for none.
        scans: Number of views with which the master maps the site.
    """

    without: str = ""
    scans: int = 5


class CrossingTeam:
    """Runs both rovers' parts; a `twin.robot.Controller`.

    Stages are: ``search`` (both), ``approach`` (the slave drives before the slot), ``map`` (the
    master maps the site) and ``place`` (the master drives to its camera station).

    Args:
        roles: Descriptions of both rovers.
        site: Drawing of the site.
        config: Configuration of the crossing.
        rng: Random generator for searches and candidate views.

    Attributes:
        master: Estimates of the rover that maps the site.
        slave: Estimates of the rover with the card.
        rovers: Both rovers' parts, the master's first.
    """

    def __init__(
        self,
        roles: MissionRoles,
        site: FieldDrawing,
        config: CrossingConfig,
        rng: np.random.Generator,
    ) -> None:
        blind = config.without == "paths"
        self.master = FieldKnowledge.initial(roles.master, site, blind)
        self.slave = FieldKnowledge.initial(roles.slave, site, blind)
        self._ticks = 0
        guiding, holding = rng.spawn(2)
        self.rovers = (
            FieldRover(roles.master.name, self._master_stages(config, guiding)),
            FieldRover(roles.slave.name, self._slave_stages(holding)),
        )

    def reset(self) -> None:
        """Do nothing: each crossing has a new team."""

    def step(self, observations: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Step both rovers; a stage ends for both together."""
        self._tell_places()
        goes_on = all(rover.stage.done for rover in self.rovers)
        commands = {rover.name: rover.step(observations, goes_on) for rover in self.rovers}
        return {name: command for name, command in commands.items() if command is not None}

    def _tell_places(self) -> None:
        """Let each rover that knows where it stands tell the other, once a second."""
        self._ticks += 1
        if self._ticks % _TELLING:
            return
        for one, other in ((self.master, self.slave), (self.slave, self.master)):
            if one.localization is not None:
                other.partner = one.place_in_ground()[:2]

    @property
    def over(self) -> bool:
        """Whether the last stage has ended."""
        return all(rover.over for rover in self.rovers)

    @property
    def ended(self) -> list[str]:
        """Names of the stages that both rovers have completed."""
        return [name for name, _ in zip(*(rover.ended for rover in self.rovers))]

    def _master_stages(
        self, config: CrossingConfig, rng: np.random.Generator
    ) -> Iterator[FieldStage]:
        knowledge = self.master
        yield SearchPanel(knowledge, rng)
        yield Wait("approach", knowledge)
        yield MapSite(knowledge, config.scans, rng)
        place = self._station(config).place
        yield GoToPlace("place", knowledge, place, _NEAR_STATION)

    def _slave_stages(self, rng: np.random.Generator) -> Iterator[FieldStage]:
        knowledge = self.slave
        yield SearchPanel(knowledge, rng)
        yield GoToPlace("approach", knowledge, knowledge.site.card_place, _NEAR_SLOT)
        yield Wait(MapSite.name, knowledge)
        yield Wait("place", knowledge)

    def _station(self, config: CrossingConfig) -> CameraStation:
        """Return the best camera station that the master can reach, on its map.

        Raises:
            StageError: If there is none.
        """
        knowledge = self.master
        to_ground = knowledge.transform_ground_to_map.inv()
        if config.without == "occluders":
            ground = MappedGround(None, to_ground)
        else:
            high = to_ground.apply(knowledge.navigator.high_places())
            kept_off = np.vstack([high[:, :2], _filled(knowledge.discs())])
            surface = knowledge.map.voxels.surface()
            ground = MappedGround(surface, to_ground, obstacles=kept_off)
        start, drawing = knowledge.place_in_ground()[:2], knowledge.site.insertion
        try:
            return best_camera_station(knowledge.robot, drawing, ground=ground, start=start)
        except PlacementError as error:
            raise StageError("place", str(error)) from error


def _filled(discs: FloatArray) -> FloatArray:
    """Return points (N, 2) a few centimetres apart that fill discs (K, 3) [m]."""
    side = np.arange(-0.5, 0.51, _FILLING)
    square = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    spread = [square[np.hypot(*square.T) <= radius] + (x, y) for x, y, radius in discs]
    return np.vstack([discs[:, :2], *spread])
