"""The search for a target by driving, against counts and geometry made by hand."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from controllers.mapping.panel_search import Cloud, Ground, PanelSearch, PanelSearchConfig

CONFIG = PanelSearchConfig()
EMPTY = Ground(np.full((100, 100), np.nan), np.array([-2.5, -2.5]), 0.05)


def camera(place, target):
    """Camera at a place that looks at a target, its rows level."""
    ahead = np.subtract(target, place) / np.linalg.norm(np.subtract(target, place))
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(ahead, right), ahead])
    return RigidTransform.from_components(place, Rotation.from_matrix(axes))


def cloud_of(*places, normal=(-1.0, 0.0)):
    spots = np.array(places, dtype=float)
    frames = np.column_stack([spots[:, :2], np.full(len(spots), 0.5 * math.pi)])
    return Cloud(spots, np.tile(np.array(normal, dtype=float), (len(places), 1)), frames)


def search_of(*places, normal=(-1.0, 0.0)):
    return PanelSearch(cloud_of(*places, normal=normal))


def test_a_miss_makes_only_places_unlikely_that_it_should_have_shown():
    eye = [0.0, 0.0, 0.4]
    far = CONFIG.reach[1]
    search = search_of(
        [1.2, 0.0, 0.2],  # in view
        [1.2, 1.2, 0.2],  # aside
        [far + 0.1, 0.0, 0.2],  # too far
        [-1.2, 0.0, 0.2],  # behind, and facing away
    )
    search.miss(camera(eye, [1.2, 0.0, 0.2]), EMPTY)
    left = CONFIG.passed + CONFIG.opaque - CONFIG.passed * CONFIG.opaque
    np.testing.assert_allclose(search.weights, np.array([left, 1, 1, 1]) / (3 + left))


def test_a_view_that_was_chosen_counts_more_than_one_on_the_way():
    search = search_of([1.2, 0.0, 0.2], [-1.2, 0.0, 0.2])
    chosen = search.best(np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY)
    search.miss(camera([0.0, 0.0, 0.4], chosen.target), EMPTY, chosen)
    missed = CONFIG.missed[0]
    left = missed + CONFIG.opaque - missed * CONFIG.opaque
    np.testing.assert_allclose(search.weights, np.array([left, 1.0]) / (1.0 + left))


@pytest.mark.parametrize(("away", "share"), [(1.0, 0.0), (2.95, 0.5), (3.95, 0.976)])
def test_a_view_from_farther_away_tells_less(away, share):
    search = search_of([away, 0.0, 0.4], [-1.2, 0.0, 0.2])
    chosen = search.best(np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY)
    search.miss(camera([0.0, 0.0, 0.4], chosen.target), EMPTY, chosen)
    near, far = CONFIG.missed
    missed = near + share * (far - near)
    left = missed + CONFIG.opaque - missed * CONFIG.opaque
    np.testing.assert_allclose(search.weights[0], left / (1.0 + left), rtol=1e-3)


def test_a_face_turned_away_is_not_missed():
    search = search_of([1.2, 0.0, 0.2], [1.2, 0.1, 0.2], normal=(1.0, 0.0))
    search.miss(camera([0.0, 0.0, 0.4], [1.2, 0.0, 0.2]), EMPTY)
    np.testing.assert_allclose(search.weights, 0.5)


def test_a_wall_on_the_map_hides_what_stands_behind_it_and_below_its_edge():
    heights = np.full((100, 100), 0.0)
    heights[:, 60:62] = 0.5  # x from 0.5 to 0.6
    ground = Ground(heights, np.array([-2.5, -2.5]), 0.05)
    eye = np.array([0.0, 0.0, 0.4])
    points = np.array([[1.2, 0.0, 0.2], [1.2, 0.0, 0.9], [0.45, 0.0, 0.2], [-1.0, 0.3, 0.2]])
    assert ground.hidden(eye, points).tolist() == [True, False, False, False]
    search = search_of(points[0], points[0] + [0.0, 0.1, 0.0])
    search.miss(camera(eye, points[0]), ground)
    np.testing.assert_allclose(search.weights, 0.5)


def test_where_the_map_shows_bare_ground_no_target_stands():
    heights = np.full((100, 100), np.nan)
    heights[40:60, 50:90] = 0.0  # y from -0.5 to 0.5, x from 0 to 2
    heights[48:52, 72:76] = 0.25  # about (1.2, 0)
    ground = Ground(heights, np.array([-2.5, -2.5]), 0.05)
    places = (
        [0.5, 0.0, 0.2],  # bare
        [1.2, 0.0, 0.2],  # where something stands
        [1.1, 0.1, 0.2],  # beside it
        [-1.0, 0.0, 0.2],  # unknown
        [9.0, 0.0, 0.2],  # beyond the map
        [1.8, 0.0, 0.05],  # so low that it would not stand out
    )
    search = search_of(*places)
    for _ in range(2):  # It is told once.
        search.stands(ground)
        left = np.array([CONFIG.empty, 1.0, 1.0, 1.0, 1.0, 1.0])
        np.testing.assert_allclose(search.weights, left / left.sum())
    # What a view shows there speaks against the map, not the other way round.
    search.sight(cloud_of(places[0]))
    search.stands(ground)
    assert search.sighted and search.weights.max() == pytest.approx(CONFIG.sighted)
    assert search.weights.sum() == pytest.approx(1.0)


def test_the_best_view_is_the_one_with_most_chance_a_second():
    cluster = [1.2, 0.0, 0.2]
    search = search_of(*([cluster] * 9), [-1.2, 0.0, 0.2])
    places = np.array([[0.0, 0.0], [0.2, 0.0]])
    view = search.best(places, np.array([0.0, 0.2]), np.full(2, 0.4), EMPTY)
    odds = 0.9 * (1 - CONFIG.missed[0]) * (1 - CONFIG.opaque)
    assert view.place.tolist() == [0.0, 0.0]
    assert view.chance == pytest.approx(odds) and view.rate == pytest.approx(
        odds / CONFIG.view_time
    )
    np.testing.assert_allclose(view.target, cluster)


def test_a_drive_is_worth_it_where_nothing_can_be_seen_from_here():
    search = search_of(*([[6.0, 0.0, 0.2]] * 5))
    places = np.array([[0.0, 0.0], [3.0, 0.0], [2.5, 0.0]])
    lengths = np.array([0.0, 3.0, 2.5])
    view = search.best(places, lengths, np.full(3, 0.4), EMPTY)
    assert view.place.tolist() == [3.0, 0.0]  # from nearer the view misses less
    lengths[1] = 4.5
    view = search.best(places, lengths, np.full(3, 0.4), EMPTY)
    assert view.place.tolist() == [2.5, 0.0]


def test_nothing_to_be_seen_has_no_rate():
    search = search_of([9.0, 0.0, 0.2])
    assert search.best(np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY).rate == 0.0


def test_drawn_places_see_the_face_from_within_reach():
    search = search_of([4.0, 0.0, 0.2], [0.0, 3.0, 0.2], normal=(0.6, 0.8))
    places = search.draw_places(200, np.random.default_rng(1))
    away = np.linalg.norm(places[:, None] - search.places[:, :2], axis=2)
    nearest = search.places[np.argmin(away, axis=1), :2]
    out = (places - nearest) / np.linalg.norm(places - nearest, axis=1)[:, None]
    assert away.min(axis=1).max() < CONFIG.sight
    assert np.degrees(np.arccos(out @ [0.6, 0.8])).max() < math.degrees(CONFIG.slant)


def test_what_likely_stands_somewhere_is_kept_off():
    rng = np.random.default_rng(5)
    vague = search_of(*np.column_stack([rng.uniform(-3, 3, (900, 2)), np.zeros(900)]))
    assert len(vague.likely_discs(np.array([[0.0, 0.0, 0.2]]))) == 0
    sure = search_of(*([[1.0, 0.5, 0.2]] * 9), [-2.0, 0.0, 0.2])
    # A quarter turn of the ground frame brings its x to y.
    discs = sure.likely_discs(np.array([[0.4, 0.0, 0.2]]))
    assert np.linalg.norm(discs[:, :2] - [1.0, 0.9], axis=1).max() < 0.15
    assert np.all(discs[:, 2] == 0.2)
    for _ in range(40):
        sure.miss(camera([0.0, 0.5, 0.4], [1.0, 0.5, 0.2]), EMPTY)
    discs = sure.likely_discs(np.array([[0.4, 0.0, 0.2]]))
    assert np.linalg.norm(discs[:, :2] - [-2.0, 0.4], axis=1).max() < 0.15


def test_a_sighting_draws_the_odds_to_where_it_was_until_near_views_miss_it():
    spots = [[1.0, 0.0, 0.2], [1.2, 0.1, 0.2], [-2.0, 0.0, 0.2], [-2.0, 2.0, 0.2]]
    search = search_of(*spots)
    search.sight(cloud_of([5.0, 5.0, 0.3]))  # Nothing may stand there.
    np.testing.assert_allclose(search.weights, 0.25)
    there = [1.1, 0.05, 0.3]
    search.sight(cloud_of(there, normal=(1.0, 0.0)))  # Its face looks the other way there.
    np.testing.assert_allclose(search.weights, 0.25)
    assert not search.sighted
    search.miss(camera([-3.2, 2.0, 0.4], [-2.0, 2.0, 0.2]), EMPTY)
    for sighting in ([1.1, 0.05, 0.3], [1.14, 0.0, 0.3]):
        search.sight(cloud_of(sighting))
        assert search.sighted
        # It takes the place of the least likely one, and the next one takes its place.
        seen = np.flatnonzero(np.isclose(search.places, sighting).all(axis=1))
        assert len(seen) == 1 and search.weights[seen[0]] == pytest.approx(CONFIG.sighted)
        assert search.weights.sum() == pytest.approx(1.0)
        assert all(np.any(np.isclose(search.places, spot).all(axis=1)) for spot in spots[:3])
    for step in range(4):
        eye = np.array([0.0, 0.4 * (step % 2), 0.4])
        view = search.best(eye[None, :2], np.zeros(1), np.full(1, 0.4), EMPTY)
        search.miss(camera(eye, view.target), EMPTY, view)
    assert not search.sighted


def test_of_two_poses_that_fit_a_sighting_the_odds_are_those_that_were_known_before():
    ways = [(-1.0, 0.0), (0.0, -1.0)]
    spots = [cloud_of([1.0, 0.0, 0.2], normal=normal) for normal in (*ways, ways[0], ways[0])]
    parts = (np.concatenate(part) for part in zip(*spots, cloud_of([4.0, 4.0, 0.2])))
    search = PanelSearch(Cloud(*parts))
    search.sight(*(cloud_of([1.05, 0.0, 0.2], normal=normal) for normal in ways))
    seen = np.isclose(search.places[:, 0], 1.05)
    odds = search.weights[seen][np.argsort(search._normals[seen, 0])]
    np.testing.assert_allclose(odds, CONFIG.sighted * np.array([0.75, 0.25]), rtol=1e-6)
    assert search.weights.sum() == pytest.approx(1.0)
    # The other way round, with one pose that nothing speaks for.
    search.sight(*(cloud_of([1.05, 0.0, 0.2], normal=normal) for normal in ((1.0, 0.0), ways[1])))
    assert search.weights.max() == pytest.approx(CONFIG.sighted, rel=1e-6)


def test_what_was_sighted_far_away_is_to_be_seen_from_near():
    far = CONFIG.reach[1] + 0.5
    search = search_of([far, 0.0, 0.2])
    here = np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY
    assert search.best(*here).rate > 0.0
    search.sight(cloud_of([far, 0.0, 0.2]))
    assert search.best(*here).rate > 0.0
    search.within = 0.8 * far  # What the view told is not enough.
    assert search.best(*here).rate == 0.0
    places = search.draw_places(50, np.random.default_rng(0))
    assert np.linalg.norm(places - [far, 0.0], axis=1).max() < CONFIG.reach[1]


def test_what_another_robot_hides_is_not_missed():
    search = search_of([1.2, 0.0, 0.2], [1.2, 0.1, 0.2], [1.2, 0.9, 0.2])
    eye, here = np.array([0.0, 0.0, 0.4]), (np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY)
    # The ground frame has its origin at the target and is turned by a quarter: it is at (0.6, 0).
    search.hiding = np.array([[0.0, 0.6, 0.3]])
    search.miss(camera(eye, [1.2, 0.0, 0.2]), EMPTY)
    np.testing.assert_allclose(search.weights, 1.0 / 3.0)
    assert search.best(*here).shown.tolist() == [False, False, True]
    search.hiding = np.zeros((0, 3))
    assert search.best(*here).shown.tolist() == [True, True, False]


def test_a_target_in_sight_is_likely_near_open_to_the_eye_and_turned_to_it():
    heights = np.full((100, 100), 0.0)
    heights[:20, 60:62] = 0.5  # x from 0.5 to 0.6, y below -1.5
    places = np.array(
        [[2.0, 0.0, 0.2], [CONFIG.sight + 0.1, 0.0, 0.2], [0.9, -2.4, 0.2], [2.0, 0.3, 0.2]]
    )
    search = search_of(*places)
    eye, ground = np.array([0.0, 0.0, 0.4]), Ground(heights, np.array([-2.5, -2.5]), 0.05)
    np.testing.assert_array_equal(search.in_sight(eye, ground), places[[0, 3]])
    search.weights[:] = [0.6, 0.2, 0.199, 0.001]
    np.testing.assert_array_equal(search.in_sight(eye, ground), places[[0]])
    assert not len(search.in_sight(np.array([4.5, 0.0, 0.4]), ground))


def test_a_view_decided_on_before_is_kept_unless_another_one_is_clearly_better():
    """Two likely places on either side, each with its own view 1.2 m before it."""
    search = search_of([3.2, 5.0, 0.2], [3.2, -5.0, 0.2])
    places = np.array([[0.0, 0.0], [2.0, 5.0], [2.0, -5.0]])
    lengths, heights = np.array([0.0, 5.4, 5.4]), np.full(3, 0.4)
    for odds, kept in ((0.6, True), (0.7, False)):
        search.weights[:] = [odds, 1.0 - odds]
        chosen = search.best(places, lengths, heights, EMPTY)
        np.testing.assert_array_equal(chosen.place, places[1])
        again = search.best(places, lengths, heights, EMPTY, places[2])
        np.testing.assert_array_equal(again.place, places[2 if kept else 1])
        assert again.rate <= chosen.rate


def test_a_view_from_the_same_place_again_tells_nothing_new():
    search = search_of([1.2, 0.0, 0.2], [1.2, 0.1, 0.2], [-3.0, 0.0, 0.2])
    here = np.zeros((1, 2)), np.zeros(1), np.full(1, 0.4), EMPTY
    view = search.best(*here)
    search.miss(camera([0.0, 0.0, 0.4], view.target), EMPTY, view)
    once = search.weights.copy()
    assert search.best(*here).rate == 0.0
    search.miss(camera([0.1, 0.0, 0.4], view.target), EMPTY, view)
    np.testing.assert_allclose(search.weights, once)
    aside = np.array([[0.0, 0.5]])
    again = search.best(aside, *here[1:])
    assert again.rate > 0.0
    search.miss(camera([0.0, 0.5, 0.4], again.target), EMPTY, again)
    assert search.weights[0] < once[0]
