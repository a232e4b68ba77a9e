"""Visual odometry against closed forms; its features are replaced by motions made by hand."""

import collections
import math
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import camera_arm, stereo_geometry
from controllers.mapping.localization import RobotLocalization
from controllers.mapping.visual_odometry import VisualOdometry, VisualOdometryConfig, levelled
from controllers.motion.driving import SkidSteer
from perception.registration.checks import RegistrationError
from perception.registration.motion import Motion
from twin.describe import describe_rover
from twin.robot import Channel, Observation, Validity
from twin.sensors import DATASHEET

ROBOT = describe_rover("rover1")
ARM, _ = camera_arm(ROBOT)
HOME = typing.cast(typing.Any, ROBOT.arm).home
IMAGE = np.zeros((2, 2), np.uint8)
POINTS = typing.cast(typing.Any, None)


class HandMatcher:
    """Gives the true motion of the camera, or none."""

    def __init__(self):
        self.motions = []

    def find(self, image, points):
        return object()

    def motion(self, before, after, guess):
        if self.motions[0] is None:
            raise RegistrationError("nothing is recognised")
        motion = self.motions.pop(0)
        return Motion(motion, 1e-8 * np.eye(6), np.ones(9, bool), 1.0)


def rover(share=0.5, sigma=0.1):
    odometry = VisualOdometry(ARM, stereo_geometry(ROBOT), SkidSteer.of(ROBOT, share, sigma))
    matcher = HandMatcher()
    odometry._matcher = matcher  # pyright: ignore
    return odometry, matcher


def drive(odometry, forward, turn, seconds, begin=0.0, tilt=(0.0, 0.0)):
    """Feed ticks of a motion of rolling wheels, and return the time after it."""
    speeds = SkidSteer.of(ROBOT, 1.0).wheel_speeds(forward, turn)
    for step in range(round(seconds / 0.01)):
        time = begin + 0.01 * step
        seen = Observation(time)._replace(
            wheel_speeds=Channel(speeds, time, Validity.MEASURED),
            arm_angles=Channel(np.array(HOME), time, Validity.MEASURED),
            inclinometer=Channel(np.array(tilt), time, Validity.MEASURED),
        )
        odometry.update(seen)
    return begin + 0.01 * round(seconds / 0.01)


def test_wheels_alone_turn_by_their_share_of_a_circle():
    odometry, _ = rover(share=0.5)
    end = drive(odometry, 0.1, 0.2, 20.0)
    odometry.update(Observation(end))  # nothing measured moves nothing
    pose, (x, y) = odometry.level_pose(), odometry.level_pose().translation[:2]
    turned, radius = 0.5 * 0.2 * 19.99, 0.1 / (0.5 * 0.2)
    assert pose.rotation.as_euler("ZXY")[0] == pytest.approx(turned, abs=1e-6)
    assert x == pytest.approx(radius * (math.cos(turned) - 1.0), abs=1e-4)
    assert y == pytest.approx(radius * math.sin(turned), abs=1e-4)
    assert odometry.distance == pytest.approx(2.0)
    assert odometry.turned == pytest.approx(0.6 * 0.2 * 20.0)


def test_a_slope_is_climbed():
    pitch = math.radians(8.0)
    odometry, _ = rover()
    drive(odometry, 0.1, 0.0, 10.0, tilt=(pitch, 0.0))
    x, y, z = odometry.level_pose().translation
    assert (x, y, z) == pytest.approx((0.0, math.cos(pitch), math.sin(pitch)), abs=2e-3)
    tilt = odometry.pose().rotation.as_euler("ZXY")[1:]
    assert tilt == pytest.approx((pitch, 0.0), abs=1e-6)


def camera_motion(odometry, robot_motion):
    """The left camera's motion, after to before, of a motion of the rover, after to before."""
    tool = ARM.tool_in_robot(HOME)
    return tool.inv() * robot_motion * tool


def test_a_seen_motion_replaces_that_of_the_wheels_and_tells_the_turn_share():
    odometry, matcher = rover(share=0.5, sigma=0.1)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    true = 0.4 * 0.2 * 2.0  # the wheels keep less of a turn than was believed
    for _ in range(6):
        moved = RigidTransform.from_components([0.0, 0.02, 0.0], Rotation.from_euler("z", true))
        matcher.motions.append(camera_motion(odometry, moved))
        time = drive(odometry, 0.01, 0.2, 2.0, time)
        odometry.see(time - 0.01, IMAGE, POINTS)
    assert odometry.seen == 6 and odometry.missed == 0
    assert odometry.level_pose().rotation.as_euler("ZXY")[0] == pytest.approx(6 * true, abs=1e-3)
    assert odometry.turn_share == pytest.approx(0.4, abs=0.025)
    assert VisualOdometryConfig().turn_scatter < odometry.turn_sigma < 0.14


@pytest.mark.parametrize(("forward", "turn"), [(0.1, 0.0), (0.0, 0.3)])
def test_wheels_that_turn_while_the_rover_stays_slip_and_tell_nothing_of_turns(forward, turn):
    odometry, matcher = rover(share=0.5)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    matcher.motions.append(RigidTransform.identity())
    time = drive(odometry, forward, turn, 2.0, time)
    odometry.see(time - 0.01, IMAGE, POINTS)
    assert odometry.slip == pytest.approx(1.0, abs=0.02)
    assert odometry.turn_share == 0.5


@pytest.mark.parametrize(("forward", "turn", "duration"), [(0.08, 0.9, 1.5), (0.07, 0.45, 1.0)])
@pytest.mark.parametrize(("kept", "slip"), [(0.5, 0.0), (0.25, 0.5), (0.0, 1.0)])
def test_a_turn_on_the_spot_slips_by_what_it_lacks_of_the_drawn_one_though_it_rolls_meanwhile(
    kept, slip, forward, turn, duration
):
    odometry, matcher = rover(share=0.5)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    for _ in range(4):
        turned = Rotation.from_euler("z", kept * turn * duration)
        matcher.motions.append(camera_motion(odometry, RigidTransform.from_rotation(turned)))
        # It slides back as far as it rolls.
        time = drive(odometry, forward, turn, duration, time)
        odometry.see(time - 0.01, IMAGE, POINTS)
        assert odometry.slip == pytest.approx(slip, abs=0.02)


def test_on_other_ground_the_turn_share_is_learnt_anew_however_long_the_first_was():
    odometry, matcher = rover(share=0.5)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    for count, share in ((60, 0.3), (12, 0.5)):
        for _ in range(count):
            moved = RigidTransform.from_rotation(Rotation.from_euler("z", share * 0.4))
            matcher.motions.append(camera_motion(odometry, moved))
            time = drive(odometry, 0.0, 0.2, 2.0, time)
            odometry.see(time - 0.01, IMAGE, POINTS)
        assert odometry.turn_share == pytest.approx(share, abs=0.04)
        assert odometry.turn_sigma > VisualOdometryConfig().turn_scatter


@pytest.mark.parametrize(("pitch", "roll"), [(0.1, 0.0), (-0.08, 0.0), (0.0, 0.1), (0.05, -0.09)])
@pytest.mark.parametrize("slide", [0.3, 1.2])
def test_turns_on_a_slope_tell_how_far_the_rover_slides(pitch, roll, slide):
    odometry, matcher = rover(share=0.5)
    odometry._views = collections.deque(maxlen=1)  # pyright: ignore
    time = drive(odometry, 0.0, 0.0, 0.1, tilt=(pitch, roll))
    odometry.see(time, IMAGE, POINTS)
    tilted = Rotation.from_euler("XY", [pitch, roll])
    x, y, up = tilted.apply([0.0, 0.0, 1.0])
    slid = slide * 0.4 * np.array([x, y]) / up
    for turn in (0.2, -0.2) * 12:
        # Seen in the tilted rover; it does not turn, so that its tilt stays.
        matcher.motions.append(
            camera_motion(odometry, RigidTransform.from_translation(tilted.inv().apply([*slid, 0])))
        )
        time = drive(odometry, 0.0, turn, 2.0, time, (pitch, roll))
        odometry.see(time - 0.01, IMAGE, POINTS)
    assert odometry.slide == pytest.approx(slide, rel=0.1)
    # The wheels alone tell as much from now on.
    before = odometry.level_pose().translation[:2]
    drive(odometry, 0.0, 0.2, 2.0, time, (pitch, roll))
    moved = odometry.level_pose().translation[:2] - before
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(slid), rel=0.1)


def test_what_slips_on_a_straight_way_is_no_slide():
    odometry, matcher = rover()
    time = drive(odometry, 0.0, 0.0, 0.1, tilt=(0.15, 0.0))
    odometry.see(time, IMAGE, POINTS)
    for _ in range(6):
        ahead = RigidTransform.from_translation([0.0, 0.2, 0.0])
        matcher.motions.append(camera_motion(odometry, ahead))
        time = drive(odometry, 0.1, 0.3, 3.0, time, (0.15, 0.0))
        odometry.see(time - 0.01, IMAGE, POINTS)
    assert odometry.slide == 0.0


def test_a_rover_back_at_an_earlier_view_has_not_slipped():
    odometry, matcher = rover()
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    ahead = RigidTransform.from_translation([0.0, 0.3, 0.0])
    for speed, robot_motion in ((0.1, ahead), (-0.1, RigidTransform.identity())):
        matcher.motions.append(camera_motion(odometry, robot_motion))
        time = drive(odometry, speed, 0.0, 3.0, time)
        odometry.see(time - 0.01, IMAGE, POINTS)
        assert abs(odometry.slip) < 0.02
    np.testing.assert_allclose(odometry.level_pose().translation, 0.0, atol=1e-3)


def test_where_nothing_is_recognised_the_wheels_stand_in_with_their_covariance():
    seen, sees = rover(share=0.5, sigma=0.1)
    blind, misses = rover(share=0.5, sigma=0.1)
    for odometry, matcher in ((seen, sees), (blind, misses)):
        time = drive(odometry, 0.0, 0.0, 0.1)
        odometry.see(time, IMAGE, POINTS)
        drive(odometry, 0.0, 0.2, 5.0, time)
        turn = RigidTransform.from_rotation(Rotation.from_euler("z", 0.5))
        matcher.motions.append(camera_motion(odometry, turn) if odometry is seen else None)
        odometry.see(time + 4.99, IMAGE, POINTS)
    assert blind.missed == 1
    assert blind.level_pose().rotation.as_euler("ZXY")[0] == pytest.approx(0.5, abs=2e-3)
    # A share off by a deviation errs by a tenth of the rolled radian, and this turn's by more.
    assert math.sqrt(blind.covariance[2, 2]) == pytest.approx(0.16, rel=0.1)
    assert math.sqrt(seen.covariance[2, 2]) < 0.01


def test_a_rover_is_astray_by_what_it_did_not_recognise_on_the_way_and_not_at_rest():
    odometry, matcher = rover(share=0.5, sigma=0.1)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    for speed, astray, strayed in ((0.2, 1, 0.1), (0.2, 2, 0.2), (0.0, 2, 0.2)):
        time = drive(odometry, 0.0, speed, 1.0, time)
        matcher.motions = [None]
        odometry.see(time - 0.01, IMAGE, POINTS)
        assert odometry.astray == astray
        assert odometry.strayed == pytest.approx(strayed, abs=0.01)
    matcher.motions = [camera_motion(odometry, RigidTransform.identity())]
    odometry.see(time - 0.01, IMAGE, POINTS)
    assert odometry.astray == 0 and odometry.strayed == 0.0


def test_a_turn_that_the_wheels_do_not_tell_is_recognised():
    """On smooth ground the rover has turned by 0.35 rad more than its wheels."""
    odometry, matcher = rover(share=0.5, sigma=0.1)
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    drive(odometry, 0.0, 0.2, 2.0, time)
    true = camera_motion(odometry, RigidTransform.from_rotation(Rotation.from_euler("z", 0.55)))
    guesses = []

    def motion(before, after, guess):
        guesses.append((guess.inv() * true).rotation.magnitude())
        if guesses[-1] > 0.1:
            raise RegistrationError("too far from the guess")
        return Motion(true, 1e-8 * np.eye(6), np.ones(9, bool), 1.0)

    matcher.motion = motion
    odometry.see(time + 1.99, IMAGE, POINTS)
    assert odometry.seen == 1 and odometry.missed == 0
    assert guesses[0] == pytest.approx(0.35, abs=0.01)
    assert odometry.level_pose().rotation.as_euler("ZXY")[0] == pytest.approx(0.55, abs=2e-3)


def test_the_inclinometer_keeps_the_frame_level_but_is_not_averaged_to_nothing():
    odometry, matcher = rover()
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    # Features that drift in tilt by 1 degree a view.
    for _ in range(40):
        drift = RigidTransform.from_rotation(Rotation.from_euler("x", math.radians(1.0)))
        matcher.motions.append(drift)
        time = drive(odometry, 0.0, 0.0, 0.2, time)
        odometry.see(time - 0.01, IMAGE, POINTS)
    tilt = odometry.pose().rotation.as_euler("ZXY")[1:]
    assert np.degrees(np.abs(tilt)).max() < 3.0  # 40 without it
    assert np.sqrt(odometry.covariance[0, 0]) >= VisualOdometryConfig().tilt_at_rest


def test_a_frame_stays_as_unsure_of_what_is_upright_as_the_view_that_defined_it():
    """Its own zero lies in the same error: no inclinometer, and no later view, tells it there."""
    odometry, matcher = rover()
    time = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(time, IMAGE, POINTS)
    at_rest, first, ahead = VisualOdometryConfig().tilt_at_rest, np.array([0.03, 0.01]), 0.1
    for sigmas in (first, np.array([0.004, 0.004])):
        place = RigidTransform.from_translation(
            [0.0, float(odometry.level_pose().translation[1]), 0.0]
        )
        variances = np.square([*sigmas, 0.01, 0.01, 0.01, 0.01])
        found = RobotLocalization(ARM, place, np.diag(variances), np.zeros((6, 6 + len(ARM))))
        odometry.localize(found, time)
        for _ in range(8):
            forward = RigidTransform.from_translation([0.0, ahead, 0.0])
            matcher.motions.append(camera_motion(odometry, forward))
            time = drive(odometry, ahead, 0.0, 1.0, time)
            odometry.see(time - 0.01, IMAGE, POINTS)
        tilts = np.sqrt(np.diag(odometry.covariance)[:2])
        np.testing.assert_allclose(tilts, np.hypot(first, at_rest), rtol=0.1)


def test_levelled_keeps_place_and_yaw():
    pose = RigidTransform.from_components(
        [1.0, 2.0, 3.0], Rotation.from_euler("ZXY", [0.7, 0.2, -0.1])
    )
    level = levelled(pose)
    np.testing.assert_allclose(level.rotation.as_euler("ZXY"), [0.7, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(level.translation, pose.translation)


def test_the_noise_of_tachometers_at_rest_makes_no_rover_unsure_that_it_stands():
    odometry, rng = rover(sigma=0.3)[0], np.random.default_rng(1)
    end = drive(odometry, 0.0, 0.0, 0.1)
    odometry.see(end - 0.01, IMAGE, POINTS)
    noise = DATASHEET.channels["wheel_speeds"].noise
    for tick in range(10000):
        time = end + 0.01 * tick
        seen = Observation(time)._replace(
            wheel_speeds=Channel(rng.normal(0.0, noise, 4), time, Validity.MEASURED),
            arm_angles=Channel(np.array(HOME), time, Validity.MEASURED),
            inclinometer=Channel(np.zeros(2), time, Validity.MEASURED),
        )
        odometry.update(seen)
    pose, covariance = odometry.estimate()
    np.testing.assert_array_equal(covariance, odometry.covariance)
    assert np.linalg.norm(pose.translation[:2]) < 1e-3
