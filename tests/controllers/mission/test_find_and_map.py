"""Stages ``find`` and ``map``: what they take from their mapper, and what they hand to it."""

import types
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.shared_map import SharedMap
from controllers.mapping.stereo_mapper import StereoMapper
from controllers.mission.belief import MissionBelief
from controllers.mission.exchange import ArmPosture, SlotPose
from controllers.mission.stages.find import FindPanel
from controllers.mission.stages.map import MapTogether
from tests.controllers.mission.hand_made import (
    HOME,
    MASTER,
    ROVERS,
    SITE,
    SLAVE,
    KinematicRover,
    belief_of,
    exchange_with,
    transform_robot_to_ground,
)
from twin.robot import Command, Observation

PANEL_TO_GROUND = SITE.insertion.transform_slot_to_ground * SITE.transform_slot_to_panel.inv()
CAMERA_ARM = camera_arm(ROVERS[MASTER])[0]


class Mapper:
    """Stands for a mapper that takes views until a test ends it.

    Attributes:
        done: Whether all views are taken.
        localizations: Localization of each robot that has one.
        steps: Name and known postures of each robot's step.
    """

    def __init__(self, shared: typing.Any, *names: str) -> None:
        self.shared, self.done = shared, False
        self.localizations: dict[str, typing.Any] = dict.fromkeys(names)
        self.steps: list[tuple[str, dict[str, np.ndarray]]] = []

    def step(self, seen: dict[str, Observation]) -> dict[str, Command]:
        return {name: Command(np.zeros(4), HOME + 0.1) for name in seen}

    def step_robot(self, name: str, seen: Observation, arms: dict[str, np.ndarray]) -> Command:
        self.steps.append((name, dict(arms)))
        return Command(np.zeros(4), HOME + 0.2)


def shared_map() -> SharedMap:
    """Return a map that stands in the panel's own frame."""
    known = types.SimpleNamespace(transform_target_to_world=RigidTransform.identity())
    return typing.cast(SharedMap, known)


def localization_of(name: str) -> RobotLocalization:
    """Return where a rover is in the panel's frame, with both where drawn."""
    to_world = PANEL_TO_GROUND.inv() * transform_robot_to_ground(name)
    return RobotLocalization(CAMERA_ARM, to_world, 1e-6 * np.eye(6), np.zeros((6, 10)))


def test_master_that_has_found_the_panel_knows_the_map_and_the_slot() -> None:
    belief = belief_of(MASTER)
    stage = FindPanel(belief, 4, np.random.default_rng(0))
    mapper = Mapper(shared_map())
    stage.mapper = typing.cast(StereoMapper, mapper)
    rover, drawn = KinematicRover(MASTER), belief.transform_slot_to_level
    for done, name in ((False, ""), (True, ""), (False, MASTER)):
        mapper.done = done
        mapper.localizations = {name: localization_of(MASTER)} if name else {}
        np.testing.assert_array_equal(rover.step(stage).arm, HOME + 0.1)
        assert belief.map is None and belief.localization is None and stage.done is done
        assert belief.transform_slot_to_level is drawn
    mapper.done = True
    rover.step(stage)
    assert belief.map is mapper.shared
    assert belief.localization is mapper.localizations[MASTER] and stage.done
    slot = transform_robot_to_ground(MASTER).inv() * SITE.insertion.transform_slot_to_ground
    np.testing.assert_allclose(
        belief.transform_slot_to_level.as_matrix(), slot.as_matrix(), atol=1e-9
    )


def localized() -> MissionBelief:
    belief = belief_of(MASTER)
    belief.map = shared_map()
    belief.localize(localization_of(MASTER))
    return belief


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[typing.Any]:
    """Return a list that gets the arguments of each new mapper."""
    begun: list[typing.Any] = []

    def mapper(robots, shared, config, rng, localizations):
        begun.append((robots, shared, config, rng, localizations))
        return Mapper(shared, *localizations)

    monkeypatch.setattr("controllers.mission.stages.map.StereoMapper", mapper)
    return begun


@pytest.mark.parametrize("met", [True, False])
def test_slave_maps_too_if_its_pose_was_measured(begun: list[typing.Any], met: bool) -> None:
    belief, rng = localized(), np.random.default_rng(0)
    exchange, _ = exchange_with(MASTER, SLAVE)
    slave = transform_robot_to_ground(SLAVE)
    slot = slave.inv() * SITE.insertion.transform_slot_to_ground
    belief.partner = SlotPose(slot, 1e-6 * np.eye(6), met=met)
    stage = MapTogether.begin(belief, ROVERS[SLAVE], exchange, 3, rng)
    ((robots, shared, config, generator, places),) = begun
    assert stage.mapper is exchange.mapper
    assert set(robots) == set(places) == ({MASTER, SLAVE} if met else {MASTER})
    assert shared is belief.map and config.scans == 3 and generator is rng
    assert places[MASTER] is belief.localization
    if met:
        assert robots[SLAVE] is ROVERS[SLAVE]
        np.testing.assert_allclose(
            places[SLAVE].transform_level_to_world.as_matrix(),
            (PANEL_TO_GROUND.inv() * slave).as_matrix(),
            atol=1e-9,
        )


def test_robot_steps_with_all_known_postures_and_moves_home_if_it_does_not_map() -> None:
    exchange, _ = exchange_with(MASTER, SLAVE)
    exchange.mapper = typing.cast(StereoMapper, mapper := Mapper(shared_map(), MASTER))
    stages = [MapTogether(belief_of(name), exchange) for name in (MASTER, SLAVE)]
    rovers = [KinematicRover(name, HOME + 0.3) for name in (MASTER, SLAVE)]
    exchange.post(MASTER, ArmPosture(HOME + 0.3))
    exchange.post(SLAVE, ArmPosture(None))
    np.testing.assert_array_equal(rovers[0].step(stages[0]).arm, HOME + 0.2)
    ((name, arms),) = mapper.steps
    assert name == MASTER and set(arms) == {MASTER}
    np.testing.assert_array_equal(arms[MASTER], HOME + 0.3)
    for _ in range(100):
        rovers[1].step(stages[1])
        assert not rovers[1].drives
    np.testing.assert_allclose(rovers[1].command.arm, HOME, atol=1e-12)
    assert len(mapper.steps) == 1
    assert not stages[1].done
    mapper.done = True
    assert stages[1].done
