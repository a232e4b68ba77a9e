"""A rover goes to a pose: held against the pose that an independent integration arrives at."""

import math

import numpy as np
import pytest

from controllers.motion.drive_to_pose import DriveToPose, DriveToPoseConfig
from controllers.motion.driving import SkidSteer
from tests.controllers.motion.seen import seen_at

RADIUS, HALF_TRACK, SHARE = 0.065, 0.16, 0.6
STEER = SkidSteer(RADIUS, HALF_TRACK, SHARE)
PERIOD = DriveToPoseConfig().period


def drive(
    driver: DriveToPose,
    share: float,
    longest: float = 90.0,
    lame: tuple[float, float] = (1.0, 1.0),
    motions: list[tuple[float, float]] | None = None,
) -> np.ndarray:
    """Return (3,) where a rover ends that follows at once and turns by a share of rolling.

    Args:
        driver: Controller of the rover.
        share: Turn rate over that of rolling wheels.
        longest: Time after which it has failed [s].
        lame: Shares of the commanded speed that the left and the right wheels reach.
        motions: Gets the commanded speed [m/s] and rate of turn [rad/s] of each tick.
    """
    x = y = yaw = 0.0
    speeds = np.zeros(4)
    for tick in range(round(longest / PERIOD)):
        command = driver.step(seen_at(tick * PERIOD, wheel_speeds=speeds))
        if motions is not None:
            motions.append(STEER.motion(np.asarray(command.wheels, dtype=float)))
        speeds = np.asarray(command.wheels, dtype=float) * [*lame, *lame]
        left, right = RADIUS * speeds[0], RADIUS * speeds[1]
        yaw += share * (right - left) / (2.0 * HALF_TRACK) * PERIOD
        x -= 0.5 * (left + right) * math.sin(yaw) * PERIOD
        y += 0.5 * (left + right) * math.cos(yaw) * PERIOD
        if driver.done:
            return np.array([x, y, yaw])
    raise AssertionError("it never arrived")


@pytest.mark.parametrize(
    "goal",
    [
        (0.0, 0.5, 0.0),
        (0.4, 0.3, 1.0),
        (-0.5, -0.2, -2.0),
        (0.1, -0.6, 0.3),
        (0.0, 0.0, 0.7),
        (0.3, 0.0, 0.0),
        (0.09, 0.0, 0.14),
        (-0.1, 0.03, -0.1),
        (0.05, -0.04, 0.0),
    ],
)
def test_a_rover_with_the_right_slip_model_reaches_its_goal(
    goal: tuple[float, float, float],
) -> None:
    ended = drive(DriveToPose(STEER, goal), SHARE)
    np.testing.assert_allclose(ended[:2], goal[:2], atol=0.01)
    assert math.remainder(ended[2] - goal[2], 2.0 * math.pi) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("goal", [(0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.3, 0.8, 0.0)])
@pytest.mark.parametrize("lame", [(0.9, 1.0), (1.0, 0.9)])
def test_the_course_is_corrected_where_one_side_is_slower_than_asked(goal, lame) -> None:
    driver = DriveToPose(STEER, goal)
    ended = drive(driver, SHARE, lame=lame)
    np.testing.assert_allclose(ended[:2], goal[:2], atol=0.02)
    assert math.remainder(ended[2], 2.0 * math.pi) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("goal", [(0.0, 0.6, 0.0), (0.0, -0.6, 0.0), (0.4, 0.4, -2.0)])
def test_speed_and_turn_keep_their_limits_and_slow_down_before_the_end(goal) -> None:
    config = DriveToPoseConfig()
    motions: list[tuple[float, float]] = []
    drive(DriveToPose(STEER, goal), SHARE, motions=motions)
    forward, turn = np.abs(np.array(motions)).T
    assert forward.max() == pytest.approx(config.speed)
    assert turn.max() <= config.turn + 1e-9
    if goal[2]:
        assert turn.max() == pytest.approx(config.turn)
    # What is not nothing is enough to turn at all.
    assert turn[turn > 1e-9].min(initial=1.0) >= 0.05 - 1e-9
    moving = forward[forward > 1e-9]
    assert moving[-1] <= 2.0 * config.slowing * config.near[0]
    assert np.all(np.diff(moving[-50:]) < 1e-9)


def test_a_turn_slows_down_with_what_is_left_of_it() -> None:
    config = DriveToPoseConfig()
    motions: list[tuple[float, float]] = []
    drive(DriveToPose(STEER, (0.0, 0.0, -0.7)), SHARE, motions=motions)
    turn = np.array(motions)[:, 1]
    assert np.all(turn <= 1e-9) and turn.min() == pytest.approx(-config.turn)
    # Half of the largest rate is for a tenth of a radian.
    slow = np.flatnonzero(turn > -0.5 * config.turn)[0]
    left = -0.7 - np.cumsum(turn)[slow] * PERIOD
    assert left == pytest.approx(-0.5 * config.turn / config.slowing, abs=0.01)


def test_goals_behind_are_reached_backwards() -> None:
    driver = DriveToPose(STEER, (0.0, -0.4, 0.0))
    first = driver.step(seen_at(0.0)).wheels
    assert np.all(np.asarray(first) < 0.0)


def test_a_step_aside_is_made_by_backing_off_and_not_by_turning_on_the_spot() -> None:
    goal = (0.09, 0.0, 0.14)
    turned = {}
    for free in (True, False):
        driver = DriveToPose(STEER, goal, free=lambda pose, free=free: free)
        ended = drive(driver, SHARE)
        np.testing.assert_allclose(ended, goal, atol=0.015)
        turned[free] = driver.odometry.turned
    assert turned[False] > math.radians(160.0)
    assert turned[True] < math.radians(80.0)


def test_it_backs_off_along_its_goal_heading() -> None:
    asked: list[np.ndarray] = []
    DriveToPose(STEER, (0.09, 0.0, 0.14), free=lambda pose: (asked.append(pose), True)[1])
    (behind,) = asked
    ahead = [-math.sin(0.14), math.cos(0.14)]
    np.testing.assert_allclose(
        behind[:2] + DriveToPoseConfig().back_off * np.array(ahead), [0.09, 0.0], atol=1e-12
    )
    assert behind[2] == pytest.approx(0.14)


@pytest.mark.parametrize("goal", [(0.0, 0.5, 0.0), (0.4, 0.3, 1.0), (0.0, 0.0, 0.7)])
def test_where_backing_off_saves_no_turns_the_drive_is_straight(goal) -> None:
    asked: list[np.ndarray] = []
    DriveToPose(STEER, goal, free=lambda pose: (asked.append(pose), True)[1])
    assert not asked


def _turned(goal: np.ndarray) -> float:
    """Return the turns [rad] before and after a drive to (3,), from angles between headings."""
    heading = np.array([-math.sin(goal[2]), math.cos(goal[2])])
    path = goal[:2] / np.linalg.norm(goal[:2])
    if path[1] < 0.0:  # The rover faces y; it drives backwards to what is behind it.
        path = -path
    return math.acos(path[1]) + math.acos(np.clip(path @ heading, -1.0, 1.0))


def test_it_backs_off_exactly_where_that_halves_the_turns() -> None:
    goals = np.random.default_rng(4).uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0], (200, 3))
    backed = []
    for goal in goals:
        asked: list[np.ndarray] = []
        DriveToPose(STEER, goal, free=lambda pose, asked=asked: (asked.append(pose), True)[1])
        heading = np.array([-math.sin(goal[2]), math.cos(goal[2]), 0.0])
        behind = goal - DriveToPoseConfig().back_off * heading
        backed.append(bool(asked))
        assert backed[-1] == (_turned(behind) < 0.5 * _turned(goal))
    assert 10 < sum(backed) < 190


@pytest.mark.parametrize("degrees", [60.0, -60.0, 120.0, -120.0])
def test_a_goal_within_a_quarter_turn_is_reached_forwards_and_others_backwards(degrees) -> None:
    course = math.radians(degrees)
    goal = [-0.5 * math.sin(course), 0.5 * math.cos(course), 0.0]
    motions: list[tuple[float, float]] = []
    driver = DriveToPose(STEER, goal, free=lambda pose: False)
    np.testing.assert_allclose(drive(driver, SHARE, motions=motions)[:2], goal[:2], atol=0.01)
    driven = np.array(motions)[:, 0].sum() * PERIOD
    assert driven == pytest.approx(0.5 if abs(degrees) < 90.0 else -0.5, abs=0.02)
    # To the course and back by 60 degrees each; the other direction would take 120 degrees each.
    assert math.radians(115.0) < driver.odometry.turned < math.radians(180.0)


def test_a_rover_that_neglects_wheel_slip_misses_its_goal() -> None:
    ended = drive(DriveToPose(SkidSteer(RADIUS, HALF_TRACK, 1.0), (0.4, 0.3, 0.0)), SHARE)
    assert math.dist(ended[:2], (0.4, 0.3)) > 0.05


def test_nothing_moves_before_the_arm_is_known() -> None:
    command = DriveToPose(STEER, (0.0, 0.5, 0.0)).step(seen_at(0.0, arm_angles=None))
    assert np.all(np.asarray(command.wheels) == 0.0)


def test_a_goal_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="three finite numbers"):
        DriveToPose(STEER, (0.0, math.nan, 0.0))
