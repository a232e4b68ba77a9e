"""The insertion of a mission, in its field and over its radio, from rovers at their places."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import best_camera_station, camera_arm
from controllers.insertion.card_arm import CardArm
from controllers.insertion.card_inserter import InsertionStage
from controllers.mapping.localization import (
    LocalizationConfig,
    RobotLocalization,
    level_target,
)
from controllers.mission.radio import MissionRadio
from controllers.mission.robot_mission import RobotMission
from controllers.mission.stages.insert import GuideInsertion, InsertCard
from experiments.ch5.insertion_scene import in_slot, insertion_drawing, is_seated
from experiments.mission.scene import MASTER, SLAVE, roles
from experiments.mission.trial import Mission, MissionTrial, prepared, upright
from tests.experiments.mission.test_mission import near_scene
from twin.loop import run
from twin.robot import Command, Observation


class Placed:
    """Lets rovers that stand at their places, and know where by the truth, insert the card."""

    def __init__(self, mission: Mission) -> None:
        self._mission, self._ticks = mission, 0

    def reset(self) -> None:
        """Do nothing."""

    def step(self, seen: Mapping[str, Observation]) -> Mapping[str, Command]:
        """Let them settle, then insert."""
        team = self._mission.team
        self._ticks += 1
        if self._ticks < 100:
            for part in team.parts:
                part.belief.navigator.observe(seen[part.name])
            return {}
        if self._ticks == 100:
            for part in team.parts:
                self._localize(part)
            team.master, team.slave = self._parts()
        return team.step(seen)

    def _localize(self, part: RobotMission) -> None:
        belief, poses = part.belief, self._mission.poses(part.name)
        up = np.array(self._mission.scene.field.up)
        rotation = upright(poses["chassis"].rotation, up)
        level = RigidTransform.from_components(poses["chassis"].translation, rotation)
        panel = poses["slot"] * belief.site.transform_slot_to_panel.inv()
        to_world = level_target(level.inv() * panel)
        belief.map.transform_target_to_world = to_world
        arm, _ = camera_arm(belief.robot)
        deviations = np.array([2e-3] * 3 + [4e-3] * 3)
        belief.localize(
            RobotLocalization(
                arm,
                to_world * panel.inv() * level,
                np.diag(deviations**2),
                np.zeros((6, 6 + len(arm))),
                LocalizationConfig(),
            )
        )

    def _parts(self) -> list[RobotMission]:
        """Return both rovers' parts with the last stage alone."""
        master, slave = (part.belief for part in self._mission.team.parts)
        links = self._mission.connection.links
        radios = MissionRadio(links[MASTER], SLAVE), MissionRadio(links[SLAVE], MASTER)
        arm = CardArm(slave.robot, slave.site.insertion.tip)
        guide = GuideInsertion(master, radios[0], arm.transform_card_to_robot(slave.home))
        stages = guide, InsertCard(slave, radios[1])
        return [
            RobotMission(belief, radio, number, iter([stage]), np.random.default_rng(1))
            for number, (belief, radio, stage) in enumerate(zip((master, slave), radios, stages), 1)
        ]


def inserted(seed: int) -> bool:
    """Return whether the card is in the slot at the end, from rovers placed beside it."""
    scene, trial = near_scene(seed), MissionTrial(seed)
    station = best_camera_station(roles(trial.realism).master, insertion_drawing(trial.width))
    poses = {MASTER: station.place, SLAVE: (0.03, -0.95, 0.0)}
    robots = tuple(
        dataclasses.replace(robot, position=poses[robot.name][:2], yaw=poses[robot.name][2])
        for robot in scene.robots
    )
    scene = dataclasses.replace(scene, robots=robots, known=poses)
    with prepared(trial, scene) as mission:
        run(
            mission.connection.robots,
            [Placed(mission)],
            mission.connection.clock,
            [],
            90.0,
            until=lambda: mission.insertion is not None and mission.insertion.inserter.over,
        )
        assert mission.insertion is not None
        poses = mission.poses(SLAVE)
        seated = is_seated(in_slot(poses["slot"].inv() * poses["card"]), trial.width)
        assert not mission.team.notices
        return mission.insertion.inserter.stage is InsertionStage.DONE and seated


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_rovers_at_their_places_insert_the_card_by_radio_in_the_field() -> None:
    """On each processor it takes another course; a second and third one are for mishaps."""
    assert any(inserted(seed) for seed in (1, 2, 3))
