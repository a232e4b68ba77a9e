"""Worlds to map: an unstructured field, an indoor floor, or a picture (figures 3-12, 3-19)."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage
from scipy.cluster.hierarchy import DisjointSet

from experiments.harness.contract import OptionError
from perception.geometry.arrays import BoolArray
from perception.geometry.files import check_picture
from perception.planar.map import Grid

UNSTRUCTURED_OBSTACLES = (22, 30)
"""Fewest and most obstacles of an unstructured world."""
RADII = (1.5, 6.0)
"""Smallest and largest mean radius of an obstacle [m]."""
CORRIDOR = 4.0
DOOR = 2.0
ROOM = (9.0, 24.0)
"""Shortest side of a room, and the side from which it is split [m]."""
IMAGE_LONGEST = 200
"""A larger picture is shrunk so that its longer side has this many cells."""
SMALLEST = 20
"""Fewest pixels along a side of a picture."""
FEWEST_FREE = 100
"""Fewest cells of a region to start in."""
DARK = 128
HECTARE = Grid(200, 200, 0.5)
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=bool)


@dataclasses.dataclass(frozen=True)
class World:
    """A planar world, the truth of a simulated run.

    Attributes:
        grid: Number and size of the cells.
        occupied: (rows, columns) obstacles.
        start: Row and column of the first robot.
        visible: (rows, columns) cells that can be seen from somewhere that can be reached.
    """

    grid: Grid
    occupied: BoolArray
    start: tuple[int, int]
    visible: BoolArray

    def starts(self, robots: int) -> list[tuple[int, int]]:
        """Return start cells of several robots: the reachable ones nearest to ``start``."""
        free = np.argwhere(self.visible & ~self.occupied)
        distance = np.hypot(*(free - self.start).T)
        order = np.argsort(distance, kind="stable")[:robots]
        return [(int(r), int(c)) for r, c in free[order]]


def make_world(occupied: BoolArray, generator: np.random.Generator, cell: float = 0.5) -> World:
    """Draw a start and find the visible cells.

    Robots move between cells that share a side, diagonally only past two free cells; beams pass
    corners likewise. So a robot can come to see just the free cells connected by sides to its
    start, and the obstacle cells beside those.

    Args:
        occupied: (rows, columns) obstacles.
        generator: Random generator for the start, drawn evenly in the largest connected region.
        cell: Side of a cell [m].

    Raises:
        ValueError: If the largest region is too small to start in.
    """
    labels, count = ndimage.label(~occupied, structure=_CROSS)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    if count == 0 or sizes.max() < FEWEST_FREE:
        largest = int(sizes.max()) if count else 0
        raise ValueError(
            f"no free start: the largest free region has {largest} cells, needed {FEWEST_FREE}"
        )
    region = labels == 1 + int(np.argmax(sizes))
    beside = ndimage.binary_dilation(region, structure=_CROSS)
    cells = np.argwhere(region)
    start = cells[int(generator.integers(len(cells)))]
    grid = Grid(occupied.shape[0], occupied.shape[1], cell)
    return World(grid, occupied, (int(start[0]), int(start[1])), region | (beside & occupied))


def unstructured_world(seed: int, grid: Grid = HECTARE) -> World:
    """Scatter convex and irregular obstacles (as in figure 3-12).

    Args:
        seed: Random seed of obstacles and start.
        grid: Size of the world.
    """
    generator = np.random.default_rng(seed)
    canvas = np.zeros(grid.shape, dtype=np.uint8)
    scale = grid.rows * grid.columns * grid.cell**2 / 1e4
    count = round(int(generator.integers(*UNSTRUCTURED_OBSTACLES, endpoint=True)) * scale)
    for _ in range(count):
        centre = generator.uniform((0, 0), (grid.columns, grid.rows))
        radius = generator.uniform(*RADII) / grid.cell
        corners = int(generator.integers(4, 12))
        angles = np.sort(generator.uniform(0.0, 2.0 * np.pi, corners))
        irregular = generator.random() < 0.5
        reach = radius * (generator.uniform(0.3, 1.5, corners) if irregular else np.ones(corners))
        outline = centre + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        outline = np.round(outline).astype(np.int32)
        cv2.fillPoly(canvas, [outline if irregular else cv2.convexHull(outline)], 1)
    return make_world(canvas.astype(bool), generator, grid.cell)


def indoor_world(seed: int, grid: Grid = HECTARE) -> World:
    """Lay out a floor: crossing corridors, rooms with doors, furniture (as in figure 3-19).

    Args:
        seed: Random seed of walls, doors, furniture and start.
        grid: Size of the world.
    """
    generator = np.random.default_rng(seed)
    rows, columns = grid.shape
    occupied = np.zeros(grid.shape, dtype=bool)
    wide = round(CORRIDOR / grid.cell)
    cross_row = int(generator.integers(round(0.35 * rows), round(0.65 * rows) - wide))
    cross_column = int(generator.integers(round(0.35 * columns), round(0.65 * columns) - wide))
    row_parts = ((1, cross_row - 1), (cross_row + wide + 1, rows - 1))
    column_parts = ((1, cross_column - 1), (cross_column + wide + 1, columns - 1))
    for low_r, high_r in row_parts:
        for low_c, high_c in column_parts:
            occupied[low_r - 1 : high_r + 1, low_c - 1 : high_c + 1] = True
            occupied[low_r:high_r, low_c:high_c] = False
            rooms = _split(occupied, (low_r, high_r, low_c, high_c), grid.cell, generator)
            _furnish(occupied, rooms, grid.cell, generator)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    _open_doors(occupied, grid.cell, generator)
    return make_world(occupied, generator, grid.cell)


def _split(
    occupied: BoolArray, box: tuple[int, int, int, int], cell: float, generator: np.random.Generator
) -> list[tuple[int, int, int, int]]:
    """Divide a block into rooms by walls one cell thick; each box is rows, then columns."""
    low_r, high_r, low_c, high_c = box
    tall = high_r - low_r >= high_c - low_c
    low, high = (low_r, high_r) if tall else (low_c, high_c)
    shortest, longest = (round(side / cell) for side in ROOM)
    if high - low <= longest or high - low < 2 * shortest + 1:
        return [box]
    wall = int(generator.integers(low + shortest, high - shortest))
    if tall:
        occupied[wall, low_c:high_c] = True
        halves = ((low_r, wall, low_c, high_c), (wall + 1, high_r, low_c, high_c))
    else:
        occupied[low_r:high_r, wall] = True
        halves = ((low_r, high_r, low_c, wall), (low_r, high_r, wall + 1, high_c))
    return [room for half in halves for room in _split(occupied, half, cell, generator)]


def _furnish(
    occupied: BoolArray,
    rooms: list[tuple[int, int, int, int]],
    cell: float,
    generator: np.random.Generator,
) -> None:
    """Put up to three boxes into each room, a passage of a metre off the walls."""
    margin = round(1.5 / cell)
    for low_r, high_r, low_c, high_c in rooms:
        for _ in range(int(generator.integers(0, 4))):
            size = np.round(generator.uniform(0.8, 3.0, 2) / cell).astype(int)
            room = np.array([high_r - low_r, high_c - low_c]) - size - 2 * margin
            if np.any(room < 1):
                continue
            r, c = np.array([low_r, low_c]) + margin + generator.integers(0, room)
            occupied[r : r + size[0], c : c + size[1]] = True


def _open_doors(occupied: BoolArray, cell: float, generator: np.random.Generator) -> None:
    """Break doors through walls in random order until all rooms are connected, and a few more."""
    wide = round(DOOR / cell)
    upright, level = _door_sites(occupied, wide), _door_sites(occupied.T, wide).T
    sites = np.argwhere(np.stack([upright, level], axis=-1))
    labels, count = ndimage.label(~occupied, structure=_CROSS)
    connected = DisjointSet(range(count + 1))
    opened: set[tuple[int, int]] = set()
    for r, c, across in sites[generator.permutation(len(sites))]:
        sides = ((r - 1, c), (r + 1, c)) if across else ((r, c - 1), (r, c + 1))
        first, second = sorted(int(labels[side]) for side in sides)
        if first == second or (first, second) in opened:
            continue
        if connected.connected(first, second) and generator.random() > 0.02:
            continue
        opened.add((first, second))
        connected.merge(first, second)
        door = np.s_[r, c : c + wide] if across else np.s_[r : r + wide, c]
        occupied[door] = False


def _door_sites(occupied: BoolArray, wide: int) -> BoolArray:
    """Return (rows, columns) first cells of doors along the rows: walls with free cells beside."""
    windows = np.lib.stride_tricks.sliding_window_view(occupied, wide, axis=0)[1:-1]
    wall, free = np.all(windows, axis=-1), np.all(~windows, axis=-1)
    sites = np.zeros(occupied.shape, dtype=bool)
    sites[1 : len(wall) + 1, 1:-1] = wall[:, 1:-1] & free[:, :-2] & free[:, 2:]
    return sites


def image_world(path: Path, seed: int, pixel: float = 0.5) -> World:
    """Read a floor plan: dark is obstacle, a pixel is a cell, unless it has too many of them.

    Args:
        path: Picture, such as PNG or JPEG; its top is the world's far side.
        seed: Seed of the start.
        pixel: Side of a pixel [m].

    Returns:
        The world; where the picture had to be shrunk its cells are larger than pixels.

    Raises:
        OptionError: If it cannot be read, is too small or too large, or leaves no free start.
    """
    try:
        check_picture(path)
    except OSError as error:
        raise OptionError(f"--world {path}: {error.strerror}") from None
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise OptionError(f"--world {path}: not a picture that can be read")
    if min(picture.shape) < SMALLEST:
        size = f"{picture.shape[1]} x {picture.shape[0]}"
        raise OptionError(f"--world {path}: {size} pixels, needed {SMALLEST} or more a side")
    occupied = np.asarray(picture) < DARK
    shrink = max(1.0, max(picture.shape) / IMAGE_LONGEST)
    if shrink > 1.0:
        # A cell with any wall in it is a wall: thin lines must not vanish.
        rows, columns = (max(int(side / shrink), 2) for side in picture.shape)
        share = cv2.resize(
            occupied.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA
        )
        occupied = np.asarray(share) > 0.25
    try:
        return make_world(occupied[::-1].copy(), np.random.default_rng(seed), pixel * shrink)
    except ValueError as error:
        raise OptionError(f"--world {path}: {error}") from None
