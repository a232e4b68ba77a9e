"""A window says of every voxel what the map says."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.geometry.pinhole import Frustum
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.map import VoxelMap, window


@pytest.fixture(scope="module")
def voxels():
    made = VoxelMap(VoxelGrid(0.02, (-0.5, -0.5, 0.1), (0.5, 0.5, 1.3)))
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (3000, 2)), rng.uniform(0.8, 1.0, 3000)])
    view = Frustum(80, 60, 90.0, 90.0, 39.5, 29.5, near=0.1, far=2.0)
    for _ in range(3):
        spread = np.broadcast_to(1e-6 * np.eye(3), (3000, 3, 3))
        made.insert(RigidTransform.identity(), view, points, spread)
    return made


def test_window_holds_the_map_s_probabilities_also_where_it_reaches_out_of_it(voxels):
    cut = window(voxels, [-0.7, -0.31, 0.5], [0.33, 0.7, 1.5])
    points = np.random.default_rng(1).uniform([-0.7, -0.31, 0.5], [0.33, 0.7, 1.5], (5000, 3))
    cells, inside = cut.grid.cells(points)
    assert inside.all()
    found = cut.probabilities()[tuple(cells.T)]
    np.testing.assert_array_equal(found, voxels.probabilities(points))
    assert np.isnan(found).any() and (found < 0.05).any() and (found > 0.5).any()


def test_occupied_voxels_are_the_map_s(voxels):
    cut = window(voxels, voxels.grid.lower, voxels.grid.upper)
    cells, _ = voxels.occupied_cells()
    assert np.count_nonzero(cut.occupied()) == len(cells)
    assert cut.occupied()[tuple(cells.T)].all()


def test_window_that_is_no_box_is_refused(voxels):
    with pytest.raises(MapError, match="lower < upper"):
        window(voxels, [0.0, 0.0, 0.5], [0.1, -0.1, 0.6])
    with pytest.raises(MapError, match="three numbers"):
        window(voxels, [0.0, 0.0], [0.1, 0.1])
