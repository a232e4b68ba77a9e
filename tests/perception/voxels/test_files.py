"""Maps on disk: nothing is lost, and nothing half written is ever found."""

import tracemalloc
import zipfile

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import RigidTransform, Rotation

from perception.geometry.files import MAP
from perception.geometry.pinhole import Frustum
from perception.voxels import files as voxel_files
from perception.voxels.files import (
    MESHES,
    export_mesh,
    export_points,
    load,
    save,
    surface_mesh,
)
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from perception.voxels.occupancy import State

VIEW = Frustum(60, 60, 70.0, 70.0, 29.5, 29.5, near=0.1, far=1.5)
POSE = RigidTransform.from_components([0.0, 0.0, 0.5], Rotation.from_euler("x", np.pi))


def step_map(scans=2):
    """Return a map of ground with a step of 5 cm in it."""
    grid = VoxelGrid(0.02, (-0.2, -0.2, -0.06), (0.2, 0.2, 0.4))
    voxels = VoxelMap(grid, VoxelMapConfig(correlated_points=3.0))
    for index in range(scans):
        insert(voxels, 0.05 + 0.001 * index)
    return voxels


def insert(voxels, step):
    rays = VIEW.rays(VIEW.pixel_grid()).reshape(-1, 3)
    depth = np.where(rays[:, 0] > 0.1, 0.495 - step, 0.495)
    points = POSE.apply(rays * depth[:, None])
    covariances = np.tile(np.diag([1e-7, 1e-7, 4e-6]), (len(points), 1, 1))
    voxels.insert(POSE, VIEW, points, covariances)


def same(a, b):
    where = a.grid.centres(np.stack(np.indices(a.grid.shape), axis=-1).reshape(-1, 3))
    np.testing.assert_array_equal(a.probabilities(where), b.probabilities(where))
    for name in ("means", "covariances", "probabilities"):
        np.testing.assert_array_equal(getattr(a.surface(), name), getattr(b.surface(), name))


def test_a_loaded_map_is_equal_and_continues_equally(tmp_path):
    voxels = step_map()
    save(voxels, tmp_path / "map.npz")
    loaded = load(tmp_path / "map.npz")
    assert (loaded.grid, loaded.config, loaded.scans) == (voxels.grid, voxels.config, 2)
    same(voxels, loaded)
    for either in (voxels, loaded):
        insert(either, 0.09)
        insert(either, 0.02)
    same(voxels, loaded)


def test_an_empty_map_survives(tmp_path):
    voxels = step_map(scans=0)
    save(voxels, tmp_path / "map.npz")
    assert load(tmp_path / "map.npz").counts() == voxels.counts()


def test_a_crash_while_saving_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "map.npz"
    save(step_map(), path)
    old = path.read_bytes()

    def crash(stream, **arrays):
        stream.write(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(voxel_files.np, "savez", crash)
    with pytest.raises(KeyboardInterrupt):
        save(step_map(scans=1), path)
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_refused(tmp_path, share):
    path = tmp_path / "map.npz"
    save(step_map(), path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(MapError, match="map.npz: no voxel map"):
        load(path)


def test_flipped_bytes_are_refused_or_harmless(tmp_path):
    path = tmp_path / "map.npz"
    save(step_map(), path)
    whole = bytearray(path.read_bytes())
    generator = np.random.default_rng(1)
    header = whole.index(b"{'descr'")  # NumPy reads it as Python.
    places = [*generator.integers(0, len(whole), 60), *range(header, header + 60)]
    for position in places:
        damaged = whole.copy()
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            load(path).surface()
        except MapError as error:
            assert "map.npz" in str(error)


@pytest.mark.parametrize("offset", [6, 8, 10])  # Version needed, flags and method of an entry.
def test_flipped_bytes_of_the_archives_directory_are_refused(tmp_path, offset):
    path = tmp_path / "map.npz"
    save(step_map(scans=0), path)
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(b"PK\x01\x02") + offset] ^= 0xFF
    path.write_bytes(damaged)
    with pytest.raises(MapError, match="map.npz: no voxel map"):
        load(path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"version": np.array(99)}, "version 99, this program reads 1"),
        ({"format": np.array("another")}, "no voxel map"),
        ({"values": np.zeros((3, 5), dtype=np.int8)}, "damaged voxel map: values"),
        ({"used": np.array([1, 1, 1, 0, 0, 0])}, "damaged"),
        ({"grid": np.full(7, np.nan)}, "damaged"),
        ({"model": np.array([0.1, 0.9, 0.1, 0.9, 0.5])}, "damaged"),
    ],
)
def test_a_file_that_is_no_such_map_is_refused(tmp_path, change, named):
    path = tmp_path / "map.npz"
    save(step_map(), path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    np.savez(path, **(arrays | change))
    with pytest.raises(MapError, match=named):
        load(path)


def saved_arrays(path):
    save(step_map(scans=0), path)
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def assert_refused_in_little_memory(path, reason):
    tracemalloc.start()
    try:
        with pytest.raises(MapError, match=reason):
            load(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


def test_an_archive_that_unpacks_to_more_than_its_file_is_refused(tmp_path):
    path = tmp_path / "map.npz"
    np.savez_compressed(path, **saved_arrays(path), more=np.zeros(10**8, dtype=np.int8))
    assert path.stat().st_size < 200_000
    assert_refused_in_little_memory(path, r"map.npz: no voxel map, .* bytes in a file of")


def test_a_grid_of_other_size_than_its_index_is_refused_before_memory_is_taken(tmp_path):
    path = tmp_path / "map.npz"
    arrays = saved_arrays(path)
    arrays["grid"] = arrays["grid"] * [1e-2, 1, 1, 1, 1, 1, 1]
    np.savez(path, **arrays)
    assert_refused_in_little_memory(path, r"map.npz: a damaged voxel map: index")


def test_an_array_that_is_shorter_than_its_header_says_is_refused(tmp_path):
    path = tmp_path / "map.npz"
    arrays = saved_arrays(path)
    for count in (b"9" * 10, b"9" * 17):
        with zipfile.ZipFile(path, "w") as archive:
            for name in arrays:
                header = b"{'descr': '<i8', 'fortran_order': False, 'shape': (" + count + b",)}\n"
                length = len(header).to_bytes(2, "little")
                archive.writestr(f"{name}.npy", b"\x93NUMPY\x01\x00" + length + header + bytes(8))
        with pytest.raises(MapError, match=r"map.npz: no voxel map"):
            load(path)


def test_a_limit_of_memory_that_is_no_number_is_refused(tmp_path):
    path = tmp_path / "map.npz"
    arrays = saved_arrays(path)
    np.savez(path, **(arrays | {"config": np.full(5, np.inf)}))
    with pytest.raises(MapError, match="damaged voxel map"):
        load(path)


def test_a_file_larger_than_any_map_is_refused(tmp_path):
    path = tmp_path / "map.npz"
    with path.open("wb") as stream:
        stream.truncate(MAP + 1)  # Takes no place on the disk.
    with pytest.raises(MapError, match="too large: 2,147,483,649 bytes, the limit is"):
        load(path)


def test_references_to_nothing_are_refused(tmp_path):
    path = tmp_path / "map.npz"
    save(step_map(), path)
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files}
    for name in ("index", "slots", "block"):
        for wrong in (10**6, 0):
            damaged = arrays[name].copy()
            damaged[damaged >= 0] = wrong
            np.savez(path, **(arrays | {name: damaged}))
            with pytest.raises(MapError, match="points at nothing"):
                load(path)


def test_a_pickle_is_not_executed(tmp_path):
    path = tmp_path / "map.npz"
    np.savez(path, format=np.array([{"a": 1}], dtype=object), version=np.array(1))
    with pytest.raises(MapError, match="no voxel map"):
        load(path)
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "missing.npz")


def test_exported_points_are_read_back_by_trimesh(tmp_path):
    voxels = step_map()
    count = export_points(voxels, tmp_path / "map.ply")
    surface = voxels.surface()
    cloud = trimesh.load(tmp_path / "map.ply")
    assert count == len(surface.means) == len(cloud.vertices)
    np.testing.assert_allclose(cloud.vertices, surface.means, atol=1e-6)
    red = np.asarray(cloud.colors)[:, 0]
    np.testing.assert_allclose(red, 255 * (2 * surface.probabilities - 1).clip(0), atol=1.0)
    assert export_points(step_map(scans=0), tmp_path / "empty.ply") == 0
    assert b"element vertex 0" in (tmp_path / "empty.ply").read_bytes()


def test_the_exported_mesh_encloses_the_occupied_voxels(tmp_path):
    voxels = step_map()
    export_mesh(voxels, tmp_path / "map.stl")
    mesh = trimesh.load(tmp_path / "map.stl")
    occupied = voxels.counts()[State.OCCUPIED]
    assert mesh.volume == pytest.approx(occupied * voxels.grid.resolution**3, rel=1e-4)
    lower, upper = surface_mesh(voxels).bounds
    centres = voxels.grid.centres(voxels.occupied_cells()[0])
    half = voxels.grid.resolution / 2
    np.testing.assert_allclose([lower, upper], [centres.min(0) - half, centres.max(0) + half])
    with pytest.raises(MapError, match="nothing is occupied"):
        export_mesh(step_map(scans=0), tmp_path / "none.stl")


def test_mesh_format_follows_the_file_extension_and_other_extensions_are_refused(
    tmp_path, monkeypatch
):
    box = trimesh.creation.box()
    monkeypatch.setattr(voxel_files, "surface_mesh", lambda voxels: box)
    for kind in MESHES:
        assert export_mesh(step_map(scans=0), tmp_path / f"map.{kind}") == len(box.faces)
        assert len(trimesh.load(tmp_path / f"map.{kind}", force="mesh").faces) == len(box.faces)
    for name in ("map.step", "map"):
        with pytest.raises(MapError, match=r"end in one of \.ply, \.stl, \.obj, \.glb"):
            export_mesh(step_map(scans=0), tmp_path / name)
