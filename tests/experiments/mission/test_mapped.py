"""The map of a mission's site and the station chosen on it, from a rover that stands before it."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.insertion.camera_station import held_space
from controllers.mission.radio import MissionRadio
from controllers.mission.robot_mission import RobotMission
from controllers.mission.stages.go_to import Wait
from controllers.mission.stages.map_site import MapSite
from controllers.mission.team import CameraStations
from experiments.mission.scene import MASTER, PILLAR, SLAVE, MissionScene, draw_scene
from experiments.mission.trial import MissionTrial, generators, prepared
from tests.experiments.mission.test_inserted import Placed
from twin.loop import run

SEED, PLACE = 13, (1.35, -1.0, 0.9)
"""A field whose pillar stands in the slot's best view, and the master's pose."""
VIEWS = 5


class Mapping(Placed):
    """Lets the master, which knows its place by the truth, map the site."""

    def _parts(self) -> list[RobotMission]:
        master, slave = (part.belief for part in self._mission.team.parts)
        links = self._mission.connection.links
        rng = np.random.default_rng(0)
        self.stage = MapSite(master, VIEWS, rng)
        return [
            RobotMission(master, MissionRadio(links[MASTER], SLAVE), 1, iter([self.stage]), rng),
            RobotMission(
                slave, MissionRadio(links[SLAVE], MASTER), 2, iter([Wait("map", slave)]), rng
            ),
        ]

    @property
    def done(self) -> bool:
        """Whether all views are taken."""
        return hasattr(self, "stage") and self.stage.done


@pytest.fixture(scope="module")
def mapped():
    trial = MissionTrial(SEED)
    scene = draw_scene(trial.width, generators(SEED)[0])
    robots = tuple(
        dataclasses.replace(robot, position=PLACE[:2], yaw=PLACE[2])
        if robot.name == MASTER
        else robot
        for robot in scene.robots
    )
    scene = dataclasses.replace(scene, robots=robots, known={**scene.known, MASTER: PLACE})
    with prepared(trial, scene) as mission:
        team = Mapping(mission)
        run(
            mission.connection.robots,
            [team],
            mission.connection.clock,
            [],
            60.0,
            until=lambda: team.done,
        )
        yield team, mission, scene


def pillar_of(scene: MissionScene) -> np.ndarray:
    """Return where the pillar stands."""
    return np.array(next(s.position for s in scene.field.screens if s.size == PILLAR))


@pytest.mark.slow
def test_the_site_is_mapped_in_all_views_with_the_pillar(mapped: tuple) -> None:
    team, mission, scene = mapped
    assert len(team.stage.mapper.views) == VIEWS
    belief = mission.team.master.belief
    points = belief.transform_ground_to_map.inv().apply(belief.map.voxels.surface().means)
    away = np.linalg.norm(points[:, :2] - pillar_of(scene), axis=1)
    assert np.sum((away < 0.1) & (points[:, 2] > 0.1)) > 100


@pytest.mark.slow
def test_at_the_station_arm_and_head_keep_clear_of_the_true_pillar(mapped: tuple) -> None:
    _, mission, scene = mapped
    belief = mission.team.master.belief
    station = CameraStations(belief, occluders=True).best()
    pillar, half = pillar_of(scene), PILLAR[0] / 2.0
    spheres = held_space(belief.robot, station)
    # A square pillar is farther than a disc about its corners.
    gaps = np.linalg.norm(spheres[:, :2] - pillar, axis=1) - spheres[:, 3] - half * math.sqrt(2.0)
    assert gaps.min() > 0.0
