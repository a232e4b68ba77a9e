"""Free cells by counting, paths beside Dijkstra's method in Python, and what each leg runs over."""

import dataclasses
import heapq
import itertools
import math

import numpy as np
import pytest

from controllers.mapping.ground_paths import (
    GroundPathConfig,
    MappedRises,
    obstacles,
    path_costs,
    path_lengths,
    plan_path,
    shortened,
    standing_places,
)
from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap

CELL = 0.05
CORNER = (-1.0, -1.5)
HOW = GroundPathConfig(near_cost=0.0, sure=99.0, corner=1e-9)
"""No more is paid beside obstacles, so that the cheapest paths are the shortest."""


def mapped(model):
    return MappedRises(model.grid, rises(model))


def field(rocks, shape=(60, 80), slope=0.1, height=0.06):
    """A slope with rocks of a cell each."""
    model = ElevationMap(ElevationGrid(CORNER, shape, CELL))
    model.heights[...] = model.grid.centres @ [slope, -0.5 * slope]
    for row, column in rocks:
        model.heights[row, column] += height
    model.variances[...] = 1e-6
    return model


def middle_of(row, column):
    return CORNER[0] + (column + 0.5) * CELL, CORNER[1] + (row + 0.5) * CELL


def free_by_counting(above, start=None, radius=HOW.radius, climb=HOW.climb, discs=()):
    """Each cell beside each higher one; to those within the disc at the start it is no nearer."""
    rocks = [middle_of(*cell) for cell in np.argwhere(above > climb)]
    if start is not None:
        rocks = [rock for rock in rocks if math.dist(rock, start) > HOW.inner]
    held = [rock for rock in rocks if start is not None and math.dist(rock, start) <= radius]
    free = np.ones(above.shape, dtype=bool)
    for cell in np.ndindex(above.shape):
        place = middle_of(*cell)
        free[cell] = all(
            math.dist(place, rock) >= math.dist(start, rock) - 1e-12
            if rock in held
            else math.dist(place, rock) > radius
            for rock in rocks
        ) and all(math.dist(place, disc[:2]) >= radius + disc[2] for disc in discs)
    return free


def cell_at(place):
    return tuple(math.floor((place[k] - CORNER[k]) / CELL) for k in (1, 0))


def shortest_length(free, start, goal):
    """Dijkstra's method with steps to eight neighbours that cut no corners; infinite if none."""
    best, heap = {start: 0.0}, [(0.0, start)]
    while heap:
        length, (row, column) = heapq.heappop(heap)
        if (row, column) == goal:
            return CELL * length
        if length > best[row, column]:
            continue
        for i, j in itertools.product((-1, 0, 1), repeat=2):
            there = row + i, column + j
            if not all(0 <= k < n for k, n in zip(there, free.shape)) or not free[there]:
                continue
            if i and j and not (free[row + i, column] and free[row, column + j]):
                continue
            if length + math.hypot(i, j) < best.get(there, math.inf):
                best[there] = length + math.hypot(i, j)
                heapq.heappush(heap, (best[there], there))
    return math.inf


def assert_runs_over(path, free):
    """Every millimetre of every leg."""
    for first, second in itertools.pairwise(path):
        count = int(np.linalg.norm(second - first) / 0.001) + 2
        for place in np.linspace(first, second, count):
            assert free[cell_at(place)], (first, second, place)


def length_of(path):
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


@pytest.mark.parametrize("radius", [0.28, 0.11, 0.01])
def test_free_cells_are_those_with_nothing_higher_within_the_disc(radius):
    rng, start = np.random.default_rng(0), np.array([-0.9, -1.4])
    model = field(rng.integers((10, 10), (50, 70), (25, 2)))
    how = dataclasses.replace(HOW, radius=radius)
    found = np.isfinite(path_costs(mapped(model), start, None, how))
    expected = free_by_counting(rises(model), start, radius)
    np.testing.assert_array_equal(found, expected)
    assert found.any() and not found.all()


def test_unknown_ground_is_free():
    model = ElevationMap(ElevationGrid(CORNER, (60, 80), CELL))
    np.testing.assert_array_equal(path_costs(mapped(model), np.zeros(2), None, HOW), 1.0)


def test_paths_are_no_longer_than_the_shortest_from_cell_to_cell_and_run_over_free_cells():
    rng, found, blocked, legs = np.random.default_rng(1), 0, 0, []
    for _ in range(25):
        model = field(rng.integers((0, 0), (60, 80), (rng.integers(8, 40), 2)))
        start, goal = rng.uniform([-0.7, -1.2], [2.7, 1.2], (2, 2))
        free = free_by_counting(rises(model), start)
        free[cell_at(start)] = True
        expected = math.inf
        if free[cell_at(goal)]:
            expected = shortest_length(free, cell_at(start), cell_at(goal))
        path = plan_path(mapped(model), start, goal, config=HOW)
        if not math.isfinite(expected):
            assert path is None  # Rocks of 60 mm are none to climb, either.
            blocked += 1
            continue
        np.testing.assert_allclose(path[[0, -1]], [start, goal])
        assert_runs_over(path, free)
        # Both ends are somewhere in their cells.
        assert np.linalg.norm(goal - start) - 1e-9 <= length_of(path)
        assert length_of(path) <= expected + math.sqrt(2.0) * CELL
        found += 1
        legs.append(len(path) - 1)
    assert found > 8 and blocked > 2
    assert np.mean(legs) < 6


def test_open_ground_is_crossed_in_one_leg():
    model = ElevationMap(ElevationGrid(CORNER, (60, 80), CELL))
    path = plan_path(mapped(model), [-0.9, -1.4], [2.9, 1.43])
    np.testing.assert_allclose(path, [[-0.9, -1.4], [2.9, 1.43]])
    np.testing.assert_allclose(
        plan_path(mapped(model), [0.0, 0.0], [0.01, 0.0]), [[0.0, 0.0], [0.01, 0.0]]
    )


def test_a_path_around_a_wall_is_as_short_as_the_rover_s_disc_allows():
    """Two tangents and an arc about the wall's end; only chords over cells stay beyond it."""
    model = field([(row, 40) for row in range(35)])
    start, goal = np.array([0.0, -0.5]), np.array([2.0, -0.5])
    path = plan_path(mapped(model), start, goal, config=HOW)
    end = np.array(CORNER) + CELL * np.array([40.5, 34.5])
    to_start, to_goal = start - end, goal - end
    far = np.hypot(*to_start), np.hypot(*to_goal)
    below = math.acos(to_start @ to_goal / (far[0] * far[1]))
    arc = math.tau - below - sum(math.acos(HOW.radius / d) for d in far)
    shortest = sum(math.sqrt(d * d - HOW.radius**2) for d in far) + HOW.radius * arc
    assert shortest - CELL < length_of(path) < 1.03 * shortest + CELL
    assert len(path) <= 8


def wall_with_gap(height, low):
    """A wall across the field, lower in its middle."""
    model = field([(row, 40) for row in range(60) if not 22 <= row < 38], height=height)
    for row in range(22, 38):
        model.heights[row, 40] += low
    return model


def test_what_is_25_mm_high_is_driven_over_only_where_there_is_no_other_path():
    start, goal = [0.0, 0.0], [2.0, 0.0]
    model = wall_with_gap(0.1, 0.04)
    path = plan_path(mapped(model), start, goal)
    np.testing.assert_allclose(path, [start, goal])
    assert (
        plan_path(mapped(model), start, goal, config=dataclasses.replace(HOW, most_climb=0.03))
        is None
    )
    assert plan_path(mapped(wall_with_gap(0.1, 0.07)), start, goal, config=HOW) is None
    # With another path, longer, the wall is not driven over.
    model.heights[45:, 40] -= 0.1
    around = plan_path(mapped(model), start, goal)
    assert around[:, 1].max() > CORNER[1] + CELL * 45


def test_a_rover_may_leave_where_it_stands_but_reach_no_goal_too_near():
    model = field([(30, 22), (30, 45)])
    start, goal = [0.2, 0.0], [0.9, 0.025]
    assert not free_by_counting(rises(model))[cell_at(start)]
    path = plan_path(mapped(model), start, goal, config=HOW)
    np.testing.assert_allclose(path, [start, goal])
    assert plan_path(mapped(model), start, [1.0, 0.025]) is None


def test_a_rover_with_a_rock_in_its_disc_drives_away_and_comes_no_nearer_to_it():
    rock = (30, 24)
    model, start = field([rock]), np.array([0.0, 0.0])
    beside = math.dist(start, middle_of(*rock))
    assert HOW.inner < beside < HOW.radius
    for goal in ([-0.6, -0.8], [2.0, 0.0], [0.2, 1.0]):
        path = plan_path(mapped(model), start, np.array(goal), config=HOW)
        points = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(path)])
        away = np.linalg.norm(points - middle_of(*rock), axis=1)
        assert away.min() > beside - CELL
        assert away[np.linalg.norm(points - start, axis=1) > HOW.radius + CELL].min() > (
            HOW.radius - CELL
        )


def test_a_rover_between_two_rocks_comes_no_nearer_to_either():
    """Beside one at 0.22 m it does not come as near to another."""
    rocks = [(30, 24), (33, 26)]
    model, start = field(rocks), np.array([0.02, -0.02])
    how = dataclasses.replace(HOW, radius=0.4)
    near = [math.dist(start, middle_of(*rock)) for rock in rocks]
    assert HOW.inner < near[0] < near[1] < how.radius
    for goal in goals_around():
        path = plan_path(mapped(model), start, goal, config=how)
        points = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(path)])
        for rock, least in zip(rocks, near, strict=True):
            assert np.linalg.norm(points - middle_of(*rock), axis=1).min() > least - CELL


def goals_around():
    """Places all around, a metre away and more."""
    turns = np.random.default_rng(6).uniform(-math.pi, math.pi, 12)
    return 1.0 * np.column_stack([np.cos(turns), np.sin(turns)])


def test_a_path_is_kept_until_another_is_clearly_cheaper():
    model = field([(30, 38)])
    start, goal = np.array([0.0, 0.025]), np.array([1.9, 0.025])
    left = plan_path(mapped(model), start, goal, config=HOW)
    right = left * [1.0, -1.0] + [0.0, 0.05]  # Mirrored at the line through the rock.
    for kept in (left, right):
        assert plan_path(mapped(model), start, goal, config=HOW, kept=kept) is kept
    far = np.array([start, [0.9, -1.2], goal])
    np.testing.assert_allclose(plan_path(mapped(model), start, goal, config=HOW, kept=far), left)
    through = np.array([start, goal])
    np.testing.assert_allclose(
        plan_path(mapped(model), start, goal, config=HOW, kept=through), left
    )


def test_other_robots_are_gone_around_and_a_rover_beside_one_comes_no_closer():
    model = field([])
    start, goal, other = np.array([0.0, 0.0]), np.array([2.0, 0.0]), np.array([1.0, 0.1, 0.3])
    path = plan_path(mapped(model), start, goal, [other], HOW)
    free = free_by_counting(rises(model), start, discs=[other])
    assert_runs_over(path, free)
    assert path[:, 1].min() < -0.4
    beside = np.array([0.4, 0.0, 0.3])
    path = plan_path(mapped(model), start, goal, [beside], HOW)
    assert len(path) > 2
    for first, second in itertools.pairwise(path):
        along = np.linspace(first, second, 200)
        assert np.linalg.norm(along - beside[:2], axis=1).min() > 0.4 - CELL
    surrounded = [(0.0, y, 0.3) for y in np.arange(-1.5, 1.6, 0.2)]
    assert plan_path(mapped(model), [-0.6, 0.0], goal, surrounded) is None


@pytest.mark.parametrize("ends", [([-1.01, 0.0], [1.0, 0.0]), ([0.0, 0.0], [3.01, 0.0])])
def test_there_is_no_path_from_or_to_beyond_the_map(ends):
    assert plan_path(mapped(field([])), *ends) is None


@pytest.mark.parametrize(("height", "over"), [(0.06, math.inf), (0.042, 1.0 + 3.0 + 7.0)])
def test_costs_fall_with_the_distance_from_what_is_high(height, over):
    how = GroundPathConfig(margin=0.2, near_cost=3.0, over_cost=7.0, sure=99.0)
    costs = path_costs(mapped(field([(30, 40)], height=height)), np.array([-0.9, -1.4]), None, how)
    rows, columns = np.mgrid[:60, :80]
    beyond = CELL * np.hypot(rows - 30, columns - 40) - how.radius
    np.testing.assert_array_equal(costs[beyond <= 0.0], over)
    near = (beyond > 0.0) & (beyond < 0.2)
    np.testing.assert_allclose(costs[near], 1.0 + 3.0 * (0.2 - beyond[near]) / 0.2)
    np.testing.assert_array_equal(costs[beyond >= 0.2], 1.0)


def test_doubted_ground_is_gone_around_where_that_is_short():
    model, start = field([]), np.array([-0.5, 0.0])
    doubted = np.zeros((60, 80), bool)
    doubted[28:33, 38:42] = True
    path = plan_path(mapped(model), start, [2.5, 0.0], doubted=doubted)
    points = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(path)])
    middles = [middle_of(*cell) for cell in np.argwhere(doubted)]
    assert min(np.linalg.norm(points - middle, axis=1).min() for middle in middles) > HOW.radius
    doubted[:, 38:42] = True
    path = plan_path(mapped(model), start, [2.5, 0.0], doubted=doubted)
    np.testing.assert_allclose(path, [start, [2.5, 0.0]])


def test_unknown_ground_costs_and_lengths_are_those_over_it():
    model, how = field([], slope=0.0), dataclasses.replace(HOW, unknown_cost=1.5)
    x, y = np.moveaxis(model.grid.centres, -1, 0)
    hidden = (np.abs(x - 1.0) < 0.3) & (y < 0.6)
    model.heights[hidden] = np.nan
    costs = path_costs(mapped(model), np.array([-0.5, 0.0]), None, how)
    np.testing.assert_array_equal(costs[hidden], 2.5)
    np.testing.assert_array_equal(costs[~hidden], 1.0)
    # Straight on 2.6 + 0.6 * 1.5 = 3.5 m; past the end 0.7 m aside, which is 3.0 m.
    start, goals = np.array([-0.3, 0.0]), np.array([[2.3, 0.0], [-0.3, 1.0]])
    path = plan_path(mapped(model), start, goals[0], config=how)
    assert path is not None and path[:, 1].max() > 0.55
    straight = plan_path(mapped(model), start, goals[0], config=HOW)
    np.testing.assert_allclose(straight, [start, goals[0]])
    far, aside = path_lengths(mapped(model), start, goals, config=how)
    assert aside == pytest.approx(1.0 / 2.5, rel=0.1)
    assert length_of(path) / 2.5 <= far < 1.15 * length_of(path) / 2.5


def test_holes_between_far_points_are_no_unknown_ground():
    model, how = field([]), dataclasses.replace(HOW, unknown_cost=1.5)
    model.heights[np.random.default_rng(2).uniform(size=(60, 80)) < 0.3] = np.nan
    model.heights[:, 50:] = np.nan
    costs = path_costs(mapped(model), np.array([-0.5, 0.0]), None, how)
    assert np.all(costs[:, 51:] == 2.5) and np.mean(costs[:, :48] == 1.0) > 0.98


def test_what_is_high_far_away_costs_and_closer_by_bars_the_way():
    model = field([(row, 60) for row in range(60)])
    start, goal = np.array([-0.5, 0.0]), np.array([2.8, 0.0])
    how = dataclasses.replace(HOW, sure=1.5)
    path = plan_path(mapped(model), start, goal, config=how)
    np.testing.assert_allclose(path, [start, goal])  # A wall from side to side.
    length, cost = path_lengths(mapped(model), start, np.array([[1.6, 0.0], goal]), config=how)
    assert length == pytest.approx(2.1, abs=0.1)
    assert cost == pytest.approx(3.3 + 2.0 * how.radius * how.far_cost, rel=0.15)
    near = path_costs(mapped(model), np.array([1.0, 0.0]), None, how)
    assert np.isinf(near[30, 60]) and near[0, 60] == 1.0 + how.far_cost


def test_a_cell_alone_is_noise_and_two_side_by_side_are_a_rock():
    rng = np.random.default_rng(5)
    above = np.where(rng.uniform(size=(40, 50)) < 0.05, 0.04, 0.0)
    found = obstacles(above, 0.02, least=2)
    for row, column in np.ndindex(above.shape):
        about = above[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2] > 0.02
        assert found[row, column] == (above[row, column] > 0.02 and about.sum() > 1)
    np.testing.assert_array_equal(obstacles(above, 0.02), above > 0.02)


def test_a_path_keeps_off_rocks_where_there_is_room_and_squeezes_where_there_is_none():
    """Past one rock with a margin, and through a gap that leaves none."""
    start, goal = np.array([-0.5, 0.0]), np.array([2.5, 0.0])
    gap = [(row, 38) for row in range(60) if not 22 < row < 36]
    for rocks, least in (([(24, 38)], 0.36), (gap, 0.28)):
        model = field(rocks)
        path = plan_path(mapped(model), start, goal)
        points = np.concatenate([np.linspace(a, b, 500) for a, b in itertools.pairwise(path)])
        away = min(np.linalg.norm(points - middle_of(*rock), axis=1).min() for rock in rocks)
        assert away > least
        assert length_of(path) < 3.3


def cost_by_steps(first, second, costs):
    """What a line over cells costs, summed in small steps [cells]."""
    places = np.linspace(first, second, 20001)
    middles = 0.5 * (places[1:] + places[:-1])
    length = np.linalg.norm(second - first) / len(middles)
    return float(sum(costs[int(y), int(x)] for x, y in middles)) * length


def test_string_pulling_keeps_the_cheapest_chain_where_cells_cost():
    rng, corner = np.random.default_rng(3), np.zeros(2)
    for _ in range(8):
        costs = rng.uniform(1.0, 4.0, (9, 9))
        path = rng.uniform(0.01, 8.99, (5, 2))
        legs = {
            (i, j): cost_by_steps(path[i], path[j], costs)
            for i, j in itertools.combinations(range(5), 2)
        }
        chains = [
            (0, *inner, 4)
            for count in range(4)
            for inner in itertools.combinations((1, 2, 3), count)
        ]
        best = min(chains, key=lambda chain: sum(legs[leg] for leg in itertools.pairwise(chain)))
        pulled = shortened(CELL * path, costs, corner, CELL)
        np.testing.assert_allclose(pulled, CELL * path[list(best)])


def test_a_leg_that_saves_less_than_a_turn_costs_is_left_out():
    """A kink through a cheap corner of the field, worth 0.4 m."""
    costs = np.ones((40, 40))
    costs[:, 20] = 9.0
    costs[22, 20] = 1.0
    path = CELL * np.array([(4.5, 20.5), (20.5, 22.5), (36.5, 20.5)])
    straight = cost_by_steps(path[0] / CELL, path[2] / CELL, costs)
    kinked = sum(cost_by_steps(a / CELL, b / CELL, costs) for a, b in itertools.pairwise(path))
    saved = CELL * (straight - kinked)
    assert 0.1 < saved < 1.0
    for turn, count in ((0.9 * saved, 3), (1.1 * saved, 2)):
        assert len(shortened(path, costs, np.zeros(2), CELL, turn)) == count


def test_a_corner_costs_a_turn_times_the_square_of_what_its_cell_costs():
    """The kink of the test above again, where turning at it costs more than beside it."""
    costs = np.ones((40, 40))
    costs[:, 20], costs[22, 20] = 9.0, 1.0
    path = CELL * np.array([(4.5, 20.5), (20.5, 22.5), (36.5, 20.5)])
    straight = cost_by_steps(path[0] / CELL, path[2] / CELL, costs)
    for dear in (1.0, 2.0, 4.0):
        costs[22, 20] = dear
        kinked = sum(cost_by_steps(a / CELL, b / CELL, costs) for a, b in itertools.pairwise(path))
        least = CELL * (straight - kinked) / dear**2
        for turn, count in ((0.95 * least, 3), (1.05 * least, 2)):
            assert len(shortened(path, costs, np.zeros(2), CELL, turn)) == count


def test_string_pulling_keeps_the_shortest_chain_of_free_legs():
    """Against all subsets of a path's points."""
    rng, corner = np.random.default_rng(2), np.zeros(2)
    for _ in range(40):
        free = rng.uniform(size=(9, 9)) < 0.75
        path = np.cumsum(rng.integers(-1, 2, (8, 2)), axis=0) + rng.uniform(0.0, 1.0, (8, 2)) + 4.0
        path = np.clip(path, 0.01, 8.99)
        free[*path[:, ::-1].astype(int).T] = True
        pulled = shortened(CELL * path, np.where(free, 1.0, math.inf), corner, CELL)

        def is_free(first, second, free=free):
            places = np.linspace(first, second, 2000)
            return all(free[int(y), int(x)] for x, y in places)

        legs = {
            (i, j): j == i + 1 or is_free(path[i], path[j])
            for i, j in itertools.combinations(range(8), 2)
        }
        chains = [
            (0, *inner, 7)
            for count in range(7)
            for inner in itertools.combinations(range(1, 7), count)
        ]
        best = min(
            length_of(path[list(chain)])
            for chain in chains
            if all(legs[leg] for leg in itertools.pairwise(chain))
        )
        assert length_of(pulled) == pytest.approx(CELL * best, abs=1e-6)


def test_impossible_settings_are_named():
    with pytest.raises(ValueError, match="ground path climb = -1"):
        GroundPathConfig(climb=-1.0)


def test_pooled_cells_are_as_high_as_the_highest_that_they_hold():
    fine = field([(20, 40)], shape=(61, 80))
    how = dataclasses.replace(HOW, pool=2)
    start, goal = np.array([0.0, -0.5]), np.array([2.0, -0.5])
    path = plan_path(mapped(fine), start, goal, config=how)
    rock = np.array([CORNER[0] + 40.5 * CELL, CORNER[1] + 20.5 * CELL])
    assert path is not None
    points = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(path)])
    # A pooled cell's middle lies up to half a fine cell's diagonal off the rock's.
    assert np.linalg.norm(points - rock, axis=1).min() > HOW.radius - CELL
    assert len(plan_path(mapped(fine), start, goal, config=HOW)) >= 3


def test_lengths_are_those_of_the_paths_from_cell_to_cell():
    rng = np.random.default_rng(4)
    model = field(rng.integers((0, 0), (60, 80), (25, 2)))
    start, goals = np.array([-0.5, -1.0]), rng.uniform([-0.7, -1.2], [2.7, 1.2], (12, 2))
    lengths = path_lengths(mapped(model), start, goals, config=HOW)
    free = free_by_counting(rises(model), start)
    free[cell_at(start)] = True
    for goal, length in zip(goals, lengths, strict=True):
        expected = (
            shortest_length(free, cell_at(start), cell_at(goal))
            if free[cell_at(goal)]
            else math.inf
        )
        assert length == pytest.approx(expected)
    assert np.isinf(path_lengths(mapped(model), start, np.array([[99.0, 0.0]]))).all()


@pytest.mark.parametrize("room", [0.0, 0.1])
def test_a_rover_may_stand_where_it_gets_to_and_has_room(room):
    rng = np.random.default_rng(6)
    start, disc, how = (
        np.array([-0.5, -1.0]),
        (1.0, 0.0, 0.1),
        dataclasses.replace(HOW, near_cost=3),
    )
    rocks = rng.integers((0, 0), (60, 80), (25, 2))
    rocks = [rock for rock in rocks if math.dist(middle_of(*rock), start) > 0.5]
    model = field(rocks)
    may_stand = standing_places(mapped(model), start, room, [disc], how)
    above = rises(model)
    free = free_by_counting(above, start, discs=[disc])
    roomy = free_by_counting(above, start, HOW.radius + room, discs=[(1.0, 0.0, 0.1 + room)])
    answers = []
    for place in rng.uniform([-1.2, -1.7], [3.2, 1.7], (80, 2)):
        inside = model.grid.inside(model.grid.cells_of([place]))[0]
        expected = bool(
            inside
            and roomy[cell_at(place)]
            and math.isfinite(shortest_length(free, cell_at(start), cell_at(place)))
        )
        answers.append(may_stand(place))
        assert answers[-1] == expected
    assert 5 < sum(answers) < 60


@pytest.mark.parametrize("height", [0.03, 0.06])
def test_a_rover_drives_over_what_it_climbs_but_rather_stands_on_nothing(height):
    """A row of stones across the field: low ones are driven over, high ones not."""
    model = field([(row, 40) for row in range(60)], slope=0.0, height=height)
    start, beyond, amid = np.array([-0.5, 0.0]), np.array([2.5, 0.0]), np.array([1.0, 0.0])
    how = dataclasses.replace(HOW, near_cost=3.0)
    climbs = height < HOW.most_climb
    for room in (0.0, None):
        may_stand = standing_places(mapped(model), start, room, config=how)
        assert may_stand(beyond) == climbs
        assert may_stand(amid) == (climbs and room is None)
