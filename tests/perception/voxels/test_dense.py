"""Rays through voxels, against OctoMap and against a walk that samples each ray densely."""

import numpy as np
import pyoctomap
import pytest

from perception.voxels.dense import DenseVoxelMap
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.occupancy import State, UpdateModel, log_odds

GRID = VoxelGrid(0.1, (-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))


def octomap_states(clouds, resolution, max_range, grid):
    """Return OctoMap's states in a grid after the same clouds."""
    tree = pyoctomap.OcTree(resolution)
    for origin, points in clouds:
        tree.insertPointCloud(points, origin, max_range)
    states = np.zeros(grid.shape, dtype=np.int8)
    for leaf in tree.begin_leafs():
        side = round(leaf.getSize() / resolution)
        steps = (np.arange(side) - (side - 1) / 2) * resolution
        offsets = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        cells, inside = grid.cells(np.array(leaf.getCoordinate()) + offsets)
        assert inside.all()
        state = State.OCCUPIED if tree.isNodeOccupied(leaf) else State.FREE
        states[tuple(cells.T)] = state
    return states


def random_clouds(seed, count=4, points=400):
    generator = np.random.default_rng(seed)
    return [
        (generator.uniform(-0.5, 0.5, 3), generator.uniform(-1.9, 1.9, (points, 3)))
        for _ in range(count)
    ]


@pytest.mark.parametrize(("resolution", "max_range"), [(0.1, -1.0), (0.1, 1.2), (0.07, 0.9)])
def test_every_voxel_is_in_the_state_that_octomap_gives_it(resolution, max_range):
    grid = VoxelGrid(resolution, (-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
    clouds = random_clouds(seed=1)
    voxels = DenseVoxelMap(grid)
    for origin, points in clouds:
        voxels.insert(origin, points, max_range)
    np.testing.assert_array_equal(
        voxels.cell_states(), octomap_states(clouds, resolution, max_range, grid)
    )


def test_rays_along_axes_and_planes_agree_with_octomap():
    steps = np.stack(np.meshgrid(*3 * [[-1.0, 0.0, 1.0]]), axis=-1).reshape(-1, 3)
    clouds = [(np.array([0.05, 0.05, 0.05]), 0.05 + 1.3 * steps[np.any(steps != 0, axis=1)])]
    voxels = DenseVoxelMap(GRID)
    voxels.insert(*clouds[0])
    np.testing.assert_array_equal(voxels.cell_states(), octomap_states(clouds, 0.1, -1.0, GRID))


def test_a_ray_frees_the_voxels_that_dense_samples_of_it_lie_in():
    generator = np.random.default_rng(2)
    for _ in range(8):
        origin, end = generator.uniform(-1.9, 1.9, (2, 3))
        voxels = DenseVoxelMap(GRID)
        voxels.insert(origin, end[None])
        samples = origin + np.linspace(0.0, 1.0, 40_000)[:, None] * (end - origin)
        crossed = np.unique(GRID.cells(samples)[0], axis=0)
        expected = np.zeros(GRID.shape, dtype=np.int8)
        expected[tuple(crossed.T)] = State.FREE
        expected[tuple(GRID.cells(end)[0])] = State.OCCUPIED
        # A corner that is cut by less than a sample's spacing may be missed by the samples.
        assert np.count_nonzero(voxels.cell_states() != expected) <= 1


def test_a_hit_outweighs_and_counts_once_in_a_scan():
    voxels = DenseVoxelMap(GRID)
    # The second ray passes through the voxel in which the first one ends, twice.
    points = np.array([[0.55, 0.05, 0.05], [0.56, 0.06, 0.05], [1.05, 0.05, 0.05]])
    voxels.insert([0.05, 0.05, 0.05], points)
    hit, miss = voxels.model.steps
    between = GRID.cells([0.75, 0.05, 0.05])[0]
    assert voxels.log_odds[tuple(between)] == pytest.approx(miss, rel=1e-6)
    assert voxels.log_odds[tuple(GRID.cells([0.55, 0.05, 0.05])[0])] == pytest.approx(hit, rel=1e-6)


def test_log_odds_add_up_to_the_clamps():
    model = UpdateModel()
    voxels = DenseVoxelMap(GRID, model)
    near, end = tuple(GRID.cells([0.35, 0.05, 0.05])[0]), np.array([[0.95, 0.05, 0.05]])
    for count in range(1, 9):
        voxels.insert([0.05, 0.05, 0.05], end)
        hit = min(count * log_odds(0.7), log_odds(model.highest))
        miss = max(count * log_odds(0.4), log_odds(model.lowest))
        assert voxels.log_odds[tuple(GRID.cells(end[0])[0])] == pytest.approx(hit, rel=1e-5)
        assert voxels.log_odds[near] == pytest.approx(miss, rel=1e-5)


def test_what_lies_outside_of_the_box_is_left_out():
    small = VoxelGrid(0.1, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    whole, part = DenseVoxelMap(GRID), DenseVoxelMap(small)
    for origin, points in random_clouds(seed=3):
        whole.insert(origin, points)
        part.insert(origin, points)
    np.testing.assert_array_equal(part.log_odds, whole.log_odds[20:30, 20:30, 20:30])


def test_rays_without_length_and_empty_clouds_change_nothing_else():
    voxels = DenseVoxelMap(GRID)
    voxels.insert([0.05, 0.05, 0.05], np.empty((0, 3)))
    assert voxels.counts()[State.UNKNOWN] == 40**3
    voxels.insert([0.05, 0.05, 0.05], [[0.05, 0.05, 0.05]])
    assert voxels.counts() == {State.UNKNOWN: 40**3 - 1, State.FREE: 0, State.OCCUPIED: 1}


@pytest.mark.parametrize(
    ("origin", "points", "named"),
    [
        ([0.0, 0.0, 0.0], [[0.1, np.nan, 0.2]], "points: 1 of 1 not finite, the first at 0"),
        ([0.0, np.inf, 0.0], [[0.1, 0.1, 0.2]], "origin"),
        ([0.0, 0.0, 0.0], [[0.1, 0.2]], r"expected \(N, 3\)"),
        ([0.0, 0.0, 0.0], [[900.0, 900.0, 900.0]], "spans"),
    ],
)
def test_bad_scans_are_refused_and_leave_the_map_as_it_was(origin, points, named):
    voxels = DenseVoxelMap(GRID)
    voxels.insert([0.0, 0.0, 0.0], [[1.0, 1.0, 1.0]])
    before = voxels.log_odds.copy()
    with pytest.raises(MapError, match=named):
        voxels.insert(origin, points)
    np.testing.assert_array_equal(voxels.log_odds, before)


def test_a_box_is_refused_if_it_is_none_or_too_large():
    with pytest.raises(MapError, match="lower < upper"):
        VoxelGrid(0.1, (0.0, 0.0, 0.0), (1.0, 0.0, 1.0))
    with pytest.raises(MapError, match="positive resolution"):
        VoxelGrid(0.0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    with pytest.raises(MapError, match="can be dense"):
        DenseVoxelMap(VoxelGrid(0.001, (0.0, 0.0, 0.0), (2.0, 2.0, 2.0)))
