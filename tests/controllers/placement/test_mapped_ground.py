"""Free positions and paths of a rover on a map, against counting points and against geometry."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.placement.mapped_ground import GroundConfig, MappedGround
from perception.voxels.map import Surface

LEVEL = RigidTransform.identity()
HOW = GroundConfig()


def surface(points, sigma=1e-4):
    points = np.asarray(points, dtype=float)
    covariances = np.tile(sigma**2 / 3.0 * np.eye(3), (len(points), 1, 1))
    return Surface(points, covariances, np.ones(len(points)))


def wall(start, end, height=0.2, step=0.02):
    """Points of an upright wall, three at each place."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    count = int(np.linalg.norm(end - start) / step) + 1
    line = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
    return np.vstack([np.column_stack([line, np.full(count, height + d)]) for d in (0, 0.02, 0.04)])


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def test_a_place_is_free_if_fewer_than_three_points_of_its_disc_are_obstacles():
    rng = np.random.default_rng(0)
    points = rng.uniform([-2, -2, 0.0], [2, 2, 0.6], (300, 3))
    turn = RigidTransform.from_components([0.3, -0.2, 0.1], Rotation.from_euler("z", 0.7))
    ground = MappedGround(surface(turn.apply(points)), turn.inv())
    answers = []
    for place in rng.uniform(-2.0, 2.0, (400, 2)):
        count = 0
        for x, y, z in points:
            inside = (x - place[0]) ** 2 + (y - place[1]) ** 2 < 0.30**2
            count += inside and 0.08 + 1e-4 < z < 0.45
        answers.append(ground.is_free(place))
        assert answers[-1] == (count < 3)
    assert 50 < sum(answers) < 350


def test_a_point_as_uncertain_as_its_height_over_the_limit_is_no_obstacle():
    stake = [[0.1, 0.0, 0.10]] * 3
    assert not MappedGround(surface(stake, 0.019), LEVEL).is_free([0.0, 0.0])
    assert MappedGround(surface(stake, 0.021), LEVEL).is_free([0.0, 0.0])


def test_nothing_mapped_is_free_everywhere_and_paths_are_straight():
    for mapped in (None, surface(np.zeros((0, 3)))):
        ground = MappedGround(mapped, LEVEL)
        assert ground.is_free([0.0, 0.0]) and not len(ground.points)
        assert ground.occluders(np.zeros(3), np.array([1.0, 0.0, 0.0])) == []
        paths = ground.paths_from([1.0, 0.5])
        assert paths.path_to([-3.2, 0.5]) is None
        path = paths.path_to([-2.0, 0.7])
        np.testing.assert_allclose(path[[0, -1]], [[1.0, 0.5], [-2.0, 0.7]])
        assert length(path) == pytest.approx(np.hypot(3.0, 0.2), abs=0.2)


@pytest.mark.parametrize("towards", [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1)])
def test_a_straight_path_on_free_ground_is_a_row_of_cells_from_the_start(towards):
    start, towards = np.array([1.02, 0.47]), np.array(towards)
    path = MappedGround(None, LEVEL).paths_from(start).path_to(start + 10 * HOW.cell * towards)
    wanted = start + HOW.cell * np.arange(11)[:, None] * towards
    np.testing.assert_allclose(path, wanted, atol=1e-12)


@pytest.mark.parametrize("towards", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_paths_reach_as_far_to_every_side(towards):
    start, count = np.array([1.02, 0.47]), round(HOW.reach / HOW.cell)
    paths = MappedGround(None, LEVEL).paths_from(start)
    assert paths.path_to(start + count * HOW.cell * np.array(towards)) is not None
    assert paths.path_to(start + (count + 2) * HOW.cell * np.array(towards)) is None


def test_a_goal_that_is_just_blocked_is_reached_from_the_neighbour_nearest_the_start():
    goal = np.array([10 * HOW.cell, 0.0])
    stake = np.tile([goal[0] + HOW.radius - 0.2 * HOW.cell, 0.0, 0.3], (3, 1))
    ground = MappedGround(surface(stake), LEVEL)
    assert not ground.is_free(goal) and ground.is_free(goal - [HOW.cell, 0.0])
    path = ground.paths_from([0.0, 0.0]).path_to(goal)
    wanted = [*(HOW.cell * np.arange(9)), goal[0]]
    np.testing.assert_allclose(path, np.column_stack([wanted, np.zeros(10)]), atol=1e-12)


def test_path_around_a_wall_is_as_short_as_the_rover_s_disc_allows():
    """Around the end of a wall the middle keeps a radius away: two tangents and an arc."""
    ground = MappedGround(surface(wall([0.0, -4.0], [0.0, 1.0])), LEVEL)
    path = ground.paths_from([-1.0, 0.0]).path_to([1.0, 0.0])
    assert np.all([ground.is_free(place) for place in path])
    far = 2.0**0.5
    # Seen from the end of the wall, both places are 3/4 of a turn apart on the open side.
    arc = 1.5 * np.pi - 2.0 * np.arccos(HOW.radius / far)
    shortest = 2.0 * np.sqrt(far**2 - HOW.radius**2) + HOW.radius * arc
    # Steps to eight neighbours are up to 8 % longer than the straight line.
    assert shortest - 2.0 * HOW.cell < length(path) < 1.09 * shortest + 4.0 * HOW.cell
    assert path[:, 1].max() > 1.0 + HOW.radius - 2.0 * HOW.cell


def test_steps_of_a_path_are_no_longer_than_a_cell_s_diagonal_but_at_its_ends():
    rng = np.random.default_rng(1)
    posts = np.repeat(rng.uniform(-1.5, 1.5, (12, 2)), 3, axis=0)
    ground = MappedGround(surface(np.column_stack([posts, np.full(len(posts), 0.3)])), LEVEL)
    paths, found = ground.paths_from([-2.0, -2.0]), 0
    for place in rng.uniform(-1.8, 1.8, (40, 2)):
        path = paths.path_to(place)
        if path is None:
            continue
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert np.all(steps[1:-1] <= 2.0**0.5 * HOW.cell + 1e-12)
        assert steps[-1] <= 4.0 * HOW.cell and steps[0] <= 2.0 * HOW.cell
        assert np.all([ground.is_free(at) for at in path[1:-1]])
        found += 1
    assert found > 20


def test_no_path_leads_through_a_gap_narrower_than_the_rover():
    for gap, passes in ((0.5, False), (0.8, True)):
        sides = np.vstack([
            wall([-1.5, -1.5], [1.5, -1.5]), wall([-1.5, 1.5], [1.5, 1.5]),
            wall([-1.5, -1.5], [-1.5, 1.5]), wall([1.5, -1.5], [1.5, -gap / 2.0]),
            wall([1.5, gap / 2.0], [1.5, 1.5]),
        ])  # fmt: skip
        ground = MappedGround(surface(sides), LEVEL)
        assert ground.is_free([0.0, 0.0])
        path = ground.paths_from([3.0, 0.0]).path_to([0.0, 0.0])
        assert (path is not None) == passes
        assert ground.paths_from([0.5, 0.5]).path_to([0.0, 0.0]) is not None


def test_a_rover_may_leave_its_position_among_noise():
    """The map has points within its own disc, which are noise."""
    ground = MappedGround(surface(wall([-0.1, 0.0], [0.1, 0.0])), LEVEL)
    assert not ground.is_free([0.0, 0.05])
    path = ground.paths_from([0.0, 0.05]).path_to([1.0, 1.0])
    assert path is not None and length(path) < 1.09 * np.hypot(1.0, 0.95) + 2.0 * HOW.cell


def test_occluders_are_what_is_mapped_before_a_target_and_near_it():
    position, normal = np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0])
    kept = [[0.3, 0.0, 0.3], [0.06, 0.5, 0.2]]
    left_out = [[0.04, 0.0, 0.3], [-0.3, 0.0, 0.3], [0.95, 0.0, 0.3], [0.3, 0.0, 0.05]]
    found = MappedGround(surface(kept + left_out), LEVEL).occluders(position, normal)
    middles = np.array(sorted(part.points.mean(axis=0).tolist() for part in found))
    np.testing.assert_allclose(middles, sorted(kept), atol=0.51 * HOW.voxel)


def test_further_obstacles_block_places_and_paths_but_hide_nothing():
    post = np.array([[1.0, 0.0], [1.02, 0.0], [1.0, 0.02]])
    ground = MappedGround(None, RigidTransform.identity(), obstacles=post)
    assert not ground.is_free([1.0, 0.2]) and ground.is_free([1.0, 0.5])
    path = ground.paths_from([0.0, 0.0]).path_to([2.0, 0.0])
    assert path is not None
    assert np.linalg.norm(path - post[0], axis=1).min() > 0.25
    assert ground.occluders(np.array([1.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0])) == []
