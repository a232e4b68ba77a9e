"""The last way of a rover to a pose, held against finite differences of its curve."""

import math

import numpy as np
import pytest

from controllers.motion.docking import Leg, curve_to, docking

HERE = (0.4, -0.2, 0.7)


def of(pose, aside, ahead, turn):
    """Return a pose given to the right and ahead of another one, and turned to the left."""
    x, y, yaw = pose
    right, on = (math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))
    return (
        x + aside * right[0] + ahead * on[0],
        y + aside * right[1] + ahead * on[1],
        yaw + turn,
    )


def course(leg: Leg, end: int) -> float:
    """Return the heading of a rover at the first (0) or last (-1) step of a part."""
    step = np.diff(leg.path, axis=0)[end]
    return math.atan2(-step[0], step[1]) + (math.pi if leg.backwards else 0.0)


@pytest.mark.parametrize("goal", [(0.1, 0.6, 0.2), (-0.05, 0.4, -0.3), (0.1, -0.5, 0.1)])
def test_the_curve_begins_and_ends_in_both_poses(goal):
    end = of(HERE, *goal)
    leg = curve_to(HERE, end)
    np.testing.assert_allclose(leg.path[[0, -1]], [HERE[:2], end[:2]], atol=1e-12)
    assert leg.backwards == (goal[1] < 0.0) and leg.heading == end[2]
    for index, yaw in ((0, HERE[2]), (-1, end[2])):
        assert math.remainder(course(leg, index) - yaw, math.tau) == pytest.approx(0.0, abs=0.05)


def test_a_rover_in_line_drives_straight_there():
    for ahead in (0.3, -0.3):
        (leg,) = docking(HERE, of(HERE, 0.0, ahead, 0.0), lambda leg: True)
        assert leg.backwards == (ahead < 0.0)
        off = leg.path - np.array(HERE[:2])
        assert np.abs(off @ [math.cos(HERE[2]), math.sin(HERE[2])]).max() < 1e-12


@pytest.mark.parametrize("aside", [-0.15, 0.15])
def test_a_rover_beside_its_place_backs_off_and_comes_back_along_a_gentle_curve(aside):
    legs = docking(HERE, of(HERE, aside, 0.1, 0.0), lambda leg: True)
    assert len(legs) == 2 and legs[0].backwards != legs[1].backwards
    np.testing.assert_allclose(legs[1].path[0], legs[0].path[-1])
    steps = np.diff(legs[1].path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    turns = np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0])))
    assert np.abs(turns / lengths[1:]).max() < 4.5
    # A quarter turn to the side and one back are pi.
    assert np.abs(turns).sum() < 1.0


def test_what_is_not_free_is_not_driven():
    goal = of(HERE, 0.15, 0.1, 0.0)

    def ahead_alone(leg: Leg) -> bool:
        return not leg.backwards

    def back_first(leg: Leg) -> bool:
        return leg.backwards or len(leg.path) > 2

    assert docking(HERE, goal, ahead_alone) == []
    legs = docking(HERE, goal, back_first)
    assert [leg.backwards for leg in legs] == [True, False]
    assert docking(HERE, goal, lambda leg: False) == []
