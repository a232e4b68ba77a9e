"""What a robot of the mission believes, where its camera is placed by the map, and how it waits."""

import math
import types
import typing

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.insertion.camera_station import CameraStation, camera_arm, stereo_geometry
from controllers.mapping.localization import RobotLocalization, level_target, tilt_to_level
from controllers.mapping.shared_map import SharedMap
from controllers.mission.belief import MissionBelief, drawn_turn_share, tilt_of
from controllers.mission.exchange import Exchange, SlotPose, TurnShare
from controllers.mission.robot_mission import RobotMission
from controllers.mission.site import SiteDrawing
from controllers.mission.stages.find import VOXEL, FindPanel
from controllers.mission.stages.place import PlaceCamera, choose_station, mapped_ground
from controllers.mission.stages.rest import Rest
from controllers.motion.drive_to_pose import DriveToPose
from controllers.motion.driving import SkidSteer
from experiments.ch5.insertion_scene import best_station
from experiments.mission.scene import INITIAL_POSES, MASTER, SLAVE, draw_scene, roles, survey
from models.datasheets import CARD_AND_SLOT, ROVER
from perception.registration.target import TargetCad
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import Surface, VoxelMap
from tests.controllers.motion.seen import seen_at
from twin.robot import Observation, RobotError

WIDTH = CARD_AND_SLOT.slot_widths[-1]
ROLES = roles()
ARM = camera_arm(ROLES.master)[0]


@pytest.fixture(scope="module")
def site() -> SiteDrawing:
    rng = np.random.default_rng(3)
    return survey(draw_scene(WIDTH, rng), rng)


def master_of(site: SiteDrawing) -> MissionBelief:
    return MissionBelief.initial(ROLES.master, ROLES.slave, site)


def test_slot_is_drawn_where_a_rover_at_its_nominal_place_would_have_it(site: SiteDrawing) -> None:
    belief = master_of(site)
    x, y, yaw = INITIAL_POSES[SLAVE]
    assert (x, yaw) == (0.0, 0.0)
    # Straight ahead of the slave, as high as the slot is above a robot's origin.
    ahead = [0.0, -y, site.insertion.transform_slot_to_ground.translation[2] - ROVER.centre_height]
    np.testing.assert_allclose(
        belief.partner.transform_slot_to_robot.translation, ahead, atol=1e-12
    )
    # The master faces -x: its left is -y.
    master_x, master_y, _ = INITIAL_POSES[MASTER]
    np.testing.assert_allclose(
        belief.transform_slot_to_level.translation[:2],
        [-master_y * -1.0 * -1.0, master_x],
        atol=1e-12,
    )


def test_localization_and_the_site_drawing_give_the_slot_pose(site: SiteDrawing) -> None:
    level = RigidTransform.from_components([0.7, -0.4, 0.1], Rotation.from_euler("z", 1.4))
    to_level = level.inv() * site_panel(site)
    to_world = level_target(to_level)
    level_to_world = to_world * to_level.inv()
    belief = master_of(site)
    belief.map = _map(site.target)
    belief.map.transform_target_to_world = to_world
    localization = RobotLocalization(ARM, level_to_world, np.zeros((6, 6)), np.zeros((6, 10)))
    belief.localize(localization)
    expected = to_level * site.transform_slot_to_panel
    np.testing.assert_allclose(
        belief.transform_slot_to_level.as_matrix(),
        expected.as_matrix(),
        atol=1e-12,
    )
    # All that is left is the drawing's error, seen from the robot.
    sigma = np.sqrt(np.trace(belief.slot_covariance[:3, :3]))
    assert sigma == pytest.approx(np.sqrt(np.trace(site.covariance[:3, :3])))


def _map(target: TargetCad) -> SharedMap:
    voxels = VoxelMap(VoxelGrid(VOXEL, (-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)))
    return SharedMap(voxels, stereo_geometry(ROLES.master), target, 4, (0.25, 2.0))


def test_slot_in_a_tilted_rover_is_moved_by_its_tilt(site: SiteDrawing) -> None:
    belief = master_of(site)
    tilt = np.array([0.06, -0.03])
    slot, _ = belief.slot_in_robot(tilt)
    back = tilt_to_level(tilt) * slot
    np.testing.assert_allclose(
        back.as_matrix(), belief.transform_slot_to_level.as_matrix(), atol=1e-12
    )


Drives = list[tuple[np.ndarray, typing.Callable[[np.ndarray], bool]]]


@pytest.fixture
def drives(monkeypatch: pytest.MonkeyPatch) -> Drives:
    """Return a list that gets each drive's goal, and its function for whether a pose is free."""
    drives: Drives = []
    begin = DriveToPose.__init__

    def note(self: DriveToPose, steer: SkidSteer, goal: np.ndarray, free: typing.Any) -> None:
        drives.append((np.array(goal), free))
        begin(self, steer, goal, free=free)

    monkeypatch.setattr(DriveToPose, "__init__", note)
    return drives


def test_drive_goal_is_the_camera_station_in_the_robot_frame(
    site: SiteDrawing, drives: Drives
) -> None:
    belief = master_of(site)
    x, y, yaw = INITIAL_POSES[MASTER]
    PlaceCamera(belief, CameraStation((x, y, yaw), np.zeros(4), 0.5, 0.0))
    np.testing.assert_allclose(drives[0][0], np.zeros(3), atol=1e-12)
    PlaceCamera(belief, CameraStation((x - 0.3, y, yaw + 0.2), np.zeros(4), 0.5, 0.0))
    # It looks along -x: 0.3 m less of x is 0.3 m ahead.
    np.testing.assert_allclose(drives[1][0], [0.0, 0.3, 0.2], atol=1e-12)


def _with_map(site: SiteDrawing, points: np.ndarray) -> MissionBelief:
    """Return belief whose map holds points of the level ground below the slot [m]."""
    belief = master_of(site)
    level_to_world = RigidTransform.from_components([0.3, 0.2, 0.1], Rotation.from_euler("z", 0.5))
    localization = RobotLocalization(ARM, level_to_world, np.zeros((6, 6)), np.zeros((6, 10)))
    to_world = (
        level_to_world
        * belief.transform_slot_to_level
        * site.insertion.transform_slot_to_ground.inv()
    )
    surface = Surface(
        to_world.apply(points), np.tile(1e-8 * np.eye(3), (len(points), 1, 1)), np.ones(len(points))
    )
    shared = types.SimpleNamespace(voxels=types.SimpleNamespace(surface=lambda: surface))
    belief.map, belief.localization = typing.cast(SharedMap, shared), localization
    return belief


def test_camera_station_is_clear_of_mapped_obstacles(site: SiteDrawing) -> None:
    free = best_station(WIDTH)
    x, y, _ = free.place
    stake = np.array([[x + 0.1, y, z] for z in (0.15, 0.2, 0.25, 0.3)])
    assert not mapped_ground(_with_map(site, stake)).is_free(free.place[:2])
    other = choose_station(_with_map(site, stake))
    assert math.dist(other.place[:2], (x + 0.1, y)) > 0.29


def test_the_master_does_not_back_off_into_mapped_obstacles(
    site: SiteDrawing, drives: Drives
) -> None:
    x, y, yaw = INITIAL_POSES[MASTER]
    # It looks along -x: behind it is +x, and +y lies to its right.
    stake = np.array([[x + 0.4, y + 0.1, z] for z in (0.15, 0.2, 0.25, 0.3)])
    PlaceCamera(_with_map(site, stake), CameraStation((x, y, yaw), np.zeros(4), 0.5, 0.0))
    ((_, free),) = drives
    assert not free(np.array([0.1, -0.4, 0.0]))
    assert not free(np.array([0.0, -0.2, 0.3]))
    assert free(np.array([-0.3, -0.4, 0.0])) and free(np.array([0.1, 0.4, 0.0]))


def test_stones_that_a_rover_drives_over_do_not_block(site: SiteDrawing) -> None:
    free = best_station(WIDTH)
    x, y, _ = free.place
    stones = np.array([[x + d, y, 0.04] for d in (-0.1, 0.0, 0.1, 0.2)])
    assert mapped_ground(_with_map(site, stones)).is_free(free.place[:2])
    assert choose_station(_with_map(site, stones)).place == free.place


def test_what_the_map_has_before_the_slot_moves_the_camera(site: SiteDrawing) -> None:
    free = best_station(WIDTH)
    middle = np.array([0.0, -0.08, site.insertion.transform_slot_to_ground.translation[2]])
    # A board half way to where the camera would be, too high to touch the rover.
    ahead = np.array([math.cos(free.slant), 0.0, 0.0]) * 0.5 * free.distance
    board = (
        middle
        + ahead
        + 0.02
        * np.stack(
            np.meshgrid([0.0], np.arange(-3, 4), np.arange(8, 12), indexing="ij"), axis=-1
        ).reshape(-1, 3)
    )
    assert choose_station(_with_map(site, board)).place != free.place


def test_a_missing_inclinometer_stops_the_mission_with_its_name() -> None:
    with pytest.raises(RobotError, match="inclinometer of rover1 is missing"):
        tilt_of(Observation(0.0), MASTER)


def site_panel(site: SiteDrawing) -> RigidTransform:
    """Return the panel in the ground frame, as drawn."""
    return site.insertion.transform_slot_to_ground * site.transform_slot_to_panel.inv()


def test_map_of_the_master_holds_the_site_from_the_ground_to_above_the_slot(
    site: SiteDrawing,
) -> None:
    stage = FindPanel(master_of(site), 4, np.random.default_rng(0))
    grid = stage.mapper.shared.voxels.grid
    # The map is level, and its origin is the panel.
    height = site_panel(site).translation[2]
    slot = site.insertion.transform_slot_to_ground.translation[2]
    assert grid.lower[2] < 0.0 - height and slot + 0.3 - height < grid.upper[2]
    places = [*site.initial_poses.values(), (0.0, 0.0, 0.0)]
    far = max(
        np.hypot(*(np.array(place[:2]) - site_panel(site).translation[:2])) for place in places
    )
    assert np.all(np.array(grid.lower[:2]) < -far) and np.all(np.array(grid.upper[:2]) > far)


def test_robot_adopts_the_estimates_of_its_partner(site: SiteDrawing) -> None:
    belief, exchange = master_of(site), Exchange({})
    drawn = belief.partner.transform_slot_to_robot
    belief.receive(exchange, SLAVE)
    assert (
        belief.partner.transform_slot_to_robot is drawn
        and belief.turn_share == drawn_turn_share(belief.robot)
    )
    pose = SlotPose(RigidTransform.from_translation([0.1, 0.9, 0.2]), np.eye(6), met=True)
    exchange.post(SLAVE, pose)
    exchange.post(SLAVE, TurnShare(0.7, 0.04))
    belief.receive(exchange, SLAVE)
    assert belief.partner is pose and belief.turn_share.share == 0.7
    # The other robot's wheels are not its own.
    assert 0.04 < belief.turn_share.deviation < 0.06
    assert belief.steer().turn_sigma == belief.turn_share.deviation
    # A message of the other robot's is not its own.
    assert exchange.read(MASTER, SlotPose) is None


def test_stage_ends_for_both_in_the_tick_after_both_are_done(site: SiteDrawing) -> None:
    exchange = Exchange({})
    beliefs = master_of(site), MissionBelief.initial(ROLES.slave, ROLES.master, site)
    parts = []
    for belief, partner in zip(beliefs, (SLAVE, MASTER), strict=True):
        stages = [Rest(belief, "one"), Rest(belief, "two")]
        parts.append(RobotMission(belief, partner, exchange, iter(stages)))
    slow = parts[0].stage
    slow.done = False
    for tick in range(8):
        seen = seen_at(0.01 * tick)
        slow.done = tick >= 3
        for part in parts:
            part.report(seen)
        for part in parts:
            part.step(seen)
        assert [part.stage.name for part in parts] == ["one" if tick < 3 else "two"] * 2
        assert [part.over for part in parts] == [tick > 3] * 2
    assert parts[0].ended == parts[1].ended == ["one", "two"]
