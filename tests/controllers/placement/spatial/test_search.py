"""The fast search finds what rating every candidate finds, and reports why if there is none."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from controllers.placement.spatial.best_first import direction_tree
from controllers.placement.spatial.occluders import before_plane, expand, occluders_of_voxels
from controllers.placement.spatial.search import (
    SearchConfig,
    SpatialTask,
    best_view,
    best_view_of_all,
    rate_directions,
    rate_positions,
    spherical,
    views_in_order,
)
from controllers.placement.task import Exponents, PlacementError
from tests.controllers.placement.spatial.scenes import (
    LENS,
    box,
    disc_target,
    random_occluders,
)
from tests.perception.voxels.wall_views import scanned

COARSE = SearchConfig(level=3, rings=8, refine=False)


def patchy(points):
    """Free, unknown and uncertain positions in turn."""
    wave = np.sin(40 * points[:, 0]) * np.sin(37 * points[:, 1]) * np.sin(23 * points[:, 2])
    return np.where(wave > 0.2, np.nan, 0.024 * (1.0 + np.sin(50 * points[:, 0])))


def random_fields(rng, count=1):
    fields = []
    while len(fields) < count:
        target = disc_target(f"hole {len(fields)}", rng.normal(size=3), rng.normal(size=3))
        try:
            fields.append(expand(target, random_occluders(rng, int(rng.integers(3, 21)), target)))
        except PlacementError:
            continue
    return fields


def test_triangles_cover_the_half_sphere_and_hold_their_parts():
    tree = direction_tree(3)
    leaves = tree.leaves
    assert len(leaves) == 4**4
    # An octant's corner is as far from its middle as the edge from the diagonal of a cube.
    np.testing.assert_allclose(tree.radii[:4], np.arccos(3.0**-0.5))
    assert np.all(leaves[:, 2] > 0.0)
    for node in range(tree.first_leaf):
        children = tree.centres[4 * node + 4 : 4 * node + 8]
        apart = np.arccos(np.clip(children @ tree.centres[node], -1.0, 1.0))
        assert np.all(apart <= tree.radii[node])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(2000, 3)) * [1, 1, 1]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = np.abs(directions[:, 2])
    nearest = np.arccos(np.clip((directions @ leaves.T).max(axis=1), -1.0, 1.0))
    assert nearest.max() <= tree.radii[tree.first_leaf :].max()


def test_fast_search_finds_the_best_of_all_candidates():
    rng = np.random.default_rng(4)
    for case in range(24):
        fields = random_fields(rng, 1 + case % 2)
        occupancy = patchy if case % 3 == 0 else None
        exponents = Exponents(*rng.uniform(0.3, 2.0, 4)) if case % 5 == 0 else Exponents()
        config = dataclasses.replace(COARSE, exponents=exponents)
        task = SpatialTask(fields, LENS, occupancy, config)
        slow = best_view_of_all(task)
        fast = best_view(task)
        assert fast.rating == pytest.approx(slow.rating, rel=1e-12)
        finer = best_view(
            dataclasses.replace(task, config=dataclasses.replace(config, refine=True))
        )
        assert finer.rating >= fast.rating * (1.0 - 1e-12)


def test_candidates_come_in_falling_order_and_none_is_left_out():
    rng = np.random.default_rng(5)
    fields = random_fields(rng, 2)
    ordered = np.array(
        [view.rating for view in views_in_order(SpatialTask(fields, LENS, patchy, COARSE))]
    )
    assert np.all(np.diff(ordered) <= 1e-9 * ordered[1:])
    rings = np.geomspace(LENS.near, LENS.far, COARSE.rings)
    places = direction_tree(COARSE.level).leaves[:, None] * rings[:, None]
    every = [
        view.rating
        for field in fields
        for view in rate_positions(field, LENS, field.to_world(places.reshape(-1, 3)), patchy)
    ]
    every = np.sort(every)[::-1]
    np.testing.assert_allclose(ordered, every[: len(ordered)], rtol=1e-9)
    assert np.all(every[len(ordered) :] == 0.0)


def test_each_direction_is_rated_at_its_best_distance():
    field = random_fields(np.random.default_rng(6))
    rated = rate_directions(SpatialTask(field, LENS, patchy, COARSE))
    best = {}
    for view in views_in_order(SpatialTask(field, LENS, patchy, COARSE)):
        direction = tuple(np.round((view.position - field[0].target.position) / view.distance, 9))
        best.setdefault(direction, view.rating)
    np.testing.assert_allclose(rated.ratings, sorted(best.values(), reverse=True), rtol=1e-9)


def test_wall_at_sixty_degrees_gives_five_inch_zero_and_sixty_degrees():
    """RF ~ sin(phi) min(phi, 2 pi / 3 - phi), so the optimum is at pi / 3, as near as in focus."""
    target = disc_target(radius=0.01)
    slope = np.tan(np.pi / 3)
    foot = 0.05  # The expanded wall's upper edge is at x = -foot and z = slope * foot.
    wall = box("wall", [-foot - 0.06, 0.0, -0.5 + slope * foot], [0.05, 20.0, 0.5])
    view = best_view(SpatialTask([expand(target, [wall])], LENS))
    distance, azimuth, elevation = spherical(expand(target, [wall]), view.position)
    assert distance == pytest.approx(0.127, abs=1e-6)
    np.testing.assert_allclose(np.rad2deg([azimuth, elevation]), [0.0, 60.0], atol=0.25)
    assert view.free_cap == pytest.approx(np.pi / 3, abs=2e-3)


def test_refined_view_of_an_unhidden_target_is_straight_above_it():
    field = expand(disc_target(), [])
    best = best_view(SpatialTask([field], LENS, config=dataclasses.replace(COARSE, refine=True)))
    distance, _, elevation = spherical(field, best.position)
    # RF rises with the elevation and falls with the distance.
    assert distance == pytest.approx(LENS.near, abs=1e-4)
    assert np.rad2deg(elevation) == pytest.approx(90.0, abs=0.005)


def test_refined_view_is_as_near_as_is_free_between_two_rings():
    field = expand(disc_target(), [])
    rings = np.geomspace(LENS.near, LENS.far, COARSE.rings)
    nearest = 0.8 * rings[2] + 0.2 * rings[3]

    def occupancy(points):
        return np.where(np.linalg.norm(points, axis=1) < nearest, np.nan, 0.0)

    config = dataclasses.replace(COARSE, refine=True)
    best = best_view(SpatialTask([field], LENS, occupancy, config))
    assert best.distance == pytest.approx(nearest, abs=5e-4)


def test_views_are_offered_best_first_until_one_is_accepted():
    field = random_fields(np.random.default_rng(7))
    offered = []

    def accept(view):
        offered.append(view.rating)
        return len(offered) == 30

    view = best_view(SpatialTask(field, LENS, config=COARSE), accept)
    expected = [
        v.rating
        for v in itertools.islice(views_in_order(SpatialTask(field, LENS, None, COARSE)), 30)
    ]
    assert offered == expected
    assert view.rating == expected[-1]


def test_cameras_are_placed_only_where_a_voxel_map_is_known_to_be_free():
    voxels = scanned()
    target = disc_target(position=[0.0, 0.0, 0.6], normal=[0.0, 0.0, -1.0])
    cells, _ = voxels.occupied_cells()
    points = before_plane(target, voxels.grid.centres(cells), 0.02)
    parts = occluders_of_voxels(points, voxels.grid.resolution)
    lens = dataclasses.replace(LENS, near=0.2)
    view = best_view(SpatialTask([expand(target, parts)], lens, voxels.probabilities))
    assert view.position[2] < 0.6
    assert view.occupancy < 0.05
    assert view.occupancy == voxels.probabilities(view.position[None])[0]
    behind = disc_target(position=[0.0, 0.0, 0.62])
    with pytest.raises(PlacementError, match="100% are not known to be free"):
        best_view(SpatialTask([expand(behind, [])], lens, voxels.probabilities))


def test_no_pose_is_answered_with_the_share_of_each_reason():
    lid = box("lid", [0.0, 0.0, 0.06], [0.07, 0.07, 0.01])
    sides = [
        box(
            f"side {k}",
            [0.06 * x, 0.06 * y, 0.03],
            [0.06 - 0.05 * x * x, 0.06 - 0.05 * y * y, 0.04],
        )
        for k, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1)])
    ]
    for search in (best_view, best_view_of_all):
        with pytest.raises(PlacementError, match=r"'hole': of 2048 .*% are hidden.*'(lid|side .)'"):
            search(SpatialTask([expand(disc_target(), [lid, *sides])], LENS, patchy, COARSE))
    field = expand(disc_target(), [])
    with pytest.raises(PlacementError, match="100% are not known to be free"):
        best_view(SpatialTask([field], LENS, lambda p: np.full(len(p), np.nan)))
    with pytest.raises(PlacementError, match="100% are refused"):
        best_view(SpatialTask([field], LENS, config=COARSE), lambda view: False)


def test_shares_of_the_reasons_are_all_candidates_largest_first():
    field = random_fields(np.random.default_rng(8))
    with pytest.raises(PlacementError) as error:
        best_view(SpatialTask(field, LENS, patchy, COARSE), lambda view: False)
    shares = [int(share) for share in re.findall(r"(\d+)% are", str(error.value))]
    assert len(shares) == 3 and shares == sorted(shares, reverse=True)
    assert sum(shares) == pytest.approx(100, abs=2)


def test_refined_view_that_is_refused_gives_way_to_the_candidate():
    task = SpatialTask(random_fields(np.random.default_rng(7)), LENS, config=COARSE)
    plain = best_view(task)
    fine = dataclasses.replace(task, config=dataclasses.replace(COARSE, refine=True))
    assert best_view(fine).rating > plain.rating
    assert best_view(fine, lambda view: view.rating <= plain.rating).rating == plain.rating


@pytest.mark.parametrize("seed", range(6))
def test_refined_view_goes_along_the_edge_of_what_is_feasible(seed):
    """Held against a dense sample of the places that are feasible about the best candidate."""
    rng = np.random.default_rng(seed)
    (field,) = random_fields(rng)
    task = SpatialTask([field], LENS, config=COARSE)
    top = best_view(task).position
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    # Cut off so that the best candidate of all is not feasible.
    border = top @ normal - 0.05

    def accept(view):
        return view.position @ normal <= border

    plain = best_view(task, accept)
    fine = dataclasses.replace(task, config=dataclasses.replace(COARSE, refine=True))
    refined = best_view(fine, accept)
    assert accept(refined) and refined.rating >= plain.rating
    away = refined.position - field.target.position
    near = field.target.position + away + rng.normal(0.0, 0.02, (4000, 3))
    near = near[near @ normal <= border]
    rated = max(view.rating for view in rate_positions(field, LENS, near))
    assert refined.rating > 0.998 * rated


def test_rated_directions_name_their_target():
    fields = random_fields(np.random.default_rng(5), 2)
    rated = rate_directions(SpatialTask(fields, LENS, patchy, COARSE))
    assert set(rated.fields) == {0, 1}
    for number, field in enumerate(fields):
        mine = rated.fields == number
        views = rate_positions(field, LENS, rated.positions[mine], patchy)
        np.testing.assert_allclose([view.rating for view in views], rated.ratings[mine], rtol=1e-9)


def test_spherical_coordinates_are_of_the_targets_frame():
    field = expand(disc_target(position=[1.0, 0.0, 0.0]), [])
    found = spherical(field, [1.1, 0.2, 0.2])
    np.testing.assert_allclose(found, [0.3, np.arctan2(0.2, 0.1), np.arcsin(2.0 / 3.0)])


def test_senseless_searches_are_refused():
    with pytest.raises(ValueError, match="level 99"):
        SearchConfig(level=99)
    with pytest.raises(ValueError, match="rings 1"):
        SearchConfig(rings=1)
    with pytest.raises(ValueError, match="no target"):
        SpatialTask([], LENS)
