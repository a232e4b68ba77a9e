"""Voxel maps on disk: a crash while saving leaves the old file; points and meshes for others."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false
# pyright: reportUnknownArgumentType=false

import dataclasses
import math
import os
import tokenize
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.exchange.ply import export_ply

from perception.geometry.files import MAP, check_size, replace_file
from perception.voxels.bricks import (
    BLOCKS,
    BRICKS,
    FREE_BRICKS,
    FREE_RECORDS,
    POINTS,
    RECORDS,
    SIDE,
    Bricks,
)
from perception.voxels.grid import MapError, VoxelGrid
from perception.voxels.map import VoxelMap, VoxelMapConfig
from perception.voxels.occupancy import UpdateModel

FORMAT, VERSION = "fieldtwin voxel map", 1
MESHES = ("ply", "stl", "obj", "glb")
"""Endings of the files that a mesh can be written to."""
# An archive whose flags are damaged needs a password, or what no reader can do.
_UNREADABLE = (
    OSError, ValueError, KeyError, EOFError, AttributeError, RuntimeError, zipfile.BadZipFile,
    MemoryError,  # An array's header may say any size.
    SyntaxError, tokenize.TokenError,  # NumPy reads an array's header as Python.
)  # fmt: skip
_STORES = {
    "values": BRICKS,
    "block": BRICKS,
    "slots": BLOCKS,
    "records": RECORDS,
    "free_bricks": FREE_BRICKS,
    "free_records": FREE_RECORDS,
}
"""Entry of `Bricks.used` that counts the used rows of each array."""


def save(voxels: VoxelMap, path: Path | str) -> None:
    """Save a map; `load` reads it."""
    used = voxels.bricks.used
    arrays = {name: getattr(voxels.bricks, name)[: used[entry]] for name, entry in _STORES.items()}
    config = dataclasses.asdict(voxels.config)
    model = config.pop("model")
    grid = voxels.grid
    numbers = {
        "format": np.array(FORMAT),
        "version": np.array(VERSION),
        "scans": np.array(voxels.scans),
        "grid": np.array([grid.resolution, *grid.lower, *grid.upper]),
        "model": np.array([model[name] for name in _fields(UpdateModel)]),
        "config": np.array([float(config[name]) for name in _fields(VoxelMapConfig)[1:]]),
        "index": voxels.bricks.index,
        "used": used,
    }
    replace_file(path, lambda stream: np.savez(stream, **numbers, **arrays))


def load(path: Path | str) -> VoxelMap:
    """Read a map that was saved.

    Raises:
        MapError: If the file is none, is damaged, or is of another version.
        FileNotFoundError: If there is no file.
    """
    try:
        check_size(path, MAP)
        with np.load(Path(path), allow_pickle=False) as file:
            _check_archive(file.zip, os.path.getsize(path))
            found: dict[str, Any] = {name: file[name] for name in file.files}
        if str(found["format"]) != FORMAT:
            raise ValueError("another format")
        version = int(found["version"])
    except FileNotFoundError:
        raise
    except _UNREADABLE as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"{path}: no voxel map, or a damaged one: {reason}") from error
    if version != VERSION:
        raise MapError(f"{path}: voxel map of version {version}, this program reads {VERSION}")
    try:
        return _rebuilt(found)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise MapError(f"{path}: a damaged voxel map: {error}") from error


def _check_archive(archive: zipfile.ZipFile, size: int) -> None:
    """Refuse an archive that holds more than its own bytes: `save` does not compress."""
    inside = sum(entry.file_size for entry in archive.infolist())
    if inside > size:
        raise ValueError(f"{inside:,} bytes in a file of {size:,}")


def _fields(kind: type) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def _rebuilt(found: dict[str, Any]) -> VoxelMap:
    model = UpdateModel(*found["model"].tolist())
    deviations, margin, correlated, coarse, limit = found["config"].tolist()
    config = VoxelMapConfig(model, deviations, margin, correlated, bool(coarse), int(limit))
    resolution, *corners = found["grid"].tolist()
    x0, y0, z0, x1, y1, z1 = corners
    grid = VoxelGrid(resolution, (x0, y0, z0), (x1, y1, z1))
    # Before memory is taken for a grid of any size.
    if found["index"].size * SIDE**3 != math.prod(grid.shape):
        raise ValueError(f"index: {found['index'].shape}")
    voxels = VoxelMap(grid, config)
    empty = voxels.bricks
    arrays = {"index": found["index"], "used": found["used"]}
    arrays |= {name: found[name] for name in _STORES}
    bricks = Bricks(**{name: np.ascontiguousarray(array) for name, array in arrays.items()})
    for name, array in bricks._asdict().items():
        expected = getattr(empty, name)
        length = bricks.used[_STORES[name]] if name in _STORES else len(expected)
        if array.dtype != expected.dtype or array.shape != (length, *expected.shape[1:]):
            raise ValueError(f"{name}: {array.dtype} {array.shape}")
    _check_references(bricks)
    # The stacks of what was given back must be as long as what they may hold.
    size = (len(bricks.values), len(bricks.records))
    stacks = [np.zeros(length, dtype=np.int32) for length in size]
    stacks[0][: len(bricks.free_bricks)] = bricks.free_bricks
    stacks[1][: len(bricks.free_records)] = bricks.free_records
    voxels.bricks = bricks._replace(free_bricks=stacks[0], free_records=stacks[1])
    voxels.scans = int(found["scans"])
    return voxels


def _check_references(bricks: Bricks) -> None:
    """Check the values; an error names the wrong one."""
    _check_numbers("index", bricks.index, bricks.free_bricks, len(bricks.values))
    blocks = bricks.block[bricks.index[bricks.index >= 0]]
    _check_numbers("block", blocks, blocks[:0], len(bricks.slots))
    slots = bricks.slots[blocks[blocks >= 0]]
    _check_numbers("slots", slots, bricks.free_records, len(bricks.records))
    live = bricks.records[slots[slots >= 0], : POINTS + 1]
    if np.any(bricks.index < -256) or not np.isfinite(live).all():
        raise ValueError("index or records: out of range")


def _check_numbers(
    name: str, numbers: NDArray[np.int32], given_back: NDArray[np.int32], count: int
) -> None:
    every = np.concatenate([numbers[numbers >= 0].ravel(), given_back])
    outside = np.any(every >= count) or np.any(every < 0)
    if outside or len(np.unique(every)) < len(every):
        raise ValueError(f"{name}: points at nothing, or twice at the same")


def export_points(voxels: VoxelMap, path: Path | str) -> int:
    """Write the surface estimates as a PLY cloud, coloured by probability; return how many.

    Colours go from blue (hardly more than even) to red (certain).
    """
    surface = voxels.surface()
    certain = np.clip(2.0 * surface.probabilities - 1.0, 0.0, 1.0)
    colours = np.column_stack([255 * certain, 60 + 0 * certain, 255 * (1 - certain)])
    opaque = np.column_stack([colours, np.full(len(certain), 255)]).astype(np.uint8)
    cloud = trimesh.PointCloud(surface.means, colors=opaque)
    content = export_ply(cloud) if len(certain) else _EMPTY_PLY
    replace_file(path, lambda stream: _write(stream, content))
    return len(certain)


_EMPTY_PLY = (
    b"ply\nformat ascii 1.0\nelement vertex 0\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n"
)


def _write(stream: IO[bytes], content: Any) -> None:
    stream.write(content.encode() if isinstance(content, str) else content)


def surface_mesh(voxels: VoxelMap) -> trimesh.Trimesh:
    """Return the faces between occupied voxels and all others, as a closed mesh [m], world."""
    cells, _ = voxels.occupied_cells()
    size = np.array(voxels.grid.shape) + 2
    flat = np.ravel_multi_index(tuple((cells + 1).T), tuple(size))
    corners: list[NDArray[np.int64]] = []
    for axis in range(3):
        across, up = (np.eye(3, dtype=np.int64)[(axis + k) % 3] for k in (1, 2))
        along = np.eye(3, dtype=np.int64)[axis]
        for side in (0, 1):
            beyond = cells + 1 + (2 * side - 1) * along
            open_ = ~np.isin(np.ravel_multi_index(tuple(beyond.T), tuple(size)), flat)
            start = cells[open_] + side * along
            ring = [start, start + across, start + across + up, start + up]
            corners.append(np.stack(ring if side else ring[::-1], axis=1))
    quads = np.concatenate(corners)
    points, numbers = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    numbers = numbers.reshape(-1, 4)
    faces = np.concatenate([numbers[:, [0, 1, 2]], numbers[:, [0, 2, 3]]])
    vertices = (points + voxels.grid.first) * voxels.grid.resolution
    return trimesh.Trimesh(vertices, faces, process=False)


def export_mesh(voxels: VoxelMap, path: Path | str) -> int:
    """Write `surface_mesh` to a file whose ending is the format, one of `MESHES`.

    Returns:
        How many triangles it has.

    Raises:
        MapError: If nothing is occupied, or the ending is another.
    """
    kind = Path(path).suffix.lstrip(".")
    if kind not in MESHES:
        raise MapError(f"{path}: expected a mesh's name to end in one of .{', .'.join(MESHES)}")
    mesh = surface_mesh(voxels)
    if len(mesh.faces) == 0:
        raise MapError("map: nothing is occupied, so there is no mesh")
    replace_file(path, lambda stream: _write(stream, mesh.export(file_type=kind)))
    return len(mesh.faces)
