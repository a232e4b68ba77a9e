"""What a view would show, against a brute force that asks for each voxel whether it is seen."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.pinhole import Frustum
from perception.voxels.bricks import NEVER, NOWHERE, SIDE
from perception.voxels.grid import VoxelGrid
from perception.voxels.map import VoxelMap
from perception.voxels.occupancy import State
from perception.voxels.views import view_counts

VIEW = Frustum(64, 48, 60.0, 60.0, 31.5, 23.5, near=0.15, far=0.7)
GRID = VoxelGrid(0.02, (-0.48, -0.48, -0.48), (0.48, 0.48, 0.48))


def known_map(states):
    """Return a map whose voxels are in given states, with one brick for each that is mixed."""
    voxels = VoxelMap(GRID)
    level = {State.UNKNOWN: NEVER, State.FREE: -20, State.OCCUPIED: 20}
    values = np.vectorize(level.get)(states).astype(np.int8)
    shape = voxels.bricks.index.shape
    bricks, rows = voxels.bricks.index.copy(), []
    for x, y, z in np.ndindex(shape):
        part = values[
            x * SIDE : (x + 1) * SIDE, y * SIDE : (y + 1) * SIDE, z * SIDE : (z + 1) * SIDE
        ].ravel()
        if np.all(part == part[0]):
            bricks[x, y, z] = -129 - int(part[0])
        else:
            bricks[x, y, z] = len(rows)
            rows.append(part)
    rows = np.array(rows, dtype=np.int8).reshape(-1, SIDE**3)
    voxels.bricks = voxels.bricks._replace(
        index=bricks, values=rows, block=np.full(len(rows), NOWHERE, dtype=np.int32)
    )
    voxels.bricks.used[0] = len(rows)
    return voxels


def scattered_states(seed):
    """Return a free middle, unknown surroundings and some occupied balls."""
    generator = np.random.default_rng(seed)
    cells = np.stack(np.indices(GRID.shape), axis=-1)
    where = GRID.centres(cells)
    states = np.where(where[..., 0] < 0.05, State.FREE, State.UNKNOWN)
    for _ in range(5):
        centre, radius = generator.uniform(-0.2, 0.4, 3), generator.uniform(0.04, 0.12)
        states[np.linalg.norm(where - centre, axis=-1) < radius] = State.OCCUPIED
    return states


def pose_looking_along_x(turn=0.2):
    forward = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turned = Rotation.from_euler("z", turn) * forward
    return RigidTransform.from_components([-0.41, 0.03, 0.02], turned)


def seen_by_brute_force(states, pose):
    """Return which voxels are in the frustum and not behind an occupied one: dense samples."""
    where = GRID.centres(np.stack(np.indices(GRID.shape), axis=-1)).reshape(-1, 3)
    local = pose.inv().apply(where)
    depth = local[:, 2]
    u = local[:, 0] / depth * VIEW.fx + VIEW.cx
    v = local[:, 1] / depth * VIEW.fy + VIEW.cy
    inside = (depth > VIEW.near) & (depth < VIEW.far)
    inside &= (np.abs(u - 31.5) < 32.0) & (np.abs(v - 23.5) < 24.0)
    seen = inside.copy()
    steps = np.linspace(0.0, 1.0, 200)[:, None]
    for part in np.array_split(np.flatnonzero(inside), 20):
        path = pose.translation + steps[..., None] * (where[part] - pose.translation)
        cells, within = GRID.cells(path)
        met = within & (states[tuple(np.moveaxis(cells, -1, 0))] == State.OCCUPIED)
        met &= np.any(cells != GRID.cells(where[part])[0], axis=-1)
        met &= steps * depth[part] > VIEW.near
        seen[part] = ~np.any(met, axis=0)
    return seen.reshape(states.shape)


@pytest.mark.parametrize("seed", [1, 2])
def test_visible_volumes_are_those_of_a_brute_force_over_voxels(seed):
    states, pose = scattered_states(seed), pose_looking_along_x()
    seen = seen_by_brute_force(states, pose)
    found = view_counts(known_map(states), pose, VIEW)
    volume = GRID.resolution**3
    for state, value in ((State.UNKNOWN, found.unmeasured), (State.FREE, found.free)):
        expected = volume * np.count_nonzero(seen & (states == state))
        assert value == pytest.approx(expected, rel=0.05)


def sampled_along_rays(states, pose, path, step=2e-4):
    """Return depths of the first occupied sample and (unmeasured, free, information) by sums."""
    z = np.arange(VIEW.near + step / 2, VIEW.far, step)
    rays = VIEW.rays(VIEW.pixel_grid())
    lookup = np.vectorize(int)(states)
    depths, sums = np.full((VIEW.height, VIEW.width), np.inf), np.zeros(3)
    for row in range(VIEW.height):
        points = pose.apply((rays[row, :, None] * z[:, None]).reshape(-1, 3))
        cells, inside = GRID.cells(points)
        found = np.where(inside, lookup[tuple(cells.T)], -1).reshape(VIEW.width, len(z))
        met = found == State.OCCUPIED
        hit = met.any(axis=1)
        depths[row, hit] = z[met[hit].argmax(axis=1)]
        found[np.cumsum(met, axis=1) > 0] = -1
        unmeasured = found == State.UNKNOWN
        length = np.linalg.norm(rays[row], axis=1)[:, None] * step
        clear = np.exp(-length / path * (np.cumsum(unmeasured, axis=1) - 0.5))
        area = z**2 * step / (VIEW.fx * VIEW.fy)
        sums += [
            np.sum(area * unmeasured),
            np.sum(area * (found == State.FREE)),
            np.sum(area * unmeasured * clear),
        ]
    return depths, sums


@pytest.mark.parametrize("turn", [0.2, 1.3, -2.5])
def test_rays_end_and_count_as_dense_samples_along_them_do(turn):
    states = scattered_states(4)
    # Single voxels too, so that what is known changes within bricks.
    generator = np.random.default_rng(5)
    scattered = generator.random(states.shape)
    states[scattered < 0.1] = State.FREE
    states[scattered > 0.95] = State.UNKNOWN
    states[(scattered > 0.45) & (scattered < 0.452)] = State.OCCUPIED
    pose = RigidTransform.from_components([-0.05, 0.03, 0.02], pose_looking_along_x(turn).rotation)
    depths, (unmeasured, free, seen) = sampled_along_rays(states, pose, 0.4)
    found = view_counts(known_map(states), pose, VIEW, mean_free_path=0.4)
    # A corner that a ray cuts by less than a sample may be missed by the samples.
    near = np.isclose(found.depths, depths, rtol=0.0, atol=2e-4)
    assert np.mean(near | (np.isinf(found.depths) & np.isinf(depths))) > 0.98
    assert np.all((found.depths < depths + 2e-4) | np.isinf(depths))
    assert found.unmeasured == pytest.approx(unmeasured, rel=0.01)
    assert found.free == pytest.approx(free, rel=0.01)
    assert found.information * GRID.resolution**3 == pytest.approx(seen, rel=0.01)


def test_an_empty_view_shows_the_frustum_s_volume():
    pose = RigidTransform.from_components([0.0, 0.0, -0.45], Rotation.identity())
    found = view_counts(VoxelMap(GRID), pose, VIEW)
    # Where the frustum is inside of the box: its half-width stays below 0.48 m up to 0.7 m.
    expected = VIEW.width * VIEW.height / (3 * VIEW.fx * VIEW.fy) * (0.7**3 - 0.15**3)
    assert found.unmeasured == pytest.approx(expected, rel=1e-6)
    assert found.free == 0.0 and found.blocked == 0.0


def test_information_falls_with_the_free_path_whatever_the_voxels():
    pose = RigidTransform.from_components([0.0, 0.0, -0.45], Rotation.identity())
    rays = VIEW.rays(VIEW.pixel_grid())
    length = np.linalg.norm(rays, axis=-1)
    z = np.linspace(VIEW.near, VIEW.far, 2001)
    for side, path in ((0.02, 0.3), (0.01, 0.3), (0.02, 1.5)):
        grid = VoxelGrid(side, GRID.lower, GRID.upper)
        found = view_counts(VoxelMap(grid), pose, VIEW, mean_free_path=path)
        weight = np.exp(-(z[:, None, None] - VIEW.near) * length / path)
        inner = np.trapezoid(z[:, None, None] ** 2 * weight, z, axis=0)
        expected = inner.sum() / (VIEW.fx * VIEW.fy) / side**3
        assert found.information == pytest.approx(expected, rel=1e-3)


def test_known_space_has_no_information_and_a_wall_occludes_the_space_behind():
    states = np.full(GRID.shape, State.FREE)
    pose = pose_looking_along_x(0.0)
    found = view_counts(known_map(states), pose, VIEW)
    assert found.information == 0.0 and found.unmeasured == 0.0
    states[24:] = State.UNKNOWN
    open_view = view_counts(known_map(states), pose, VIEW)
    states[23] = State.OCCUPIED
    closed = view_counts(known_map(states), pose, VIEW)
    assert open_view.unmeasured > 0.02
    assert closed.unmeasured == 0.0
    # The wall's near face is at x = -0.02, 0.39 m ahead.
    np.testing.assert_allclose(closed.depths, 0.39, atol=1e-6)
    assert closed.blocked == 1.0


def test_a_camera_outside_that_looks_away_sees_nothing():
    away = RigidTransform.from_components([0.0, 0.0, 2.0], Rotation.identity())
    found = view_counts(VoxelMap(GRID), away, VIEW)
    assert (found.unmeasured, found.free, found.information) == (0.0, 0.0, 0.0)


def test_a_free_path_must_have_a_length():
    with pytest.raises(ValueError, match="mean_free_path"):
        view_counts(VoxelMap(GRID), RigidTransform.identity(), VIEW, mean_free_path=0.0)


def test_a_view_that_is_none_is_refused():
    with pytest.raises(ValueError, match="near < far"):
        Frustum(64, 48, 60.0, 60.0, 31.5, 23.5, near=1.0, far=0.5)
