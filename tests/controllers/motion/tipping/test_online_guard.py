"""What the online guard lets pass: against statics in closed form and the dynamics themselves."""

import dataclasses

import numpy as np
import pytest

from controllers.kinematics.rigid_motion import LEVEL, at_rest
from controllers.motion.tipping.online_guard import OnlineConfig, OnlineGuard
from controllers.motion.tipping.tip_over import Sweep
from perception.geometry.gravity import GRAVITY
from tests.controllers.motion.test_control_and_tip_over import SQUARE, footing

TICK = OnlineConfig.period
RESERVE = OnlineConfig.reserve


def sweep(start, end, duration):
    return Sweep(np.array([start]), np.array([end]), duration)


def passed(guard, ticks, still=LEVEL):
    """Return (n, 3) angle, rate and acceleration by tick, in its middle."""
    rows = []
    for tick in range(ticks):
        guard.step(still)
        rows.append(np.concatenate(guard.at((tick + 0.5) * TICK)))
    return np.array(rows)


def margins(rover, rows, still=LEVEL):
    return np.array(
        [
            rover.margin(rover.zero_moment_point(angle, rate, growth, still))
            for angle, rate, growth in rows[:, :, None]
        ]
    )


def static_limit(load, floor, slope=0.0):
    """Angle of the rod at which the whole's centre is above the floor's distance from the edge.

    The ground falls forward by `slope`; base 3 kg at the origin, 0.1 m above it.
    """
    angles = np.linspace(1.4, 0.0, 100001)
    y, z = 0.5 * np.cos(angles) * load, (0.1 + 0.5 * np.sin(angles)) * load
    forward = (y + (z + 0.3) * np.tan(slope)) / (3.0 + load)
    return angles[np.argmax(forward > 0.2 - floor)]


def test_harmless_motion_passes_as_it_is():
    asked = sweep(1.2, 1.0, 1.0)
    guard = OnlineGuard(footing(0.5), asked.at)
    rows = passed(guard, 120)
    wanted = [np.concatenate(asked.at((tick + 0.5) * TICK)) for tick in range(120)]
    np.testing.assert_allclose(rows, wanted, atol=1e-9)
    assert guard.report == "" and guard.late == pytest.approx(0.0, abs=1e-9)


def test_motion_that_would_tip_is_slowed_only_as_long_as_it_must_and_ends_where_asked():
    rover, asked = footing(1.4), sweep(1.4, 0.8, 0.45)
    tipping = min(
        margins(rover, np.array([[*asked.at(t)] for t in np.linspace(0, 0.45, 61)])[..., 0])
    )
    assert tipping < 0.0
    guard = OnlineGuard(rover, asked.at)
    rows = passed(guard, 80)
    assert margins(rover, rows).min() > RESERVE
    assert rows[-1, 0] == pytest.approx(0.8) and guard.rate == 1.0
    assert 0.1 < guard.late < 0.5
    assert guard.report.startswith("slowed to") and guard.lost == 0


def test_without_the_base_springs_the_reserve_itself_is_kept():
    rover = footing(1.4)
    guard = OnlineGuard(rover, sweep(1.4, 0.8, 0.45).at, OnlineConfig(swing=1.0))
    least = margins(rover, passed(guard, 80)).min()
    assert RESERVE - 2e-3 < least < RESERVE + 2e-3  # all that there is, and no more


def test_arm_is_not_dropped_so_fast_that_the_wheels_lose_the_ground():
    wide = dataclasses.replace(footing(3.0), polygon=20.0 * SQUARE)  # it cannot tip
    asked = sweep(0.5, -0.5, 0.4)
    weight = 6.0 * GRAVITY

    def presses(rows):
        return min(wide.wrench(*row[:, None])[2] for row in rows)

    whole = np.array([np.concatenate(asked.at(time)) for time in np.linspace(0.0, 0.4, 41)])
    assert presses(whole) < 0.2 * weight
    guard = OnlineGuard(wide, asked.at, OnlineConfig(swing=1.0))
    assert presses(passed(guard, 100)) > (OnlineConfig.least_weight - 0.02) * weight
    assert guard.report


@pytest.mark.parametrize("slope", [0.0, 0.05])
def test_motion_is_held_where_the_robot_would_tip_over_at_rest(slope):
    rover = footing(3.0)
    still = at_rest([0.0, -np.sin(slope), np.cos(slope)])
    guard = OnlineGuard(rover, sweep(1.4, 0.0, 1.0).at)
    rows = passed(guard, 320, still)
    limit = static_limit(3.0, 1.1 * RESERVE, slope)
    assert limit <= rows[-1, 0] < limit + 0.03
    np.testing.assert_array_equal(rows[-1, 1:], 0.0)
    assert margins(rover, rows, still).min() > 0.5 * RESERVE
    assert guard.held > 1.0 and "held at" in guard.report


def test_reference_within_a_tick_is_its_own_derivative_and_runs_on_to_the_next():
    guard = OnlineGuard(footing(0.8), sweep(1.4, 0.8, 0.3).at)
    step, end = 1e-5, guard.at(0.0)
    for tick in range(60):
        guard.step(LEVEL)
        begin, middle = tick * TICK, (tick + 0.5) * TICK
        np.testing.assert_allclose(guard.at(begin)[0], end[0], atol=1e-12)
        np.testing.assert_allclose(guard.at(begin)[1], end[1], atol=1e-9)
        before, after = guard.at(middle - step), guard.at(middle + step)
        for order in (0, 1):
            slope = (after[order] - before[order]) / (2.0 * step)
            np.testing.assert_allclose(slope, guard.at(middle)[order + 1], rtol=1e-3, atol=1e-3)
        end = guard.at(begin + TICK)


def test_ground_that_begins_to_tilt_during_the_motion_stops_it_sooner():
    rover, slope = footing(3.0), 0.05
    guard = OnlineGuard(rover, sweep(1.4, 0.0, 1.5).at)
    passed(guard, 40)
    for _ in range(40, 320):
        guard.step(at_rest([0.0, -np.sin(slope), np.cos(slope)]))
    angle = guard.at(320 * TICK)[0][0]
    limit = static_limit(3.0, 1.1 * RESERVE, slope)
    assert limit <= angle < limit + 0.03


@pytest.mark.parametrize("missing", [None, at_rest([np.nan, 0.0, 1.0])])
def test_without_a_tilt_measurement_the_motion_stops_and_resumes_with_it(missing):
    guard = OnlineGuard(footing(0.5), sweep(1.2, 1.0, 1.0).at)
    guard.step(missing)
    assert guard.rate == 0.0 and guard.at(0.005)[1] == 0.0
    for _ in range(60):
        guard.step(LEVEL)
    assert guard.rate == 1.0
    for _ in range(30):
        guard.step(missing)
    assert guard.rate == 0.0 and 0.0 < guard.time < 1.0
    for _ in range(150):
        guard.step(LEVEL)
    assert guard.time > 1.0


def test_arm_with_less_than_the_reserve_may_be_drawn_in_but_not_out():
    load, rover = 3.0, footing(3.0)
    start = static_limit(load, 0.5 * RESERVE)
    inward = OnlineGuard(rover, sweep(start, 1.4, 1.0).at)
    rows = passed(inward, 300)
    assert rows[-1, 0] == pytest.approx(1.4)
    assert margins(rover, rows).min() > 0.0
    outward = OnlineGuard(rover, sweep(start, 0.0, 1.0).at)
    assert passed(outward, 100)[-1, 0] > start - 0.02


def test_numbers_that_could_not_be_meant_are_refused():
    with pytest.raises(ValueError, match="brake = 0"):
        OnlineConfig(brake=0.0)
