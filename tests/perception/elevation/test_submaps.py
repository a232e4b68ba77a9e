"""Elevation maps one after the other: what each one knows, and no cliffs between them."""

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap
from perception.elevation.submaps import Submaps, filled, rises_by_map

GRID = ElevationGrid((-1.5, -1.5), (60, 60))
X, Y = np.moveaxis(GRID.centres, -1, 0)


def put(elevation, cells, height, variance=1e-5):
    """Put level ground into cells, a block of 0.08 m on it at x = 0.5, y = 0."""
    block = (np.abs(X - 0.5) < 0.1) & (np.abs(Y) < 0.1)
    elevation.heights[cells] = height + 0.08 * block[cells]
    elevation.variances[cells] = variance


def drifted():
    """Return maps that both know the middle, the newer one lower by 0.15 m."""
    maps = Submaps(GRID)
    put(maps.newest, X < 0.8, 0.0)
    maps.begin()
    put(maps.newest, X > -0.2, -0.15, 4e-5)
    return maps


def test_the_newest_map_that_knows_a_cell_tells_it():
    maps = drifted()
    maps.newest.heights[Y > 1.4] = np.nan
    expected = np.where(X > -0.2, -0.15, 0.0)
    expected[(Y > 1.4) & (X < 0.8)] = 0.0
    expected[(Y > 1.4) & (X > 0.8)] = np.nan
    expected[(np.abs(X - 0.5) < 0.1) & (np.abs(Y) < 0.1)] += 0.08
    np.testing.assert_allclose(maps.heights, expected, atol=1e-12)
    np.testing.assert_array_equal(maps.known, np.isfinite(expected))
    below = (X > -0.2) & (Y < 1.4)
    np.testing.assert_array_equal(maps.variances[below], 4e-5)
    np.testing.assert_array_equal(maps.variances[X < -0.2], 1e-5)


def test_between_maps_of_other_heights_stands_nothing_and_blocks_stand_in_each():
    maps = drifted()
    joined = ElevationMap(GRID)
    joined.heights[...] = maps.heights
    assert (rises(joined)[Y < -0.5] > 0.04).sum() > 50  # A cliff.
    above = rises_by_map(maps.maps)
    block = (np.abs(X - 0.5) < 0.1) & (np.abs(Y) < 0.1)
    np.testing.assert_array_equal(above > 0.04, block)
    assert np.isfinite(above[maps.known]).all()


def test_all_maps_move_to_another_frame():
    maps = drifted()
    turn = RigidTransform.from_components([0.1, -0.05, 0.3], Rotation.from_euler("z", np.pi / 2))
    moved = maps.moved(turn, np.zeros((6, 6)))
    for one, other in zip(maps.maps, moved.maps, strict=True):
        np.testing.assert_array_equal(one.moved(turn).heights, other.heights)
    inner = np.hypot(X, Y) < 1.0
    places = np.column_stack([GRID.centres[inner], maps.heights[inner]])
    cells = GRID.cells_of(turn.apply(places)[:, :2])
    np.testing.assert_allclose(moved.heights[tuple(cells.T)], maps.heights[inner] + 0.3, atol=1e-9)


def test_holes_of_four_cells_count_as_seen_and_larger_ones_do_not():
    for width, seen in ((4, True), (6, False)):
        cells = np.ones((20, 20), bool)
        cells[8 : 8 + width, 8 : 8 + width] = False
        assert filled(cells)[8 + width // 2, 8 + width // 2] == seen
        assert filled(cells, grown=1)[8 + width // 2, 8 + width // 2] == seen
    alone = np.zeros((9, 9), bool)
    alone[4, 4] = True
    assert [filled(alone, grown).sum() for grown in (0, 1, 2)] == [1, 9, 25]


def test_holes_of_the_newest_map_show_nothing_of_those_before():
    maps = drifted()
    maps.maps[1].heights[X < 0.3] += 0.2  # A cliff, in the midst of what the newest one shows.
    holes = np.random.default_rng(0).uniform(size=GRID.shape) < 0.2
    maps.newest.heights[holes] = np.nan
    shown = (X > 0.0) & (X < 0.35)
    assert (rises(maps.maps[1])[shown] > 0.04).sum() > 50
    assert not (rises_by_map(maps.maps)[shown] > 0.04).any()
