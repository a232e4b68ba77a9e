"""Shortest collision-free paths on the field as it truly is, for scoring alone."""

import numpy as np

from controllers.mapping.ground_paths import GroundPathConfig, MappedRises, path_lengths
from controllers.mission.site import SiteDrawing
from experiments.mission.collisions import HIGHEST
from experiments.mission.scene import MissionScene
from models.compose import make_terrain
from perception.elevation.grid import ElevationGrid
from perception.elevation.ground import rises
from perception.elevation.map import ElevationMap
from perception.geometry.arrays import FloatArray

_CELL = 0.05  # Side of a cell [m].
_RADIUS = 0.3  # Radius of a disc that holds a rover [m].


def shortest_path(
    scene: MissionScene, site: SiteDrawing, start: FloatArray, goal: FloatArray
) -> float:
    """Return the length of the shortest path of a rover that knows all [m]; infinite for none.

    Args:
        scene: Scene as built.
        site: Drawing of the site, whose panel and slot the path keeps off.
        start: (2,) where it begins [m], ground frame.
        goal: (2,) where it ends [m], ground frame.
    """
    ends = np.array([start, goal])
    if not np.isfinite(ends).all():
        return np.nan
    wide, long = scene.field.size
    shape = round(long / _CELL), round(wide / _CELL)
    truth = ElevationMap(ElevationGrid((-0.5 * wide, -0.5 * long), shape, _CELL))
    truth.heights[...] = make_terrain(scene.field, scene.robots).height_at(truth.grid.centres)
    truth.variances[...] = 1e-8
    # Neither over nor beside anything a path costs more than its length.
    paths = GroundPathConfig(radius=_RADIUS, climb=HIGHEST, most_climb=HIGHEST, near_cost=0.0)
    mapped = MappedRises(truth.grid, rises(truth))
    return float(path_lengths(mapped, start, goal[None], site.structures, paths)[0])
