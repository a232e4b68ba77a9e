"""A rover's navigator on wheels that roll as they are told, without images."""

import math
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from controllers.insertion.camera_station import camera_arm
from controllers.mapping.localization import RobotLocalization
from controllers.mission.belief import MissionBelief
from controllers.mission.navigator import NavigatorConfig
from controllers.motion.driving import SkidSteer
from models.datasheets import CAMERA
from perception.stereo.matching import StereoPoints
from tests.controllers.mission.hand_made import POSES, SITE
from tests.controllers.motion.seen import PAIR, seen_at
from twin.describe import describe_rover

ROBOT = describe_rover("rover1")
ANGLES = np.array([0.0, 1.6, -0.2, -1.85])


class Rolling:
    """A rover whose wheels turn as commanded, and its navigator."""

    def __init__(self, without="", tilt=(0.0, 0.0)):
        self.knowledge = MissionBelief.initial(ROBOT, SITE, without)
        self.navigator = self.knowledge.navigator
        self.time, self.wheels, self.tilt = 0.0, np.zeros(4), np.array(tilt)
        self.seen = self.tick()

    def tick(self):
        self.time += 0.01
        seen = seen_at(self.time, self.wheels, ANGLES, PAIR, self.time)
        seen = seen._replace(inclinometer=seen.inclinometer._replace(value=self.tilt))
        self.navigator.observe(seen)
        return seen

    def drive(self, seconds=60.0):
        """Drive until the end; return the places (N, 2) on the way."""
        places = []
        while not self.navigator.arrived and self.time < seconds:
            command = self.navigator.step(self.seen)
            self.wheels = np.array(command.wheels) if len(command.wheels) else np.zeros(4)
            self.seen = self.tick()
            places.append(self.navigator.place)
        return np.array(places)


def put_box(navigator, x, y, half=0.1, height=0.08):
    """Map level ground about the rover, with a box on it."""
    ground = navigator.ground.newest
    centres = ground.grid.centres
    about = np.abs(centres).max(axis=-1) < 2.5
    ground.heights[about] = 0.0
    ground.variances[about] = 1e-6
    box = (np.abs(centres[..., 0] - x) < half) & (np.abs(centres[..., 1] - y) < half)
    ground.heights[box] = height


def put_box_on(navigator, x, y, half=0.1, height=0.08):
    """Put a further box on ground that is mapped already."""
    centres = navigator.ground.grid.centres
    box = (np.abs(centres[..., 0] - x) < half) & (np.abs(centres[..., 1] - y) < half)
    navigator.ground.newest.heights[box] = height


def test_a_drive_ends_at_its_place_and_heading():
    rover = Rolling()
    assert rover.navigator.set_off(np.array([0.5, 1.2]), 0.8)
    rover.drive()
    assert math.dist(rover.navigator.place, (0.5, 1.2)) < 0.04
    assert rover.navigator.yaw == pytest.approx(0.8, abs=0.05)


def test_a_given_path_is_followed_as_it_is_forward_and_back():
    rover = Rolling()
    put_box(rover.navigator, 0.0, 0.5)
    rover.navigator.follow(np.array([[0.0, 0.0], [0.0, 1.0]]), 0.0)
    rover.drive()
    np.testing.assert_allclose(rover.navigator.place, [0.0, 1.0], atol=0.02)
    rover.navigator.follow(np.array([[0.0, 1.0], [0.0, 0.4]]), 0.0, backwards=True)
    rover.drive()
    np.testing.assert_allclose(rover.navigator.place, [0.0, 0.4], atol=0.02)
    assert rover.navigator.yaw == pytest.approx(0.0, abs=0.02)
    assert not rover.navigator.is_clear(np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert rover.navigator.is_clear(np.array([[1.0, 0.0], [1.0, 1.0]]))


def test_ground_on_the_way_is_unseen_until_it_is_mapped_or_was_looked_at():
    navigator = Rolling().navigator
    ground, path = navigator.ground.newest, np.array([[0.0, 0.0], [0.0, 2.0]])
    centres = ground.grid.centres
    ground.heights[...] = 0.0
    hidden = np.hypot(centres[..., 0] - 0.1, centres[..., 1] - 0.7) < 0.1
    ground.heights[hidden] = np.nan
    point = navigator.unseen(path)
    assert point is not None
    np.testing.assert_allclose(point[:2], [0.1, 0.7], atol=0.05)
    assert navigator.unseen(path, 0.2) is None  # Not as far as that.
    assert navigator.unseen(np.array([[0.0, 0.0], [0.0, -2.0]])) is None
    navigator.looked()
    assert navigator.unseen(path) is not None
    navigator.looked()  # What no look has shown is behind something.
    assert navigator.unseen(path) is None
    ground.heights[np.hypot(*np.moveaxis(centres, -1, 0)) < 0.25] = np.nan
    assert navigator.unseen(path) is None  # The rover stands there.


def test_a_drive_stops_before_ground_that_was_not_seen():
    rover = Rolling()
    ground = rover.navigator.ground.newest
    centres = ground.grid.centres
    ground.heights[centres[..., 1] < 1.2] = 0.0
    assert rover.navigator.set_off(np.array([0.0, 2.0]), None)
    for tick in range(3000):
        if rover.navigator.waits:
            break
        if tick % 50 == 0:
            rover.navigator.correct()
        rover.wheels = np.array(rover.navigator.step(rover.seen).wheels)
        rover.seen = rover.tick()
    assert rover.navigator.waits and not rover.navigator.arrived
    assert 0.5 < rover.navigator.place[1] < 0.85


def test_paths_lead_around_what_is_mapped_unless_the_navigator_is_blind():
    for blind in (False, True):
        rover = Rolling("paths" if blind else "")
        put_box(rover.navigator, 0.0, 1.0)
        assert rover.navigator.set_off(np.array([0.0, 2.0]), None)
        places = rover.drive()
        nearest = np.linalg.norm(places - [0.0, 1.0], axis=1).min()
        assert nearest < 0.05 if blind else nearest > 0.3


@pytest.mark.parametrize("without", ["", "guard"])
def test_drives_are_slow_where_it_is_steep_and_end_where_it_is_too_steep_unless_unguarded(without):
    """At 22.5 degrees, half way between both limits, five eighths of the speed are left."""
    flat, inclined, steep = (
        Rolling(without, (math.radians(tilt), 0.0)) for tilt in (0.0, 22.5, 35.0)
    )
    for rover in (flat, inclined, steep):
        assert rover.navigator.set_off(np.array([0.0, 1.0]), None)
        places = rover.drive(3.0)
        rover.speed = np.ptp(places[-50:, 1]) / 0.49
    # A level metre is longer on a slope.
    share = inclined.speed / math.cos(math.radians(22.5)) / flat.speed
    assert share == pytest.approx(1.0 if without else 0.625, abs=0.01)
    steep.tilt = np.zeros(2)
    steep.drive(3.5)
    steep.tilt = np.array([math.radians(35.0), 0.0])
    steep.drive(10.0)
    assert steep.navigator.blocked == ("" if without else "tilted beyond 30 degrees")


def test_a_place_on_an_obstacle_has_no_path_and_one_behind_it_a_longer_one():
    rover = Rolling()
    put_box(rover.navigator, 0.0, 1.0)
    lengths = rover.navigator.lengths_to(np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 0.0]]))
    assert np.isinf(lengths[0])
    usual = 1.0 + NavigatorConfig().paths.unknown_cost
    assert 2.02 < usual * lengths[1] < 2.6
    assert usual * lengths[2] == pytest.approx(1.0, abs=0.1)
    high = rover.navigator.high_places()
    assert len(high) and np.abs(high[:, :2] - [0.0, 1.0]).max() < 0.12


def test_a_rover_that_its_map_encloses_forgets_it_and_has_a_path_again():
    navigator, place = Rolling().navigator, np.array([0.0, 1.5])
    put_box(navigator, 0.0, 0.0, half=2.0, height=0.3)
    put_box_on(navigator, 0.0, 0.0, half=0.4, height=0.0)  # It stands in a pit that is not there.
    assert navigator.path_to(place) is None
    navigator.back_off(held=False)
    assert navigator.arrived
    navigator.forget()
    assert navigator.path_to(place) is not None and not navigator.ground.known.any()


def test_what_held_a_rover_is_rather_gone_around_after_it_backed_off():
    rover = Rolling()
    put_box(rover.navigator, 5.0, 5.0)
    assert rover.navigator.set_off(np.array([0.0, 2.0]), None)
    rover.navigator.back_off(held=True)
    rover.drive()
    assert rover.navigator.place[1] < -0.15
    assert rover.navigator.set_off(np.array([0.0, 2.0]), None)
    places = rover.drive(seconds=120.0)
    ahead = [0.0, NavigatorConfig().paths.radius + 0.1]
    assert np.linalg.norm(places - ahead, axis=1).min() > 0.3
    assert math.dist(places[-1], (0.0, 2.0)) < 0.05
    # Where there is no other way, it is tried once more.
    for x in (-0.7, 0.7):
        put_box_on(rover.navigator, x, ahead[1], half=0.3)
    lengths = rover.navigator.lengths_to(np.array([[0.0, -0.2]]))
    assert 3.0 < (1.0 + NavigatorConfig().paths.unknown_cost) * lengths[0] < 12.0


def test_a_rover_that_could_not_turn_at_a_place_twice_turns_elsewhere():
    """Its path leads over the place where it backed off once, and around it from then on."""
    rover = Rolling()
    put_box(rover.navigator, 5.0, 5.0)
    goal = np.array([0.0, 2.0])
    for tried, straight in ((1, True), (2, False)):
        rover.navigator.back_off(held=False)
        rover.drive()
        assert rover.navigator.place[1] < -0.2
        path = rover.navigator.path_to(goal)
        assert path is not None
        between = np.linspace(path[:-1], path[1:], 50).reshape(-1, 2)
        away = np.linalg.norm(between, axis=1).min()
        assert (away < 0.05) == straight and (straight or away > 0.25), tried
        rover.navigator.follow(np.array([rover.navigator.place, [0.0, 0.0]]), 0.0)
        rover.drive()


def test_a_rover_backs_off_where_there_is_room_for_that():
    for boxes, expected in (((), -0.25), ((-0.45,), 0.25), ((-0.45, 0.45), 0.0)):
        rover = Rolling()
        put_box(rover.navigator, 5.0, 5.0)
        for y in boxes:
            put_box_on(rover.navigator, 0.0, y)
        rover.navigator.back_off(held=False)
        rover.drive()
        assert rover.navigator.place[1] == pytest.approx(expected, abs=0.03)


def test_a_rover_beside_something_backs_off_away_from_it():
    for box, expected in ((0.3, -0.25), (-0.3, 0.25)):
        rover = Rolling()
        put_box(rover.navigator, 5.0, 5.0)
        put_box_on(rover.navigator, 0.0, box)
        assert not rover.navigator.is_clear(rover.navigator.place[None])
        rover.navigator.back_off(held=False)
        rover.drive()
        assert rover.navigator.place[1] == pytest.approx(expected, abs=0.03)


def test_a_turn_ends_where_the_rover_slides_towards_something():
    for box, slides in ((0.42, True), (1.0, False)):
        rover = Rolling()
        put_box(rover.navigator, box, 0.0)
        rover.navigator.follow(np.zeros((1, 2)), 2.0)
        for _ in range(100):
            rover.wheels = np.array(rover.navigator.step(rover.seen).wheels)
            rover.seen = rover.tick()
        odometry = rover.navigator.odometry
        odometry._pose = RigidTransform.from_translation([0.08, 0.0, 0.0]) * odometry.pose()  # pyright: ignore
        odometry._at = odometry._pasts[-1]  # pyright: ignore
        rover.navigator.correct()
        assert bool(rover.navigator.blocked) == slides and not rover.navigator.held


def test_a_rover_that_turns_from_one_path_to_another_on_the_spot_stops(monkeypatch):
    rover = Rolling()
    put_box(rover.navigator, 5.0, 5.0)
    assert rover.navigator.set_off(np.array([0.0, 2.0]), None)
    for turn in range(1, 9):
        aside = np.array([[0.0, 0.0], [0.5 * (-1.0) ** turn, 1.0], [0.0, 2.0]])
        monkeypatch.setattr(rover.navigator, "path_to", lambda *_, path=aside: path)
        rover.navigator.correct()
        assert bool(rover.navigator.blocked) == (turn > 6) and not rover.navigator.held


def taken():
    """A rover that has just taken a pair."""
    rover = Rolling()
    rover.navigator._taken = (0.0, 0.0)  # pyright: ignore
    rover.navigator._stamp = rover.time  # pyright: ignore
    rover.seen = rover.tick()
    return rover


def test_a_pair_is_due_after_some_time_however_little_the_wheels_turn():
    rover = taken()
    ticks = 1
    while not rover.navigator.is_due(rover.seen):
        rover.seen = rover.tick()
        ticks += 1
    assert 0.01 * ticks == pytest.approx(NavigatorConfig().longest, abs=0.03)


def test_a_pair_is_due_after_some_way_or_turn():
    rover = taken()
    assert not rover.navigator.is_due(rover.seen)
    rolling = SkidSteer.of(ROBOT, rover.navigator.odometry.turn_share)
    for forward, turn in ((0.2, 0.0), (0.0, 0.3)):
        rover = taken()
        rover.wheels = rolling.wheel_speeds(forward, turn)
        ticks = 0
        while not rover.navigator.is_due(rover.seen):
            rover.seen = rover.tick()
            ticks += 1
        far, angle = NavigatorConfig().apart
        # Turns count as if the wheels slipped little.
        expected = far / forward if forward else angle / turn * rolling.turn_share / 0.6
        assert 0.01 * ticks == pytest.approx(expected, rel=0.1)


def test_drawn_initial_poses_fill_their_limits():
    rng = np.random.default_rng(0)
    poses = SITE.draw_initial_poses("rover1", 4000, rng) - np.array(POSES["rover1"])
    low, high = typing.cast(typing.Any, (poses.min(axis=0), poses.max(axis=0)))
    np.testing.assert_allclose(-low, 0.5, atol=0.01)
    np.testing.assert_allclose(high, 0.5, atol=0.01)


def test_paths_lead_around_what_the_other_rover_has_mapped_where_nothing_is_known():
    rover = Rolling()
    received = Rolling().navigator
    put_box(received, 0.0, 1.0)
    assert len(rover.navigator.path_to(np.array([0.0, 2.0]))) == 2
    rover.navigator.received = received.ground.newest
    assert len(rover.navigator.path_to(np.array([0.0, 2.0]))) > 2
    # What the rover has seen itself counts.
    put_box(rover.navigator, 5.0, 5.0)
    assert len(rover.navigator.path_to(np.array([0.0, 2.0]))) == 2
    assert not rover.navigator.high_places().size


def test_a_turn_on_a_slope_needs_room_downhill():
    """Nose up by 9 degrees, downhill is behind it."""
    for pitch, box, angle, free in (
        (0.15, -0.40, 1.5, False),
        (0.15, 0.45, 1.5, True),
        (0.15, -0.40, 0.2, True),
        (0.0, -0.40, 1.5, True),
        (-0.15, 0.40, 1.5, False),
    ):
        rover = Rolling(tilt=(pitch, 0.0))
        put_box(rover.navigator, 0.0, box)
        assert rover.navigator.may_turn(angle) == free
        assert rover.navigator.may_turn(-angle) == free


@pytest.mark.parametrize(("slide", "free"), [(0.2, True), (1.5, False)])
def test_a_rover_that_has_slid_far_needs_more_room_to_turn(slide, free):
    """Nose up by 6 degrees; what is to be kept off stands 0.4 m behind."""
    rover = Rolling(tilt=(0.1, 0.0))
    put_box(rover.navigator, 0.0, -0.45)
    rover.navigator.odometry.slide = slide
    assert rover.navigator.may_turn(1.3) == free


def test_a_rover_that_slips_on_its_path_goes_straight_on_before_it_steers_again():
    rover = Rolling()
    put_box(rover.navigator, 5.0, 5.0)
    navigator = rover.navigator
    assert navigator.set_off(np.array([1.2, 2.0]), None)
    for _ in range(400):
        rover.wheels = np.array(navigator.step(rover.seen).wheels)
        rover.seen = rover.tick()
    navigator._slips = 2  # pyright: ignore
    navigator.correct()
    yaw, place = navigator.yaw, navigator.place
    assert not navigator.blocked
    ahead = navigator.course[-1] - place
    assert math.atan2(-ahead[0], ahead[1]) == pytest.approx(yaw, abs=0.01)
    assert np.linalg.norm(ahead) == pytest.approx(0.7, abs=0.01)
    while not navigator.arrived and rover.time < 60.0:
        rover.wheels = np.array(navigator.step(rover.seen).wheels)
        rover.seen = rover.tick()
        if round(100.0 * rover.time) % 100 == 0:
            navigator.correct()
    assert math.dist(navigator.place, (1.2, 2.0)) < 0.04


def test_a_rover_that_slips_before_something_does_not_go_straight_on():
    rover = Rolling()
    put_box(rover.navigator, 0.0, 0.45)
    assert rover.navigator.set_off(np.array([1.0, 0.0]), None)
    for _ in range(50):
        rover.wheels = np.array(rover.navigator.step(rover.seen).wheels)
        rover.seen = rover.tick()
    rover.navigator._drive._phase = type(rover.navigator._drive._phase).FOLLOW  # pyright: ignore
    rover.navigator._slips = 3  # pyright: ignore
    assert rover.navigator.blocked and rover.navigator.held


def test_a_rover_that_backs_off_again_from_the_same_place_goes_farther():
    rover = Rolling()
    put_box(rover.navigator, 5.0, 5.0)
    for expected in (-0.25, -0.75):
        rover.navigator.back_off(held=False)
        rover.drive(rover.time + 10.0)
        assert rover.navigator.place[1] == pytest.approx(expected, abs=0.03)
        back = RigidTransform.identity()  # It has slid to where it was.
        rover.navigator.odometry._pose = back  # pyright: ignore
        rover.navigator.odometry._at = rover.navigator.odometry._pasts[-1]  # pyright: ignore


@pytest.mark.parametrize(("without", "again"), [("", True), ("panel", False)])
def test_the_panel_localizes_a_rover_again_unless_that_is_left_out(monkeypatch, without, again):
    rover, found = Rolling(without), object()
    navigator = rover.navigator
    monkeypatch.setattr(navigator._panel, "locate", lambda *_: found)  # pyright: ignore
    monkeypatch.setattr(navigator._panel, "sight", lambda *_: None)  # pyright: ignore

    def take():
        seen = rover.tick()
        grey = np.zeros((2, CAMERA.height, CAMERA.width), np.uint8)
        return navigator.take(seen._replace(stereo=seen.stereo._replace(value=grey)), at_rest=True)

    assert take() is found
    navigator.localized = True
    navigator._panel.transform_target_to_world = RigidTransform.identity()  # pyright: ignore
    assert (take() is found) == again


def test_an_astray_rover_stops_and_maps_nothing_until_it_resigns(monkeypatch):
    rover, mapped = Rolling(), []
    navigator = rover.navigator
    monkeypatch.setattr(navigator, "_map", lambda *_: mapped.append(True))
    grey = np.zeros((2, CAMERA.height, CAMERA.width), np.uint8)
    for astray, maps in ((0, True), (0, True), (1, False), (0, True)):
        navigator.follow(np.array([[0.0, 0.0], [0.0, 1.0]]), None)
        for _ in range(50):
            rover.wheels = np.array(navigator.step(rover.seen).wheels)
            rover.seen = rover.tick()
        navigator.odometry.astray = astray
        mapped.clear()
        navigator.take(rover.seen._replace(stereo=rover.seen.stereo._replace(value=grey)), False)
        # Of grey pairs each one shows nothing known, and counts.
        assert bool(mapped) == (navigator.odometry.astray < 2) == maps
        navigator.correct()
        for _ in range(100):
            rover.wheels = np.array(navigator.step(rover.seen).wheels)
            rover.seen = rover.tick()
        assert navigator.waits == (not maps)
        navigator.resign()
        assert not navigator.astray


def level_view(camera, rng):
    """Return the points of level ground ahead of a camera, in its frame."""
    ahead = camera.rotation.apply([0.0, 0.0, 1.0])[:2]
    ahead /= np.linalg.norm(ahead)
    far, aside = rng.uniform(0.4, 1.3, 4000), rng.uniform(-0.5, 0.5, 4000)
    across = np.array([ahead[1], -ahead[0]])
    flat = camera.translation[:2] + far[:, None] * ahead + aside[:, None] * across
    points = camera.apply(np.column_stack([flat, np.zeros(len(far))]), inverse=True)
    covariances = np.broadcast_to(np.diag([1e-6, 1e-6, 1e-5]), (len(points), 3, 3))
    empty = np.zeros((len(points), 2)), np.zeros(len(points)), np.zeros(len(points))
    return StereoPoints(np.asarray(points), covariances, *empty)


def localized_at(navigator, rise):
    """Return a localization where the rover believes to be, but so high above its beginning."""
    place = RigidTransform.from_translation([*navigator.place, rise])
    arm, _ = camera_arm(ROBOT)
    return RobotLocalization(arm, place, 1e-6 * np.eye(6), np.zeros((6, 10)))


def test_what_was_mapped_higher_before_stands_in_no_way_of_a_rover_that_sees_it_is_not():
    rover, rng = Rolling(), np.random.default_rng(1)
    navigator = rover.navigator
    camera = navigator.odometry.camera(rover.seen.time)[0]
    sure = np.diag(np.square([0.002, 0.002, 0.01, 0.01, 0.01, 0.01]))
    for _ in range(3):
        navigator._map(rover.seen, level_view(camera, rng), camera, sure)  # pyright: ignore
    before = navigator.ground.newest
    left = navigator.ground.grid.centres[..., 0] < 0.0
    before.heights[left] += 0.1
    cliff = len(navigator.high_places())
    assert cliff > 100
    before.heights[~left] -= 1e-9  # So that no rise is as it was.
    navigator._map(rover.seen, level_view(camera, rng), camera, sure)  # pyright: ignore
    assert navigator.ground.maps[1] is before
    assert len(navigator.high_places()) < 0.05 * cliff  # At the view's edge.
    np.testing.assert_allclose(navigator.heights[navigator.ground.newest.known], 0.0, atol=0.01)
    # What it does not show now is known as before, and another such view goes on as usual.
    known = navigator.ground.known.sum()
    navigator._map(rover.seen, level_view(camera, rng), camera, sure)  # pyright: ignore
    assert len(navigator.ground.maps) == 2 and navigator.ground.known.sum() >= known


def test_a_rover_whose_height_drifts_maps_level_ground_as_level_and_where_it_believes_it():
    """By 0.6 m on its way there and back, beyond what the fit of one view to the map allows."""
    rover, rng = Rolling(), np.random.default_rng(0)
    navigator = rover.navigator
    camera = navigator.odometry.camera(rover.seen.time)[0]
    sure = np.diag(np.square([0.02, 0.02, 0.02, 0.02, 0.02, 0.1]))
    for step in range(61):
        way = 0.1 * min(step, 60 - step)
        true = RigidTransform.from_translation([0.0, way, 0.0]) * camera
        sunk = RigidTransform.from_translation([0.0, 0.0, -0.01 * step])
        navigator._map(rover.seen, level_view(true, rng), sunk * true, sure)  # pyright: ignore
    known = navigator.ground.known
    assert np.count_nonzero(known) > 3000
    assert np.ptp(navigator.ground.heights[known]) < 0.02
    assert not navigator.high_places().size
    np.testing.assert_allclose(navigator.heights[known], -0.6, atol=0.02)
    navigator.localize(localized_at(navigator, rise=0.6))
    np.testing.assert_allclose(navigator.heights[navigator.ground.known], 0.0, atol=0.02)
    navigator.localize(localized_at(navigator, rise=0.3))
    np.testing.assert_allclose(navigator.heights[navigator.ground.known], -0.3, atol=0.02)
