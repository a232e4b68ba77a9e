"""An arm on its way to a look: straight, in time, and a pair counts only from rest."""

import numpy as np
import pytest

from controllers.motion.arm_move import ArmMove
from controllers.motion.base_motion import level_of
from controllers.motion.tipping.tip_guard import TipGuard
from tests.controllers.motion.seen import PAIR, seen_at
from twin.describe import describe_rover
from twin.robot import ArmMode, Observation, WheelMode

GOAL = np.array([0.4, 0.8, -1.0, 0.0])


def test_all_joints_arrive_at_once_at_the_speed_of_the_fastest() -> None:
    move = ArmMove(GOAL, speed=0.5)
    move.command(seen_at(1.0, arm_angles=np.zeros(4)))
    half = move.command(seen_at(2.0, arm_angles=np.zeros(4)))
    np.testing.assert_allclose(half.arm, GOAL / 2.0)
    np.testing.assert_allclose(half.arm_rates, GOAL / 2.0)
    whole = move.command(seen_at(3.0, arm_angles=GOAL))
    np.testing.assert_allclose(whole.arm, GOAL)
    assert np.all(np.asarray(whole.arm_rates) == 0.0)


def test_a_pair_counts_only_from_rest_at_the_goal() -> None:
    move = ArmMove(GOAL, speed=1.0, rest=0.6)
    move.command(seen_at(0.0, arm_angles=np.zeros(4)))
    assert not move.is_there(seen_at(0.5, arm_angles=GOAL / 2.0))
    assert not move.is_there(seen_at(1.0, arm_angles=GOAL))
    assert move.is_there(seen_at(1.6, arm_angles=GOAL))
    before = seen_at(1.7, arm_angles=GOAL, stereo=PAIR, stereo_stamp=1.5)
    after = seen_at(1.7, arm_angles=GOAL, stereo=PAIR, stereo_stamp=1.65)
    assert not move.sees(before)
    assert move.sees(after)


def test_an_arm_that_does_not_reach_its_goal_is_awaited_only_for_the_time_limit() -> None:
    move = ArmMove(GOAL, speed=1.0, rest=0.5, patience=2.0)
    move.command(seen_at(0.0, arm_angles=np.zeros(4)))
    assert not move.is_there(seen_at(2.5, arm_angles=0.8 * GOAL))
    assert not move.is_there(seen_at(3.0, arm_angles=0.8 * GOAL))
    assert move.is_there(seen_at(3.5, arm_angles=0.8 * GOAL))


def test_nothing_moves_before_the_arm_is_known() -> None:
    command = ArmMove(GOAL).command(seen_at(0.0, arm_angles=None))
    assert command.arm_mode is ArmMode.DUTY
    assert np.all(np.asarray(command.arm) == 0.0)


@pytest.mark.parametrize("mode", [WheelMode.SPEED, WheelMode.DUTY])
def test_wheels_are_held_in_the_requested_mode(mode: WheelMode) -> None:
    command = ArmMove(GOAL, wheel_mode=mode).command(seen_at(0.0, arm_angles=np.zeros(4)))
    assert command.wheel_mode is mode
    assert np.all(command.wheels == 0.0)


GUARD = TipGuard(describe_rover("rover2", card=True, mast=0.065))
ROVER = GUARD.footing
FOLDED = np.array([0.0, 1.6, -0.2, -1.85])
AHEAD = np.array([0.0, 1.2, -0.9, -1.0])


def tilted(degrees: float, angles: np.ndarray, time: float = 0.0) -> Observation:
    """Return what a rover measures that is pitched down by some degrees."""
    seen = seen_at(time, arm_angles=angles)
    down = np.array([-np.radians(degrees), 0.0])
    return seen._replace(inclinometer=seen.inclinometer._replace(value=down))


def played(move: ArmMove, degrees: float) -> tuple[float, float, np.ndarray]:
    """Return duration [s], least margin of the zero-moment point [m], and end of a move.

    The joints gain and lose their speed within 0.1 s.
    """
    rates, places, time = [np.zeros(4)], [FOLDED], 0.0
    while time < 0.2 or rates[-1].any():
        command = move.command(tilted(degrees, places[-1], time))
        rates.append(np.array(command.arm_rates))
        places.append(np.array(command.arm))
        time += 0.01
    padded = np.vstack([np.zeros((10, 4)), rates, np.zeros((10, 4))])
    smooth = np.array([padded[i : i + 10].mean(axis=0) for i in range(len(rates) + 10)])
    bends = np.diff(smooth, axis=0)[: len(rates)] / 0.01
    still = level_of(tilted(degrees, FOLDED))
    points = [
        ROVER.zero_moment_point(place, rate, bend, still)
        for place, rate, bend in zip(places, smooth, bends, strict=False)
    ]
    return time, min(ROVER.margin(point) for point in points), places[-1]


def test_a_move_that_would_tip_a_rover_on_a_steep_slope_is_slowed_and_not_without_the_guard():
    free, free_margin, _ = played(ArmMove(AHEAD), 34.0)
    slowed, margin, end = played(ArmMove(AHEAD, guard=GUARD), 34.0)
    assert free_margin < 0.029 < margin
    assert slowed > 1.2 * free
    np.testing.assert_allclose(end, AHEAD, atol=1e-9)


def test_no_move_is_slowed_on_the_slopes_of_the_field():
    assert played(ArmMove(AHEAD, guard=GUARD), 10.0)[:2] == played(ArmMove(AHEAD), 10.0)[:2]


def test_an_arm_that_could_not_rest_at_its_goal_goes_less_far_or_stays_and_is_not_awaited():
    _, _, end = played(ArmMove(AHEAD, guard=GUARD), 37.0)
    share = (end - FOLDED)[1:] / (AHEAD - FOLDED)[1:]
    np.testing.assert_allclose(share, share[0])
    assert 0.05 < share[0] < 0.95
    stays = ArmMove(AHEAD, guard=GUARD)
    _, _, end = played(stays, 45.0)
    np.testing.assert_array_equal(end, FOLDED)
    assert not stays.is_there(tilted(45.0, FOLDED, 2.0))
    stays.is_there(tilted(45.0, FOLDED, 6.0))
    assert stays.is_there(tilted(45.0, FOLDED, 7.0))
