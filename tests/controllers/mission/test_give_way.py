"""A rover that waits drives out of the way, and farther from what the other one needs."""

import numpy as np
import pytest

from controllers.mission.behaviours import Driven
from controllers.mission.radio import MissionRadio, Status
from controllers.mission.robot_mission import RobotMission
from controllers.mission.stages import give_way
from controllers.mission.stages.give_way import GiveWay
from tests.controllers.mission.hand_made import MASTER, SLAVE, hand_links, localized
from tests.controllers.motion.seen import seen_at
from twin.robot import Command

RNG = np.random.default_rng(1)


def mapped(belief, wall=None):
    """Map level ground about a rover, with a wall around it if that has a distance [m]."""
    ground = belief.navigator.ground.newest
    centres = ground.grid.centres - belief.navigator.place
    ground.heights[...], ground.variances[...] = 0.0, 1e-6
    if wall is not None:
        away = np.abs(centres).max(axis=-1)
        ground.heights[(away > wall) & (away < wall + 0.1)] = 0.3
    return belief


@pytest.fixture
def goals(monkeypatch):
    """Return the goals of all drives, which arrive at once."""
    driven = []

    def drive(seen, navigator, arm, goal):
        driven.append(goal())
        return Driven(seen, True)
        yield

    monkeypatch.setattr(give_way, "drive", drive)
    return driven


def test_it_drives_farther_from_the_site(goals):
    belief = mapped(localized(MASTER))
    way = GiveWay(belief)
    way.step(seen_at(0.01))
    ((place, heading),) = goals
    here, needed = belief.navigator.place, belief.structures()[:, :2]
    before, after = (np.linalg.norm(needed - p, axis=1).min() for p in (here, place))
    assert way.done and heading is None and after > before + 0.5
    assert 0.7 < np.linalg.norm(place - here) < 1.3


def test_a_rover_that_gets_nowhere_stays(goals):
    way = GiveWay(mapped(localized(MASTER), wall=0.5))
    way.step(seen_at(0.01))
    assert way.done and not goals


class Done:
    """A stage whose part is done."""

    name, done = "wait", True

    def step(self, seen):
        return None


def test_a_rover_that_has_done_its_part_gives_way_once_the_other_one_has_no_path(goals):
    links = hand_links()
    part = RobotMission(
        mapped(localized(SLAVE)), MissionRadio(links[0], MASTER), 2, iter([Done(), Done()]), RNG
    )
    for time, blocked, ways in ((1.0, False, 0), (2.0, True, 1), (3.0, True, 1), (4.0, False, 1)):
        links[1].send(Status(0, blocked=blocked).pack())
        for tick in range(3):
            command = part.step(seen_at(time + 0.01 * tick))
            assert command is None or isinstance(command, Command)
        assert len(goals) == ways
    links[1].send(Status(0, blocked=True).pack())
    part.step(seen_at(5.0))
    part.step(seen_at(5.01))
    assert len(goals) == 2


def test_no_stage_begins_while_a_rover_drives_out_of_the_way(monkeypatch):
    """A stage would begin with the localization of before the drive."""
    driving = [True]

    def drive(seen, navigator, arm, goal):
        while driving:
            seen = yield Command()
        return Driven(seen, True)

    monkeypatch.setattr(give_way, "drive", drive)
    links = hand_links()
    belief = mapped(localized(SLAVE))
    part = RobotMission(belief, MissionRadio(links[0], MASTER), 2, iter([Done(), Done()]), RNG)
    before = belief.localization
    for time, blocked, done in ((1.0, True, 0), (2.0, False, 1)):
        links[1].send(Status(done, blocked=blocked).pack())
        for tick in range(5):
            part.step(seen_at(time + 0.01 * tick))
        assert part.ended == [] and belief.localization is before
    driving.clear()
    for tick in range(3):
        part.step(seen_at(3.0 + 0.01 * tick))
    assert part.ended == ["wait"] and belief.localization is not before


def test_a_rover_that_has_taken_its_place_stays(goals):
    links = hand_links()
    part = RobotMission(
        mapped(localized(SLAVE)), MissionRadio(links[0], MASTER), 2, iter([Done(), Done()]), RNG
    )
    part.ended.append("place")
    links[1].send(Status(0, blocked=True).pack())
    for tick in range(3):
        part.step(seen_at(2.0 + 0.01 * tick))
    assert not goals


def test_a_rover_without_a_path_tells_it_until_it_has_one():
    links = hand_links()
    belief = mapped(localized(SLAVE))
    part = RobotMission(belief, MissionRadio(links[0], MASTER), 2, iter([Working()]), RNG)
    for time, hindered in ((1.0, True), (3.0, False)):
        belief.navigator.hindered = hindered
        part.step(seen_at(time))
        part.step(seen_at(time + 1.01))
        messages = [m for m in links[1].poll().messages if m[0] == Status(0).pack()[0]]
        assert Status.unpack(messages[-1]).blocked == hindered


class Working(Done):
    """A stage that goes on."""

    done = False
