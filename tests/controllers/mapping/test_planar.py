"""Planar pose selection: paths, ratings, every method's choice, and claims."""

import dataclasses

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse import csgraph

from controllers.mapping.planar_paths import shortest_paths
from controllers.mapping.planar_planner import (
    METHODS,
    PlanarTeam,
    PlannerConfig,
    ViewPlanner,
    expected_information,
    fixed_price_rating,
    isolation_weights,
    new_and_old_area,
    rate_rating,
)
from controllers.mapping.planar_situation import believe, draw_candidates, frontier_cells
from perception.planar.map import Grid, PlanarMap
from perception.planar.raycast import RangeSensor, expected_view, fan, scan

SENSOR = RangeSensor(np.radians(90.0), 8.0)
GRID = Grid(60, 60, 0.5)
START = (30, 30)


def partly_mapped(seed=1, views=3):
    """A scattered world and its map after a few scans from one place."""
    occupied = np.random.default_rng(seed).random(GRID.shape) < 0.03
    occupied[START] = False
    model = PlanarMap(GRID)
    for turn in range(views):
        seen = scan(occupied, GRID, START, 2.0 * turn, SENSOR)
        model.insert(seen.passed, seen.hit)
    return occupied, model


def grid_graph(enterable):
    """The same neighbourhood as a sparse graph, built cell by cell."""
    rows, columns = enterable.shape
    graph = sparse.lil_matrix((rows * columns, rows * columns))
    for r, c in np.argwhere(enterable):
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            nr, nc = r + dr, c + dc
            if not (nr < rows and 0 <= nc < columns and enterable[nr, nc]):
                continue
            if dr and dc and not (enterable[r, nc] and enterable[nr, c]):
                continue
            graph[r * columns + c, nr * columns + nc] = np.hypot(dr, dc)
    return graph.tocsr()


def test_path_lengths_are_those_of_scipy():
    enterable = np.random.default_rng(2).random((30, 37)) > 0.35
    start = tuple(int(i) for i in np.argwhere(enterable)[200])
    found = shortest_paths(enterable, start, 0.5)
    flat = start[0] * 37 + start[1]
    expected = csgraph.dijkstra(grid_graph(enterable), directed=False, indices=flat)
    assert 100 < np.isfinite(expected).sum() < expected.size
    np.testing.assert_allclose(found.lengths.ravel(), 0.5 * expected, rtol=1e-12)


def test_path_lengths_to_goals_are_those_of_a_search_for_all_cells():
    rng = np.random.default_rng(5)
    for _ in range(20):
        enterable = rng.random((30, 37)) > 0.35
        cells = np.argwhere(enterable)
        start = tuple(int(i) for i in rng.choice(cells))
        goals = rng.choice(cells, 3)
        some = shortest_paths(enterable, start, 0.5, goals=goals)
        flat = start[0] * 37 + start[1]
        expected = csgraph.dijkstra(grid_graph(enterable), directed=False, indices=flat)
        expected = 0.5 * expected.reshape(30, 37)[*goals.T]
        np.testing.assert_allclose(some.lengths[*goals.T], expected, rtol=1e-12)
    near = shortest_paths(np.ones((30, 37), dtype=bool), (3, 3), 0.5, goals=np.array([[3, 5]]))
    assert np.isfinite(near.lengths).sum() < 40


def test_a_path_is_free_connected_and_of_the_reported_length():
    enterable = np.random.default_rng(3).random((30, 37)) > 0.3
    start = tuple(int(i) for i in np.argwhere(enterable)[0])
    paths = shortest_paths(enterable, start, 0.5)
    far = np.unravel_index(np.argmax(np.where(np.isfinite(paths.lengths), paths.lengths, -1)),
                           enterable.shape)  # fmt: skip
    path = paths.to((int(far[0]), int(far[1])))
    assert path[0].tolist() == list(start) and tuple(path[-1]) == far
    steps = np.diff(path, axis=0)
    assert np.abs(steps).max() == 1
    assert enterable[path[:, 0], path[:, 1]].all()
    for (r, c), (dr, dc) in zip(path, steps):
        assert enterable[r, c + dc] and enterable[r + dr, c]
    assert 0.5 * np.hypot(*steps.T).sum() == pytest.approx(paths.lengths[far])


def test_no_path_leads_past_a_corner_or_through_a_wall():
    enterable = np.eye(5, dtype=bool)
    paths = shortest_paths(enterable, (0, 0), 1.0)
    assert np.isfinite(paths.lengths).sum() == 1
    with pytest.raises(ValueError, match=r"\(1, 1\): no collision-free path"):
        paths.to((1, 1))


def test_rating_3_15_by_hand_and_occupancy_never_raises_it():
    information = np.array([[0.6], [0.1]])
    distance, probability = np.array([1.0, 2.0]), np.array([0.04, 0.9])
    found = fixed_price_rating(information, distance, probability, 0.1, 2.0)
    np.testing.assert_allclose(found, [[0.5 * 0.96], [-0.3]])


def test_rate_by_hand():
    found = rate_rating(np.array([[0.6, 0.3]]), np.array([0.4]), np.array([0.0]), 0.8)
    np.testing.assert_allclose(found, [[0.5, 0.25]])


def test_best_rate_is_best_with_distance_at_its_going_rate():
    generator = np.random.default_rng(4)
    information, distance = generator.random((50, 6)), 4.0 * generator.random(50)
    rate = rate_rating(information, distance, np.zeros(50), 1.2)
    priced = information - rate.max() * (distance + 1.2)[:, None]
    assert np.argmax(priced) == np.argmax(rate)
    assert priced.max() == pytest.approx(0.0, abs=1e-12)


def test_isolated_cells_are_worth_up_to_the_gain_more():
    known = np.ones((31, 31), dtype=bool)
    known[15, 15] = False
    known[:, 20:] = False
    weights = isolation_weights(known, 5, 2.0)
    assert weights[15, 15] == pytest.approx(1.0 + 2.0 * 24 / 25)
    assert weights[15, 25] == pytest.approx(1.0)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_chooses_a_free_and_reachable_pose(method):
    occupied, model = partly_mapped()
    planner = ViewPlanner(PlannerConfig(SENSOR, method), np.random.default_rng(5))
    cell = START
    for _ in range(6):
        view = planner.choose(model, cell)
        assert view is not None
        free = model.measured & (model.probability() < 0.05)
        assert free[view.candidates[:, 0], view.candidates[:, 1]].all()
        assert free[view.path[:, 0], view.path[:, 1]].all()
        assert tuple(view.path[0]) == cell and tuple(view.path[-1]) == view.cell
        assert not occupied[view.cell]
        cell = view.cell
        seen = scan(occupied, GRID, cell, view.heading, SENSOR)
        model.insert(seen.passed, seen.hit)


def test_half_of_the_candidates_are_near_and_the_present_cell_is_one():
    free = np.ones((200, 200), dtype=bool)
    model = PlanarMap(Grid())
    model.insert(free, ~free)
    sensor = RangeSensor(np.radians(75.0), 10.0)
    situation = believe(model, (100, 100), sensor, 240)
    cells = draw_candidates(situation, 150, 20.0, np.random.default_rng(6))
    assert len(np.unique(cells, axis=0)) == len(cells) <= 150
    assert [100, 100] in cells.tolist()
    near = (situation.distance(cells) <= 20.0).sum()
    assert 75 <= near <= 100


def test_max_new_and_min_old_choose_the_extreme_of_a_brute_force():
    _, model = partly_mapped()
    situation = believe(model, START, SENSOR, 240)
    for method in ("max_new", "min_old"):
        config = PlannerConfig(SENSOR, method)
        view = ViewPlanner(config, np.random.default_rng(7)).choose(model, START)
        assert view is not None
        best = None
        table = fan(SENSOR.depth, 0.5, 240)
        for cell in view.candidates:
            for heading in range(24):
                pose = (int(cell[0]), int(cell[1])), 2 * np.pi * heading / 24
                seen = expected_view(situation.opaque, *pose, SENSOR.fov, table)
                new, old = (seen & ~model.measured).sum(), (seen & model.measured).sum()
                score = new if method == "max_new" else (-old if new else -np.inf)
                if best is None or score > best:
                    best = score
        seen = expected_view(situation.opaque, view.cell, view.heading, SENSOR.fov, table)
        new, old = (seen & ~model.measured).sum(), (seen & model.measured).sum()
        # Cells counted against areas: alike but for the edge.
        chosen = new if method == "max_new" else -old
        assert chosen >= best - 0.06 * SENSOR.area / 0.25


def test_new_and_old_area_fill_the_open_sector():
    model = PlanarMap(GRID)
    everything = np.ones(GRID.shape, dtype=bool)
    everything[:, 33:] = False
    model.insert(everything, np.zeros_like(everything))
    config = PlannerConfig(SENSOR)
    new, old = new_and_old_area(config, believe(model, START, SENSOR, 240), np.array([START]))
    np.testing.assert_allclose(new + old, 1.0, rtol=1e-12)


def test_frontier_chooses_the_nearest_cell_beside_the_unknown_that_shows_enough():
    _, model = partly_mapped()
    situation = believe(model, START, SENSOR, 240)
    config = PlannerConfig(SENSOR, "frontier")
    view = ViewPlanner(config, np.random.default_rng(8)).choose(model, START)
    assert view is not None
    cells = frontier_cells(situation)
    assert list(view.cell) in cells.tolist()
    new, _ = new_and_old_area(config, situation, cells)
    enough = cells[new.max(axis=1) >= 0.1]
    assert view.length == pytest.approx(situation.distance(enough).min())


def test_raster_turns_fully_then_takes_the_next_lattice_point():
    model = PlanarMap(GRID)
    model.insert(np.ones(GRID.shape, dtype=bool), np.zeros(GRID.shape, dtype=bool))
    planner = ViewPlanner(PlannerConfig(SENSOR, "raster"), np.random.default_rng(9))
    cell, views = START, []
    for _ in range(12):
        view = planner.choose(model, cell)
        assert view is not None
        cell = view.cell
        views.append((cell, round(np.degrees(view.heading)) % 360))
    assert views[:4] == [(START, angle) for angle in (0, 90, 180, 270)]
    assert [cell for cell, _ in views[4:]] == [(40, 8)] * 4 + [(40, 24)] * 4


def test_nothing_left_to_see_ends_the_planning():
    model = PlanarMap(GRID)
    model.insert(np.ones(GRID.shape, dtype=bool), np.zeros(GRID.shape, dtype=bool))
    for method in ("max_new", "min_old", "information", "rate", "frontier"):
        planner = ViewPlanner(PlannerConfig(SENSOR, method), np.random.default_rng(10))
        assert planner.choose(model, START) is None


def test_one_unknown_cell_is_found_though_no_candidate_was_drawn_near():
    model = PlanarMap(Grid())
    known = np.ones((200, 200), dtype=bool)
    known[7, 190] = False
    model.insert(known, ~known & False)
    config = PlannerConfig(RangeSensor(np.radians(90.0), 2.0), candidates=3)
    view = ViewPlanner(config, np.random.default_rng(11)).choose(model, (100, 20))
    assert view is not None
    assert np.hypot(*np.subtract(view.cell, (7, 190))) <= 5.0


def test_claimed_cells_are_not_counted():
    _, model = partly_mapped(views=1)
    config = PlannerConfig(SENSOR)
    first = ViewPlanner(config, np.random.default_rng(12)).choose(model, START)
    assert first is not None
    table = fan(SENSOR.depth, 0.5, config.rays)
    opaque = model.measured & (model.probability() > 0.5)
    claimed = expected_view(opaque, first.cell, first.heading, SENSOR.fov, table)
    there = np.array([first.cell])
    heading = round(first.heading / (2 * np.pi) * 24) % 24
    before, after = (
        expected_information(config, believe(model, START, SENSOR, 240, claims), there)[0]
        for claims in (None, claimed)
    )
    assert before[0, heading] > 0.3
    assert after[0, heading] == pytest.approx(0.0, abs=1e-12)


def test_cooperating_robots_see_more_than_independent_ones():
    seen = {}
    for cooperative in (True, False):
        _, model = partly_mapped(views=1)
        team = PlanarTeam(3, PlannerConfig(SENSOR), np.random.default_rng(13), cooperative)
        views = team.choose(model, [START] * 3)
        table = fan(SENSOR.depth, 0.5, 240)
        opaque = model.measured & (model.probability() > 0.5)
        covered = np.zeros(GRID.shape, dtype=bool)
        for view in views:
            assert view is not None
            covered |= expected_view(opaque, view.cell, view.heading, SENSOR.fov, table)
        seen[cooperative] = (covered & ~model.measured).sum()
    assert seen[True] > 1.2 * seen[False]


def test_team_wants_one_cell_for_each_robot():
    _, model = partly_mapped()
    team = PlanarTeam(2, PlannerConfig(SENSOR), np.random.default_rng(14))
    with pytest.raises(ValueError, match="expected 2, got 1"):
        team.choose(model, [START])
    with pytest.raises(ValueError, match="robots"):
        PlanarTeam(0, PlannerConfig(SENSOR), np.random.default_rng(14))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "greedy"}, "random, raster"),
        ({"reading": "grey"}, "histogram"),
        ({"utility": "free"}, "going_rate, fixed"),
        ({"rays": 100}, "multiple"),
        ({"candidates": 0}, "candidates"),
        ({"scan_path": 0.0}, "scan_path"),
        ({"price": -1.0}, "price"),
    ],
)
def test_impossible_settings_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(PlannerConfig(), **change)
