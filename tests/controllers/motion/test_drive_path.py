"""A rover follows a path: held against an independent integration, and in MuJoCo."""

import dataclasses
import math
import typing

import numpy as np
import pytest

from controllers.mapping.planar_paths import shortest_paths
from controllers.mission.belief import drawn_turn_share
from controllers.motion.arm_move import ArmMove
from controllers.motion.drive_path import DrivePath, DrivePathConfig
from controllers.motion.driving import SkidSteer
from experiments.ch5.insertion_identify import identify_slip
from models.compose import RobotPlacement
from tests.controllers.motion.seen import seen_at
from tests.models.scenes import make_scene
from twin.describe import describe_rover
from twin.robot import MISSING, ArmMode, Channel, Validity, WheelMode
from twin.simulation import Simulation

ROBOT = "rover1"
ROVER = describe_rover(ROBOT)
SHARE = 0.5
STEER = SkidSteer.of(ROVER, SHARE)
CONFIG = DrivePathConfig()
PERIOD = CONFIG.period
ZIGZAG = np.array([(0.0, 0.0), (0.5, 1.0), (0.0, 2.0), (0.3, 2.3), (-0.6, 2.8)])
SLOPE = 0.17
"""Slope of the ground."""
LAG = 0.08
"""Time constant with which the wheels follow [s]."""


@dataclasses.dataclass
class Drive:
    """What a rover did that keeps a share of its turns.

    Attributes:
        poses: (N, 3) x, y [m] and yaw [rad] after each tick.
        motions: (N, 2) commanded speed [m/s] and turning rate [rad/s].
    """

    poses: np.ndarray
    motions: np.ndarray

    def off(self, path: np.ndarray) -> np.ndarray:
        """Return (N,) the distance from a path at each tick [m]."""
        fine = [np.linspace(a, b, 400) for a, b in zip(path[:-1], path[1:])]
        points = np.concatenate(fine)
        return np.array([np.linalg.norm(points - pose[:2], axis=1).min() for pose in self.poses])


def drive(
    driver: DrivePath,
    share: float = SHARE,
    longest: float = 120.0,
    each_tick: typing.Callable[[int, np.ndarray], None] = lambda tick, pose: None,
    wheels_turn: typing.Callable[[int], bool] = lambda tick: True,
    tilt: typing.Callable[[int], tuple[float, float]] = lambda tick: (0.0, 0.0),
    ends: bool = True,
) -> Drive:
    """Drive until the end of the path.

    Args:
        driver: Controller of the rover.
        share: Turn rate over that of rolling wheels.
        longest: Time after which it has failed, or has been watched enough [s].
        each_tick: Gets tick and pose before each step.
        wheels_turn: Whether the wheels follow at a tick.
        tilt: Pitch and roll at a tick.
        ends: Whether it must end.
    """
    x = y = yaw = 0.0
    speeds, poses, motions = np.zeros(4), [], []
    for tick in range(round(longest / PERIOD)):
        each_tick(tick, np.array([x, y, yaw]))
        tilted = Channel(np.array(tilt(tick)), 0.0, Validity.MEASURED)
        seen = seen_at(tick * PERIOD, wheel_speeds=speeds)._replace(inclinometer=tilted)
        command = driver.step(seen)
        motions.append(STEER.motion(command.wheels))
        follows = command.wheels if wheels_turn(tick) else np.zeros(4)
        speeds = speeds + PERIOD / (PERIOD + LAG) * (follows - speeds)
        left, right = ROVER.wheel_radius * speeds[0], ROVER.wheel_radius * speeds[1]
        yaw += share * (right - left) / (2.0 * ROVER.half_track) * PERIOD
        x -= 0.5 * (left + right) * math.sin(yaw) * PERIOD
        y += 0.5 * (left + right) * math.cos(yaw) * PERIOD
        poses.append((x, y, yaw))
        if driver.done:
            break
    else:
        assert not ends, "it never arrived"
    return Drive(np.array(poses), np.array(motions))


def bent(degrees: float) -> np.ndarray:
    """Return a path that turns by an angle after a metre."""
    angle = math.radians(degrees)
    return np.array([(0.0, 0.0), (0.0, 1.0), (-math.sin(angle), 1.0 + math.cos(angle))])


@pytest.mark.parametrize("path", [ZIGZAG, *map(bent, (20, 35, -45, 49, 52, 90, 150))])
def test_it_follows_a_path_within_3_cm_and_ends_at_its_end(path) -> None:
    done = drive(DrivePath(STEER, path))
    assert done.off(path).max() < 0.03
    np.testing.assert_allclose(done.poses[-1, :2], path[-1], atol=0.01)
    last = path[-1] - path[-2]
    ahead = [-math.sin(done.poses[-1, 2]), math.cos(done.poses[-1, 2])]
    assert ahead @ last / np.linalg.norm(last) > math.cos(0.05)


@pytest.mark.parametrize("heading", [0.0, 2.0, -3.0])
def test_it_ends_in_the_heading_that_is_asked_for(heading) -> None:
    done = drive(DrivePath(STEER, ZIGZAG, heading))
    np.testing.assert_allclose(done.poses[-1, :2], ZIGZAG[-1], atol=0.01)
    assert math.remainder(done.poses[-1, 2] - heading, math.tau) == pytest.approx(0.0, abs=0.02)


def turn_on_a_slope(steer: SkidSteer, turn: float, downhill: float) -> float:
    """Return how far from its place a turn ends that slides by 0.2 m a radian [m].

    Args:
        steer: Wheels, as the drive knows them.
        turn: Angle of the turn [rad].
        downhill: Direction downhill, to the left of the heading at first [rad].
    """
    driver, slid, last = DrivePath(steer, [(0.0, 0.0)], turn), np.zeros(2), 0.0
    down = np.array([-math.sin(downhill), math.cos(downhill)])

    def slide(tick: int, pose: np.ndarray) -> None:
        nonlocal last
        slid[:] += 0.2 * abs(pose[2] - last) * down
        last = pose[2]
        if tick % 100 == 99:
            driver.correct(*(pose[:2] + slid), pose[2])

    def tilt(tick: int) -> tuple[float, float]:
        return -math.atan(SLOPE * math.cos(downhill - last)), -math.atan(
            SLOPE * math.sin(downhill - last)
        )

    done = drive(driver, each_tick=slide, tilt=tilt)
    return float(np.linalg.norm(done.poses[-1, :2] + slid))


@pytest.mark.parametrize("turn", [0.7, math.pi / 2.0, -math.pi / 2.0, 2.5])
def test_a_turn_on_a_slope_ends_nearer_to_its_place_if_it_is_known_how_far_it_slides(turn) -> None:
    """Though forward and back is all that the rover drives, much of the slide is made up for."""
    steer = dataclasses.replace(STEER, slide=0.2 * SHARE / SLOPE)
    directions = np.linspace(0.0, math.pi, 5)
    known, unknown = (
        np.mean([turn_on_a_slope(wheels, turn, downhill) for downhill in directions])
        for wheels in (steer, STEER)
    )
    assert known < 0.75 * unknown


@pytest.mark.parametrize("hold", [CONFIG.hold, 1e-9])
def test_a_rover_that_slides_as_it_turns_rolls_back_to_where_it_began(hold) -> None:
    """On a slope it slides 0.3 m for each radian; what is across its heading cannot be made up."""
    driver = DrivePath(STEER, [(0.0, 0.0)], math.pi / 2, dataclasses.replace(CONFIG, hold=hold))
    slid, last = np.zeros(2), 0.0
    places = []

    def slide(tick: int, pose: np.ndarray) -> None:
        nonlocal last
        slid[1] -= 0.3 * abs(pose[2] - last)
        last = pose[2]
        if tick % 50 == 49:
            driver.correct(*(pose[:2] + slid), pose[2])
        places.append(pose[:2] + slid)

    drive(driver, each_tick=slide)
    off, alone = float(np.linalg.norm(places[-1])), 0.3 * math.pi / 2.0
    assert off < 0.75 * alone if hold == CONFIG.hold else off == pytest.approx(alone, abs=0.01)


def test_a_rover_that_slides_along_its_path_while_it_turns_drives_on_from_there() -> None:
    """It has to turn to the right, and slides there by 0.4 m a radian: past its first corner."""
    driver, slid, last = DrivePath(STEER, [(0.0, 0.0), (1.5, 0.0)]), np.zeros(2), 0.0

    def slide(tick: int, pose: np.ndarray) -> None:
        nonlocal last
        slid[0] += 0.4 * abs(pose[2] - last)
        last = pose[2]
        if tick % 50 == 49:
            driver.correct(*(pose[:2] + slid), pose[2])

    done = drive(driver, each_tick=slide, longest=40.0)
    np.testing.assert_allclose(done.poses[-1, :2] + slid, [1.5, 0.0], atol=0.03)
    assert np.ptp(done.poses[:, 2]) < 0.8 * math.pi


@pytest.mark.parametrize("share", [0.9 * SHARE, 1.1 * SHARE])
def test_corrected_each_second_it_stays_within_10_cm_though_its_turns_err_by_a_tenth(share) -> None:
    driver = DrivePath(STEER, ZIGZAG)

    def correct(tick: int, pose: np.ndarray) -> None:
        if tick % 100 == 99:
            driver.correct(*pose)

    done = drive(driver, share, each_tick=correct)
    assert done.off(ZIGZAG).max() < 0.10
    np.testing.assert_allclose(done.poses[-1, :2], ZIGZAG[-1], atol=0.03)
    # Dead reckoning alone misses the end by more, and stays what the wheels say.
    alone = DrivePath(STEER, ZIGZAG)
    missed = drive(alone, share).poses[-1]
    assert math.dist(missed[:2], ZIGZAG[-1]) > 0.10
    assert driver.odometry.yaw == pytest.approx(SHARE / share * done.poses[-1, 2], rel=0.02)


@pytest.mark.parametrize("path", [ZIGZAG, bent(40), bent(120)])
def test_speeds_and_accelerations_keep_their_limits(path) -> None:
    motions = drive(DrivePath(STEER, path, 1.0)).motions
    speed, turn = np.abs(motions).max(axis=0)
    assert speed == pytest.approx(CONFIG.speed) and turn == pytest.approx(CONFIG.turn)
    steps = np.abs(np.diff(motions, axis=0, prepend=0.0, append=0.0)).max(axis=0) / PERIOD
    assert np.all(steps <= np.array([CONFIG.acceleration, CONFIG.turn_acceleration]) + 1e-9)
    wheels = [STEER.wheel_speeds(*motion) for motion in motions]
    assert np.abs(wheels).max() <= STEER.most
    # Nothing is asked of the wheels that they could not do, so that the curve is kept.
    np.testing.assert_allclose([STEER.motion(row) for row in wheels], motions, atol=1e-12)


def test_it_stands_where_it_turns_a_sharp_corner_and_does_not_where_it_curves() -> None:
    sharp, curved = (drive(DrivePath(STEER, bent(degrees))) for degrees in (90, 45))
    middle = [np.abs(done.poses[:, 2] - half) < 0.2 for done, half in
              zip((sharp, curved), np.radians([45.0, 22.5]))]  # fmt: skip
    assert np.abs(sharp.motions[middle[0], 0]).max() < 1e-3
    assert curved.motions[middle[1], 0].min() > 0.03


def test_it_slows_down_before_a_curve_that_its_turning_rate_bounds() -> None:
    done = drive(DrivePath(STEER, bent(45)))
    forward, turn = done.motions.T
    fast = np.flatnonzero(forward > 0.99 * CONFIG.speed)
    # Slow once it turns at its full rate, and fast again thereafter.
    turning = np.flatnonzero(turn > 0.99 * CONFIG.turn)
    assert forward[turning[0]] < 0.4 * CONFIG.speed
    assert fast[0] < turning[0] < turning[-1] < fast[-1]


def test_the_cells_of_a_grid_are_followed_without_a_stop() -> None:
    goal = np.array([0.7, 2.0])
    cells = shortest_paths(np.ones((41, 41), bool), (0, 0), 0.05).to((40, 14))
    path = np.vstack([0.05 * cells[:-1, ::-1], goal])
    assert len(path) > 30
    done = drive(DrivePath(STEER, path))
    assert done.off(path).max() < 0.03 + CONFIG.slack
    under_way = done.motions[100:-150, 0]
    assert under_way.min() > 0.04
    np.testing.assert_allclose(done.poses[-1, :2], goal, atol=0.01)


def test_a_new_path_is_taken_on_without_a_stop_and_counts_from_the_first_start() -> None:
    driver = DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)])
    other = np.array([(0.0, 1.05), (0.2, 1.7), (0.2, 2.6)])

    def replan(tick: int, pose: np.ndarray) -> None:
        if tick == 600:
            assert pose[1] > other[0, 1]
            driver.replan(other, 0.5)
            length = math.dist(other[0], other[1]) + math.dist(other[1], other[2])
            assert driver.remaining == pytest.approx(length - (pose[1] - other[0, 1]), abs=0.02)

    done = drive(driver, each_tick=replan)
    assert done.motions[500:900, 0].min() > 0.03
    assert Drive(done.poses[600:], done.motions).off(other).max() < 0.05
    np.testing.assert_allclose(done.poses[-1], [0.2, 2.6, 0.5], atol=0.02)
    assert driver.distance == pytest.approx(driver.odometry.distance) and driver.distance > 2.5


def test_what_is_left_of_a_path_begins_where_the_rover_is():
    driver, seen = DrivePath(STEER, ZIGZAG), []

    def watch(tick, pose):
        if tick % 50 == 0 and len(driver.rest):
            seen.append(np.vstack([driver.place, driver.rest]))

    drive(driver, each_tick=watch)
    for rest in seen:
        np.testing.assert_allclose(rest[-1], ZIGZAG[-1])
        assert len(rest) <= len(ZIGZAG)
        np.testing.assert_allclose(rest[1:], ZIGZAG[len(ZIGZAG) + 1 - len(rest) :])
    assert {len(rest) for rest in seen} == {2, 3, 4, 5}
    assert not len(driver.rest)


def test_a_path_that_begins_elsewhere_is_approached_straight() -> None:
    path = np.array([(0.3, 0.4), (0.3, 1.4)])
    done = drive(DrivePath(STEER, path))
    assert done.off(np.vstack([[0.0, 0.0], path])).max() < 0.03
    alone = drive(DrivePath(STEER, [(0.0, 0.5)]))
    np.testing.assert_allclose(alone.poses[-1], [0.0, 0.5, 0.0], atol=0.01)
    # A path that leads back past the rover is not cut short there.
    loop = np.array([(0.0, 0.0), (0.0, 1.0), (0.5, 1.0), (0.05, 0.0), (0.05, -0.4)])
    done = drive(DrivePath(STEER, loop))
    assert done.off(loop).max() < 0.03 and done.poses[:, 1].max() > 0.97


def test_it_drives_backwards_where_asked_and_turns_round_where_not() -> None:
    path = np.array([(0.0, 0.0), (0.1, -0.5), (0.0, -1.0)])
    back = drive(DrivePath(STEER, path, backwards=True))
    assert back.motions[:, 0].max() <= 0.0 and back.off(path).max() < 0.03
    assert np.abs(back.poses[:, 2]).max() < 0.6
    ahead = drive(DrivePath(STEER, path))
    assert ahead.motions[:, 0].min() >= 0.0 and np.abs(ahead.poses[:, 2]).max() > 2.5
    np.testing.assert_allclose([back.poses[-1, :2], ahead.poses[-1, :2]], [path[-1]] * 2, atol=0.01)


def test_it_stops_within_its_braking_distance_and_goes_on_with_a_path() -> None:
    driver = DrivePath(STEER, ZIGZAG)
    rests: list[float] = []

    def halt(tick: int, pose: np.ndarray) -> None:
        if tick == 300:
            driver.stop()
            rests.append(pose[1])
        if tick == 600:
            assert not driver.moving and not driver.done and not driver.blocked
            rests.append(pose[1])
            driver.replan(ZIGZAG)

    done = drive(driver, each_tick=halt)
    braking = CONFIG.speed**2 / (2.0 * CONFIG.acceleration) + CONFIG.speed * LAG
    assert 0.0 < rests[1] - rests[0] < braking + 0.01
    assert done.off(ZIGZAG).max() < 0.03
    np.testing.assert_allclose(done.poses[-1, :2], ZIGZAG[-1], atol=0.01)


@pytest.mark.parametrize(("pitch", "speed"), [(14.0, 1.0), (-22.5, 0.625), (29.9, 0.255)])
def test_the_tilt_bounds_the_speed(pitch, speed) -> None:
    """In line from 1 at 15 degrees to a quarter at 30."""
    tilt = (math.radians(pitch), 0.0)
    done = drive(DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)]), tilt=lambda tick: tilt)
    assert done.motions[:, 0].max() == pytest.approx(speed * CONFIG.speed, rel=0.02)


def test_beyond_the_largest_tilt_it_stops_and_may_creep_away() -> None:
    driver = DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)])
    steep = (0.0, math.radians(-30.3))

    def turn_back(tick: int, pose: np.ndarray) -> None:
        if tick == 700:
            assert driver.blocked == "tilted beyond 30 degrees"
            assert not driver.moving and not driver.done
            driver.replan([(0.0, 0.0)], backwards=True)
            assert not driver.blocked

    done = drive(driver, each_tick=turn_back, tilt=lambda tick: steep if tick > 300 else (0.0, 0.0))
    np.testing.assert_allclose(done.poses[-1, :2], 0.0, atol=0.01)
    assert done.motions[:, 0].min() == pytest.approx(-CONFIG.creep * CONFIG.speed, rel=0.05)


class WarningGuard:
    """Guard that warns of drives towards +y from a tick on, and notes when it was asked."""

    def __init__(self, since: int) -> None:
        self.since, self.asked = since, []

    def warning(self, seen, wheels: np.ndarray) -> str:
        self.asked.append(round(seen.time / PERIOD))
        speed, turn = STEER.motion(wheels)
        assert abs(speed) <= CONFIG.speed and turn == 0.0
        return "tips over" if speed > 0.0 and self.asked[-1] >= self.since else ""


def test_a_drive_that_is_likely_to_tip_over_stops_and_may_go_back() -> None:
    guard = WarningGuard(since=500)
    driver = DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)], guard=guard)
    reasons: list[str] = []

    def turn_back(tick: int, pose: np.ndarray) -> None:
        reasons.append(driver.blocked)
        if tick == 900:
            assert not driver.moving and not driver.done
            driver.replan([(0.0, 0.0)], backwards=True)

    tilt = math.radians(15.5), 0.0
    done = drive(driver, each_tick=turn_back, tilt=lambda tick: tilt if tick > 200 else (0.0, 0.0))
    np.testing.assert_allclose(done.poses[-1, :2], 0.0, atol=0.01)
    first = reasons.index("tips over")
    # Every half second where the tilt, as filtered, slows it, and not before.
    assert 201 < guard.asked[0] < 350 and set(np.diff(guard.asked[:5])) == {50}
    assert 500 <= first - 1 <= 552 and "tips over" not in reasons[901:]


def test_wheels_that_stall_stop_it_with_a_reason() -> None:
    driver = DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)])
    since: list[int] = []

    def note(tick: int, pose: np.ndarray) -> None:
        if driver.blocked:
            since.append(tick)

    done = drive(driver, each_tick=note, longest=10.0, wheels_turn=lambda t: t < 300, ends=False)
    assert driver.blocked == "wheels stall for 2 s" and not driver.done and not driver.moving
    assert 300 < since[0] - CONFIG.patience / PERIOD < 350
    assert done.motions[-1, 0] == 0.0
    # A stall of a second is none.
    drive(DrivePath(STEER, ZIGZAG), wheels_turn=lambda tick: not 300 < tick < 400)


def test_unmeasured_wheels_brake_it_at_once() -> None:
    driver = DrivePath(STEER, [(0.0, 0.0), (0.0, 2.0)])
    speeds = np.zeros(4)
    for tick in range(700):
        seen = seen_at(tick * PERIOD, wheel_speeds=speeds)
        missing = tick >= 300
        command = driver.step(seen._replace(wheel_speeds=MISSING) if missing else seen)
        speeds = command.wheels
        if tick == 450:
            assert not driver.moving and not driver.blocked
    assert driver.blocked == "wheel speeds are not measured for 2 s"


def test_the_arm_is_held_or_moves_by_its_own_command() -> None:
    driver, start = DrivePath(STEER, ZIGZAG), np.array([0.1, 0.2, 0.3, 0.4])
    assert not driver.step(seen_at(0.0, arm_angles=None)).wheels.any()
    for tick in range(100):
        command = driver.step(seen_at(tick * PERIOD, command_wheels(tick), start + 0.001 * tick))
    np.testing.assert_array_equal(command.arm, start)
    assert (command.wheel_mode, command.arm_mode) == (WheelMode.SPEED, ArmMode.POSITION)
    look = ArmMove(start + 0.5)
    look.command(seen_at(0.0, arm_angles=start))
    seen = seen_at(0.5, command_wheels(100), start)
    wheels = driver.step(seen).wheels
    joined = dataclasses.replace(look.command(seen), wheels=wheels)
    assert joined.wheels.any() and joined.wheel_mode is WheelMode.SPEED
    np.testing.assert_allclose(joined.arm, start + 0.4)
    np.testing.assert_allclose(joined.arm_rates, 0.8)


def command_wheels(tick: int) -> np.ndarray:
    """Return wheel speeds of a rover that speeds up [rad/s]."""
    return np.full(4, 0.04 * tick)


def test_bad_input_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(0,\): expected \(N, 2\)"):
        DrivePath(STEER, [])
    with pytest.raises(ValueError, match=r"shape \(1, 3\): expected \(N, 2\)"):
        DrivePath(STEER, [(0.0, 1.0, 0.0)])
    with pytest.raises(ValueError, match="expected finite numbers"):
        DrivePath(STEER, [(0.0, math.nan)])
    driver = DrivePath(STEER, [(0.0, 1.0)])
    with pytest.raises(ValueError, match="expected finite numbers"):
        driver.replan([(0.0, 1.0)], math.inf)
    with pytest.raises(ValueError, match="expected finite numbers"):
        driver.correct(0.0, math.nan, 0.0)


def follow_in_mujoco(steer: SkidSteer, path: np.ndarray) -> tuple[DrivePath, np.ndarray]:
    """Return the drive of MuJoCo's rover on flat ground, and its true x, y and yaw at the end."""
    scene = make_scene(RobotPlacement(ROBOT, stereo=False))
    simulation = Simulation(scene.model, [ROBOT], seed=5, data=scene.start())
    robot, chassis = simulation.robots[ROBOT], simulation.data.body(f"{ROBOT}/chassis")
    robot.activate()
    start, turned = chassis.xpos.copy(), chassis.xmat.reshape(3, 3).copy()
    driver = DrivePath(steer, path)
    while not driver.done and simulation.data.time < 60.0:
        robot.command(driver.step(robot.observe()))
        simulation.tick()
    assert driver.done
    for _ in range(100):
        robot.command(driver.step(robot.observe()))
        simulation.tick()
    x, y, _ = turned.T @ (chassis.xpos - start)
    ahead = turned.T @ chassis.xmat.reshape(3, 3)[:, 1]
    simulation.close()
    return driver, np.array([x, y, math.atan2(-ahead[0], ahead[1])])


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("identified", [True, False])
def test_mujocos_rover_ends_within_the_covariance_of_its_odometry(side, identified) -> None:
    drawn = drawn_turn_share(ROVER)
    share, sigma = drawn.share, drawn.deviation
    if identified:  # Where it was, so that as little is left as two shares differ.
        share, sigma = identify_slip(RobotPlacement(ROBOT), 0), 0.02
    path = np.array([(0.0, 0.0), (0.0, 0.7), (-0.6, 1.2), (-0.2, 1.8)]) * [side, 1.0]
    driver, truth = follow_in_mujoco(SkidSteer.of(ROVER, share, sigma), path)
    own = np.array([*driver.odometry.place, driver.odometry.yaw])
    # By its own reckoning at the end; the rest is the wheels' coming to rest.
    np.testing.assert_allclose(own[:2], path[-1], atol=0.015)
    # The error in the robot's own axes, where the covariance holds.
    c, s = math.cos(own[2]), math.sin(own[2])
    error = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ (truth - own)
    covariance = driver.odometry.covariance()[np.ix_([3, 4, 2], [3, 4, 2])]
    assert error @ np.linalg.solve(covariance, error) < 16.27  # 99.9 % of 3 degrees of freedom
    if identified:
        assert np.linalg.norm(error[:2]) < 0.035 * driver.distance
