"""Wheel speeds and motion belong together, and dead reckoning goes where geometry says."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.localization import tilt_to_level
from controllers.mission.belief import drawn_slide, drawn_turn_share
from controllers.motion.drive_path import DrivePath
from controllers.motion.driving import Odometry, SkidSteer, TurnShareDrive, identify_turn_share
from experiments.ch5.insertion_identify import identify_slip
from models.compose import RobotPlacement, settle
from tests.models.scenes import PLAIN, make_scene
from twin.describe import describe_rover
from twin.robot import MISSING, ArmMode, Channel, Command, Observation, Validity, WheelMode
from twin.simulation import Simulation

STEER = SkidSteer(0.05, 0.15, turn_share=0.6)
ROBOT = "rover1"
ROLLING = SkidSteer.of(describe_rover(ROBOT))
PERIOD = 0.01


def measured(*values: float) -> Channel:
    return Channel(np.array(values), 0.0, Validity.MEASURED)


def driving(speeds, pitch=0.0, roll=0.0) -> Observation:
    return Observation(0.0, wheel_speeds=measured(*speeds), inclinometer=measured(pitch, roll))


@pytest.fixture(scope="module")
def slip_drive():
    """A turn that the identification has not seen: wheel speeds and true headings of MuJoCo's."""
    scene = make_scene(RobotPlacement(ROBOT, stereo=False))
    simulation = Simulation(scene.model, [ROBOT], seed=5, data=scene.start())
    robot, chassis = simulation.robots[ROBOT], simulation.data.body(f"{ROBOT}/chassis")
    robot.activate()
    held = np.array(robot.observe().arm_angles.value)
    speeds, yaw = [], []
    for _ in range(300):
        seen = robot.observe()
        speeds.append(np.array(seen.wheel_speeds.value))
        yaw.append(math.atan2(-chassis.xmat[1], chassis.xmat[4]))
        wheels = ROLLING.wheel_speeds(0.06, 0.25)
        robot.command(Command(wheels, held, WheelMode.SPEED, ArmMode.POSITION))
        simulation.tick()
    simulation.close()
    return np.array(speeds), np.unwrap(yaw), simulation.period


def test_motion_of_the_wheel_speeds_for_a_motion_is_that_motion():
    rng = np.random.default_rng(0)
    for forward, turn in rng.uniform([-0.1, -0.2], [0.1, 0.2], (50, 2)):
        np.testing.assert_allclose(STEER.motion(STEER.wheel_speeds(forward, turn)), [forward, turn])


def test_rolling_wheels_go_as_fast_as_the_body_over_them():
    """A wheel's hub moves as the rigid body does: v + turn x (half track), ahead."""
    rolling = SkidSteer(0.05, 0.15)
    speeds = rolling.wheel_speeds(0.08, 0.2)
    hubs = 0.08 + 0.2 * 0.15 * np.array([-1.0, 1.0, -1.0, 1.0])
    np.testing.assert_allclose(speeds * 0.05, hubs)


@pytest.mark.parametrize("asked", [(0.5, 2.0), (-0.5, 2.0), (0.5, -2.0), (-0.5, 0.0), (0.0, 9.0)])
def test_saturated_wheels_keep_the_curve_forwards_and_backwards(asked):
    speeds = STEER.wheel_speeds(*asked)
    assert np.abs(speeds).max() == pytest.approx(STEER.most)
    kept = np.array(STEER.motion(speeds))
    share = kept @ asked / np.dot(asked, asked)
    assert 0.0 < share < 1.0
    np.testing.assert_allclose(kept, share * np.array(asked), atol=1e-12)
    np.testing.assert_array_equal(STEER.wheel_speeds(0.0, 0.0), 0.0)


@pytest.mark.parametrize("turn", [0.4, -0.4])
def test_dead_reckoning_follows_a_circle(turn):
    odometry = Odometry(STEER)
    seen = driving(STEER.wheel_speeds(0.1, turn))
    radius = 0.1 / turn
    for tick in range(1, round(2.0 * math.pi / abs(turn) / PERIOD) + 1):
        odometry.update(seen, PERIOD)
        angle = turn * PERIOD * tick
        # Forward is y at the start; the centre is to the left by the radius.
        place = [radius * (math.cos(angle) - 1.0), radius * math.sin(angle)]
        assert tick % 50 or np.allclose(odometry.place, place, rtol=0.0, atol=2e-6)
    assert odometry.yaw == pytest.approx(angle)
    assert odometry.distance == pytest.approx(0.1 * PERIOD * tick)
    assert odometry.turned == pytest.approx(abs(angle))


def test_way_and_turn_count_backwards_too():
    odometry = Odometry(STEER)
    for sign in (1.0, -1.0):
        for _ in range(100):
            odometry.update(driving(sign * STEER.wheel_speeds(0.1, 0.3)), PERIOD)
    np.testing.assert_allclose(odometry.place, 0.0, atol=1e-12)
    assert odometry.distance == pytest.approx(0.2) and odometry.turned == pytest.approx(0.6)


def test_missing_speeds_move_nothing_and_missing_tilt_keeps_the_last():
    odometry = Odometry(STEER, (1.0, 2.0), 0.5)
    odometry.update(driving([1.0] * 4, 0.02, -0.01)._replace(wheel_speeds=MISSING), PERIOD)
    np.testing.assert_array_equal(odometry.place, [1.0, 2.0])
    odometry.update(Observation(0.0), PERIOD)
    np.testing.assert_array_equal(odometry.tilt, [0.02, -0.01])


def test_pose_has_the_tilt_of_the_inclinometer():
    odometry = Odometry(STEER, (0.3, -0.2), 0.7)
    odometry.update(driving([0.0] * 4, 0.04, -0.06), PERIOD)
    c, s = math.cos(0.7), math.sin(0.7)
    yaw = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    wanted = yaw @ tilt_to_level(np.array([0.04, -0.06])).rotation.as_matrix()
    np.testing.assert_allclose(odometry.pose()[:3, :3], wanted, atol=1e-12)
    np.testing.assert_allclose(odometry.pose()[:, 3], [0.3, -0.2, 0.0, 1.0], atol=1e-12)
    np.testing.assert_array_equal(odometry.pose()[3, :3], 0.0)
    np.testing.assert_allclose(odometry.pose()[:3, 3], [0.3, -0.2, 0.0])


SLOPE = math.radians(10.0)
"""Slope of a plane that rises along y."""
PLANE = Rotation.from_euler("x", SLOPE)


def on_the_plane(angle):
    """Return pitch, roll and yaw of a rover on the plane that has turned by an angle on it."""
    attitude = (PLANE * Rotation.from_euler("z", angle)).as_matrix()
    yaw = math.atan2(-attitude[0, 1], attitude[1, 1])
    return math.asin(attitude[2, 1]), math.atan2(-attitude[2, 0], attitude[2, 2]), yaw


@pytest.mark.parametrize("speed", [0.2, -0.2])
def test_a_straight_drive_up_a_slope_climbs_by_its_sine(speed):
    odometry = Odometry(STEER)
    for _ in range(500):
        odometry.update(driving(STEER.wheel_speeds(speed, 0.0), SLOPE), PERIOD)
    far = 5.0 * speed
    np.testing.assert_allclose(odometry.place, [0.0, far * math.cos(SLOPE)], atol=1e-12)
    assert odometry.height == pytest.approx(far * math.sin(SLOPE))
    assert odometry.distance == pytest.approx(abs(far))
    assert odometry.climbed == pytest.approx(abs(far) * math.sin(SLOPE))


@pytest.mark.parametrize("turn", [0.3, -0.3])
@pytest.mark.parametrize("speed", [0.0, 0.15])
def test_a_circle_on_a_slope_is_one_in_its_plane(speed, turn):
    """Where the rover is and how it is tilted, by its turn about the plane's normal alone."""
    odometry = Odometry(STEER, tilt_lag=0.0)
    speeds, radius, step = STEER.wheel_speeds(speed, turn), speed / turn, 0.002
    for tick in range(round(2.0 * math.pi / abs(turn) / step)):
        pitch, roll, _ = on_the_plane(turn * step * (tick + 0.5))
        odometry.update(driving(speeds, pitch, roll), step)
        if tick % 500 == 499:
            angle = turn * step * (tick + 1)
            circle = radius * np.array([math.cos(angle) - 1.0, math.sin(angle), 0.0])
            x, y, z = PLANE.apply(circle)
            np.testing.assert_allclose([*odometry.place, odometry.height], [x, y, z], atol=1e-5)
            yaw = on_the_plane(angle)[2]
            assert math.remainder(odometry.yaw - yaw, math.tau) == pytest.approx(0.0, abs=1e-5)
            attitude = (PLANE * Rotation.from_euler("z", angle)).as_matrix()
            # The tilt is that of half a step before.
            np.testing.assert_allclose(odometry.pose()[:3, :3], attitude, atol=2e-4)
            np.testing.assert_allclose(odometry.pose()[:3, 3], [x, y, z], atol=1e-5)
    # A turn is whole again, whatever its tilt on the way.
    assert abs(odometry.yaw) == pytest.approx(2.0 * math.pi, abs=1e-3)
    assert odometry.climbed == pytest.approx(odometry.distance * math.sin(SLOPE))


def test_the_height_takes_an_acceleration_for_a_tilt_until_it_brakes():
    """v^2 / 2 g meanwhile, with a lag v a lag / g more; both ramps leave 2 v a lag / g at most."""
    odometry, speed, acceleration, lag, g = Odometry(STEER, tilt_lag=0.3), 0.2, 0.2, 0.3, 9.81
    heights = []
    for time in np.arange(0.0, 10.0, PERIOD):
        ramp = min(acceleration * time, speed, max(acceleration * (8.0 - time), 0.0))
        felt = acceleration / g * (float(time < 1.0) - float(7.0 < time < 8.0))
        odometry.update(driving(STEER.wheel_speeds(ramp, 0.0), felt), PERIOD)
        heights.append(odometry.height)
    more = speed * acceleration * lag / g
    assert heights[600] == pytest.approx(speed**2 / (2.0 * g) + more, rel=0.2)
    assert 0.5 * more < odometry.height < 2.0 * more < 0.003


@pytest.mark.parametrize("turn", [0.0, 0.15, -0.15])
@pytest.mark.parametrize("bearing", [0.0, 45.0, 90.0, 180.0])
def test_mujocos_rover_on_a_slope_is_where_its_odometry_is(bearing, turn):
    """Up, across and down a slope of 10 degrees: gravity is turned, not the ground."""
    scene = make_scene(RobotPlacement(ROBOT, yaw=math.radians(bearing), stereo=False))
    scene.model.opt.gravity[:] = -9.81 * PLANE.apply([0.0, 0.0, 1.0], inverse=True)
    simulation = Simulation(scene.model, [ROBOT], seed=5, data=settle(scene.model))
    robot, chassis = simulation.robots[ROBOT], simulation.data.body(f"{ROBOT}/chassis")
    robot.activate()
    period, held = simulation.period, np.array(robot.observe().arm_angles.value)
    drawn = drawn_turn_share(describe_rover(ROBOT))
    steer = SkidSteer.of(describe_rover(ROBOT), drawn.share, drawn.deviation)
    odometry, start = Odometry(steer), chassis.xpos.copy()
    first = PLANE.apply(chassis.xmat.reshape(3, 3)[:, 1])
    for tick in range(1200):
        seen, time = robot.observe(), tick * period
        odometry.update(seen, period)
        speed = min(0.15, 0.2 * time, 0.2 * max(11.0 - time, 0.0))
        wheels = steer.wheel_speeds(speed, turn if 2.0 < time < 7.0 else 0.0)
        robot.command(Command(wheels, held, WheelMode.SPEED, ArmMode.POSITION))
        simulation.tick()
    began = Rotation.from_euler("z", math.atan2(-first[0], first[1]))
    moved = began.apply(PLANE.apply(chassis.xpos - start), inverse=True)
    last = began.apply(PLANE.apply(chassis.xmat.reshape(3, 3)[:, 1]), inverse=True)
    simulation.close()
    far = odometry.distance
    assert far > 1.4
    error = moved - [*odometry.place, odometry.height]
    # Of the height most is by the pitch at which the rover hangs on its springs.
    assert abs(error[2]) < 0.015 * far
    yaw = math.remainder(math.atan2(-last[0], last[1]) - odometry.yaw, math.tau)
    if turn == 0.0:
        assert np.linalg.norm(error[:2]) < 0.01 * far and abs(yaw) < 0.01
    # It turns less than on level ground, uphill least. In its own axes, within what it knows:
    own = Rotation.from_euler("z", odometry.yaw).apply(error, inverse=True)
    twist, covariance = np.array([yaw, *own]), odometry.covariance()[2:, 2:]
    assert twist @ np.linalg.solve(covariance, twist) < 18.47  # 99.9 % of 4 degrees of freedom


def test_mujocos_rover_that_turns_on_a_slope_slides_as_drawn():
    """To a third, on friction of 0.5, over all headings: its load is not in its middle."""
    slope, slid, rolled = math.tan(math.radians(6.0)), 0.0, 0.0
    for bearing in (0.0, 90.0, 180.0, 270.0):
        placement = RobotPlacement(ROBOT, yaw=math.radians(bearing), stereo=False)
        field = dataclasses.replace(PLAIN, friction=0.5, slope=(0.0, math.atan(slope)))
        scene = make_scene(placement, field=field)
        simulation = Simulation(scene.model, [ROBOT], seed=5, data=scene.start())
        robot, chassis = simulation.robots[ROBOT], simulation.data.body(f"{ROBOT}/chassis")
        robot.activate()
        held, begin = np.array(robot.observe().arm_angles.value), float(chassis.xpos[1])
        for tick in range(400):
            turn = 0.25 if tick < 200 else -0.25  # Left and right, so that its heading stays.
            rolled += abs(ROLLING.motion(robot.observe().wheel_speeds.value)[1]) * PERIOD
            wheels = ROLLING.wheel_speeds(0.0, turn)
            robot.command(Command(wheels, held, WheelMode.SPEED, ArmMode.POSITION))
            simulation.tick()
        slid += begin - float(chassis.xpos[1])
        simulation.close()
    assert slid / (rolled * slope) == pytest.approx(drawn_slide(describe_rover(ROBOT)), rel=0.4)


@pytest.mark.parametrize("tilt", [(0.12, 0.0), (0.0, 0.1), (-0.05, 0.08)])
def test_what_slides_is_reckoned_and_made_up_for_ahead(tilt):
    """Downhill by the slope that the plane of the axes has."""
    steer = dataclasses.replace(STEER, slide=0.5)
    odometry, upright = Odometry(steer), Rotation.from_euler("XY", tilt).apply([0.0, 0.0, 1.0])
    for _ in range(100):
        odometry.update(driving(steer.wheel_speeds(0.0, 0.3), *tilt), PERIOD)
    turned = 0.3 * 100 * PERIOD
    far = 0.5 * turned / steer.turn_share * np.hypot(*upright[:2]) / upright[2]
    assert np.linalg.norm(odometry.place) == pytest.approx(far, rel=0.03)
    half = Rotation.from_euler("z", 0.5 * turned).apply(upright)[:2]
    assert odometry.place @ half / (far * np.linalg.norm(half)) == pytest.approx(1.0, abs=0.03)
    drive = DrivePath(steer, [(0.0, 0.0)], 0.3)
    wheels = drive._wheels(0.0, 0.3)  # pyright: ignore
    np.testing.assert_allclose(wheels, steer.wheel_speeds(0.0, 0.3))  # No tilt is known yet.
    drive.odometry.update(driving(np.zeros(4), *tilt), PERIOD)
    ahead, _ = steer.motion(drive._wheels(0.0, 0.3))  # pyright: ignore
    assert ahead == pytest.approx(0.5 * 0.3 / steer.turn_share * math.tan(tilt[0]))


def test_what_the_height_is_known_to_grows_with_distance_and_slope():
    def deviation(pitch, roll, far):
        odometry = Odometry(STEER)
        for _ in range(round(far / 0.2 / PERIOD)):
            odometry.update(driving(STEER.wheel_speeds(0.2, 0.0), pitch, roll), PERIOD)
        return math.sqrt(odometry.covariance()[5, 5])

    assert deviation(0.0, 0.0, 0.01) == pytest.approx(0.01, rel=1e-3)
    assert deviation(0.0, 0.0, 4.0) == pytest.approx(math.hypot(0.01, 0.04))
    climb = 0.05 * 4.0 * math.sin(SLOPE)
    for tilt in ((SLOPE, 0.0), (0.0, -SLOPE)):
        assert deviation(*tilt, 4.0) == pytest.approx(math.hypot(0.01, 0.04, climb))


def test_tilt_follows_a_step_as_a_first_order_lag():
    odometry = Odometry(STEER, tilt_lag=0.3)
    odometry.update(driving([0.0] * 4), 1e-4)
    for _ in range(3000):
        odometry.update(driving([0.0] * 4, 0.1), 1e-4)
    assert odometry.tilt[0] == pytest.approx(0.1 * (1.0 - math.exp(-1.0)), rel=1e-3)


def test_share_of_a_synthetic_drive_is_found_as_well_as_the_headings_tell():
    rng = np.random.default_rng(3)
    turns = 0.2 * np.sign(np.sin(np.arange(600) * PERIOD * 2.0))
    speeds = np.array([STEER.wheel_speeds(0.05, turn) for turn in turns])
    headings = 3.0 + np.cumsum(turns) * PERIOD + 1e-3 * rng.normal(size=600)
    share = identify_turn_share(STEER, speeds, headings, PERIOD)
    rolled = np.cumsum(turns) * PERIOD / STEER.turn_share
    deviation = 1e-3 / (np.std(rolled) * np.sqrt(600.0))  # of a line's slope
    assert abs(share - STEER.turn_share) < 3.0 * deviation < 0.01


def test_share_of_mujocos_rover_brings_dead_reckoning_to_its_true_heading(slip_drive):
    share = identify_slip(RobotPlacement(ROBOT), 0)
    assert 0.2 < share < 1.0
    speeds, yaw, period = slip_drive
    errors = {}
    for name, steer in (
        ("rolling", ROLLING),
        ("identified", dataclasses.replace(ROLLING, turn_share=share)),
    ):
        odometry = Odometry(steer, yaw=yaw[0])
        for row in speeds:
            odometry.update(driving(row), period)
        errors[name] = abs(odometry.yaw - yaw[-1])
    turned = abs(yaw[-1] - yaw[0])
    assert turned > 0.2
    assert errors["identified"] < 0.06 * turned < errors["rolling"]


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="turn_share = 0"):
        SkidSteer(0.05, 0.15, turn_share=0.0)
    with pytest.raises(ValueError, match="turn_sigma = -0.1"):
        SkidSteer(0.05, 0.15, turn_sigma=-0.1)
    with pytest.raises(ValueError, match="wheel_radius"):
        SkidSteer(math.nan, 0.15)
    straight = np.ones((100, 4))
    with pytest.raises(ValueError, match="less than 5 degrees"):
        identify_turn_share(STEER, straight, np.zeros(100), PERIOD)
    with pytest.raises(ValueError, match="as many"):
        identify_turn_share(STEER, straight, np.zeros(99), PERIOD)


def test_identification_drive_curves_to_the_left_and_then_to_the_right_in_equal_parts():
    drive = TurnShareDrive(ROBOT, STEER, PERIOD)
    turns = []
    for _ in range(600):
        seen = driving([0.0] * 4)._replace(arm_angles=measured(0.1, 0.2), heading=measured(0.0))
        command = drive.step({ROBOT: seen})[ROBOT]
        forward, turn = STEER.motion(command.wheels)
        assert forward == pytest.approx(0.06)
        turns.append(turn)
    np.testing.assert_allclose(turns, np.repeat([0.25, -0.25, 0.25, -0.25], 150))


def wound(share, sigma=0.0):
    """Return dead reckoning of a winding drive by wheels that keep a share of its turns."""
    odometry = Odometry(SkidSteer(0.05, 0.15, share, sigma), (0.3, -0.2), 0.4)
    rng = np.random.default_rng(2)
    for speeds in np.repeat(rng.uniform(-1.0, 3.0, (12, 2)), 25, axis=0):
        left, right = speeds
        odometry.update(driving([left, right, left, right], 0.1, -0.15), PERIOD)
    return odometry


def test_slip_is_what_a_share_off_by_its_deviation_makes_of_the_pose():
    odometry, sigma = wound(0.6, 0.05), 0.05
    step = 1e-5
    less, more = (RigidTransform.from_matrix(wound(0.6 + s).pose()) for s in (-step, step))
    slope = (more * less.inv()).as_exp_coords() / (2.0 * step)
    np.testing.assert_allclose(odometry.slip(), sigma * slope, atol=1e-8)
    assert np.abs(odometry.slip()[2]) > 0.005
    np.testing.assert_array_equal(wound(0.6).slip(), 0.0)
