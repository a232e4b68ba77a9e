"""Bytes of an elevation map's tiles beside zlib's, and what damage makes of them."""

import dataclasses
import zlib
from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from experiments.bench.bench_options import Options
from experiments.harness.output import Output
from models.compose import make_terrain
from models.configuration import FieldConfig
from perception.compression.byte_codes import (
    CodingError,
    huffman_encode,
    lzw_encode,
    run_length_encode,
)
from perception.elevation.deltas import (
    STEP,
    TILE,
    TileDelta,
    decode_delta,
    encode_delta,
    residuals_of,
    rounded,
    tile_counts,
    tile_parts,
)
from perception.elevation.grid import ElevationGrid
from perception.elevation.map import ElevationMap
from perception.geometry.arrays import ByteArray, FloatArray
from perception.geometry.pinhole import Pinhole

FIELD = FieldConfig(size=(6.0, 6.0), relief=0.02, rocks=300, rock_radius=(0.03, 0.1))
"""Ground to drive over."""
VIEW = Pinhole(140, 105, 130.0, 130.0, 69.5, 52.0)
"""Pixels of a view that points are made of."""
DISPARITY = 36.0
"""Focal length by baseline, in full pixels [px m]."""
PIXEL_SIGMA = 0.1
"""Deviation of disparities [px]."""
STRAYS = 0.01
"""Share of false matches."""
NEAREST, FARTHEST, MARCH = 0.35, 3.0, 0.02
"""Depths that are matched, and step in which rays are followed [m]."""
CAMERA_HEIGHT, PITCH = 0.4, 0.4
"""Height of the camera above ground [m], and by how much it looks down [rad]."""
DRIVES, QUICK_DRIVES, VIEWS, VIEWS_A_DELTA, DRIVE = 8, 2, 12, 3, 0.25
"""Drives; views of each, and after how many the changed tiles are sent; way between views [m]."""
SLOPE, FINE, EDGE = 0.15, 0.02, 2.4
"""Rise of the ground along x, spacing of its heights and where drives turn back [m]."""
DAMAGED, QUICK_DAMAGED = 30000, 3000
"""Messages damaged in transit."""
LONGEST_BURST = 8
"""Most bits or bytes damaged together."""
FEWEST_CELLS = 8
"""Tiles with fewer changed cells are left for later."""
CODES: dict[str, Callable[[ByteArray], bytes]] = {
    "huffman": huffman_encode,
    "run_length": run_length_encode,
    "lzw": lzw_encode,
    "zlib": lambda symbols: zlib.compress(symbols.tobytes(), 9),
}
"""Codes of appendix C and zlib's, of the same residuals and masks."""


def bench_elevation_tiles(options: Options, output: Output) -> None:
    """Code the tiles of simulated drives, and damage them.

    Args:
        options: ``quick`` drives less and damages fewer messages; ``seed`` draws ground and noise.
        output: Receives the mean ``tile_bytes/<code>``, ``tile_cells`` and ``tile_silent_damages``.
    """
    rng = np.random.default_rng(options.seed)
    drives = QUICK_DRIVES if options.quick else DRIVES
    deltas = [delta for _ in range(drives) for delta in _deltas_of_a_drive(rng)]
    sizes = [_sizes(delta) for delta in deltas]
    for name in sizes[0]:
        output.measure(f"tile_bytes/{name}", float(np.mean([size[name] for size in sizes])))
    output.measure("tile_cells", float(np.mean([len(delta.cells) for delta in deltas])))
    messages = [encode_delta(delta) for delta in deltas]
    count = QUICK_DAMAGED if options.quick else DAMAGED
    whole = set(messages)
    silent = sum(_decodes(_damaged(rng, messages, index), whole) for index in range(count))
    output.measure("tile_silent_damages", silent)
    output.check(f"tiles of {count} damaged messages decoded silently", silent, "0", silent == 0)


def _deltas_of_a_drive(rng: np.random.Generator) -> list[TileDelta]:
    """Return what a rover that drives over ground of its own would send."""
    field = dataclasses.replace(FIELD, seed=int(rng.integers(2**31)))
    terrain, nodes = make_terrain(field), np.arange(-3.0, 3.0 + FINE, FINE)
    y, x = np.meshgrid(nodes, nodes, indexing="ij")
    ground = terrain.height_at(np.stack([x, y], axis=-1)) + SLOPE * x
    model, found = ElevationMap(ElevationGrid((-3.2, -3.2), (128, 128))), list[TileDelta]()
    sent = np.full(model.grid.shape, np.nan)
    place, yaw = rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi)
    for view in range(1, VIEWS + 1):
        model.insert(*_points_of_a_view(rng, ground, place, yaw))
        place = place + DRIVE * np.array([np.cos(yaw), np.sin(yaw)])
        # Back to the middle before the field ends.
        away = np.abs(place).max() > EDGE
        yaw = float(np.arctan2(*-place[::-1])) if away else yaw + rng.uniform(-0.3, 0.3)
        if view % VIEWS_A_DELTA == 0:
            found += _changed_tiles(model, sent)
    return found


def _points_of_a_view(
    rng: np.random.Generator, ground: FloatArray, place: FloatArray, yaw: float
) -> tuple[FloatArray, FloatArray]:
    """Return points (N, 3) [m] of a stereo view, and their covariances [m^2], world."""
    down = Rotation.from_euler("x", -0.5 * np.pi - PITCH)
    rays = (Rotation.from_euler("z", yaw - 0.5 * np.pi) * down).apply(
        VIEW.rays(VIEW.pixel_grid()).reshape(-1, 3)
    )
    eye = np.append(place, _height(ground, place[None])[0] + CAMERA_HEIGHT)
    depths, open_rays = np.full(len(rays), np.nan), np.arange(len(rays))
    for depth in np.arange(NEAREST, FARTHEST, MARCH):
        points = eye + depth * rays[open_rays]
        below = points[:, 2] < _height(ground, points)
        depths[open_rays[below]] = depth - 0.5 * MARCH
        open_rays = open_rays[~below]
    seen = np.isfinite(depths)
    rays, depths = rays[seen], depths[seen]
    sigmas = depths**2 / DISPARITY * PIXEL_SIGMA
    points = eye + (depths + sigmas * rng.standard_normal(len(depths)))[:, None] * rays
    strays = rng.uniform(size=len(points)) < STRAYS
    points[strays, 2] += rng.uniform(-0.3, 0.3, strays.sum())
    along = sigmas[:, None] * rays
    return points, along[:, :, None] * along[:, None, :] + 1e-7 * np.eye(3)


def _height(ground: FloatArray, points: FloatArray) -> FloatArray:
    """Return the height (N,) of the ground at points (N, 2 or 3) [m]."""
    places = (points[:, 1::-1].T + 3.0) / FINE
    return map_coordinates(ground, places, order=1, mode="nearest")


def _changed_tiles(model: ElevationMap, sent: FloatArray) -> list[TileDelta]:
    """Return deltas of what changed since it was sent, and note it as sent."""
    found, rows_and_columns = list[TileDelta](), tile_counts(model.grid)
    changed = model.known & ~(np.abs(model.heights - sent) < STEP)
    for tile in range(int(np.prod(rows_and_columns))):
        part = tile_parts(model.grid, tile)
        rows, columns = np.nonzero(changed[part])
        if len(rows) < FEWEST_CELLS:
            continue
        heights = rounded(model.heights[part][rows, columns])
        sent[part][rows, columns] = heights
        deviation = float(np.sqrt(model.variances[part][rows, columns].mean()))
        found.append(TileDelta(1, tile, 0, rows * TILE + columns, heights, deviation))
    return found


def _sizes(delta: TileDelta) -> dict[str, int]:
    """Return the bytes that a delta takes, whole and by parts, in several codes."""
    mask, steps = np.zeros(TILE * TILE, np.bool_), np.zeros(TILE * TILE, np.int64)
    mask[delta.cells], steps[delta.cells] = True, np.rint(delta.heights / STEP)
    left = residuals_of(steps.reshape(TILE, TILE), mask.reshape(TILE, TILE))[1:]
    left = np.where(left >= 0, 2 * left, -2 * left - 1).clip(max=0xFF).astype(np.uint8)
    known = np.packbits(mask)
    plain = known.tobytes() + steps[delta.cells].astype(">i2").tobytes()
    sizes = {"coded": len(encode_delta(delta)), "plain": len(plain)}
    sizes["plain/zlib"] = len(zlib.compress(plain, 9))
    for name, code in CODES.items():
        sizes[f"residuals/{name}"] = len(code(left))
        sizes[f"mask/{name}"] = len(code(known))
    return sizes


def _damaged(rng: np.random.Generator, messages: list[bytes], index: int) -> bytes:
    """Return a message with bits turned, a burst, bytes lost or doubled, or another's end."""
    message = bytearray(messages[index % len(messages)])
    other, size = messages[int(rng.integers(len(messages)))], int(rng.integers(1, LONGEST_BURST))
    at = int(rng.integers(len(message)))
    match index % 5:
        case 0:
            for bit in rng.integers(8 * len(message), size=size):
                message[bit >> 3] ^= 1 << (bit & 7)
        case 1:
            message[at : at + size] = rng.bytes(len(message[at : at + size]))
        case 2:
            del message[at : at + size]
        case 3:
            message[at:at] = message[at : at + size]
        case _:
            message[at:] = other[at:]
    return bytes(message)


def _decodes(message: bytes, whole: set[bytes]) -> bool:
    """Return whether a message that is none of the whole ones is taken for a tile."""
    if message in whole:
        return False
    try:
        decode_delta(message)
    except CodingError:
        return False
    return True
