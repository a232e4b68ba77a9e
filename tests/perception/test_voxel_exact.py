"""The exact map: the cells of OctoMap, and of a slow walk along each ray."""

import math

import numpy as np
import pyoctomap
import pytest

from perception.occupancy import State, UpdateModel, log_odds
from perception.voxel_dense import DenseVoxelMap
from perception.voxel_grid import MapError, VoxelGrid

GRID = VoxelGrid(0.02, (-0.6, -0.6, -0.6), (0.6, 0.6, 0.6))


def scans(seed: int, count: int = 3, points: int = 400):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        origin = rng.uniform(-0.2, 0.2, 3)
        yield origin, rng.uniform(-0.5, 0.5, (points, 3))


def octomap_counts(tree: pyoctomap.OcTree) -> dict[State, int]:
    tree.updateInnerOccupancy()
    found = {State.FREE: 0, State.OCCUPIED: 0}
    for leaf in tree.begin_leafs():
        cells = round(leaf.getSize() / tree.getResolution()) ** 3
        found[State.OCCUPIED if tree.isNodeOccupied(leaf) else State.FREE] += cells
    return found


@pytest.mark.parametrize("max_range", [-1.0, 0.3])
@pytest.mark.parametrize("seed", [0, 1])
def test_as_many_cells_are_occupied_and_free_as_in_octomap(seed, max_range):
    tree, voxels = pyoctomap.OcTree(GRID.resolution), DenseVoxelMap(GRID)
    for origin, points in scans(seed):
        tree.insertPointCloud(points, origin, max_range, True)
        voxels.insert(origin, points, max_range)
    counts = voxels.counts()
    assert {state: counts[state] for state in (State.FREE, State.OCCUPIED)} == octomap_counts(tree)


def walked(origin: np.ndarray, point: np.ndarray, grid: VoxelGrid) -> set[tuple[int, ...]]:
    """Cells met for more than a three-hundredth of a cell, the last one left out."""
    length = float(np.linalg.norm(point - origin))
    steps = np.linspace(0.0, 1.0, math.ceil(300 * length / grid.resolution))
    cells, _ = grid.cells(origin + steps[:, None] * (point - origin))
    return set(map(tuple, cells)) - {tuple(grid.cells(point[None])[0][0])}


def test_free_cells_are_those_that_a_slow_walk_meets():
    rng = np.random.default_rng(5)
    different = total = 0
    for _ in range(15):
        voxels = DenseVoxelMap(GRID)
        origin, point = rng.uniform(-0.5, 0.5, (2, 3))
        voxels.insert(origin, point[None])
        free = set(map(tuple, np.argwhere(voxels.cell_states() == State.FREE)))
        expected = walked(origin, point, GRID)
        different += len(free ^ expected)
        total += len(expected)
    # 32-bit rays and grazed corners.
    assert different <= 0.02 * total


def test_log_odds_add_up_to_their_clamps():
    model = UpdateModel()
    hit, miss = model.steps
    voxels = DenseVoxelMap(GRID, model)
    origin, point = np.array([-0.31, 0.01, 0.01]), np.array([[0.31, 0.01, 0.01]])
    for count in range(1, 12):
        voxels.insert(origin, point)
        expected = min(count * hit, model.clamps[1]), max(count * miss, model.clamps[0])
        cells = [tuple(GRID.cells(p[None])[0][0]) for p in (point[0], (origin + point[0]) / 2)]
        found = [voxels.log_odds[cell] for cell in cells]
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    assert voxels.probabilities(point)[0] == pytest.approx(model.highest, abs=1e-5)
    assert log_odds(model.lowest) == pytest.approx(found[1], abs=1e-5)


def test_cell_that_is_hit_and_passed_in_one_scan_is_hit():
    voxels = DenseVoxelMap(GRID)
    origin = np.array([-0.31, 0.01, 0.01])
    voxels.insert(origin, np.array([[0.11, 0.01, 0.01], [0.31, 0.01, 0.01]]))
    assert voxels.states(np.array([[0.11, 0.01, 0.01]]))[0] == State.OCCUPIED


def test_what_was_never_measured_is_unknown_and_no_number():
    voxels = DenseVoxelMap(GRID)
    voxels.insert([0.0, 0.0, 0.0], np.zeros((0, 3)))
    assert voxels.counts()[State.UNKNOWN] == math.prod(GRID.shape)
    assert np.isnan(voxels.probabilities(np.zeros((1, 3)))).all()
    assert voxels.states(np.full((1, 3), 9.0))[0] == State.UNKNOWN


@pytest.mark.parametrize(
    "origin, points",
    [
        ([0.0, 0.0, np.nan], [[0.1, 0.1, 0.1]]),
        ([0.0, 0.0, 0.0], [[0.1, np.inf, 0.1]]),
        ([0.0, 0.0, 0.0], [[0.1, 0.1]]),
        ([0.0, 0.0, 0.0], [[1e5, 1e5, 1e5]]),
    ],
)
def test_bad_scan_is_refused_and_the_map_is_as_it_was(origin, points):
    voxels = DenseVoxelMap(GRID)
    voxels.insert([0.0, 0.0, 0.0], [[0.2, 0.1, 0.0]])
    before = voxels.log_odds.copy()
    with pytest.raises(MapError):
        voxels.insert(origin, np.array(points))
    np.testing.assert_array_equal(voxels.log_odds, before)


def test_ray_of_no_length_marks_its_own_cell_only():
    voxels = DenseVoxelMap(GRID)
    voxels.insert([0.1, 0.1, 0.1], [[0.1, 0.1, 0.1]])
    counts = voxels.counts()
    assert counts[State.FREE] == 0 and counts[State.OCCUPIED] <= 1


@pytest.mark.parametrize("resolution, upper", [(0.0, 1.0), (np.nan, 1.0), (0.1, -1.0), (1e-6, 1.0)])
def test_what_is_no_grid_is_refused(resolution, upper):
    with pytest.raises(MapError):
        DenseVoxelMap(VoxelGrid(resolution, (0.0, 0.0, 0.0), (1.0, 1.0, upper)))
