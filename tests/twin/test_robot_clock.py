"""Clocks of robots: what they read, and whom they change."""

import dataclasses

import numpy as np
import pytest

from models.compose import FLAT, RobotPlacement
from models.datasheets import CLOCK, HARSH_CLOCK
from twin.camera import StereoConfig
from twin.connect import connect
from twin.realism import REALISMS, Realism
from twin.robot import Validity

PLAIN = dataclasses.replace(FLAT, texture_pixels=16)
PLACES = tuple(RobotPlacement(name, (x, 0.0)) for name, x in (("rover1", -0.6), ("rover2", 0.6)))
HARSH = Realism(clock=HARSH_CLOCK)


def times_of(realism, target="sim", places=PLACES, ticks=100):
    """Return the world's times (ticks,), and the observations of each robot at them."""
    stereo = StereoConfig(4.0)
    with connect(
        target, robots=places, field=PLAIN, realism=realism, seed=3, stereo=stereo
    ) as link:
        world, seen = [], {name: [] for name in link.robots}
        for robot in link.robots.values():
            robot.activate()
        for _ in range(ticks):
            world.append(link.clock.time)
            for name, robot in link.robots.items():
                seen[name].append(robot.observe())
            link.clock.tick()
    return np.array(world), seen


@pytest.mark.parametrize("target", ["sim", "quantised"])
def test_robots_clock_is_ahead_by_its_offset_and_gains_by_its_drift(target):
    world, seen = times_of(HARSH, target)
    lines = [np.polyfit(world, [each.time for each in robot], 1) for robot in seen.values()]
    for (slope, offset), robot in zip(lines, seen.values(), strict=True):
        assert 0.0 < offset < HARSH_CLOCK.offset and abs(slope - 1.0) < HARSH_CLOCK.drift
        np.testing.assert_allclose([s.time for s in robot], offset + slope * world, atol=1e-9)
    assert abs(lines[0][0] - lines[1][0]) > 1e-6 and abs(lines[0][1] - lines[1][1]) > 1e-3


def test_clock_changes_times_and_nothing_else():
    world, ideal = times_of("ideal")
    _, clocked = times_of(HARSH)
    for robot, plain in clocked.items():
        slope, offset = np.polyfit(world, [each.time for each in plain], 1)
        for one, two in zip(plain, ideal[robot], strict=True):
            for channel, other in zip(one[1:], two[1:], strict=True):
                assert channel.validity is other.validity
                if channel.validity is Validity.MISSING:
                    assert np.isnan(channel.stamp)
                    continue
                assert channel.stamp == pytest.approx(offset + slope * other.stamp, abs=1e-9)
    last, other = clocked["rover1"][-1], ideal["rover1"][-1]
    for channel, same in zip(last[1:-1], other[1:-1], strict=True):
        np.testing.assert_array_equal(channel.value, same.value)


def test_further_robot_changes_no_clock_and_the_seed_changes_all():
    def first(realism, places=PLACES):
        return times_of(realism, places=places, ticks=1)[1]["rover1"][0].time

    assert first(HARSH) == first(HARSH, PLACES[:1]) != first(Realism(clock=CLOCK))
    assert 0.0 < first("default") < CLOCK.offset and first("ideal") == 0.0
    assert REALISMS["default"].clock == CLOCK and REALISMS["harsh"].clock == HARSH_CLOCK
