"""Maps on disk: what was saved is what is read, and a crash loses nothing."""

import numpy as np
import pytest
import trimesh

from perception import voxel_files
from perception.voxel_files import export_mesh, export_points, load, save
from perception.voxel_grid import MapError
from perception.voxel_map import VoxelMap
from tests.perception.test_voxel_fast import FRUSTUM, GRID, cone, scanned, wall_scan


@pytest.fixture(scope="module")
def voxels():
    return scanned(3, np.random.default_rng(0))


def test_saved_map_is_read_as_it_was_and_goes_on_alike(tmp_path, voxels):
    save(voxels, tmp_path / "a.map")
    other = load(tmp_path / "a.map")
    places = cone([0.1, 0.3, 0.58, 0.6, 0.62, 0.75])
    np.testing.assert_array_equal(other.probabilities(places), voxels.probabilities(places))
    assert other.counts() == voxels.counts() and other.config == voxels.config
    again = load(tmp_path / "a.map")
    pose, points, covariances = wall_scan()
    for one in (other, again):
        one.insert(pose, FRUSTUM, points + [0.0, 0.0, 0.05], covariances)
    np.testing.assert_array_equal(other.surface().means, again.surface().means)
    assert other.scans == voxels.scans + 1


def test_crash_while_saving_leaves_the_old_file(tmp_path, voxels, monkeypatch):
    path = tmp_path / "a.map"
    save(voxels, path)
    old = path.read_bytes()

    def crash(stream, **arrays):
        stream.write(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(voxel_files.np, "savez", crash)
    with pytest.raises(KeyboardInterrupt):
        save(voxels, path)
    assert path.read_bytes() == old and [p.name for p in tmp_path.iterdir()] == ["a.map"]


@pytest.mark.parametrize("damage", ["cut", "empty", "text", "other"])
def test_what_is_no_map_is_told(tmp_path, voxels, damage):
    path = tmp_path / "a.map"
    save(voxels, path)
    content = path.read_bytes()
    if damage == "other":
        with path.open("wb") as stream:
            np.savez(stream, format=np.array("a song"))
    else:
        path.write_bytes({"cut": content[: len(content) // 2], "empty": b"", "text": b"hi"}[damage])
    with pytest.raises(MapError, match="a.map"):
        load(path)


def test_points_and_mesh_are_read_by_trimesh(tmp_path, voxels):
    count = export_points(voxels, tmp_path / "points.ply")
    cloud = trimesh.load(tmp_path / "points.ply")
    assert count == len(cloud.vertices) == len(voxels.surface().means)
    np.testing.assert_allclose(np.sort(cloud.vertices[:, 2]), np.sort(voxels.surface().means[:, 2]),
                               atol=1e-5)  # fmt: skip
    assert len(np.unique(cloud.colors[:, 0])) > 1
    faces = export_mesh(voxels, tmp_path / "mesh.stl")
    mesh = trimesh.load(tmp_path / "mesh.stl")
    cells, _ = voxels.occupied_cells()
    assert len(mesh.faces) == faces
    assert abs(mesh.volume) == pytest.approx(len(cells) * GRID.resolution**3, rel=1e-4)


def test_empty_map_has_no_mesh_and_no_points(tmp_path):
    empty = VoxelMap(GRID)
    assert export_points(empty, tmp_path / "points.ply") == 0
    with pytest.raises(MapError, match="nothing is occupied"):
        export_mesh(empty, tmp_path / "mesh.ply")
    assert [p.name for p in tmp_path.iterdir()] == ["points.ply"]
