"""When two scans of a wall are of one surface, and what becomes of those that are not."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from tests.perception.voxels.wall_views import FRUSTUM

GRID = VoxelGrid(0.01, (-0.1, -0.1, 0.5), (0.1, 0.1, 0.7))
SIGMA = 5e-4  # Of each point, in all directions [m].


def walls(*depths):
    """Scans of walls that face the camera: depths, variances and number in each column."""
    voxels = VoxelMap(GRID, VoxelMapConfig(correlated_points=1e6))
    rays = FRUSTUM.rays(FRUSTUM.pixel_grid()).reshape(-1, 3)
    for depth in depths:
        points = depth * rays[np.abs(depth * rays[:, :2]).max(axis=1) < 0.08]
        covariances = np.tile(SIGMA**2 * np.eye(3), (len(points), 1, 1))
        voxels.insert(RigidTransform.identity(), FRUSTUM, points, covariances)
    surface = voxels.surface()
    columns = np.floor(surface.means[:, :2] / GRID.resolution)
    _, counts = np.unique(columns, axis=0, return_counts=True)
    return surface.means[:, 2], surface.covariances[:, 2, 2], counts


def test_walls_within_three_deviations_are_one_surface_known_better():
    means, variances, counts = walls(0.604, 0.6055)
    assert counts.max() == 1
    assert np.median(means) == pytest.approx(0.60475, abs=1e-4)
    # The map adds a fiftieth of a voxel to each deviation, squared.
    floor = (0.02 * GRID.resolution) ** 2
    assert np.median(variances) - floor == pytest.approx(SIGMA**2 / 2, rel=0.05)
    assert np.median(walls(0.604)[1]) - floor == pytest.approx(SIGMA**2, rel=0.05)


@pytest.mark.parametrize("gap", [0.003, 0.004])
def test_disagreeing_walls_of_one_voxel_widen_its_variance(gap):
    means, variances, counts = walls(0.604, 0.604 + gap)
    assert counts.max() == 1
    assert np.median(means) == pytest.approx(0.604 + gap / 2, abs=2e-4)
    assert np.median(variances) == pytest.approx(SIGMA**2 + gap**2 / 4, rel=0.1)


def test_a_wall_seen_on_both_sides_of_a_voxels_face_is_no_double():
    means, _, counts = walls(0.6095, 0.6103)
    # Where rays are slanted, a few patches lie beside each other.
    assert np.mean(counts == 1) > 0.6
    assert np.median(means) == pytest.approx(0.6099, abs=1e-4)


def test_walls_a_voxel_apart_stay_two():
    means, _, counts = walls(0.6045, 0.6145)
    assert np.mean(counts == 2) > 0.8 and counts.max() == 2
    np.testing.assert_allclose(np.minimum(abs(means - 0.6045), abs(means - 0.6145)), 0, atol=1e-4)
