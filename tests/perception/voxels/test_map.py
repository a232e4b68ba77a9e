"""The sparse map: against a brute force over all voxels, and against a known surface."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.pinhole import Frustum
from perception.stereo.geometry import StereoGeometry
from perception.voxels.bricks import BLOCKS, BRICKS, FREE_RECORDS, RECORDS
from perception.voxels.fusion import merge_gaussians
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.map import MapFull, VoxelMap, VoxelMapConfig
from perception.voxels.occupancy import State, UpdateModel
from tests.perception.voxels import wall_views

VIEW = Frustum(80, 60, 80.0, 80.0, 39.5, 29.5, near=0.1, far=1.5)
HEAD = StereoGeometry(80, 60, 80.0, 80.0, 39.5, 29.5, 0.038)
GRID = VoxelGrid(0.02, (-0.6, -0.6, -0.2), (0.6, 0.6, 0.8))
WALL = 0.4037
"""Depth of the wall ahead [m]; inside a voxel."""


def look_down(height, x=0.0, y=0.0, tilt=0.0):
    """Return a camera above the ground that looks down, tilted about x."""
    turn = Rotation.from_euler("xz", [np.pi + tilt, 0.0])
    return RigidTransform.from_components([x, y, height], turn)


def ground_cloud(pose, generator=None, sigma=0.02, level=0.0037):
    """Return points and covariances of level ground, with disparity noise if there is one."""
    rays = VIEW.rays(VIEW.pixel_grid()).reshape(-1, 3)
    turned = pose.rotation.apply(rays)
    with np.errstate(divide="ignore"):
        depth = (level - pose.translation[2]) / turned[:, 2]
    true = rays[(depth > VIEW.near) & (depth < VIEW.far)]
    true = true * depth[(depth > VIEW.near) & (depth < VIEW.far), None]
    sigmas = np.array([0.05, 0.05, sigma])
    image = HEAD.project(true)
    if generator is not None:
        image = image + sigmas * generator.standard_normal(image.shape)
    points = HEAD.points(image)
    turn = pose.rotation.as_matrix()
    covariances = turn @ HEAD.covariance(points, sigmas) @ turn.T
    return pose.apply(points), covariances


def insert_ground(voxels, pose, generator=None, **options):
    points, covariances = ground_cloud(pose, generator, **options)
    return voxels.insert(pose, VIEW, points, covariances)


def centres(grid):
    cells = np.stack(np.indices(grid.shape), axis=-1).reshape(-1, 3)
    return grid.centres(cells)


def test_free_space_is_what_brute_force_finds_before_the_depth_image():
    voxels = VoxelMap(GRID)
    pose = look_down(0.7, 0.05, -0.03, 0.3)
    insert_ground(voxels, pose)
    where = centres(voxels.grid)
    local = pose.inv().apply(where)
    u = np.rint(local[:, 0] / local[:, 2] * VIEW.fx + VIEW.cx)
    v = np.rint(local[:, 1] / local[:, 2] * VIEW.fy + VIEW.cy)
    inside = (local[:, 2] > VIEW.near) & (u >= 0) & (v >= 0) & (u < VIEW.width) & (v < VIEW.height)
    # Ground is seen in all pixels; well above it is free, in view or not.
    states = voxels.states(where)
    height = where[:, 2] - 0.0037
    clear = height > 0.035
    np.testing.assert_array_equal(states[clear] == State.FREE, inside[clear])
    assert np.all(states[~clear & ~inside & (height > 0.02)] == State.UNKNOWN)
    assert np.all(states[height < -0.02] == State.UNKNOWN)
    crossed = inside & (np.abs(height) < 0.01)
    assert np.mean(states[crossed] == State.OCCUPIED) > 0.98
    assert not np.any(states[np.abs(height) > 0.02] == State.OCCUPIED)


def test_two_views_make_space_free_for_collisions_and_unknown_space_never_is():
    voxels = VoxelMap(GRID)
    high, under, beside = [0.0, 0.0, 0.3], [0.0, 0.0, -0.1], [0.55, 0.55, 0.5]
    insert_ground(voxels, look_down(0.7))
    assert voxels.collides([high])
    insert_ground(voxels, look_down(0.7))
    assert not voxels.collides([high])
    assert voxels.collides([high, [0.0, 0.0, 0.0]])
    assert voxels.collides([under]) and voxels.collides([beside]) and voxels.collides([[9, 9, 9]])
    several = np.array([[high, high], [high, under]])
    np.testing.assert_array_equal(voxels.collides(several), [False, True])


def test_log_odds_follow_the_model_within_its_8_bits():
    model = UpdateModel()
    voxels = VoxelMap(GRID, VoxelMapConfig(model))
    for count in range(1, 7):
        insert_ground(voxels, look_down(0.7))
        odds = (0.4 / 0.6) ** count
        free = max(odds / (1 + odds), model.lowest)
        assert voxels.probabilities([[0.0, 0.0, 0.3]])[0] == pytest.approx(free, abs=0.01)
        odds = (0.7 / 0.3) ** count
        occupied = min(odds / (1 + odds), model.highest)
        found = voxels.surface().probabilities
        assert np.median(found) == pytest.approx(occupied, abs=0.01)


def test_merging_gaussians_is_their_product():
    generator = np.random.default_rng(1)
    rows, columns = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]
    for _ in range(20):
        (m1, m2), roots = generator.standard_normal((2, 3)), generator.standard_normal((2, 3, 3))
        c1, c2 = (root @ root.T + 0.1 * np.eye(3) for root in roots)
        expected = np.linalg.inv(np.linalg.inv(c1) + np.linalg.inv(c2))
        centre = expected @ (np.linalg.solve(c1, m1) + np.linalg.solve(c2, m2))
        mean, packed = m1.copy(), c1[rows, columns]
        merge_gaussians(mean, packed, m2, c2[rows, columns])
        np.testing.assert_allclose(mean, centre, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(packed, expected[rows, columns], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("resolution", [0.02, 0.004])
def test_fused_estimates_are_consistent_with_their_covariances(resolution):
    """Noise is 0.1 to 1 voxel of 2 cm, and up to 6 of 4 mm."""
    generator = np.random.default_rng(2)
    grid = VoxelGrid(resolution, (-0.32, -0.32, -0.064), (0.32, 0.32, 0.064))
    voxels = VoxelMap(grid)
    for _ in range(12):
        x, y, tilt = generator.uniform(-0.15, 0.15, 3)
        pose = look_down(generator.uniform(0.45, 0.8), x, y, 2 * tilt)
        insert_ground(voxels, pose, generator)
    surface = voxels.surface()
    error = (surface.means[:, 2] - 0.0037) ** 2 / surface.covariances[:, 2, 2]
    assert 0.35 < error.mean() < 2.0
    assert len(error) > 300


def test_disagreeing_surfaces_of_a_voxel_make_one_estimate_with_a_wider_variance():
    """Six millimetres apart in a voxel of twenty, each known to within one: no surface moved."""
    voxels = VoxelMap(GRID)
    levels = (0.0037, 0.0097)
    for level in levels:
        insert_ground(voxels, look_down(0.7), level=level, sigma=0.005)
    surface = voxels.surface()
    near = np.linalg.norm(surface.means[:, :2], axis=1) < 0.1
    # Most: groups whose plane is not sure are compared as loosely as a voxel is wide.
    assert np.median(surface.means[near, 2]) == pytest.approx(np.mean(levels), abs=1e-4)
    half = (levels[1] - levels[0]) / 2.0
    assert np.median(surface.covariances[near, 2, 2]) == pytest.approx(half**2, rel=0.1)


def test_surfaces_that_agree_become_one_and_no_place_has_two():
    """Noise of several voxels: estimates along the ray are merged, not left beside each other."""
    generator = np.random.default_rng(3)
    voxels = VoxelMap(VoxelGrid(0.004, (-0.2, -0.2, -0.064), (0.2, 0.2, 0.064)))
    for _ in range(6):
        insert_ground(voxels, look_down(0.6), generator)
    means = voxels.surface().means
    near = means[np.linalg.norm(means[:, :2], axis=1) < 0.1]
    columns = {tuple(cell) for cell in np.floor(near[:, :2] / 0.004).astype(int)}
    assert len(near) > 100 and len(columns) > 0.8 * len(near)


def test_points_that_share_an_error_count_as_one():
    sure, unsure = VoxelMap(GRID), VoxelMap(GRID, VoxelMapConfig(correlated_points=1e6))
    for voxels in (sure, unsure):
        insert_ground(voxels, look_down(0.7))
    points, covariances = ground_cloud(look_down(0.7))
    below = np.linalg.norm(points[:, :2], axis=1) < 0.1
    single = np.median(covariances[below, 2, 2])
    middle = [np.linalg.norm(v.surface().means[:, :2], axis=1) < 0.1 for v in (sure, unsure)]
    found = [
        np.median(v.surface().covariances[near, 2, 2]) for v, near in zip((sure, unsure), middle)
    ]
    assert found[1] == pytest.approx(single, rel=0.1)
    assert found[0] < 0.6 * single


def test_a_surface_that_is_removed_is_cleared():
    voxels = VoxelMap(GRID)
    insert_ground(voxels, look_down(0.75), level=0.2037)
    assert voxels.counts()[State.OCCUPIED] > 100
    for _ in range(6):
        insert_ground(voxels, look_down(0.75))
    assert np.all(np.abs(voxels.surface().means[:, 2]) < 0.02)
    used = voxels.bricks.used
    assert used[RECORDS] - used[FREE_RECORDS] >= len(voxels.surface().means)


def test_a_pixel_without_a_point_gives_no_information():
    voxels = VoxelMap(GRID)
    pose = look_down(0.7)
    points, covariances = ground_cloud(pose)
    kept = points[:, 0] > 0.0
    voxels.insert(pose, VIEW, points[kept], covariances[kept])
    assert voxels.states([[0.1, 0.0, 0.2]])[0] == State.FREE
    assert voxels.states([[-0.1, 0.0, 0.2]])[0] == State.UNKNOWN


def test_a_camera_may_be_outside_of_the_box():
    low = VoxelMap(VoxelGrid(0.02, (-0.3, -0.3, -0.1), (0.3, 0.3, 0.2)))
    high = VoxelMap(GRID)
    for voxels in (low, high):
        insert_ground(voxels, look_down(0.7))
    # Voxels near the ground only: the grids' bricks begin at other heights.
    where = centres(VoxelGrid(0.02, (-0.28, -0.28, -0.08), (0.28, 0.28, 0.18)))
    np.testing.assert_array_equal(low.states(where), high.states(where))


def test_nothing_seen_changes_nothing():
    voxels = VoxelMap(GRID)
    assert voxels.insert(look_down(0.7), VIEW, np.empty((0, 3)), np.empty((0, 3, 3))) == 0
    behind, covariance = np.array([[0.0, 0.0, 1.5]]), 1e-6 * np.eye(3)[None]
    assert voxels.insert(look_down(0.7), VIEW, behind, covariance) == 0
    assert voxels.counts()[State.UNKNOWN] == np.prod(voxels.grid.shape)
    assert len(voxels.surface().means) == 0


def bad_inputs():
    points, covariances = ground_cloud(look_down(0.7))
    nan, infinite, negative = points.copy(), points.copy(), covariances.copy()
    nan[7, 1], infinite[9, 2], negative[5] = np.nan, np.inf, -np.eye(3)
    hollow = covariances.copy()
    hollow[3, 0, 0] = np.nan
    return {
        "point 7": (nan, covariances),
        "point 9": (infinite, covariances),
        "point 5": (points, negative),
        "point 3": (points, hollow),
        r"points: expected \(N, 3\)": (points[:, :2], covariances),
        "covariances: expected": (points, covariances[:-1]),
    }


@pytest.mark.parametrize("named", bad_inputs())
def test_bad_points_are_named_and_leave_the_map_as_it_was(named):
    voxels = VoxelMap(GRID)
    insert_ground(voxels, look_down(0.7))
    before = voxels.states(centres(voxels.grid))
    with pytest.raises(MapError, match=named):
        voxels.insert(look_down(0.7), VIEW, *bad_inputs()[named])
    np.testing.assert_array_equal(voxels.states(centres(voxels.grid)), before)
    assert voxels.scans == 1


def test_a_box_too_large_for_the_memory_is_refused():
    with pytest.raises(MapError, match="memory_limit"):
        VoxelMap(VoxelGrid(0.001, (-8.0, -8.0, -8.0), (8.0, 8.0, 8.0)))


def test_a_full_map_is_an_error_and_stays_valid():
    fine = VoxelGrid(0.004, (-0.4, -0.4, -0.1), (0.4, 0.4, 0.7))
    voxels = VoxelMap(fine, VoxelMapConfig(memory_limit=3_000_000))
    with pytest.raises(MapFull, match="3 MB"):
        for tilt in (0.0, 0.3, -0.3):
            insert_ground(voxels, look_down(0.7, tilt=tilt))
    assert voxels.memory <= 3_000_000
    assert np.all(np.abs(voxels.surface().means[:, 2]) < 0.02)
    assert sum(voxels.counts().values()) == np.prod(voxels.grid.shape)


def test_free_bricks_are_one_number():
    voxels = VoxelMap(VoxelGrid(0.01, (-0.4, -0.4, -0.1), (0.4, 0.4, 0.7)))
    for _ in range(8):
        insert_ground(voxels, look_down(0.7))
    inside = np.prod(voxels.bricks.index.shape)
    assert voxels.bricks.used[BRICKS] < 0.5 * inside
    assert voxels.bricks.used[BLOCKS] < voxels.bricks.used[BRICKS]


def test_a_coarse_map_has_the_same_surface_and_nearly_the_same_free_space():
    fine = VoxelGrid(0.004, (-0.2, -0.2, -0.064), (0.2, 0.2, 0.256))
    maps = [VoxelMap(fine, VoxelMapConfig(coarse=coarse)) for coarse in (False, True)]
    for voxels, tilt in itertools.product(maps, (0.0, 0.2)):
        insert_ground(voxels, look_down(0.7, tilt=tilt))
    exact, coarse = (voxels.states(centres(voxels.grid)) for voxels in maps)
    np.testing.assert_array_equal(exact == State.OCCUPIED, coarse == State.OCCUPIED)
    assert np.mean((coarse == State.FREE) & (exact == State.UNKNOWN)) < 0.02
    assert np.mean(coarse == State.FREE) > 0.9 * np.mean(exact == State.FREE)


def test_configurations_that_make_no_sense_are_refused():
    with pytest.raises(MapError, match="correlated_points"):
        VoxelMapConfig(correlated_points=0.5)
    with pytest.raises(MapError, match="margins"):
        VoxelMapConfig(margin_voxels=-1.0)


def test_a_smaller_box_holds_the_same_cells_up_to_its_faces():
    small = VoxelMap(VoxelGrid(0.01, (0.0, 0.0, 0.6), (0.16, 0.16, 0.68)))
    large = VoxelMap(wall_views.GRID)
    for _ in range(2):
        pose, points, covariances = wall_views.wall_scan()
        for voxels in (small, large):
            voxels.insert(pose, wall_views.FRUSTUM, points, covariances)
    layers = [small.grid.centres(small.occupied_cells()[0])]
    layers.append(large.grid.centres(large.occupied_cells()[0]))
    inside = np.all((layers[1] > small.grid.lower) & (layers[1] < small.grid.upper), axis=1)
    found, expected = (set(map(tuple, np.round(c, 6))) for c in (layers[0], layers[1][inside]))
    assert len(expected) == 256 and found == expected
