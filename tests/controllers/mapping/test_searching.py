"""The search for the target covers all sides, and turns to possible markers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.arm_views import ViewConfig
from controllers.mapping.searching import TargetSearch, TargetSearchConfig
from controllers.mapping.stereo_view import MapperConfig
from models.datasheets import ARM
from perception.registration.target import PossibleMarkers
from twin.describe import describe_rover

HOME, SURVEY = np.array(ARM.home), np.array(ViewConfig().survey)
NOTHING = PossibleMarkers(np.zeros((0, 3)), np.zeros((0, 3)))
EXTENT = 0.35
LEVEL = np.zeros(2)


@pytest.fixture(scope="module")
def arm():
    return SerialChain.of_robot(describe_rover())


def searching(arm):
    search = TargetSearch(arm, HOME, SURVEY, EXTENT)
    return search, search.first()


def hints_at(arm, angles, places, alone=()):
    """Hints (N, 3) in the robot frame as the camera sees them."""
    to_camera = arm.tool_in_robot(angles).inv()
    paired, single = (np.reshape(p, (-1, 3)) for p in (places, alone))
    return PossibleMarkers(to_camera.apply(paired), to_camera.apply(single))


def off_axis(arm, angles, place):
    seen = arm.tool_in_robot(angles).inv().apply(place)
    return np.arccos(seen[2] / np.linalg.norm(seen))


def test_search_without_hints_views_all_directions_once_and_then_ends(arm):
    search, view = searching(arm)
    views = []
    while view is not None:
        views.append(view)
        view = search.after(view, NOTHING, LEVEL)
    views = np.array(views)
    assert views[0, 0] == 0.0 and len(views) == 18
    apart = np.abs(views[:, None] - views).max(axis=2) + np.eye(len(views))
    assert apart.min() > TargetSearchConfig().alike
    # Neighbouring views of 41 degrees overlap.
    assert np.diff(np.sort(views[:9, 0])).max() < np.deg2rad(41.0)


def test_next_view_has_a_possible_marker_in_its_middle(arm):
    rng = np.random.default_rng(0)
    for _ in range(8):
        azimuth, distance = rng.uniform(-2.0, 2.0), rng.uniform(0.6, 1.4)
        place = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]) * distance
        place[2] = rng.uniform(-0.1, 0.25)
        search, view = searching(arm)
        view = search.after(view, hints_at(arm, view, place), LEVEL)
        assert off_axis(arm, view, place) < 1e-3


def test_hints_that_fit_on_one_target_outweigh_a_single_one(arm):
    search, view = searching(arm)
    target = np.array([[0.5, 0.8, 0.1], [0.6, 0.8, 0.2]])
    view = search.after(view, hints_at(arm, view, [*target, [-0.6, 0.8, 0.1]]), LEVEL)
    assert off_axis(arm, view, target.mean(axis=0)) < 1e-3


def test_hint_in_both_images_outweighs_one_in_a_single_image(arm):
    search, view = searching(arm)
    view = search.after(view, hints_at(arm, view, [-0.6, 0.8, 0.1], alone=[0.6, 0.8, 0.1]), LEVEL)
    assert off_axis(arm, view, np.array([-0.6, 0.8, 0.1])) < 1e-3


def test_false_hint_costs_one_view_from_each_posture_and_the_search_continues(arm):
    place = np.array([0.3, 0.9, 0.1])
    search, view = searching(arm)
    centred = []
    for _ in range(6):
        view = search.after(view, hints_at(arm, view, place), LEVEL)
        centred.append(off_axis(arm, view, place) < 1e-3)
    assert centred == [True, True, False, False, False, False]


@pytest.mark.parametrize("tilt", [(-0.17, 0.04), (0.15, -0.1)])
def test_views_of_a_tilted_robot_are_as_high_as_those_of_a_level_one(arm, tilt):
    tilted = Rotation.from_euler("XY", tilt)
    heights = []
    for measured, turn in ((LEVEL, Rotation.identity()), (np.array(tilt), tilted)):
        search, view = searching(arm)
        axes = []
        while view is not None:
            axes.append(turn.apply(arm.tool_in_robot(view).rotation.as_matrix()[:, 2])[2])
            view = search.after(view, NOTHING, measured)
        heights.append(np.arcsin(axes))
    level, compensated = heights
    # The first view ahead is tilted with the robot, so it is repeated.
    assert len(compensated) == len(level) + 1
    assert abs(compensated[0] - level[0]) > 0.1
    assert np.abs(compensated[1:] - level).max() < 0.02


def test_arm_keeps_to_the_space_that_is_free_when_the_robot_is_set_down(arm):
    """Whatever it turns to, and on straight paths in joint space between any two such views."""
    rng = np.random.default_rng(1)
    radius, height = MapperConfig().clear
    base = arm.transform_base_to_robot.translation
    ends = []
    for posture in (HOME + [0.0, 0.0, 0.0, TargetSearchConfig().lift], SURVEY):
        bent = rng.uniform(-TargetSearchConfig().bend, TargetSearchConfig().bend, 200)
        turned = rng.uniform(-2.6, 2.6, 200)
        ends.append(np.tile(posture, (200, 1)) + np.outer(bent, [0, 0, 0, 1.0]))
        ends[-1][:, 0] = turned
    views = rng.permutation(np.concatenate(ends))
    paths = np.linspace(views[:-1], views[1:], 15).reshape(-1, 4)
    bodies = arm.cover_points(paths) - base
    assert np.hypot(bodies[..., 0], bodies[..., 1]).max() <= radius
    assert bodies[..., 2].min() >= height
