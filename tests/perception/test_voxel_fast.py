"""The sparse map: what it frees, fills and leaves alone, and how well it knows its surface."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.occupancy import State
from perception.pinhole import Frustum
from perception.stereo_geometry import StereoGeometry
from perception.view_information import planning_grid
from perception.voxel_grid import MapError, VoxelGrid
from perception.voxel_map import VoxelMap, VoxelMapConfig

HEAD = StereoGeometry(170, 164, 225.8, 290.4, 84.5, 81.5, 0.038)
FRUSTUM = Frustum(HEAD.width, HEAD.height, HEAD.fx, HEAD.fy, HEAD.cx, HEAD.cy, 0.2, 2.0)
GRID = VoxelGrid(0.01, (-0.4, -0.4, -0.2), (0.4, 0.4, 0.8))
SIGMA = np.array([0.03, 0.03, 0.05])
WALL = 0.605  # The plane z = WALL faces a camera at the origin that looks along z.


def wall_scan(rng=None, pose=None):
    """Points (N, 3) of the wall, one a pixel, with the noise of stereo, and their covariances."""
    pose = RigidTransform.identity() if pose is None else pose
    u, v = np.meshgrid(np.arange(HEAD.width), np.arange(HEAD.height))
    rays = HEAD.points(np.stack([u.ravel(), v.ravel(), np.full(u.size, 10.0)], axis=1))
    world = pose.rotation.apply(rays)
    scale = (WALL - pose.translation[2]) / world[:, 2]
    local = rays * scale[:, None]
    if rng is not None:
        noise = SIGMA * rng.standard_normal(local.shape)
        local = HEAD.points(HEAD.project(local) + noise)
    turn = pose.rotation.as_matrix()
    return pose, pose.apply(local), turn @ HEAD.covariance(local, SIGMA) @ turn.T


def scanned(count=2, rng=None, **config):
    voxels = VoxelMap(GRID, VoxelMapConfig(**config))
    for _ in range(count):
        pose, points, covariances = wall_scan(rng)
        voxels.insert(pose, FRUSTUM, points, covariances)
    return voxels


def cone(depths):
    """Points (N, 3) well within the field of view at each of some depths."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.2, 0.2, 9))
    flat = np.stack([x.ravel(), y.ravel(), np.ones(81)], axis=1)
    return np.concatenate([depth * flat for depth in depths])


def test_space_before_a_wall_is_free_the_wall_occupied_and_beyond_it_unknown():
    voxels = scanned()
    assert np.all(voxels.states(cone([0.25, 0.3, 0.5])) == State.FREE)
    assert np.all(voxels.states(cone([0.7, 0.75])) == State.UNKNOWN)
    cells, _ = voxels.occupied_cells()
    heights = voxels.grid.centres(cells)[:, 2]
    assert np.abs(heights - WALL).max() <= 0.01 and len(cells) > 1000
    aside = np.array([[0.35, 0.0, 0.1], [0.0, 0.0, -0.1]])  # Beside the view, and behind it.
    assert np.all(voxels.states(aside) == State.UNKNOWN)


def test_every_voxel_is_free_only_if_all_its_rays_reach_beyond_it():
    """Against brute force: the pixels that a free voxel projects to, and the wall behind it."""
    voxels = scanned()
    states = voxels.states(voxels.grid.centres(np.indices(voxels.grid.shape).reshape(3, -1).T))
    centres = voxels.grid.centres(np.indices(voxels.grid.shape).reshape(3, -1).T)
    pixels = HEAD.project(centres)[:, :2]
    inside = np.all((pixels > -0.5) & (pixels < [HEAD.width - 0.5, HEAD.height - 0.5]), axis=1)
    free = states == State.FREE
    assert np.all(inside[free]) and np.all(centres[free, 2] < WALL)
    deep = inside & (centres[:, 2] > FRUSTUM.near + 0.01) & (centres[:, 2] < WALL - 0.03)
    middle = np.abs(pixels - [HEAD.cx, HEAD.cy]) < [HEAD.width / 2 - 12, HEAD.height / 2 - 12]
    assert np.all(free[deep & middle.all(axis=1)])


def test_what_was_seen_through_becomes_free_again():
    voxels = scanned()
    pose, points, covariances = wall_scan()
    for _ in range(6):
        voxels.insert(pose, FRUSTUM, points + [0.0, 0.0, 0.15], covariances)
    assert np.all(voxels.states(cone([WALL])) == State.FREE)


def test_estimates_of_the_surface_are_as_certain_as_they_say():
    """Fused over views from several places; across the wall, where the truth is known."""
    rng = np.random.default_rng(3)
    squares = []
    voxels = VoxelMap(GRID)
    for _ in range(6):
        tilt = Rotation.from_rotvec(rng.uniform(-0.15, 0.15, 3))
        pose = RigidTransform.from_components(rng.uniform(-0.08, 0.08, 3), tilt)
        pose, points, covariances = wall_scan(rng, pose)
        voxels.insert(pose, FRUSTUM, points, covariances)
    surface = voxels.surface()
    squares = (surface.means[:, 2] - WALL) ** 2 / surface.covariances[:, 2, 2]
    assert len(squares) > 1000 and 0.5 < squares.mean() < 2.0


@pytest.mark.parametrize("resolution", [0.002, 0.01])
def test_more_looks_make_the_surface_more_certain(resolution):
    rng = np.random.default_rng(0)
    spread = []
    voxels = VoxelMap(VoxelGrid(resolution, (-0.1, -0.1, 0.4), (0.1, 0.1, 0.7)))
    for _ in range(4):
        pose, points, covariances = wall_scan(rng)
        voxels.insert(pose, FRUSTUM, points, covariances)
        spread.append(np.median(voxels.surface().covariances[:, 2, 2]))
    assert spread[0] > spread[1] > spread[3]


def test_arm_collides_with_what_is_occupied_or_unknown_and_not_with_what_is_free():
    voxels = scanned(4)
    free, wall, beyond = cone([0.3]), cone([WALL]), cone([0.75])
    assert not voxels.collides(free)
    assert voxels.collides(wall) and voxels.collides(beyond)
    bodies = np.stack([free, wall])
    np.testing.assert_array_equal(voxels.collides(bodies), [False, True])


def test_nothing_seen_leaves_nothing():
    voxels = VoxelMap(GRID)
    nothing = voxels.insert(
        RigidTransform.identity(), FRUSTUM, np.zeros((0, 3)), np.zeros((0, 3, 3))
    )
    assert nothing == 0 and voxels.counts()[State.UNKNOWN] == np.prod(voxels.grid.shape)
    assert len(voxels.surface().means) == 0


def test_bad_scans_are_refused_and_the_map_is_as_it_was():
    voxels = scanned()
    before = voxels.counts(), voxels.surface().means.copy()
    pose, points, covariances = wall_scan()
    lost, indefinite = points.copy(), covariances.copy()
    lost[7, 1] = np.nan
    indefinite[3] = -np.eye(3)
    for bad in ((lost, covariances), (points, indefinite), (points, covariances[:5])):
        with pytest.raises(MapError):
            voxels.insert(pose, FRUSTUM, *bad)
    assert voxels.counts() == before[0]
    np.testing.assert_array_equal(voxels.surface().means, before[1])


def test_box_too_large_for_the_memory_is_refused_by_name():
    with pytest.raises(MapError, match="memory_limit"):
        VoxelMap(VoxelGrid(0.001, (-10.0, -10.0, -10.0), (10.0, 10.0, 10.0)))


def test_planning_grid_is_the_map_by_its_bricks():
    voxels = scanned()
    grid = planning_grid(voxels)
    assert grid.resolution == pytest.approx(0.08)
    inner = np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for brick in np.ndindex(grid.states.shape):
        states = voxels.states(voxels.grid.centres(np.array(brick) * 8 + inner))
        measured = np.count_nonzero(states != State.UNKNOWN)
        expected = State.FREE if measured >= 256 else State.UNKNOWN
        if np.any(states == State.OCCUPIED):
            expected = State.OCCUPIED
        assert grid.states[brick] == expected
