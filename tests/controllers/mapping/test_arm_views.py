"""Views of a stereo head on an arm: reachable, free, and rated by their information."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.kinematics.serial_chain import SerialChain
from controllers.mapping.arm_views import ArmViews, ViewConfig, ViewError, ViewRays
from models.compose import FieldConfig, RobotPlacement, make_model
from models.datasheets import ARM
from perception.voxels.occupancy import State
from perception.voxels.views import PlanningGrid
from twin.describe import describe

PLACE = RigidTransform.from_components([0.4, -0.3, 0.1], Rotation.from_euler("z", 0.5))
HOME = np.array(ARM.home)
COLUMNS, ROWS = np.meshgrid(np.linspace(-0.35, 0.35, 12), np.linspace(-0.28, 0.28, 12))
RAYS = np.stack([COLUMNS.ravel(), ROWS.ravel(), np.ones(144)], axis=1)
LENS = ViewRays(RAYS / np.linalg.norm(RAYS, axis=1, keepdims=True), (0.2, 1.5))
GRID = PlanningGrid(np.array([-1.5, -2.0, 0.0]), 0.05, np.zeros((70, 80, 20), np.int8))


@pytest.fixture(scope="module")
def views() -> ArmViews:
    model = make_model(FieldConfig(texture_pixels=64), [RobotPlacement("rover1")])
    arm = SerialChain.of_robot(describe(model, "rover1"))
    return ArmViews(arm, PLACE, LENS, ViewConfig(candidates=30))


def above(height: float):
    return lambda points: points[:, 2] < height


def test_drawn_views_and_the_paths_to_them_touch_nothing(views):
    ground = above(0.12)
    drawn = views.draw(HOME, ground, 30, np.random.default_rng(0))
    assert drawn.shape == (30, 4)
    for goal in drawn:
        for angles in np.linspace(HOME, goal, 25):
            assert not ground(views.body(angles[None])[0]).any()


def test_wall_between_start_and_goal_is_seen_though_both_are_free(views):
    left, right = HOME + [1.2, 0, 0, 0], HOME + [-1.2, 0, 0, 0]
    reach = views.body(HOME[None])[0]
    ahead = reach[np.argmax(np.linalg.norm((reach - PLACE.translation)[:, :2], axis=1))]

    def wall(points):
        return np.linalg.norm(points - ahead, axis=1) < 0.06

    assert views.is_free(np.array([left, right]), wall).all()
    assert list(views.are_reachable(left, np.array([right, left, right]), wall)) == [
        False,
        True,
        False,
    ]
    assert views.are_reachable(left, right[None], above(-1.0)).all()


def test_views_are_the_first_of_those_drawn_whose_own_path_is_free(views):
    def posts(points):
        return (points[:, 2] < 0.12) | (
            np.cos(7.0 * points[:, 0]) * np.cos(9.0 * points[:, 1]) > 0.9
        )

    drawn = views.draw(HOME, posts, 70, np.random.default_rng(4))
    low, high = views.arm.limits.T
    rng, expected = np.random.default_rng(4), []
    while len(expected) < 70:
        goals = rng.uniform(low, high, (280, 4))
        expected += [
            goal
            for goal in goals[views.is_free(goals, posts)]
            if views.is_free(views.path(HOME, goal), posts).all()
        ]
    np.testing.assert_array_equal(drawn, expected[:70])


def test_no_reachable_view_is_an_error(views):
    with pytest.raises(ViewError, match="no view"):
        views.draw(HOME, above(9.0), 5, np.random.default_rng(0))


def test_best_view_is_aimed_at_the_only_unknown_region(views):
    states = np.full(GRID.states.shape, State.FREE, np.int8)
    drawn = views.draw(HOME, above(0.12), 30, np.random.default_rng(1))
    targets = [camera.apply([0.0, 0.0, 0.8]) for camera in views.cameras(drawn)]
    cells = np.floor((targets - GRID.low) / GRID.resolution).astype(int)
    within = np.all((cells >= 2) & (cells < np.array(states.shape) - 2), axis=1)
    target, cell = targets[np.argmax(within)], cells[np.argmax(within)]
    near = tuple(slice(max(c - 2, 0), c + 3) for c in cell)
    states[near] = State.UNKNOWN
    grid = PlanningGrid(GRID.low, GRID.resolution, states)
    rated = views.rate(grid, None, HOME, drawn)
    assert np.all(np.diff(rated.ratings) <= 0.0) and rated.information[0] > 0.0
    sight = rated.cameras[0].inv().apply(target)
    assert sight[2] > 0 and np.abs(sight[:2] / sight[2]).max() < 0.4


def test_claimed_view_has_no_information(views):
    drawn = views.draw(HOME, above(0.12), 5, np.random.default_rng(2))
    first = views.rate(GRID, None, HOME, drawn)
    claims = views.claims(GRID, None, first.angles[0])
    again = views.rate(GRID, claims, HOME, first.angles[:1])
    assert first.information[0] > 0.0 and again.information[0] == 0.0


def test_farther_of_two_equal_views_is_rated_lower(views):
    near, far = HOME + [0.1, 0, 0, 0], HOME + [0.1 - 2 * np.pi, 0, 0, 0]
    rated = views.rate(GRID, None, HOME, np.array([far, near]))
    np.testing.assert_allclose(rated.angles[0], near)
    assert rated.information[0] == pytest.approx(rated.information[1])


def test_raster_proceeds_column_by_column(views):
    raster = views.raster()
    assert len(raster) > 20
    steps = np.diff(raster, axis=0)
    assert np.all((steps[:, 0] > 0) | (steps[:, 3] != 0))
    np.testing.assert_allclose(raster[:, 1:3], np.tile(views.config.survey[1:3], (len(raster), 1)))
