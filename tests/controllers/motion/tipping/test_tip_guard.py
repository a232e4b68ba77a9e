"""The guard of moves and drives, held against MuJoCo across a slope."""

import math

import numpy as np
import pytest

from controllers.motion.tipping.look_ahead import TIPPED, Plan
from controllers.motion.tipping.tip_guard import TipGuard
from controllers.motion.tipping.tip_over import GuardConfig, Sweep, guard
from tests.controllers.motion.seen import seen_at
from tests.controllers.motion.tipping.test_look_ahead import HOME, loaded, mujocos, sideways
from twin.describe import describe_rover

DOWN, UP = np.array([-1.5, 0.3, -0.4, 0.0]), np.array([1.5, 0.3, -0.4, 0.0])
"""The arm aside, over the lower and over the upper wheels."""


def tips_in_mujoco(load: float, posture: np.ndarray, slope: float) -> bool:
    plan = Plan.of_arm(Sweep(HOME, posture, 1.5).at, 3.0)
    return bool(np.abs(mujocos(loaded(load), load, plan, (-slope, 0.0))[:, :2]).max() > TIPPED)


@pytest.mark.parametrize(("posture", "over"), [(DOWN, True), (UP, False)])
def test_a_move_is_refused_that_tips_the_rover_though_its_zero_moment_point_is_inside(
    posture, over
):
    load, slope, sweep = 0.2, math.radians(20.0), Sweep(HOME, posture, 1.5)
    assert tips_in_mujoco(load, posture, slope) == over
    tip_guard, still = TipGuard(loaded(load)), sideways(slope)
    by_point = guard(tip_guard.footing, sweep, still)
    assert by_point.sweep is sweep and by_point.margin > GuardConfig().reserve + 0.015
    found = tip_guard.allowed(sweep, still)
    assert (found.sweep is None) == over
    assert found.report.startswith("tips over with") == over
    assert over or found.sweep is sweep


def test_what_the_zero_moment_point_refuses_is_not_asked_for_again():
    still = sideways(math.radians(60.0))
    sweep = Sweep(HOME, DOWN, 1.5)
    found = TipGuard(loaded(0.2)).allowed(sweep, still)
    assert found.sweep is None and "edge of tipping" in found.report


@pytest.mark.parametrize(("posture", "over"), [(DOWN, True), (UP, False)])
def test_a_drive_is_warned_of_that_holds_a_load_over_the_lower_wheels(posture, over):
    load, slope = 0.5, math.radians(15.0)
    assert tips_in_mujoco(load, posture, slope) == over
    seen = seen_at(0.0, arm_angles=posture)
    tilt = seen.inclinometer._replace(value=np.array([0.0, slope]))
    found = TipGuard(loaded(load)).warning(seen._replace(inclinometer=tilt), np.full(4, 2.0))
    assert found.startswith("tips over within 2 s with ") == over
    assert bool(found) == over


def test_two_looks_at_one_motion_say_the_same():
    tip_guard, sweep = TipGuard(loaded(0.2)), Sweep(HOME, DOWN, 1.5)
    still = sideways(math.radians(17.0))
    reports = {tip_guard.allowed(sweep, still).report for _ in range(3)}
    assert len(reports) == 1 and "%" in reports.pop()


def test_a_rover_without_an_arm_has_no_guard():
    with pytest.raises(ValueError, match="arm"):
        TipGuard(describe_rover("rover1", arm=False))
