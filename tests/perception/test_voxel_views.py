"""What a view would show, against every ray walked in small steps."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from perception.occupancy import State
from perception.voxel_grid import VoxelGrid
from perception.voxel_map import VoxelMap
from perception.voxel_views import view_counts
from tests.perception.test_voxel_fast import FRUSTUM, GRID, WALL, scanned

RAYS = (12, 10)


def walked(voxels, pose, mean_free_path=np.inf):
    """Volumes of unmeasured and free space in view, and depths, by steps of a tenth of a voxel."""
    lens = FRUSTUM.resized(*RAYS)
    u, v = np.meshgrid((np.arange(RAYS[0]) - lens.cx) / lens.fx,
                       (np.arange(RAYS[1]) - lens.cy) / lens.fy)  # fmt: skip
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1)
    step = voxels.grid.resolution / 10
    depths = np.arange(lens.near + step / 2, lens.far, step)
    size = depths**2 * step / (lens.fx * lens.fy)
    volumes, ends = np.zeros(2), []
    for ray in rays:
        states = voxels.states(pose.apply(depths[:, None] * ray))
        inside = voxels.grid.cells(pose.apply(depths[:, None] * ray))[1]
        stops = np.flatnonzero(states == State.OCCUPIED)
        last = stops[0] if len(stops) else len(depths)
        seen = np.arange(len(depths)) < last
        for k, state in enumerate((State.UNKNOWN, State.FREE)):
            volumes[k] += size[seen & inside & (states == state)].sum()
        ends.append(depths[last] if len(stops) else np.inf)
    return volumes, np.array(ends).reshape(RAYS[1], RAYS[0])


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.15, -0.1, 0.05), (-0.3, 0.2, -0.15)])
def test_volumes_and_depths_are_those_of_a_slow_walk(place):
    voxels = scanned()
    turn = Rotation.from_rotvec([0.3 * place[1], -0.5 * place[0], 0.2])
    pose = RigidTransform.from_components(place, turn)
    found = view_counts(voxels, pose, FRUSTUM, rays=RAYS)
    (unknown, free), depths = walked(voxels, pose)
    assert found.unmeasured == pytest.approx(unknown, rel=0.01, abs=1e-6)
    assert found.free == pytest.approx(free, rel=0.01)
    same = np.isfinite(found.depths) == np.isfinite(depths)
    assert same.mean() > 0.98
    both = np.isfinite(found.depths) & np.isfinite(depths)
    assert np.quantile(np.abs(found.depths[both] - depths[both]), 0.95) < 0.002


def test_wall_hides_what_is_behind_it():
    pose = RigidTransform.identity()
    seen = view_counts(scanned(4), pose, FRUSTUM)
    assert seen.blocked > 0.95
    assert np.abs(seen.depths[np.isfinite(seen.depths)] - WALL).max() < 0.015
    assert seen.information < 0.05 * view_counts(VoxelMap(GRID), pose, FRUSTUM).information


def test_known_space_tells_nothing_however_often_it_is_looked_at():
    voxels = scanned(8)
    pose = RigidTransform.identity()
    near = dataclasses.replace(FRUSTUM, far=0.5)
    whole = view_counts(VoxelMap(GRID), pose, near).information
    # But for the voxels that are only partly in view.
    assert view_counts(voxels, pose, near).information < 0.03 * whole


def test_information_counts_voxels_so_a_finer_map_has_eight_times_as_many():
    pose = RigidTransform.identity()
    box = (-0.48, -0.48, -0.16), (0.48, 0.48, 0.8)  # Whole bricks of either.
    counts = [view_counts(VoxelMap(VoxelGrid(size, *box)), pose, FRUSTUM) for size in (0.02, 0.01)]
    assert counts[0].unmeasured == pytest.approx(counts[1].unmeasured, rel=1e-6)
    assert counts[1].information == pytest.approx(8 * counts[0].information, rel=0.03)


def test_free_path_must_be_positive():
    with pytest.raises(ValueError, match="mean_free_path"):
        view_counts(VoxelMap(GRID), RigidTransform.identity(), FRUSTUM, mean_free_path=0.0)
