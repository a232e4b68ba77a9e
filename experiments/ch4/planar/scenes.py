"""Planar scenes to place cameras in: random ones, and those of figures 4-8 and 4-10.

The thesis' worlds are 100 x 100 with the primary target at (50, 50) and the secondary one at
(50, 75); a unit is taken as a metre, as in chapter 3's worlds.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from controllers.placement.moving import cell_centres, covers
from controllers.placement.planar.search import PlanarTask
from controllers.placement.planar.sight import KnownSpace
from controllers.placement.task import Lens, Occluder, Target
from experiments.ch3.planar.worlds import World, make_world
from models.datasheets import CAMERA
from perception.planar.map import Grid

SIDE = 100
PRIMARY, SECONDARY = (50.0, 50.0), (50.0, 75.0)
FREE_P = (0.01, 0.04)
"""P of free random cells: from often to once measured."""
TAKEN_P = 0.99
UNKNOWN_SHARE = 0.1
"""Share of free cells of a random map that were never measured."""
RADII = (1.5, 6.0)
"""Radii of random obstacles [m], as in the unstructured worlds of chapter 3."""
WIDTH = 2.0
"""Width of a target [m]."""
RELATION_ERROR = 0.5 / math.sqrt(12.0)
"""Standard deviation of the secondary target's position relative to the primary one [m]: it is read
off a map with cells of 0.5 m, so it lies anywhere within a cell."""


def make_lens(near: float = 5.0, far: float = 60.0) -> Lens:
    """Return the thesis' camera with a depth of field fit for these worlds [m]."""
    return Lens(CAMERA.field_of_view[0], CAMERA.width, near, far)


def face(name: str, place: tuple[float, float], direction: float, error: float = 0.0) -> Target:
    """Return a straight target of `WIDTH`.

    Args:
        name: Name of the target.
        place: Middle of the target [m].
        direction: Direction of its normal from the x axis [rad].
        error: Relation error of the target [m].
    """
    normal = np.array([math.cos(direction), math.sin(direction)])
    along = 0.5 * WIDTH * np.array([-normal[1], normal[0]])
    return Target(name, np.array(place), normal, np.stack([along, -along]), error)


def convex_obstacle(
    middle: NDArray[np.float64], radius: float, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Draw a convex obstacle's corners (K, 2) [m]."""
    corners = int(generator.integers(4, 10))
    angles = 2.0 * np.pi * (np.arange(corners) + generator.uniform(0.0, 0.9, corners)) / corners
    reach = radius * generator.uniform(0.6, 1.0, corners)
    points = middle + reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return points[ConvexHull(points).vertices]


def random_task(density: float, generator: np.random.Generator) -> PlanarTask:
    """Draw a scene: convex obstacles over a share of the area, two targets that face anywhere.

    Obstacles overlap, and leave the targets uncovered.

    Args:
        density: Share of the area that obstacles cover.
        generator: Random generator of the scene.
    """
    probability = generator.uniform(*FREE_P, (SIDE, SIDE))
    probability[generator.random((SIDE, SIDE)) < UNKNOWN_SHARE] = 0.5
    centres = cell_centres(KnownSpace(probability, 1.0))
    targets = (
        face("primary", PRIMARY, generator.uniform(-np.pi, np.pi)),
        face("secondary", SECONDARY, generator.uniform(-np.pi, np.pi), RELATION_ERROR),
    )
    covered = np.zeros((SIDE, SIDE), dtype=bool)
    occluders: list[Occluder] = []
    while covered.mean() < density:
        radius = generator.uniform(*RADII)
        middle = generator.uniform(0.0, SIDE, 2)
        if min(float(np.hypot(*(middle - t.position))) for t in targets) < radius + WIDTH:
            continue
        corners = convex_obstacle(middle, radius, generator)
        low = np.floor(corners.min(axis=0)).astype(int).clip(0)
        high = np.ceil(corners.max(axis=0)).astype(int)
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        covered[window] |= covers(corners, centres[window])
        occluders.append(Occluder(f"obstacle {len(occluders) + 1}", corners))
    probability[covered] = TAKEN_P
    return PlanarTask(targets, make_lens(), tuple(occluders), KnownSpace(probability, 1.0))


WORK_PIECE = np.array([[46.0, 42.0], [50.0, 42.0], [50.0, 83.0], [46.0, 83.0]])
"""Both targets are on its face x = 50 [m]."""
BOX = np.array([[-3.0, -4.0], [3.0, -4.0], [3.0, 4.0], [-3.0, 4.0]])
"""The occluder of figure 4-8, such an object as is inserted [m]."""
BOX_PLACES = ((75.0, 36.0), (54.0, 50.0))
"""Positions of its middle [m]: beside the path to the primary target; and a metre before that
target, nearer than the lens can focus, so that the target is visible only steeply from the side."""


def work_targets() -> tuple[Target, Target]:
    """Return the primary and the secondary target on the work-piece's face."""
    return face("primary", PRIMARY, 0.0), face("secondary", SECONDARY, 0.0, RELATION_ERROR)


def two_instances() -> tuple[PlanarTask, PlanarTask]:
    """Return figure 4-8's scene, all of it known, with its occluder at both places."""
    blank = KnownSpace(np.full((2 * SIDE, 2 * SIDE), FREE_P[0]), 0.5)
    tasks: list[PlanarTask] = []
    for place in BOX_PLACES:
        solids = {"work-piece": WORK_PIECE, "box": BOX + place}
        taken = np.any([covers(c, cell_centres(blank)) for c in solids.values()], axis=0)
        space = dataclasses.replace(blank, probability=np.where(taken, TAKEN_P, FREE_P[0]))
        occluders = tuple(Occluder(name, corners) for name, corners in solids.items())
        tasks.append(PlanarTask(work_targets(), make_lens(), occluders, space))
    return tasks[0], tasks[1]


def work_site(panel: NDArray[np.float64], seed: int) -> tuple[World, NDArray[np.bool_]]:
    """Draw figure 4-10's world: the work-piece, obstacles on 5 % of the area, and the panel.

    The obstacles leave free the path of the panel and the space before the targets.

    Args:
        panel: (K, 2) corners of the moving object at its initial pose [m].
        seed: Seed of the obstacles.

    Returns:
        The world with the panel, and (rows, columns) its obstacles without.
    """
    generator = np.random.default_rng([seed, 4])
    grid = Grid(2 * SIDE, 2 * SIDE, 0.5)
    centres = cell_centres(KnownSpace(np.zeros(grid.shape), grid.cell))
    occupied = covers(WORK_PIECE, centres)
    keep_free = (centres[..., 0] > 50.0) & (  # noqa: PLR2004
        (np.abs(centres[..., 1] - PRIMARY[1]) < 10.0)  # noqa: PLR2004
        | (np.abs(centres - SECONDARY).max(axis=-1) < 10.0)  # noqa: PLR2004
    )
    drawn = np.zeros(grid.shape, dtype=bool)
    while drawn.mean() < 0.05:  # noqa: PLR2004
        corners = convex_obstacle(
            generator.uniform(0.0, SIDE, 2), generator.uniform(*RADII), generator
        )
        cells = covers(corners, centres)
        if not np.any(cells & keep_free):
            drawn |= cells
    occupied |= drawn
    world = make_world(occupied | covers(panel, centres), generator, grid.cell)
    row, column = grid.cell_at([70.0, 58.0])
    return dataclasses.replace(world, start=(int(row), int(column))), occupied
