"""The elevation map against formulas, and what false matches, edges and ghosts do to it."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.elevation.grid import ElevationGrid
from perception.elevation.map import ElevationMap, ElevationMapConfig
from perception.voxels.grid import MapError

GRID = ElevationGrid((-0.3, 0.2), (8, 12))
CELL = (3, 5)
SIGMA = 0.004
FLOOR = ElevationMapConfig().least_sigma ** 2


def points_in(heights, rng, cell=CELL):
    """Points of given heights somewhere in a cell."""
    heights = np.asarray(heights, dtype=float)
    low = np.array(GRID.corner) + GRID.cell * np.array(cell)[::-1]
    return np.column_stack([low + rng.uniform(0.0, GRID.cell, (len(heights), 2)), heights])


def covariances(points, sigma=SIGMA):
    return np.tile(np.diag([1e-4, 1e-4, sigma**2]), (len(points), 1, 1))


def inserted(model, heights, seed=0, sigma=SIGMA):
    points = points_in(heights, np.random.default_rng(seed))
    return model.insert(points, covariances(points, sigma))


def test_cells_and_centres_are_inverse_and_go_on_beyond_the_grid():
    centres = GRID.centres
    assert centres.shape == (8, 12, 2)
    np.testing.assert_allclose(centres[0, 0], [-0.275, 0.225])
    np.testing.assert_allclose(centres[2, 7], [-0.3 + 7.5 * 0.05, 0.2 + 2.5 * 0.05])
    rows, columns = np.indices(GRID.shape)
    cells = GRID.cells_of(centres)
    np.testing.assert_array_equal(cells, np.stack([rows, columns], axis=-1))
    assert GRID.inside(cells).all()
    beyond = GRID.cells_of([[-0.301, 0.31], [0.301, 0.31], [0.01, 0.601]])
    np.testing.assert_array_equal(beyond, [[2, -1], [2, 12], [8, 6]])
    assert not GRID.inside(beyond).any()


@pytest.mark.parametrize(
    ("corner", "shape", "cell"),
    [
        ((0, 0), (0, 4), 0.05),
        ((0, 0), (4, 9999), 0.05),
        ((np.nan, 0), (4, 4), 1.0),
        ((0, 0), (4, 4), 0.0),
    ],
)
def test_impossible_grids_are_refused(corner, shape, cell):
    with pytest.raises(MapError, match="expected"):
        ElevationGrid(corner, shape, cell)


def test_height_is_the_mean_of_its_points_and_states_how_sure_it_is():
    """Independent points: the squared error over the variance is 1 in the mean."""
    config = ElevationMapConfig(correlated_points=1.0, least_sigma=1e-6, roughness=1e-6)
    rng, ratios, biases = np.random.default_rng(1), [], []
    for _ in range(400):
        model = ElevationMap(GRID, config)
        inserted(model, 0.1 + SIGMA * rng.standard_normal(40), seed=int(rng.integers(1e9)))
        biases.append(model.heights[CELL] - 0.1)
        ratios.append(biases[-1] ** 2 / model.variances[CELL])
    assert abs(np.mean(biases)) < 4.0 * SIGMA / np.sqrt(40 * 400)
    assert 0.75 < np.mean(ratios) < 1.3


def test_points_weigh_by_their_variances_and_scatter_counts_where_it_is_larger():
    config = ElevationMapConfig(correlated_points=1.0, least_sigma=1e-9)
    model, points = ElevationMap(GRID, config), points_in([0.0, 0.006], np.random.default_rng(1))
    spread = np.concatenate([covariances(points[:1], 0.004), covariances(points[1:], 0.010)])
    model.insert(points, spread)
    weights = 1.0 / (np.array([0.004, 0.010]) ** 2 + config.roughness**2)
    mean = 0.006 * weights[1] / weights.sum()
    assert model.heights[CELL] == pytest.approx(mean)
    assert model.variances[CELL] == pytest.approx(weights @ [16e-6, 100e-6] / weights.sum() / 2.0)
    model = ElevationMap(GRID, config)
    inserted(model, [0.0, 0.006], sigma=0.001)
    assert model.heights[CELL] == pytest.approx(0.003)
    assert model.variances[CELL] == pytest.approx(0.003**2 / 2.0)


def test_points_that_share_their_error_count_as_one():
    model = ElevationMap(GRID)
    inserted(model, np.full(52, 0.2))
    assert model.variances[CELL] == pytest.approx(SIGMA**2 / 4.0 + FLOOR)
    model = ElevationMap(GRID)
    inserted(model, np.full(5, 0.2))
    assert model.variances[CELL] == pytest.approx(SIGMA**2 + FLOOR)


@pytest.mark.parametrize("off", [-0.5, -0.05, 0.05, 0.5])
@pytest.mark.parametrize("count", [3, 10, 40])
def test_false_matches_make_no_obstacle(off, count):
    """One point far off among few, and five of a hundred, each elsewhere."""
    rng = np.random.default_rng(2)
    heights = SIGMA * rng.standard_normal(count)
    strays = max(1, count // 20)
    heights[:strays] = off * np.linspace(1.0, 2.0, strays)
    model = ElevationMap(GRID)
    inserted(model, heights)
    # Of three, the two true ones may contradict each other: then nothing is known.
    assert model.known[CELL] or count == 3
    assert not abs(model.heights[CELL]) > 4.5 * SIGMA / np.sqrt(count - strays)


def test_a_cell_whose_only_two_points_contradict_each_other_stays_unknown():
    model = ElevationMap(GRID)
    assert len(inserted(model, [0.0, 0.1])) == 0
    assert len(inserted(model, [0.1])) == 0
    assert not model.known.any()
    assert inserted(model, [0.0, 0.001]).tolist() == [3 * 12 + 5]
    assert model.known[CELL] and model.known.sum() == 1


def test_of_two_surfaces_with_as_many_points_the_upper_counts():
    model = ElevationMap(GRID)
    inserted(model, [0.0, 0.1, 0.0, 0.1])
    assert model.heights[CELL] == pytest.approx(0.1)


@pytest.mark.parametrize("share", [0.25, 0.5, 0.8])
def test_where_a_cell_holds_an_edge_the_upper_surface_counts(share):
    rng, errors = np.random.default_rng(3), []
    for _ in range(50):
        upper = np.arange(40) < 40 * share
        model = ElevationMap(GRID)
        inserted(model, 0.06 * upper + SIGMA * rng.standard_normal(40))
        errors.append(model.heights[CELL] - 0.06)
    assert abs(np.mean(errors)) < 0.002
    assert np.abs(errors).max() < 0.01


def test_false_matches_above_an_edge_make_no_obstacle_either():
    """A tenth of the points, each alone: what counts is where several agree."""
    rng = np.random.default_rng(3)
    heights = 0.06 * (np.arange(40) < 20) + SIGMA * rng.standard_normal(40)
    heights[:4] = [0.2, 0.3, 0.4, 0.5]
    model = ElevationMap(GRID)
    inserted(model, heights)
    assert model.heights[CELL] == pytest.approx(0.06, abs=0.009)


def test_an_upright_face_is_nearly_as_high_as_its_top():
    rng, heights = np.random.default_rng(4), []
    for _ in range(20):
        model = ElevationMap(GRID)
        inserted(model, rng.uniform(0.0, 0.06, 30) + SIGMA * rng.standard_normal(30))
        heights.append(model.heights[CELL])
    assert min(heights) > 0.03 and max(heights) < 0.065
    assert np.mean(heights) > 0.042


def test_ground_that_slopes_within_its_cells_is_no_edge():
    """At 15 degrees a cell of 50 mm rises by 13 mm: heights are those of the cells' centres."""
    rng = np.random.default_rng(5)
    places = rng.uniform([-0.3, 0.2], [0.3, 0.6], (20000, 2))
    slope = np.tan(np.radians(15.0)) * np.array([0.6, 0.8])
    points = np.column_stack([places, places @ slope + SIGMA * rng.standard_normal(20000)])
    model = ElevationMap(GRID)
    assert len(model.insert(points, covariances(points))) == GRID.size
    assert np.abs(model.heights - GRID.centres @ slope).max() < 0.0025


def test_views_are_weighted_by_their_variances():
    """Against the closed form: the inverse variances add up, and weight the heights."""
    heights, sigmas = [0.100, 0.106, 0.097], [0.004, 0.008, 0.005]
    model = ElevationMap(GRID, ElevationMapConfig(least_sigma=1e-9))
    for height, sigma in zip(heights, sigmas):
        assert len(inserted(model, [height, height], sigma=sigma)) == 1
    weights = 1.0 / np.square(sigmas)
    assert model.heights[CELL] == pytest.approx(weights @ heights / weights.sum(), abs=1e-9)
    assert model.variances[CELL] == pytest.approx(1.0 / weights.sum(), rel=1e-6)


def test_a_cell_is_never_surer_than_its_own_deviation():
    model = ElevationMap(GRID)
    for _ in range(100):
        inserted(model, [0.1, 0.1])
    assert model.variances[CELL] == pytest.approx(FLOOR)


def test_what_is_clearly_above_replaces_and_what_is_clearly_below_is_believed_at_the_third_view():
    model = ElevationMap(GRID)
    inserted(model, np.zeros(5))
    assert len(inserted(model, np.full(5, 0.05))) == 1
    assert model.heights[CELL] == pytest.approx(0.05)
    assert model.variances[CELL] == pytest.approx(SIGMA**2 + FLOOR)
    for height in (0.001, -0.001):
        assert len(inserted(model, np.full(5, height))) == 0
        assert model.heights[CELL] == pytest.approx(0.05)
    assert len(inserted(model, np.zeros(5))) == 1
    assert model.heights[CELL] == pytest.approx(0.0, abs=1e-9)
    assert model.variances[CELL] == pytest.approx((SIGMA**2 + FLOOR) / 3.0)


def test_a_block_keeps_its_top_if_that_is_seen_from_time_to_time():
    model = ElevationMap(GRID)
    for _ in range(10):
        for height in (0.05, 0.0, 0.0):
            inserted(model, np.full(5, height))
            assert model.heights[CELL] == pytest.approx(0.05, abs=1e-3)


def test_views_below_that_contradict_each_other_are_not_believed():
    model = ElevationMap(GRID)
    inserted(model, np.full(5, 0.2))
    for height in (0.0, 0.1, 0.0, 0.1, 0.05, 0.05):
        inserted(model, np.full(5, height))
    assert model.heights[CELL] == pytest.approx(0.2)
    inserted(model, np.full(5, 0.05))
    assert model.heights[CELL] == pytest.approx(0.05)


def test_views_below_count_anew_once_something_above_was_seen():
    model = ElevationMap(GRID)
    for height in (0.1, 0.0, 0.0, 0.2, 0.0, 0.0):
        inserted(model, np.full(5, height))
    assert model.heights[CELL] == pytest.approx(0.2)


def test_two_sure_heights_a_few_millimetres_apart_are_of_one_surface():
    """A pose's error moves all points of a view alike, and makes no step."""
    model = ElevationMap(GRID)
    for _ in range(30):
        inserted(model, np.zeros(200), sigma=1e-4)
    inserted(model, np.full(200, -0.009), sigma=1e-4)
    assert model.heights[CELL] == pytest.approx(-0.0045, abs=5e-4)


def test_a_pose_s_error_is_not_averaged_away():
    turn, shift = np.array([0.01, 0.02, 0.03]), np.array([0.004, 0.005, 0.006])
    plain, uncertain = ElevationMap(GRID), ElevationMap(GRID)
    points = points_in(np.full(100, 0.3), np.random.default_rng(6))
    plain.insert(points, covariances(points))
    uncertain.insert(points, covariances(points), np.diag(np.concatenate([turn, shift]) ** 2))
    x, y = GRID.centres[CELL]
    added = shift[2] ** 2 + (turn[0] * y) ** 2 + (turn[1] * x) ** 2
    assert uncertain.variances[CELL] - plain.variances[CELL] == pytest.approx(added)


@pytest.mark.parametrize("place", [(0.02, 0.41), (-0.28, 0.23), (0.5, 0.4), (9.0, 9.0)])
def test_cells_of_a_disc_are_forgotten_and_no_other(place):
    model = ElevationMap(GRID)
    model.heights[...], model.variances[...] = 1.0, 1e-4
    model.forget(np.array(place), 0.12)
    apart = np.hypot(*np.moveaxis(GRID.centres - place, -1, 0))
    np.testing.assert_array_equal(model.known, apart >= 0.12)
    np.testing.assert_array_equal(np.isfinite(model.variances), model.known)


def test_points_beyond_the_grid_are_left_out_and_cells_come_in_order():
    rng = np.random.default_rng(7)
    wanted = [(7, 11), (0, 0), (2, 3)]
    inside = np.vstack([points_in(np.zeros(4), rng, cell) for cell in wanted])
    beyond = inside + [0.6, 0.0, 0.0]
    points = rng.permutation(np.vstack([inside, beyond]))
    model = ElevationMap(GRID)
    assert model.insert(points, covariances(points)).tolist() == [0, 27, 95]
    assert len(model.insert(np.zeros((0, 3)), np.zeros((0, 3, 3)))) == 0


@pytest.mark.parametrize("wrong", ["point", "variance", "negative", "shape"])
def test_what_is_not_finite_leaves_the_map_as_it_was(wrong):
    model = ElevationMap(GRID)
    points = points_in(np.zeros(5), np.random.default_rng(8))
    spread = covariances(points)
    if wrong == "point":
        points[3, 1] = np.nan
    elif wrong == "variance":
        spread[3, 2, 2] = np.inf
    elif wrong == "negative":
        spread[3, 2, 2] = -1e-9
    else:
        spread = spread[:4]
    with pytest.raises(MapError, match="covariances" if wrong == "shape" else "point 3"):
        model.insert(points, spread)
    assert not model.known.any()


def test_impossible_settings_are_named():
    with pytest.raises(ValueError, match="gate = 0"):
        ElevationMapConfig(gate=0.0)
    with pytest.raises(ValueError, match="correlated_points = 0.5"):
        ElevationMapConfig(correlated_points=0.5)


def filled(function, grid=GRID):
    model = ElevationMap(grid)
    x, y = np.moveaxis(grid.centres, -1, 0)
    model.heights[...] = function(x, y)
    model.variances[...] = 1e-5
    return model


def test_a_map_in_another_frame_has_the_heights_of_the_nearest_cells():
    wide = ElevationGrid((-1.0, -1.0), (40, 40))
    model = filled(lambda x, y: 0.3 * x - 0.2 * y, wide)
    model.heights[:, 30:] = np.nan
    pose = RigidTransform.from_components([0.4, 0.3, 0.15], Rotation.from_euler("z", 2.1))
    moved = model.moved(pose, grid=GRID)
    for row in range(GRID.shape[0]):
        for column in range(GRID.shape[1]):
            x, y = GRID.centres[row, column]
            back = pose.inv().apply([x, y, 0.0])
            i, j = (int((back[k] + 1.0) // 0.05) for k in (1, 0))
            if 0 <= i < 40 and 0 <= j < 30:
                expected = 0.3 * (j * 0.05 - 0.975) - 0.2 * (i * 0.05 - 0.975) + 0.15
                assert moved.heights[row, column] == pytest.approx(expected)
                assert moved.variances[row, column] == pytest.approx(1e-5)
            else:
                assert not moved.known[row, column]
    assert 20 < moved.known.sum() < GRID.size


def test_a_moved_map_is_as_unsure_as_the_pose_makes_it():
    model, deviations = filled(lambda x, y: 0.0 * x), np.array([0.01, 0.02, 0.5, 0.1, 0.2, 0.007])
    pose = RigidTransform.from_translation([0.0, 0.0, -0.4])
    moved = model.moved(pose, np.diag(deviations**2))
    x, y = np.moveaxis(GRID.centres, -1, 0)
    expected = 1e-5 + 0.007**2 + (0.01 * y) ** 2 + (0.02 * x) ** 2
    np.testing.assert_allclose(moved.variances, expected)
    np.testing.assert_allclose(moved.heights, -0.4)


def test_a_map_is_not_moved_into_a_frame_that_is_not_level():
    tilted = RigidTransform.from_rotation(Rotation.from_euler("x", 1e-3))
    with pytest.raises(MapError, match="turn about z"):
        filled(lambda x, y: x).moved(tilted)
