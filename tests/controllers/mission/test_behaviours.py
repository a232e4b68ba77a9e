"""Drives and poses of a rover, on a navigator made by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from controllers.insertion.camera_station import camera_arm
from controllers.mission.behaviours import (
    DRIVING,
    LOOKING,
    drive,
    drive_along,
    faced,
    posed,
    recognised,
    retreat,
)
from tests.controllers.motion.seen import PAIR, seen_at
from twin.describe import describe_rover
from twin.robot import Command

ARM, _ = camera_arm(describe_rover("rover1"))
STEPS = 100
"""Ticks of a drive made by hand."""


def ahead():
    return np.array([0.0, 1.0]), None


def behind():
    return np.array([0.2, -1.1]), None


class HandNavigator:
    """Drives for some ticks; may be held, find no path, or not have seen ground before it."""

    def __init__(self, path=True, held=0, unseen=(), waits_at=None):
        self.calls, self.postures = [], []
        self._path, self._held, self._unseen = path, held, list(unseen)
        self._left, self.blocked, self.taken = 0, "", 0
        self.place, self.yaw, self.heading = np.zeros(2), 0.0, math.nan
        self.room = math.inf
        self.waits, self._waits_at, self.tip_guard = False, waits_at, None
        self.astray, self.known, self.odometry = False, None, SimpleNamespace(strayed=0.0)

    @property
    def looks(self):
        """Number of pairs taken in the posture for looks at the ground."""
        return sum(abs(posture[2] - LOOKING[2]) < 1e-6 for posture in self.postures)

    def may_turn(self, angle):
        return abs(angle) <= self.room

    def path_to(self, place):
        return np.array([[0.0, 0.0], place]) if self._path else None

    def unseen(self, path):
        return np.array(self._unseen[0]) if self._unseen else None

    def to_look_at(self):
        return np.array(self._unseen[0])

    def looked(self):
        self._unseen.pop(0)

    def set_off(self, place, heading):
        self.calls.append("set off")
        self._left, self.blocked, self.waits = self._left or STEPS, "", False
        return self._path

    def follow(self, path, heading, backwards=False):
        self.calls.append("back" if backwards else "straight")
        self.heading = heading
        self._left = STEPS

    @property
    def arrived(self):
        return self._left == 0

    @property
    def held(self):
        return bool(self.blocked)

    def is_due(self, seen):
        return self._left % 20 == 10

    def take(self, seen, at_rest):
        self.taken += 1
        self.postures.append(np.array(seen.arm_angles.value))
        if self.known is not None and abs(self.postures[-1][0] - self.known) < 0.1:
            self.astray = False
        return None

    def resign(self):
        self.calls.append("resign")
        self.astray = False

    def correct(self):
        self.calls.append("correct")

    def halt(self):
        self.calls.append("halt")
        self._left = 0

    def back_off(self, held):
        self.calls.append("back off" if held else "retreat")
        self._left, self.blocked = 10, ""

    def step(self, seen):
        self._left -= 1
        if self._left == self._waits_at:
            self.waits, self._waits_at = True, None
            self._unseen.append([0.0, 0.6, -0.06])
        if self._held and self._left == STEPS // 2:
            self._held -= 1
            self.blocked = "something holds the rover"
        return Command(np.ones(4))


def play(behaviour, begin=0.0):
    """Run a behaviour on a rover whose arm follows at once; return what it returns, and time."""
    time, angles = begin, DRIVING.copy()
    try:
        command = next(behaviour)
        while True:
            if len(command.arm):
                angles = np.array(command.arm)
            time += 0.01
            command = behaviour.send(
                seen_at(time, arm_angles=angles, stereo=PAIR, stereo_stamp=time)
            )
    except StopIteration as end:
        return end.value, time


def first():
    return seen_at(0.0, arm_angles=DRIVING.copy(), stereo=PAIR)


def test_posed_returns_with_a_pair_taken_at_the_goal():
    goal = DRIVING + [0.8, 0.0, 0.0, 0.0]
    seen, time = play(posed(first(), HandNavigator(), goal))
    np.testing.assert_allclose(seen.arm_angles.value, goal, atol=1e-9)
    assert 1.0 <= time < 3.0  # a second of motion, and the time of rest


def test_a_drive_takes_pairs_before_and_on_the_way():
    navigator = HandNavigator()
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert driven.arrived and not driven.reason
    assert navigator.calls[0] == "set off" and navigator.calls[-1] == "halt"
    assert navigator.calls.count("correct") == 5 and navigator.taken == 6
    np.testing.assert_allclose(navigator.postures, np.tile(DRIVING, (6, 1)), atol=1e-9)


def test_unseen_ground_is_looked_at_before_a_drive_sets_off():
    sides = [[-0.6, 0.1, -0.06], [0.5, 0.5, -0.06]]
    navigator = HandNavigator(unseen=sides)
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert driven.arrived and navigator.calls.count("set off") == 1
    for posture, point in zip(navigator.postures, sides):
        seen = ARM.tool_in_robot(posture).apply(point, inverse=True)
        off = np.degrees(np.arctan2(np.hypot(*seen[:2]), seen[2]))
        assert off < 15.0  # The wrist is at its limit; half the view's height is 16 degrees.
        np.testing.assert_allclose(posture[1:3], LOOKING[1:3], atol=1e-9)
    np.testing.assert_allclose(navigator.postures[2], DRIVING, atol=1e-9)


def test_a_rover_that_waits_before_unseen_ground_looks_at_it_and_drives_on():
    navigator = HandNavigator(waits_at=30)
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert driven.arrived and navigator.calls.count("set off") == 2
    assert navigator.calls.count("back off") == 0
    assert navigator.looks == 1


def test_a_drive_in_one_go_ends_where_it_first_stops():
    for navigator, held in ((HandNavigator(waits_at=30), 0), (HandNavigator(held=1), 1)):
        driven, _ = play(drive(first(), navigator, ARM, ahead, once=True))
        assert driven.stopped and not driven.arrived
        assert navigator.calls.count("set off") == 1
        assert navigator.calls.count("back off") == held and navigator.arrived


def test_a_rover_beside_something_moves_away_before_it_turns():
    for behaviour in (drive, faced):
        navigator = HandNavigator()
        # To what lies behind on its right it turns by 2.96 rad; to see it, by 0.76.
        goal = np.array([0.2, -1.1, 0.0]) if behaviour is faced else behind
        turned = 0.76 if behaviour is faced else 2.96
        for navigator.room, moved in ((turned - 0.05, True), (turned + 0.05, False)):
            navigator.calls.clear()
            play(behaviour(first(), navigator, ARM, goal))
            moves = [call for call in navigator.calls if call in ("retreat", "set off", "straight")]
            assert (moves[0] == "retreat") == moved and len(moves) == 1 + moved


def test_a_straight_drive_looks_ahead_but_not_where_it_came_from():
    for backwards, looks in ((False, 1), (True, 0)):
        navigator = HandNavigator(unseen=[[0.0, 0.6, -0.06]])
        path = np.array([[0.0, 0.0], [0.0, 0.4]])
        play(drive_along(first(), navigator, ARM, path, 0.0, backwards))
        assert navigator.calls[0] == ("back" if backwards else "straight")
        assert navigator.looks == looks


def test_a_held_rover_backs_off_and_tries_again():
    navigator = HandNavigator(held=1)
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert driven.arrived
    assert navigator.calls.count("back off") == 1 and navigator.calls.count("set off") == 2


def test_a_rover_that_is_held_again_and_again_says_why():
    navigator = HandNavigator(held=99)
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert not driven.arrived and "something holds the rover" in driven.reason
    assert navigator.calls.count("set off") == 4


def test_without_a_path_the_rover_looks_on_all_sides_and_moves_a_little_before_it_gives_up():
    navigator = HandNavigator(path=False)
    driven, _ = play(drive(first(), navigator, ARM, ahead))
    assert not driven.arrived and "no path" in driven.reason
    assert navigator.calls.count("set off") == navigator.calls.count("retreat") == 4
    turns = [posture[0] for posture in navigator.postures if abs(posture[2] - LOOKING[2]) < 1e-6]
    assert len(turns) == 4 * 7 and np.diff(sorted(set(turns))).max() < 0.9


def test_a_rover_faces_what_is_behind_it_before_it_looks_there():
    for point, turned in (([0.1, -0.6, 0.0], True), ([0.6, -0.1, 0.0], False)):
        navigator = HandNavigator()
        play(faced(first(), navigator, ARM, np.array(point)))
        assert ("straight" in navigator.calls) == turned
        if turned:
            left = math.remainder(math.atan2(-point[0], point[1]) - navigator.heading, 2 * math.pi)
            assert abs(left) == pytest.approx(ARM.limits[0, 1] - 0.4)
            assert abs(navigator.heading) < 1.0


def test_a_pair_may_end_the_drive():
    navigator = HandNavigator()
    seen = []

    def on_pair(observation, found):
        seen.append(observation.time)
        return len(seen) == 4

    driven, _ = play(drive(first(), navigator, ARM, ahead, on_pair))
    assert driven.arrived and len(seen) == 4
    assert navigator.calls[-1] == "halt"


def test_a_retreat_drives_back_without_a_bump():
    navigator = HandNavigator()
    play(retreat(first(), navigator, held=False))
    assert navigator.calls == ["retreat", "halt"]


def test_an_astray_rover_turns_its_head_back_until_it_recognises_something():
    """It has turned by 0.6 rad to the left, by its wheels; truly by 0.9 rad, or who knows."""
    for known, calls, turns in ((-0.9, [], [0.0, -0.3, -0.6, -0.9]), (None, ["resign"], None)):
        navigator = HandNavigator()
        play(recognised(first(), navigator))
        assert not navigator.postures
        navigator.astray, navigator.known, navigator.odometry.strayed = True, known, 0.6
        play(recognised(first(), navigator))
        assert not navigator.astray and navigator.calls == calls
        if turns:
            np.testing.assert_allclose([p[0] for p in navigator.postures], turns, atol=0.02)


def test_where_a_drive_leads_is_asked_again_after_each_stop():
    navigator, asked = HandNavigator(held=1, waits_at=30), []

    def goal():
        asked.append(len(navigator.calls))
        return ahead()

    driven, _ = play(drive(first(), navigator, ARM, goal))
    assert driven.arrived and len(asked) == navigator.calls.count("set off") == 3
