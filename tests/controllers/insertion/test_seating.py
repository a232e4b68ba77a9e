"""What the guide into a connector does with forces: it snaps in, stands square, and gives way."""

import dataclasses
import math

import numpy as np
import pytest

from controllers.insertion.guide import GuideConfig, Phase
from controllers.insertion.seating import SeatingConfig, SeatingGuide, StraightSeating

CONFIG = GuideConfig(0.10795, 0.3, 1981.25)
BOTTOM = SeatingConfig(bottom=0.04, snap=3.0, mouth=0.0084)
START = np.array([0.0, 0.03, 0.0])


class Connector:
    """Forces of a connector on a card of which the hand's spring is bent by them."""

    def __init__(self, snap=3.0, aside=0.0, bottom=0.04, drift=0.0):
        self.snap, self.aside, self.bottom, self.drift = snap, aside, bottom, drift
        self.inside = False

    def wrench(self, command):
        """Return the wrench (6,) at a commanded pose: the springs, then the bottom aside."""
        push = max(CONFIG.stiffness * (command[1] - (self.bottom - 0.003)), 0.0)
        self.inside |= push > self.snap
        self.inside &= command[1] > self.bottom - 0.006
        if not self.inside:
            return np.array([0.0, -push, 0.0, 0.0, 0.0, 0.0])
        push = 0.6 + max(CONFIG.stiffness * (command[1] - self.bottom), 0.0)
        return np.array([0.0, -push, 0.0, 0.0, 0.0, self.drift - self.aside * (push - 0.6)])


def seat(connector, steps=3000, config=BOTTOM):
    guide = SeatingGuide(CONFIG, START, config)
    pushes = []
    for _ in range(steps):
        wrench = connector.wrench(guide.command)
        guide.step(wrench)
        pushes.append(-wrench[1])
        if guide.over:
            break
    return guide, np.array(pushes)


@pytest.mark.parametrize("snap", [2.0, 3.0, 5.0])
def test_a_card_is_seated_once_the_force_has_fallen_and_the_bottom_bears_it(snap):
    guide, pushes = seat(Connector(snap))
    assert guide.phase is Phase.DONE
    assert guide.snap_force == pytest.approx(snap, rel=0.1)
    assert 0.6 + BOTTOM.bottom_force < pushes[-1] < 0.6 + BOTTOM.bottom_force + 0.5


def test_a_force_that_rises_without_a_snap_draws_the_card_back():
    guide, pushes = seat(Connector(snap=99.0))
    assert guide.phase is Phase.FAILED and guide.reason == "force"
    assert guide.tries == CONFIG.retries + 1 and math.isnan(guide.snap_force)
    assert pushes.max() < BOTTOM.push + 1.0


def test_a_card_that_stands_on_one_corner_turns_until_it_is_square():
    guide = SeatingGuide(CONFIG, START, BOTTOM)
    connector = Connector(aside=0.03)
    for _ in range(3000):
        guide.step(connector.wrench(guide.command))
        connector.aside = 0.03 * max(0.0, 1.0 + guide.command[2] / 0.02)  # It turns off by 0.02.
        if guide.over:
            break
    assert guide.phase is Phase.DONE
    assert guide.command[2] < -0.01 and connector.aside < 1.5 * BOTTOM.square


def test_a_card_that_was_drawn_out_of_the_connector_has_to_snap_in_anew():
    # Its moment is within the deadband of what turns it, and too far off for a square card.
    strict = dataclasses.replace(BOTTOM, square=0.002)
    guide, connector = SeatingGuide(CONFIG, START, strict), Connector(snap=5.0, aside=0.004)
    reasons, pushes = set(), []
    while not guide.over:
        wrench = connector.wrench(guide.command)
        guide.step(wrench)
        pushes.append(-wrench[1])
        reasons.add(guide.reason)
        connector.aside *= guide.tries == 0  # It stands square when it comes again.
    assert guide.tries == 1 and "jam" in reasons and guide.phase is Phase.DONE
    # Until then it is pushed no harder than the bottom has to show itself.
    assert max(pushes) < 0.6 + 1.6 * strict.bottom_force
    assert connector.inside and guide.snap_force == pytest.approx(5.0, rel=0.1)


def test_a_moment_that_was_there_before_the_bottom_turns_no_card():
    guide, _ = seat(Connector(drift=0.1))
    assert guide.phase is Phase.DONE and abs(guide.command[2]) < 2e-3


@pytest.mark.parametrize(("push", "turns"), [(0.0, False), (2.0, True)])
def test_a_moment_that_no_force_explains_is_the_sensor_s_and_turns_no_card(push, turns):
    guide = SeatingGuide(CONFIG, np.array([0.0, 0.02, 0.0]), BOTTOM)
    for _ in range(50):
        guide.step(np.array([0.0, -push, 0.0, 0.0, 0.0, 0.1]))
    assert (abs(guide.command[2]) > 1e-3) == turns and (turns or guide.command[2] == 0.0)


def test_the_command_gives_way_along_the_normal_beyond_the_deadband_and_no_farther_than_its_reach():
    guide = SeatingGuide(CONFIG, np.array([0.0, -0.01, 0.0]), BOTTOM)
    for _ in range(50):
        guide.step(np.array([0.0, 0.0, 0.9 * BOTTOM.deadband, 0.0, 0.0, 0.0]))
    assert guide.beside == 0.0
    for _ in range(50):
        guide.step(np.array([0.0, 0.0, -1.2, 0.0, 0.0, 0.0]))
    assert guide.beside == pytest.approx(-0.5 * BOTTOM.give, rel=0.1)
    for _ in range(400):
        guide.step(np.array([0.0, 0.0, -3.0, 0.0, 0.0, 0.0]))
    assert (guide.phase, guide.reason) == (Phase.FAILED, "out of reach")


def test_a_tare_is_taken_of_all_six():
    config = GuideConfig(0.10795, 0.3, 1981.25, tare=0.2)
    guide = SeatingGuide(config, START, BOTTOM)
    zero = np.array([0.5, -0.5, 0.8, 0.0, 0.0, 0.01])
    for _ in range(60):
        guide.step(zero)
    assert guide.beside == 0.0 and guide.command[0] == 0.0
    assert guide.command[1] > START[1]


@pytest.mark.parametrize(("stop", "phase"), [(0.04, Phase.DONE), (0.034, Phase.FAILED)])
def test_straight_ahead_a_card_counts_as_seated_that_is_commanded_to_the_bottom(stop, phase):
    guide, connector = StraightSeating(CONFIG, START, BOTTOM, beside=1e-3), Connector(bottom=stop)
    while not guide.over:
        wrench = connector.wrench(guide.command)
        guide.step(wrench)
    assert guide.phase is phase and guide.beside == 1e-3
    assert -wrench[1] == pytest.approx(BOTTOM.push, abs=0.3)
    assert guide.command[0] == guide.command[2] == 0.0


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="snap"):
        dataclasses.replace(BOTTOM, snap=-1.0)
