"""A rover brings its camera where it should be, or says why not."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.arm_inverse import ArmGeometry, arm_solutions, standing_views
from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.looking import RobotBrief
from controllers.placement.reach.footprint import Part, pose_drives
from controllers.placement.reach.ground import Ground, drives
from controllers.placement.reach.reach import Reach, RoverState, plan_reach
from controllers.placement.task import PlacementError, View
from models.compose import FieldConfig, RobotPlacement, make_model
from models.datasheets import ARM
from twin.describe import describe

MODEL = make_model(FieldConfig(texture_pixels=64), [RobotPlacement("rover1")])
DRAWN = describe(MODEL, "rover1")
STRAIGHT = SerialChain.of_robot(DRAWN)
OFF = RigidTransform.from_exp_coords([0.02, 0.03, -0.05, 0.01, 0.01, 0.02])
SQUINTING = dataclasses.replace(
    STRAIGHT, transform_tool_to_link=STRAIGHT.transform_tool_to_link * OFF
)
HOME = np.array(ARM.home)
BRIEF = RobotBrief(STRAIGHT, HOME, DRAWN.body_spheres)
HEIGHT = 0.0635
HERE = RoverState(RigidTransform.from_translation([0.0, 0.0, HEIGHT]), HOME)
RADIUS = 0.28


def looks(arm, angles, target):
    """Return the cameras' places, and how far their axes pass the target over the distance."""
    pose = arm.tool_in_robot(angles)
    ahead = target - pose.translation
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    return pose.translation, np.abs(pose.rotation.apply([0.0, 0.0, 1.0]) - ahead).max()


@pytest.mark.parametrize("arm", [STRAIGHT, SQUINTING], ids=["straight", "squinting"])
def test_solutions_hold_the_true_angles_and_all_look_at_the_target(arm):
    rng = np.random.default_rng(0)
    for _ in range(40):
        angles = rng.uniform(*arm.limits.T)
        pose = arm.tool_in_robot(angles)
        target = pose.apply([0.0, 0.0, rng.uniform(0.1, 1.0)])
        found = arm_solutions(arm, pose.translation, target)
        assert 1 <= len(found) <= 4
        assert np.abs(found - angles).max(axis=1).min() < 1e-6
        for solution in found:
            place, off = looks(arm, solution, target)
            assert np.abs(place - pose.translation).max() < 1e-9 and off < 1e-9
            assert np.all((arm.limits[:, 0] <= solution) & (solution <= arm.limits[:, 1]))


def test_camera_straight_above_the_target_is_solved():
    angles = np.array([0.4, 1.0, -1.2, -np.pi / 2 + 0.2])
    pose = STRAIGHT.tool_in_robot(angles)
    target = pose.translation - [0.0, 0.0, 0.15]
    found = arm_solutions(STRAIGHT, pose.translation, target)
    assert np.abs(found - angles).max(axis=1).min() < 1e-6
    for solution in found:
        place, off = looks(STRAIGHT, solution, target)
        assert np.abs(place - pose.translation).max() < 1e-9 and off < 1e-9


def test_camera_beside_the_arm_s_plane_or_too_far_has_no_solution():
    pose = STRAIGHT.tool_in_robot(HOME)
    target = pose.apply([0.0, 0.0, 0.4])
    beside = pose.apply([0.01, 0.0, 0.0])
    assert len(arm_solutions(STRAIGHT, beside, target)) == 0
    far = pose.translation + [0.0, 1.0, 0.0]
    assert len(arm_solutions(STRAIGHT, far, far + [0.0, 0.3, 0.0])) == 0


def test_bad_questions_are_refused():
    with pytest.raises(ValueError, match="stands at the target"):
        arm_solutions(STRAIGHT, [0.0, 0.4, 0.2], [0.0, 0.4, 0.2])
    with pytest.raises(ValueError, match="finite"):
        arm_solutions(STRAIGHT, [0.0, np.nan, 0.2], [0.0, 0.4, 0.2])
    turned = dataclasses.replace(STRAIGHT.joints[2], axis=(0.0, 1.0, 0.0))
    odd = dataclasses.replace(STRAIGHT, joints=(*STRAIGHT.joints[:2], turned, STRAIGHT.joints[3]))
    with pytest.raises(ValueError, match="hinge 2"):
        ArmGeometry.of(odd)


@pytest.mark.parametrize("arm", [STRAIGHT, SQUINTING], ids=["straight", "squinting"])
def test_standing_rover_s_views_look_at_the_target_from_the_distances_asked_for(arm):
    target = np.array([0.25, 0.6, 0.2])
    wanted = np.array([0.15, 0.25, 0.4])
    views = standing_views(arm, target, wanted, np.linspace(-np.pi, np.pi, 90, endpoint=False))
    place, off = looks(arm, views.angles, target)
    assert len(place) > 50 and off < 1e-9
    np.testing.assert_allclose(place, views.positions)
    distance = np.linalg.norm(target - place, axis=1)
    assert np.abs(distance[:, None] - wanted).min(axis=1).max() < 1e-9


def ground(free, known=None):
    """Return 3 x 3 m about the origin: free where a function of x, y says so."""
    axis = (np.arange(150) + 0.5) * 0.02 - 1.5
    x, y = np.meshgrid(axis, axis)
    chance = np.where(free(x, y), 0.01, 0.9)
    if known is not None:
        chance[~known(x, y)] = np.nan
    return Ground(chance, np.array([-1.5, -1.5]), 0.02)


def everywhere(x, y):
    return np.ones_like(x, dtype=bool)


def nothing(points):
    return np.zeros(len(points), dtype=bool)


EYE, TARGET = np.array([0.1, 0.9, 0.3]), np.array([0.4, 1.0, 0.15])


def check(plan, eye, target, collides):
    """Check a plan against the arm's own kinematics and the world."""
    there = plan.transform_robot_to_world
    pose = there * STRAIGHT.tool_in_robot(plan.angles)
    ahead = (target - eye) / np.linalg.norm(target - eye)
    assert np.abs(pose.translation - eye).max() < 1e-9
    assert np.abs(pose.rotation.apply([0.0, 0.0, 1.0]) - ahead).max() < 1e-9
    points = STRAIGHT.cover_points(plan.path).reshape(-1, 3)
    assert not collides(there.apply(points)).any()
    assert np.abs(np.diff(plan.path, axis=0)).max() <= 0.1 + 1e-12
    gap = np.linalg.norm(points[:, None] - BRIEF.body[:, :3], axis=2).min()
    assert gap >= STRAIGHT.cover_radius


def test_rover_drives_to_where_its_arm_reaches_the_view():
    drive = drives(ground(everywhere), [0.0, 0.0], RADIUS, 2.0)
    plan = plan_reach(BRIEF, HERE, drive, nothing, EYE, TARGET)
    check(plan, EYE, TARGET, nothing)
    straight = np.linalg.norm(plan.way[-1] - plan.way[0])
    assert straight <= plan.length <= 1.09 * straight + 0.03
    np.testing.assert_allclose(plan.way[-1], plan.transform_robot_to_world.translation[:2])
    np.testing.assert_allclose(plan.fold[0], HOME)
    np.testing.assert_allclose(plan.path[0], plan.fold[-1])


def test_rover_goes_round_a_wall_and_keeps_its_radius_from_it():
    def free(x, y):
        return (np.abs(y - 0.45) > 0.05) | (x > 0.6)

    blocked = drives(ground(free), [0.0, 0.0], RADIUS, 4.0)
    plan = plan_reach(BRIEF, HERE, blocked, nothing, np.array([-0.4, 1.2, 0.3]), TARGET - 0.2)
    assert plan.length > 1.5
    x, y = plan.way.T
    corner = np.hypot(np.maximum(x - 0.6, 0.0), np.maximum(np.abs(y - 0.45) - 0.05, 0.0))
    assert corner.min() >= RADIUS - 0.02


def test_no_way_leads_off_the_map():
    drive = drives(ground(everywhere), [0.0, 0.0], RADIUS, 2.0)
    for place in ([0.0, 9.0], [-9.0, -9.0]):
        with pytest.raises(ValueError, match="outside of the map"):
            drive.way(place)


def test_rover_that_is_near_enough_stays():
    pose = HERE.transform_robot_to_world * STRAIGHT.tool_in_robot(HOME + [0.5, 0.1, 0.0, 0.2])
    target = pose.apply([0.0, 0.0, 0.3])
    plan = plan_reach(BRIEF, HERE, None, nothing, pose.translation, target)
    assert plan.length == 0.0 and len(plan.fold) == 0
    check(plan, pose.translation, target, nothing)


def test_arm_goes_over_what_stands_in_the_straight_way():
    goal = HOME + [1.2, 0.0, 0.0, 0.0]
    pose = HERE.transform_robot_to_world * STRAIGHT.tool_in_robot(goal)

    def post(points):
        middle = HERE.transform_robot_to_world.apply([-0.22, 0.36, 0.0])
        near = np.hypot(*(points - middle)[:, :2].T) < 0.06
        return near & (points[:, 2] < 0.34)

    how = dataclasses.replace(Reach.__dataclass_fields__["config"].default_factory(), clear=0.0)
    target = pose.apply([0.0, 0.0, 0.3])
    plan = plan_reach(BRIEF, HERE, None, post, pose.translation, target, how)
    check(plan, pose.translation, target, post)
    assert plan.path[:, 1].max() > 1.25


def test_reason_names_what_is_in_the_way():
    unknown = drives(ground(everywhere, lambda x, y: y < 0.3), [0.0, 0.0], RADIUS, 2.0)
    with pytest.raises(PlacementError, match="none of .* standing places is known to be free"):
        plan_reach(BRIEF, HERE, unknown, nothing, EYE, TARGET)
    wall = drives(ground(lambda x, y: np.abs(y - 0.2) > 0.05), [0.0, -0.3], RADIUS, 4.0)
    with pytest.raises(PlacementError, match="no path of at most 4 m"):
        state = RoverState(RigidTransform.from_translation([0.0, -0.3, HEIGHT]), HOME)
        plan_reach(BRIEF, state, wall, nothing, np.array([0.1, 1.1, 0.3]), TARGET)
    free = drives(ground(everywhere), [0.0, 0.0], RADIUS, 2.0)
    with pytest.raises(PlacementError, match="beyond what the arm reaches"):
        plan_reach(BRIEF, HERE, free, nothing, EYE + [0.0, 0.0, 1.0], TARGET)
    with pytest.raises(PlacementError, match="would touch something"):
        plan_reach(BRIEF, HERE, free, lambda p: p[:, 2] > 0.2, EYE, TARGET)
    with pytest.raises(PlacementError, match="while the rover stays"):
        plan_reach(BRIEF, HERE, None, nothing, EYE, TARGET)
    with pytest.raises(ValueError, match="outside of the map"):
        drives(ground(everywhere), [9.0, 0.0], RADIUS, 2.0)


def test_rover_may_leave_the_ground_under_it_that_it_cannot_see():
    unseen = ground(everywhere, lambda x, y: np.hypot(x, y) > 0.27)
    drive = drives(unseen, [0.0, 0.0], RADIUS, 2.0)
    assert np.isfinite(drive.lengths(np.array([[0.0, 0.8]]))[1]).all()


def test_views_of_a_search_are_refused_until_one_can_be_taken():
    def view(place):
        return View("hole", np.asarray(place), 0.3, 1.0, 1.0, 1.0, 1.0, 0.0)

    drive = drives(ground(everywhere), [0.0, 0.0], RADIUS, 2.0)
    reach = Reach(BRIEF, HERE, drive, nothing, {"hole": TARGET}, most=2)
    assert not reach(view(EYE + [0.0, 0.0, 1.0]))
    assert not reach(view(EYE + [0.0, 0.0, 1.01])) and len(reach.refused) == 1
    assert reach(view(EYE)) and reach.plan is not None
    assert not reach(view(EYE + [0.0, 0.0, 2.0]))
    with pytest.raises(PlacementError, match="none of the 2 best views.*beyond what the arm"):
        reach(view(EYE))


def test_places_that_are_not_possible_are_refused_and_those_that_are_taken_are_possible():
    def here_and_there(x, y):
        return y < 0.75

    part = Part((-0.165, 0.165, -0.221, 0.221), ground(here_and_there))
    drive = pose_drives([part], [0.0, 0.0, 0.0], 2.0)
    reach = Reach(BRIEF, HERE, drive, nothing, {"hole": TARGET})
    rng = np.random.default_rng(0)
    eyes = rng.uniform([-0.6, 0.3, 0.05], [0.6, 1.4, 0.6], (60, 3))
    possible = reach.possible(eyes)
    taken = np.zeros(len(eyes), dtype=bool)
    for index, eye in enumerate(eyes):
        try:
            plan = plan_reach(BRIEF, HERE, drive, nothing, eye, TARGET)
        except PlacementError:
            continue
        check(plan, eye, TARGET, nothing)
        taken[index] = True
    assert taken.sum() > 10 and (~possible).sum() > 10
    assert np.all(possible[taken])
    stays = Reach(BRIEF, HERE, None, nothing, {"hole": TARGET}).possible(eyes)
    assert np.all(possible[stays]) and stays.sum() < possible.sum()


def test_plan_holds_for_a_rover_that_stands_turned():
    turned = RigidTransform.from_components([0.3, -0.2, HEIGHT], Rotation.from_euler("z", 2.0))
    drive = drives(ground(everywhere), [0.3, -0.2], RADIUS, 2.0)
    plan = plan_reach(BRIEF, RoverState(turned, HOME), drive, nothing, EYE, TARGET)
    check(plan, EYE, TARGET, nothing)
