"""Drives to a place that fail: the place is chosen anew, and in the end the stage says why."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mission.behaviours import DRIVING, Driven
from controllers.mission.stage import StageError
from controllers.mission.stages import go_to
from controllers.mission.stages.go_to import GoToPlace, Wait
from tests.controllers.mission.hand_made import SLAVE, at_once, belief_of, localized
from tests.controllers.motion.seen import PAIR, seen_at


class GoBy(GoToPlace):
    """Drives by hand: to places on the map's x axis, without looking for the panel."""

    def _goal(self):
        return np.array(self.place[:2]), self.place[2]

    def _before_place(self):
        return self._goal()

    def _look(self, seen):
        return seen
        yield


def stage_with(monkeypatch, arrives, heading=0.0, near=(0.05, 0.1)):
    """Return a stage whose drives arrive or not, and places and headings that they went to."""
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    went, places = [], iter([(x, 0.0, heading) for x in range(2, 13)])

    def drive(seen, navigator, arm, goal):
        place, heading = goal()
        went.append((float(place[0]), heading))
        arrived = arrives(len(went))
        if arrived:
            navigator.odometry._pose = type(navigator.odometry.pose()).from_translation(
                [*place, 0.0]
            )
        return Driven(seen, arrived, "" if arrived else "there is no path")
        yield

    monkeypatch.setattr(go_to, "drive", drive)
    return GoBy("place", belief, lambda: next(places), near), went


def test_after_a_drive_that_failed_the_place_is_chosen_anew(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: count == 2)
    stage.step(seen_at(0.01))
    assert stage.done and went == [(2.0, 0.0), (3.0, 0.0)] and stage.place == (3.0, 0.0, 0.0)


def test_a_place_that_does_not_suit_is_left_for_another(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: True)
    suits = iter([False, False, True])
    stage._suits = lambda seen: next(suits)  # pyright: ignore
    stage.step(seen_at(0.01))
    assert stage.done and [place for place, _ in went] == [2.0, 3.0, 4.0]
    stage, _ = stage_with(monkeypatch, lambda count: True)
    stage._suits = lambda seen: False  # pyright: ignore
    with pytest.raises(StageError, match="10 drives: it cannot see what it is to watch"):
        stage.step(seen_at(0.01))


def test_where_no_other_place_is_within_reach_it_is_that_of_before(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: count == 3)

    def none():
        raise StageError("place", "no pose sees the slot")

    stage._choose = none  # pyright: ignore
    stage.step(seen_at(0.01))
    assert stage.done and went == [(2.0, 0.0)] * 3
    with pytest.raises(StageError, match="no pose"):
        GoBy("place", belief_of(SLAVE), none, (0.05, 0.1))


def test_drives_that_all_fail_end_the_stage_with_the_reason(monkeypatch):
    stage, went = stage_with(monkeypatch, lambda count: False)
    with pytest.raises(StageError, match="10 drives: there is no path"):
        stage.step(seen_at(0.01))
    assert [place for place, _ in went] == list(np.arange(2.0, 12.0))


@pytest.mark.parametrize("heading", [-0.9, -2.4, 0.0, 2.5])
def test_where_the_heading_matters_little_the_rover_turns_no_more_than_it_has_to(
    monkeypatch, heading
):
    """A path to the right ends in a heading of -pi / 2; drives by hand end in one of 0."""
    stage, went = stage_with(monkeypatch, lambda count: True, heading, (0.2, 1.0))
    led = -0.5 * np.pi
    off = np.remainder(led - heading + np.pi, 2.0 * np.pi) - np.pi
    turned = led if abs(off) < 1.0 else heading + 0.8 * np.sign(off)
    # The arm's base, before the middle of the rover, gets to its place in either heading.
    ahead = stage._arm.transform_base_to_robot.translation[1]
    place = pytest.approx(2.0 - ahead * (np.sin(heading) - np.sin(turned)))
    first = place, None if turned == led else pytest.approx(turned)
    if abs(heading) < 1.0:
        stage.step(seen_at(0.01))
        assert stage.done and went == [first]
        return
    with pytest.raises(StageError, match="degrees off its place after 10 drives"):
        stage.step(seen_at(0.01))
    # Where it stands at last, it can but turn.
    assert went[0] == first
    assert went[1][1] == pytest.approx(heading - 0.8 * np.sign(heading))


@pytest.mark.parametrize(
    ("place", "ways"),
    [
        ((0.01, 0.15, 0.05), 1),  # in line: ahead
        ((0.01, -0.15, 0.05), 1),  # in line: back
        ((0.06, 0.15, 0.05), 2),  # aside: straight first, to where a curve leads there
        ((0.01, 0.15, 0.30), 2),  # turned
    ],
)
def test_a_rover_near_its_place_docks(monkeypatch, place, ways):
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    went = []

    def straight(seen, navigator, arm, path, heading, backwards):
        went.append((path[-1], backwards))
        if len(went) == ways:
            turn = Rotation.from_euler("z", heading)
            navigator.odometry._pose = RigidTransform.from_components([*path[-1], 0.0], turn)
        return seen
        yield

    monkeypatch.setattr(go_to, "drive_along", straight)
    monkeypatch.setattr(go_to, "posed", at_once)
    monkeypatch.setattr(go_to, "finished", at_once)
    monkeypatch.setattr(belief.navigator, "take", lambda seen, at_rest: None)
    monkeypatch.setattr(belief.navigator, "unseen", lambda path, far: None)
    stage = GoBy("approach", belief, lambda: place, (0.035, 0.06))
    stage.step(seen_at(0.01))
    assert stage.done and len(went) == ways
    np.testing.assert_allclose(went[-1][0], place[:2])
    assert went[-1][1] == (place[1] < 0.0) or ways == 2


def test_a_drive_that_gets_no_nearer_is_held_and_the_place_chosen_anew(monkeypatch):
    belief = belief_of(SLAVE)
    belief.navigator.observe(seen_at(0.0))
    held, places = [], iter([(0.5, 0.5, 0.0), (0.0, 0.0, 0.0)])

    def drive(seen, navigator, arm, goal):
        return Driven(seen, True)
        yield

    def retreat(seen, navigator, **why):
        held.append(why["held"])
        return seen
        yield

    monkeypatch.setattr(go_to, "drive", drive)
    monkeypatch.setattr(go_to, "retreat", retreat)
    stage = GoBy("place", belief, lambda: next(places), (0.06, 1.8))
    stage.step(seen_at(0.01))
    assert stage.done and stage.place == (0.0, 0.0, 0.0) and held == [True]


@pytest.mark.parametrize(("off", "turns"), [(0.02, 0), (0.2, 1), (0.38, 2)])
def test_a_rover_that_has_docked_turns_until_its_head_sees_it_in_its_heading(
    monkeypatch, off, turns
):
    """Each turn makes up for 0.18 rad."""
    belief = belief_of(SLAVE)
    navigator = belief.navigator
    navigator.observe(seen_at(0.0))
    headings, left = [], [off]

    def be(heading):
        turn = Rotation.from_euler("z", heading)
        navigator.odometry._pose = RigidTransform.from_components([0.0, 0.3, 0.0], turn)

    def along(seen, *_):
        be(left[0])
        return seen
        yield

    def finished(seen, *_):
        left[0] -= 0.18
        be(left[0])
        return seen
        yield

    monkeypatch.setattr(go_to, "drive_along", along)
    monkeypatch.setattr(go_to, "posed", at_once)
    monkeypatch.setattr(go_to, "finished", finished)
    monkeypatch.setattr(navigator, "take", lambda seen, at_rest: None)
    monkeypatch.setattr(navigator, "follow", lambda path, heading: headings.append(heading))
    stage = GoBy("approach", belief, lambda: (0.0, 0.3, 0.0), (0.1, 0.07))
    stage.step(seen_at(0.01))
    assert stage.done and headings == [0.0] * turns


def test_a_rover_that_waits_looks_every_ten_seconds_whether_it_still_stands(monkeypatch):
    belief = localized(SLAVE)
    navigator, looks = belief.navigator, []
    monkeypatch.setattr(navigator, "take", lambda seen, at_rest: looks.append(seen.time))
    wait, time, before = Wait("place", belief), 0.0, belief.localization
    while time < 35.0:
        time += 0.01
        wait.step(seen_at(time, np.zeros(4), DRIVING, PAIR, time))
    assert len(looks) == 4 and looks[0] < 2.0
    np.testing.assert_allclose(np.diff(looks), 10.0, atol=0.03)
    assert belief.localization is not before


def test_a_rover_stops_short_of_its_place_where_there_is_room_by_what_is_mapped_then(monkeypatch):
    belief = belief_of(SLAVE)
    navigator = belief.navigator
    navigator.observe(seen_at(0.0))
    free = [-0.5, 0.4]
    monkeypatch.setattr(navigator, "is_clear", lambda path: path[0][0] - path[1][0] in free)
    monkeypatch.setattr(navigator, "lengths_to", lambda places: np.ones(len(places)))
    stage = GoToPlace("approach", belief, lambda: (0.0, 0.0, -0.5 * math.pi), (0.1, 0.07))
    monkeypatch.setattr(stage, "_goal", lambda: (np.zeros(2), -0.5 * math.pi))
    for x in (-0.5, 0.4, 0.0):
        place, heading = stage._before_place()
        np.testing.assert_allclose(place, [x, 0.0], atol=1e-12)
        assert heading == -0.5 * math.pi and stage._docks == (x != 0.0)
        free = [other for other in free if other != x]
