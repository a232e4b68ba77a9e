"""The planar map: what one scan changes, and what may be entered."""

import numpy as np
import pytest

from perception.planar.map import Grid, PlanarMap
from perception.voxels.occupancy import State

GRID = Grid(3, 4, 0.5)


def cells(*chosen):
    marked = np.zeros(GRID.shape, dtype=bool)
    for cell in chosen:
        marked[cell] = True
    return marked


def test_one_clear_view_lets_a_robot_enter_and_one_return_bars_it():
    model = PlanarMap(GRID)
    model.insert(cells((0, 0), (0, 1)), cells((0, 1), (0, 2)))
    assert model.states()[0].tolist() == [
        State.FREE,
        State.OCCUPIED,
        State.OCCUPIED,
        State.UNKNOWN,
    ]
    np.testing.assert_array_equal(model.enterable(), cells((0, 0)))
    assert model.probability()[0, 0] == pytest.approx(0.04)
    assert model.probability()[2, 2] == 0.5


def test_a_contradicted_cell_is_measured_but_not_enterable():
    model = PlanarMap(GRID)
    model.insert(cells((1, 1)), cells())
    model.insert(cells(), cells((1, 1)))
    assert model.measured[1, 1]
    assert not model.enterable().any()


def test_probabilities_are_clamped():
    model = PlanarMap(GRID)
    for _ in range(50):
        model.insert(cells((0, 0)), cells((2, 3)))
    assert model.probability()[0, 0] == pytest.approx(0.01)
    assert model.probability()[2, 3] == pytest.approx(0.99)


def test_points_and_cells_are_inverse():
    everywhere = np.argwhere(np.ones(GRID.shape))
    np.testing.assert_array_equal(GRID.cell_at(GRID.centre(everywhere)), everywhere)
    np.testing.assert_allclose(GRID.centre((0, 3)), (1.75, 0.25))


@pytest.mark.parametrize("point", [(-0.1, 0.0), (2.1, 0.0), (np.nan, 0.0), (0.0, np.inf)])
def test_points_outside_or_not_finite_are_refused(point):
    with pytest.raises(ValueError, match="points"):
        GRID.cell_at(point)


def test_impossible_grids_and_scans_are_refused():
    with pytest.raises(ValueError, match="rows"):
        Grid(1, 4, 0.5)
    with pytest.raises(ValueError, match="cell"):
        Grid(4, 4, 0.0)
    with pytest.raises(ValueError, match="hit"):
        PlanarMap(GRID).insert(cells(), np.zeros((4, 3), dtype=bool))
