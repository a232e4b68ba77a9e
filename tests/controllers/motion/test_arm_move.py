"""An arm on its way to a look: straight, in time, and a pair counts only from rest."""

import numpy as np
import pytest

from controllers.motion.arm_move import ArmMove
from tests.controllers.motion.seen import PAIR, seen_at
from twin.robot import ArmMode, WheelMode

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
